"""Tuning: ranges as written, folds that never see their own clip, gains against spreads, the recipe that is written."""

from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, RecipeError, UsageError
from facetrack_cli.evaluation.experiments import tune
from facetrack_cli.evaluation.experiments.tune import EVIDENCE, Range, Search, Setting, Tuning, read_range
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.trajectory.diagnostics import EVIDENCE as DECLARED
from facetrack_cli.trajectory.diagnostics import Diagnostics
from facetrack_cli.trajectory.trajectory import one_part
from tests.support.results import table

SIGMA = Range("motion.sigma", low=0.01, high=1.0)


def tuning(scores, *, measure="points.mean_px", values=None, recipe="factorized", **more):
    """A search whose settings, the recipe as it is first, scored (settings, clips, seeds)."""
    scores = np.asarray(scores, float)
    values = values or [f"0.{i + 1}" for i in range(len(scores) - 1)]
    settings = [Setting((), scores[0]), *(Setting((v,), s) for v, s in zip(values, scores[1:], strict=True))]
    clips = tuple(Path(f"{name}.mp4") for name in "abcdefgh"[: scores.shape[1]])
    search = Search(trials=len(values))
    return Tuning(load_recipe(recipe), (SIGMA,), clips, measure, search, tuple(settings), len(values), **more)


@pytest.mark.parametrize(
    ("given", "one"),
    [
        ("motion.sigma=.02..0.3", Range("motion.sigma", low=0.02, high=0.3)),
        ("a.b = 0.5..3:log", Range("a.b", low=0.5, high=3, log=True)),
        ("a=1e-3..10.", Range("a", low=0.001, high=10)),
        ("a=2px..8px", Range("a", low=2, high=8, unit="px")),
        ("a=-3..-1", Range("a", low=-3, high=-1)),
        ("a=l1, huber", Range("a", ("l1", "huber"))),
        ("a=[2, 2],[3, 3],null", Range("a", ("[2, 2]", "[3, 3]", "null"))),
    ],
)
def test_ranges_are_read(given, one):
    assert read_range(given) == one


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("motion.sigma", "write KEY=LOW..HIGH"),
        ("=1..2", "write KEY=LOW..HIGH"),
        ("a=3..1", "smaller number first"),
        ("a=0..1:log", "begins above 0"),
        ("a=l1", "two or more different"),
        ("a=l1,l1", "two or more different"),
        ("a=1..x", "is no range"),
    ],
)
def test_what_is_no_range_is_refused(given, said):
    with pytest.raises(UsageError, match=said):
        read_range(given)


def test_whole_numbers_are_known_by_their_key_and_ends_are_checked():
    def load(values):
        return tune.load_with("factorized", (), values)

    assert tune.checked(read_range("filter.particles=50..400:log"), load).whole
    assert not tune.checked(read_range("likelihood.sigma=1..3"), load).whole
    assert tune.checked(read_range("confidence.memory=5..50"), load).whole
    for wrong in ("likelihood.sigma=-1..3", "likelihood.robust=l1,l3", "motion.sgma=1..2", "filter.particles=0.5..9"):
        with pytest.raises(RecipeError):
            tune.checked(read_range(wrong), load)


def test_values_are_written_short_and_stay_within_the_range():
    one = Range("a", low=0.02, high=0.123456)
    assert one.text(0.0623456) == "0.06235" and one.text(0.1234561) == "0.123456"
    assert (
        Range("a", low=1, high=9, whole=True).text(3) == "3" and Range("a", low=1, high=9, unit="px").text(3.0) == "3px"
    )


def test_a_fold_chooses_without_its_own_clip():
    # setting 0.1 is good on a and b, 0.2 excellent on c alone
    found = tuning([[[5, 5], [5, 5], [5, 5]], [[1, 1], [1, 1], [9, 9]], [[6, 6], [6, 6], [0, 0]]])
    a, b, c = found.folds
    assert (a.setting.values, b.setting.values, c.setting.values) == (("0.2",), ("0.2",), ("0.1",))
    assert c.gain.tolist() == [-4, -4] and a.gain.tolist() == [-1, -1], "on less-is-better gains are before - after"
    changed = np.stack([one.scores for one in found.settings])
    changed[:, 2] = np.random.default_rng(0).random((3, 2))
    assert tuning(changed).folds[2].setting.values == c.setting.values, "its own clip has no say"
    assert found.best().values == ("0.1",)


def test_the_recipe_as_it_is_is_kept_where_nothing_is_better():
    found = tuning([[[2, 2], [2, 2]], [[2, 2], [2, 2]]])
    assert found.best().values == () and found.gain == (0, 0)
    assert "not larger than the spread" in tune.verdict(found)


def test_the_gain_is_held_against_the_spread():
    rng = np.random.default_rng(0)
    before = 10 + 0.1 * rng.standard_normal((4, 5))
    clear = tuning([before, before - 2 + 0.1 * rng.standard_normal((4, 5))])
    gain, reach = clear.gain
    assert gain == pytest.approx(2, abs=0.2) and 0 < reach < 0.5
    assert "is larger than the spread: on 4 of 4" in tune.verdict(clear)
    uneven = before - np.array([[6], [0.5], [-0.2], [0.1]])  # one clip gains, the others hardly differ
    gains = tuning([before, uneven]).gain
    assert gains[1] > gains[0] > 0
    noisy = tuning([before, before - 0.5 + 5 * rng.standard_normal((4, 5))])
    assert noisy.gain[1] > 1
    more = tuning([before, before + 2], measure="points.auc")
    assert more.gain[0] == pytest.approx(2), "more is better"


def test_one_seed_of_a_random_tracker_and_one_clip_prove_nothing():
    one_seed = tuning([[[5.0], [5.0]], [[1.0], [1.0]]])
    assert one_seed.gain[1] == np.inf and "one seed tells nothing" in tune.verdict(one_seed)
    one_clip = tuning([[[5.0, 5.1]], [[1.0, 1.1]]])
    said = tune.verdict(one_clip)
    assert said.startswith("No clip was held out") and "flatters it" in said
    assert tune.sheet(one_clip).heads[0] == "clip"
    tune.as_json(one_seed), tune.as_json(one_clip)  # strict JSON has no infinity


def test_the_table_says_how_far_folds_differ():
    found = tuning(
        [[[5, 5], [5, 5], [5, 5]], [[1, 1], [1, 1], [9, 9]], [[6, 6], [6, 6], [0, 0]]], values=["0.3", "0.05"]
    )
    sheet = tune.sheet(found)
    assert [row[1] for row in sheet.rows] == ["0.05", "0.05", "0.3", ""]
    assert sheet.rows[0][2:] == ("5.00 ± 0.00", "6.00 ± 0.00", "-1.00")
    assert "motion.sigma: folds choose 0.05 to 0.3, 0.3 by all clips; 0.1 in the recipe as it is." in sheet.notes
    assert sheet.notes[-1] == tune.verdict(found)


def test_evidence_is_the_mean_of_known_frames_summed_over_targets():
    def reported(*values):
        return Diagnostics.of([DECLARED], list(range(len(values))), [{EVIDENCE: value} for value in values])

    rows = [one_part(name, "box", np.arange(3), x=np.ones(3)) for name in ("face", "hand")]
    known = {"face": reported(None, -2.0, -4.0), "hand": reported(None, 1.0, 2.0)}
    assert tune.evidence(table(Path("a.csv"), rows, diagnostics=known)) == pytest.approx(-3 + 1.5)
    for lacking in ({}, {"face": known["face"], "hand": reported(None, None, None)}):
        with pytest.raises(InputError, match="reports no evidence"):
            tune.evidence(table(Path("a.csv"), rows, diagnostics=lacking))
    assert not tune.less_is_better(EVIDENCE)


def test_the_recipe_that_is_written_is_the_best_one(tmp_path):
    found = tuning([[[5, 5], [5, 5]], [[1, 1], [1, 1]]], values=["0.0625"])
    text = tune.tuned_recipe(found, ["filter.particles=50", "confidence.patience=5"])
    assert text.startswith("# factorized, tuned: motion.sigma=0.0625, the best by points.mean_px on a.mp4, b.mp4.\n")
    assert "small templates on the mouth" in text and "  sigma: 0.0625\n" in text
    (tmp_path / "t.yaml").write_text(text, encoding="utf-8")
    asked = load_recipe("factorized", ["filter.particles=50", "confidence.patience=5", "motion.sigma=0.0625"])
    assert to_dict(load_recipe(str(tmp_path / "t.yaml"))) == to_dict(asked)
