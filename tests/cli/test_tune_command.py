"""facetrack tune and facetrack motion fit as their users meet them."""

import json
import sys
from pathlib import Path

import pytest

from facetrack_cli.core.errors import ExitCode, RecipeError
from facetrack_cli.evaluation.experiments import tune
from facetrack_cli.recipe.load import load_recipe
from tests.support.samples import FOLDER

CLIPS = [FOLDER / "expressions.mp4", FOLDER / "occlusion.mp4"]
SHORT = ["--stop", "8", "--seeds", "2", "--trials", "3", "-q"]
SIGMA = ["--set-range", "motion.sigma=0.02..0.3:log"]


@pytest.fixture
def clips():
    return FOLDER


def test_tune_reports_held_out_clips_and_writes_the_recipe(facetrack):
    pytest.importorskip("optuna")
    code, out, err = facetrack("tune", "factorized", *CLIPS, *SIGMA, *SHORT, "-o", "tuned.yaml")
    assert code == 0 and err == ""
    for said in ("held-out clip", "expressions.mp4", "occlusion.mp4", "mean", "motion.sigma: ", "the spread"):
        assert said in out
    best = load_recipe("tuned.yaml").motion.sigma.root.value
    assert 0.02 <= best <= 0.3
    code, out, err = facetrack("tune", "factorized", *CLIPS, *SIGMA, *SHORT, "-o", "tuned.yaml")
    assert code == ExitCode.USAGE and "--overwrite" in err and not out, "said before anything runs"


def test_tuning_by_evidence_needs_no_ground_truth(facetrack, monkeypatch, tmp_path):
    pytest.importorskip("optuna")
    for name in ("expressions.mp4", "expressions.init.yaml"):
        (tmp_path / name).symlink_to(FOLDER / name)
    monkeypatch.setattr(tune, "evidence", lambda trajectory: -float(abs(trajectory.x[10:]).sum() % 7))
    code, out, err = facetrack("tune", "factorized", tmp_path / "expressions.mp4", *SIGMA, *SHORT, "--by", "evidence")
    assert code == 0 and err == ""
    assert "Evidence compares settings of motion, filter and prior" in out and "No clip was held out" in out


def test_settings_that_cannot_run_are_left_out(facetrack, monkeypatch):
    pytest.importorskip("optuna")
    load = tune.load_with

    def refusing(name, overrides, values):
        if values and values[0] != "motion.sigma=0.02" and float(values[0].partition("=")[2]) < 0.1:
            raise RecipeError("too little")
        return load(name, overrides, values)

    monkeypatch.setattr(tune, "load_with", refusing)
    code, out, _ = facetrack("tune", "factorized", *CLIPS, *SIGMA, *SHORT, "--json")
    found = json.loads(out)
    assert code == 0 and found["refused"] == ["too little"] and found["trials"] == 3 and len(found["settings"]) == 3


def test_an_end_that_the_recipe_refuses_is_an_error(facetrack):
    ranges = ["--set-range", "likelihood.robust=l1,huber"]
    code, _, err = facetrack("tune", "factorized", *CLIPS, *ranges, *SHORT)
    assert code == ExitCode.USAGE and "needs likelihood.scale" in err


def test_a_stop_reports_what_is_there(facetrack, monkeypatch):
    pytest.importorskip("optuna")
    scores, calls = tune._scores, []

    def interrupted(recipe, cases, measure, search, stop, *more):
        calls.append(recipe)
        if len(calls) == 3:
            stop.code = ExitCode.INTERRUPTED
        return scores(recipe, cases, measure, search, stop, *more)

    monkeypatch.setattr(tune, "_scores", interrupted)
    code, out, _ = facetrack("tune", "factorized", *CLIPS, *SIGMA, *SHORT)
    assert code == ExitCode.INTERRUPTED and "Interrupted after 1 of 3 trials." in out
    calls[:] = [None, None]
    code, out, err = facetrack("tune", "factorized", *CLIPS, *SIGMA, *SHORT[:-1])
    assert code == ExitCode.INTERRUPTED and not out and "before the recipe as it is was measured" in err


def test_without_optuna_one_line_says_what_to_install(facetrack, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    code, out, err = facetrack("tune", "factorized", *CLIPS, *SIGMA, *SHORT)
    assert code == ExitCode.USAGE and not out
    assert err == "facetrack: error: trials need optuna, which is not installed: pip install 'facetrack[tune]'\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--set-range", "motion.sigma=3..1"], "smaller number first"),
        ([*SIGMA, *SIGMA], "given twice"),
        ([*SIGMA, "--measure", "beauty"], "--measure beauty: is nothing to rank by"),
        ([*SIGMA, "--measure", "points.auc", "--by", "evidence"], "--measure is one of ground truth"),
        ([*SIGMA, "--truth", "a.csv"], "1 files for 2 clips"),
        (["--set-range", "seed=1..5"], "seed has no effect here"),
        (["--set-range", "motion.sigma=-1..1"], "must be a length"),
        (["--set-range", "motion.sgma=1..2"], 'did you mean "sigma"'),
    ],
)
def test_what_makes_no_sense_is_refused(facetrack, arguments, said):
    code, out, err = facetrack("tune", "factorized", *CLIPS, *arguments)
    assert code == ExitCode.USAGE and said in err and not out


def test_a_tracker_without_particles_has_no_evidence(facetrack):
    code, _, err = facetrack("tune", "mil", *CLIPS, "--by", "evidence", "--set-range", "tracker=mil,csrt")
    assert code == ExitCode.USAGE and "mil is no particle filter, and so has no evidence" in err


def test_motion_fit_prints_or_writes_a_block(facetrack):
    truth = FOLDER / "map.truth.csv"
    code, out, err = facetrack("motion", "fit", truth)
    assert code == 0 and err == "" and "\nmotion:\n  type: first_order\n  position: {A: [[1, " in out
    code, printed, err = facetrack("motion", "fit", truth, "-o", "motion.yaml")
    assert code == 0 and not printed and Path("motion.yaml").read_text(encoding="utf-8") == out
    code, _, err = facetrack("motion", "fit", truth, "-o", "motion.yaml")
    assert code == ExitCode.USAGE and "--overwrite" in err
    code, out, _ = facetrack("motion", "fit", FOLDER / "expressions.truth.csv", "--target", "face/nose")
    assert code == ExitCode.INPUT
