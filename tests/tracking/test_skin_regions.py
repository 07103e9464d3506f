"""Where hands begin: regions of skin apart from the face, in images drawn here."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame
from facetrack_cli.start.assembly import hand_regions
from facetrack_cli.trackers.skin.colour import learn_skin

FACE = (130.0, 40.0, 50.0, 60.0)
USUAL, DARK = (205, 150, 125), (52, 36, 30)
# centre and half axes
LEFT, RIGHT, SMALL = (70, 180, 18, 20), (240, 160, 15, 22), (160, 205, 10, 10)


def scene(*hands, skin=USUAL, neck=True, width=320, height=240, zoom=1):
    """A face with forehead, ears and neck, and hands, before a cloth of blue."""
    picture = np.full((height, width, 3), (150, 90, 60), np.uint8)
    colour = skin[::-1]
    shapes = [(155, 67, 27, 42), *hands]
    for x, y, a, b in shapes:
        cv2.ellipse(picture, (x, y), (a, b), 0, 0, 360, colour, -1)
    if neck:
        cv2.rectangle(picture, (143, 95), (167, 128), colour, -1)
    for eye in (144, 166):
        cv2.ellipse(picture, (eye, 58), (5, 3), 0, 0, 360, (40, 35, 35), -1)
    noise = np.random.default_rng(0).normal(0, 3, (height, width, 1))
    picture = np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)
    if zoom > 1:
        picture = cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_LINEAR)
    return Frame(0, 0.0, np.asarray(picture, np.uint8))


def found(frame, count, face=FACE):
    return hand_regions(frame, face, learn_skin(frame, face), count)


def assert_at(box, shape, zoom=1, off=4):
    """The box is that of the ellipse, to `off` pixels of the image before it was enlarged."""
    x, y, a, b = shape
    expected = (x - a, y - b, 2 * a + 1, 2 * b + 1)
    np.testing.assert_allclose(np.array(box) / zoom, expected, atol=off)


@pytest.mark.parametrize("skin", [USUAL, DARK], ids=["usual", "dark"])
def test_the_largest_regions_from_left_to_right(skin):
    frame = scene(RIGHT, LEFT, SMALL, skin=skin)
    left, right = found(frame, 2)
    assert_at(left, LEFT)
    assert_at(right, RIGHT)
    assert found(frame, 2) == [left, right]
    (largest,) = found(frame, 1)
    assert largest == left
    three = found(frame, 3)
    assert [three[0], three[2]] == [left, right]
    assert_at(three[1], SMALL)
    assert found(frame, 0) == []


def test_the_face_and_its_neck_are_no_hands():
    assert found(scene(), 2) == []
    assert len(found(scene(LEFT), 2)) == 1


def test_specks_and_walls_are_no_hands():
    specks = [(40 + 60 * i, 200, 3, 3) for i in range(5)]
    assert found(scene(*specks), 5) == []
    frame = scene(LEFT)
    frame.bgr[:, 200:] = USUAL[::-1]
    (left,) = found(frame, 2)
    assert_at(left, LEFT)


def test_of_a_bare_arm_a_box_of_the_faces_size():
    frame = scene(RIGHT)
    cv2.line(frame.bgr, (60, 120), (60, 235), USUAL[::-1], 16)
    cv2.circle(frame.bgr, (60, 140), 20, USUAL[::-1], -1)
    arm, right = found(frame, 2)
    assert_at(right, RIGHT)
    assert arm[3] <= FACE[3] and arm[2] <= FACE[2]
    # most skin is in the hand
    assert arm[1] <= 124 and arm[1] + arm[3] >= 156


@pytest.mark.parametrize("zoom", [3, 12])
def test_a_larger_picture_shows_the_same_hands(zoom):
    frame = scene(LEFT, RIGHT, zoom=zoom)
    left, right = found(frame, 2, tuple(zoom * v for v in FACE))
    assert_at(left, LEFT, zoom)
    assert_at(right, RIGHT, zoom)


def test_boxes_are_within_the_picture():
    frame = scene((0, 200, 20, 20), (319, 239, 25, 30))
    for x, y, w, h in found(frame, 2):
        assert x >= 0 and y >= 0 and x + w <= 320 and y + h <= 240
    assert len(found(frame, 2)) == 2


@pytest.mark.parametrize(
    "face", [(-30, -20, 60, 60), (300, 220, 90, 90), (10, 10, 1, 1), (-500, -500, 2000, 2000), (5, 5, 0.3, 400)]
)
def test_any_face_is_survived(face):
    frame = scene(LEFT, RIGHT)
    for x, y, w, h in found(frame, 3, face):
        assert x >= 0 and y >= 0 and x + w <= 320 and y + h <= 240 and w > 0 and h > 0


@pytest.mark.parametrize("size", [(1, 1), (2, 500), (700, 3)])
def test_tiny_and_flat_pictures_are_survived(size):
    frame = Frame(0, 0.0, np.full((*size, 3), USUAL[::-1], np.uint8))
    assert len(found(frame, 2, (0, 0, 2, 2))) <= 2


def test_skin_out_of_reach_is_somebody_elses():
    near, far = (110, 180, 15, 20), (700, 180, 18, 22)
    frame = scene(near, far, width=800)
    [box] = found(frame, 2)
    assert_at(box, near)


def test_what_another_region_holds_is_not_counted_twice():
    """An arm bent around a hand: their boxes are the same, their skin is not."""
    hand = (120, 165, 18, 20)
    frame = scene(hand)
    cv2.line(frame.bgr, (40, 100), (40, 225), USUAL[::-1], 8)
    cv2.line(frame.bgr, (40, 225), (150, 225), USUAL[::-1], 8)
    arm, other = found(frame, 2)
    assert_at(other, hand)
    assert arm[0] + arm[2] < 100
