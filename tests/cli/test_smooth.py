"""run --smooth and --lag: the files that they write, and what they refuse."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from facetrack_cli.cli.app import cli
from facetrack_cli.core.errors import FacetrackError, InputError, OutputError
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.finished import finish_run
from facetrack_cli.runs.plan import Job, silent
from facetrack_cli.runs.signals import StoppedError, never
from facetrack_cli.trajectory.reader import read_trajectory
from tests.support.damage import raising

CLIP = Path(__file__).parents[2] / "sample_videos" / "expressions.mp4"
RUN = ("run", str(CLIP), "--config", "factorized", "--stop", "20", "-q")


def invoke(*args):
    return CliRunner().invoke(cli, [str(one) for one in args])


def done(*args):
    result = invoke(*args)
    assert result.exit_code == 0, result.output
    return result


def refused(*args):
    """The exit code, and the one line."""
    error = invoke(*args).exception
    assert isinstance(error, FacetrackError)
    assert "\n" not in str(error)
    return error.exit_code, str(error)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A run that was stopped before it was smoothed."""
    folder = tmp_path_factory.mktemp("smooth") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("facetrack_cli.runs.finished.finish_run", raising(StoppedError))
        said = done(*RUN[:-1], "--smooth", "--no-video", "-o", folder).output
    assert "not smoothed; the same command again does it" in said and (folder / "posterior.npz").is_file()
    return folder


@pytest.fixture
def run(kept, tmp_path):
    return Path(shutil.copytree(kept, tmp_path / "run"))


def test_the_same_command_again_smooths_what_was_not_and_leaves_what_was(run, tmp_path, no_plot):
    done(*RUN, "--smooth", "-o", tmp_path / "once", "--threads", "1")
    names = {path.name for path in (tmp_path / "once").iterdir()}
    assert names == {"annotated.mp4", "run.json", "trajectory.csv", "trajectory.json", "trajectory.filtered.csv"}
    before = (run / "trajectory.csv").read_bytes()
    done(*RUN, "--smooth", "--no-video", "-o", run)
    assert (run / "trajectory.filtered.csv").read_bytes() == before != (run / "trajectory.csv").read_bytes()
    assert not (run / "posterior.npz").exists()
    for name in ("trajectory.csv", "trajectory.filtered.csv"):
        assert (run / name).read_bytes() == (tmp_path / "once" / name).read_bytes()
    assert read_trajectory(run / "trajectory.json").header["smoothed"] == {"lag": None}
    stamps = {path.name: path.stat().st_mtime_ns for path in run.iterdir()}
    assert "done before" in done(*RUN[:-1], "--smooth", "--no-video", "-o", run).output
    assert stamps == {path.name: path.stat().st_mtime_ns for path in run.iterdir()}
    done("eval", run, "--truth", CLIP.with_suffix(".truth.csv"), "--partial")
    done("report", run)
    done("export", run, "--to", "mot", "-o", "-")


def test_an_error_of_smoothing_leaves_what_was_tracked_and_is_the_command_s(tmp_path, monkeypatch):
    monkeypatch.setattr("facetrack_cli.runs.finished.finish_run", raising(InputError("posterior.npz: odd")))
    result = invoke(*RUN[:-1], "--smooth", "--no-video", "-o", tmp_path / "out")
    assert isinstance(result.exception, InputError) and "20 frames" in result.output
    assert (tmp_path / "out" / "posterior.npz").is_file() and len(read_trajectory(tmp_path / "out").frames) == 20


def test_a_run_without_its_video_is_drawn_again(tmp_path, monkeypatch):
    full = "annotated.mp4: the disk is full"
    command = (*RUN[:3], "factorized", "--stop", "8", "-q", "--smooth", "-o", tmp_path / "out")
    with monkeypatch.context() as patched:
        patched.setattr("facetrack_cli.video.writer.VideoWriter.write", raising(OutputError(full)))
        assert refused(*command) == (2, full)
    done(*command)
    assert {"annotated.mp4", "trajectory.filtered.csv"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert "done before" in done(*(word for word in command if word != "-q")).output


@pytest.mark.parametrize("how", [("--smooth",), ("--lag", "4")])
def test_a_smoothed_run_is_corrected_as_a_run_that_begins_with_the_corrections(how, kept, tmp_path):
    run, again = tmp_path / "run", tmp_path / "again"
    done(*RUN, *how, "-o", run)
    assert not np.array_equal(read_trajectory(run).x, read_trajectory(kept).x)
    if how[0] == "--lag":
        assert done(*RUN, *how, "-o", "-").output == (run / "trajectory.csv").read_text()
    old = (run / "annotated.mp4").read_bytes()
    corrections = CLIP.with_suffix(".init.yaml").read_text() + (
        "corrections:\n  - frame: 12\n    points: {nose: [150, 135], mouth_left: [130, 150], "
        "mouth_right: [172, 150], lip_upper: [150, 150], lip_lower: [150, 166]}\n"
    )
    (tmp_path / "fixed.yaml").write_text(corrections)
    done("fix", run, "--init", tmp_path / "fixed.yaml", "-q")
    done(*RUN, *how, "--init", run / "corrected.init.yaml", "--no-video", "-o", again)
    for name in {"trajectory.csv", "trajectory.filtered.csv"} & {path.name for path in again.iterdir()}:
        assert (run / name).read_bytes() == (again / name).read_bytes()
    rows = read_trajectory(run / "trajectory.json")
    assert rows.header["smoothed"] == {"lag": None if how == ("--smooth",) else 4}
    assert rows.header["init"]["corrections"][0]["frame"] == 12
    assert (run / "annotated.mp4").read_bytes() != old
    assert "done before" in done(*RUN[:-1], *how, "-o", run).output, "it is the same job, corrected"


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--smooth", "--lag", "3"), "give one of them"),
        (("--smooth", "-o", "-"), "take --lag, or a folder"),
        (("--smooth", "--format", "csv"), "give --format csv,json"),
        (("--config", "mil", "--smooth"), "no posterior to smooth"),
    ],
)
def test_what_cannot_be_smoothed_is_refused(more, says, tmp_path):
    out = () if "-o" in more else ("-o", tmp_path / "out")
    code, line = refused(*RUN, *out, *more)
    assert code == 2 and says in line
    assert not (tmp_path / "out").exists()


def unknown(path):
    """An array of a posterior is not finite."""
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **{**arrays, "0/0": arrays["0/0"] * np.nan})


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
        lambda path: np.savez(path, format=np.array("facetrack-gallery")),
        unknown,
    ],
)
def test_a_damaged_posterior_is_refused_in_one_line(damage, run):
    damage(run / "posterior.npz")
    before = (run / "trajectory.csv").read_bytes()
    with pytest.raises(InputError, match=r"posterior\.npz") as error:
        finish_run(Job(CLIP, load_recipe("factorized"), run, smooth=True), run, silent, never)
    assert "\n" not in str(error.value) and (run / "trajectory.csv").read_bytes() == before


def test_a_posterior_of_before_corrections_is_refused(run):
    fixed = '"corrections": [{"frame": 5, "target": "face", "points": {"nose": [1, 2]}}]'
    text = re.sub(r'^("init": \{.*)\},$', rf"\1, {fixed}}},", (run / "trajectory.json").read_text(), flags=re.MULTILINE)
    (run / "trajectory.json").write_text(text)
    (run / "run.json").unlink()
    with pytest.raises(InputError, match="before the run was corrected"):
        finish_run(Job(CLIP, load_recipe("factorized"), run, smooth=True), run, silent, never)
