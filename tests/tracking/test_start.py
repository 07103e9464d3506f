"""Init files, Haar cascades and facetrack init. The face is the one of our own sample clip."""

import csv
import io
import json
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError, UsageError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.checks import check_start
from facetrack_cli.start.init_file import find_init, read_init, write_init
from facetrack_cli.start.preview import draw_start
from facetrack_cli.start.search import box_start, search_start
from facetrack_cli.trackers.face.detectors import PARTS, find_faces, mean_eyes, place

SAMPLES = Path(__file__).parents[2] / "sample_videos"
CLIPS = Path(os.environ.get("FACETRACK_CLIPS", "clips"))
NOBODY = np.random.default_rng(7).integers(0, 256, (120, 160, 3), dtype=np.uint8)


def sample(clip, every=1000):
    """Every so many frames of a sample clip, each with the true points of those parts that are visible."""
    truth = {}
    with (SAMPLES / f"{clip}.truth.csv").open() as file:
        for row in csv.DictReader(file):
            if row["status"] == "visible":
                truth.setdefault(int(row["frame"]), {})[row["part"]] = (float(row["x"]), float(row["y"]))
    capture = cv2.VideoCapture(str(SAMPLES / f"{clip}.mp4"))
    index = 0
    while (read := capture.read())[0]:
        if index % every == 0:
            yield Frame(index, index / 25, read[1]), truth.get(index, {})
        index += 1
    capture.release()


@pytest.fixture(scope="module")
def face():
    return next(sample("expressions"))


def write(tmp_path, text, name="clip.init.yaml"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def errors_in_mouth_widths(start, truth):
    points = start.targets["face"].points
    width = np.hypot(*np.subtract(truth["mouth_right"], truth["mouth_left"])) if len(truth) == 5 else 43.0
    return [np.hypot(*np.subtract(points[part], truth[part])) / width for part in truth]


# --- init files ---------------------------------------------------------------------------------------------------


def test_reads_the_documented_file(tmp_path):
    text = """
frame: 3
face:
  box: [100, 60, 80, 80]          # left, top, width, height
  points: {nose: [141.0, 112.5], mouth_left: [120, 140]}
  windows: {nose: [25, 21]}
"""
    start = read_init(write(tmp_path, text))
    assert start.frame == 3
    assert dict(start.targets) == {
        "face": TargetStart((100, 60, 80, 80), {"nose": (141.0, 112.5), "mouth_left": (120, 140)}, {"nose": (25, 21)})
    }
    assert start.origin == str(tmp_path / "clip.init.yaml")


def test_a_single_target_may_stand_at_the_top_level(tmp_path):
    start = read_init(write(tmp_path, "frame: 0\nbox: [1, 2, 3, 4]\n"))
    assert dict(start.targets) == {"face": TargetStart((1, 2, 3, 4))}


def test_json_may_be_indented_by_tabs(tmp_path):
    text = json.dumps({"frame": 2, "face": {"points": {"nose": [1.5, 2e1]}}}, indent="\t")
    assert read_init(write(tmp_path, text, "clip.init.json")).targets["face"].points == {"nose": (1.5, 20.0)}


def test_several_targets_keep_their_order(tmp_path):
    start = read_init(write(tmp_path, "frame: 0\nleft_hand: {box: [1, 2, 3, 4]}\nhead: {points: {a: [1, 2]}}\n"))
    assert list(start.targets) == ["left_hand", "head"]
    assert start.targets["head"] == TargetStart(None, {"a": (1, 2)})


HEAD = "frame: 0\nface:\n  "
MISTAKES = {
    "unknown key": ("frame: 0\nbocks: [1, 2, 3, 4]\n", 2, 'unknown key "bocks"'),
    "misspelt key": ("frame: 0\npoint: {nose: [1, 2]}\n", 2, 'did you mean "points"'),
    "misspelt frame": ("frame: 0\nfarme: 0\nbox: [1, 2, 3, 4]\n", 2, 'did you mean "frame"'),
    "unknown key in a target": (
        HEAD + "box: [1, 2, 3, 4]\n  colour: red\n",
        4,
        'face: unknown key "colour"; the keys there are: box',
    ),
    "frame in a target": ("face: {frame: 0, box: [1, 2, 3, 4]}\n", 1, '"frame" is missing'),
    "no frame": ("box: [1, 2, 3, 4]\n", 1, '"frame" is missing'),
    "negative frame": ("frame: -1\nbox: [1, 2, 3, 4]\n", 1, "frame must be a whole number, from 0"),
    "no value for frame": ("frame:\nbox: [1, 2, 3, 4]\n", 1, "frame must be a whole number"),
    "huge frame": ("frame: 99999999999\nbox: [1, 2, 3, 4]\n", 1, "frame must be a whole number, from 0 to 1000000000"),
    "unknown detector": (
        "frame: 0\nplaced_by: hand\nbox: [1, 2, 3, 4]\n",
        2,
        "placed_by names a detector, haar or yunet",
    ),
    "no value for placed_by": ("frame: 0\nplaced_by:\nbox: [1, 2, 3, 4]\n", 2, "remove the line if none did"),
    "misspelt placed_by": ("frame: 0\nplacedby: haar\nbox: [1, 2, 3, 4]\n", 2, 'did you mean "placed_by"'),
    "only a frame": ("frame: 0\n", 1, "neither a box nor points"),
    "nothing in the target": (HEAD + "windows: {nose: [1, 2]}\n", 3, "neither a box nor points of face"),
    "target without value": ("frame: 0\nface:\n", 2, "a target holds box: and points:"),
    "NaN": (HEAD + "box: [1, 2, .nan, 4]\n", 3, "not a finite number"),
    "beyond any image": (HEAD + "points: {nose: [1, -1e7]}\n", 3, "face: points.nose[2] must be at least -1000000"),
    "negative height": (HEAD + "box: [1, 2, 3, -4]\n", 3, "face: box[4] must be greater than 0, not -4"),
    "three numbers of a box": (
        HEAD + "box: [1, 2, 3]\n",
        3,
        "box must have 4 items, not 3; write box: [left, top, width, height]",
    ),
    "box as text": (HEAD + "box: 1,2,3,4\n", 3, 'box must be a list, not the text "1,2,3,4"'),
    "point as a number": (HEAD + "points: {nose: 3}\n", 3, "points.nose must be a list, not 3"),
    "text for a number": (
        HEAD + "points: {nose: [1, x]}\n",
        3,
        'face: points.nose[2] must be a number, not the text "x"',
    ),
    "null for a box": (HEAD + "box:\n  points: {nose: [1, 2]}\n", 3, "nothing is given here"),
    "nothing for a number": (HEAD + "points: {nose: [1, ]}\n", 3, "points.nose must have 2 items, not 1"),
    "points as a list": (
        HEAD + "points: [[1, 2]]\n",
        3,
        "points must be a mapping of keys, not a list; write points: {nose: [x, y]}",
    ),
    "no points": (HEAD + "points: {}\n", 3, "nothing is given here"),
    "part with a strange name": (HEAD + 'points: {"the nose": [1, 2]}\n', 3, '"the nose" cannot name a part'),
    "window of no point": (HEAD + "points: {nose: [1, 2]}\n  windows: {nase: [5, 5]}\n", 4, 'did you mean "nose"'),
    "no mapping": ("- 1\n- 2\n", 1, "an init file is a mapping of keys; write frame: 0"),
    "empty": ("", 1, "empty"),
}


@pytest.mark.parametrize("text, line, said", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_one_line_with_its_place(tmp_path, text, line, said):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_init(path)
    message = str(caught.value)
    assert "\n" not in message
    assert re.match(rf"{re.escape(str(path))}:{line}[: ]", message), message
    assert said in message


@pytest.mark.parametrize("name, said", [("none.yaml", "no such init file"), (".", "is a folder")])
def test_no_file_to_read(tmp_path, name, said):
    with pytest.raises(InputError, match=said):
        read_init(tmp_path / name)


numbers = st.floats(-1e6, 1e6, allow_nan=False)
sizes = st.floats(0.01, 1e6)
names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_-]{0,8}", fullmatch=True).filter(
    lambda name: name not in ("box", "points", "windows", "frame", "boxes", "point", "window", "frames")
)


@st.composite
def starts(draw):
    targets = {}
    for name in draw(st.lists(st.sampled_from(["face", "no", "left_hand", "n2"]), min_size=1, max_size=3, unique=True)):
        points = draw(st.dictionaries(names, st.tuples(numbers, numbers), max_size=4))
        box = draw(st.tuples(numbers, numbers, sizes, sizes))
        windows = {part: draw(st.tuples(sizes, sizes)) for part in list(points)[:1]}
        targets[name] = TargetStart(None if points and draw(st.booleans()) else box, points, windows)
    by = draw(st.sampled_from(["", *DETECTORS]))
    return Start(draw(st.integers(0, 10**9)), targets, "", detector=by, placed=by != "")


@given(starts(), st.sampled_from(["a.init.yaml", "a.init.json"]))
def test_what_is_written_is_read_back(tmp_path_factory, start, name):
    path = tmp_path_factory.mktemp("init") / name
    write_init(path, start, clip="a # clip\n")
    again = read_init(path)
    assert again.frame == start.frame
    assert dict(again.targets) == dict(start.targets)
    assert (again.detector, again.placed) == (start.detector, start.placed)
    if name.endswith(".json"):
        json.loads(path.read_text())


def test_written_files_explain_themselves_and_are_not_replaced_unasked(tmp_path):
    path = tmp_path / "clip.init.yaml"
    start = Start(12, {"face": TargetStart((1, 2, 30, 40), {"nose": (10.25, 20)})}, "haar")
    write_init(path, start, clip="clip.mp4")
    text = path.read_text()
    assert "\nplaced_by: haar  # remove this line once you have edited" in text and read_init(path).detector == "haar"
    assert "clip.mp4" in text and "left, top, width, height" in text and "the tip of the nose" in text
    with pytest.raises(OutputError, match="--overwrite"):
        write_init(path, start)
    write_init(path, Start(13, start.targets, ""), overwrite=True)
    assert read_init(path).frame == 13 and "placed_by" not in path.read_text()
    assert [file.name for file in tmp_path.iterdir()] == ["clip.init.yaml"]
    with pytest.raises(OutputError, match="cannot be written"):
        write_init(tmp_path / "none" / "a.yaml", start)
    stream = io.StringIO()
    write_init(stream, start)
    assert "frame: 12" in stream.getvalue()


def test_finds_the_file_beside_a_video_or_a_folder(tmp_path):
    frames = tmp_path / "shots.d"
    frames.mkdir()
    assert find_init(tmp_path / "clip.a.mp4") is None and find_init(frames) is None
    for suffix in ("json", "yml", "yaml"):
        beside = write(tmp_path, "", f"clip.a.init.{suffix}")
        assert find_init(tmp_path / "clip.a.mp4") == beside
    (tmp_path / "shots.d.init.yaml").touch()
    assert find_init(frames) == tmp_path / "shots.d.init.yaml"
    assert find_init(frames / ".") == tmp_path / "shots.d.init.yaml"


@pytest.mark.parametrize(
    "target, said",
    [
        (TargetStart(None, {"nose": (320, 10), "mouth_left": (1, 2)}), r"nose of face at \[320, 10\] is outside"),
        (TargetStart(None, {"nose": (1, 2), "mouth_left": (1, -0.6)}), "mouth_left of face"),
        (TargetStart((310, 10, 40, 40), {"nose": (1, 2), "mouth_left": (1, 2)}), "the box .* is outside"),
        (TargetStart((10, 10, 40, 40)), "no point for nose, mouth_left of face"),
        (TargetStart(None, {"nose": (1, 2)}), "no point for mouth_left of face"),
        (TargetStart(None, {"nose": (1, 2), "mouth_left": (1, 2)}, {"nose": (5, 241)}), "5x241, is larger than"),
    ],
)
def test_what_the_clip_and_the_recipe_refuse(target, said):
    with pytest.raises(InputError, match=rf"^here\.yaml: .*{said}"):
        check_start(Start(0, {"face": target}, "here.yaml"), (320, 240), ("nose", "mouth_left"))


def test_what_they_accept():
    target = TargetStart((-10, -10, 40, 40), {"nose": (-0.5, 239.5), "chin": (319.5, 0)}, {"nose": (320, 240)})
    check_start(Start(4, {"face": target}, ""), (320, 240), ["nose"], frames=5)
    with pytest.raises(InputError, match="ends with frame 3"):
        check_start(Start(4, {"face": target}, ""), (320, 240), ["nose"], frames=4)


# --- points -------------------------------------------------------------------------------------------------------


def as_it_lies(image, turn, zoom):
    """The image turned about its middle, in degrees, and enlarged; the map (2, 3)."""
    height, width = image.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), -turn, zoom)
    size = round(zoom * width), round(zoom * height)
    matrix[:, 2] += (np.array(size) - (width, height)) / 2
    turned = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE)
    return turned, matrix


@pytest.mark.parametrize(("turn", "zoom"), [(0, 0.6), (0, 2.5), (12, 1.0), (-12, 1.0), (25, 1.4), (-60, 0.8)])
@pytest.mark.parametrize("clip", ["expressions", "occlusion"])
def test_points_go_with_a_face_whose_eyes_are_seen_however_it_lies(clip, turn, zoom):
    frame, truth = next(sample(clip))
    box = find_faces(frame.bgr)[0]
    eyes, apart = np.array(mean_eyes(box)), 0.363 * box[2]
    straight = place(frame.bgr, box, tuple(map(tuple, eyes)))
    assert max(np.hypot(*np.subtract(straight[part], truth[part])) for part in PARTS) < 0.2 * apart
    image, to = as_it_lies(frame.bgr, turn, zoom)
    (cx, cy), (left, right) = (
        to[:, :2] @ np.add(box[:2], np.divide(box[2:], 2)) + to[:, 2],
        eyes @ to[:, :2].T + to[:, 2],
    )
    side = zoom * box[2]
    points = place(image, (cx - side / 2, cy - side / 2, side, side), (tuple(left), tuple(right)))
    off = [np.hypot(*(to[:, :2] @ straight[part] + to[:, 2] - points[part])) / (zoom * apart) for part in PARTS]
    assert np.mean(off) < 0.06 and max(off) < 0.12


@pytest.mark.parametrize(("turn", "size"), [(0, 0.8), (0, 1.2), (6, 1.0), (-6, 0.9)])
@pytest.mark.parametrize("clip", ["expressions", "occlusion"])
def test_points_are_found_in_a_box_that_says_neither_the_size_nor_the_tilt_of_a_face(clip, turn, size):
    frame, truth = next(sample(clip))
    x, y, w, h = find_faces(frame.bgr)[0]
    image, to = as_it_lies(frame.bgr, turn, 1.0)
    cx, cy = to[:, :2] @ (x + w / 2, y + h / 2) + to[:, 2]
    points = place(image, (cx - size * w / 2, cy - size * h / 2, size * w, size * h))
    off = [np.hypot(*(to[:, :2] @ truth[part] + to[:, 2] - points[part])) / (0.363 * w) for part in PARTS]
    assert max(off) < 0.2


# --- Haar ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clip", ["expressions", "occlusion"])
def test_points_are_close_to_the_truth(clip):
    errors = []
    for count, (frame, truth) in enumerate(sample(clip, every=40)):
        found = errors_in_mouth_widths(search_start([frame]), truth)
        if count == 0:
            assert max(found) < 0.2
        errors += found
    assert len(errors) > 15
    assert np.mean(errors) < 0.1


@pytest.mark.parametrize("change", ["grey", "dark", "tiny", "large", "tilted"])
def test_finds_the_face_however_it_is_shown(face, change):
    frame, truth = face
    image, points = frame.bgr, truth
    if change == "grey":
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    elif change == "dark":
        image = (image * 0.5).astype(np.uint8)
    else:
        height, width = image.shape[:2]
        scale = {"tiny": 0.5, "large": 6.0, "tilted": 1.0}[change]
        turn = {"tilted": 9.0}.get(change, 0.0)
        matrix = cv2.getRotationMatrix2D((width / 2, height / 2), turn, scale)
        matrix[:, 2] += (scale - 1) / 2 * np.array([width, height])
        size = round(width * scale), round(height * scale)
        image = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE)
        points = {part: tuple(matrix @ [*point, 1]) for part, point in truth.items()}
    start = search_start([Frame(5, 0.2, image)])
    assert start.frame == 5 and start.origin == "haar"
    assert np.mean(errors_in_mouth_widths(start, points)) < 0.12
    check_start(start, (image.shape[1], image.shape[0]), PARTS)


def test_prefers_a_later_frame_to_a_face_in_the_dark(face):
    frame, _ = face
    dark = (frame.bgr * 0.35).astype(np.uint8)
    frames = [Frame(0, 0, dark), Frame(1, 0.04, frame.bgr)]
    assert search_start(frames).frame == 1
    assert search_start(frames[:1]).frame == 0


def test_takes_the_largest_face(face):
    frame, _ = face
    small = cv2.resize(frame.bgr, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    image = np.full((frame.bgr.shape[0], frame.bgr.shape[1] + small.shape[1], 3), 90, np.uint8)
    image[: small.shape[0], : small.shape[1]] = small
    image[:, small.shape[1] :] = frame.bgr
    boxes = find_faces(image)
    assert len(boxes) == 2 and boxes[0][2] > boxes[1][2]
    assert search_start([Frame(0, 0, image)]).targets["face"].box == boxes[0]


def test_nobody_there():
    frames = [Frame(index, 0, NOBODY) for index in range(10, 30)]
    with pytest.raises(InputError, match=r"^a\.mp4: no face found in frames 10 to 29; .*--box.*--init"):
        search_start(frames, clip="a.mp4")
    with pytest.raises(InputError, match="no face found in frame 10;"):
        search_start(frames[:1])
    with pytest.raises(InputError, match="no frame"):
        search_start([])


def test_only_five_parts_can_be_placed(face):
    with pytest.raises(UsageError, match=r"no cascade can place chin, brow, only nose, .*--init"):
        search_start([face[0]], ["nose", "chin", "brow"])
    with pytest.raises(UsageError, match="chin"):
        box_start(face[0], (0, 0, 50, 50), ["chin"])


@pytest.mark.parametrize("by", ["haar", None])
def test_a_box_drawn_by_hand_need_not_be_exact(face, by):
    frame, truth = face
    x, y, w, h = find_faces(frame.bgr)[0]
    drawn = (x + 0.08 * w, y - 0.1 * h, 0.9 * w, 1.2 * h)
    start = box_start(frame, drawn, by=by)
    assert start.targets["face"].box == drawn and start.origin == "--box"
    assert np.mean(errors_in_mouth_widths(start, truth)) < 0.12


@pytest.mark.parametrize("by", ["haar", None])
def test_a_box_stands_in_for_a_face_that_no_detector_sees(by):
    frame = Frame(3, 0.1, np.full((200, 200, 3), 100, np.uint8))
    points = box_start(frame, (40, 40, 100, 120), by=by).targets["face"].points
    (left, _), (right, _) = mean_eyes((40, 40, 100, 120))
    assert points["mouth_left"][0] == pytest.approx((left + right) / 2 - 0.41 * (right - left), abs=2)
    assert 40 < points["nose"][1] < points["lip_upper"][1] < points["lip_lower"][1] < 160


@pytest.mark.parametrize(
    "box, said",
    [
        ((10, 10, 0, 20), "no area"),
        ((10, 10, float("nan"), 20), "no area"),
        ((300, 10, 20, 20), "not in the frame of 200x100"),
        ((10, 60, 60, 60), "lip_lower outside the frame"),
        ((1e5, 1e5, 50, 50), "not in the frame"),
        ((10, 10, 0.5, 0.5), "smaller than 2 pixels"),
        ((-300, -150, 800, 400), "far larger than the frame of 200x100"),
        ((99, -1e5, 2, 2e5), "far larger than the frame"),
    ],
)
def test_boxes_that_hold_no_face(box, said):
    with pytest.raises(InputError, match=said):
        box_start(Frame(0, 0, np.full((100, 200, 3), 100, np.uint8)), box)


def test_the_same_twice(face):
    first, second = search_start([face[0]]), search_start([face[0]])
    assert first == second
    box = first.targets["face"].box
    assert place(face[0].bgr, box) == place(face[0].bgr.copy(), box)


def test_the_frame_is_left_as_it_was(face):
    before = face[0].bgr.copy()
    start = search_start([face[0]])
    picture = draw_start(face[0], start)
    assert np.array_equal(face[0].bgr, before)
    assert picture.dtype == np.uint8 and max(picture.shape) >= 700


def test_preview_marks_the_points_where_they_are():
    frame = Frame(0, 0, np.zeros((100, 100, 3), np.uint8))
    start = Start(0, {"face": TargetStart(None, {"nose": (30, 50), "chin": (80, 50)})}, "")
    picture = draw_start(frame, start)
    zoom = picture.shape[1] // 100  # all of its width is shown, but not all rows
    assert zoom == 9 and picture.shape[1] == 900 and picture.shape[0] % zoom == 0
    first_row = 50 - 35
    for x, y in ((30, 50), (80, 50)):
        row, column = round((y - first_row + 0.5) * zoom - 0.5), round((x + 0.5) * zoom - 0.5)
        assert picture[row, column] == pytest.approx([0, 255, 255], abs=5)


# --- facetrack init -----------------------------------------------------------------------------------------------


@pytest.fixture
def clip(tmp_path, face):
    """A folder of two frames without a face and one with."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for index, image in enumerate((np.zeros_like(face[0].bgr), np.zeros_like(face[0].bgr), face[0].bgr)):
        cv2.imwrite(str(folder / f"{index}.png"), image)
    return folder


def test_init_writes_what_run_will_find(clip, capsys):
    assert main(["init", str(clip)]) == 0
    path = clip.parent / "frames.init.yaml"
    assert find_init(clip) == path
    start = read_init(path)
    assert start.frame == 2 and list(start.targets["face"].points) == list(PARTS)
    out, err = capsys.readouterr()
    assert out == "" and str(path) in err and "facetrack run" in err


def test_init_refuses_to_overwrite(clip, capsys):
    path = clip.parent / "frames.init.yaml"
    path.write_text("mine\n")
    assert main(["init", str(clip)]) == 2
    assert path.read_text() == "mine\n"
    assert "--overwrite" in capsys.readouterr().err
    assert main(["init", str(clip), "--overwrite"]) == 0
    assert read_init(path).frame == 2


def test_init_to_stdout_with_box_frame_and_preview(clip, tmp_path, capsys, face):
    preview = tmp_path / "look.png"
    x, y, w, h = find_faces(face[0].bgr)[0]
    box = f"{x},{y},{w},{h}"
    assert main(["init", str(clip), "-o", "-", "--init-frame", "2", "--box", box, "--preview", str(preview)]) == 0
    text = capsys.readouterr().out
    start = read_init(write(tmp_path, text))
    assert start.frame == 2 and start.targets["face"].box == (x, y, w, h)
    assert cv2.imread(str(preview)) is not None
    assert [file.name for file in clip.parent.glob("*.init.*")] == ["clip.init.yaml"]


@pytest.mark.parametrize(
    "arguments, code, said",
    [
        (["--init-frame", "0", "--box", "5,5"], 2, "four numbers"),
        (["--box", "5,5,0,5"], 2, "above 0"),
        (["--box", "900,5,10,10"], 3, "not in the frame"),
        (["--init-frame", "99"], 3, "99"),
        (["--init-frame", "99", "--box", "5,5,60,60"], 3, "99"),
        (["-o", "clip.mp4"], 2, ".yaml"),
        (["-o", ""], 2, "empty"),
        (["-o", "/nowhere/at/all.yaml"], 2, "no folder"),
        (["--preview", "a.jpg"], 2, ".png"),
    ],
)
def test_init_says_what_is_wrong_in_one_line(clip, capsys, arguments, code, said):
    assert main(["init", str(clip), *arguments]) == code
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and said in err
    assert not list(clip.parent.glob("*.init.*"))


def test_init_without_a_face_writes_nothing(clip, capsys):
    (clip / "2.png").unlink()
    assert main(["init", str(clip)]) == 3
    assert "no face found in frames 0 to 1" in capsys.readouterr().err
    assert not list(clip.parent.glob("*.init.*"))


def test_a_preview_never_becomes_a_frame(clip, capsys):
    assert main(["init", str(clip), "--preview", str(clip / "3.png"), "--overwrite"]) == 2
    assert "one more frame" in capsys.readouterr().err
    assert len(list(clip.iterdir())) == 3


@pytest.mark.clips
@pytest.mark.parametrize("name", ["talking/talking.webm", "sign/sign.mp4", "talkers/lrwp9a.mpg", "girl/img"])
def test_real_clips_start_at_once(name):
    from facetrack_cli.video.source import open_source

    path = CLIPS / name
    if not path.exists():
        pytest.skip(f"no clips at {CLIPS}; say where they are in FACETRACK_CLIPS")
    with open_source(path) as source:
        start = search_start(source)
    points = start.targets["face"].points
    assert start.frame <= 2
    assert points["mouth_left"][0] < points["lip_upper"][0] < points["mouth_right"][0]
    assert points["nose"][1] < points["lip_upper"][1] < points["lip_lower"][1]
    check_start(start, source.size, PARTS)
