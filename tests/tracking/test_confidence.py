"""Confidence and status from the distances of windows alone."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame
from facetrack_cli.engine import confidence as judging
from facetrack_cli.recipe.model import ConfidenceSettings

X0 = np.array([[50.0, 50.0], [80.0, 50.0]])
WINDOWS = np.array([[10.0, 10.0], [20.0, 12.0]])


class Ring:
    """A likelihood whose windows near the parts are off by 0.1, those beside by 0.4 and 0.2, and a blank by 0.3."""

    def distances(self, learned, frame, x):
        if np.all(frame.bgr == frame.bgr[0, 0]):
            return np.full(x.shape[:2], 0.3)
        # how far off, in windows: the same in every direction
        off = np.sqrt(np.sum(((x - X0) / WINDOWS) ** 2, axis=2))
        assert np.allclose(off, 1.0) or np.allclose(off, 1 / 13)
        return np.full(x.shape[:2], [0.4, 0.2]) if off[0, 0] > 0.5 else np.full(x.shape[:2], 0.1)


def confidence_of(**options):
    """The functions of confidence.py with these settings."""
    settings = ConfidenceSettings(**options)
    return SimpleNamespace(begin=partial(judging.begin, settings), judge=partial(judging.judge, settings))


def begin(**options):
    confidence = confidence_of(**options)
    frame = Frame(0, 0.0, np.arange(300, dtype=np.uint8).reshape(10, 10, 3))
    return confidence, confidence.begin(Ring(), None, frame, X0, WINDOWS)


def test_the_first_frame_is_init_and_sure_and_sets_the_levels():
    _, judgement = begin()
    assert judgement.status == ("init", "init")
    np.testing.assert_array_equal(judgement.confidence, 1.0)
    np.testing.assert_allclose(judgement.good, 0.1)
    # the first by the blank window, the second by the ring
    np.testing.assert_allclose(judgement.bad, [0.3, 0.2])


def test_confidence_falls_from_what_was_good_to_what_is_not_the_part():
    confidence, judgement = begin()
    for distance, expected in ((0.1, 1.0), (0.05, 1.0)):
        seen = confidence.judge(judgement, np.array([distance, distance]))
        np.testing.assert_allclose(seen.confidence, expected)
    seen = confidence.judge(judgement, np.array([0.2, 0.15]))
    np.testing.assert_allclose(seen.confidence, 0.5)
    seen = confidence.judge(judgement, np.array([0.3, 0.3]))
    np.testing.assert_allclose(seen.confidence, 0.0)


def test_a_lower_quantile_of_the_windows_beside_is_stricter():
    class Uneven(Ring):
        def distances(self, learned, frame, x):
            seen = super().distances(learned, frame, x)
            return seen * np.linspace(0.5, 1.5, len(x))[:, None] if len(x) > 1 else seen

    frame = Frame(0, 0.0, np.arange(300, dtype=np.uint8).reshape(10, 10, 3))
    low, median = (confidence_of(beside=q).begin(Uneven(), None, frame, X0, WINDOWS).bad for q in (0.125, 0.5))
    assert np.all(low < median)


def test_a_part_that_looks_like_all_around_it_is_never_sure():
    confidence, judgement = begin()
    same = replace(judgement, good=judgement.bad)
    np.testing.assert_array_equal(confidence.judge(same, np.zeros(2)).confidence, 0.0)


def test_lost_after_patience_and_tracked_at_once():
    confidence, judgement = begin(lost_below=0.3, patience=3)
    judgement = confidence.judge(judgement, np.array([0.1, 0.1]))
    seen = []
    for distance in (0.5, 0.5, 0.5, 0.5, 0.1):
        judgement = confidence.judge(judgement, np.array([distance, 0.1]))
        seen.append(judgement.status)
    assert seen == [("tracked",) * 2] * 2 + [("lost", "tracked")] * 2 + [("tracked", "tracked")]


def test_what_is_good_is_not_learned_from_what_is_bad():
    confidence, judgement = begin()
    judgement = confidence.judge(judgement, np.array([0.1, 0.1]))
    for _ in range(500):
        judgement = confidence.judge(judgement, np.array([0.5, 0.12]))
    np.testing.assert_allclose(judgement.good, [0.1, 0.12], atol=1e-3)


@pytest.mark.parametrize("lost_below", [0.0, 1.0])
@given(st.lists(st.floats(0, 5), min_size=1, max_size=20))
def test_any_distances_give_a_confidence_between_0_and_1(lost_below, distances):
    confidence, judgement = begin(lost_below=lost_below)
    for d in distances:
        judgement = confidence.judge(judgement, np.array([d, d / 2]))
        assert np.all((judgement.confidence >= 0) & (judgement.confidence <= 1))
        assert np.isfinite(judgement.good).all()
        if lost_below == 0.0:
            assert set(judgement.status) == {"tracked"}


def test_without_a_memory_what_is_good_stays_what_the_first_frame_said():
    def after(**options):
        confidence, judgement = begin(**options)
        for _ in range(40):
            judgement = confidence.judge(judgement, np.array([0.15, 0.12]))
        return judgement

    np.testing.assert_allclose(after(memory=None).good, 0.1)
    np.testing.assert_allclose(after(memory=5).good, [0.15, 0.12], rtol=1e-3)
    assert np.all(after(memory=None).confidence < after(memory=5).confidence)
