"""Faces by skin and template: rho, NCC and the score are those of the formulas, and nothing wild breaks them."""

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trackers.skin import likelihoods as matching
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.likelihoods import MIN_NCC
from facetrack_cli.trackers.skin.settings import SkinNccSettings
from tests.support.images import frame, grey, states
from tests.support.parts import pattern, skin_cue, skin_ncc
from tests.support.samples import TrackClip
from tests.tracking.test_skin import BLUE_WALL, FACE, USUAL, portrait
from tests.twins import skin as naive

SIZE, TRUTH = FACE[2:], (79.5, 74.5)


@cache
def scene():
    return portrait(USUAL, BLUE_WALL, height=170, width=260).bgr


def learned(bgr, centre=TRUTH, size=SIZE, **options):
    likelihood = skin_ncc(size, **options)
    return likelihood, likelihood.init(frame(bgr), states(centre)[0])


@pytest.mark.parametrize(("max_size", "inner"), [(None, 1.0), (36, 0.7)])
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


@pytest.mark.parametrize("cost", ["printed", "shifted", "product"])
@pytest.mark.parametrize("cues", ["both", "skin", "ncc"])
@pytest.mark.parametrize("mean", ["keep", "remove"])
def test_score_is_equation_11(cost, mean, cues):
    skin, ncc = skin_cue() if cues != "ncc" else None, pattern(mean, exponent=2.0) if cues != "skin" else None
    likelihood, known = learned(scene(), skin=skin, ncc=ncc, cost=cost, sigma=0.3)
    x = states([TRUTH, (110, 80), (60, 40), (300, 400)])
    f = frame(scene())
    rho = likelihood.rho(known, f, x) if skin else 0.0
    match = matching.correlate(known.template, f, x)[0 if mean == "keep" else 1] if ncc else 1.0
    good, divisor = np.maximum(match, 0) ** 2, np.maximum(match, MIN_NCC) ** 2
    v = {"printed": rho / divisor, "shifted": (1 + rho) / divisor, "product": rho * good}[cost]
    if cues == "ncc":
        v = good
    assert known.k == pytest.approx(v[0])
    np.testing.assert_allclose(likelihood.score(known, f, x)[:, 0], -((v[0] - v) ** 2) / (2 * 0.3**2), rtol=1e-9)


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
        for place in ((-40, 50), (50, 1000), (np.nan, 50)):
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


unit = st.floats(-12, 40, width=32)
step = st.one_of(st.just(1.0), st.floats(0.25, 4.0, width=32))


@settings(max_examples=12)
@given(
    picture=st.tuples(st.integers(1, 20), st.integers(1, 24), st.integers(0, 99)),
    template=st.tuples(st.integers(1, 6), st.integers(1, 7)),
    boxes=st.lists(st.tuples(unit, unit, step), min_size=1, max_size=3),
)
def test_kernels_do_what_their_twins_do(picture, template, boxes):
    rng = np.random.default_rng(picture[2])
    values = rng.integers(0, 256, picture[:2], dtype=np.uint8)
    weights = rng.normal(0, 30, template).astype(np.float32)
    th, tw = template
    found = kernel.moments_direct(values, weights, np.array(boxes).T.copy())
    for n, (u, v, s) in enumerate(boxes):
        assert found[0, n] * th * tw == pytest.approx(naive.cross(values, weights, u, v, s), rel=1e-4, abs=0.5)
        there = naive.patch(values, u, v, s, th, tw)
        assert found[1, n] == pytest.approx(np.var(there), rel=1e-4, abs=0.05)


@given(
    boxes=st.lists(
        st.tuples(st.floats(-90, 150), st.floats(-90, 150), st.sampled_from([1.0, 1.0, 0.5, 3.0, 0.01, -1.0, np.nan])),
        min_size=1, max_size=5,
    ),
    size=st.tuples(st.floats(4, 36), st.floats(4, 36)),
    picture=st.tuples(st.integers(20, 60), st.integers(20, 60)),
    most=st.sampled_from([8, None]),
)  # fmt: skip
@example(boxes=[(9.75, 3.0, 1.0)], size=(4.0, 4.0), picture=(20, 20), most=None)
def test_ncc_with_means_is_that_of_area_means_wherever_boxes_lie(boxes, size, picture, most):
    values = grey(np.random.default_rng(1).integers(0, 256, picture))
    template = matching.learn_template(values, size, states((picture[1] / 2, picture[0] / 2))[0], most)
    found = matching.correlate(template, values, states(boxes))[0]
    factor, (th, tw) = template.factor, template.centred.shape
    height, width = (side // factor for side in picture)
    seen = values.grey(factor, (0, 0, picture[1] - 1, picture[0] - 1))[0][:height, :width]
    centred, mean, variance = template.centred, template.mean, template.variance
    for n, (cx, cy, s) in enumerate(boxes):
        u = (cx - (factor - 1) / 2) / factor + s * (template.offset[0] - (tw - 1) / 2)
        v = (cy - (factor - 1) / 2) / factor + s * (template.offset[1] - (th - 1) / 2)
        edges, area = (u - s / 2, v - s / 2, u + s * (tw - 0.5), v + s * (th - 0.5)), s * s * tw * th
        square = naive.area_sum(seen, *edges, power=2) if s * min(th, tw) >= 1 else 0
        if square > 0:
            cross = naive.cross(seen, centred, u, v, s) / centred.size + mean * naive.area_sum(seen, *edges) / area
            expected = np.clip(cross / np.sqrt((variance + mean**2) * square / area), -1, 1)
            assert found[n] == pytest.approx(expected, abs=1e-3)
        else:
            assert found[n] == 0


@pytest.mark.parametrize("dense", [False, True])
def test_ncc_is_equation_10_between_pixels(dense, monkeypatch):
    monkeypatch.setattr(matching, "DENSE", 0.0 if dense else np.inf)
    values = np.random.default_rng(3).integers(0, 256, (60, 70))
    template = matching.learn_template(grey(values), (12.0, 9.0), states((30.5, 25.0))[0], None)
    # the last two over a border
    corners = [(25.0, 21.0), (25.5, 21.5), (26.3, 20.9), (20.0, 30.7), (25.01, 21.99), (-4.4, 10.2), (63.7, 54.6)]
    if not dense:
        corners += [(20.3, 18.8, 1.3), (12.6, 30.1, 0.7)]
    boxes = [(*corner, *(() if len(corner) == 3 else (1.0,))) for corner in corners]
    found = matching.correlate(template, grey(values), states([(u + 5.5 * s, v + 4 * s, s) for u, v, s in boxes]))
    for n, (u, v, s) in enumerate(boxes):
        seen = naive.patch(values, u, v, s, 9, 12)
        assert found[1][n] == pytest.approx(naive.ncc(template.centred + template.mean, seen, remove=True), abs=1e-5)
    whole = naive.patch(values, 25.0, 21.0, 1.0, 9, 12)
    assert found[0][0] == pytest.approx(naive.ncc(template.centred + template.mean, whole, remove=False), abs=1e-5)
