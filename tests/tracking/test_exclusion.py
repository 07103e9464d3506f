"""Exclusion: what one target explains counts for less for another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.engine.loop import Footprint
from facetrack_cli.trackers.skin.cloud import log_weights
from facetrack_cli.trackers.skin.settings import ExclusionSettings

HEAD = Footprint(np.array([50.0, 40.0]), np.array([10.0, 20.0]))
number = st.floats(-1e7, 1e7)


def at(exclusion, *places, footprints=(HEAD,)):
    return log_weights(exclusion, np.array(places, float)[:, None], footprints)[:, 0]


def test_in_the_middle_of_another_target_the_strength_is_lost_and_far_from_it_nothing():
    middle, far = np.exp(at(ExclusionSettings(strength=0.9, reach=1.0), (50, 40), (120, 40)))
    assert middle == pytest.approx(0.1)
    assert far == pytest.approx(1.0)


def test_its_outline_is_an_ellipse_that_reach_widens():
    wide, high = at(ExclusionSettings(strength=0.9, reach=1.0), (60, 40), (50, 60))
    assert wide == pytest.approx(high) == pytest.approx(np.log(1 - 0.9 * np.exp(-0.5)))
    assert at(ExclusionSettings(strength=0.9, reach=2.0), (70, 40)) == pytest.approx(wide)


def test_what_is_inside_is_forbidden_nearly_evenly_and_what_is_outside_nearly_free():
    inside, outside = np.exp(at(ExclusionSettings(strength=1.0, reach=1.0), (55, 40), (66, 40)))
    assert inside < 0.04 and outside > 0.95


def test_several_targets_add_up():
    other = Footprint(np.array([58.0, 40.0]), np.array([10.0, 20.0]))
    both = at(ExclusionSettings(strength=0.5, reach=1.0), (54, 40), footprints=(HEAD, other))
    assert both == pytest.approx(2 * at(ExclusionSettings(strength=0.5, reach=1.0), (54, 40)))


def test_a_target_shrunk_to_a_point_still_forbids_its_pixel():
    point = Footprint(np.array([5.0, 5.0]), np.zeros(2))
    there, beside = np.exp(at(ExclusionSettings(strength=0.9, reach=1.0), (5, 5), (8, 5), footprints=(point,)))
    assert there == pytest.approx(0.1) and beside == pytest.approx(1.0)


@given(strength=st.floats(0, 1), reach=st.floats(0.01, 10), x=number, y=number)
def test_weights_are_finite_and_between_what_is_left_and_all(strength, reach, x, y):
    found = at(ExclusionSettings(strength=strength, reach=reach), (x, y))
    assert np.isfinite(found).all()
    assert np.log(max(1 - strength, 1e-12)) - 1e-9 <= found[0] <= 0


def test_no_other_target_changes_nothing():
    assert at(ExclusionSettings(strength=0.9, reach=1.0), (1, 2), (50, 40), footprints=()).tolist() == [0, 0]


def test_what_is_wholly_forbidden_is_still_a_number():
    assert np.isfinite(at(ExclusionSettings(strength=1.0, reach=1.0), (50, 40))).all()
