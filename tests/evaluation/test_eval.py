"""facetrack eval: one value of all measures, and the command that prints and writes it."""

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from facetrack_cli.__main__ import main
from facetrack_cli.cli.app import cli
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation.accuracy import measure_boxes
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.evaluation.summary import MEASURES, evaluate, scalars
from facetrack_cli.trajectory.trajectory import one_part

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
