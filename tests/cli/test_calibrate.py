"""facetrack calibrate as its users meet it: tables, a file, a recipe that names it, and what is refused."""

import json
import shutil
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import ExitCode

SAMPLES = Path(__file__).parents[2] / "sample_videos"
TWO = [SAMPLES / "occlusion.mp4", SAMPLES / "expressions.mp4"]
SHORT = ["--config", "factorized_robust", "--stop", "60", "--seeds", "1"]


@pytest.fixture
def facetrack(tmp_path, monkeypatch, capfd):
    """Run in an empty folder: exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        code = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return code, out, err

    return run


def test_a_calibration_is_fitted_stored_and_named_by_a_recipe(facetrack):
    code, out, err = facetrack("calibrate", *TWO, *SHORT, "-o", "mine.json", "--plot", "mine.png")
    assert code == 0, err
    assert "factorized_robust, 1 run of 2 clips: points" in out and "calibration error" in out and "Brier" in out
    assert max(map(len, out.splitlines())) <= 100 and "wrote mine.json" in err
    assert Path("mine.png").read_bytes()[:4] == b"\x89PNG"
    stored = json.loads(Path("mine.json").read_text(encoding="utf-8"))
    assert stored["recipe"] == "factorized_robust" and stored["clips"] == ["expressions.mp4", "occlusion.mp4"]
    assert stored["seeds"] == 1 and set(stored["maps"]) == {"points"}
    assert stored["checked"]["points"]["ece"] < stored["checked"]["points"]["ece_raw"]

    # equal input, also through a recipe that names a calibration and by two processes, gives equal bytes
    given = [*reversed(TWO), *SHORT, "--set", "confidence.calibration=mine.json", "-j", "2", "-q"]
    code, out, err = facetrack("calibrate", *given, "-o", "again.json")
    assert (code, out, err) == (0, "", "")
    assert Path("again.json").read_bytes() == Path("mine.json").read_bytes()

    run = ["run", TWO[0], "--config", "factorized_robust", "--stop", "60", "-q", "--no-video", "-o"]
    code, _, err = facetrack(*run, "named", "--set", "confidence.calibration=mine.json")
    assert code == 0, err
    assert facetrack(*run, "raw", "--set", "confidence.calibration=null")[0] == 0
    named, raw = (Path(name, "trajectory.csv").read_text(encoding="utf-8").splitlines() for name in ("named", "raw"))
    at = raw[0].split(",").index("confidence")
    assert named != raw
    for one, other in zip(named, raw, strict=True):
        cells = [line.split(",") for line in (one, other)]
        places, same = (line[:at] + line[at + 7 :] for line in cells)
        assert places == same
    evaluated = [json.loads(facetrack("eval", name, "--partial", "--json", "-")[1]) for name in ("named", "raw")]
    ece = [one["all"]["confidence"]["ece"] for one in evaluated]
    assert ece[0] < ece[1]


def test_ground_truth_is_named_for_each_clip(facetrack, tmp_path):
    truths = []
    for clip in TWO:
        for name in (clip.name, clip.with_suffix(".init.yaml").name):
            shutil.copy(SAMPLES / name, tmp_path / name)
        truths += ["--truth", clip.with_suffix(".truth.csv")]
    clips = [clip.name for clip in TWO]
    code, _, err = facetrack("calibrate", *clips, *SHORT)
    assert code == ExitCode.INPUT and "name it with --truth" in err
    assert facetrack("calibrate", *clips, *truths, *SHORT)[0] == 0
    assert Path("factorized_robust.calibration.json").is_file()
    code, _, err = facetrack("calibrate", *clips, *truths[:2], *SHORT)
    assert code == ExitCode.USAGE and "given 1 times for 2 clips" in err


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        ([TWO[0], *SHORT], ExitCode.INPUT, "two clips or more"),
        ([*TWO, *SHORT, "-o", "mine.npz"], ExitCode.USAGE, "is a .json file"),
        ([*TWO, *SHORT, "--plot", "mine"], ExitCode.USAGE, "cannot tell the kind of file"),
        ([*TWO, *SHORT, "--set", "seed=3"], ExitCode.USAGE, "seed has no effect"),
        ([*TWO, "--config", "mil"], ExitCode.USAGE, "gives no confidence"),
        ([TWO[0], "none.mp4", *SHORT], ExitCode.INPUT, "none.mp4"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(facetrack, given, code, said):
    found, out, err = facetrack("calibrate", *given)
    assert found == code and said in err and err.count("\n") == 1 and out == ""
    assert not list(Path().iterdir())


def test_a_file_that_is_there_stays(facetrack):
    Path("mine.json").write_text("{}", encoding="utf-8")
    code, _, err = facetrack("calibrate", *TWO, *SHORT, "-o", "mine.json")
    assert code == ExitCode.USAGE and "exists already" in err and Path("mine.json").read_text(encoding="utf-8") == "{}"
    code, _, err = facetrack("run", TWO[0], *SHORT[:4], "--set", "confidence.calibration=mine.json", "-q")
    assert code == ExitCode.INPUT and 'mine.json: is no calibration: its "format"' in err and err.count("\n") == 1
