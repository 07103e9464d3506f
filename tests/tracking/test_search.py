"""Where a search begins: which of the things that a detector finds is the face, and when it is sure."""

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.start.search import MIN_LOOKS, SEARCHED_FRAMES, search_start
from facetrack_cli.trackers.face.cascaded_regression import PlacedPoints, load_regression
from facetrack_cli.trackers.face.detectors import Detection
from tests.support import moving_face as moving
from tests.support.moving_face import PARTS, Pose

WAIT_FRAMES = 10  # of 25 a second


class Fake:
    """A detector that finds boxes (left, top, side) by frame."""

    name, std = "haar", 0.1

    def __init__(self, found, sure=True):
        self.found, self.sure = found, sure

    def find(self, frame):
        return [Detection((x, y, side, side), sure=self.sure) for x, y, side in self.found(frame.index)]

    def measure(self, image, box):
        return None


def noise(count, still=None):
    """Frames in which everything changes, but for the box `still`."""
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 256, (120, 200, 3), dtype=np.uint8) for _ in range(count)]
    if still:
        x, y, side = still
        for one in frames[1:]:
            one[y : y + side, x : x + side] = frames[0][y : y + side, x : x + side]
    return [Frame(i, i / 25, one) for i, one in enumerate(frames)]


def search(found, count=60, sure=True, still=None, **others):
    return search_start(noise(count, still), detector=Fake(found, sure), **others)


def test_a_face_that_is_found_once_is_passed_over():
    start = search(lambda t: [(20, 20, 40)] * (t == 3) + [(100, 50, 30)] * (t >= 12))
    assert start.frame == 12 and start.targets["face"].box == (100, 50, 30, 30)
    assert "a face 30 pixels wide, found in 10 frames by haar" in start.note
    assert "passed over: 40 pixels wide, found in 1 frame" in start.note


def test_a_late_face_is_waited_for_and_the_search_ends_soon():
    seen = []

    def found(t):
        seen.append(t)
        return [(50, 30, 40)] * (t >= 35)

    assert search(found, 200).frame == 35
    assert seen[-1] == 35 + WAIT_FRAMES - 1


def test_the_largest_face_that_stays_is_taken():
    three = [(10, 20, 30), (60, 20, 50), (130, 20, 40)]
    assert search(lambda t: three).targets["face"].box[2] == 50
    # a larger one that is there half of the time covers less
    assert search(lambda t: [*three, *([(60, 60, 55)] if t % 2 else [])]).targets["face"].box[2] == 50


def test_all_faces_begin_together():
    three = [(10, 20, 30), (60, 20, 50), (130, 20, 40)]
    start = search(lambda t: three, faces="all")
    assert {name: target.box[2] for name, target in start.targets.items()} == {"face": 50, "face_2": 40, "face_3": 30}
    assert all({*target.points} == {*PARTS} for target in start.targets.values())
    assert "and 2 more" in start.note


def test_a_photograph_on_the_wall_comes_after_a_face_that_moves():
    photograph, alive = (10, 20, 60), (120, 40, 40)
    assert search(lambda t: [photograph, alive], still=photograph).targets["face"].box[2] == 40
    assert search(lambda t: [photograph], still=photograph).targets["face"].box[2] == 60


@pytest.fixture
def placing(monkeypatch):
    """Puts `at(t, part)` (2,), in sizes of the box, in the place of what is seen in frame t."""

    def use(at):
        def placed(face, frame):
            x, y, w, h = face.box
            places = [np.array([x, y]) + np.multiply(at(frame.index, part), [w, h]) for part in load_regression().parts]
            return PlacedPoints(np.array(places), np.full(len(places), 4.0))

        monkeypatch.setattr(Detection, "placed", placed)
        return search_start(noise(30), detector=Fake(lambda t: [(40 + 2 * t, 30, 50)]))

    return use


def in_box(start, part):
    (x, y, w, h), (u, v) = start.targets["face"].box, start.targets["face"].points[part]
    return (u - x) / w, (v - y) / h


def test_noise_of_points_averages_out_in_the_box(placing):
    rng = np.random.default_rng(1)
    off = 0.004 * rng.standard_normal((30, len(PARTS), 2))
    start = placing(lambda t, part: np.array([0.5, 0.6]) + off[t, PARTS.index(part)])
    assert start.frame == 0, "of ten frames"
    for k, part in enumerate(PARTS):
        mean = np.array([0.5, 0.6]) + off[:WAIT_FRAMES, k].mean(axis=0)
        assert in_box(start, part) == pytest.approx(mean, abs=5e-4), "and it is rounded to 0.01 pixels"


def test_a_part_that_moves_afterwards_keeps_the_place_of_its_own_frame(placing):
    def at(t, part):
        opened = 0.12 * (t >= 2) if part == "lip_lower" else 0.0
        return 0.5, 0.8 + opened

    start = placing(at)
    assert in_box(start, "lip_lower") == pytest.approx((0.5, 0.8), abs=5e-4)
    assert in_box(start, "nose") == pytest.approx((0.5, 0.8), abs=5e-4)


def test_one_frame_that_is_wrong_changes_nothing(placing):
    start = placing(lambda t, part: (0.1, 0.1) if t == 3 else (0.5, 0.6))
    assert in_box(start, "nose") == pytest.approx((0.5, 0.6), abs=5e-4)


def test_a_recipe_of_boxes_has_a_start_without_points():
    start = search_start(noise(30), (), detector=Fake(lambda t: [(60, 40, 40)]))
    assert start.targets["face"].box == (60, 40, 40, 40) and start.targets["face"].points == {}


def test_a_face_without_eyes_and_mouth_is_none():
    grey = [Frame(i, 0.0, np.full((120, 200, 3), 40 + i, np.uint8)) for i in range(20)]
    with pytest.raises(InputError, match=r"no face found in frames 0 to 19 \(something 40 pixels wide, found in 20"):
        search_start(grey, detector=Fake(lambda t: [(60, 40, 40)], sure=False), clip="a.mp4")


def test_a_clip_of_a_few_frames_is_enough():
    assert search(lambda t: [(60, 40, 40)], 1).frame == 0
    assert search(lambda t: [(60, 40, 40)] * (t == 2), 3).frame == 2
    with pytest.raises(InputError, match="no face found in frames 0 to 19"):
        search(lambda t: [(60, 40, 40)] * (t < MIN_LOOKS - 1), 20)


def test_a_face_that_comes_late_is_found_and_few_frames_are_looked_at():
    seen = []

    def found(t):
        seen.append(t)
        return [(60, 30, 40)] * (1500 <= t < 1900)

    frames = (Frame(i, i / 25, one.bgr) for i, one in enumerate(noise(40) * 60))
    start = search_start(frames, detector=Fake(found), clip="a.mp4")
    assert 1500 <= start.frame < 1500 + 50 and start.targets["face"].box == (60, 30, 40, 40)
    looks = list(dict.fromkeys(seen))
    assert len(looks) < SEARCHED_FRAMES + 120 and looks[:SEARCHED_FRAMES] == list(range(SEARCHED_FRAMES))
    assert len(seen) < 2 * len(looks), "closer looks, for faces that lie, are fewer"
    again = (Frame(i, i / 25, one.bgr) for i, one in enumerate(noise(40) * 60))
    assert search_start(again, detector=Fake(found)).frame == start.frame


def test_of_images_that_are_all_kept_the_first_alone_are_searched():
    pulled = []

    def frames():
        for i, one in enumerate(noise(40) * 10):
            pulled.append(i)
            yield Frame(i, i / 25, one.bgr)

    with pytest.raises(InputError, match="no face found in frames 0 to 249"):
        search_start(frames(), detector=Fake(lambda t: [(60, 30, 40)] * (t > 300)), whole=False)
    assert len(pulled) == SEARCHED_FRAMES


def test_what_is_seen_once_late_is_no_face():
    frames = (Frame(i, i / 25, one.bgr) for i, one in enumerate(noise(20) * 30))
    with pytest.raises(InputError, match="no face found in frames 0 to 599; give its box"):
        search_start(
            frames, detector=Fake(lambda t: [(60, 30, 40)] * (t % 40 == 0 and t > SEARCHED_FRAMES)), clip="a.mp4"
        )
    short = (Frame(i, i / 25, one.bgr) for i, one in enumerate(noise(20) * 13))
    with pytest.raises(InputError, match="no face found"):  # the last frame alone shows something
        search_start(short, detector=Fake(lambda t: [(60, 30, 40)] * (t == 259)))


@pytest.mark.nightly
def test_two_real_faces_by_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = []
    for t in range(16):
        picture = moving.paste(moving.ground(), Pose(90 + t, 120, 90), t)
        frames.append(moving.frame(t, moving.paste(picture, Pose(235, 120, 60), (t + 7) % 40)))

    folder = tmp_path / "clip"
    folder.mkdir()
    for one in frames:
        cv2.imwrite(str(folder / f"{one.index:03d}.png"), one.bgr)
    assert main(["run", "clip", "--init", "haar", "--no-video", "-o", "one"]) == 0
    said = capsys.readouterr().err
    assert "begins in frame 0 with a face" in said and "1 more face was found, --faces all follows each" in said
    assert {line.split(",")[2] for line in (tmp_path / "one/trajectory.csv").read_text().splitlines()[1:]} == {"face"}
    assert main(["run", "clip", "--init", "haar", "--faces", "all", "--no-video", "-o", "all"]) == 0
    rows = [line.split(",") for line in (tmp_path / "all/trajectory.csv").read_text().splitlines()[1:]]
    names = "person_1", "person_2"
    assert {(row[2], row[3]) for row in rows} == {(name, p) for name in names for p in (*PARTS, "box")}
    assert {row[10] for row in rows} == {"init", "tracked"}
    last = {row[2]: float(row[4]) for row in rows if row[0] == "15" and row[3] == "box"}
    assert last["person_1"] == pytest.approx(105, abs=8) and last["person_2"] == pytest.approx(235, abs=8)
