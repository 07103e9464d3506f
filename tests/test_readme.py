"""README's commands, typed one after the other in an empty folder: each finds what those before it have written."""

import shlex

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.test_docs import ROOT, blocks, command_lines

FRAMES = 24
PAGES = {"fix", "--pick"}  # which somebody must close
# what keeps a run short, or is said in the comment beside the command
MORE = {"run": ["-q", "--keep-posterior"], "init": [], "smooth": ["-q"], "report": ["-q"], "eval": [], "suggest": []}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder with a clip, its ground truth, the samples, and a recipe in a file."""
    source = open_source(ROOT / "sample_videos" / "expressions.mp4", stop=FRAMES)
    with source, VideoWriter(tmp_path / "clip.mp4", source.size, source.fps) as video:
        for frame in source:
            video.write(frame.bgr, frame.time_s)
    lines = (ROOT / "sample_videos" / "expressions.truth.csv").read_text().splitlines()
    few = [line for line in lines[1:] if int(line.split(",")[0]) < FRAMES]
    (tmp_path / "points.csv").write_text("\n".join([lines[0], *few]) + "\n")
    (tmp_path / "sample_videos").symlink_to(ROOT / "sample_videos")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def typed():
    """The calls of facetrack in README's blocks of shell, in their order; pip lines and pages are passed over."""
    for block in blocks(ROOT / "README.md", "sh"):
        for arguments, _ in command_lines(block):
            if not PAGES & {*arguments} and "..." not in arguments:
                yield arguments


def test_the_commands_of_readme_work_in_their_order(folder, capsys):
    done = []
    for arguments in typed():
        more = [*MORE[arguments[0]], *(["--stop", "12"] if "sample_videos/" in " ".join(arguments) else [])]
        code = main([*arguments, *more])
        assert code == 0, f"{shlex.join(arguments)}: {capsys.readouterr().err}"
        done.append(arguments[0])
    assert {"run", "eval", "smooth", "report"} <= {*done}
    written = {path.name for path in folder.iterdir()}
    assert {"clip-face", "clip-factorized", "expressions-face", "smooth"} <= written
    for name in ("clip-face", "expressions-face"):
        assert {"annotated.mp4", "trajectory.csv", "trajectory.json"} <= {p.name for p in (folder / name).iterdir()}
    assert (folder / "clip-face" / "report.html").is_file()


def test_the_python_of_readme_runs(folder, capsys):
    [block] = blocks(ROOT / "README.md", "python")
    exec(compile(block.replace("stop=50", "stop=6"), "README.md", "exec"), {})
    frame, x, y, confidence, status = capsys.readouterr().out.split()
    assert frame == "5" and status == "tracked" and float(confidence) > 0.3 and float(x) > 0 and float(y) > 0
