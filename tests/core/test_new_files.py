"""Files that commands write: all or nothing, never over what they read, never in the place of a device."""

import os
import stat
import threading
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import FileSink, check_new, publish, write_new

HEADER = (
    '{"schema": "facetrack-trajectory", "version": 1, "source": {"path": "clip.mp4", "size": [64, 48]}, "frames": ['
)
FRAME = '{"frame": 0, "time_s": 0, "targets": [{"target": "face", "parts": [{"part": "nose", "x": 1, "y": 2}]}]}]}'


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A folder with a trajectory, its clip and ground truth, which is the current one."""
    monkeypatch.chdir(tmp_path)
    Path("trajectory.json").write_text(HEADER + FRAME)
    Path("clip.mp4").write_bytes(b"a clip")
    Path("clip.truth.csv").write_text("frame,target,part,x,y\n0,face,nose,1,2\n")
    return tmp_path


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_written_to_and_stays_one(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    heard = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    check_new(pipe, overwrite=False)  # nothing is replaced, so nobody need agree to it
    write_new(pipe, b"whole", overwrite=True)
    reader.join(10)
    assert heard == [b"whole"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_link_stays_one(tmp_path):
    Path(tmp_path / "far").mkdir()
    link, real = tmp_path / "link.csv", tmp_path / "far" / "real.csv"
    link.symlink_to(real)
    with pytest.raises(OutputError, match="exists already"):
        write_new(link, b"", overwrite=False)
    write_new(link, b"new", overwrite=True)
    assert link.is_symlink()
    assert real.read_bytes() == b"new"
    assert [path.name for path in real.parent.iterdir()] == ["real.csv"]
    sink = FileSink(link)
    sink.write("records")
    sink.finish(lambda count: f", {count}")
    publish(link)
    assert link.is_symlink()
    assert real.read_text() == "records, 1"
    assert [path.name for path in real.parent.iterdir()] == ["real.csv"]


def test_nothing_is_left_behind_when_interrupted(tmp_path, monkeypatch):
    def interrupted(path, target):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_new(tmp_path / "new.csv", b"half", overwrite=False)
    assert not list(tmp_path.iterdir())


def test_names_that_the_system_refuses(tmp_path):
    for refuse in (lambda path: check_new(path, overwrite=False), lambda path: write_new(path, b"", overwrite=False)):
        with pytest.raises(OutputError, match=r"a{300}: cannot be written: .*; .*\w"):
            refuse(tmp_path / ("a" * 300))


@pytest.mark.parametrize(
    "command",
    [
        ("eval", "trajectory.json", "--json", "clip.mp4"),
        ("eval", "trajectory.json", "--csv", "clip.truth.csv"),
        ("eval", "trajectory.json", "--csv", "./trajectory.json"),
        ("export", "trajectory.json", "--to", "dlc", "-o", "clip.mp4"),
        ("export", "trajectory.json", "--to", "eaf", "--media", "clip.truth.csv", "-o", "clip.truth.csv"),
        ("export", ".", "--to", "dlc", "-o", "trajectory.json"),
    ],
)
def test_what_is_read_is_never_replaced(run, capsys, command):
    before = {path: path.read_bytes() for path in run.iterdir()}
    assert main([*command, "--overwrite"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"{Path(command[-1])}: is read here, and would be replaced; name another file")
    assert {path: path.read_bytes() for path in run.iterdir()} == before


@pytest.mark.parametrize("name", ["a" * 300, "a\\u0000b", "a\\nb<&>\\u00fc.mp4"])
def test_whatever_a_header_calls_its_clip(run, capsys, name):
    Path("trajectory.json").write_text((HEADER + FRAME).replace("clip.mp4", name))
    assert main(["eval", "trajectory.json"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("give --truth FILE")
    assert main(["eval", "trajectory.json", "--truth", "clip.truth.csv", "--csv", "clip.csv"]) == 0
    assert main(["export", "trajectory.json", "--to", "eaf"]) == 0
    assert main(["export", "trajectory.json", "--to", "coco", "--box", "points"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4  # what eval wrote, a clip that is not there, and two exports
