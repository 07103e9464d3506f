"""ELAN files: times, the schema's rules, names and paths that need care."""

import re
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.analysis import face_events
from facetrack_cli.trajectory.analysis.head_motion import KINDS, LABELS
from facetrack_cli.trajectory.formats.eaf import VOCABULARIES, spans_of, write_eaf
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
    slots = {one.get("TIME_SLOT_ID"): int(one.get("TIME_VALUE")) for one in root.iter("TIME_SLOT")}
    return {
        tier.get("TIER_ID"): [
            (slots[one.get("TIME_SLOT_REF1")], slots[one.get("TIME_SLOT_REF2")], one.find("ANNOTATION_VALUE").text)
            for one in tier.iter("ALIGNABLE_ANNOTATION")
        ]
        for tier in root.iter("TIER")
    }


def check_schema(root):
    """The rules of EAFv3.0.xsd, and of ELAN's guidelines, that this file could break."""
    order = ["HEADER", "TIME_ORDER", "TIER", "LINGUISTIC_TYPE", "LANGUAGE", "CONSTRAINT", "CONTROLLED_VOCABULARY"]
    places = [order.index(child.tag) for child in root]
    assert places == sorted(places)
    assert (root.get("FORMAT"), root.get("VERSION")) == ("3.0", "3.0")
    ids = [one.get(key) for key in ("TIME_SLOT_ID", "ANNOTATION_ID") for one in root.iter() if one.get(key)]
    assert len(ids) == len(set(ids)) and all(re.fullmatch(r"(ts|a)[1-9]\d*", one) for one in ids)
    names = [one.get("TIER_ID") for one in root.iter("TIER")]
    assert len(names) == len(set(names))
    times = [int(one.get("TIME_VALUE")) for one in root.iter("TIME_SLOT")]
    assert times == sorted(times) and min(times, default=0) >= 0
    types = {one.get("LINGUISTIC_TYPE_ID"): one for one in root.iter("LINGUISTIC_TYPE")}
    entries = {one.get("CVE_ID"): one for one in root.iter("CV_ENTRY_ML")}
    vocabularies = {one.get("CV_ID") for one in root.iter("CONTROLLED_VOCABULARY")}
    languages = {one.get("LANG_ID") for one in root.iter("LANGUAGE")}
    assert {one.get("LANG_REF") for one in root.iter() if one.get("LANG_REF")} <= languages
    used = []
    for tier in root.iter("TIER"):
        vocabulary = types[tier.get("LINGUISTIC_TYPE_REF")].get("CONTROLLED_VOCABULARY_REF")
        assert vocabulary is None or vocabulary in vocabularies
        for one in tier.iter("ALIGNABLE_ANNOTATION"):
            used += [one.get("TIME_SLOT_REF1"), one.get("TIME_SLOT_REF2")]
            if vocabulary:
                assert entries[one.get("CVE_REF")].find("CVE_VALUE").text == one.find("ANNOTATION_VALUE").text
    assert sorted(used) == sorted(one.get("TIME_SLOT_ID") for one in root.iter("TIME_SLOT"))
    for rows in tiers(root).values():
        assert all(begin < end for begin, end, _ in rows)
        assert all(one[1] <= other[0] for one, other in pairwise(rows))
    properties = {one.get("NAME"): one.text for one in root.iter("PROPERTY")}
    assert properties["lastUsedAnnotationId"] == str(len(used) // 2)
    assert re.fullmatch(r"urn:nl-mpi-tools-elan-eaf:[0-9a-f-]{36}", properties["URN"])
    assert {one.get("STEREOTYPE") for one in root.iter("CONSTRAINT")} == {
        "Time_Subdivision", "Symbolic_Subdivision", "Symbolic_Association", "Included_In"
    }  # fmt: skip


def test_spans_of_lost_parts_name_the_parts_and_split_where_others_are():
    root = eaf(part("nose", states("..LLLL..")), part("lip", states("....LLL.")))
    check_schema(root)
    assert tiers(root)["lost@face"] == [(80, 160, "nose"), (160, 240, "nose, lip"), (240, 280, "lip")]


def test_a_box_is_lost_as_a_whole_and_to_the_end():
    root = eaf(part("box", states("...LL")))
    assert tiers(root)["lost@face"] == [(120, 200, "lost")]


def test_spans_end_when_the_next_frame_begins_at_a_variable_rate():
    time_s = [0.0, 0.04, 0.08, 0.2, 0.24, 0.5]
    assert tiers(eaf(part("nose", states("..L.LL"), time_s=time_s)))["lost@face"] == [
        (80, 200, "nose"),
        (240, 540, "nose"),
    ]


def test_frames_without_rows_are_in_no_span():
    frames = [0, 1, 2, 50, 51, 52]
    found = tiers(eaf(part("nose", states(".LLLL."), frames=frames)))["lost@face"]
    assert found == [(40, 120, "nose"), (2000, 2080, "nose")]


def test_every_kind_of_motion_has_a_vocabulary_with_its_labels():
    assert tuple(VOCABULARIES) == ("seen", *KINDS, *face_events.KINDS)
    for tier, kind in face_events.KINDS.items():
        assert {*filter(None, (kind.value, kind.longer, kind.other))} == set(VOCABULARIES[tier])
    assert all(set(LABELS[kind]) == set(VOCABULARIES[kind]) for kind in LABELS)


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
    "name", ["clip.mp4", "my clip.mp4", "Grüße.mp4", "a#b.mp4", "100%25.mp4", "q\"<&>'.mp4", "x?y=1.mp4"]
)
def test_media_urls_are_paths_as_elan_writes_them(name):
    """ELAN takes all that follows `file:` for the file's name, without undoing percent signs."""
    root = eaf(part("nose", states("..")), media=Path("/videos") / name, folder=Path("/results/one"))
    (media,) = root.iter("MEDIA_DESCRIPTOR")
    assert media.get("MEDIA_URL") == f"file:///videos/{name}"
    assert media.get("RELATIVE_MEDIA_URL") == f"../../videos/{name}"
    assert media.get("MIME_TYPE") == "video/mp4"


def test_media_beside_the_file_and_of_another_type(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (media,) = eaf(part("nose", states("..")), media=Path("sub/../clip.xyz"), folder=tmp_path).iter("MEDIA_DESCRIPTOR")
    assert media.get("MEDIA_URL") == f"file://{tmp_path.as_posix()}/clip.xyz"
    assert media.get("RELATIVE_MEDIA_URL") == "./clip.xyz" and media.get("MIME_TYPE") == "video/*"


def test_names_are_escaped_and_what_xml_cannot_hold_is_replaced():
    root = eaf(part('a<b>&"c"', states("LL"), target="<x> & ä\x01"))
    check_schema(root)
    assert tiers(root)["lost@<x> & ä\ufffd"] == [(0, 80, 'a<b>&"c"')]


def test_names_of_tiers_have_no_straight_quotes_and_participants_keep_theirs():
    root = eaf(part("nose", states("LL"), target="O'Brien"), part("nose", states("L."), target='Ann "Nan" Lee'))
    check_schema(root)
    assert list(tiers(root)) == ["lost@O’Brien", "lost@Ann ”Nan” Lee"]
    assert [one.get("PARTICIPANT") for one in root.iter("TIER")] == ["O'Brien", 'Ann "Nan" Lee']
    assert root.find(f".//*[@TIER_ID='{root.find('TIER').get('TIER_ID')}']") is not None


def test_several_targets_have_their_own_tiers():
    root = eaf(part("nose", states(".L")), part("box", states("L."), target="hand"))
    check_schema(root)
    assert tiers(root)["lost@face"] == [(40, 80, "nose")] and tiers(root)["lost@hand"] == [(0, 40, "lost")]


@pytest.mark.parametrize(
    ("time_s", "said"),
    [
        ([0.0, np.nan, 0.08], "frame 1 has no time_s"),
        ([0.0, 0.08, 0.04], "frame 2 is at 0.04 s, not after frame 1"),
        ([0.0, 0.04, 0.04], "frame 2 is at 0.04 s"),
    ],
)
def test_times_that_cannot_be_are_refused(time_s, said):
    with pytest.raises(InputError, match=re.escape(said)):
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
