"""Normalised cross-correlation: its sums are those of eq. 10, read off a dense map or one by one."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from facetrack_cli.core.types import Particles
from facetrack_cli.trackers.skin import ncc as matching
from facetrack_cli.trackers.skin import ncc_kernels as kernel
from tests.support.images import frame, grey, smooth, states
from tests.support.parts import pattern
from tests.support.skin_faces import SIZE, TRUTH, learned, scene
from tests.twins import ncc as naive

unit = st.floats(-12, 40, width=32)
step = st.one_of(st.just(1.0), st.floats(0.25, 4.0, width=32))


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
    found = kernel.moments_direct(values, weights, np.array(boxes))
    integrals = cv2.integral2(values, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    level, square = kernel.means(*integrals, np.array(boxes), th, tw).T
    for n, (u, v, s) in enumerate(boxes):
        assert found[n, 0] * th * tw == pytest.approx(naive.cross(values, weights, u, v, s), rel=1e-4, abs=0.5)
        there = naive.patch(values, u, v, s, th, tw)
        assert found[n, 1] == pytest.approx(np.var(there), rel=1e-4, abs=0.05)
        edges, area = (u - s / 2, v - s / 2, u + s * (tw - 0.5), v + s * (th - 0.5)), s * s * th * tw
        assert level[n] == pytest.approx(naive.area_sum(values, *edges) / area, abs=1e-6)
        assert square[n] == pytest.approx(naive.area_sum(values, *edges, power=2) / area, abs=1e-4)
        np.testing.assert_allclose(kernel.read_patch(values, u, v, s, th, tw), there, atol=1e-3)


@given(
    boxes=st.lists(
        st.tuples(st.floats(-90, 150), st.floats(-90, 150), st.sampled_from([1.0, 1.0, 0.5, 3.0, 0.01, -1.0, np.nan])),
        min_size=1, max_size=5,
    ),
    factor=st.sampled_from([1, 2, 4]),
    offset=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    template=st.tuples(st.integers(2, 9), st.integers(2, 9)),
    picture=st.tuples(st.integers(1, 60), st.integers(1, 60)),
)  # fmt: skip
@example(boxes=[(9.75, 3.0, 1.0)], factor=1, offset=(0.5, 0.0), template=(2, 2), picture=(8, 10))
def test_what_boxes_see_is_in_the_area(boxes, factor, offset, template, picture):
    (th, tw), (height, width) = template, picture
    found, seen, low, high, area, same = kernel.place(states(boxes), factor, offset, th, tw, width, height)
    x0, y0, x1, y1 = area.tolist()
    assert 0 <= x0 < x1 <= width
    assert 0 <= y0 < y1 <= height
    there = np.zeros((height, width))
    there[y0:y1, x0:x1] = 1.0
    everything = np.ones((height, width))
    for n, (cx, cy, s) in enumerate(boxes):
        if not s * min(th, tw) >= 1:
            assert not seen[n]
            continue
        u = (cx - (factor - 1) / 2) / factor + s * (offset[0] - (tw - 1) / 2)
        v = (cy - (factor - 1) / 2) / factor + s * (offset[1] - (th - 1) / 2)
        edges = u - s / 2, v - s / 2, u + s * (tw - 0.5), v + s * (th - 0.5)
        if not seen[n]:
            assert naive.area_sum(everything, *edges) == pytest.approx(0, abs=1e-9)
            continue
        np.testing.assert_allclose(found[n], (u, v, s), atol=1e-9)
        assert low[0] - 1e-9 <= u <= high[0] + 1e-9
        assert low[1] - 1e-9 <= v <= high[1] + 1e-9
        # all of the image under the box, and all that its points are read from
        assert naive.area_sum(there, *edges) == pytest.approx(naive.area_sum(everything, *edges))
        np.testing.assert_allclose(naive.patch(there, u, v, s, th, tw), naive.patch(everything, u, v, s, th, tw))
    assert same == all(boxes[n][2] == 1.0 for n in np.flatnonzero(seen))


@pytest.mark.parametrize("max_size", [None, 24, 10])
@pytest.mark.parametrize("picture", ["face", "noise"])
def test_dense_and_direct_agree_to_the_rounding_of_float32(picture, max_size, monkeypatch):
    noise = np.random.default_rng(5).integers(0, 256, (170, 260, 3), dtype=np.uint8)
    bgr = scene() if picture == "face" else noise
    template = matching.learn_template(frame(bgr), SIZE, states((100.3, 81.8))[0], max_size)
    # inside, over all borders and beyond them
    x = states(np.random.default_rng(0).uniform((-60, -60), (320, 230), (500, 2)))
    monkeypatch.setattr(matching, "DENSE", 0.0)
    dense = matching.correlate(template, frame(bgr), x)
    monkeypatch.setattr(matching, "DENSE", np.inf)
    direct = matching.correlate(template, frame(bgr), x)
    for one, other in zip(dense, direct, strict=True):
        assert np.ptp(other) > 0.1
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_the_cheaper_way_is_taken_by_sizes_alone(monkeypatch):
    template = matching.learn_template(frame(scene()), SIZE, states(TRUTH)[0], None)
    calls = []
    real = cv2.matchTemplate
    monkeypatch.setattr(cv2, "matchTemplate", lambda *given: (calls.append(1), real(*given))[1])

    def dense(x):
        calls.clear()
        matching.correlate(template, frame(scene()), x)
        return bool(calls)

    near = states(np.random.default_rng(0).normal(TRUTH, 5, (300, 2)))
    assert dense(near)
    assert not dense(near[:2]), "two particles are read faster one by one"
    assert not dense(states([(20, 30)] * 6 + [(220, 140)] * 6)), "a dense correlation would span all between them"
    scaled = near.copy()
    scaled[3, 0, 2] = 1.01
    assert not dense(scaled)
    scaled[3, 0, 0] = 1e6
    assert dense(scaled), "what shows nothing of the image decides nothing"


def test_ncc_is_equation_10_at_whole_places():
    values = smooth(7, 60, 70).round()
    template = matching.learn_template(grey(values), (12.0, 9.0), states((30.5, 25.0))[0], None)
    there = values[21:30, 25:37]
    np.testing.assert_array_equal(template.first, there)
    for dx, dy in ((0, 0), (3, -7), (-11, 15)):
        seen = values[21 + dy : 30 + dy, 25 + dx : 37 + dx]
        keep, remove = matching.correlate(template, grey(values), states((30.5 + dx, 25.0 + dy)))
        assert keep[0] == pytest.approx(naive.ncc(there, seen), abs=1e-5)
        assert remove[0] == pytest.approx(naive.ncc(there, seen, remove=True), abs=1e-5)
    # scaled light changes neither; added light only the one that keeps the mean
    half = matching.correlate(template, grey(values * 0.5), states((30.5, 25.0)))
    added = matching.correlate(template, grey(values * 0.5 + 80), states((30.5, 25.0)))
    assert half[0][0] > 0.999
    assert half[1][0] > 0.999
    assert added[1][0] > 0.999
    assert added[0][0] < 0.999


@pytest.mark.parametrize("dense", [False, True])
def test_ncc_is_equation_10_between_pixels(dense, monkeypatch):
    monkeypatch.setattr(matching, "DENSE", 0.0 if dense else np.inf)
    values = np.random.default_rng(3).integers(0, 256, (60, 70))
    template = matching.learn_template(grey(values), (12.0, 9.0), states((30.5, 25.0))[0], None)
    # the last two over a border
    corners = [(25.5, 21.5), (26.3, 20.9), (20.0, 30.7), (25.01, 21.99), (-4.4, 10.2), (63.7, 54.6)]
    if not dense:
        corners += [(20.3, 18.8, 1.3), (12.6, 30.1, 0.7)]
    boxes = [(*corner, *(() if len(corner) == 3 else (1.0,))) for corner in corners]
    found = matching.correlate(template, grey(values), states([(u + 5.5 * s, v + 4 * s, s) for u, v, s in boxes]))
    for n, (u, v, s) in enumerate(boxes):
        seen = naive.patch(values, u, v, s, 9, 12)
        assert found[1][n] == pytest.approx(naive.ncc(template.first, seen, remove=True), abs=1e-5)


@pytest.mark.parametrize("factor", [1, 2, 4])
@pytest.mark.parametrize("place", [(100.0, 80.0), (101.3, 79.6)])
def test_the_start_matches_itself_perfectly_at_any_place(factor, place):
    template = matching.learn_template(frame(scene()), SIZE, states(place)[0], 48.0 / factor)
    assert template.factor == factor
    keep, remove = matching.correlate(template, frame(scene()), states(place))
    assert keep[0] == pytest.approx(1, abs=1e-5)
    assert remove[0] == pytest.approx(1, abs=1e-5)


def test_a_larger_face_is_matched_at_its_own_scale():
    values = smooth(8, 100, 120, 4)
    template = matching.learn_template(grey(values), (30.0, 30.0), states((60, 50))[0], None)
    larger = cv2.warpAffine(values, np.array([[1.4, 0, -24], [0, 1.4, -20.0]]), (120, 100), flags=cv2.INTER_CUBIC)
    keep, remove = matching.correlate(template, grey(larger), states([(60, 50, s) for s in (1.0, 1.2, 1.4, 1.6, 1.8)]))
    assert remove.argmax() == keep.argmax() == 2
    assert remove[2] > 0.99


def test_template_adapts_only_while_it_knows_the_first_one():
    here, there = states(TRUTH)[0], states((200, 60))[0]
    light = np.clip(scene() * 0.6 + 30, 0, 255).astype(np.uint8)
    none = Particles(here[None], np.zeros(1))
    likelihood, known = learned(scene(), ncc=pattern(adapt=0.25, adapt_above=0.8))
    first = known.template.first
    after = likelihood.learn(known, frame(light), here, none).template
    darker = learned(light)[1].template.first
    np.testing.assert_allclose(after.now, 0.75 * first + 0.25 * darker, atol=0.01)
    np.testing.assert_array_equal(after.first, first)
    again = likelihood.learn(dataclasses.replace(known, template=after), frame(light), here, none).template
    np.testing.assert_allclose(again.now, 0.75 * after.now + 0.25 * darker, atol=0.01)
    assert likelihood.learn(known, frame(light), there, none).template.now is known.template.now
    # what counts is the first template: one that has drifted does not vouch for itself
    ground = dataclasses.replace(known.template, now=matching.learn_template(frame(scene()), SIZE, there, None).now)
    drifted = dataclasses.replace(known, template=ground)
    assert likelihood.learn(drifted, frame(scene()), there, none).template.now is ground.now
    fixed, known = learned(scene())
    assert fixed.learn(known, frame(light), here, none).template.now is known.template.now


def test_a_patch_without_a_pattern_has_no_correlation_at_all():
    template = matching.learn_template(frame(scene()), SIZE, states(TRUTH)[0], None)
    rng = np.random.default_rng(0)
    x = states(np.column_stack([rng.uniform(50, 190, 200), rng.uniform(50, 120, 200), rng.uniform(0.5, 1.6, 200)]))
    for level in (0, 77, 255):
        keep, remove = matching.correlate(template, grey(np.full((170, 260), level)), x)
        assert (remove == 0).all()
        assert (keep > 0.5).all() if level else (keep == 0).all()


def test_correlation_never_passes_1_where_areas_stand_in_for_points():
    values = np.random.default_rng(0).integers(0, 256, (90, 90))
    for place in ((40, 40, 2.5), (45.5, 38.2, 3.0), (44, 44, 1.7), (39, 48, 2.2)):
        template = matching.learn_template(grey(values), (12.0, 10.0), states(place)[0], None)
        for found in matching.correlate(template, grey(values), states(place)):
            assert 0.5 < found[0] <= 1


def test_a_start_at_another_scale_is_learned_from_whole_pixels():
    values = smooth(7, 60, 70).round()
    template = matching.learn_template(grey(values), (8.0, 7.0), states((31.3, 25.8, 2.0))[0], None)
    np.testing.assert_array_equal(template.first, values[20:34:2, 24:40:2])


def test_what_is_left_over_beside_the_last_block_is_not_seen():
    bgr = scene()[:169, :257].copy()
    template = matching.learn_template(frame(bgr), SIZE, states((99.5, 83.5))[0], 12.0)
    assert (template.factor, template.offset) == (4, (0.0, 0.0))
    # column 256 belongs to no block of four
    for x in (states((256 + SIZE[0] / 2 + off, 80.0)) for off in (-0.4, 1.6)):
        for found in matching.correlate(template, frame(bgr), x):
            assert found[0] == 0
