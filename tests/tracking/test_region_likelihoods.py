"""The likelihoods of a region against twins and formulas: edges of an ellipse, colours, a frame and that before."""

import math
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.regions import likelihoods
from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.likelihoods import OUTSIDE, ellipse
from tests.support.images import frame, grey, smooth, states
from tests.support.media import write_pictures
from tests.support.moving_head import START, clip, start, truth
from tests.support.parts import contour, correlation, histogram
from tests.support.results import parts_of
from tests.support.terminal import refusal
from tests.twins import regions as naive

WIDTH, HEIGHT = 160, 120

# --- edges

OVAL = (40.0, 52.0)
OVAL_AT = (80.0, 60.0, 1.0)


@settings(max_examples=10)
@given(
    seed=st.integers(0, 1000),
    cx=st.floats(-20, 80),
    cy=st.floats(-20, 60),
    s=st.one_of(st.floats(0.05, 3.0), st.sampled_from([-1.0, 0.0, 1e-7, 1e7])),
    factor=st.sampled_from([1, 2, 4]),
    reach=st.floats(0.5, 14.0),
    threshold=st.floats(9.0, 540.0),
)
def test_the_kernel_is_what_its_plain_twin_says(seed, cx, cy, s, factor, reach, threshold):
    noise = np.random.default_rng(seed).normal(0, 1, (37, 61)).astype(np.float32)
    image = np.clip(1150 + 1080 * cv2.GaussianBlur(noise, (0, 0), 1.0), 0, 2295).astype(np.uint16)
    points, normals = ellipse((23.0, 31.0), 10)
    x = np.array([[cx, cy, s]])
    ours = kernel.nearest_edges(image, x, 5, -3, factor, points, normals, reach, threshold)
    theirs = naive.nearest_edges(image, x, (5, -3), factor, points, normals, reach, threshold)
    np.testing.assert_allclose(ours, theirs, atol=2e-3)  # float32, and a parabola may be nearly flat


@pytest.mark.parametrize(
    ("row", "at", "nearest"),
    [
        # the step from 0 to 100 has contrasts of 50, 100 and 50, which end on the centre of the last pixel
        ([0, 0, 0, 0, 0, 0, 0, 100, 100, 100], 4, 2.5),
        # one nearer to the border may be half of a larger one
        ([0, 0, 0, 0, 0, 0, 0, 0, 100, 100], 4, math.inf),
        # two equal contrasts are one edge between them, on the outline too
        ([0, 0, 0, 0, 50, 100, 100, 100, 100, 100], 4, 0.0),
        # contrasts of 60, 70 at 4.5, and 40: the parabola is highest 0.5 (60 - 40) / (60 - 140 + 40) from there
        ([0, 0, 0, 0, 40, 80, 100, 100, 100, 100], 7, 2.75),
        # of two edges the nearer, whichever way
        ([0, 0, 90, 90, 90, 90, 90, 0, 0, 0], 4, 2.5),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_edges_by_hand(row, at, nearest, turned):
    image = np.repeat(np.array([row], np.uint16), 10, axis=0)
    image = np.ascontiguousarray(image.T) if turned else image
    normals = np.array([[0.0, 1.0], [0.0, -1.0]] if turned else [[1.0, 0.0], [-1.0, 0.0]])
    x = np.array([[3.0, at, 1.0] if turned else [at, 3.0, 1.0]])
    found = kernel.nearest_edges(image, x, 0, 0, 1, np.zeros((2, 2)), normals, 4.0, 5.0)
    np.testing.assert_allclose(found, [[nearest, nearest]], atol=1e-6)


@pytest.mark.parametrize(("size", "count"), [((40.0, 52.0), 9), ((90.0, 31.0), 32)])
def test_the_normals_stand_at_equal_steps_of_arc(size, count):
    points, normals = ellipse(size, count)
    other_points, other_normals = naive.ellipse(*size, count)
    np.testing.assert_allclose(points, other_points, atol=0.03)
    np.testing.assert_allclose(normals, other_normals, atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


@pytest.mark.parametrize(("max_size", "factor", "search"), [(None, 1, 4.0), (None, 1, 30.0), (30, 2, 30.0)])
def test_likelihood_and_distance_are_the_formulas(max_size, factor, search):
    """Eq. 11, on the means of 3x3 pixels: an edge that lies beyond `search` is none, wherever K takes over."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    within = np.hypot((x - OVAL_AT[0]) / (OVAL[0] / 2), (y - OVAL_AT[1]) / (OVAL[1] / 2)) < 1
    clutter = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, within.shape), (0, 0), 2.0)
    picture = grey(cv2.GaussianBlur(np.where(within, 150.0, 90 + 25 * clutter / clutter.std()), (0, 0), 1.0))
    likelihood = contour(OVAL, sigma=5.0, search=search, threshold=8.0, outlier=0.1, max_size=max_size)
    boxes = [OVAL_AT, (86.3, 57.2, 1.1), (70.1, 66.4, 0.8)]
    x, learned = states(boxes), likelihood.init(picture, states(OVAL_AT)[0])
    assert likelihood._outline[0] == factor
    seen = picture.grey(factor, (0, 0, WIDTH, HEIGHT))[0].astype(float)
    means = np.lib.stride_tricks.sliding_window_view(np.pad(seen, 1, mode="reflect"), (3, 3)).mean(axis=(2, 3))
    points, normals = ellipse(OVAL, 32)
    nearest = naive.nearest_edges(means, boxes, (0, 0), factor, points, normals, search, 8.0)
    likely = [[math.exp(-(d**2) / (2 * 5.0**2)) for d in row] for row in nearest]
    assert any(0.1 > p > 0 for row in likely for p in row) == (search > 5)
    logs = [sum(math.log(max(0.1, p)) for p in row) for row in likely]
    np.testing.assert_allclose(likelihood.score(learned, picture, x, x)[:, 0], logs, atol=5e-3)
    np.testing.assert_allclose(likelihood.distances(learned, picture, x)[:, 0], 1 - np.mean(likely, axis=1), atol=1e-3)


# --- colours


def noisy(seed, height=30, width=37):
    """Any colours, greys and darkness in patches of a few pixels."""
    small = np.random.default_rng(seed).integers(0, 256, (9, 9, 3), dtype=np.uint8)
    small[:2] = small[:2, :, :1]
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST)


@settings(max_examples=12)
@given(
    seed=st.integers(0, 30),
    x=st.lists(st.tuples(st.floats(-15, 50), st.floats(-15, 45), st.floats(0.02, 3)), min_size=1, max_size=4),
    regions=st.sampled_from([(1, 1), (3, 3), (2, 4)]),
    bins=st.sampled_from([(8, 4, 1), (5, 3, 4), (7, 1, 0)]),
    factor=st.sampled_from([1, 2]),
)
def test_distance_agrees_with_the_formula(seed, x, regions, bins, factor):
    picture, size, x0 = noisy(seed), (11.0, 14.5), (17.2, 14.9, 1.0)
    likelihood = histogram(
        size, hue_bins=bins[0], saturation_bins=bins[1], regions=regions, value_bins=bins[2], max_size=16 // factor
    )
    learned = likelihood.init(frame(picture), states([x0])[0])
    assert learned.factor == factor

    small = frame(picture).reduced(factor, (0, 0, 99, 99))[0]
    codes = [
        [naive.bin_of(*map(int, pixel), *bins, 0.1, 0.2) for pixel in row]
        for row in cv2.cvtColor(small, cv2.COLOR_BGR2HSV)
    ]

    def there(box):
        box = ((box[0] - (factor - 1) / 2) / factor, (box[1] - (factor - 1) / 2) / factor, box[2] / factor)
        return naive.counts(codes, box, size, *regions)

    first, _ = there(x0)
    reference = {key: n / sum(first.values()) for key, n in first.items()}
    expected = [naive.squared_distance(*there(box), reference) for box in x]
    seen = likelihood.score(learned, frame(picture), states(x), states(x))
    np.testing.assert_allclose(seen[:, 0], -20 * np.array(expected), atol=2e-5)
    d = likelihood.distances(learned, frame(picture), states(x))[:, 0]
    np.testing.assert_allclose(d**2, expected, atol=2e-6)


def test_boxes_far_apart_are_counted_as_alone(monkeypatch):
    likelihood, picture = histogram((48.0, 60.0)), frame(noisy(0, 200, 260))
    learned = likelihood.init(picture, states([(101.3, 83.6)])[0])
    x = states([(101.3, 83.6, 1), (20, 30, 1), (-90, 20, 1), (240.2, 180.7, 0.4)])
    together = likelihood.distances(learned, picture, x)
    monkeypatch.setattr(likelihoods, "MAX_CELLS", 0)
    np.testing.assert_array_equal(likelihood.distances(learned, picture, x), together)


# --- frame and frame before

DISTANCES = ["l2", "saturated_l1"]
SIZE = (40.0, 48.0)


place = st.floats(-60, 220, width=32)
scale = st.one_of(st.floats(0.0, 3.0, width=32), st.sampled_from([1e-6, 1e3, -0.7]))


@settings(max_examples=30)
@given(
    kind=st.sampled_from(DISTANCES),
    boxes=st.lists(st.tuples(place, place, scale), min_size=1, max_size=4),
    parent=st.tuples(place, place, scale),
    other=st.tuples(st.integers(0, 2), scale),
    split=st.integers(0, 4),
    size=st.tuples(st.floats(2, 200), st.floats(2, 200)),
    grid=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    factor=st.sampled_from([1, 2, 8]),
    picture=st.sampled_from([(1, 1), (1, 9), (7, 2), (37, 50), (96, 120)]),
)
def test_kernel_does_what_its_twin_does(kind, boxes, parent, other, split, size, grid, factor, picture):
    rng = np.random.default_rng(picture[0] + factor)
    whole = picture[1] * factor + 5 % factor, picture[0] * factor + 3 % factor
    # in another place of the whole image than the one before, as a crop is
    now, before = (rng.integers(0, 256, picture, dtype=np.uint8) for _ in range(2))
    now_view, before_view = (0, 0, *whole), (2 * factor, 3 * factor, whole[0] + 2 * factor, whole[1] + 3 * factor)
    x = np.array(boxes)
    # rounding decides whether a point on the border lies within
    for axis in (0, 1):
        cells = size[axis] * ((np.arange(grid[axis]) + 0.5) / grid[axis] - 0.5)
        rows = np.vstack([x, parent, np.add(parent, other[1] * (np.arange(3) == other[0]))])
        borders = [-0.5, now_view[2 + axis] - 0.5, before_view[2 + axis] - 0.5]
        points = rows[:, axis, None] + np.outer(rows[:, 2], cells)
        assume(np.abs(points[..., None] - borders).min() > 1e-6)
    # two parents that differ in one coordinate, with several children each
    of = np.tile(parent, (len(x), 1))
    of[split:, other[0]] += other[1]
    out = np.full(len(x), np.nan)
    how = (0.0 if kind == "l2" else 25.0), 1000.0
    kernel.patch_distances(now, now_view, before, before_view, factor, x, of, size, *grid, *how, out)
    for n in range(len(x)):
        a = naive.patch(now, now_view, factor, x[n], size, *grid)
        b = naive.patch(before, before_view, factor, of[n], size, *grid)
        # float32 places a point to within 1e-5 pixels, over which grey levels differ by up to 255
        assert out[n] == pytest.approx(naive.distance(a, b, kind, 25.0, 1000.0), rel=1e-3, abs=0.05)


@pytest.mark.parametrize("kind", DISTANCES)
def test_likelihood_is_the_formula_of_the_paper(kind):
    before, now = grey(smooth(0)), grey(smooth(0) * 0.9 + 20)
    likelihood = correlation(SIZE, grid=(5, 4), sigma=60.0, saturation=15.0 if kind == "saturated_l1" else None)
    x, parent = [[70.3, 50.2, 1.1], [20.0, 30.0, 0.5], [150.0, 60.0, 1.0]], [71.0, 49.0, 1.05]
    factor = 8
    assert likelihood.factor == factor, "40 / 5 pixels a step"
    greys = [f.grey(factor, (0, 0, WIDTH, HEIGHT)) for f in (now, before)]
    (a, b), view = [grey[0] for grey in greys], (0, 0, WIDTH, HEIGHT)
    assert all(grey[1:] == (0, 0) for grey in greys)
    learned, parents = likelihood.init(before, states([0, 0, 1.0])[0]), np.repeat(states(parent), len(x), axis=0)
    for row, log_p in zip(x, likelihood.score(learned, now, states(x), parents)[:, 0], strict=True):
        here = naive.patch(a, view, factor, row, SIZE, 5, 4)
        there = naive.patch(b, view, factor, parent, SIZE, 5, 4)
        outside = {"l2": OUTSIDE**2, "saturated_l1": 15.0}[kind]
        d = naive.distance(here, there, kind, 15.0, outside)
        assert log_p == pytest.approx(-d / (2 * 60.0**2 if kind == "l2" else 60.0), rel=1e-3)


ALL = "contour_histogram_correlation"
SHIPPED = [load_recipe(path.stem) for path in shipped_recipes()]
PRODUCTS = [one for one in SHIPPED if isinstance(one, ParticleRecipe) and one.likelihood.type == "product"]
RECIPES = [one.name for one in PRODUCTS]


def track_frames(config, frames, seed=0, overrides=(), begin=None):
    return list(track(build_tracker(load_recipe(config, overrides), begin or start()), iter(frames), seed))


def boxes(results, target=0):
    parts = [parts_of(r.targets[target])[0] for r in results]
    return np.array([(p.x - (p.w - 1) / 2, p.y - (p.h - 1) / 2, p.w, p.h) for p in parts])


@pytest.mark.parametrize("config", RECIPES)
def test_every_recipe_follows_a_head_that_moves_and_grows(config):
    results = track_frames(config, clip())
    overlap = iou(boxes(results), truth())
    assert overlap[0] == pytest.approx(1.0)
    assert overlap.mean() > 0.6 and overlap[-5:].mean() > 0.5
    first = results[0].targets[0]
    assert [(p.part, p.status, p.confidence) for p in parts_of(first)] == [("box", "init", 1.0)]
    assert first.cloud.shape == (200, 1, 2)
    for result in results[1:]:
        [part] = parts_of(result.targets[0])
        assert part.status in ("tracked", "lost") and 0.0 <= part.confidence <= 1.0
        assert part.cov[0] * part.cov[2] >= part.cov[1] ** 2 * (1 - 1e-9) and part.cov[0] >= 0
        assert 1 - 1e-9 <= part.ess <= 200 + 1e-6
    assert np.mean([parts_of(r.targets[0])[0].status == "tracked" for r in results[1:]]) > 0.9


WITH_GREYS = ["likelihood.histogram.value_bins=8"]  # without, a grey clip is refused


@pytest.mark.parametrize(
    ("config", "overrides"),
    [("contour", ()), ("contour_correlation", ()), ("histogram", WITH_GREYS), (ALL, WITH_GREYS)],
)
def test_a_grey_clip_is_followed(config, overrides):
    assert iou(boxes(track_frames(config, clip(grey=True), overrides=overrides)), truth()).mean() > 0.6


def test_correlation_alone_follows_what_moves_and_does_not_judge():
    overrides = ["likelihood={type: product, correlation: {sigma: 60}}", "filter.particles=400"]
    results = track_frames("histogram", clip()[:25], overrides=overrides)
    assert iou(boxes(results), truth(25)).mean() > 0.5
    statuses = [(parts_of(r.targets[0])[0].status, parts_of(r.targets[0])[0].confidence) for r in results]
    assert statuses == [("init", None)] + [("tracked", None)] * 24


def test_lengths_are_in_units_of_the_mean_side_of_the_box():
    [target] = build_tracker(load_recipe("contour_histogram_correlation"), start((10.0, 20.0, 30.0, 67.5)))
    contour, histogram, correlation = target.likelihood.factors
    assert (contour.sigma, contour.search) == pytest.approx((0.08 * 45, 0.3 * 45))
    np.testing.assert_allclose(target.motion.position[1], [[0.05 * 45], [0.03 * 45]])
    np.testing.assert_allclose(target.motion.scale[1], [[0.01], [0]])
    assert contour.size == histogram.context.placed.size == target.space.size == (30.0, 67.5)
    assert correlation.size == (30.0, 67.5)
    np.testing.assert_array_equal(target.x0, [[24.5, 53.25, 1, 0, 0, 0]])


# --- at the command line ----------------------------------------------------------------------------------------------

BOX = ",".join(f"{side:g}" for side in START)
FRAMES = 4


def starts(box="[100, 60, 40, 52]", points=""):
    inside = [f"box: {box}"] * bool(box) + [f"points: {points}"] * bool(points)
    return f"frame: 0\nhead: {{{', '.join(inside)}}}\n"


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Folders of images: `head` and `grey` with boxes to begin with and as ground truth, `points` with points alone."""
    folder = tmp_path_factory.mktemp("clips")
    for name, plain in (("head", False), ("grey", True), ("points", False)):
        write_pictures(folder / name, [frame.bgr for frame in clip(FRAMES, grey=plain)])
    for name in ("head", "grey"):
        (folder / f"{name}.init.yaml").write_text(starts())
        rows = [f"{n},head,box,{x + (w - 1) / 2},{y + (h - 1) / 2},{w},{h},visible"
                for n, (x, y, w, h) in enumerate(truth(FRAMES))]  # fmt: skip
        (folder / f"{name}.truth.csv").write_text("\n".join(["frame,target,part,x,y,w,h,status", *rows]) + "\n")
    (folder / "points.init.yaml").write_text(starts("", "{nose: [120, 90]}"))
    rows = [f"{n},head,nose,120,90,visible" for n in range(FRAMES)]
    (folder / "points.truth.csv").write_text("\n".join(["frame,target,part,x,y,status", *rows]) + "\n")
    return folder


def refused(result, code):
    """The one line of a refusal that left nothing behind."""
    said = refusal(result, code)
    assert list(Path().iterdir()) == []
    return said


def run(facetrack, *args, name="head", config=ALL):
    return facetrack("run", f"IN/{name}", "--config", config, "--no-video", "-q", *args)


# --- where to begin --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("begin", "name"), [((), "head"), (("--box", BOX), "face")])
def test_colours_on_a_grey_clip_name_the_clip_the_target_and_what_to_do(facetrack, clips, begin, name):
    said = refused(run(facetrack, *begin, name="grey"), 3)
    assert f"{clips}/grey: {name}, frame 0: 0.0% of the box's pixels have a hue" in said
    assert "use the recipe contour or contour_correlation, or --set likelihood.histogram.value_bins=8" in said


@pytest.mark.parametrize(
    ("box", "said"),
    [
        ("100,60,1,40", "--box: the box of face is smaller than 6x6 pixels; give a larger one"),
        ("100,60,5.9,6", "smaller than 6x6 pixels"),
        ("0,0,261,200", "the box of face, 261x200 pixels, is larger than the frame of 260x200; make it smaller"),
        ("-400000,-400000,800000,800000", "is larger than the frame of 260x200"),
        ("-31,-31,60,60", "the centre of the box [-31, -31, 60, 60] of face is outside the frame of 260x200 pixels"),
    ],
)
def test_a_box_that_cannot_be_followed_is_told_alike_by_option_and_file(facetrack, tmp_path, box, said):
    file = tmp_path / "here.yaml"
    file.write_text(starts(f"[{box}]"))
    assert said in refused(run(facetrack, "--box", box), 3)
    assert said.replace("--box:", f"{file}:").replace("face", "head") in refused(run(facetrack, "--init", file), 3)


def test_a_box_too_narrow_for_the_reduced_picture_names_the_setting(facetrack):
    options = ["--set", "likelihood.histogram.max_size=16", "--box", "10,10,6,180"]
    said = refused(run(facetrack, *options, config="histogram"), 3)
    assert "the box has no pixel of the image at 1/16 of its size" in said and "likelihood.histogram.max_size" in said


# --- what a recipe may say -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "overrides",
    [
        ["motion.position.A=[[1, 1e6], [0, 1]]", "motion.position.B=[[1e6px], [1e6px]]"],
        ["motion.scale.A=[[1, 1e6], [0, 1]]", "motion.scale.B=[[1e6], [1e6]]", "motion.position.B=[[0], [0]]"],
        ["likelihood.correlation={grid: [64, 1], sigma: 0.001, region: 1e-300}"],
        ["likelihood.histogram={hue_bins: 1, saturation_bins: 1, regions: [64, 64], lambda_h: 1e6, value_bins: 64}"],
        ["likelihood.contour={normals: 4, sigma: 1e6, search: 10, threshold: 1e-300, outlier: 1e-320}"],
    ],
)
def test_what_is_allowed_stays_finite_however_far_it_goes(facetrack, overrides):
    options = [word for override in overrides for word in ("--set", override)]
    code, out, err = run(facetrack, *options, "-o", "-")
    assert (code, err) == (0, "")
    rows = [line.split(",") for line in out.splitlines()]
    columns = [rows[0].index(name) for name in ("x", "y", "w", "h", "std_x", "std_y", "ess", "confidence")]
    assert len(rows) == FRAMES + 1
    assert np.isfinite([[float(row[column]) for column in columns] for row in rows[1:]]).all()


def test_correlation_alone_cannot_fail_on_lost(facetrack):
    options = ["--set", "likelihood.histogram=null", "-o", "o"]
    said = refused(run(facetrack, *options, "--fail-on-lost", config="histogram_correlation"), 2)
    assert "histogram_correlation cannot tell when it is lost; leave it out" in said
    assert run(facetrack, *options, config="histogram_correlation")[0] == 0


# --- points and boxes ------------------------------------------------------------------------------------------------


def test_a_recipe_of_points_on_a_clip_of_boxes_or_of_regions_on_one_of_points_says_what_follows_it(facetrack, clips):
    said = refused(run(facetrack, name="points"), 3)
    assert f"{clips}/points.init.yaml: head has no box, which the recipe follows; add one" in said
    assert "or follow its points, by a recipe such as factorized" in said
    begin = Path("two.yaml")
    begin.write_text("frame: 0\na: {box: [100, 60, 40, 52]}\nb: {box: [20, 130, 40, 40]}\n")
    code, _, err = run(facetrack, "--init", "two.yaml", config="factorized")
    assert code == 3 and "two.yaml: no point for nose, mouth_left" in err
    assert "or follow its box by a recipe of regions, as contour_histogram" in err


# --- the same bytes, and no more memory ------------------------------------------------------------------------------


def test_of_all_frames_the_last_alone_is_kept():
    pictures = []

    kept = [Frame(f.index, f.time_s, f.bgr.copy()) for f in clip(6)]

    def one_by_one():
        while kept:
            frame = kept.pop(0)
            pictures.append(weakref.ref(frame.bgr))
            yield frame
            del frame

    begin = Start(0, {"head": TargetStart(box=START)}, "here")
    for result in track(build_tracker(load_recipe(ALL), begin), one_by_one(), 0):
        del result
        assert sum(picture() is not None for picture in pictures) <= 2
