"""The contract of every likelihood: where its peak is, what wild input does, and what a score may depend on."""

import copy
import pickle
from functools import cache, partial

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame, Particles, Start, TargetStart
from facetrack_cli.engine.resampling import uniform
from facetrack_cli.engine.target import ParticleTarget
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.skin.likelihoods import CloudSpace
from tests.support.moving_head import START, H, W, path, scene
from tests.support.parts import contour, correlation
from tests.support.samples import FOLDER

MOVED = np.array([3.0, -2.0])  # pixels, from the first frame to the second
PRODUCT = "likelihood={type: product, "
WIDE = "likelihood.{}.max_size=26"
# recipe and overrides, which together cover each likelihood and each way in which one reads a frame
CASES = {
    "colour_ratio": ("factorized", "likelihood.floor=null"),
    "colour_ratio, reduced": ("factorized", "likelihood.max_samples=7"),
    "contour": ("contour",),
    "contour, reduced": ("contour", WIDE.format("contour")),
    "histogram": ("histogram",),
    "histogram, reduced": ("histogram", WIDE.format("histogram")),
    "histogram and greys": ("histogram", "likelihood.histogram.value_bins=8"),
    "correlation, plain": ("histogram", f"{PRODUCT}correlation: {{sigma: 60}}}}"),
    "correlation, saturated": ("histogram", f"{PRODUCT}correlation: {{sigma: 60, saturation: 20}}}}"),
    "product": ("contour_histogram_correlation",),
    "product, estimated shares": ("contour_histogram_correlation_robust",),
    "skin": ("skin",),
    "ncc": ("ncc",),
    "skin_ncc": ("skin_ncc",),
    "skin_ncc, robust": ("skin_ncc_robust",),
    "skin_ncc, reduced": ("skin_ncc", "likelihood.skin.max_size=26", "likelihood.ncc.max_size=26"),
    "skin cloud": ("head_hands_cloud", "targets.left_hand=null", "targets.right_hand=null"),
    "appearance": ("adaptive_appearance",),
    "appearance, robust": ("adaptive_robust",),
    "appearance, fixed": ("fixed_template",),
    "recognition": ("adaptive_recognition", f"recognition.gallery={FOLDER / 'people.npz'}"),
    "correlation_filter": ("correlation_filter",),
}  # fmt: skip
# of other light the scores of these say little: one counts skin, others compare frame and frame before
OF_ONE_LIGHT = ("correlation, ", "product", "skin")
# motions of points, and of a box that may be hidden, give finite places
FINITE = ("colour_ratio", "correlation_filter")
CONTRACT = pytest.mark.parametrize("name", CASES)


def places(x, y):
    """The parts of a face at a head's middle, on the head's border, whose windows show contrast."""
    at = {"nose": (0, -0.1), "mouth_left": (-0.4, -0.1), "mouth_right": (0.4, -0.1), "lip_upper": (0, 0.42),
          "lip_lower": (0, 0.55)}  # fmt: skip
    return {part: (x + u * W / 2, y + v * H / 2) for part, (u, v) in at.items()}


@cache
def frames():
    """The head where it begins, and moved by MOVED."""
    x, y, _ = path(0)
    return tuple(Frame(i, i / 25, scene(x + dx, y + dy, 1)) for i, (dx, dy) in enumerate([(0, 0), MOVED]))


@cache
def built(name):
    """The target, what its likelihood learned of the first frame, and the frames that it was not asked of yet."""
    config, *overrides = CASES[name]
    recipe = load_recipe(config, overrides)
    target_name = next(iter(recipe.followed), "face")
    x, y, _ = path(0)
    begin = Start(0, {target_name: TargetStart(START, places(x, y))}, "head.init.yaml")
    [target] = build_tracker(recipe, begin)
    assert isinstance(target, ParticleTarget)
    return target, target.likelihood.init(frames()[0], target.x0)


def fresh(frame):
    return Frame(frame.index, frame.time_s, frame.bgr.copy())


def prepared(target, learned, frame, expected=None):
    """What is learned, ready to score particles in a frame."""
    return target.likelihood.look(learned, frame, target.x0 if expected is None else expected)


def scored(target, learned, frame, x):
    """(N, K) of x (N, K, D), whose parents are all at the start."""
    parents = np.repeat(target.x0[None], len(x), axis=0)
    found = target.likelihood.score(prepared(target, learned, frame), frame, x, parents)
    assert found.shape == x.shape[:2]
    return found


def around(target, off):
    """(N, K, D): the state of the start moved by `off` (N, 2)."""
    x = np.repeat(target.x0[None], len(off), axis=0)
    x[..., :2] += np.asarray(off)[:, None]
    return x


GRID = np.stack(np.meshgrid(np.arange(-9.0, 10), np.arange(-9.0, 10)), axis=-1).reshape(-1, 2)


@CONTRACT
@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_the_peak_is_at_the_ground_truth(name, gain):
    if gain < 1 and name.startswith(OF_ONE_LIGHT):
        pytest.skip("other light changes what this likelihood sees")
    target, learned = built(name)
    now = Frame(1, 0.04, np.round(frames()[1].bgr * gain).astype(np.uint8))
    x = around(target, MOVED + GRID)
    score = scored(target, learned, now, x)
    if isinstance(target.space, CloudSpace):  # a pixel is skin or not, wherever in the face
        assert score[np.hypot(*GRID.T) < 3].mean() > score[np.hypot(*GRID.T) > 9].mean()
        return
    assert np.abs(GRID[score.argmax(axis=0)]).max() <= 1.0
    if hasattr(target.likelihood, "factors") and "correlation, " in name:
        return  # it says how the target moved and nothing of what it looks like
    distance = target.likelihood.distances(learned, now, x)
    assert distance.shape == score.shape and distance.min() >= 0 and np.isfinite(distance).all()
    assert (distance[len(GRID) // 2] <= distance[0]).all()


WILD = st.one_of(st.floats(-400, 400), st.floats(allow_nan=True, allow_infinity=True))


@CONTRACT
@given(
    place=st.tuples(WILD, WILD),
    scale=st.one_of(st.floats(0.05, 3), st.sampled_from([0.0, 1e-9, 1e9])),
    level=st.sampled_from([None, 0, 128, 255]),
    size=st.sampled_from([(200, 260), (1, 1), (3, 70)]),
)
def test_scores_are_finite_in_any_frame_and_at_any_place(name, place, scale, level, size):
    target, learned = built(name)
    bgr = frames()[1].bgr[: size[0], : size[1]] if level is None else np.full((*size, 3), level, np.uint8)
    now, x = Frame(1, 0.04, np.ascontiguousarray(bgr)), around(target, np.zeros((3, 2)))
    x[1, :, :2] = np.clip(np.nan_to_num(place), -1e12, 1e12) if name.startswith(FINITE) else place
    if x.shape[2] > 2:
        x[2, :, 2] = max(scale, 1e-6) if name.startswith("correlation_filter") else scale
    assert np.isfinite(scored(target, learned, now, x)).all()
    if "correlation, " not in name:
        distance = target.likelihood.distances(learned, now, x)
        assert np.isfinite(distance).all() and distance.min() >= 0
    ready = prepared(target, learned, now)
    after = target.likelihood.learn(ready, now, target.x0, Particles(x, uniform(3)))
    assert np.isfinite(scored(target, after, frames()[1], around(target, np.zeros((1, 2))))).all()


@CONTRACT
def test_equal_input_gives_equal_scores_and_no_argument_changes(name):
    target, learned = built(name)
    now, x = fresh(frames()[1]), around(target, GRID[::7])
    shown, before, places = now.bgr.copy(), pickle.dumps(plain(learned)), x.copy()
    one, two = scored(target, learned, now, x), scored(target, learned, fresh(frames()[1]), x.copy())
    assert one.tobytes() == two.tobytes()
    particles = Particles(x, uniform(len(x)))
    ready = prepared(target, learned, now)
    later = [target.likelihood.learn(ready, frame, target.x0, particles) for frame in (now, fresh(frames()[1]))]
    a, b = (scored(target, one, fresh(frames()[0]), x) for one in later)
    np.testing.assert_allclose(a, b, rtol=1e-4)  # a part of a frame that was read before may be larger
    np.testing.assert_array_equal(now.bgr, shown)
    np.testing.assert_array_equal(x, places)
    assert pickle.dumps(plain(learned)) == before


def plain(learned):
    """A copy without what is computed again when it is asked for."""
    if isinstance(learned, tuple) and not hasattr(learned, "_fields"):
        return [plain(one) for one in learned]
    state = copy.copy(getattr(learned, "__dict__", learned))
    if isinstance(state, dict):
        fields = getattr(learned, "__dataclass_fields__", state)
        return {key: plain(value) for key, value in state.items() if key in fields and key != "frame"}
    return state


@CONTRACT
def test_a_score_does_not_depend_on_other_particles_nor_on_what_a_frame_was_asked_before(name):
    target, learned = built(name)
    off = GRID[::11]
    alone = scored(target, learned, fresh(frames()[1]), around(target, off))
    crowd = scored(target, learned, fresh(frames()[1]), around(target, [*off, (150, 70), (-300, 900), (-90, -60)]))
    np.testing.assert_allclose(crowd[: len(off)], alone, rtol=2e-4, atol=2e-3)
    asked = fresh(frames()[1])
    for factor in (1, 2, 4):
        for read in (asked.reduced, asked.grey):
            read(factor, (30.0, 20.0, 170.0, 150.0))
    np.testing.assert_allclose(scored(target, learned, asked, around(target, off)), alone, rtol=2e-4, atol=2e-3)


def test_a_product_is_the_sum_of_logarithms_and_judges_by_its_objects():
    target, learned = built("product")
    x, now = around(target, GRID[::11]), frames()[1]
    parents = np.repeat(target.x0[None], len(x), axis=0)
    factors = [*zip(target.likelihood.factors, learned, strict=True)]
    each = [factor.score(part, now, x, parents) for factor, part in factors]
    np.testing.assert_allclose(scored(target, learned, now, x), sum(each))
    looks = [factor.distances(part, now, x) for factor, part in factors[:2]]  # the third says how it moved
    np.testing.assert_allclose(target.likelihood.distances(learned, now, x), sum(looks) / 2)


BOX = np.array([[80.0, 60.0, 1, 0, 0, 0]])


@pytest.mark.parametrize("kind", ["contour", "correlation", "saturated"])
def test_estimated_the_likelihood_is_flatter_and_has_the_same_order(kind):
    noise = np.random.default_rng(2).integers(0, 255, (120, 160, 3), np.uint8)
    picture = cv2.GaussianBlur(noise, (0, 0), 2.0)
    first, second = Frame(0, 0.0, picture), Frame(1, 0.04, np.roll(picture, 1, axis=1))
    make = {
        "contour": partial(contour, (40.0, 48.0), 2.0, 8.0, normals=32, threshold=2.0, outlier=0.05),
        "correlation": partial(correlation, (40.0, 48.0), grid=(16, 16)),
        "saturated": partial(correlation, (40.0, 48.0), saturation=20.0, grid=(16, 16)),
    }[kind]
    x = np.repeat(BOX[None], 40, axis=0)
    x[..., :2] += np.random.default_rng(3).normal(0, 2, (40, 1, 2))
    scores = []
    for one in (make(), make(independent="estimated")):
        learned = one.learn(one.init(first, BOX), second, BOX, None)
        share = learned if kind == "contour" else learned.share
        scores.append(one.score(learned, first, x, x))
        assert one.settings.independent == "estimated" or share.mean == 1.0
    assert share.frames == 2 and 0 < share.mean < (1.001 if kind == "contour" else 0.6)
    np.testing.assert_allclose(scores[1], scores[0] * share.mean, rtol=1e-9)
