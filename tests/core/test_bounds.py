"""What is read is bounded before it is read: endless files, archives that inflate, numbers and names without end."""

import io
import json
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core import files, yaml_tree
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import check_readable
from facetrack_cli.engine.calibration import load_calibration
from facetrack_cli.runs.smooth import KIND
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.appearance.gallery import load_gallery, name_problem
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.video.source import open_source

SAMPLES = Path(__file__).parents[2] / "sample_videos"
READERS = pytest.mark.parametrize("read", [read_trajectory, read_truth, load_gallery, load_calibration])
RUN = ["run", SAMPLES / "expressions.mp4", "--stop", "2", "-q"]


def said(capsys, *arguments):
    code = main([*map(str, arguments)])
    [line] = capsys.readouterr().err.splitlines()
    return code, line


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="this system has no /dev/zero")
@pytest.mark.parametrize("name", ["/dev/zero", "/dev/full"])
@READERS
def test_a_file_without_end_is_refused(name, read):
    with pytest.raises(InputError, match="is a device, not a"):
        read(Path(name))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@READERS
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="is a pipe, and can be read only once"):
        read(tmp_path / "pipe")


def test_a_file_that_is_too_large(tmp_path):
    with (tmp_path / "rows.csv").open("wb") as file:
        file.truncate(files.MAX_TABLE_BYTES + 1)
    with pytest.raises(InputError, match=r"too large for a table of rows: 1074 MB, and at most 1074 MB are read"):
        read_trajectory(tmp_path / "rows.csv")
    with pytest.raises(InputError, match="too large for a file"):
        check_readable(tmp_path / "rows.csv", files.MAX_FILE_BYTES)


@pytest.mark.parametrize("what", ["archive of images", "arrays"])
def test_an_archive_that_lists_millions_of_files(tmp_path, what):
    """The list takes a kilobyte of memory for each: it is refused before it is read."""
    entry, name = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", *[20] * 2, *[0] * 4, 0, 0, 0, 5, *[0] * 4, 0, 0), b"a.png"
    many = 1_000_000
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 0xFFFF, 0xFFFF, many * (len(entry) + 5), 0, 0)
    path = tmp_path / ("x.zip" if what == "archive of images" else "x.npz")
    path.write_bytes((entry + name) * many + end)
    with pytest.raises(InputError, match="lists files in 51 MB, and at most 34 MB are read; unpack it"):
        open_source(path) if path.suffix == ".zip" else load_gallery(path)


@pytest.mark.parametrize("header", ["{'descr': '<f8', 'shape': (3,", '"', "(((((", "{'a': 1", "\t1\n 2"])
def test_arrays_whose_header_is_cut(tmp_path, header):
    """NumPy hands it to Python's tokenizer, whose errors are of its own kind."""
    data = f"{header}\n".encode()
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("format.npy", b"\x93NUMPY\x01\x00" + len(data).to_bytes(2, "little") + data)
    with pytest.raises(InputError, match="is not a usable gallery"):
        load_gallery(tmp_path / "x.npz")


@pytest.mark.nightly
def test_an_archive_that_inflates(tmp_path):
    block = io.BytesIO()
    np.save(block, np.zeros(16 << 20))
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("format", "version", "mean"):
            archive.writestr(f"{name}.npy", block.getvalue())
    with pytest.raises(InputError, match=r"its \d+ bytes hold 403 MB"):
        KIND.read(tmp_path / "bomb.npz", lambda stored: stored)


@pytest.mark.parametrize("form", ["json", "jsonl"])
def test_a_number_of_thousands_of_digits(tmp_path, form):
    header = json.dumps({"type": "header", "schema": "facetrack-trajectory"})
    path = tmp_path / f"t.{form}"
    path.write_text(
        f'{{"seed": {"9" * 5000}}}' if form == "json" else f'{header}\n{{"type": "frame", "frame": {"9" * 5000}}}'
    )
    with pytest.raises(InputError, match=r"t.json"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        (["plot", "x", "--dpi", "nan"], 2, "'nan' is no finite number"),
        (["plot", "x", "--width", "nan"], 2, "'nan' is no finite number"),
        ([*RUN, "--threads", "99999999999"], 2, "is not in the range 1<=x<=1000"),
        ([*RUN, "-j", "99999999999"], 2, "is not in the range 1<=x<=1000"),
        (["gallery", "show", "."], 3, ".: cannot be read: Is a directory"),
        (["run", "x/" * 2100 + "clip.mp4"], 3, "File name too long; name another file or folder"),
        (["compare", "x" * 300 + ".mp4", "--config", "mil"], 3, "File name too long"),
    ],
)
def test_what_is_the_users_is_no_internal_error(capsys, tmp_path, monkeypatch, arguments, code, line):
    monkeypatch.chdir(tmp_path)
    found = said(capsys, *arguments)
    assert found[0] == code and line in found[1]


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("x"),
        RuntimeError("can't start new thread"),
        Exception("(-4:Insufficient memory) Failed to allocate"),
    ],
)
def test_too_little_memory_is_said(capsys, monkeypatch, tmp_path, error):
    def fails(*_):
        raise error

    monkeypatch.setattr("facetrack_cli.runs.clip.tracker_for", fails)
    code, line = said(capsys, *RUN, "-o", tmp_path / "out")
    assert code == 1 and "not enough memory" in line and "internal" not in line


def test_names_and_targets_are_bounded(tmp_path):
    assert "has 100000 letters, and a name of a person at most 100" in name_problem("x" * 100_000)
    path = tmp_path / "many.init.yaml"
    path.write_text("frame: 0\n" + "".join(f"t{i}: {{box: [1, 2, 30, 40]}}\n" for i in range(300)))
    with pytest.raises(InputError, match="300 targets, and at most 100"):
        read_init(path)


def test_many_unknown_keys_do_not_take_the_square_of_their_number(tmp_path, capsys):
    path = tmp_path / "recipe.yaml"
    path.write_text("filter:\n  type: sir\n" + "".join(f"k{i}: 1\n" for i in range(500)))
    before = yaml_tree._lines.cache_info().misses
    assert main(["recipes", "check", str(path)]) == 2
    assert "k499" in capsys.readouterr().out
    assert yaml_tree._lines.cache_info().misses - before < 10, "the text is split into lines for each of them"
