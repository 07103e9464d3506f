"""Which of the things that a detector finds is the face: upright, lying, small, cut off, or a picture on the wall."""

import re
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX, Frame
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.search import (
    ALONE_S,
    MIN_LOOKS,
    SEARCHED_FRAMES,
    Search,
    _Candidate,
    _change,
    _Look,
    box_start,
    search_start,
)
from facetrack_cli.trackers.face.cascaded_regression import PlacedPoints, load_regression
from facetrack_cli.trackers.face.detectors import (
    Detection,
    Haar,
    YuNet,
    again,
    everywhere,
    named,
    righted,
    yunet_model,
)
from facetrack_cli.trackers.face.stabilized import FACE, Similarity
from tests.support import moving_face as moving
from tests.support.moving_face import EYES, PARTS, Pose

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


def search(found, count=30, sure=True, still=None, **others):
    return search_start(noise(count, still), detector=Fake(found, sure), **others)


THREE = [(10, 20, 30), (60, 20, 50), (130, 20, 40)]


def test_the_largest_face_that_stays_is_taken():
    start = search(lambda t: [(20, 20, 40)] * (t == 3) + [(100, 50, 30)] * (t >= 12))
    assert start.frame == 12 and start.targets["face"].box == (100, 50, 30, 30)
    assert "a face 30 pixels wide, found in 10 frames by haar" in start.note
    assert search(lambda t: THREE).targets["face"].box[2] == 50
    # a larger one that is there half of the time covers less
    assert search(lambda t: [*THREE, *([(60, 60, 55)] if t % 2 else [])]).targets["face"].box[2] == 50


def test_all_faces_begin_together():
    start = search(lambda t: THREE, faces="all")
    assert {name: target.box[2] for name, target in start.targets.items()} == {"face": 50, "face_2": 40, "face_3": 30}
    assert all({*target.points} == {*PARTS} for target in start.targets.values())
    assert "and 2 more" in start.note


def test_a_photograph_on_the_wall_comes_after_a_face_that_moves():
    photograph, alive = (10, 20, 60), (120, 40, 40)
    assert search(lambda t: [photograph, alive], still=photograph).targets["face"].box[2] == 40
    assert search(lambda t: [photograph], still=photograph).targets["face"].box[2] == 60


OFF = 0.004 * np.random.default_rng(1).standard_normal((30, len(PARTS), 2))
SEEN = {  # where a part is seen in frame t, and where it is placed
    "noise averages out": (
        lambda t, part: np.array([0.5, 0.6]) + OFF[t, PARTS.index(part)],
        lambda part: np.array([0.5, 0.6]) + OFF[:WAIT_FRAMES, PARTS.index(part)].mean(axis=0),
    ),
    "a part that moves later": (
        lambda t, part: (0.5, 0.92 if part == "lip_lower" and t >= 2 else 0.8),
        lambda part: (0.5, 0.8),
    ),
    "one frame that is wrong": (lambda t, part: (0.1, 0.1) if t == 3 else (0.5, 0.6), lambda part: (0.5, 0.6)),
}


@pytest.mark.parametrize(("at", "expected"), SEEN.values(), ids=SEEN)
def test_points_are_means_in_the_box_of_what_looks_as_in_the_first_frame(at, expected, monkeypatch):
    def placed(face, frame):
        x, y, w, h = face.box
        places = [np.array([x, y]) + np.multiply(at(frame.index, part), [w, h]) for part in load_regression().parts]
        return PlacedPoints(np.array(places), np.full(len(places), 4.0))

    monkeypatch.setattr(Detection, "placed", placed)
    start = search_start(noise(12), detector=Fake(lambda t: [(40 + 2 * t, 30, 50)]))
    (x, y, w, h), points = start.targets["face"].box, start.targets["face"].points
    assert start.frame == 0
    for part in PARTS:
        u, v = points[part]
        assert ((u - x) / w, (v - y) / h) == pytest.approx(expected(part), abs=5e-4), "and it is rounded to 0.01 pixels"


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


@pytest.mark.filterwarnings("error")
def test_what_the_network_makes_up_of_a_tiny_image_is_no_face(monkeypatch):
    rows = np.ones((4, 15), np.float32)
    rows[0], rows[1, 2:4], rows[2] = np.nan, 1e30, np.inf
    net = SimpleNamespace(setInputSize=lambda size: None, detect=lambda image: (1, rows))
    monkeypatch.setattr("facetrack_cli.trackers.face.detectors._net", lambda *_: net)
    assert len(YuNet(Path("none")).find(Frame(0, 0.0, np.zeros((10, 10, 3), np.uint8)))) == 1, "one is a number"


INSTALLED = [Haar(), *([YuNet(model)] if (model := yunet_model()) else [])]
detectors = pytest.mark.parametrize("detector", INSTALLED, ids=lambda one: one.name)
POSE = Pose(160, 120, 100)


def off(points, pose, source=0):
    """How far points are from the truth at most, in distances between the eyes."""
    at = np.array([points[part] for part in PARTS])
    return np.hypot(*(at - moving.truth(pose, source)).T).max() / (EYES * pose.side)


@pytest.mark.parametrize("degrees", [100, 180])
@detectors
def test_a_face_that_lies_begins_as_it_lies(detector, degrees):
    pose = POSE._replace(roll=degrees)
    start = search_start(moving.clip([pose] * 2), detector=detector)
    face = start.targets["face"]
    assert off(face.points, pose) < 0.25
    said = re.search(r"turned by (\d+) degrees clockwise", start.note)
    assert said is not None and int(said[1]) == pytest.approx(degrees, abs=12)
    x, y, w, h = face.box
    assert (x + w / 2, y + h / 2, w) == pytest.approx((160, 120, 100), abs=25)
    if degrees == 180:  # a box that is drawn around it
        drawn = box_start(next(iter(moving.clip([pose]))), (110, 70, 100, 100), by=detector.name)
        assert drawn.placed and off(drawn.targets["face"].points, pose) < 0.25


def test_a_track_begins_where_nothing_covers_the_face():
    frames = [*moving.clip([POSE] * 12)]
    for frame in frames[:4]:
        frame.bgr[115:] = 128  # a board before nose and mouth
    start = search_start(frames, detector=Fake(lambda t: [(110, 70, 100)]))
    assert start.frame == 4 and off(start.targets["face"].points, POSE) < 0.25


@pytest.mark.parametrize(("roll", "turn", "count"), [(100, 0.0, 6), (0, 2.5, 44)])
def test_a_face_that_lies_and_one_that_turns_over_are_tracked(roll, turn, count):
    poses = [Pose(155 + t / 5, 120, 90, roll + turn * t) for t in range(count)]
    frames = moving.clip(poses)
    start = search_start(frames[:2], detector=Haar())
    rows = [one.rows for one in track(build_tracker(load_recipe("face", ["filter.particles=60"]), start), frames, 0)]
    last = rows[-1]
    points = {part: (x, y) for (_, part), x, y in zip(last.names, last.x, last.y, strict=True)}
    assert off(points, poses[-1], (count - 1) % 40) < 0.35
    assert last.angle[[part for _, part in last.names].index(BOX)] % 360 == pytest.approx(poses[-1].roll, abs=15)


def large(pose, at=(1500, 700), t=0, size=(1920, 1080)):
    """A large frame with the small picture of a face in it; its left top corner is `at`."""
    image = np.full((size[1], size[0], 3), (140, 150, 150), np.uint8)
    small = moving.frame(t, moving.paste(moving.ground(), pose, t)).bgr
    image[at[1] : at[1] + small.shape[0], at[0] : at[0] + small.shape[1]] = small
    return Frame(t, t / 25, image)


@detectors
def test_a_small_face_in_a_large_frame_is_found(detector):
    pose = Pose(160, 120, 60)
    frames = [large(pose, t=t) for t in range(2)]
    assert not detector.find(frames[0]) or detector.name == "yunet"
    face = search_start(frames, detector=detector).targets["face"]
    points = {part: (x - 1500, y - 700) for part, (x, y) in face.points.items()}
    assert off(points, pose) < 0.25


def test_a_face_that_was_lost_is_looked_for_as_it_was():
    lying = large(POSE._replace(side=60, roll=180), t=0)
    assert not Haar().find(lying)
    face = Similarity(np.array([900.0, 500.0]), 60 / FACE, np.pi)
    [found] = again(Haar(), lying, face)
    assert found.turn == 4 and found.roll == pytest.approx(np.pi)
    assert np.array(found.box[:2]) + found.box[2] / 2 == pytest.approx((1660, 820), abs=15)
    assert not [one for one in again(Haar(), lying, face._replace(angle=0.0)) if one.turn]


@pytest.mark.parametrize("roll", [0, 45, 180])
def test_a_face_that_was_turned_before_it_was_lost_is_seen_where_it_is_upright(roll, monkeypatch):
    """The roll of a head that turns away is that of the last points that were seen."""
    find, sizes = Haar.find, []
    monkeypatch.setattr(Haar, "find", lambda self, frame: sizes.append(max(frame.size)) or find(self, frame))
    upright, pose = moving.clip([POSE] * 1)[0], Similarity(np.array([90.0, 60.0]), 80 / FACE, np.radians(roll))
    [face] = again(Haar(), upright, pose)
    assert not face.turn and off(named(face.placed(upright)), POSE) < 0.25
    assert max(sizes) == 320, "views are no larger than the frame"


def test_in_a_crowd_a_face_that_lies_as_the_lost_one_comes_first():
    crowd = large(POSE._replace(side=60, roll=180))
    for left in (0, 380, 760, 1140):
        crowd.bgr[100:340, left : left + 320] = moving.frame(0, moving.paste(moving.ground(), POSE, 0)).bgr
    found = again(Haar(), crowd, Similarity(np.array([900.0, 500.0]), 60 / FACE, np.pi))
    assert [face.turn for face in found] == [4, 0, 0, 0, 0]


@pytest.mark.parametrize("cut", ["forehead", "chin"])
@detectors
def test_a_face_that_the_border_cuts_off_is_a_start(detector, cut):
    def close(frame):
        part = frame.bgr[95:] if cut == "forehead" else frame.bgr[:168]
        return Frame(frame.index, frame.time_s, np.ascontiguousarray(part))

    face = search_start(map(close, moving.clip([POSE] * 2)), detector=detector).targets["face"]
    down = 95 if cut == "forehead" else 0
    assert off({part: (x, y + down) for part, (x, y) in face.points.items()}, POSE) < 0.25


def test_nothing_is_seen_where_nobody_is():
    empty = moving.frame(0, moving.ground())
    for detector in INSTALLED:
        assert everywhere(detector, empty) == []
        nobody = Detection((100.0, 60.0, 80.0, 80.0))
        assert righted(detector, empty, nobody) is nobody


POSTER, PERSON = Pose(90, 110, 110), Pose(240, 130, 70)


class Knowing:
    """A detector that knows where both faces are, by the time in s."""

    name = "haar"

    def __init__(self, moved=lambda t: (0, 0)):
        self.moved, self.looks = moved, []

    def find(self, frame):
        self.looks.append(frame.time_s)
        if frame.size != moving.SIZE:
            return []
        (dx, dy) = self.moved(frame.time_s)
        boxes = ((p.x + dx - p.side / 2, p.y + dy - p.side / 2, p.side, p.side) for p in (POSTER, PERSON))
        return [Detection(box, sure=True) for box in boxes]


def room(fps, seconds, speaks, moved=lambda t: (0, 0)):
    """A large picture of a face, and a smaller face that keeps still until it `speaks`, in s."""
    wall = moving.paste(moving.ground(), POSTER)
    for i in range(round(fps * seconds)):
        t = i / fps
        source = round(25 * max(t - speaks, 0)) % 40
        (dx, dy) = moved(t)
        image = moving.paste(wall, PERSON, source)
        image = cv2.warpAffine(
            image, np.array([[1, 0, dx], [0, 1, dy]], float), moving.SIZE, borderMode=cv2.BORDER_WRAP
        )
        yield Frame(i, t, np.clip(image, 0, 255).round().astype(np.uint8))


@pytest.mark.parametrize(("fps", "speaks"), [(100, 0.0), (25, 1.4)])
def test_the_person_is_taken_and_not_the_larger_poster(fps, speaks):
    detector = Knowing()
    start = search_start(room(fps, 4, speaks), detector=detector)
    assert start.targets["face"].box[2] == PERSON.side and start.frame == 0
    assert len(detector.looks) < 40, "a fast camera is not looked at more often"


def test_a_poster_that_a_hand_shakes_is_none_that_lives():
    def moved(t):
        return 6 * np.sin(9 * t), 5 * np.cos(7 * t) - 5

    start = search_start(room(25, 4, 0.2, moved), detector=Knowing(moved))
    assert start.targets["face"].box[2] == PERSON.side


def candidate(side, change=1.0, contrast=50.0):
    box = (0, 0, side, side)
    looks = [_Look(frame, box, {}, contrast, False) for frame in range(60)]
    return _Candidate(Detection(box), looks, begins={0: None}, features=True, change=change)


def faces(*candidates, ended=True):
    """The sides of those that are faces, the best first, after 60 frames."""
    search = Search((), Fake(None), lambda _, start: start, 0.0)
    search.candidates, search.frames, search.times = candidates, [*range(60)], [frame / 25 for frame in range(60)]
    return [face.box[2] for face in search.faces(ended=ended)]


def test_of_those_that_hardly_move_one_that_changes_ten_times_as_much_comes_first():
    assert faces(candidate(60, 0.1), candidate(40, 1.1)) == [40, 60]
    assert faces(candidate(60, 0.2), candidate(40, 1.1)) == [60, 40]
    picture = np.full((24, 24), 100, np.uint8)
    assert _change(picture + np.uint8(20), picture) == 0, "light that changes is no movement"


def test_a_dark_face_is_taken_at_the_end_and_if_no_other_is_lit():
    dark, lit = candidate(60, contrast=2.0), candidate(40)
    assert (faces(dark, ended=False), faces(dark), faces(dark, lit)) == ([], [60], [40])


def test_one_that_keeps_still_alone_is_waited_for_less_and_a_dark_one_with_few_looks_until_light_falls_on_it():
    bright = moving.clip([POSE])[0].bgr

    def begins(dark, count):
        looks, detector = [], Fake(lambda t: looks.append(t / 25) or [(110, 70, 100)])
        frames = [Frame(i, i / 25, (0.2 * bright).astype(np.uint8) if i < dark else bright) for i in range(count)]
        return search_start(frames, detector=detector).frame, looks

    at, looks = begins(0, 40)
    assert at == 0 and ALONE_S <= max(looks) < ALONE_S + 0.3 and len(looks) < 15
    at, looks = begins(75, 150)
    assert 75 <= at < 80 and sum(look < 3 for look in looks) < 25
