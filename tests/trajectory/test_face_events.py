"""Events of a face: signals that are made up, noise that is none, the sample clip."""

import math
from itertools import pairwise

import numpy as np
import pytest

import facetrack_cli as facetrack
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.trajectory.analysis.face_events import events_of
from facetrack_cli.trajectory.analysis.measures import Measured
from tests.support.face_shape import moving_face
from tests.support.samples import FOLDER


def events(std=0.01, rate=25.0, **signals):
    """(name, frame, last) of the events of signals (T,), by time, and their probabilities."""
    found = {}
    for name, value in signals.items():
        t = np.arange(len(value))
        found[name] = Measured(name, "", t, t / rate, np.asarray(value, float), np.broadcast_to(std, len(value)))
    all_ = sorted(event for kind in events_of("face", found).values() for event in kind)
    return [(one.name, one.frame, one.last) for one in all_], [one.probability for one in all_]


def bumps(frames, starts, length, height=0.4, rest=0.1):
    value = np.full(frames, rest)
    for start in starts:
        value[start : start + length] += height
    return value


def noise(seed, frames, kept=0.0):
    """Noise of unit variance, of which a share stays from frame to frame."""
    rng = np.random.default_rng(seed)
    value, steps = np.empty(frames), rng.normal(size=frames)
    value[0] = steps[0]
    for t in range(1, frames):
        value[t] = kept * value[t - 1] + math.sqrt(1 - kept**2) * steps[t]
    return value


def test_a_mouth_opens_and_closes_where_it_does():
    value = bumps(200, (50, 120), 20) + 0.01 * noise(0, 200)
    found, chance = events(mouth_opening=value)
    assert found == [
        ("mouth_opens", 50, 69),
        ("mouth_closes", 70, 69),
        ("mouth_opens", 120, 139),
        ("mouth_closes", 140, 139),
    ]
    assert min(chance) > 0.999


def test_the_probability_is_that_of_both_sides_of_the_threshold():
    """Levels 0 and 1, so that the threshold is 1/2: by a spread of 1/4 each side is two deviations away from it."""
    value = bumps(100, (40,), 30, height=1.0, rest=0.0)
    found, chance = events(std=0.25, mouth_opening=value)
    side = 0.5 * math.erfc(-2 / math.sqrt(2))
    assert found == [("mouth_opens", 40, 69), ("mouth_closes", 70, 69)] and chance == pytest.approx([side**2] * 2)
    blink = bumps(100, (40,), 5, height=-1.0, rest=1.0)
    assert events(std=0.25, eye_opening=blink) == ([("blink", 40, 44)], pytest.approx([side**3]))
    assert events(std=0.4, mouth_opening=value) == ([], []), "levels that the spread does not tell apart"


def test_inner_lips_count_before_outer_ones():
    assert events(lips_apart=np.full(100, 0.0), mouth_opening=bumps(100, (40,), 20))[0] == []
    assert len(events(lips_apart=bumps(100, (40,), 20), mouth_opening=np.full(100, 0.3))[0]) == 2


def test_a_state_that_the_clip_or_a_pause_cuts_off_makes_no_event():
    value = bumps(100, (0, 60), 40) + 0.002 * noise(1, 100)
    assert events(mouth_opening=value)[0] == [("mouth_closes", 40, 39), ("mouth_opens", 60, 99)]
    paused = bumps(100, (40,), 20) + 0.002 * noise(1, 100)
    paused[36:44] = np.nan
    assert events(mouth_opening=paused)[0] == [("mouth_closes", 60, 59)]
    paused[[36, 37, 38, 39]], paused[[40, 41, 42, 43]] = 0.1, 0.5
    paused[45] = np.nan  # a single frame does not matter
    assert events(mouth_opening=paused)[0] == [("mouth_opens", 40, 59), ("mouth_closes", 60, 59)]


def test_blinks_are_short_and_found_while_the_eyes_open_and_narrow():
    slow = 0.05 * np.sin(np.arange(400) / 60)
    value = 0.3 + slow + bumps(400, (50, 130, 131, 300), 4, height=-0.25, rest=0.0) + 0.01 * noise(2, 400)
    assert events(eye_opening=np.maximum(value, 0))[0] == [("blink", 50, 53), ("blink", 130, 134), ("blink", 300, 303)]
    asleep = bumps(400, (100,), 100, height=-0.25, rest=0.3) + 0.01 * noise(3, 400)
    assert events(eye_opening=asleep)[0] == []


def test_a_nod_goes_down_and_back_and_needs_the_eyes():
    t = np.arange(300)
    pitch = 5.0 + noise(4, 300, 0.8)
    for start in (60, 150):
        pitch += 15 * np.where((t >= start) & (t < start + 12), np.sin(np.pi * (t - start) / 12), 0.0)
    pitch += np.where(t >= 220, 20.0, 0.0)  # and once it stays down
    found, chance = events(std=1.0, pitch=pitch, eye_opening=np.full(300, 0.3))
    assert [name for name, *_ in found] == ["nod", "nod"] and min(chance) > 0.9
    assert all(abs(frame - start) <= 4 for (_, frame, _), start in zip(found, (60, 150), strict=True))
    assert events(std=1.0, pitch=pitch)[0] == []


@pytest.mark.one_in(3)
@pytest.mark.parametrize("kept", [0.0, 0.5, 0.9, 0.98])
@pytest.mark.parametrize("frames", [100, 500])
def test_noise_that_the_spread_explains_makes_no_event(frames, kept):
    for name in ("mouth_opening", "eye_opening", "pitch"):
        clips = [{name: 0.1 * noise(seed, frames, kept), "eye_opening": np.full(frames, 0.3)} for seed in range(40)]
        clips = [{"eye_opening": one["eye_opening"], **one} if name == "pitch" else {name: one[name]} for one in clips]
        some = sum(bool(events(std=0.1, **one)[0]) for one in clips)
        assert some <= 2, f"{name}: {some} of {len(clips)}"


@pytest.mark.parametrize("value", [np.full(50, 0.3), np.linspace(0.3, 0.31, 50), np.full(50, np.nan), np.zeros(4)])
def test_a_mouth_that_does_not_move_makes_no_event(value):
    assert events(mouth_opening=value) == ([], [])


def test_what_is_larger_by_a_factor_gives_the_same_events():
    value = bumps(300, (50, 120, 200), 20) + 0.02 * noise(5, 300)
    one, other = events(std=0.03, mouth_opening=value), events(std=30.0, mouth_opening=1000 * value - 7)
    assert one[0] == other[0] and one[1] == pytest.approx(other[1])


def test_a_wider_spread_makes_an_event_less_likely():
    value = bumps(200, (50,), 20) + 0.01 * noise(6, 200)
    chances = [events(std=std, mouth_opening=value)[1][0] for std in (0.02, 0.06, 0.09, 0.12)]
    assert all(one > other for one, other in pairwise(chances))


def test_a_whole_face_tells_its_events():
    t = np.arange(250)
    moves = {
        "open": bumps(250, (100,), 40, 0.3, 0.0),
        "shut": (t % 80 >= 40) & (t % 80 < 44),
        "smile": 0.05 * (t > 180),
    }
    table = moving_face(250, noise=0.5, std=0.5, **moves)
    found = [(one.target, one.name, one.frame, one.last) for one in table.events]
    blinks = [("face", "blink", k, k + 3) for k in (40, 120, 200)]
    mouth = [("face", "mouth_opens", 100, 139), ("face", "mouth_closes", 140, 139)]
    assert found == sorted([*blinks, *mouth], key=lambda one: one[2])
    assert [one.time_s for one in table.events] == sorted(one.frame / 25 for one in table.events)


def test_the_mouth_of_the_sample_clip_opens_once_wide():
    """Frames 105 to 137 of the truth; speech before it moves the lips by half of that."""
    table = facetrack.track_video(FOLDER / "expressions.mp4", load_recipe("face", {"filter.particles": 20}), stop=150)
    sure = [one for one in table.events if one.probability > 0.9]
    assert [one.name for one in sure] == ["mouth_opens", "mouth_closes"]
    assert 100 <= sure[0].frame <= 112 and 118 <= sure[1].frame <= 140
