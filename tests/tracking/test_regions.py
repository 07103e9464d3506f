"""Regions in the whole engine: every shipped recipe of a region on a made-up clip, whose ground truth is known."""

from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe
from facetrack_cli.runs.clip import run as job_run
from facetrack_cli.runs.plan import Job
from facetrack_cli.runs.signals import Stop
from facetrack_cli.start.assembly import build_tracker
from tests.support.moving_head import W, clip, path, scene, start, truth
from tests.support.results import parts_of

SAMPLE = Path(__file__).parents[2] / "sample_videos" / "hands.mp4"
SHIPPED = [load_recipe(path.stem) for path in shipped_recipes()]
PRODUCTS = [one for one in SHIPPED if isinstance(one, ParticleRecipe) and one.likelihood.type == "product"]
RECIPES = [one.name for one in PRODUCTS]


def run(config, frames, seed=0, overrides=(), begin=None):
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
    results = run(config, coloured)
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


@pytest.mark.parametrize("config", ["contour", "contour_correlation"])
def test_contours_follow_a_grey_clip(config, grey):
    assert iou(boxes(run(config, grey)), truth()).mean() > 0.6


@pytest.mark.parametrize("config", [name for name in RECIPES if "histogram" in name])
def test_a_colour_recipe_says_of_a_grey_clip_that_it_cannot_know_colours(config, grey):
    with pytest.raises(InputError, match=r"colour.*contour") as caught:
        run(config, grey)
    assert "\n" not in str(caught.value)
    with_grey = run(config, grey, overrides=["likelihood.histogram.value_bins=8"])
    assert iou(boxes(with_grey), truth()).mean() > 0.6


@pytest.mark.parametrize("config", ["contour", "contour_histogram_correlation"])
def test_the_posterior_mean_is_unbiased(config, coloured):
    """In the mean over 8 seeds, though the head changes its speed all the time: less than half a pixel, 3 % of s."""
    parts = [[parts_of(r.targets[0])[0] for r in run(config, coloured, seed)] for seed in range(8)]
    off = np.array([[(p.x - x, p.y - y, p.w / W - s) for p, (x, y, s) in zip(row, map(path, range(45)), strict=True)]
                    for row in parts])  # fmt: skip
    assert np.all(np.abs(off.mean(axis=(0, 1))) < (0.5, 0.5, 0.03))


def test_correlation_alone_follows_what_moves_and_does_not_judge(coloured):
    overrides = ["likelihood={type: product, correlation: {sigma: 60}}", "filter.particles=400"]
    results = run("histogram", coloured[:25], overrides=overrides)
    assert iou(boxes(results), truth(25)).mean() > 0.5
    statuses = [(parts_of(r.targets[0])[0].status, parts_of(r.targets[0])[0].confidence) for r in results]
    assert statuses == [("init", None)] + [("tracked", None)] * 24


def test_a_head_that_goes_is_lost_and_found_when_it_is_back(coloured):
    gone = [Frame(n, n / 25, scene(-500.0, 0.0, 1.0)) for n in range(10, 18)]
    back = [Frame(n, n / 25, scene(*path(9))) for n in range(18, 30)]
    results = run("contour_histogram", [*coloured[:10], *gone, *back])
    statuses = [parts_of(r.targets[0])[0].status for r in results]
    assert "lost" not in statuses[:10]
    assert statuses[17] == "lost" and statuses[-1] == "tracked"


@pytest.mark.parametrize("config", [name for name in RECIPES if "correlation" in name])
def test_the_picture_that_is_drawn_is_not_the_one_that_the_next_frame_is_compared_with(config, tmp_path):
    """Correlation looks at the previous frame again, after it was painted, or while it is."""
    written = {}
    for video in (False, True):
        for threads in (1, 2):
            out = tmp_path / f"{video}{threads}"
            recipe = load_recipe(config, ["filter.particles=30"])
            job = Job(SAMPLE, recipe, out, formats=("csv",), video=video, stop=6, threads=threads)
            assert job_run(job, Stop()).frames == 6
            assert (out / "annotated.mp4").exists() == video
            written[video, threads] = (out / "trajectory.csv").read_bytes()
    assert len(set(written.values())) == 1


def test_lengths_are_in_units_of_the_mean_side_of_the_box():
    [target] = build_tracker(load_recipe("contour_histogram_correlation"), start((10.0, 20.0, 30.0, 67.5)))
    contour, histogram, correlation = target.likelihood.factors
    assert (contour.sigma, contour.search) == pytest.approx((0.08 * 45, 0.3 * 45))
    np.testing.assert_allclose(target.motion.position[1], [[0.05 * 45], [0.03 * 45]])
    np.testing.assert_allclose(target.motion.scale[1], [[0.01], [0]])
    assert contour.size == histogram.size == target.space.size == (30.0, 67.5)
    assert correlation.size == (30.0, 67.5)
    np.testing.assert_array_equal(target.x0, [[24.5, 53.25, 1, 0, 0, 0]])


@pytest.mark.parametrize("box", [(100, 60, 5, 50), (100, 60, 50, 2.5)])
def test_a_box_too_small_to_see_anything_in_is_refused(box):
    with pytest.raises(InputError, match=r"clip.init.yaml: the box of head is smaller than 6x6 pixels; give a larger"):
        build_tracker(load_recipe("contour"), start(box))


def test_a_target_without_a_box_is_refused():
    begin = Start(0, {"head": TargetStart(points={"nose": (50, 50)})}, "points.yaml")
    with pytest.raises(InputError, match=r"points.yaml: head has no box"):
        build_tracker(load_recipe("contour"), begin)
