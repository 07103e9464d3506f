"""Our box measures against got10k and vot-toolkit, to 1e-9: as recorded, and again if FACETRACK_PEERS says by whom."""

import os
import time

import numpy as np
import pytest

from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation.boxes import centre_errors, measure_boxes, vot_overlaps
from tests.peers import cases

CLOSE = 1e-9
RECORDED = cases.expected()


@pytest.fixture(scope="module")
def peers():
    """What the toolkits say now: of the recorded cases and of new ones."""
    python = os.environ.get("FACETRACK_PEERS")
    if not python:
        pytest.skip("FACETRACK_PEERS names no Python that has the packages of tests/peers/requirements.txt")
    seed = int(time.time()) // 86400  # new ones each day; the names of the cases tell the seed
    given = {name: case for name, (case, _) in RECORDED.items()} | cases.random(seed)
    return given, cases.run(python, given)["measures"]


def ours(case):
    """The measures as measure.py has them."""
    kept = {
        "our_corners": case.our_corners,
        "true_corners": case.true_corners,
        "size": case.size,
    }
    known = ~np.isnan(case.truth).any(axis=1)
    found = measure_boxes(case.ours, case.truth, **kept)
    # as the toolkit burns in, and leaves out what has no prediction
    there, first = np.isfinite(case.ours).all(axis=1), np.arange(len(case.ours))
    accuracy = {
        f"{burn_in} {skip}": measure_boxes(
            case.ours, case.truth, **kept, visible=(first >= burn_in) & (there | (not skip)), init=first < 0
        ).vot_accuracy
        for burn_in in (1, 10)
        for skip in (False, True)
    }
    overlap = vot_overlaps(case.ours, case.truth, case.our_corners, case.true_corners, case.size)
    return {
        "iou": iou(case.ours, case.truth),
        "iou_clipped": iou(case.ours, case.truth, case.size),
        "centre_error": centre_errors(case.ours, case.truth),
        "otb": {
            "success_curve": found.success,
            "precision_curve": found.precision,
            "success_score": found.success_auc,
            "precision_score": found.precision_20,
            "success_rate": found.success[10],
        },
        "otb_success_of_all": found.success_auc * known.sum() / len(known),
        "normalised": {"curve": found.normalised_precision, "score": found.normalised_auc},
        "got10k": {"ao": found.ao, "sr": found.sr50, "sr75": found.sr75, "succ_curve": found.got10k_success},
        "vot_overlap": overlap,
        "vot_accuracy": accuracy,
    }


def differences(mine, theirs, place=""):
    """Every value that differs by more than CLOSE, or is known to one of us alone."""
    if isinstance(theirs, dict):
        assert mine.keys() == theirs.keys()
        return [each for key in theirs for each in differences(mine[key], theirs[key], f"{place} {key}")]
    a, b = np.atleast_1d(np.array(mine, dtype=float)), np.atleast_1d(np.array(theirs, dtype=float))
    assert a.shape == b.shape, place
    with np.errstate(invalid="ignore"):
        apart = ~((np.abs(a - b) <= CLOSE) | (np.isnan(a) & np.isnan(b)))
    return [f"{place}[{at}]: ours {a[at]!r}, theirs {b[at]!r}" for at in np.flatnonzero(apart)]


def check(case, theirs):
    mine, theirs = ours(case), dict(theirs)
    # a single missing box makes their AO nan, and we count it as 0
    missing = np.isnan(case.ours).any(axis=1) & ~np.isnan(case.truth).any(axis=1)
    with_nan = theirs.pop("got10k_ao_with_nan")
    assert with_nan is None if missing[1:].any() else with_nan == theirs["got10k"]["ao"]
    # a row without ground truth has an overlap for vot-toolkit, which leaves it out of the accuracy
    unknown = np.isnan(case.truth).any(axis=1)
    theirs["vot_overlap"] = np.where(unknown, np.nan, np.array(theirs["vot_overlap"], dtype=float))
    # no frame to average over is 0 for vot-toolkit, and not known for us
    for key, value in mine["vot_accuracy"].items():
        mine["vot_accuracy"][key] = value or 0.0
    assert not differences(mine, theirs)


@pytest.mark.parametrize("name", RECORDED)
def test_measures_are_those_recorded_from_the_toolkits(name):
    check(*RECORDED[name])


def test_records_reach_every_rule():
    """What would make the comparison empty: no miss, no absence, no value on a threshold, no polygon."""
    edges, walk = RECORDED["edges"][0], RECORDED["walk"][0]
    for case in (edges, walk):
        assert np.isnan(case.ours).any() and np.isnan(case.truth).any()
    overlaps = iou(edges.ours, edges.truth)
    assert {0.0, 0.5, 0.75, 1.0} <= set(overlaps[~np.isnan(overlaps)])
    assert 20.0 in centre_errors(edges.ours, edges.truth)
    assert RECORDED["polygons"][0].our_corners is None
    assert RECORDED["two polygons"][0].our_corners is not None


@pytest.mark.nightly
def test_measures_are_those_of_the_toolkits_now(peers):
    given, said = peers
    for name, case in given.items():
        try:
            check(case, said[name])
        except AssertionError as e:
            raise AssertionError(f"{name}: {e}") from e


@pytest.mark.nightly
def test_records_are_what_the_toolkits_say_now(peers):
    _, said = peers
    for name, (_, held) in RECORDED.items():
        assert not differences(held, said[name], name)
