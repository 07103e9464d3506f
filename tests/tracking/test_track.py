"""The whole engine in process: every shipped recipe of points on a sample clip, judged by its ground truth."""

import re
import shutil

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.models import shipped_folder, shipped_recipes
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.points.shape_prior import default_prior_path
from tests.support.results import parts_of
from tests.support.samples import TrackClip

RECIPES = [path.stem for path in shipped_recipes() if load_recipe(path.stem).points]


class Clip(TrackClip):
    """Up to a frame, with ground truth and visibility (T, K) in the recipe's order."""

    def __init__(self, name, stop):
        super().__init__(name, stop)
        rows = self.truth
        parts = load_recipe("factorized").target.parts
        truth = [[rows[f.index, part] for part in parts] for f in self.frames]
        self.truth = np.array([[(row.x, row.y) for row in line] for line in truth])
        self.visible = np.array([[row.status == "visible" for row in line] for line in truth])


@pytest.fixture(scope="module")
def expressions():
    return Clip("expressions", 60)


@pytest.fixture(scope="module")
def occlusion():
    return Clip("occlusion", 130)


def run(config, clip, seed=0, frames=None, overrides=()):
    tracker = build_tracker(load_recipe(config, overrides), clip.start)
    return list(track(tracker, iter(frames or clip.frames), seed))


def places(results):
    """Of nose, mouth and lips: a face has rows of its box and eyes, too."""
    return np.array([[(p.x, p.y) for p in parts_of(result.targets[0])[:5]] for result in results])


def errors(results, clip):
    return np.hypot(*np.moveaxis(places(results) - clip.truth[: len(results)], 2, 0))


@pytest.mark.parametrize("config", RECIPES)
def test_every_recipe_follows_the_face_of_a_sample_clip(config, expressions):
    results = run(config, expressions)
    assert [r.frame.index for r in results] == list(range(60))
    assert {p.status for p in parts_of(results[0].targets[0])[:5]} == {"init"}
    off = errors(results, expressions)
    # bounds from the measured tables, with room; the filters over the joint state are the ones that wander
    assert off.mean() < {"sir": 8.0, "auxiliary_prior": 5.5}.get(config, 3.0)
    assert off[:, 0].mean() < 4.0
    for result in results[1:]:
        for part in parts_of(result.targets[0])[:6]:
            assert part.status in ("tracked", "lost")
            assert 0.0 <= part.confidence <= 1.0
            assert part.cov[0] >= 0
            assert part.cov[0] * part.cov[2] >= part.cov[1] ** 2 * (1 - 1e-9)
            assert 1 - 1e-9 <= part.ess <= part.particles + 1e-6


def test_covered_parts_are_called_lost_and_found_again(occlusion):
    results = run("factorized_robust", occlusion)
    lost = np.array([[p.status == "lost" for p in parts_of(r.targets[0])] for r in results])
    covered = slice(60, 100)
    hidden = ~occlusion.visible[covered]
    assert hidden.any()
    assert lost[covered][hidden].mean() > 0.9
    assert lost[:45].mean() < 0.02
    assert lost[115:].mean() < 0.05
    assert errors(results, occlusion)[115:].mean() < 3.0


def test_the_prior_is_what_brings_a_part_back(occlusion):
    """The paper's main claim in one test: 100 particles with the prior come back, 1,000 without it do not."""
    with_prior = [errors(run("factorized", occlusion, seed), occlusion)[-10:].mean() for seed in range(3)]
    without = [errors(run("independent", occlusion, seed), occlusion)[-10:].mean() for seed in range(3)]
    assert max(with_prior) < 4.0
    assert min(without) > 4.0


def test_lengths_scale_with_the_target_and_windows_of_the_init_file_win():
    points = load_recipe("factorized").target.parts
    small = {part: (10.0 * i, 5.0 * (i % 2)) for i, part in enumerate(points)}
    large = {part: (4 * x, 4 * y) for part, (x, y) in small.items()}
    [a] = build_tracker(load_recipe("factorized"), Start(0, {"face": TargetStart(points=small)}, "x"))
    [b] = build_tracker(
        load_recipe("factorized"), Start(0, {"face": TargetStart(points=large, windows={"nose": (31.0, 17.0)})}, "x")
    )
    np.testing.assert_allclose(b.motion.sigma, 4 * a.motion.sigma)
    np.testing.assert_allclose(b.likelihood.windows[1:], 4 * a.likelihood.windows[1:])
    np.testing.assert_allclose(b.likelihood.windows[0], [31, 17])
    [c] = build_tracker(
        load_recipe("factorized", ["motion.sigma=3px"]), Start(0, {"face": TargetStart(points=large)}, "x")
    )
    np.testing.assert_allclose(c.motion.sigma, 3.0)


def test_a_start_without_a_part_is_refused_by_name():
    with pytest.raises(InputError, match="mouth_left"):
        build_tracker(load_recipe("factorized"), Start(0, {"face": TargetStart(points={"nose": (1, 2)})}, "clip.yaml"))


def test_a_prior_of_the_command_line_is_sought_there_whatever_else_has_its_name(expressions, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    recipe = tmp_path / "elsewhere" / "mine.yaml"
    text = (shipped_folder() / "factorized.yaml").read_text()
    recipe.write_text(re.sub("(?m)^description: .*", "description: own.npz", text))
    shutil.copy(default_prior_path(), tmp_path / "own.npz")
    assert build_tracker(load_recipe(recipe, ["prior.file=own.npz"]), expressions.start)


def test_a_prior_for_other_parts_is_refused():
    recipe = load_recipe("factorized", ["target.parts=[nose, chin]", "target.windows=0.3"])
    start = Start(0, {"face": TargetStart(points={"nose": (1, 2), "chin": (5, 60)})}, "clip.yaml")
    with pytest.raises(RecipeError, match="chin"):
        build_tracker(recipe, start)
