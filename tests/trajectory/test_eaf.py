"""ELAN files: times, the schema's rules, names and paths that need care; tiers that are added to one, and read."""

import re
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory import measures
from facetrack_cli.trajectory.formats.annotation import (
    IDS,
    ORDER,
    VOCABULARIES,
    add_tiers,
    read_tiers,
    spans_of,
    write_eaf,
)
from facetrack_cli.trajectory.head import KINDS
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face

WRITTEN = datetime(2020, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def part(name, status, target="face", time_s=None, frames=None, **columns):
    t = len(status)
    frames = np.arange(t) if frames is None else frames
    time_s = np.asarray(frames) / 25 if time_s is None else time_s
    columns = {"x": np.full(t, 50.0), "y": np.full(t, 60.0), **columns}
    return one_part(target, name, frames, time_s=time_s, status=status, **columns)


def states(text):
    """`..LL.` as statuses."""
    return ["lost" if char == "L" else "tracked" for char in text]


def eaf(*parts, media=Path("/videos/clip.mp4"), folder=Path("/videos")):
    return ET.fromstring(write_eaf(joined(parts, path=Path("t.csv")), media, folder, written=WRITTEN))


def tiers(root):
    slots = {one.get("TIME_SLOT_ID"): int(one.get("TIME_VALUE", -1)) for one in root.iter("TIME_SLOT")}
    return {
        tier.get("TIER_ID"): [
            (slots[one.get("TIME_SLOT_REF1")], slots[one.get("TIME_SLOT_REF2")], one.find("ANNOTATION_VALUE").text)
            for one in tier.iter("ALIGNABLE_ANNOTATION")
        ]
        for tier in root.iter("TIER")
    }


def check_links(root, ours=False):
    """The rules of EAFv3.0.xsd that hold for any file of ELAN: order, names that are unique, and links to them."""
    places = [ORDER.index(child.tag) for child in root]
    assert places == sorted(places)
    for key in IDS:
        names = [element.get(key) for element in root.iter() if element.get(key)]
        assert len(names) == len(set(names)), key
    times = [int(slot.get("TIME_VALUE")) for slot in root.iter("TIME_SLOT") if slot.get("TIME_VALUE")]
    assert times == sorted(times) and min(times, default=0) >= 0
    types = {kind.get("LINGUISTIC_TYPE_ID"): kind for kind in root.iter("LINGUISTIC_TYPE")}
    entries = {group.get("CV_ID"): {e.get("CVE_ID"): e for e in group} for group in root.iter("CONTROLLED_VOCABULARY")}
    for tier in root.iter("TIER"):
        vocabulary = types[tier.get("LINGUISTIC_TYPE_REF")].get("CONTROLLED_VOCABULARY_REF")
        for note in tier.iter("ALIGNABLE_ANNOTATION"):
            if vocabulary and (ours or note.get("CVE_REF")):
                entry = entries[vocabulary][note.get("CVE_REF")]
                assert entry.find("CVE_VALUE").text == note.find("ANNOTATION_VALUE").text
    last = root.findtext(".//PROPERTY[@NAME='lastUsedAnnotationId']")
    used = [int(note.get("ANNOTATION_ID")[1:]) for note in root.iter("ALIGNABLE_ANNOTATION")]
    assert last is None or int(last) >= max(used, default=0)


def check_schema(root):
    """The rules, and ELAN's guidelines, that a file of ours could break."""
    check_links(root, ours=True)
    assert (root.get("FORMAT"), root.get("VERSION")) == ("3.0", "3.0")
    ids = [element.get(key) for key in IDS[:2] for element in root.iter() if element.get(key)]
    assert all(re.fullmatch(r"(ts|a)[1-9]\d*", name) for name in ids)
    assert {e.get("LANG_REF") for e in root.iter()} <= {None, *(e.get("LANG_ID") for e in root.iter("LANGUAGE"))}
    notes = list(root.iter("ALIGNABLE_ANNOTATION"))
    used = [note.get(f"TIME_SLOT_REF{n}") for note in notes for n in (1, 2)]
    assert sorted(used) == sorted(slot.get("TIME_SLOT_ID") for slot in root.iter("TIME_SLOT"))
    for rows in tiers(root).values():
        assert all(begin < end for begin, end, _ in rows)
        assert all(one[1] <= other[0] for one, other in pairwise(rows))
    properties = {element.get("NAME"): element.text for element in root.iter("PROPERTY")}
    assert properties["lastUsedAnnotationId"] == str(len(notes))
    assert re.fullmatch(r"urn:nl-mpi-tools-elan-eaf:[0-9a-f-]{36}", properties["URN"])


@pytest.mark.parametrize(
    ("statuses", "more", "lost"),
    [
        ({"nose": "..LLLL..", "lip": "....LLL."}, {}, [(80, 160, "nose"), (160, 240, "nose, lip"), (240, 280, "lip")]),
        ({"box": "...LL"}, {}, [(120, 200, "lost")]),
        # at a variable rate a span ends when the next frame begins
        ({"nose": "..L.LL"}, {"time_s": [0.0, 0.04, 0.08, 0.2, 0.24, 0.5]}, [(80, 200, "nose"), (240, 540, "nose")]),
        # frames without rows are in no span
        ({"nose": ".LLLL."}, {"frames": [0, 1, 2, 50, 51, 52]}, [(40, 120, "nose"), (2000, 2080, "nose")]),
    ],
)
def test_spans_of_lost_parts_name_the_parts(statuses, more, lost):
    root = eaf(*(part(name, states(text), **more) for name, text in statuses.items()))
    check_schema(root)
    assert tiers(root)["lost@face"] == lost


def test_every_kind_of_motion_has_a_vocabulary_with_its_labels():
    assert tuple(VOCABULARIES) == ("seen", *KINDS, *measures.KINDS)
    assert VOCABULARIES["blinks"] == ["blink", "shut"] and VOCABULARIES["phases"] == ["hold", "movement"]


def test_what_a_face_does_stands_in_tiers_that_its_points_can_tell():
    t = np.arange(200)
    shut = (t % 50 == 30) | (t % 50 == 31) | (t % 50 == 32)
    moves = {"open": np.where((t < 20) | ((t >= 100) & (t < 120)), 0.4, 0.0), "shut": shut}
    whole = moving_face(200, noise=0.3, std=0.3, **moves)
    root = ET.fromstring(write_eaf(whole, Path("/videos/clip.mp4"), Path("/videos"), written=WRITTEN))
    check_schema(root)
    found = tiers(root)
    assert found["mouth@face"] == [(0, 800, "open"), (4000, 4800, "open")], "also open from the start"
    assert found["blinks@face"] == [(k * 40, (k + 3) * 40, "blink") for k in (30, 80, 130, 180)]
    assert "dips@face" not in found, "nothing was found"
    bare = tiers(eaf(part("nose", states("....")), part("mouth_left", states("...."))))
    assert not {"mouth@face", "blinks@face", "dips@face"} & bare.keys()


def test_motion_stands_in_its_tiers():
    t = np.arange(200) / 25
    move = 100 * 0.4 * np.clip(t - 3, 0, 1)
    sizes = {"w": np.full(200, 100.0), "h": np.full(200, 100.0)}
    root = eaf(part("box", states("." * 200), x=50 + move, **sizes))
    check_schema(root)
    found = tiers(root)
    (span,) = found["horizontal@face"]
    assert span[2] == "right" and span[:2] == (pytest.approx(3000, abs=250), pytest.approx(4000, abs=250))
    assert [label for _, _, label in found["still@face"]] == ["still", "still"]
    assert set(found) == {"horizontal@face", "still@face"}, "no empty tier"
    assert {one.get("LINGUISTIC_TYPE_ID") for one in root.iter("LINGUISTIC_TYPE")} == {"horizontal", "still"}


@pytest.mark.parametrize(
    "name", ["my clip.mp4", "Grüße.mp4", "a#b.mp4", "100%25.mp4", "q\"<&>'.mp4", "x?y=1.mp4", "sub/../clip.xyz"]
)
def test_media_urls_are_paths_as_elan_writes_them(name, tmp_path, monkeypatch):
    """ELAN takes all that follows `file:` for the file's name, without undoing percent signs."""
    monkeypatch.chdir(tmp_path)
    for folder, relative in ((tmp_path, "./"), (tmp_path / "results/one", "../../")):
        (media,) = eaf(part("nose", ["lost"]), media=Path(name), folder=folder).iter("MEDIA_DESCRIPTOR")
        last = name.rpartition("/")[2]
        assert media.get("MEDIA_URL") == f"file://{tmp_path.as_posix()}/{last}"
        assert media.get("RELATIVE_MEDIA_URL") == f"{relative}{last}"
        assert media.get("MIME_TYPE") == ("video/mp4" if last.endswith("mp4") else "video/*")


def test_targets_have_tiers_of_their_own_under_names_that_readers_find():
    """Without straight quotes, and without what XML cannot hold; participants keep their names."""
    names = ["<x> & ä\x01", "O'Brien", 'Ann "Nan" Lee']
    root = eaf(*(part('a<b>&"c"', states("LL"), target=name) for name in names))
    check_schema(root)
    assert list(tiers(root)) == ["lost@<x> & ä\ufffd", "lost@O’Brien", "lost@Ann ”Nan” Lee"]
    assert set(map(tuple, tiers(root).values())) == {((0, 80, 'a<b>&"c"'),)}
    assert [tier.get("PARTICIPANT") for tier in root.iter("TIER")] == ["<x> & ä\ufffd", *names[1:]]
    assert root.find(".//*[@TIER_ID='lost@O’Brien']") is not None


def test_times_that_cannot_be_are_refused():
    for time_s, said in (
        ([0.0, np.nan, 0.08], "1 has no time_s"),
        ([0.0, 0.08, 0.08], "2 is at 0.08 s, not after frame 1"),
    ):
        with pytest.raises(InputError, match=f"frame {said}"):
            eaf(part("nose", states("..."), time_s=time_s))


@given(
    st.lists(st.lists(st.booleans(), min_size=1, max_size=60), min_size=1, max_size=3),
    st.lists(st.floats(0.0004, 0.3), min_size=60, max_size=60),
    st.integers(0, 2**32),
)
def test_any_track_gives_a_valid_file(lost, steps, seed):
    """Parts of different lengths, lost anywhere, at any rate and with any motion."""
    rng = np.random.default_rng(seed)
    parts = [
        part(f"p{k}", ["lost" if gone else "tracked" for gone in flags], time_s=np.cumsum(steps)[: len(flags)],
             **dict(zip("xy", rng.normal(0, 20, (2, len(flags))).cumsum(axis=1), strict=True)))
        for k, flags in enumerate(lost)
    ]  # fmt: skip
    check_schema(eaf(*parts))
    for first, last, text in spans_of(parts):
        for k, flags in enumerate(lost):
            inside = flags[first : last + 1]
            expected = f"p{k}" in text.split(", ")
            assert all(gone == expected for gone in inside) or (not expected and not any(inside))


# as no program would write it: other quotes, comments, ends of lines, a time that is not known, names that are ours
SESSION = """<?xml version='1.0' encoding="UTF-8"?>\r
<!-- TIER, by hand <TIME_SLOT TIME_SLOT_ID="ts9" TIME_VALUE="1"/> -->\r
<ANNOTATION_DOCUMENT AUTHOR='Zoë' DATE="2021-01-01T00:00:00+01:00" FORMAT="3.0" VERSION="3.0">
    <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds">
        <MEDIA_DESCRIPTOR MEDIA_URL="file:///other/place/clip%20one.mp4" MIME_TYPE="video/mp4"ORIGIN/>
        <PROPERTY NAME="URN">urn:nl-mpi-tools-elan-eaf:1</PROPERTY>
        <PROPERTY NAME="lastUsedAnnotationId">41</PROPERTY>
    </HEADER>
    <TIME_ORDER>
        <TIME_SLOT   TIME_SLOT_ID="ts1"  TIME_VALUE="50"/>
        <TIME_SLOT TIME_SLOT_ID="ts2" />
        <TIME_SLOT TIME_SLOT_ID='ts70' TIME_VALUE='150'></TIME_SLOT>
    </TIME_ORDER>
    <TIER LINGUISTIC_TYPE_REF="gloss" TIER_ID="lost@face" PARTICIPANT="Zoë">
        <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a7" TIME_SLOT_REF1="ts1" TIME_SLOT_REF2="ts70">
            <ANNOTATION_VALUE>&lt;HOUSE&gt; &amp; garden</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    </TIER>
    <LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="gloss" TIME_ALIGNABLE="true"/>
    <LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="lost" CONSTRAINTS="Included_In" TIME_ALIGNABLE="1"/>
    <LOCALE COUNTRY_CODE="US" LANGUAGE_CODE="en"/>
    <CONSTRAINT DESCRIPTION="a > b" STEREOTYPE="Included_In"/>
    <CONTROLLED_VOCABULARY CV_ID="seen"><DESCRIPTION LANG_REF="und"/></CONTROLLED_VOCABULARY>
</ANNOTATION_DOCUMENT>
<!-- the end -->"""


def session(folder, text=SESSION, origin=""):
    path = folder / "session.eaf"
    path.write_bytes(text.replace("ORIGIN", origin).encode())
    return path


def ours():
    hand = part("box", ["tracked"] * 12, target="left_hand")
    return joined([part("nose", states("..LLLL..L...")), hand], path=Path("t.csv"))


def check(before, after):
    """What was there is there, in its order, but for the number of the last annotation."""
    root = ET.fromstring(after)
    there = root.iter()
    for was in ET.fromstring(before).iter() if before else ():
        said = [was.tag, was.attrib, (was.text or "").strip()]
        number = was.get("NAME") == "lastUsedAnnotationId"
        assert any(said == [is_.tag, is_.attrib, said[2] if number else (is_.text or "").strip()] for is_ in there)
    check_links(root)
    return root


def test_tiers_are_added_and_what_was_there_stays(tmp_path):
    path = session(tmp_path)
    data, added, linked = add_tiers(path, ours(), "clip one.mp4")
    assert linked and added == ["lost@face-2", "seen@left_hand"]
    root = check(path.read_bytes(), data)
    found = {tier.get("TIER_ID"): tier for tier in root.iter("TIER")}
    assert found["lost@face-2"].get("LINGUISTIC_TYPE_REF") == "lost-2", "lost is another type there"
    rows = tiers(root)
    assert rows["lost@face"] == [(50, 150, "<HOUSE> & garden")]
    assert rows["lost@face-2"] == [(80, 240, "nose"), (320, 360, "nose")]
    assert rows["seen@left_hand"] == [(0, 480, "seen")]


def test_a_second_time_takes_the_types_that_are_there(tmp_path):
    path = session(tmp_path, SESSION.replace('CV_ID="seen"', 'CV_ID="mine"').replace('TYPE_ID="lost"', 'TYPE_ID="own"'))
    once, _, _ = add_tiers(path, ours(), "clip one.mp4")
    path.write_text(once, encoding="utf-8")
    twice, added, _ = add_tiers(path, ours(), "clip one.mp4")
    check(once, twice)
    assert added == ["lost@face-3", "seen@left_hand-2"]
    for what in ("<LINGUISTIC_TYPE ", "<CONTROLLED_VOCABULARY "):
        assert twice.count(what) == once.count(what)


def test_times_are_those_of_the_file_whose_clip_begins_later(tmp_path):
    path = session(tmp_path, origin=' TIME_ORIGIN="100"')
    data, _, _ = add_tiers(path, ours(), "clip one.mp4")
    rows = tiers(check(path.read_bytes(), data))
    assert rows["lost@face-2"] == [(0, 140, "nose"), (220, 260, "nose")]
    assert rows["seen@left_hand"] == [(0, 380, "seen")]
    (tmp_path / "again.eaf").write_text(data, encoding="utf-8")
    found = {tier.name: tier for tier in read_tiers(tmp_path / "again.eaf", "clip one.mp4")}
    assert found["lost@face-2"].notes[1] == (320, 360, "nose")
    assert found["lost@face"].participant == "Zoë"


@pytest.mark.parametrize(
    "order",
    [
        "<TIME_ORDER/>",
        "<TIME_ORDER></TIME_ORDER>",
        '<TIME_ORDER><TIME_SLOT TIME_SLOT_ID="ts1"/></TIME_ORDER>',
        f'<TIME_ORDER><TIME_SLOT TIME_SLOT_ID="ts1" TIME_VALUE="{10**20}"/></TIME_ORDER>',
    ],
)
def test_a_file_without_annotations_takes_tiers(tmp_path, order):
    header = '<HEADER MEDIA_FILE=""><PROPERTY NAME="a">b&#13;c</PROPERTY></HEADER>'
    text = f'<ANNOTATION_DOCUMENT FORMAT="2.8">{header}{order}</ANNOTATION_DOCUMENT>'
    data, added, linked = add_tiers(session(tmp_path, text), ours(), "clip one.mp4")
    root = check("", data)
    assert added == ["lost@face", "seen@left_hand"] and not linked
    assert root.findtext("HEADER/PROPERTY") == "b\rc"
    assert tiers(root)["lost@face"] == [(80, 240, "nose"), (320, 360, "nose")]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<a/>", "not ELAN's: it begins with a"),
        ("<ANNOTATION_DOCUMENT", ":1: is no XML"),
        ('<ANNOTATION_DOCUMENT FORMAT="2.7"><TIME_ORDER/></ANNOTATION_DOCUMENT>', "is of EAF 2.7; save it by ELAN 4.9"),
        ('<ANNOTATION_DOCUMENT FORMAT="²"><TIME_ORDER/></ANNOTATION_DOCUMENT>', "is of EAF ²; save it by ELAN 4.9"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><ANNOTATION_DOCUMENT/>', "declares a document type"),
    ],
)
def test_a_file_that_cannot_take_them_is_refused(tmp_path, text, says):
    with pytest.raises(InputError, match=says):
        add_tiers(session(tmp_path, text), ours(), "clip one.mp4")


def test_export_into_a_file_asks_before_it_replaces(tmp_path, capsys):
    path, clip, table = session(tmp_path), tmp_path / "clip one.mp4", tmp_path / "track.csv"
    clip.touch()
    part("nose", states("...L.....")).to_pandas().to_csv(table, index=False)
    before = path.read_bytes()
    call = ["export", str(table), "--to", "elan", "--into", str(path), "--media", str(clip)]
    for more, code, said in (
        ([], 2, "exists already; replace it with --overwrite"),
        (["-o", str(tmp_path / "more.eaf")], 0, "lost@face-2 added"),
        (["--to", "srt"], 2, "--into adds the tiers of eaf"),
    ):
        assert main([*call, *more]) == code and path.read_bytes() == before
        assert said in capsys.readouterr().err
    assert main([*call, "--overwrite"]) == 0
    assert path.read_bytes() == (tmp_path / "more.eaf").read_bytes() != before
    assert {file.name for file in tmp_path.iterdir()} == {"session.eaf", "more.eaf", "clip one.mp4", "track.csv"}
