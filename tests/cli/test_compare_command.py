"""facetrack compare as its users meet it: tables, files, exit codes."""

import csv
import json
from pathlib import Path

import pytest

from facetrack_cli.core.errors import ExitCode, UsageError
from facetrack_cli.evaluation import compare
from facetrack_cli.report.figures import style
from facetrack_cli.runs import seeds as runs
from tests.support.damage import raising
from tests.support.samples import FOLDER

CLIP = FOLDER / "occlusion.mp4"
TWO = ["--config", "sir:filter.particles=30", "--config", "independent:filter.particles=10"]
SHORT = ["--stop", "12", "--seeds", "2"]
PNG = b"\x89PNG"


def test_compare_writes_a_table_data_and_plots(facetrack):
    code, out, err = facetrack("compare", CLIP, *TWO, *SHORT)
    assert code == 0, err
    folder = Path("occlusion-compare")
    names = {"compare.json", "compare.csv", "cumulative.png", "error.png"}
    assert {path.name for path in folder.iterdir()} == names
    assert all((folder / name).read_bytes()[:4] == PNG for name in names if name.endswith("png"))
    assert max(map(len, out.splitlines())) <= 100 and "\x1b" not in out
    for expected in ("sir: ", "filter.particles=30", "±", "0 of 2", "per s", "×1.00", "frames 0 to 11"):
        assert expected in out, expected
    assert "error.png" in err and "occlusion-compare" in err

    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    assert found["complete"] and found["ranked_by"] == "points.mean_normalised" and found["seeds"] == 2
    recipe = {one["label"]: one["recipe"] for one in found["recipes"]}["sir:filter.particles=30"]
    assert recipe["filter"]["particles"] == 30

    code, out, err = facetrack("compare", CLIP, *TWO, *SHORT)
    assert code == ExitCode.USAGE and "--overwrite" in err and err.count("\n") == 1, "said before anything runs"


def test_processes_change_no_number_and_plots_need_matplotlib(facetrack, monkeypatch):
    arguments = ["compare", CLIP, *TWO, *SHORT, "-q", "--no-plots", "--rank-by", "points.median_px", "-o"]
    found = []
    for folder, more in (("one", []), ("two", ["-j", "2"])):
        code, out, _ = facetrack(*arguments, folder, *more)
        assert code == 0 and "frames 0 to 11" in out
        assert json.loads(Path(folder, "compare.json").read_text())["ranked_by"] == "points.median_px"
        assert not list(Path(folder).glob("*.png"))
        rows = list(csv.DictReader(Path(folder, "compare.csv").read_text(encoding="utf-8").splitlines()))
        assert [row["seed"] for row in rows] == ["0", "1", "0", "1"] and float(rows[0]["points.mean_px"]) > 0
        assert float(rows[0].pop("frames_per_s")) > 0
        found.append([{k: v for k, v in row.items() if k != "frames_per_s"} for row in rows])
    assert found[0] == found[1]

    missing = UsageError("figures need matplotlib, which is not installed: pip install 'facetrack[plot]'")
    monkeypatch.setattr(style, "need_matplotlib", raising(missing))
    code, out, err = facetrack("compare", CLIP, *TWO, "--stop", "2", "--seeds", "1", "-o", "bare")
    assert code == ExitCode.USAGE and "facetrack[plot]" in err and not out and not Path("bare").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--config", "sir", "--config", "sir"], "given twice"),
        (["--config", "sir", "--rank-by", "beauty"], "nothing to rank by"),
        (["--config", "sir", "--box", "1,2,3,4", "--init", "haar"], "give one of them"),
        (["--config", "sir", "-o", "-"], "names no folder"),
        (["--config", "sir:filter.particle=3"], "filter.particle"),
    ],
)
def test_what_contradicts_itself_is_refused(facetrack, arguments, said):
    code, out, err = facetrack("compare", CLIP, *arguments)
    assert code == ExitCode.USAGE and said in err and not out
    assert not list(Path().iterdir())


def test_an_interrupt_keeps_what_is_complete(facetrack, monkeypatch):
    whole = runs.run_plans

    def interrupted(plans, workers, stop, report):
        yield from whole(plans[:1], workers, stop, report)
        stop.code = ExitCode.INTERRUPTED

    monkeypatch.setattr(compare, "run_plans", interrupted)
    code, out, _ = facetrack("compare", CLIP, *TWO, *SHORT, "--no-plots")
    assert code == ExitCode.INTERRUPTED and "Interrupted" in out and "0 of 2" in out
    found = json.loads(Path("occlusion-compare/compare.json").read_text(encoding="utf-8"))
    assert not found["complete"] and [len(one["runs"]) for one in found["recipes"]] == [2, 0]

    def at_once(plans, workers, stop, report):
        stop.code = ExitCode.INTERRUPTED
        yield from ()

    monkeypatch.setattr(compare, "run_plans", at_once)
    code, out, err = facetrack("compare", CLIP, *TWO, *SHORT, "-o", "none", "--no-plots")
    assert code == ExitCode.INTERRUPTED and not out
    assert err.startswith("facetrack: interrupted before ") and err.endswith("; nothing was written\n")
    assert not Path("none").exists()


def test_what_cannot_run_stops_no_others_and_a_truth_that_does_not_fit_is_told_first(facetrack, monkeypatch):
    began, original = [], runs._work
    monkeypatch.setattr(runs, "_work", lambda task, *more: began.append(task[0].label) or original(task, *more))
    boxes = "".join(f"{n},106,74,106,106\n" for n in range(4))
    Path("boxes.csv").write_text("frame,x,y,w,h\n" + boxes, encoding="utf-8")
    arguments = ["compare", CLIP, "--truth", "boxes.csv", "--stop", "4", "--seeds", "1", "--no-plots"]
    code, out, err = facetrack(*arguments, *TWO)
    assert code == ExitCode.INPUT and "boxes.csv" in err and "face/nose" in err and not out and len(began) == 1
    code, out, err = facetrack(*arguments, *TWO, "--config", "mil", "--rank-by", "points.mean_px")
    assert code == ExitCode.BATCH and out.count("not run: boxes.csv") == 2 and " –   mil" in out
    assert "; not ranked, none has points.mean_px." in out and "2 of 3 recipes could not run" in err
    found = json.loads(Path("occlusion-compare/compare.json").read_text(encoding="utf-8"))
    assert [(bool(one["error"]), len(one["runs"])) for one in found["recipes"]] == [(True, 0), (True, 0), (False, 1)]
