"""Faces that lie, are small in a large frame, are cut off, or are a picture on the wall."""

import re

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import BOX, Frame
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.search import ALONE_S, STILL_S, box_start, search_start
from facetrack_cli.trackers.face.closer import again, everywhere, righted
from facetrack_cli.trackers.face.detectors import Detection, Haar, YuNet, yunet_model
from facetrack_cli.trackers.face.stabilized import FACE, Similarity
from tests.support import moving_face as moving
from tests.support.moving_face import EYES, PARTS, Pose

INSTALLED = [Haar(), *([YuNet(model)] if (model := yunet_model()) else [])]
detectors = pytest.mark.parametrize("detector", INSTALLED, ids=lambda one: one.name)
POSE = Pose(160, 120, 100)


def off(points, pose, source=0):
    """How far points are from the truth at most, in distances between the eyes."""
    at = np.array([points[part] for part in PARTS])
    return np.hypot(*(at - moving.truth(pose, source)).T).max() / (EYES * pose.side)


def turned(frame, turn):
    """The frame after quarter turns clockwise."""
    return Frame(frame.index, frame.time_s, np.ascontiguousarray(np.rot90(frame.bgr, -turn)))


@pytest.mark.parametrize("degrees", [100, 135, 270])
@detectors
def test_a_face_that_lies_begins_as_it_lies(detector, degrees):
    pose = POSE._replace(roll=degrees)
    start = search_start(moving.clip([pose] * 6), detector=detector)
    face = start.targets["face"]
    assert off(face.points, pose) < 0.25
    said = re.search(r"turned by (\d+) degrees clockwise", start.note)
    assert said is not None and int(said[1]) == pytest.approx(degrees, abs=12)
    x, y, w, h = face.box
    assert (x + w / 2, y + h / 2, w) == pytest.approx((160, 120, 100), abs=25)


def test_an_upright_face_is_looked_at_once():
    looks = []

    class Counted(Haar):
        def find(self, frame):
            looks.append(frame.size)
            return super().find(frame)

    start = search_start(moving.clip([POSE] * 10), detector=Counted())
    assert start.targets["face"].points and "turned" not in start.note
    assert looks == [moving.SIZE] * 10


def test_a_box_around_a_face_that_lies_places_its_points_as_it_lies():
    pose = POSE._replace(roll=180)
    [frame] = moving.clip([pose])
    start = box_start(frame, (110, 70, 100, 100), by="haar")
    assert start.placed and off(start.targets["face"].points, pose) < 0.25


def test_a_face_that_lies_is_tracked():
    poses = [Pose(150 + t, 120, 90, 100) for t in range(12)]
    frames = moving.clip(poses)
    start = search_start(frames, detector=Haar())
    rows = [one.rows for one in track(build_tracker(load_recipe("face", ["filter.particles=100"]), start), frames, 0)]
    last = rows[-1]
    assert not (last.status == "lost").any() and [part for _, part in last.names][5] == BOX
    points = {part: (x, y) for (_, part), x, y in zip(last.names, last.x, last.y, strict=True)}
    assert off(points, poses[-1], 11) < 0.35
    assert last.angle[5] % 360 == pytest.approx(100, abs=15)


def test_a_head_that_turns_over_is_followed_beyond_60_degrees():
    poses = [Pose(160, 120, 90, 2.5 * t) for t in range(44)]
    frames = moving.clip(poses)
    tracker = build_tracker(load_recipe("face"), search_start(frames[:10], detector=Haar()))
    last = [one.rows for one in track(tracker, frames, 0)][-1]
    points = {part: (x, y) for (_, part), x, y in zip(last.names, last.x, last.y, strict=True)}
    assert off(points, poses[-1], 43 % 40) < 0.35


def large(pose, at=(1500, 700), t=0, size=(1920, 1080)):
    """A large frame with the small picture of a face in it; its left top corner is `at`."""
    image = np.full((size[1], size[0], 3), (140, 150, 150), np.uint8)
    small = moving.frame(t, moving.paste(moving.ground(), pose, t)).bgr
    image[at[1] : at[1] + small.shape[0], at[0] : at[0] + small.shape[1]] = small
    return Frame(t, t / 25, image)


@detectors
def test_a_small_face_in_a_large_frame_is_found(detector):
    pose = Pose(160, 120, 60)
    frames = [large(pose, t=t) for t in range(5)]
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


@pytest.mark.parametrize("cut", ["forehead", "chin"])
@detectors
def test_a_face_that_the_border_cuts_off_is_a_start(detector, cut):
    def close(frame):
        part = frame.bgr[95:] if cut == "forehead" else frame.bgr[:168]
        return Frame(frame.index, frame.time_s, np.ascontiguousarray(part))

    face = search_start(map(close, moving.clip([POSE] * 5)), detector=detector).targets["face"]
    down = 95 if cut == "forehead" else 0
    assert off({part: (x, y + down) for part, (x, y) in face.points.items()}, POSE) < 0.25


def test_nothing_is_seen_where_nobody_is():
    empty = moving.frame(0, moving.ground())
    for detector in INSTALLED:
        assert everywhere(detector, empty) == []
        nobody = Detection((100.0, 60.0, 80.0, 80.0))
        assert righted(detector, empty, nobody) is nobody


# --- a picture on the wall ----------------------------------------------------------------------------------------

POSTER, PERSON = Pose(90, 110, 110), Pose(240, 130, 70)


class Known:
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
    empty = moving.ground()
    for i in range(round(fps * seconds)):
        t = i / fps
        source = round(25 * max(t - speaks, 0)) % 40
        (dx, dy) = moved(t)
        image = moving.paste(moving.paste(empty, POSTER), PERSON, source)
        image = cv2.warpAffine(
            image, np.array([[1, 0, dx], [0, 1, dy]], float), moving.SIZE, borderMode=cv2.BORDER_WRAP
        )
        yield Frame(i, t, np.clip(image, 0, 255).round().astype(np.uint8))


@pytest.mark.parametrize(("fps", "speaks"), [(200, 0.0), (25, 1.4)])
def test_the_person_is_taken_and_not_the_larger_poster(fps, speaks):
    known = Known()
    start = search_start(room(fps, 4, speaks), detector=known)
    assert start.targets["face"].box[2] == PERSON.side and start.frame == 0
    assert len(known.looks) < 40, "a fast camera is not looked at more often"


def test_a_poster_that_a_hand_shakes_is_none_that_lives():
    def moved(t):
        return 6 * np.sin(9 * t), 5 * np.cos(7 * t) - 5

    start = search_start(room(25, 4, 0.2, moved), detector=Known(moved))
    assert start.targets["face"].box[2] == PERSON.side


def test_of_two_posters_the_larger_one_is_taken_and_it_says_so():
    known = Known()
    start = search_start(room(25, 5, 9), detector=known)
    assert start.targets["face"].box[2] == POSTER.side
    assert "none of them moves: if another one is meant, name it by --box X,Y,W,H" in start.note
    assert STILL_S <= max(known.looks) < STILL_S + 0.5


def test_one_that_keeps_still_alone_is_waited_for_less():
    frames = [Frame(i, i / 25, moving.clip([POSE])[0].bgr) for i in range(40)]
    known = Known()
    known.find = lambda frame: known.looks.append(frame.time_s) or [Detection((110.0, 70.0, 100.0, 100.0), sure=True)]
    assert search_start(frames, detector=known).frame == 0
    assert ALONE_S <= max(known.looks) < ALONE_S + 0.3 and len(known.looks) < 15
