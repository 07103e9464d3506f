"""Recipes of regions on a made-up clip whose ground truth is known, and what cannot be meant said in one line."""

import weakref
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe
from facetrack_cli.start.assembly import build_tracker
from tests.support.media import write_pictures
from tests.support.moving_head import START, clip, start, truth
from tests.support.results import parts_of
from tests.support.terminal import refusal

ALL = "contour_histogram_correlation"
SHIPPED = [load_recipe(path.stem) for path in shipped_recipes()]
PRODUCTS = [one for one in SHIPPED if isinstance(one, ParticleRecipe) and one.likelihood.type == "product"]
RECIPES = [one.name for one in PRODUCTS]


def track_frames(config, frames, seed=0, overrides=(), begin=None):
    return list(track(build_tracker(load_recipe(config, overrides), begin or start()), iter(frames), seed))


def boxes(results, target=0):
    parts = [parts_of(r.targets[target])[0] for r in results]
    return np.array([(p.x - (p.w - 1) / 2, p.y - (p.h - 1) / 2, p.w, p.h) for p in parts])


@pytest.fixture(scope="module")
def coloured():
    return clip()


@pytest.fixture(scope="module")
def grey():
    return clip(grey=True)


@pytest.mark.parametrize("config", RECIPES)
def test_every_recipe_follows_a_head_that_moves_and_grows(config, coloured):
    results = track_frames(config, coloured)
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
def test_a_grey_clip_is_followed(config, overrides, grey):
    assert iou(boxes(track_frames(config, grey, overrides=overrides)), truth()).mean() > 0.6


def test_correlation_alone_follows_what_moves_and_does_not_judge(coloured):
    overrides = ["likelihood={type: product, correlation: {sigma: 60}}", "filter.particles=400"]
    results = track_frames("histogram", coloured[:25], overrides=overrides)
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
    for name, grey in (("head", False), ("grey", True), ("points", False)):
        write_pictures(folder / name, [frame.bgr for frame in clip(FRAMES, grey=grey)])
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
