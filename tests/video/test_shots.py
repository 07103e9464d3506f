"""Cuts and dissolves: found where they are, and nowhere else."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame, Planes
from facetrack_cli.trackers.face import stabilized
from facetrack_cli.video import shots
from facetrack_cli.video.shots import Cut, Passing, find_cuts, shots_of, small

W, H = 96, 54


def scene(seed):
    """A picture with large and small shapes."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.integers(0, 256, (6, 10, 3), dtype=np.uint8), (2 * W, 2 * H), interpolation=cv2.INTER_CUBIC)
    fine = cv2.resize(rng.integers(0, 90, (54, 96, 3), dtype=np.uint8), (2 * W, 2 * H), interpolation=cv2.INTER_LINEAR)
    return np.clip(coarse * 0.7 + fine, 0, 255).astype(np.float32)


def still(seed, count, noise=1.0):
    rng, picture = np.random.default_rng(seed + 100), scene(seed)[:H, :W]
    return [picture + rng.normal(0, noise, picture.shape) for _ in range(count)]


def found(pictures):
    return list(find_cuts(Frame(i, i / 25, np.clip(one, 0, 255).astype(np.uint8)) for i, one in enumerate(pictures)))


def mixed(a, b, frames):
    """The end of `a` blended with the beginning of `b`."""
    shares = (np.arange(frames) + 1) / (frames + 1)
    between = [(1 - k) * x + k * y for k, x, y in zip(shares, a[-frames:], b[:frames], strict=True)]
    return [*a[:-frames], *between, *b[frames:]]


def test_a_cut_is_found_in_its_frame():
    assert found(still(1, 30) + still(2, 40) + still(3, 1)) == [Cut(30, 30, 29), Cut(70, 70, 69)]
    assert found(still(1, 1)) == found([]) == []
    assert len(found(still(1, 30) + still(7, 20) + still(1, 30))) == 2, "a hand is before the lens for less"


@pytest.mark.parametrize("frames", [8, 12, 24])
def test_a_dissolve_is_one_and_its_frames_show_both(frames):
    [cut] = found(mixed(still(1, 60), still(2, 60), frames))
    assert cut.last >= cut.first and abs(cut.frame - (60 - frames / 2)) <= 3
    assert cut.first >= 60 - frames - 8 and cut.last <= 66


def test_a_fade_by_way_of_black_is_one():
    dark = [np.zeros((H, W, 3), np.float32)] * 24
    assert len(found(mixed(mixed(still(1, 60), dark, 10), still(2, 60), 10))) == 1


def flash(lasts):
    return [one * 0.4 + 160 if 30 <= t < 30 + lasts else one for t, one in enumerate(still(1, 60))]


def pan(speed):
    wide, moves = scene(4), range(int(W / speed))
    return [cv2.warpAffine(wide, np.array([[1, 0, -speed * t], [0, 1, 0.0]]), (W, H)) for t in moves]


NO_CUT = {
    **{f"a hand of {n} frames": (lambda n: still(1, 30) + still(7, n) + still(1, 30), n) for n in (6, 11)},
    **{f"a flash of {n} frames": (flash, n) for n in (1, 2, 3)},
    "a light that is switched": (lambda by: [one * (1 if t < 30 else by) for t, one in enumerate(still(1, 60))], 0.5),
    **{f"a pan of {speed} pixels a frame": (pan, speed) for speed in (0.5, 2.0)},
}


@pytest.mark.parametrize(("make", "how"), NO_CUT.values(), ids=NO_CUT)
def test_what_is_no_cut(make, how):
    assert found(make(how)) == []


def test_long_clips_are_decided_in_blocks_with_the_same_result(monkeypatch):
    pictures = mixed(still(1, 90), still(2, 90), 12) + still(3, 60) + still(4, 70)
    whole = found(pictures)
    assert len(whole) == 3
    monkeypatch.setattr(shots, "_BLOCK", 50)
    assert found(pictures) == whole


def test_planes_of_a_decoder_give_the_same_small_image():
    picture = np.clip(scene(5)[:H, :W], 0, 255).astype(np.uint8)
    planes = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420)
    one, other = (small(Frame(0, 0.0, image)).astype(float) for image in (picture, planes))
    assert one.shape == (18, 32, 3)
    full = (other[..., 0] - 16) * 255 / 219  # a decoder's black is 16
    assert np.abs(one[..., 0] - full).mean() < 2


def test_shots_lie_between_cuts():
    first, second = shots_of([Cut(30, 25, 35)], 0, 90)
    assert first == (0, 30, 0, 25) and second == (30, 90, 36, 90)
    assert [first.is_clear(t) for t in (0, 24, 25)] == [True, True, False]
    assert not second.is_clear(35) and second.is_clear(36)
    assert shots_of([Cut(5, 5, 4)], 10, None) == [(10, None, 10, None)]


def passing(pictures):
    """What is known with which frame: (frame, event)."""
    frames = [Frame(i, i / 25, np.clip(one, 0, 255).astype(np.uint8)) for i, one in enumerate(pictures)]
    passed, events = Passing((small(frames[0]),)), []
    for frame in frames[1:]:
        passed, event = passed.after(small(frame))
        events += [(frame.index, event)] if event else []
    return events


@pytest.mark.parametrize("size, beside", [((480, 480), 32), ((322, 92), 0), ((1278, 718), 2), ((320, 180), 0)])
def test_one_kernel_shrinks_planes_as_opencv_does(size, beside):
    def plane(w, h):
        return np.random.default_rng(w).integers(0, 256, h * (w + beside), np.uint8).reshape(h, -1)[:, :w]

    half = size[0] // 2, size[1] // 2
    frame = Frame(0, 0.0, Planes(plane(*size), plane(*half), plane(*half)))
    np.testing.assert_array_equal(stabilized.shrunk(frame), small(frame))


def test_cuts_are_found_as_they_come_and_confirmed_by_the_frames_after_them():
    cuts = passing(still(1, 30) + still(2, 40) + still(3, 10))
    assert cuts == [(30, "maybe"), (33, "cut"), (70, "maybe"), (73, "cut")]
    flash = [scene(7)] * 2
    assert passing(still(1, 30) + flash + still(1, 30)) == [(30, "maybe"), (32, "maybe"), (35, "none")], "a flash"
    assert passing([one * 1.2 if i == 10 else one for i, one in enumerate(still(1, 30))]) == [], "a lamp"
    [(at, event)] = passing(mixed(still(1, 60), still(2, 60), 24))
    assert event == "cut" and 60 < at < 84, "a dissolve, after its end in frame 60"
    wide = np.hstack([scene(1), scene(2)])
    assert passing([wide[:H, 2 * i : 2 * i + W] for i in range(90)]) == [], "a pan"


@pytest.mark.parametrize("frames", [8, 16, 30])
def test_a_dissolve_that_has_ended_in_time_is_seen_among_those_that_end_then(frames):
    pictures = np.clip(mixed(still(1, 60), still(2, 60), frames)[:84], 0, 255).astype(np.uint8)
    images = shots._flat([small(Frame(i, 0.0, picture)) for i, picture in enumerate(pictures)])
    every = shots._dissolves(images)
    assert len(every) == 1
    for start in range(-6, len(images) - 12):
        lasts = range(start, start + 12)
        there = {last for _, _, last in shots._dissolves(images, lasts)}
        assert there <= set(lasts) and (there or every[0][2] not in lasts)
