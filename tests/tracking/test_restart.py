"""A particle filter that begins again where it is told to: what it takes from the first frame, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.target import Bound
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from tests.tracking.test_corrected import PARTS, Clip, given, part, run

HIDDEN = ("nose", "lip_upper")
AWAY = np.array([name in HIDDEN for name in PARTS])


@pytest.fixture(scope="module")
def face():
    return Clip("expressions", 14)


@pytest.fixture(scope="module")
def head():
    return Clip("textured", 14)


@pytest.fixture(scope="module")
def zoom():
    return Clip("zoom", 14)


def begun(config, clip, overrides=()):
    """A target, and its state after the first frame."""
    [target] = build_tracker(load_recipe(config, overrides), clip.start)
    state, _ = target.begin(np.random.default_rng(0), clip.frames[0])
    return target, state


def restarted(config, clip, place, absent=(), overrides=()):
    target, first = begun(config, clip, overrides)
    state, result = target.restart(np.random.default_rng(1), clip.frames[10], first, place, absent)
    return target, first, state, result


# --- absent parts ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bound(face):
    """A face in frame 10 of which two parts are absent, and its particles, spread."""
    place = TargetStart(points=face.points(10, [name for name in PARTS if name not in HIDDEN]))
    target, _, state, _ = restarted("factorized", face, place, HIDDEN)
    x = state.particles.x + np.random.default_rng(2).normal(0, 2, state.particles.x.shape)
    return Bound(target, state, face.frames[11], (), target.motion), x


def test_absent_parts_follow_the_others_from_the_first_frame_on(face, bound):
    start = face.start.targets["face"].points
    shape = np.array([start[name] for name in PARTS])
    x = bound[0].state.particles.x
    np.testing.assert_allclose(
        x[:, AWAY], x[:, ~AWAY].mean(axis=1, keepdims=True) + shape[AWAY] - shape[~AWAY].mean(0), atol=1e-9
    )


def test_what_follows_is_another_array(bound):
    model, x = bound
    before = x.copy()
    moved = model.target.follow(x, AWAY)
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(moved[:, ~AWAY], x[:, ~AWAY])
    assert (moved[:, AWAY] != x[:, AWAY]).all()


def test_absent_parts_say_nothing(bound):
    """Neither what they look like, nor how they moved, nor what shape they make."""
    model, x = bound
    seen = model.log_likelihood(x, x)
    moved = model.log_transition(x, x + 1)
    assert not seen[..., AWAY].any() and not moved[..., AWAY].any()
    assert seen[..., ~AWAY].any(axis=0).all() and moved[..., ~AWAY].any(axis=0).all()
    elsewhere = x.copy()
    elsewhere[:, AWAY] += 30
    np.testing.assert_array_equal(model.log_prior(elsewhere), model.log_prior(x))
    elsewhere[:, ~AWAY] += np.arange(6).reshape(3, 2)
    assert (model.log_prior(elsewhere) != model.log_prior(x)).any()


# --- what is taken from the first frame, and what is not -------------------------------------------------------------


@pytest.mark.parametrize("config", ["contour_correlation", "skin_ncc"])
def test_what_is_carried_from_frame_to_frame_is_carried_from_the_correction(config, head, zoom):
    clip = head if config == "contour_correlation" else zoom
    target, first = begun(config, clip)
    asked = []

    class Spy(type(target.likelihood)):
        def learn(self, learned, frame, state, particles):
            asked.append((learned, frame.index, state[0, :2].tolist(), particles))
            return "learned"

    target = replace(target, likelihood=Spy(**vars(target.likelihood)))
    left, top, w, h = clip.box(10)
    state, _ = target.restart(np.random.default_rng(1), clip.frames[10], first, TargetStart(box=(left, top, w, h)))
    assert state.learned == "learned"
    [(learned, frame, place, particles)] = asked
    assert learned is first.learned and frame == 10
    assert place == pytest.approx([left + (w - 1) / 2, top + (h - 1) / 2]) and particles is state.particles


def scale_of(result):
    (scale,) = result.rows.diagnostics["face"].get("scale")
    return scale


def test_a_prediction_and_the_insets_begin_in_the_frame_of_the_correction(zoom):
    place = TargetStart(box=zoom.box(10))
    target, first, state, result = restarted("adaptive_velocity", zoom, place)
    again = target.motion.begin(np.random.default_rng(9), zoom.frames[10], state.estimated.state)
    np.testing.assert_array_equal(state.flow.patch, again.patch)
    assert (state.flow.patch != first.flow.patch).any()
    expected = target.likelihood.insets(state.learned)
    for (name, picture), (other, wanted) in zip(result.insets, expected, strict=True):
        assert name == other
        np.testing.assert_array_equal(picture, wanted)
    before = target.likelihood.insets(first.learned)
    assert any((a != b).any() for (_, a), (_, b) in zip(result.insets, before, strict=True))
    assert scale_of(result) == pytest.approx(np.sqrt(zoom.box(10)[2] * zoom.box(10)[3]) / zoom.box(0)[2], rel=1e-3)


def test_a_cloud_fills_the_box_that_is_given():
    clip = Clip("signing", 8)
    few = [f"targets.{name}.filter.particles=60" for name in ("head", "left_hand", "right_hand")]
    put = run("head_hands_cloud", clip, given(5, "left_hand", box=(80.0, 120.0, 33.0, 71.0)), overrides=few)
    [hand] = [one for one in put[5].targets if one.rows.target == "left_hand"]
    assert (hand.rows.w[0], hand.rows.h[0]) == pytest.approx((33, 71))
    assert np.ptp(hand.cloud[:, 0, 0]) <= 33 and np.ptp(hand.cloud[:, 0, 1]) > 50


def test_a_box_of_another_shape_is_the_unit_from_there_on(head):
    """What is learned again is followed as what it is, and not by the first frame's measures."""
    left, top, w, h = head.box(5)
    put = run("histogram", head, given(5, "head", box=(left, top, 2 * w, h)))
    assert [part(r, "box").w / part(r, "box").h for r in put[5:]] == pytest.approx([2 * w / h] * len(put[5:]), rel=1e-6)


@pytest.mark.parametrize(("learn", "scale"), [(None, 1.0), (True, 1.0), (False, 1.5)])
def test_a_face_under_affine_maps_is_learned_anew_unless_it_is_said_otherwise(zoom, learn, scale):
    left, top, w, h = zoom.box(0)
    put = run("adaptive_velocity", zoom, given(5, box=(left, top, 1.5 * w, 1.5 * h), learn=learn))
    assert scale_of(put[5].targets[0]) == pytest.approx(scale, rel=1e-3)


def test_colours_are_not_learned_anew():
    clip = Clip("signing", 1)
    anew = given(5, "left_hand", box=(80.0, 120.0, 33.0, 71.0), learn=True)
    with pytest.raises(InputError, match="left_hand at frame 5: colours are learned in the first frame alone"):
        run("head_hands_cloud", clip, anew)


# --- what is said of it ----------------------------------------------------------------------------------------------


def test_what_is_given_is_certain_though_nothing_is_learned(face):
    far = {name: (x + 25, y) for name, (x, y) in face.points(5).items()}
    put = run("factorized", face, given(5, points=far, learn=False))
    assert {part(put[5], name).confidence for name in PARTS} == {1.0}
    assert min(part(put[6], name).confidence for name in PARTS) < 0.9


@pytest.mark.parametrize("learn", [None, False])
def test_where_nothing_judges_nothing_is_certain(head, learn):
    alone = ("likelihood.contour=null",)
    put = run("contour_correlation", head, given(5, "head", box=head.box(5), learn=learn), overrides=alone)
    assert [(part(r, "box").status, part(r, "box").confidence) for r in put[4:7]] == [
        ("tracked", None),
        ("init", None),
        ("tracked", None),
    ]


def test_a_target_that_is_gone_was_said_so_in_one_frame(face):
    put = run("factorized", face, given(5, absent=True))
    assert [{part(r, name).by_hand for name in PARTS} for r in put[4:7]] == [{False}, {True}, {False}]


def test_a_correction_that_leaves_parts_open_cannot_begin_a_part_of_a_run(face):
    start = replace(face.start, corrections=(given(5, points={"nose": (160.0, 140.0)}),))
    [target] = build_tracker(load_recipe("factorized"), start)
    with pytest.raises(ValueError, match="face at frame 5 does not tell of all its parts"):
        list(track((target.resumed(face.frames[0]),), iter(face.frames[5:]), 0))
