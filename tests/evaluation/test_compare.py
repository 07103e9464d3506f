"""facetrack compare: the order of recipes, what a failure is, and tables, narrow and in any encoding."""

import csv
import io
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.evaluation import compare, summary
from facetrack_cli.evaluation.compare import CUMULATIVE_AT, Comparison, Entry, Score, default_truth, rank, score_run
from facetrack_cli.evaluation.summary import Sheet
from facetrack_cli.report.figures import compare as figures
from facetrack_cli.runs.seeds import labels, variant
from facetrack_cli.trajectory.trajectory import joined, one_part

MEASURE = "points.mean_px"


def score(seed, value, *, measure=MEASURE, rate=100.0, frames=5, failed=False):
    figures = {} if value is None else {measure: value}
    frame = np.arange(frames)
    return Score(seed, figures, failed, rate, frame, frame + float(seed), np.array([2]))


def entry(label, values, *, deterministic=False, **more):
    scores = [score(seed, value, **more) for seed, value in enumerate(values)]
    return Entry(label, scores, recipe=SimpleNamespace(random=False) if deterministic else None)


def places(*entries, measure=MEASURE):
    ranked = rank(entries, measure)
    return {one.label: "-" if place is None else "-".join(map(str, dict.fromkeys(place))) for one, place in ranked}


AROUND = np.array([-1.0, 1.0]) * 0.1  # two runs: the standard error is half their distance, the interval 0.2 wide
A, B, C = (entry(name, middle + AROUND) for name, middle in (("a", 1.0), ("b", 1.3), ("c", 1.6)))
FIXED, SAME, OTHER = (entry(n, [v], deterministic=True) for n, v in (("fixed", 2.0), ("same", 2.0), ("other", 3.0)))
BROKEN = Entry("broken", error=InputError("no box"))


@pytest.mark.parametrize(
    ("entries", "order"),
    [
        ([entry("bad", [9, 8, 10]), entry("good", [1, 1.1, 0.9]), B], {"good": "1-2", "b": "1-2", "bad": "3"}),
        ([A, B, C], {"a": "1-2", "b": "1-3", "c": "2-3"}),  # a and b overlap, b and c too, a and c do not
        ([entry("single", [1.0]), FIXED, OTHER], {"single": "1-3", "fixed": "1-2", "other": "2-3"}),
        ([OTHER, FIXED], {"fixed": "1", "other": "2"}),  # one run of a deterministic tracker tells all
        ([FIXED, SAME], {"fixed": "1-2", "same": "1-2"}),
        ([BROKEN, entry("good", [1, 1]), entry("blind", [None])], {"good": "1", "broken": "-", "blind": "-"}),
    ],
)
def test_what_overlaps_shares_its_rank(entries, order):
    assert [*places(*entries).items()] == [*order.items()]


def test_more_is_better_for_shares_and_intervals_follow_from_the_spread():
    low, high = (entry(n, [v, v + 0.01], measure="boxes.success_auc") for n, v in (("low", 0.2), ("high", 0.8)))
    assert list(places(low, high, measure="boxes.success_auc")) == ["high", "low"]
    assert A.interval(MEASURE) == pytest.approx((0.8, 1.2))
    two = Entry("two", [score(0, 1.0, rate=100), score(1, 3.0, rate=300)])
    assert two.mean(MEASURE) == 2 and two.spread(MEASURE) == pytest.approx(math.sqrt(2))
    assert two.frames_per_s == pytest.approx(150), "two clips of n frames take n / 100 + n / 300 seconds"
    assert entry("single", [1.0]).spread(MEASURE) is None


def test_ranking_by_what_cannot_rank_is_refused():
    compare.check_measure("points.median_px")
    for measure, message in (("median_px", r"points\.median_px"), ("points.rows", "nothing to rank by")):
        with pytest.raises(UsageError, match=message):
            compare.check_measure(measure)


def test_errors_are_aligned_by_frame(monkeypatch):
    short = Entry("short", [score(0, 1.0, frames=3)])
    long = Entry("long", [score(0, 1.0), score(1, 1.0)])
    drawn = []
    monkeypatch.setattr(figures, "error_over_time_figure", lambda *what, **_: drawn.append(what))
    monkeypatch.setattr(figures, "render", lambda _: b"")
    [_] = figures.compare_figures(Comparison(Path("clip"), Path("truth"), 2, (short, long, BROKEN), MEASURE))
    [(frame, found, hidden)] = drawn
    assert hidden.tolist() == [False, False, True, False, False]
    assert frame.tolist() == [0, 1, 2, 3, 4] and list(found) == ["short", "long"]
    np.testing.assert_array_equal(found["short"], [[0, 1, 2, np.nan, np.nan]])
    np.testing.assert_array_equal(found["long"], [[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]])


def points(offset, frames=60, status="tracked"):
    """A face of two points 40 px apart that walks to the right; ours is `offset` (T,) pixels below the ground truth."""
    frame = np.arange(frames)
    x = 50 + 3 * np.abs(np.sin(frame / 5))
    same = {"y": 20 + np.broadcast_to(offset, frames), "status": np.broadcast_to(status, frames)}
    return tuple(one_part("face", part, frame, x=x + dx, **same) for part, dx in (("nose", 0), ("chin", 40)))


def run_of(made, seed=0):
    return SimpleNamespace(label="r", seed=seed, trajectory=joined(made, path=Path("run")), frames_per_s=50.0)


def truth_of(made):
    return joined(made, path=Path("clip.truth.csv"))


def test_a_run_of_points_is_scored():
    truth = truth_of(points(0.0, status="visible"))
    found = score_run(run_of(points(2.0)), truth)
    assert found.figures["points.mean_px"] == pytest.approx(2)
    assert found.figures["points.mean_normalised"] == pytest.approx(2 / 40)
    assert np.allclose(found.error, 2) and found.frame.tolist() == list(range(60)) and not found.hidden.size
    status = np.where((np.arange(60) >= 20) & (np.arange(60) < 30), "hidden", "visible")
    hidden = score_run(run_of(points(0.0)), truth_of(points(0.0, status=status))).hidden
    assert hidden.tolist() == list(range(20, 30))
    assert found.success is None and not found.failed
    assert found.cumulative[CUMULATIVE_AT < 0.049].max() == 0 and found.cumulative[CUMULATIVE_AT > 0.051].min() == 1
    lost = np.where(np.arange(60) < 40, 0.0, 15.0)  # more than a quarter of 40 px for most of the last 25 rows
    assert score_run(run_of(points(lost)), truth).failed
    back = np.where(np.arange(60) < 30, 15.0, 0.0)
    assert not score_run(run_of(points(back)), truth).failed


def test_the_truth_of_the_frames_asked_for_counts():
    truth = truth_of(points(np.where(np.arange(60) < 30, 0.0, 30.0), status="visible"))
    run = run_of(tuple(one.take(one.frame < 30) for one in points(0.0)))
    assert score_run(run, truth, stop=30).figures["points.mean_px"] == 0
    with pytest.raises(InputError):  # the clip ended before the ground truth did
        score_run(run, truth)
    late = run_of(tuple(one.take(one.frame > 40) for one in points(0.0)))
    with pytest.raises(InputError, match="no row from frame 41 to 39"):
        score_run(late, truth, stop=40)


def boxes(left, frames=40, size=20.0, status="tracked"):
    frame = np.arange(frames)
    x = np.broadcast_to(left, frames) + (size - 1) / 2
    both = np.full(frames, size)
    return (one_part("face", "box", frame, x=x, y=np.full(frames, 30.0), w=both, h=both, status=[status] * frames),)


def test_a_run_of_boxes_is_scored():
    truth = truth_of(boxes(50.0, status="visible"))
    off = np.where(np.arange(40) < 36, 0.0, 19.5)  # the last tenth is off
    good, lost = (score_run(run_of(boxes(50 + x)), truth) for x in (np.zeros(40), off))
    assert good.figures["boxes.success_auc"] == pytest.approx(20 / 21)
    assert good.success.shape == (21,) and good.precision.shape == (51,) and good.cumulative is None
    assert not good.failed and lost.failed
    for first, failed in ((37, True), (38, False)):  # most of the last four, which are a tenth
        off = np.where(np.arange(40) < first, 0.0, 19.5)
        assert score_run(run_of(boxes(50 + off)), truth).failed is failed
    assert lost.error[-1] == pytest.approx(19.5)


@pytest.mark.parametrize(
    ("text", "name", "overrides"),
    [
        ("sir", "sir", ()),
        ("sir:filter.particles=50", "sir", ("filter.particles=50",)),
        ("a.yaml:seed=1,target.windows=[25,25],x=2", "a.yaml", ("seed=1", "target.windows=[25,25]", "x=2")),
        ("odd:name", "odd:name", ()),
    ],
)
def test_variants(text, name, overrides):
    assert variant(text) == (name, overrides)


def test_labels_differ():
    assert labels(["sir", "configs/mine.yaml", "sir:seed=1,x=2"]) == ["sir", "mine", "sir:seed=1,x=2"]
    assert labels(["a/mine.yaml", "b/mine.yaml", "sir"]) == ["a/mine.yaml", "b/mine.yaml", "sir"]
    with pytest.raises(UsageError, match="sir is given twice"):
        labels(["sir", "mil", "sir"])


def test_the_truth_is_found_beside_the_clip(tmp_path):
    clip, folder = tmp_path / "clip.mp4", tmp_path / "img"
    clip.write_bytes(b"\0")
    folder.mkdir()
    with pytest.raises(InputError, match=r"clip\.truth\.csv"):
        default_truth(clip)
    (tmp_path / "groundtruth.csv").touch()
    assert default_truth(clip) == default_truth(folder) == tmp_path / "groundtruth.csv"
    (folder / "groundtruth.csv").touch()
    assert default_truth(folder) == folder / "groundtruth.csv"
    (tmp_path / "clip.truth.csv").touch()
    assert default_truth(clip) == tmp_path / "clip.truth.csv"


@pytest.fixture
def comparison():
    ranked = "points.mean_normalised"
    entries = (
        entry("slow", [0.05, 0.07], measure=ranked, rate=10.0, failed=True),
        entry("quick", [0.01, 0.012], measure=ranked, rate=1000.0),
        Entry("box|only", error=InputError("the ground truth has no box")),
    )
    return Comparison(Path("a/clip.mp4"), Path("a/clip.truth.csv"), 2, entries, ranked)


def test_the_table(comparison):
    found = comparison.sheet()
    quick, slow, broken = found.rows
    assert quick == ("1", "quick", "1.10 ± 0.14", "–", "–", "0 of 2", "1,000", "×1.00")
    assert slow == ("2", "slow", "6.00 ± 1.41", "–", "–", "2 of 2", "10", "×100.00")
    assert broken[:2] == ("–", "box|only") and "not run" in broken
    notes = " ".join(found.notes)
    assert "standard deviation over 2 seeds" in notes and "box|only: not run: the ground truth has no box" in notes


def test_the_data(comparison):
    rows = list(csv.DictReader(io.StringIO(comparison.csv())))
    assert [(row["recipe"], row["seed"], row["failed"], row["error"]) for row in rows] == [
        ("slow", "0", "1", ""), ("slow", "1", "1", ""), ("quick", "0", "0", ""), ("quick", "1", "0", ""),
        ("box|only", "", "", "the ground truth has no box"),
    ]  # fmt: skip
    assert rows[1]["points.mean_normalised"] == "0.07"
    found = json.loads(comparison.json())
    assert [one["label"] for one in found["recipes"]] == ["quick", "slow", "box|only"]
    assert [one["rank"] for one in found["recipes"]] == [[1, 1], [2, 2], None]
    assert found["recipes"][0]["mean"] == {"points.mean_normalised": 0.011}
    assert found["recipes"][1]["runs"][1] == {
        "seed": 1, "failed": True, "frames_per_s": 10.0, "points.mean_normalised": 0.07,
    }  # fmt: skip


GIVEN = Sheet(
    "a title",
    ("rank", "recipe", "mean\nerror, px ↓", "failed"),
    (("1", "sir", "12.34 ± 0.56", "0 of 10"),),
    ("A note. " * 9,),
    left=(1,),
)


@pytest.mark.parametrize("width", [20, 45, 100])
def test_a_table_loses_no_column_where_there_is_little_room(capsys, monkeypatch, width):
    monkeypatch.setattr(summary, "WIDTH", width)
    GIVEN.show()
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split() == ["rank", "recipe", "error,", "px", "↓", "failed"]
    [row] = [line for line in lines if "sir" in line]
    assert row.split() == ["1", "sir", "12.34", "±", "0.56", "0", "of", "10"]
    notes = lines[lines.index(row) + 2 :]
    assert max(map(len, notes)) <= width and all(line == line.rstrip() for line in lines)


def test_names_that_are_no_text_are_printed_escaped():
    code = "import click\nfrom facetrack_cli import __main__ as m\nm._open_streams()\nclick.echo('caf\\udce9 \\u2193')"
    env = {**os.environ, "PYTHONIOENCODING": "cp1252"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=True)
    assert done.stdout == b"caf\\udce9 \\u2193\n"
