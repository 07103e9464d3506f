"""facetrack smooth, run --smooth and --lag: the files that they write, and what they refuse."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from facetrack_cli import smooth
from facetrack_cli.cli.app import cli
from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.trajectory.reader import read_trajectory

CLIP = Path(__file__).parents[2] / "sample_videos" / "expressions.mp4"
RUN = ("run", str(CLIP), "--config", "factorized", "--stop", "30", "-q")


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
    """A run with its posterior, and without a video."""
    folder = tmp_path_factory.mktemp("smooth") / "run"
    done(*RUN, "--keep-posterior", "--no-video", "-o", folder)
    return folder


@pytest.fixture
def run(kept, tmp_path):
    return Path(shutil.copytree(kept, tmp_path / "run"))


def test_smoothing_later_is_smoothing_at_once(kept, tmp_path):
    done(*RUN, "--smooth", "-o", tmp_path / "once", "--threads", "1")
    names = {path.name for path in (tmp_path / "once").iterdir()}
    assert names == {"annotated.mp4", "run.json", "trajectory.csv", "trajectory.json", "trajectory.filtered.csv"}
    done("smooth", kept, "-o", tmp_path / "later", "-q")
    assert {path.name for path in (tmp_path / "later").iterdir()} == {"run.json", "trajectory.csv", "trajectory.json"}
    once, later = ((tmp_path / name / "trajectory.csv").read_bytes() for name in ("once", "later"))
    assert once == later
    assert (tmp_path / "once" / "trajectory.filtered.csv").read_bytes() == (kept / "trajectory.csv").read_bytes()
    header = read_trajectory(tmp_path / "later" / "trajectory.json").header
    assert header["smoothed"] == {"lag": None}
    again = smooth(kept)
    np.testing.assert_allclose(again.x, read_trajectory(tmp_path / "later").x, atol=5.1e-4)
    assert again.header["smoothed"] == {"lag": None}


def test_in_place_the_filtered_rows_are_kept(run):
    before = (run / "trajectory.csv").read_bytes()
    done("smooth", run, "--overwrite")
    assert (run / "trajectory.filtered.csv").read_bytes() == before != (run / "trajectory.csv").read_bytes()
    assert not (run / "posterior.npz").exists()
    assert json.loads((run / "trajectory.json").read_text())["smoothed"] == {"lag": None}
    for command in ("smooth", "fix"):
        code, line = refused(command, run)
        assert code == 3 and "its rows are smoothed" in line
    done("eval", run, "--truth", CLIP.with_suffix(".truth.csv"), "--partial")
    done("report", run)
    done("export", run, "--to", "mot", "-o", "-")


def test_in_place_by_another_name_of_the_folder(run, monkeypatch):
    monkeypatch.chdir(run.parent)
    done("smooth", run.name, "-o", run, "--overwrite")
    assert (run / "trajectory.filtered.csv").exists() and not (run / "posterior.npz").exists()


def test_the_video_is_drawn_again(kept, tmp_path):
    run = shutil.copytree(kept, tmp_path / "run")
    done(*RUN, "--keep-posterior", "--overwrite", "-o", run)
    done("smooth", run, "-o", tmp_path / "out")
    assert (tmp_path / "out" / "annotated.mp4").stat().st_size > 10_000
    done("smooth", run, "-o", tmp_path / "bare", "--no-video")
    assert not (tmp_path / "bare" / "annotated.mp4").exists()
    assert refused("smooth", run, "-o", tmp_path / "more", "--clip", tmp_path / "gone.mp4")[0] == 3
    assert not (tmp_path / "more").exists()


def test_a_lag_is_in_the_header_and_changes_the_rows(kept, tmp_path):
    done(*RUN, "--lag", "5", "--no-video", "-o", tmp_path / "lag")
    rows = read_trajectory(tmp_path / "lag")
    assert rows.header["smoothed"] == {"lag": 5}
    assert len(rows.frames) == 30
    assert not np.array_equal(rows.x, read_trajectory(kept).x)
    streamed = done(*RUN, "--lag", "5", "-o", "-").output
    assert streamed == (tmp_path / "lag" / "trajectory.csv").read_text()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--smooth", "--lag", "3"), "give one of them"),
        (("--smooth", "--keep-posterior"), "give one of them"),
        (("--smooth", "-o", "-"), "take --lag, or a folder"),
        (("--smooth", "--format", "csv"), "give --format csv,json"),
        (("--config", "mil", "--smooth"), "no posterior to smooth"),
        (("--config", "mil", "--lag", "3"), "no posterior to smooth"),
    ],
)
def test_what_cannot_be_smoothed_is_refused(more, says, tmp_path):
    out = () if "-o" in more else ("-o", tmp_path / "out")
    code, line = refused(*RUN, *out, *more)
    assert code == 2 and says in line
    assert not (tmp_path / "out").exists()


def test_a_run_that_is_in_the_way_or_has_nothing_to_smooth_is_refused(run, tmp_path):
    assert "--overwrite replaces" in refused("smooth", run)[1]
    done("smooth", run, "-o", tmp_path / "out")
    assert "exists already" in refused("smooth", run, "-o", tmp_path / "out")[1]
    (run / "posterior.npz").unlink()
    with pytest.raises(InputError, match="run again with --keep-posterior"):
        smooth(run)


@pytest.mark.parametrize("damage", ["cut", "empty", "other", "frames", "shape", "nan", "lacks"])
def test_a_damaged_posterior_is_refused_in_one_line(damage, run, kept, tmp_path):
    path = run / "posterior.npz"
    data = path.read_bytes()
    if damage == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "other":
        np.savez(path, format=np.array("facetrack-gallery"))
    elif damage in ("shape", "nan", "lacks"):
        with np.load(path) as file:
            arrays = dict(file)
        if damage == "lacks":
            del arrays["0/0/0/cov"]
        elif damage == "shape":
            arrays["0/0/0/mean"] = arrays["0/0/0/mean"][:, :3]
        else:
            arrays["0/0/0/noise"][3] = np.nan
        np.savez(path, **arrays)
    else:
        done(*RUN[:-3], "--stop", "10", "-q", "--keep-posterior", "--no-video", "-o", tmp_path / "short")
        shutil.copy(tmp_path / "short" / "posterior.npz", path)
    code, line = refused("smooth", run, "-o", tmp_path / "out")
    assert code == 3 and "posterior.npz" in line
    assert not (tmp_path / "out").exists()


def test_a_posterior_of_before_corrections_is_refused(run, tmp_path):
    text = (run / "trajectory.json").read_text()
    head = json.loads(text)["init"]
    head["corrections"] = [{"frame": 5, "target": "face", "points": {"nose": [1, 2]}}]
    lines = text.split("\n")
    at = next(i for i, line in enumerate(lines) if line.startswith('"init"'))
    lines[at] = f'"init": {json.dumps(head)},'
    (run / "trajectory.json").write_text("\n".join(lines))
    (run / "run.json").unlink()
    code, line = refused("smooth", run, "-o", tmp_path / "out")
    assert code == 3 and "before the run was corrected" in line
