"""Where a track starts: a search, boxes and points, the targets that a recipe names, and hands nobody placed."""

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import check_start, find_init, read_init
from facetrack_cli.start.search import box_start, search_start
from facetrack_cli.trackers.face.detectors import PARTS, Detection, Haar, mean_eyes
from facetrack_cli.video.overlay import draw_start
from facetrack_cli.video.source import open_source
from tests.support.samples import FOLDER, TrackClip
from tests.tracking.test_skin import HEAD, LEFT, RIGHT, box, picture


def sample(name):
    """The first frame of a sample clip, and the true points of its parts."""
    clip = TrackClip(name, 1)
    return clip.frames[0], {part: (clip.truth[0, part].x, clip.truth[0, part].y) for part in PARTS}


@pytest.fixture(scope="module")
def face():
    return sample("expressions")


def errors_in_mouth_widths(start, truth):
    points = start.targets["face"].points
    width = np.hypot(*np.subtract(truth["mouth_right"], truth["mouth_left"]))
    return [np.hypot(*np.subtract(points[part], truth[part])) / width for part in truth]


# --- points -------------------------------------------------------------------------------------------------------


def as_it_lies(image, turn, zoom):
    """The image turned about its middle, in degrees, and enlarged; the map (2, 3)."""
    height, width = image.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), -turn, zoom)
    size = round(zoom * width), round(zoom * height)
    matrix[:, 2] += (np.array(size) - (width, height)) / 2
    turned = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE)
    return turned, matrix


@pytest.mark.parametrize(("turn", "zoom"), [(0, 0.6), (12, 1.0), (25, 1.4), (-60, 0.8)])
@pytest.mark.parametrize("clip", ["expressions", "occlusion"])
def test_points_go_with_a_face_whose_eyes_are_seen_however_it_lies(clip, turn, zoom):
    frame, truth = sample(clip)
    box = Haar().find(frame)[0].box
    eyes, apart = np.array(mean_eyes(box)), 0.363 * box[2]
    straight = Detection(box, tuple(map(tuple, eyes))).places(frame.bgr)
    assert max(np.hypot(*np.subtract(straight[part], truth[part])) for part in PARTS) < 0.2 * apart
    image, to = as_it_lies(frame.bgr, turn, zoom)
    cx, cy = to[:, :2] @ np.add(box[:2], np.divide(box[2:], 2)) + to[:, 2]
    left, right = eyes @ to[:, :2].T + to[:, 2]
    side = zoom * box[2]
    points = Detection((cx - side / 2, cy - side / 2, side, side), (tuple(left), tuple(right))).places(image)
    off = [np.hypot(*(to[:, :2] @ straight[part] + to[:, 2] - points[part])) / (zoom * apart) for part in PARTS]
    assert np.mean(off) < 0.06 and max(off) < 0.12


# --- Haar ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("change", ["grey", "dark", (0, 0.5), (0, 6.0), (-9, 1.0)])
def test_finds_the_face_however_it_is_shown(face, change):
    """Grey, dark, or turned by so many degrees and enlarged."""
    frame, truth = face
    turn, zoom = (0, 1.0) if isinstance(change, str) else change
    image, matrix = as_it_lies(frame.bgr, turn, zoom)
    if change == "grey":
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    if change == "dark":
        image = (image * 0.5).astype(np.uint8)
    start = search_start([Frame(5, 0.2, image)])
    assert start.frame == 5 and start.origin == "haar"
    points = {part: tuple(matrix @ [*point, 1]) for part, point in truth.items()}
    assert np.mean(errors_in_mouth_widths(start, points)) < 0.12
    check_start(start, (image.shape[1], image.shape[0]), PARTS)


def test_nobody_there():
    nobody = np.random.default_rng(7).integers(0, 256, (120, 160, 3), dtype=np.uint8)
    frames = [Frame(index, 0, nobody) for index in range(10, 12)]
    with pytest.raises(InputError, match=r"^a\.mp4: no face found in frames 10 to 11; .*--box.*--init"):
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
def test_a_box_drawn_by_hand_need_not_be_exact_and_stands_in_for_a_face_that_nobody_sees(face, by):
    frame, truth = face
    x, y, w, h = Haar().find(frame)[0].box
    drawn = (x + 0.08 * w, y - 0.1 * h, 0.9 * w, 1.2 * h)
    start = box_start(frame, drawn, by=by)
    assert start.targets["face"].box == drawn and start.origin == "--box"
    assert np.mean(errors_in_mouth_widths(start, truth)) < 0.12
    flat = Frame(3, 0.1, np.full((200, 200, 3), 100, np.uint8))
    points = box_start(flat, (40, 40, 100, 120), by=by).targets["face"].points
    (left, _), (right, _) = mean_eyes((40, 40, 100, 120))
    assert points["mouth_left"][0] == pytest.approx((left + right) / 2 - 0.41 * (right - left), abs=2)
    assert 40 < points["nose"][1] < points["lip_upper"][1] < points["lip_lower"][1] < 160


@pytest.mark.parametrize(
    "box, said",
    [
        ((10, 10, 0, 20), "smaller than 6x6 pixels"),
        ((300, 10, 20, 20), "outside the frame of 200x100"),
        ((10, 60, 60, 60), "lip_lower outside the frame"),
        ((-300, -150, 800, 400), "would put nose, .* outside the frame; draw it from the brows"),
    ],
)
def test_boxes_that_hold_no_face(box, said):
    with pytest.raises(InputError, match=said):
        box_start(Frame(0, 0, np.full((100, 200, 3), 100, np.uint8)), box)


def test_preview_marks_the_points_where_they_are():
    frame = Frame(0, 0, np.zeros((100, 100, 3), np.uint8))
    start = Start(0, {"face": TargetStart(None, {"nose": (30, 50), "chin": (80, 50)})}, "")
    picture = draw_start(frame, start)
    zoom = picture.shape[1] // 100  # all of its width is shown, but not all rows
    assert zoom == 9 and picture.shape[1] == 900 and picture.shape[0] % zoom == 0
    first_row = 50 - 35
    for x, y in ((30, 50), (80, 50)):
        row, column = round((y - first_row + 0.5) * zoom - 0.5), round((x + 0.5) * zoom - 0.5)
        assert picture[row - 5 : row + 6, column - 5 : column + 6].any(axis=2).sum() > 10
        assert not picture[row + 12 : row + 20, column - 5 : column + 6].any()


# --- facetrack init -----------------------------------------------------------------------------------------------


@pytest.fixture
def clip(tmp_path, face):
    """A folder of two frames without a face and one with."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for index, image in enumerate((np.zeros_like(face[0].bgr), np.zeros_like(face[0].bgr), face[0].bgr)):
        cv2.imwrite(str(folder / f"{index}.png"), image)
    return folder


def test_init_writes_what_run_will_find_and_replaces_nothing_unasked(clip, capsys):
    path = clip.parent / "frames.init.yaml"
    path.write_text("mine\n")
    assert main(["init", str(clip)]) == 2
    assert path.read_text() == "mine\n" and "--overwrite" in capsys.readouterr().err
    assert main(["init", str(clip), "--overwrite"]) == 0
    start = read_init(find_init(clip))
    assert start.frame == 2 and list(start.targets["face"].points) == list(PARTS)
    out, err = capsys.readouterr()
    assert out == "" and str(path) in err and "facetrack run" in err


def test_init_to_stdout_with_box_frame_and_preview(clip, tmp_path, capsys, face):
    preview, box = tmp_path / "look.png", Haar().find(face[0])[0].box
    given = ["--init-frame", "2", "--box", ",".join(map(str, box)), "--preview", str(preview)]
    assert main(["init", str(clip), "-o", "-", *given]) == 0
    assert cv2.imread(str(preview)) is not None and not list(clip.parent.glob("*.init.*"))
    (tmp_path / "clip.init.yaml").write_text(capsys.readouterr().out)
    start = read_init(tmp_path / "clip.init.yaml")
    assert start.frame == 2 and start.targets["face"].box == box


@pytest.mark.parametrize(
    "arguments, code, said",
    [
        (["--init-frame", "0", "--box", "5,5"], 2, "four numbers"),
        (["--box", "900,5,10,10"], 3, "is outside the frame"),
        (["--init-frame", "99", "--box", "5,5,60,60"], 3, "99"),
        (["-o", "clip.mp4"], 2, ".yaml"),
        (["-o", "/nowhere/at/all.yaml"], 2, "no folder"),
    ],
)
def test_init_says_what_is_wrong_in_one_line(clip, capsys, arguments, code, said):
    assert main(["init", str(clip), *arguments]) == code
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and said in err
    assert not list(clip.parent.glob("*.init.*"))


def test_init_without_a_face_writes_nothing_and_a_preview_never_becomes_a_frame(clip, capsys):
    assert main(["init", str(clip), "--preview", str(clip / "3.png"), "--overwrite"]) == 2
    assert "one more frame" in capsys.readouterr().err
    assert len(list(clip.iterdir())) == 3
    (clip / "2.png").unlink()
    assert main(["init", str(clip)]) == 3
    assert "no face found in frames 0 to 1" in capsys.readouterr().err
    assert not list(clip.parent.glob("*.init.*"))


ALL = ("head", "left_hand", "right_hand")
FRAME = Frame(0, 0.0, picture(HEAD, LEFT, RIGHT))


def start(**boxes):
    return Start(0, {name: TargetStart(box=one) for name, one in boxes.items()}, "clip.init.yaml")


# --- targets, and hands that nobody placed

SPECK = (24.0, 60.0, 11.0, 11.0)  # leftmost, and the smallest
BOTH, OTHER = {"left_hand": LEFT, "right_hand": RIGHT}, {"right_hand": RIGHT}
FOUND = [  # boxes of the start; what else is in the image; the hands that are found
    *(({name: box(HEAD)}, (LEFT, RIGHT), BOTH) for name in ("face", "head", "somebody")),
    ({"face": box(HEAD), "right_hand": box(LEFT)}, (LEFT, RIGHT), {"left_hand": RIGHT}),
    ({"face": box(HEAD)}, (LEFT, RIGHT, SPECK), BOTH),  # the largest ones
    ({"face": box(HEAD), "left_hand": (120.0, 150.0, 28.0, 28.0)}, (RIGHT, SPECK), OTHER),  # where no skin is
    # boxes that are larger or smaller than the hand within them
    *(({"face": box(HEAD), "left_hand": one}, (LEFT, RIGHT), OTHER)
      for one in ((20.0, 100.0, 85.0, 85.0), (57.0, 137.0, 7.0, 7.0))),
]  # fmt: skip


@pytest.mark.parametrize(("given", "others", "found"), FOUND)
def test_the_first_target_is_the_head_and_hands_that_nobody_placed_are_found_from_left_to_right(given, others, found):
    targets = name_targets(start(**given), ALL, Frame(0, 0.0, picture(HEAD, *others))).targets
    assert targets["head"].box == box(HEAD)
    assert all(targets[name].box == given[name] for name in ALL[1:] if name in given)
    for name, hand in found.items():
        assert iou(np.array([targets[name].box]), np.array([box(hand)]))[0] > 0.7


def test_too_few_regions_of_skin_are_told_with_what_to_do():
    frame = Frame(7, 0.0, picture(HEAD, LEFT))
    with pytest.raises(InputError) as caught:
        name_targets(Start(7, {"face": TargetStart(box=box(HEAD))}, "haar"), ALL, frame, clip="a.mp4")
    assert str(caught.value).startswith(
        "a.mp4: frame 7 shows one region of skin beside the head, to begin left_hand and"
    )
    assert "init file" in str(caught.value) and "--set targets.right_hand=null" in str(caught.value)
    with pytest.raises(InputError, match="shows no region of skin"):
        name_targets(start(head=box(HEAD)), ALL, Frame(0, 0.0, picture(HEAD)))


NO_HEAD = "has no box of head, which the recipe begins with"
REFUSED = [
    (start(head=box(HEAD), foot=box(LEFT)), "has foot, which the recipe does not know; it follows head, left_hand"),
    (start(left_hand=box(LEFT)), NO_HEAD),
    (start(left_hand=box(LEFT), right_hand=box(RIGHT)), NO_HEAD),
    (Start(0, {"head": TargetStart(points={"nose": (1.0, 2.0)})}, "x"), NO_HEAD),
]


@pytest.mark.parametrize(("begin", "said"), REFUSED)
def test_targets_that_the_recipe_does_not_know_and_starts_without_a_head_are_refused(begin, said):
    with pytest.raises(InputError, match=said):
        name_targets(begin, ALL, FRAME)


def test_in_a_clip_head_and_hands_are_found_where_the_truth_has_them():
    path = FOLDER / "signing.mp4"
    true = read_init(path.with_suffix(".init.yaml")).targets
    with open_source(path) as source:
        found = search_start(source, (), complete=lambda frame, start: name_targets(start, ALL, frame))
    assert found.frame == 0
    for name, target in found.targets.items():
        middle = [np.array(one.box[:2]) + np.array(one.box[2:]) / 2 for one in (target, true[name])]
        assert np.abs(middle[0] - middle[1]).max() < 0.3 * true[name].box[2], name


def test_a_grey_clip_is_refused_at_its_first_face_and_not_searched_to_its_end():
    looked = []

    def grey(source):
        for frame in source:
            looked.append(frame.index)
            level = frame.bgr.mean(axis=2, keepdims=True).astype(np.uint8)
            yield Frame(frame.index, frame.time_s, np.ascontiguousarray(level.repeat(3, axis=2)))

    with open_source(FOLDER / "signing.mp4") as source, pytest.raises(InputError, match="have a colour"):
        search_start(grey(source), (), complete=lambda frame, start: name_targets(start, ALL, frame))
    assert looked == [0]
