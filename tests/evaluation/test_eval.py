"""facetrack eval and compare: all measures in one value, the order of recipes, what is printed and written."""

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
from click.testing import CliRunner

from facetrack_cli.__main__ import main
from facetrack_cli.cli.app import cli
from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation import compare, summary
from facetrack_cli.evaluation.accuracy import measure_boxes
from facetrack_cli.evaluation.compare import CUMULATIVE_AT, Comparison, Entry, Score, default_truth, rank, score_run
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.evaluation.summary import MEASURES, Sheet, evaluate, scalars
from facetrack_cli.report.figures import compare as figures
from facetrack_cli.runs.seeds import labels, variant
from facetrack_cli.trajectory.trajectory import joined, one_part

HEAD = "frame,target,part,x,y,w,h,confidence,status,std_x,std_y\n"
# left and right are 12 apart in frame 0: near is less than 2 off, failed more than 1.2
OURS = """\
0,face,left,10,10,,,1,init,0,0
0,face,right,22,10,,,1,init,0,0
1,face,left,11,10,,,0.9,tracked,1,1
1,face,right,22,13,,,0.2,lost,1,1
2,face,left,10,10,,,0.8,tracked,1,1
2,face,right,22,19,,,0.3,lost,1,1
"""
TRUTH = """\
frame,target,part,x,y,status
0,face,left,10,10,visible
0,face,right,22,10,visible
1,face,left,10,10,visible
1,face,right,22,10,visible
2,face,left,10,10,visible
2,face,right,22,10,hidden
"""


TABLES = ("Points", "Lost", "Confidence", "Spread", "Jitter")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with ours.csv and truth.csv, which is the current one."""
    monkeypatch.chdir(tmp_path)
    Path("ours.csv").write_text(HEAD + OURS)
    Path("truth.csv").write_text(TRUTH)
    return tmp_path


def run(*arguments, code=0, capsys=None):
    assert main(["eval", *arguments]) == code
    return capsys.readouterr() if capsys else None


def measured(capsys, *arguments):
    """What `--json -` says."""
    return json.loads(run("ours.csv", "--truth", "truth.csv", "--json", "-", *arguments, capsys=capsys).out)


def pair(part="box", **columns):
    """A pair of series from `ours_*` and `true_*` columns."""
    frame, target = columns.pop("frame"), columns.pop("target", "head")
    both = ({k.removeprefix(who): v for k, v in columns.items() if k.startswith(who)} for who in ("ours_", "true_"))
    return Pair(*(one_part(target, part, frame, **own) for own in both))


def test_each_measure_knows_which_way_is_better():
    ways = {way: {name for name in MEASURES if MEASURES[name].better == way} for way in ("more", "less", None)}
    assert {"points.auc", "boxes.success_auc", "lost.recall", "confidence.auroc_visible"} < ways["more"]
    assert {"points.mean_px", "points.missing", "confidence.brier"} < ways["less"]
    assert {"points.rows", "boxes.rows", "coverage.within_90", "lost.called"} < ways[None]


def test_figures_of_points(folder, capsys):
    found = measured(capsys)
    points = found["all"]["points"]
    assert points["rows"] == 5 and points["mean_px"] == pytest.approx(4 / 5) and points["hidden_mean_px"] == 9
    assert points["failure_rate"] == 1 / 5 and points["mean_normalised"] == pytest.approx(4 / 5 / 12)
    assert [one["part"] for one in found["parts"]] == ["left", "right"]
    assert found["parts"][1]["points"]["mean_px"] == 1.5
    assert found["all"]["lost"]["precision"] == 0.5 and found["all"]["lost"]["precision_gone"] == 1.0
    assert found["all"]["confidence"]["auroc_near"] == 1.0
    assert found["all"]["coverage"]["within_50"] == pytest.approx(2 / 3)
    assert found["all"]["coverage"]["rows"] == 3  # the given row is left out, and the hidden one
    assert "boxes" not in found["all"] and "12.0 px" in found["units"]["face"]
    assert found["schema"] == "facetrack-evaluation" and found["version"] == 1


def test_scalars_leave_out_what_is_not_defined():
    one = pair("nose", frame=[0, 1], ours_x=[1, 1], ours_y=[0, 0], true_x=[0, 0], true_y=[0, 0])
    found = evaluate([one], ["as given"])
    assert scalars(found)["points.mean_px"] == 1.0 and "points.auc" not in scalars(found)
    assert not {name for name in scalars(found) if name.startswith(("lost", "boxes", "confidence"))}
    assert all(math.isfinite(value) for value in scalars(found).values())
    assert found.notes[0] == "as given"
    assert any("--normalise PIXELS" in note for note in found.notes), "one point has no size"


def boxes(count=30, *, seed=0, target="head", **more):
    random = np.random.default_rng(seed)
    truth = {"true_x": np.arange(count) + 50.0, "true_y": np.full(count, 40.0)}
    size = {f"{who}_{side}": np.full(count, 20.0) for who in ("ours", "true") for side in "wh"}
    ours = {"ours_x": truth["true_x"] + random.normal(0, 6, count), "ours_y": truth["true_y"]}
    return pair(frame=np.arange(count), target=target, **{**truth, **size, **ours, **more})


def test_boxes_are_measured_as_boxes_and_hidden_ones_apart():
    status = ["visible"] * 20 + ["hidden"] * 10
    # the last three rows are corrections, which count nowhere
    one = boxes(true_status=status, ours_status=["init"] + ["tracked"] * 26 + ["init", "absent", "absent"])
    found = evaluate([one])
    assert found.all.points is None
    twin = measure_boxes(one.ours.boxes, one.truth.boxes, visible=np.arange(30) < 20)
    assert scalars(found)["boxes.success_auc"] == twin.success_auc and scalars(found)["boxes.ao"] == twin.ao
    assert scalars(found)["boxes.rows"] == 20
    overlap = iou(one.ours.boxes, one.truth.boxes)
    assert scalars(found)["boxes.hidden_rows"] == 7
    assert scalars(found)["boxes.hidden_overlap"] == pytest.approx(overlap[20:27].mean())
    near = overlap > 0.5
    assert scalars(found)["lost.tracked_near"] == pytest.approx(near[1:27].mean())
    assert "sqrt(width * height)" in found.units["head"]


def test_several_boxes_are_measured_as_if_their_rows_were_of_one():
    given = {"ours_status": ["init", *["tracked"] * 6]}
    one, other = boxes(30, seed=1), boxes(7, seed=2, target="hand", **given)
    both = measure_boxes(
        np.concatenate([one.ours.boxes, other.ours.boxes]),
        np.concatenate([one.truth.boxes, other.truth.boxes]),
        init=np.isin(np.arange(37), [0, 30]),
    )
    for name, value in vars(evaluate([one, other]).all.boxes).items():
        np.testing.assert_array_equal(value, getattr(both, name), err_msg=name)
    found = evaluate([one, other])
    assert [m.target for m in found.parts] == ["head", "hand"] and found.all.target == "all"
    assert found.all.figures["boxes.rows"] == 37


def test_a_box_without_our_size_is_measured_as_a_point_and_truth_that_is_lost_is_not_believed():
    found = evaluate([boxes(ours_w=np.full(30, np.nan), ours_h=np.full(30, np.nan))])
    assert found.all.boxes is None and found.all.points.rows == 30
    assert found.all.points.mean_normalised == pytest.approx(found.all.points.mean_px / 20)
    ours, status = {"ours_x": [0, 0, 0], "ours_y": [0, 0, 0]}, ["init", "tracked", "lost"]  # a trajectory as truth
    found = evaluate([pair("nose", frame=[0, 1, 2], **ours, true_x=[0, 1, 50], true_y=[0, 0, 0], true_status=status)])
    assert found.counts["visible"] == 2 and found.all.points.mean_px == 0.5
    with pytest.raises(InputError, match="no row"):
        evaluate([pair("nose", frame=[])])


def test_the_tables(folder):
    done = CliRunner().invoke(cli, ["eval", "ours.csv", "--truth", "truth.csv"])
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert lines[0].startswith("ours.csv against truth.csv (read as ")
    assert lines[1] == "3 frames, 0 to 2; rows, one a frame and part: 5 visible, 1 hidden"
    titles = [line.split(":")[0] for line in lines if line.startswith(TABLES)]
    assert titles == [*TABLES]
    points = lines[lines.index(next(line for line in lines if line.startswith("Points"))) :][2:8]
    cells = [line.split() for line in points[3:]]
    assert cells == [
        ["left", "3", "0.33", "0.00", "0.47", "0.90", "2.8", "0.0", "0.722", "0", "–", "0"],
        ["right", "2", "1.50", "1.50", "1.50", "2.85", "12.5", "50.0", "0.500", "1", "9.00", "0"],
        ["all", "5", "0.80", "0.00", "1.17", "2.60", "6.7", "20.0", "0.633", "1", "9.00", "0"],
    ]
    assert len({len(line) for line in points[3:]}) == 1, "the columns are aligned"
    assert "\x1b" not in done.stdout and "nan" not in done.stdout and max(map(len, lines)) <= 130
    assert not [line for line in lines if line != line.rstrip()]


def test_a_row_for_a_shell_loop(folder, capsys):
    out = run("ours.csv", "--truth", "truth.csv", "--csv", "-", capsys=capsys).out
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [*rows[0]] == ["trajectory", "truth", "target", "part", *MEASURES]
    assert [(row["target"], row["part"]) for row in rows] == [("face", "left"), ("face", "right"), ("all", "")]
    assert {(row["trajectory"], row["truth"]) for row in rows} == {("ours.csv", "truth.csv")}
    assert float(rows[-1]["points.mean_px"]) == pytest.approx(0.8)
    assert rows[-1]["boxes.ao"] == ""


def test_files_are_written_beside_the_tables(folder, capsys):
    wanted = ["--json", "a.json", "--csv", "a.csv"]
    said = run("ours.csv", "--truth", "truth.csv", *wanted, capsys=capsys)
    said_of = [f"ours.csv -> a.{kind}" for kind in ("json", "csv")]
    assert "Points: " in said.out and said.err.splitlines() == said_of
    assert json.loads(Path("a.json").read_text())["all"]["points"]["rows"] == 5
    assert Path("a.csv").read_text().count("\n") == 4
    Path("a.csv").write_text("mine")
    said = run("ours.csv", "--truth", "truth.csv", "--csv", "a.csv", code=2, capsys=capsys)
    assert said.out == "" and "a.csv: exists already" in said.err and Path("a.csv").read_text() == "mine"
    said = run("ours.csv", "--truth", "truth.csv", "--csv", "a.csv", "--overwrite", "--json", "-", capsys=capsys)
    assert json.loads(said.out) and Path("a.csv").read_text().startswith("trajectory,")


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["--json", "-", "--csv", "-"], 2, "both name standard output"),
        (["--csv", "."], 2, "is a folder"),
        (["--csv", "no/where.csv"], 2, "there is no folder no"),
        (["--csv", "ours.csv", "--overwrite"], 2, "ours.csv: is read here"),
        *(
            (["--normalise", how], 2, f"{how!r}: give size, two")
            for how in ("furlong", "a:", "a:a", "a:b:c", "0", "nan", "3px")
        ),
        (["--normalise", "left:chin"], 2, "the ground truth has no chin; it has left, right"),
        *((["--failure", share], 2, f"{share!r}: give a normalised error above 0") for share in ("0", "nan", "x")),
        (["--truth", "none.csv"], 3, "none.csv: cannot be read: No such file"),
    ],
)
def test_what_is_refused_in_one_line(folder, capsys, arguments, code, told):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    said = run("ours.csv", "--truth", "truth.csv", *arguments, code=code, capsys=capsys)
    assert told in said.err and said.err.count("\n") == 1 and said.out == ""
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_options_change_what_they_say(folder, capsys):
    assert measured(capsys, "--normalise", "3")["all"]["points"]["mean_normalised"] == pytest.approx(0.8 / 3)
    assert measured(capsys, "--failure", "0.05")["all"]["points"]["failure_rate"] == 2 / 5
    assert measured(capsys, "--normalise", "left:right")["units"]["face"].startswith("left to right in each frame")
    found = measured(capsys, "--target", "face/left")
    assert [one["part"] for one in found["parts"]] == ["left"]
    assert "12.0 px" in found["units"]["face"], "the size is still that of the whole truth"
    Path("truth.csv").write_text(TRUTH.replace("face", "anna"))
    assert "12.0 px" in measured(capsys, "--target", "face/left")["units"]["face"], "whatever the target's name there"
    assert "anna of the ground truth is taken for face: both have one target" in measured(capsys)["notes"]


def test_the_truth_beside_the_clip(folder, capsys):
    source = {"path": "clip.mp4", "size": [64, 48], "fps": 25.0}
    part = {"part": "nose", "x": 3.0, "y": 4.0, "status": "init"}
    frames = [{"frame": 0, "time_s": 0.0, "targets": [{"target": "face", "parts": [part]}]}]
    head = {"schema": "facetrack-trajectory", "version": 1, "source": source}
    Path("run").mkdir()
    Path("run/trajectory.json").write_text(json.dumps({**head, "frames": frames}))
    said = run("run", code=3, capsys=capsys)
    assert "there is neither clip.truth.csv nor groundtruth.csv beside it" in said.err
    Path("clip.truth.csv").write_text("frame,target,part,x,y\n0,face,nose,0,0\n")
    said = run("run", capsys=capsys)
    assert said.out.startswith("run/trajectory.json against clip.truth.csv")
    assert "does not name its clip" in run("ours.csv", code=2, capsys=capsys).err


def test_what_is_not_there_is_not_measured(folder, capsys):
    Path("ours.csv").write_text(HEAD + "".join(OURS.splitlines(keepends=True)[:2]))
    out = run("ours.csv", "--truth", "truth.csv", "--partial", capsys=capsys).out
    assert not any(f"{title}: " in out for title in TABLES[2:4])
    for name in ("ours.csv", "truth.csv"):
        Path(name).write_text("frame,target,part,x,y\n0,face,left,1,1\n0,face,right,9,1\n1,face,left,1,1\n")
    out = run("ours.csv", "--truth", "truth.csv", capsys=capsys).out
    assert not any(f"{title}: " in out for title in TABLES[1:4])


def test_results_of_another_tracker_are_measured_as_ours(folder, capsys):
    rows = [(i, 30 + 3 * i, 40 + i % 5, 20, 10) for i in range(30)]
    lines = [f"{i},head,box,{x},{y},{w},{h},,{'tracked' if i else 'init'},,\n" for i, x, y, w, h in rows]
    Path("box.csv").write_text(HEAD + "".join(lines))
    true = "".join(f"{i},{x - 9.5 + i % 3},{y - 4.5},{w},{h}\n" for i, x, y, w, h in rows)
    Path("boxes.csv").write_text("frame,x,y,w,h\n" + true)
    expected = None
    for form in (None, "otb", "got10k", "mot", "vot"):
        if form is not None:
            assert main(["export", "box.csv", "--to", form, "-o", f"{form}.txt"]) == 0
        capsys.readouterr()
        out = run(f"{form}.txt" if form else "box.csv", "--truth", "boxes.csv", "--json", "-", capsys=capsys).out
        found = json.loads(out)
        assert ("trajectory_read_as" in found) == (form is not None)
        assert "--truth-format" not in found.get("trajectory_read_as", "")
        expected = expected or found["all"]["boxes"]
        assert found["all"]["boxes"] == expected
    out = run("otb.txt", "--format", "vot", "--truth", "boxes.csv", "--json", "-", capsys=capsys).out
    assert json.loads(out)["all"]["boxes"]["success_auc"] < expected["success_auc"]  # a pixel off


# --- facetrack compare

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


def walking_box(left, frames=40, size=20.0, status="tracked"):
    frame = np.arange(frames)
    x = np.broadcast_to(left, frames) + (size - 1) / 2
    both = np.full(frames, size)
    return (one_part("face", "box", frame, x=x, y=np.full(frames, 30.0), w=both, h=both, status=[status] * frames),)


def test_a_run_of_boxes_is_scored():
    truth = truth_of(walking_box(50.0, status="visible"))
    off = np.where(np.arange(40) < 36, 0.0, 19.5)  # the last tenth is off
    good, lost = (score_run(run_of(walking_box(50 + x)), truth) for x in (np.zeros(40), off))
    assert good.figures["boxes.success_auc"] == pytest.approx(20 / 21)
    assert good.success.shape == (21,) and good.precision.shape == (51,) and good.cumulative is None
    assert not good.failed and lost.failed
    for first, failed in ((37, True), (38, False)):  # most of the last four, which are a tenth
        off = np.where(np.arange(40) < first, 0.0, 19.5)
        assert score_run(run_of(walking_box(50 + off)), truth).failed is failed
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
