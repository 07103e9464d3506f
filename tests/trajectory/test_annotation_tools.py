"""CVAT's XML, Label Studio's JSON and ELAN's files: written, read back, added to, and what is refused."""

import json
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
    read_cvat,
    read_labelstudio,
    read_tiers,
    spans_of,
    write_cvat,
    write_eaf,
    write_labelstudio,
)
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.head import KINDS
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.trajectory.views import every_frame
from tests.support.face_shape import moving_face

SIZE = (640, 480)
STATUS = ("init", "tracked", "lost", "absent")


def part(target, name, first, status, seed=0):
    rng, t = np.random.default_rng(seed), len(status)
    gone = np.array(status) == "absent"
    x, y, w, h = (np.where(gone, np.nan, values) for values in rng.uniform(30, 400, (4, t)))
    return one_part(target, name, np.arange(first, first + t), x=x, y=y, w=w, h=h, status=list(status))


def table(seed=0):
    lost = ("init", "tracked", "lost", "absent", "absent", "tracked")
    return joined([part("face", "nose", 2, lost, seed), part("face", "lip", 2, ("tracked",) * 6, seed + 1),
                   part("hand", "box", 4, ("tracked", "lost"), seed + 2)])  # fmt: skip


def test_cvat_has_a_track_a_part_and_every_frame():
    root = ET.fromstring(write_cvat(table(), SIZE, "Zoë & co.mp4").encode())
    assert root.findtext("version") == "1.1" and root.findtext("meta/task/mode") == "interpolation"
    assert root.findtext("meta/task/source") == "Zoë & co.mp4" and root.findtext("meta/task/size") == "8"
    assert [root.findtext(f"meta/task/original_size/{side}") for side in ("width", "height")] == ["640", "480"]
    kinds = [(one.findtext("name"), one.findtext("type")) for one in root.iter("label")]
    assert kinds == [("face/nose", "points"), ("face/lip", "points"), ("hand", "rectangle")]
    nose, _, hand = root.iter("track")
    assert [one.get("frame") for one in nose] == [str(n) for n in range(2, 8)]
    assert [one.get("outside") for one in nose] == list("000110")
    assert [one.get("occluded") for one in nose] == list("001000")
    assert {one.get("keyframe") for one in nose} == {"1"} and {one.get("z_order") for one in nose} == {"0"}
    assert nose[3].get("points") == nose[2].get("points")  # of what is gone the last place
    # a part whose rows end before the table's is gone from there on
    assert [(one.get("frame"), one.get("outside")) for one in hand] == [("4", "0"), ("5", "0"), ("6", "1"), ("7", "1")]


@given(st.lists(st.sampled_from(STATUS), min_size=1, max_size=9), st.integers(0, 5), st.integers(0, 2**31))
def test_tracks_come_back(tmp_path, status, first, seed):
    head = part("head", "box", first, ["tracked", *status], seed + 1)
    made = joined([part("face", "nose", first, status, seed), head])
    (tmp_path / "a.xml").write_text(write_cvat(made, SIZE, "c.mp4"), encoding="utf-8")
    (tmp_path / "a.json").write_text(write_labelstudio(made, SIZE, 25.0, "c.mp4"), encoding="utf-8")
    for found in (read_cvat(tmp_path / "a.xml"), read_labelstudio(tmp_path / "a.json", SIZE)):
        for one in made.parts:
            back, known = found.find(one.target, one.part), np.isfinite(one.x)
            if back is None:
                assert not known.any()
                continue
            rows = [back.row(frame) for frame in one.frame.tolist()]
            # before its first place a part has no track, in the last frames of the table it is not visible
            says = [str(back.status[row]) if row is not None else "absent" for row in rows]
            there = {"lost": "hidden" if found.header["read_as"].startswith("CVAT") else "absent", "absent": "absent"}
            assert says == [there.get(s, "visible") for s in one.status.tolist()]
            seen = [n for n, said in enumerate(says) if said != "absent"]
            for name in ("x", "y", "w", "h") if one.part == "box" else ("x", "y"):
                ours, theirs = getattr(one, name)[seen], getattr(back, name)[[rows[n] for n in seen]]
                np.testing.assert_allclose(theirs, ours, atol=0.011)


def test_label_studio_s_numbers():
    (task,) = json.loads(write_labelstudio(table(), SIZE, 25.0, "clip.mp4"))
    assert task["data"] == {"video": "clip.mp4"}
    (annotation,) = task["annotations"]
    nose, _, _ = annotation["result"]
    assert (nose["type"], nose["from_name"], nose["to_name"]) == ("videorectangle", "box", "video")
    value = nose["value"]
    assert (value["framesCount"], value["duration"], value["labels"]) == (8, 0.32, ["face/nose"])
    assert [one["frame"] for one in value["sequence"]] == list(range(3, 9))
    assert [one["enabled"] for one in value["sequence"]] == [True, True, False, False, False, True]
    assert value["sequence"][0]["time"] == 0.12
    with pytest.raises(InputError, match=r"face/nose: frame 0 has no w and h; .* rectangles alone"):
        write_labelstudio(one_part("face", "nose", [0], x=[1.0], y=[2.0]), SIZE, 25.0, "c.mp4")
    eye = one_part("hand", "eye", table().frames, x=np.ones(len(table().frames)), y=np.ones(len(table().frames)))
    (both,) = json.loads(write_labelstudio(joined([*table().parts, eye]), SIZE, 25.0, "clip.mp4"))
    assert both["annotations"] == task["annotations"]


def at_times(time_s, first=0):
    """A box, whose left edge is its frame, shown at these times."""
    frames, n = np.arange(first, first + len(time_s)), len(time_s)
    place = {"x": frames + 4.5, "y": np.full(n, 20.0), "w": np.full(n, 10.0), "h": np.full(n, 10.0)}
    return one_part("head", "box", frames, time_s=time_s, status=["tracked"] * n, **place)


PHONE = np.concatenate([np.arange(50) / 25, 2 + np.arange(40) * 3 / 25])
"""25 pictures a second for two seconds, then a third as many."""
CLOCKS = {
    "variable": (PHONE, 25.0),
    "pictures after the sound": (1.2 + np.arange(60) / 25, 25.0),
    "dropped": (np.delete(np.arange(50), [7, 20, 21, 40]) / 25, 25.0),
    "faster than the tool": (np.arange(90) / 50, 25.0),
    "no times": (np.full(20, np.nan), 25.0),
    "29.97": (np.round(np.arange(900) * 1.001 / 30, 4), 30 / 1.001),
}


def in_label_studio(made, fps, folder):
    (task,) = json.loads(write_labelstudio(made, SIZE, fps, "c.mp4"))
    (region,) = task["annotations"][0]["result"]
    return task, region["value"], folder / "ls.json"


@pytest.mark.parametrize("first", [0, 7])
@pytest.mark.parametrize(("time_s", "fps"), CLOCKS.values(), ids=CLOCKS)
def test_label_studio_s_frames_are_those_of_the_player_s_clock(tmp_path, time_s, fps, first):
    """Also where tracking begins later than the clip."""
    time_s = time_s[first:]
    made = at_times(time_s, first)
    task, value, path = in_label_studio(made, fps, tmp_path)
    seconds = np.where(np.isfinite(time_s), time_s, made.frame / fps)
    numbers = np.rint(np.round(seconds * fps, 3)).astype(int) + 1
    frames = [one["frame"] for one in value["sequence"]]
    assert frames == sorted(set(numbers.tolist())), "each once"
    assert value["framesCount"] == frames[-1] and value["duration"] == pytest.approx(frames[-1] / fps, abs=1e-4)
    shown = [round(one["x"] * SIZE[0] / 100) for one in value["sequence"]]  # the picture that each box is of
    assert shown == [first + int(np.flatnonzero(numbers == frame)[0]) for frame in frames]
    path.write_text(json.dumps([task]))
    clock = every_frame(made)
    (back,) = read_labelstudio(path, SIZE, clock, fps=fps).parts
    assert back.frame.tolist() == shown
    np.testing.assert_allclose(back.boxes[:, 0], shown, atol=0.01)
    # what the annotator moves is the picture that the player shows
    at = len(frames) * 2 // 3
    value["sequence"][at]["x"] += 10
    path.write_text(json.dumps([task]))
    (moved,) = read_labelstudio(path, SIZE, clock, fps=fps).parts
    assert moved.frame[np.abs(moved.boxes[:, 0] - moved.frame) > 1].tolist() == [shown[at]]


def test_keyframes_are_of_the_picture_that_is_shown_and_turned_rectangles_have_centres(tmp_path):
    task, value, path = in_label_studio(at_times(PHONE), 25.0, tmp_path)
    own = next(one for one in value["sequence"] if one["frame"] == 81)
    value["sequence"] += [own | {"frame": 82, "time": 82 / 25, "x": 50}, own | {"frame": 83, "x": 30, "auto": True}]
    path.write_text(json.dumps([task]))
    (found,) = read_labelstudio(path, SIZE, every_frame(at_times(PHONE)), fps=25.0).parts
    assert found.boxes[60, 0] == pytest.approx(320) and found.frame[60] == 60 and found.by_hand[60]
    turned = read_regions(tmp_path, region(x=50, y=50, width=10, height=20, rotation=90))
    # its left top corner is at 320, 240; it lies to the left of it, 96 wide and 64 high
    assert (turned.x[0], turned.y[0]) == pytest.approx((320 - 48 - 0.5, 240 + 32 - 0.5))
    # a clip of 29.97 frames a second, annotated under framerate="30"
    time_s = np.arange(900) * 1.001 / 30
    place = {"x": 1, "y": 10, "width": 5, "height": 5}
    places = [{"frame": n, "time": n / 30, **place} for n in (np.rint(time_s * 30).astype(int) + 1).tolist()[99::100]]
    table = read_regions(tmp_path, region("head", *places), clock=every_frame(at_times(time_s)), fps=30 / 1.001)
    assert table.frame.tolist() == list(range(99, 900, 100))


def region(label="head", *places, **change):
    places = places or ({"frame": 1, "x": 1, "y": 1, "width": 5, "height": 5, **change},)
    value = {"sequence": places, "labels": [label] if label else []}
    return {"id": "r", "type": "videorectangle", "value": value}


def read_regions(folder, *regions, **more):
    path = folder / "ls.json"
    path.write_text(json.dumps({"annotations": [{"result": regions}]}))
    return read_labelstudio(path, SIZE, **more)


def test_skeletons_and_several_points_and_splits(tmp_path):
    path = tmp_path / "annotations.xml"
    path.write_text(
        "<annotations><track id='0' label='face'><skeleton frame='3' keyframe='1'>"
        "<points label='nose' outside='0' occluded='1' keyframe='1' points='10.5,20.5'/></skeleton></track>"
        "<track id='1' label='mouth'><points frame='3' keyframe='0' outside='0' points='1.5,2.5;3.5,4.5'/></track>"
        "<track id='2' label='head'><box frame='3' outside='1' xtl='0' ytl='0' xbr='9' ybr='9'/></track>"
        "<track id='3' label='head'><box frame='3' outside='0' xtl='0' ytl='0' xbr='10' ybr='5'/></track></annotations>"
    )
    found = read_truth(path)
    assert found.names == (("face", "nose"), ("mouth", "point_01"), ("mouth", "point_02"), ("head", "box"))
    assert found.x.tolist() == [10, 1, 3, 4.5] and found.status.tolist() == ["hidden", "visible", "visible", "visible"]
    assert found.by_hand.tolist() == [True, False, False, True]
    assert read_truth(path, "cvat", shift=2).frame.tolist() == [5] * 4


TRACK = "<annotations><track id='0' label='head'>{}</track></annotations>"
BOX = "<box frame='3' xtl='0' ytl='0' xbr='{}' ybr='9'/>"
POLYGON = "<polygon frame='3' points='0,0;1,1;2,2'/>"


def of_regions(*regions):
    return [{"annotations": [{"result": regions}]}]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (TRACK.format(POLYGON), "frame 3: polygon '0,0;1,1;2,2' is neither a box nor points"),
        (TRACK.format(BOX.format("nan")), r"track 0 \(head\), frame 3: 0, 0, nan, 9 are no pixels"),
        (TRACK.format(BOX.format("9") * 2), "another track of the same label"),
        (TRACK.format(BOX.format("9").replace("3", "-3")), "that is no frame number"),
        (TRACK.format("<points frame='3' points='1,2;3'/>"), "points '1,2;3' is neither a box nor points x,y;x,y"),
        (TRACK.format(""), "has no track of a box or a point"),
        ("<annotations><image id='0'/></annotations>", 'export it as "CVAT for video 1.1"'),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><annotations/>", "declares a document type"),
        ("PK\x03\x04....", r"is a ZIP archive; unpack it, and name the file in it"),
        ([], "has 0 tasks with 0 annotations"),
        ([{"annotations": [{"result": []}] * 2}], "keep one annotation"),
        (of_regions(region(frame=0)), "0 is no frame"),
        (of_regions(region(), region()), "is there twice"),
        (of_regions(region(None)), "region r has 0 labels"),
        (of_regions(region(width=0)), "the box has no area"),
        ([{"data": {}}], "it has no 'annotations'"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, content, said):
    path = tmp_path / "from_a_tool"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(InputError, match=said) as error:
        read_cvat(path) if isinstance(content, str) else read_labelstudio(path, SIZE)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


@given(st.integers(0, 2**32), st.integers(1, 6), st.booleans())
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path, seed, changes, xml):
    rng = np.random.default_rng(seed)
    text = write_cvat(table(), SIZE, "c") if xml else write_labelstudio(table(), SIZE, 25.0, "c")
    data = bytearray(text.encode())
    for _ in range(changes):
        at, end = int(rng.integers(len(data))), int(rng.integers(1, 40))
        piece = data[int(rng.integers(len(data))) :][:end]
        data[at : at + int(rng.integers(0, end))] = rng.choice([b"", b"-1", b"1e999", b"null", bytes(piece), b"\xff"])
    path = tmp_path / "damaged"
    path.write_bytes(data)
    try:
        found = read_cvat(path) if xml else read_labelstudio(path, SIZE)
    except InputError as e:
        assert str(path) in str(e) and "\n" not in str(e) and len(str(e)) < 600
    else:
        assert len(found) and found.frame.min() >= 0


# --- ELAN: times, rules of its schema, names and paths that need care

WRITTEN = datetime(2020, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def seen_part(name, status, target="face", time_s=None, frames=None, **columns):
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
    root = eaf(*(seen_part(name, states(text), **more) for name, text in statuses.items()))
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
    bare = tiers(eaf(seen_part("nose", states("....")), seen_part("mouth_left", states("...."))))
    assert not {"mouth@face", "blinks@face", "dips@face"} & bare.keys()


def test_motion_stands_in_its_tiers():
    t = np.arange(200) / 25
    move = 100 * 0.4 * np.clip(t - 3, 0, 1)
    sizes = {"w": np.full(200, 100.0), "h": np.full(200, 100.0)}
    root = eaf(seen_part("box", states("." * 200), x=50 + move, **sizes))
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
        (media,) = eaf(seen_part("nose", ["lost"]), media=Path(name), folder=folder).iter("MEDIA_DESCRIPTOR")
        last = name.rpartition("/")[2]
        assert media.get("MEDIA_URL") == f"file://{tmp_path.as_posix()}/{last}"
        assert media.get("RELATIVE_MEDIA_URL") == f"{relative}{last}"
        assert media.get("MIME_TYPE") == ("video/mp4" if last.endswith("mp4") else "video/*")


def test_targets_have_tiers_of_their_own_under_names_that_readers_find():
    """Without straight quotes, and without what XML cannot hold; participants keep their names."""
    names = ["<x> & ä\x01", "O'Brien", 'Ann "Nan" Lee']
    root = eaf(*(seen_part('a<b>&"c"', states("LL"), target=name) for name in names))
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
            eaf(seen_part("nose", states("..."), time_s=time_s))


@given(
    st.lists(st.lists(st.booleans(), min_size=1, max_size=60), min_size=1, max_size=3),
    st.lists(st.floats(0.0004, 0.3), min_size=60, max_size=60),
    st.integers(0, 2**32),
)
def test_any_track_gives_a_valid_file(lost, steps, seed):
    """Parts of different lengths, lost anywhere, at any rate and with any motion."""
    rng = np.random.default_rng(seed)
    parts = [
        seen_part(f"p{k}", ["lost" if gone else "tracked" for gone in flags], time_s=np.cumsum(steps)[: len(flags)],
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
    hand = seen_part("box", ["tracked"] * 12, target="left_hand")
    return joined([seen_part("nose", states("..LLLL..L...")), hand], path=Path("t.csv"))


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
    seen_part("nose", states("...L.....")).to_pandas().to_csv(table, index=False)
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
