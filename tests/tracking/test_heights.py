"""How high peaks are: running moments against sums written out, and the evidence against densities written out."""

import math

import numpy as np
import pytest

from facetrack_cli.trackers.box.correlation_filter import Heights, ResponseView, Usual, evidence
from facetrack_cli.trackers.box.features import UPSAMPLED


def log_density(x, of):
    """Of Student's distribution with 3 degrees of freedom, at x, but for a constant."""
    return -2 * math.log(1 + ((x - of.mean) / of.std) ** 2 / 3) - math.log(of.std)


SEEN, OTHER, BOUND = Heights(0.6, 0.09, 40.0), Heights(0.15, 0.05, 10.0), 4.0


@pytest.mark.parametrize("height", [0.1, 0.2, 0.31, 0.37, 0.5, 0.7])
def test_evidence_is_the_log_ratio_of_two_densities_of_student(height):
    # flat beyond the mean on the side away from the other density
    ratio = log_density(min(height, SEEN.mean), SEEN) - log_density(max(height, OTHER.mean), OTHER)
    assert evidence(SEEN, OTHER, height, 100.0) == pytest.approx(ratio)
    assert evidence(SEEN, OTHER, height, BOUND) == pytest.approx(np.clip(ratio, -BOUND, BOUND))


def test_running_moments_are_those_of_the_peaks():
    rng = np.random.default_rng(0)
    peaks, learned = 0.5 + 0.08 * rng.standard_normal(2000), Heights(0.8, 0.1, 10.0)
    for peak in peaks:
        learned = learned.learn(float(peak), 1.0)
    assert learned.mean == pytest.approx(0.5, abs=0.04) and learned.std == pytest.approx(0.08, rel=0.25)
    assert learned.learn(0.1, 0.0) == learned, "nothing is learned of a target that is hidden"


def test_few_bad_frames_do_not_move_the_mean():
    learned = SEEN.learn(0.0, 1.0)
    assert SEEN.mean - learned.mean == pytest.approx(2 * SEEN.std / 41)


def test_the_standard_deviation_is_bounded_by_shares_of_the_mean():
    assert Heights(0.5, 0.0, 50).spread == pytest.approx(0.05) and Heights(0.5, 9.0, 50).spread == pytest.approx(0.1)
    assert Heights(0.0, 0.0, 50).spread > 0


def test_peaks_elsewhere_are_learned_where_the_target_is_hidden():
    usual, peaks = Usual(SEEN, SEEN, OTHER, OTHER), ((0.2, 0.2), 0.3)
    hidden, shown = usual.learn(*peaks, 0.0), usual.learn(*peaks, 1.0)
    assert hidden.now == SEEN and hidden.elsewhere.mean > OTHER.mean
    assert shown.now.mean < SEEN.mean and shown.elsewhere == OTHER
    assert hidden.others == shown.others == OTHER


@pytest.mark.parametrize("at", [(0, 0), (9, 14), (30, 20)])
def test_heights_of_a_view_are_the_highest_within_a_cell(at):
    rng = np.random.default_rng(1)
    now, first = rng.random((2, 40, 40), np.float32)
    column, row = at
    found = ResponseView(np.zeros(2), now, now, now, now, first).heights(np.array([column + 0.3, row - 0.3, 1.0]))
    near = [(i, j) for i in range(40) for j in range(40) if abs(i - row) <= UPSAMPLED and abs(j - column) <= UPSAMPLED]
    assert found == (float(max(now[i, j] for i, j in near)), float(max(first[i, j] for i, j in near)))
    assert not math.isnan(found[0])
