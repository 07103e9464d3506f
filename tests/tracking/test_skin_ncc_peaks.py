"""Where each reading of eq. 11 has its peak, and how many places far off come near it."""

from functools import cache

import cv2
import numpy as np
import pytest

from facetrack_cli.tracking.models.likelihoods import ncc as matching
from tests.support.parts import pattern
from tests.support.samples import FOLDER, read_pictures
from tests.support.skin_faces import SIZE, TRUTH, frame, learned, scene, states

READINGS = {
    "printed": {"cost": "printed"},
    "shifted": {"cost": "shifted"},
    "shifted, k = 0": {"cost": "shifted", "k": 0.0},
    "product": {"cost": "product"},
    "printed, zero-mean": {"cost": "printed", "ncc": pattern("remove")},
    "shifted, zero-mean": {"cost": "shifted", "ncc": pattern("remove")},
    "shifted, k = 0, zero-mean": {"cost": "shifted", "k": 0.0, "ncc": pattern("remove")},
    "product, zero-mean": {"cost": "product", "ncc": pattern("remove")},
    "skin": {"ncc": None},
    "skin, k = 0": {"cost": "shifted", "k": 0.0, "ncc": None},
    "ncc": {"skin": None},
    "ncc, zero-mean": {"skin": None, "ncc": pattern("remove")},
}


@cache
def pictures(name):
    """(start, the same darker and with noise, also with a second patch of skin, centre of the face, its size)."""
    if name == "made":
        worse = {"darker": 0.85, "noise": 6.0}
        return scene(), scene(**worse), scene(**worse, second=(155.0, 90.0)), TRUTH, SIZE
    text = (FOLDER / f"{name}.init.yaml").read_text(encoding="utf-8")
    left, top, w, h = (float(one) for one in text.split("[")[1].split("]")[0].split(","))
    centre, bgr = (left + (w - 1) / 2, top + (h - 1) / 2), read_pictures(name)[0]
    rng = np.random.default_rng(0)
    cheeks = bgr[round(centre[1]) - 20 : round(centre[1]) + 20, round(centre[0]) - 20 : round(centre[0]) + 20]
    with_patch = bgr.copy()
    at = round(centre[0] + (1.15 * w if centre[0] + 1.6 * w < bgr.shape[1] else -1.15 * w)), round(centre[1])
    cv2.ellipse(with_patch, at, (round(w / 2), round(h / 2)), 0, 0, 360, cheeks.mean(axis=(0, 1)).tolist(), -1)
    noise = rng.normal(0, 6, bgr.shape)
    worse, second = (np.clip(one * 0.85 + noise, 0, 255).astype(np.uint8) for one in (bgr, with_patch))
    return bgr, worse, second, centre, (w, h)


def surface(reading, name, condition):
    """(offsets (N, 2) from the ground truth in sizes, in pixels, log-likelihoods) every 2 pixels, 1.5 sizes around."""
    start, worse, second, centre, size = pictures(name)
    bgr = {"start": start, "worse": worse, "second": second}[condition]
    likelihood, known = learned(start, centre, size, sigma=0.1, **READINGS[reading])
    steps = [np.arange(-int(0.75 * side), int(0.75 * side) + 1) * 2.0 for side in size]
    off = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    return off / size, off, likelihood.score(known, frame(bgr), states(off + centre))[:, 0]


def peak(reading, name, condition):
    """How far the likelihood's maximum lies from the ground truth, in pixels."""
    _, off, score = surface(reading, name, condition)
    return float(np.hypot(*off[score.argmax()]))


PICTURES = ["made", "textured", "expressions"]
# k is the value at the start, so there the ground truth has the highest likelihood by construction; not so with k = 0
EXACT_AT_START = [reading for reading in READINGS if "k = 0" not in reading or "zero-mean" in reading]
# of a face that is darker, with noise: its skin is less like the skin that was learned
PEAKS_WHEN_WORSE = [
    "ncc", "ncc, zero-mean", "product, zero-mean",
    "shifted", "shifted, zero-mean", "shifted, k = 0", "shifted, k = 0, zero-mean",
]  # fmt: skip


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("reading", EXACT_AT_START)
def test_peak_is_at_the_truth_in_the_first_frame(reading, name):
    assert peak(reading, name, "start") <= 2.0


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("reading", PEAKS_WHEN_WORSE)
def test_peak_is_at_the_truth_of_a_darker_face_with_noise(reading, name):
    assert peak(reading, name, "worse") <= 2.0


@pytest.mark.parametrize("name", ["textured", "expressions"])
@pytest.mark.parametrize("reading", ["skin", "printed", "printed, zero-mean"])
def test_where_skin_leads_a_darker_face_is_found_beside_its_place(reading, name):
    # rho at the face is above k now, and other places of R_int reach k; NCC next to 1 changes little
    assert peak(reading, name, "worse") > 5.0


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("reading", [one for one in PEAKS_WHEN_WORSE if "mean" in one or one == "ncc"])
def test_peak_stays_at_the_truth_beside_another_patch_of_skin(reading, name):
    assert peak(reading, name, "second") <= 2.0


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("reading", ["skin", "skin, k = 0", "printed", "shifted", "shifted, k = 0", "product"])
def test_with_its_mean_kept_ncc_does_not_hold_off_another_patch_of_skin(reading, name):
    # as published: a smoother patch is the better skin, and NCC is above 0.9 on it
    size = np.array(pictures(name)[4])
    relative, off, score = surface(reading, name, "second")
    assert np.abs(relative[score.argmax()]).max() > 0.8
    start, _, second, centre, _ = pictures(name)
    known = matching.learn_template(frame(start), tuple(size), states(centre)[0], None)
    keep, remove = matching.correlate(known, frame(second), states(off[[score.argmax()]] + centre))
    assert keep[0] > 0.85
    assert remove[0] < 0.7


def test_the_sign_trap_of_equation_11():
    # divided by an NCC below 1, a rho below 0 grows: of two places with the same skin the worse match has the lower v
    # so k below v at the start makes eq. 11 as printed look for bad matches; a shifted cost, or a product, does not
    start, worse, _, centre, size = pictures("expressions")
    found = {}
    for cost, k in (("printed", -1.0), ("shifted", 0.0), ("product", -1.0)):
        likelihood, known = learned(start, centre, size, ncc=pattern("remove"), cost=cost, k=k)
        _, off, _ = surface("skin", "expressions", "start")
        score = likelihood.score(known, frame(worse), states(off + centre))[:, 0]
        best = states(off[[score.argmax()]] + centre)
        found[cost] = matching.correlate(known.template, frame(worse), best)[1][0]
    assert found["printed"] < 0.5
    assert found["shifted"] > 0.95
    assert found["product"] > 0.95


def far_and_likely(reading, name, condition="start"):
    """The share of places more than a quarter of the face off whose likelihood is within e^-1/2 of the peak's."""
    relative, _, score = surface(reading, name, condition)
    far = np.abs(relative).max(axis=1) > 0.25
    return float(np.mean(score[far] > score.max() - 0.5))


@pytest.mark.parametrize("name", PICTURES)
def test_zero_mean_leaves_no_place_far_off_that_is_nearly_as_good(name):
    for condition in ("start", "worse", "second"):
        for reading in ("shifted, zero-mean", "product, zero-mean", "ncc, zero-mean"):
            assert far_and_likely(reading, name, condition) < 0.001
    # v = rho / NCC takes on k along a whole curve of places
    assert far_and_likely("printed, zero-mean", name) > 0.002
    assert far_and_likely("ncc", name) > 0.002
