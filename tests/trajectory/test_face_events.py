"""Events of a face: the model against a plain enumeration, signals that are made up, noise and doubt that are none."""

import math

import numpy as np
import pytest

from facetrack_cli.trajectory.face_events import Chain, events_of
from facetrack_cli.trajectory.measures import SHARE, Measured
from tests.support.face_shape import moving_face
from tests.twins import hidden_markov

STD = 0.05


def measured(name, value, std=STD, rate=25.0, doubt=None):
    t, value = np.arange(len(value)), np.asarray(value, float)
    std = np.broadcast_to(np.asarray(std, float), len(value))
    doubt = SHARE * std if doubt is None else np.broadcast_to(doubt, len(value))
    return Measured(name, "", t, t / rate, value, std, doubt)


def events(std=STD, rate=25.0, doubt=None, **signals):
    """The events of signals (T,), by time."""
    found = {name: measured(name, value, std, rate, doubt) for name, value in signals.items()}
    return sorted(event for kind in events_of("face", found).values() for event in kind)


def spans(found):
    return [(one.value, one.first_frame, one.last_frame) for one in found]


def bumps(frames, starts, length, height=0.3, rest=0.25):
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


@pytest.mark.parametrize("states", [2, 3])
def test_posteriors_and_visits_are_those_of_all_paths_together(states):
    rng = np.random.default_rng(states)
    time_s = np.array([0.0, 0.04, 0.08, 0.24, 0.28, 0.32])  # with a pause
    chain = Chain.of(rng.normal(0, 2, (6, states)), time_s, [0.3, 0.1, 0.2][:states])
    assert np.exp(chain.share).sum() == pytest.approx(1) and np.allclose(np.exp(chain.move).sum(axis=2), 1)
    found = hidden_markov.paths(chain.log_p, chain.share, chain.move)
    for t in range(6):
        for state in range(states):
            assert chain.posterior[t, state] == pytest.approx(hidden_markov.posterior(found, t, state))
    for first, stop in ((0, 2), (1, 4), (2, 6), (0, 6)):
        for wanted in ((states - 1,), (0, states - 1), tuple(range(states))):
            assert chain.visits(first, stop, wanted) == pytest.approx(hidden_markov.visits(found, first, stop, wanted))


def test_a_pause_makes_a_state_less_sure_and_a_very_long_one_says_nothing():
    chains = [Chain.of(np.array([[-50.0, 0], [0, 0]]), np.array([0, gap]), [3.0, 1.0]) for gap in (0.04, 1.0, 1000.0)]
    # one step of the usual time each; the twin of a long one is many short ones
    fine = Chain.of(np.array([[-50.0, 0], *[[0, 0]] * 2000]), np.arange(2001) * 0.04, [3.0, 1.0])
    assert chains[0].posterior[1, 1] > 0.9
    assert fine.posterior[-1] == pytest.approx(np.exp(fine.share), abs=1e-6)
    assert np.exp(fine.share) == pytest.approx([0.75, 0.25], abs=0.01)


def test_a_mouth_is_open_from_where_it_opens_to_where_it_shuts():
    value = bumps(200, (50, 120), 20) + 0.005 * noise(0, 200)
    value[57] += 0.1
    first, second = events(mouth_opening=value)
    assert spans([first, second]) == [("open", 50, 69), ("open", 120, 139)]
    assert (first.tier, first.target) == ("mouth", "face") and min(first.probability, second.probability) > 0.99
    assert (first.begin_s, first.peak_s, first.end_s) == pytest.approx((2.0, 57 / 25, 70 / 25))


def test_a_mouth_that_is_open_at_the_ends_of_the_clip_or_a_pause_is_open_there():
    value = bumps(200, (0, 160), 40) + 0.002 * noise(1, 200)
    assert spans(events(mouth_opening=value)) == [("open", 0, 39), ("open", 160, 199)]
    paused = bumps(200, (80,), 40) + 0.002 * noise(1, 200)
    paused[90:100] = np.nan
    found = events(mouth_opening=paused)
    assert [one.value for one in found] == ["open", "open"], "nothing is said of what lies between"
    assert found[0].last_frame < 90 and found[1].first_frame >= 100


def test_frames_beside_lost_ones_say_nothing():
    value = np.full(200, 0.25)
    value[100:110], value[95:100], value[110:115] = np.nan, 0.6, 0.6
    assert events(mouth_opening=value) == []


def test_what_the_spread_explains_is_no_event():
    value = bumps(200, (50,), 20, height=0.12) + 0.005 * noise(6, 200)
    assert spans(events(mouth_opening=value)) == [("open", 50, 69)]
    doubtful = np.where((np.arange(200) >= 45) & (np.arange(200) < 75), 0.3, STD)
    assert events(std=doubtful, mouth_opening=value) == [], "a spread that is larger just then"
    assert events(doubt=0.12, mouth_opening=value) == [], "a head that moves"


def test_blinks_are_short_are_found_while_eyes_narrow_and_longer_ones_are_shut_eyes():
    slow = 0.05 * np.sin(np.arange(400) / 60)
    value = np.maximum(0.3 + slow + bumps(400, (50, 130, 300), 4, height=-0.25, rest=0.0) + 0.01 * noise(2, 400), 0.02)
    assert spans(events(eye_opening=value)) == [("blink", 50, 53), ("blink", 130, 133), ("blink", 300, 303)]
    asleep = bumps(400, (100,), 20, height=-0.25, rest=0.3) + 0.01 * noise(3, 400)
    assert spans(events(eye_opening=asleep)) == [("shut", 100, 119)]


def test_one_eye_that_shuts_is_a_wink():
    value = bumps(300, (100,), 10, height=0.25, rest=0.0) + bumps(300, (200,), 10, height=-0.25, rest=0.0)
    found = events(std=0.03, eyes_differ=value + 0.01 * noise(3, 300))
    assert [(one.tier, one.first_frame) for one in found] == [("wink_left", 100), ("wink_right", 200)]


def test_a_smile_is_held():
    value = bumps(300, (100,), 40, height=0.2, rest=0.8) + bumps(300, (200,), 4, height=0.2, rest=0.0)
    [(name, first, last)] = spans(events(mouth_width=value + 0.01 * noise(3, 300)))
    assert (name, first, last) == ("smile", pytest.approx(100, abs=2), pytest.approx(139, abs=2))


def test_a_nod_goes_down_and_back_and_needs_the_eyes_and_a_shake_turns_both_ways():
    t = np.arange(400)
    pitch = 5.0 + 0.5 * noise(4, 400, 0.8)
    for start in (60, 150):
        pitch += 20 * np.where((t >= start) & (t < start + 12), np.sin(np.pi * (t - start) / 12), 0.0)
    found = events(std=2.0, pitch=pitch, eye_opening=np.full(400, 0.3))
    assert [one.value for one in found] == ["nod", "nod"]
    assert all(abs(one.first_frame - start) <= 4 for one, start in zip(found, (60, 150), strict=True))
    assert events(std=2.0, pitch=pitch) == []
    turn = np.where((t >= 100) & (t < 124), 25 * np.sin(2 * np.pi * (t - 100) / 24), 0.0)
    glance = np.where((t >= 250) & (t < 262), 25 * np.sin(np.pi * (t - 250) / 12), 0.0)
    [shake] = events(std=2.0, yaw=turn + glance + 0.5 * noise(5, 400))
    assert shake.value == "shake" and abs(shake.first_frame - 100) <= 4 and abs(shake.last_frame - 123) <= 4


def test_a_mouth_talks_where_it_swings_quickly():
    t = np.arange(250)
    talks = 0.05 * np.sin(2 * np.pi * t / 8) * ((t >= 75) & (t < 175))
    table = moving_face(250, open=0.1 + talks)
    assert [one.unit for one in (table.measures["face"]["talking"],)] == ["probability"]
    [speech] = [one for one in table.events if one.tier == "speech"]
    assert speech.value == "talks" and abs(speech.first_frame - 75) < 20 and abs(speech.last_frame - 174) < 20
    yawns = moving_face(250, open=0.4 * ((t >= 75) & (t < 175)))
    assert [one.tier for one in yawns.events] == ["mouth"]


@pytest.mark.parametrize(("frames", "kept", "seeds"), [(100, 0.0, 20), (500, 0.5, 8)])
def test_noise_makes_hardly_an_event(frames, kept, seeds):
    sizes = {"mouth_opening": 0.015, "mouth_width": 0.03, "eye_opening": 0.03, "pitch": 3.0, "yaw": 3.0}
    eyes = {"eye_opening": np.full(frames, 0.3)}
    for name, size in sizes.items():
        values = ({**eyes, name: 0.3 + size * noise(seed, frames, kept)} for seed in range(seeds))
        assert sum(len(events(std=2 * size, **value)) for value in values) <= seeds / 10, name


@pytest.mark.parametrize(
    "value", [np.full(50, 0.3), np.linspace(0.3, 0.31, 50), np.full(50, np.nan), np.zeros(4), [0.3]]
)
def test_a_mouth_that_does_not_move_makes_no_event(value):
    assert [*events(mouth_opening=value), *events(eye_opening=value), *events(yaw=value)] == []


@pytest.mark.parametrize("low", [-0.6, -1.5])
def test_rows_that_are_far_off_do_not_open_the_mouth_of_all_others(low):
    rng = np.random.default_rng(1)
    value, off = 0.24 + 0.01 * noise(3, 1800), rng.random(1800) < 0.06  # as where something goes by
    value[off] += low * rng.random(off.sum())
    found = spans(events(std=0.02, doubt=0.01, mouth_opening=value))
    assert all(last - first < 10 for _, first, last in found)


def test_each_shot_of_a_film_has_its_own_rest():
    value = np.concatenate([np.full(100, 0.2), bumps(100, (50,), 20, rest=0.5)])
    film, later = measured("mouth_opening", value), np.arange(200) >= 100
    film = film._replace(frame=film.frame + 400 * later, time_s=film.time_s + 16 * later)
    assert spans(events_of("face", {"mouth_opening": film})["mouth"]) == [("open", 550, 569)]
