"""Faces by skin and template: rho and the score are those of the formulas, and nothing wild breaks them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trackers.skin import ncc as matching
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.colour import learn_skin
from facetrack_cli.trackers.skin.settings import SkinNccSettings
from facetrack_cli.trackers.skin.skin_ncc import MIN_NCC
from tests.support.images import frame, states
from tests.support.parts import pattern, skin_cue, skin_ncc
from tests.support.samples import TrackClip
from tests.support.skin_faces import SIZE, TRUTH, learned, scene
from tests.twins import ncc as naive

COSTS = ["printed", "shifted", "product"]


@given(
    place=st.tuples(st.floats(-50, 400), st.floats(-50, 400), st.floats(0.5, 4)),
    side=st.tuples(st.floats(8, 90), st.floats(8, 90)),
    factor=st.sampled_from([1, 2, 4]),
    corner=st.tuples(st.integers(0, 9), st.integers(0, 9)),
)
def test_regions_have_equal_areas_and_the_twins_edges(place, side, factor, corner):
    left, top = corner[0] * factor, corner[1] * factor
    inner, outer, area = kernel.nested(states(place), *side, factor, left, top)
    for found, whole in zip((inner[0], outer[0]), naive.regions(*place, *side), strict=True):
        np.testing.assert_allclose(found * factor + np.tile([left, top], 2) + (factor - 1) / 2, whole, atol=1e-6)
    whole = (outer[0, 2] - outer[0, 0]) * (outer[0, 3] - outer[0, 1])
    assert whole == pytest.approx(2 * area[0])
    assert area[0] * factor**2 == pytest.approx(side[0] * side[1] * place[2] ** 2)


@pytest.mark.parametrize("max_size", [None, 24])
@pytest.mark.parametrize("inner", [1.0, 0.7])
def test_rho_is_that_of_the_twin(max_size, inner):
    likelihood, known = learned(scene(), skin=skin_cue(inner=inner, max_size=max_size), ncc=None)
    rows = [(*TRUTH, 1.0), (90.2, 77.7, 1.3), (5.0, 160.0, 0.8), (-300.0, 20.0, 1.0)]
    found = likelihood.rho(known, frame(scene()), states(rows))
    factor = 1 if max_size is None else 2
    reduced = cv2.resize(scene(), (260 // factor, 170 // factor), interpolation=cv2.INTER_AREA)
    codes = cv2.cvtColor(reduced, cv2.COLOR_BGR2YCrCb)
    skin = known.table[codes[..., 2], codes[..., 1]] / 255.0
    for (cx, cy, s), value in zip(rows, found, strict=True):
        centre = ((c - (factor - 1) / 2) / factor for c in (cx, cy))
        boxes = naive.regions(*centre, s, *(inner * side / factor for side in SIZE))
        assert value == pytest.approx(naive.rho(skin, *boxes), abs=1e-6)
    if inner == 1.0:
        assert found[0] < -0.3, "a face is skin among little skin"
    assert found[3] == 0.0, "beyond the image nothing is skin"


def test_skin_is_learned_from_the_box():
    known = learned(scene(), ncc=None)[1]
    table = learn_skin(frame(scene()), (82.0, 60.0, *SIZE)).table
    np.testing.assert_array_equal(known.table, table)
    larger = skin_ncc(SIZE, ncc=None).init(frame(scene()), states((*TRUTH, 1.5))[0])
    np.testing.assert_array_equal(larger.table, learn_skin(frame(scene()), (72.0, 48.0, 60.0, 72.0)).table)


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("mean", ["keep", "remove"])
@pytest.mark.parametrize("cues", ["both", "skin", "ncc"])
@pytest.mark.parametrize("k", [None, 0.4])
def test_score_is_equation_11(cost, mean, cues, k):
    skin, ncc = skin_cue() if cues != "ncc" else None, pattern(mean, exponent=2.0) if cues != "skin" else None
    likelihood, known = learned(scene(), skin=skin, ncc=ncc, cost=cost, k=k, sigma=0.3)
    x = states([TRUTH, (110, 80), (60, 40), (300, 400)])
    f = frame(scene())
    rho = likelihood.rho(known, f, x) if skin else 0.0
    match = matching.correlate(known.template, f, x)[0 if mean == "keep" else 1] if ncc else 1.0
    good, divisor = np.maximum(match, 0) ** 2, np.maximum(match, MIN_NCC) ** 2
    v = {"printed": rho / divisor, "shifted": (1 + rho) / divisor, "product": rho * good}[cost]
    if cues == "ncc":
        v = good
    v0 = v[0] if k is None else k
    assert known.k == pytest.approx(v0)
    np.testing.assert_allclose(likelihood.score(known, f, x)[:, 0], -((v0 - v) ** 2) / (2 * 0.3**2), rtol=1e-9)


def test_beyond_the_picture_there_is_neither_skin_nor_pattern():
    likelihood, known = learned(scene())
    x = states([(-500, 80), (1e7, 1e7), (101.5, -60)])
    assert (likelihood.rho(known, frame(scene()), x) == 0).all()
    for found in matching.correlate(known.template, frame(scene()), x):
        assert (found == 0).all()
    np.testing.assert_array_equal(likelihood.distances(known, frame(scene()), x), 1.0)
    # half a box beyond the border is compared as black
    cut = scene()[:, :100].copy()
    black = np.concatenate([cut, np.zeros((170, 160, 3), np.uint8)], axis=1)
    here, there = (
        matching.correlate(known.template, frame(one), states([TRUTH, (95.2, 70.7)])) for one in (cut, black)
    )
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_a_start_outside_of_the_picture_is_refused():
    for cues in ({}, {"skin": None}, {"ncc": None}):
        for place in ((-30, 50), (50, 1000), (np.nan, 50)):
            with pytest.raises(InputError, match=r"not in the image|outside the image"):
                learned(scene(), place, **cues)
        assert learned(scene(), (-10, 5), **cues)[1].k is not None
    with pytest.raises(ValueError, match="neither skin nor ncc"):
        SkinNccSettings(type="skin_ncc", sigma=0.1)


def test_what_the_start_lacks_is_told():
    assert learned(scene())[1].notes == ()
    assert len(learned(scene()[..., ::-1].copy())[1].notes) == 1, "no pixel has the colour of skin"
    grey_face = np.repeat(scene().mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    with pytest.raises(InputError, match="only 0% of the face's box have a colour"):
        learned(grey_face)
    assert learned(grey_face, skin=None)[1].notes == ()
    flat = np.full((170, 260, 3), (120, 150, 205), np.uint8)
    assert any("pattern" in note for note in learned(flat)[1].notes)
    assert learned(flat, skin=None, ncc=pattern("remove"))[1].k == 0


def test_the_longer_side_decides_how_far_the_picture_is_reduced():
    asked = frame(scene())
    likelihood, known = learned(scene(), size=(20.0, 60.0), skin=skin_cue(max_size=32), ncc=None)
    likelihood.rho(known, asked, states(TRUTH))
    assert list(asked._reduced) == [2]


def test_sums_of_a_picture_that_is_skin_throughout_are_exact():
    """More than an int32 holds, of 8.4 million pixels and above."""
    bgr = np.full((3000, 3100, 3), (120, 150, 205), np.uint8)
    likelihood, known = learned(bgr, (1500.0, 1450.0), ncc=None)
    rho = likelihood.rho(known, frame(bgr), states([(60, 60), (3040, 2940), (3040, 2800)]))
    np.testing.assert_allclose(rho, 0, atol=1e-9)


@pytest.mark.parametrize(
    ("cost", "mean", "second", "holds"),
    [
        ("printed", "keep", False, False), ("shifted", "keep", False, True), ("shifted", "keep", True, False),
        ("shifted", "remove", True, True), ("product", "keep", True, False), ("product", "remove", True, True),
    ],
)  # fmt: skip
def test_the_readings_of_equation_11_on_a_darker_noisy_face(cost, mean, second, holds):
    """Whether the peak stays on a real face, also beside a `second` patch of skin: what docs/decisions.md says."""
    clip = TrackClip("expressions", 1)
    left, top, w, h = clip.start.targets["face"].box
    bgr, x, y = clip.frames[0].bgr, left + (w - 1) / 2, top + (h - 1) / 2
    likelihood, known = learned(bgr, (x, y), (w, h), ncc=pattern(mean), cost=cost)
    shown = bgr.copy()
    if second:
        skin = bgr[round(y) - 20 : round(y) + 20, round(x) - 20 : round(x) + 20].mean(axis=(0, 1))
        beside = round(x + (1.15 * w if x + 1.6 * w < bgr.shape[1] else -1.15 * w)), round(y)
        cv2.ellipse(shown, beside, (round(w / 2), round(h / 2)), 0, 0, 360, skin.tolist(), -1)
    worse = np.clip(0.85 * shown + np.random.default_rng(0).normal(0, 6, bgr.shape), 0, 255).astype(np.uint8)
    steps = [2.0 * np.arange(-int(0.75 * side), int(0.75 * side) + 1) for side in (w, h)]
    off = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    away = float(np.hypot(*off[likelihood.score(known, frame(worse), states(off + np.array([x, y])))[:, 0].argmax()]))
    assert away <= 2.0 if holds else away > 5.0


def test_least_share_decides_what_teaches_the_colour():
    assert learned(scene())[1].notes == ()
    assert "Kovac" in learned(scene(), skin=skin_cue(least_share=1.0))[1].notes[0]
