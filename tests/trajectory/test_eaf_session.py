"""Tiers that are added to a file of ELAN, whose own bytes stay, and what is read from one."""

import re
from difflib import SequenceMatcher
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.formats.eaf import write_eaf
from facetrack_cli.trajectory.formats.eaf_session import ORDER, Note, add_tiers, read_tiers
from facetrack_cli.trajectory.trajectory import joined
from tests.trajectory.test_eaf import WRITTEN, part, states, tiers

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
    return write_eaf(
        joined([part("nose", states("..LLLL..L...")), hand], path=Path("t.csv")),
        Path("/videos/clip one.mp4"), Path("/videos"), written=WRITTEN,
    )  # fmt: skip


def check(before, after):
    """What was there is there, in its order, but for the number of the last annotation; ids are unique and known."""
    lines = [one.decode().splitlines(keepends=True) for one in (before, after)]
    for how, a, b, *_ in SequenceMatcher(None, *lines, autojunk=False).get_opcodes():
        gone = "".join(lines[0][a:b]) if how in ("replace", "delete") else ""
        assert re.fullmatch(r'(\s*<PROPERTY NAME="lastUsedAnnotationId">\d+</PROPERTY>\s*)?', gone), gone
    root = ET.fromstring(after)
    for key in ("TIME_SLOT_ID", "ANNOTATION_ID", "TIER_ID", "LINGUISTIC_TYPE_ID", "CV_ID", "CVE_ID", "LANG_ID"):
        names = [one.get(key) for one in root.iter() if one.get(key)]
        assert len(names) == len(set(names)), key
    types = {one.get("LINGUISTIC_TYPE_ID"): one for one in root.iter("LINGUISTIC_TYPE")}
    vocabularies = {one.get("CV_ID"): {e.get("CVE_ID") for e in one} for one in root.iter("CONTROLLED_VOCABULARY")}
    for tier in root.iter("TIER"):
        vocabulary = types[tier.get("LINGUISTIC_TYPE_REF")].get("CONTROLLED_VOCABULARY_REF")
        assert vocabulary is None or vocabulary in vocabularies
        links = {one.get("CVE_REF") for one in tier.iter("ALIGNABLE_ANNOTATION")} - {None}
        assert links <= vocabularies.get(vocabulary, set())
    times = [int(one.get("TIME_VALUE")) for one in root.iter("TIME_SLOT") if one.get("TIME_VALUE")]
    assert times == sorted(times)
    order = [one.tag for one in root]
    assert all(ORDER.index(a) <= ORDER.index(b) for a, b in pairwise(order))
    last = root.findtext(".//PROPERTY[@NAME='lastUsedAnnotationId']")
    used = [int(one.get("ANNOTATION_ID")[1:]) for one in root.iter("ALIGNABLE_ANNOTATION")]
    assert last is None or int(last) >= max(used)
    return root


def test_tiers_are_added_and_nothing_else_is_touched(tmp_path):
    path = session(tmp_path)
    data, added, linked = add_tiers(path, ours(), "clip one.mp4")
    assert linked and added == ["lost@face-2", "seen@left_hand"]
    root = check(path.read_bytes(), data)
    found = {tier.get("TIER_ID"): tier for tier in root.iter("TIER")}
    assert found["lost@face-2"].get("LINGUISTIC_TYPE_REF") == "lost-2", "lost is another type there"
    rows = tiers(ET.fromstring(data.replace(b'<TIME_SLOT TIME_SLOT_ID="ts2" />', b"")))
    assert rows["lost@face"] == [(50, 150, "<HOUSE> & garden")]
    assert rows["lost@face-2"] == [(80, 240, "nose"), (320, 360, "nose")] and rows["seen@left_hand"] == [
        (0, 480, "seen")
    ]
    assert data.count(b"\r\n") == 2 and data.endswith(b"<!-- the end -->")


def test_a_second_time_takes_the_types_that_are_there(tmp_path):
    path = session(tmp_path, SESSION.replace('CV_ID="seen"', 'CV_ID="mine"').replace('TYPE_ID="lost"', 'TYPE_ID="own"'))
    once, _, _ = add_tiers(path, ours(), "clip one.mp4")
    (tmp_path / "once.eaf").write_bytes(once)
    twice, added, _ = add_tiers(tmp_path / "once.eaf", ours(), "clip one.mp4")
    check(once, twice)
    assert added == ["lost@face-3", "seen@left_hand-2"]
    assert twice.count(b"<LINGUISTIC_TYPE ") == once.count(b"<LINGUISTIC_TYPE ")
    assert twice.count(b"<CONTROLLED_VOCABULARY ") == once.count(b"<CONTROLLED_VOCABULARY ")


def test_times_are_those_of_the_file_whose_clip_begins_later(tmp_path):
    path = session(tmp_path, origin=' TIME_ORIGIN="100"')
    data, _, _ = add_tiers(path, ours(), "clip one.mp4")
    check(path.read_bytes(), data)
    rows = tiers(ET.fromstring(data.replace(b'<TIME_SLOT TIME_SLOT_ID="ts2" />', b"")))
    assert rows["lost@face-2"] == [(0, 140, "nose"), (220, 260, "nose")] and rows["seen@left_hand"] == [
        (0, 380, "seen")
    ]
    (tmp_path / "again.eaf").write_bytes(data)
    found = {tier.name: tier for tier in read_tiers(tmp_path / "again.eaf", "clip one.mp4")}
    assert found["lost@face-2"].notes[1] == Note("lost@face-2", "face", 320, 360, "nose")
    assert found["lost@face"].participant == "Zoë"


@pytest.mark.parametrize(
    "order", ["<TIME_ORDER/>", "<TIME_ORDER></TIME_ORDER>", '<TIME_ORDER><TIME_SLOT TIME_SLOT_ID="ts1"/></TIME_ORDER>']
)
def test_a_file_without_annotations_takes_tiers(tmp_path, order):
    text = f'<ANNOTATION_DOCUMENT FORMAT="2.8"><HEADER MEDIA_FILE=""/>{order}</ANNOTATION_DOCUMENT>'
    data, added, linked = add_tiers(session(tmp_path, text), ours(), "clip one.mp4")
    root = check(b"", data.replace(b'<TIME_SLOT TIME_SLOT_ID="ts1"/>', b""))
    assert added == ["lost@face", "seen@left_hand"] and not linked
    assert tiers(root)["lost@face"] == [(80, 240, "nose"), (320, 360, "nose")]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<a/>", "not ELAN's: it begins with a"),
        ("<ANNOTATION_DOCUMENT", "is no XML in UTF-8"),
        ('<ANNOTATION_DOCUMENT FORMAT="2.7"><TIME_ORDER/></ANNOTATION_DOCUMENT>', "is of EAF 2.7; save it by ELAN 4.9"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><ANNOTATION_DOCUMENT/>', "declares a document type"),
    ],
)
def test_a_file_that_cannot_take_them_is_refused(tmp_path, text, says):
    with pytest.raises(InputError, match=says):
        add_tiers(session(tmp_path, text), ours(), "clip one.mp4")


def test_export_into_a_file_asks_before_it_replaces(tmp_path, capsys):
    path, clip = session(tmp_path), tmp_path / "clip one.mp4"
    clip.touch()
    table = tmp_path / "track.csv"
    lines = [f"{t},{t / 25},face,nose,50,60,20,20,,.9,{'lost' if t == 3 else 'tracked'}" for t in range(9)]
    table.write_text("\n".join(["frame,time_s,target,part,x,y,w,h,angle,confidence,status", *lines]) + "\n")
    before = path.read_bytes()
    call = ["export", str(table), "--to", "elan", "--into", str(path), "--media", str(clip)]
    assert main(call) == 2 and path.read_bytes() == before
    assert "exists already; replace it with --overwrite" in capsys.readouterr().err
    assert main([*call, "-o", str(tmp_path / "more.eaf")]) == 0 and path.read_bytes() == before
    assert "lost@face-2 added" in capsys.readouterr().err
    assert main([*call, "--overwrite"]) == 0
    assert path.read_bytes() == (tmp_path / "more.eaf").read_bytes() != before
    assert main(["export", str(table), "--to", "srt", "--into", str(path)]) == 2
    assert "--into adds the tiers of eaf" in capsys.readouterr().err
    assert not [file for file in tmp_path.iterdir() if file.name not in (
        "session.eaf", "more.eaf", "clip one.mp4", "track.csv")]  # fmt: skip
