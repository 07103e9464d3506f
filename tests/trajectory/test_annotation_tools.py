"""CVAT's XML and Label Studio's JSON: written, read back, and what is refused."""

import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.formats.annotation import read_cvat, read_labelstudio, write_cvat, write_labelstudio
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.trajectory.views import every_frame

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
