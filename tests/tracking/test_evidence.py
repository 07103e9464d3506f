"""Which face of a frame is the one that was lost: places, time and looks of faces that somebody has drawn."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame
from facetrack_cli.tracking.face import found_again
from facetrack_cli.tracking.face.found_again import (
    MAX_LOOKS,
    NEW,
    OTHER,
    SIDE,
    kept,
    likeness,
    look_of,
    recognised,
    sighted,
)  # fmt: skip
from facetrack_cli.tracking.face.stabilized import Similarity
from facetrack_cli.tracking.people import looks as people_looks
from facetrack_cli.tracking.people.looks import Picture
from facetrack_cli.tracking.start.detectors import Found

BOX = (40.0, 30.0, 60.0, 60.0)
ELSEWHERE = (140.0, 60.0, 80.0, 80.0)


def portrait(seed):
    """(64, 64, 3) of blobs: another seed is another person."""
    noise = np.random.default_rng(seed).normal(0, 1, (64, 64)).astype(np.float32)
    blobs = cv2.GaussianBlur(noise, (0, 0), 5)
    return np.repeat((120 + 50 * blobs / blobs.std())[..., None], 3, axis=2).clip(0, 255)


def shown(*faces, time_s=0.0, turn=0.0, light=1.0):
    """A frame of 240x180 with a person in each box, turned by an angle."""
    picture = np.full((180, 240, 3), 100, np.float32)
    for (x, y, w, _), seed in faces:
        k, (a, b) = w / 64, (np.cos(turn), np.sin(turn))
        turned = k * np.array([[a, -b], [b, a]])
        middle = np.array([x + (w - 1) / 2, y + (w - 1) / 2])
        to = np.column_stack([turned, middle - turned @ np.full(2, 31.5)])
        picture = cv2.warpAffine(portrait(seed), to, (240, 180), picture, borderMode=cv2.BORDER_TRANSPARENT)
    return Frame(0, time_s, (light * picture).clip(0, 255).round().astype(np.uint8))


def look(box, seed, **how):
    middle = np.array([box[0] + (box[2] - 1) / 2, box[1] + (box[2] - 1) / 2])
    return look_of(Similarity(middle, box[2] / found_again.FACE, how.get("turn", 0.0)).read(shown((box, seed), **how)))


def seen(box, turn=0.0):
    x, y = box[0] + box[2] / 2, box[1] + box[2] / 2
    along = 10 * np.array([np.cos(turn), np.sin(turn)])
    return Found(box, eyes=((x - along[0], y - along[1]), (x + along[0], y + along[1])))


OWN = (look(BOX, 1),)


def test_a_look_has_no_mean_and_unit_norm_and_does_not_know_the_light():
    one = look(BOX, 1)
    assert one.shape == (SIDE**2,) and one.sum() == pytest.approx(0, abs=1e-9) and one @ one == pytest.approx(1)
    assert one @ look(BOX, 1, light=0.6) > 0.99
    flat = look_of(Frame(0, 0.0, np.full((160, 160, 3), 90, np.uint8)))
    np.testing.assert_array_equal(flat, 0)


def test_a_person_is_alike_at_another_place_and_size_and_roll_and_another_is_not():
    assert likeness(OWN, look(ELSEWHERE, 1, turn=0.5)) > 0.9
    assert all(likeness(OWN, look(ELSEWHERE, seed)) < NEW for seed in range(2, 12))


def test_the_last_looks_are_kept_and_that_of_the_start_stays():
    looks = OWN
    for seed in range(2, 12):
        looks = kept(looks, look(BOX, seed))
    assert len(looks) == MAX_LOOKS and looks[0] is OWN[0]
    assert looks[-1] @ look(BOX, 11) == pytest.approx(1)


def test_of_several_faces_the_likeliest_is_the_target_and_time_runs_from_its_first_sighting():
    frame = shown((BOX, 5), (ELSEWHERE, 1), time_s=2.0, turn=0.3)
    first = sighted(None, [seen(BOX, 0.3), seen(ELSEWHERE, 0.3)], frame, OWN)
    assert first is not None and first.box == ELSEWHERE and first.since == 2.0 and first.roll == pytest.approx(0.3)
    near = (ELSEWHERE[0] + 20, *ELSEWHERE[1:])
    later = sighted(first, [seen(near)], shown((near, 1), time_s=2.4), OWN)
    assert later is not None and later.box == near and later.since == 2.0
    away = sighted(later, [seen(BOX)], shown((BOX, 1), time_s=2.8), OWN)
    assert away is not None and away.since == 2.8, "another face: time begins anew"


def test_somebody_else_is_no_sighting():
    strangers = [seed for seed in range(2, 40) if likeness(OWN, look(BOX, seed)) < OTHER]
    assert len(strangers) > 10
    for seed in strangers:
        assert sighted(None, [seen(BOX)], shown((BOX, seed)), OWN) is None
    assert sighted(None, [], shown(), OWN) is None


@pytest.mark.parametrize("embedding", [0, 128])
def test_after_a_cut_the_likeliest_face_is_the_target_if_it_is_likely(monkeypatch, embedding):
    def place(box):
        return Similarity(np.array([box[0] + (box[2] - 1) / 2, box[1] + (box[2] - 1) / 2]), box[2] / found_again.FACE)

    monkeypatch.setattr(people_looks, "embedded", lambda chip: np.full(embedding, chip.mean() / 1000))
    known = [Picture.of(shown((BOX, 1)), place(BOX)._replace(scale=BOX[2]))]
    monkeypatch.setattr(
        found_again, "same_person", lambda each: 5 * np.array([one.face[0] @ each[0].face[0] for one in each])[None]
    )
    frame = shown((BOX, 5), (ELSEWHERE, 1))
    assert recognised(known, [place(BOX), place(ELSEWHERE)], frame) == 1
    assert recognised(known, [place(BOX)], frame) is None and recognised(known, [], frame) is None
    assert recognised(known, [place(BOX)], frame, least=-20) == 0
