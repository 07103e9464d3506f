"""Files: written whole or not at all, bounded before they are read, and values that are stored in them."""

import io
import itertools
import math
import os
import stat
import struct
import threading
import zipfile
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core import files, npz
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FileSink, check_new, check_readable, publish, write_new
from facetrack_cli.core.npz import STORED, flatten, restore
from facetrack_cli.core.types import Frame, Particles, Planes, TargetStart
from facetrack_cli.engine.confidence import load_calibration
from facetrack_cli.runs.finished import KIND
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.appearance.gallery import load_gallery, name_problem
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.reader import read_trajectory
from tests.support.damage import raising


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_written_to_and_stays_one(tmp_path):
    pipe, heard = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    check_new(pipe, overwrite=False)  # nothing is replaced, so nobody need agree to it
    write_new(pipe, b"whole", overwrite=True)
    reader.join(10)
    assert heard == [b"whole"] and stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_link_stays_one(tmp_path):
    Path(tmp_path / "far").mkdir()
    link, real = tmp_path / "link.csv", tmp_path / "far" / "real.csv"
    link.symlink_to(real)
    with pytest.raises(OutputError, match="exists already"):
        write_new(link, b"", overwrite=False)

    def records():
        sink = FileSink(link)
        sink.write("records")
        sink.finish(lambda count: f", {count}")
        publish(link)

    for write, text in ((lambda: write_new(link, b"new", overwrite=True), "new"), (records, "records, 1")):
        write()
        assert link.is_symlink() and real.read_text() == text
        assert [path.name for path in real.parent.iterdir()] == ["real.csv"]


def test_nothing_is_left_behind_when_interrupted(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "replace", raising(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_new(tmp_path / "new.csv", b"half", overwrite=False)
    assert not list(tmp_path.iterdir())


SAMPLES = Path(__file__).parents[2] / "sample_videos"
RUN = ["run", SAMPLES / "expressions.mp4", "--stop", "2", "-q"]


def said(capsys, *arguments):
    code = main([*map(str, arguments)])
    [line] = capsys.readouterr().err.splitlines()
    return code, line


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="this system has no devices and named pipes")
@pytest.mark.parametrize("read", [read_trajectory, read_truth, load_gallery, load_calibration])
def test_a_file_without_end_is_refused(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    pipe = "is a pipe, and can be read only once"
    for path, said in (("/dev/zero", "is a device, not a"), ("/dev/full", "is a device"), (tmp_path / "pipe", pipe)):
        with pytest.raises(InputError, match=said):
            read(Path(path))


def test_a_file_that_is_too_large(tmp_path):
    with (tmp_path / "rows.csv").open("wb") as file:
        file.truncate(files.MAX_TABLE_BYTES + 1)
    with pytest.raises(InputError, match=r"too large for a table of rows: 1074 MB, and at most 1074 MB are read"):
        read_trajectory(tmp_path / "rows.csv")
    with pytest.raises(InputError, match="too large for a file"):
        check_readable(tmp_path / "rows.csv", files.MAX_FILE_BYTES)


def test_an_archive_that_lists_millions_of_files(tmp_path):
    """The list takes a kilobyte of memory for each: it is refused before it is read."""
    entry, name = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", *[20] * 2, *[0] * 4, 0, 0, 0, 5, *[0] * 4, 0, 0), b"a.png"
    many = 1_000_000
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 0xFFFF, 0xFFFF, many * (len(entry) + 5), 0, 0)
    (tmp_path / "x.npz").write_bytes((entry + name) * many + end)
    with pytest.raises(InputError, match="lists files in 51 MB"):
        load_gallery(tmp_path / "x.npz")


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


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        ([*RUN, "--threads", "99999999999"], 2, "is not in the range 1<=x<=1000"),
        (["gallery", "show", "."], 3, ".: cannot be read: Is a directory"),
        (["run", "x/" * 2100 + "clip.mp4"], 3, "File name too long; name another file or folder"),
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
    monkeypatch.setattr("facetrack_cli.runs.clip.tracker_for", raising(error))
    code, line = said(capsys, *RUN, "-o", tmp_path / "out")
    assert code == 1 and "not enough memory" in line and "internal" not in line


def test_names_and_targets_are_bounded(tmp_path):
    assert "has 100000 letters, and a name of a person at most 100" in name_problem("x" * 100_000)
    path = tmp_path / "many.init.yaml"
    path.write_text("frame: 0\n" + "".join(f"t{i}: {{box: [1, 2, 30, 40]}}\n" for i in range(300)))
    with pytest.raises(InputError, match="300 targets, and at most 100"):
        read_init(path)


def back(value):
    return restore("x", flatten("x", value))


VALUES = [None, True, -3, 10**40, 0.1, "", "\u20ac\n", (), (1, (2.0, "x")), [], [[None], [False]], {}, {"array": "7"}]
VALUES += [frozenset({3, 1}), {"a": 1, ("a", 2): [{"b": ()}]}, {"of": 1, "fields": {}}, deque([1, "x"], 5), Path("a b")]
VALUES += [float("nan"), float("-inf"), -0.0, np.float32(0.1), np.int64(3)]
VALUES += [[Particles(np.ones((2, 1, 3)), np.zeros(2)), TargetStart((1.0, 2.0, 3.0, 4.0), {"nose": (1.0, 2.0)})]]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_values_come_back(value):
    found = back(value)
    assert repr(found) == repr(value) and type(found) is type(value)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128, "<U3"])
def test_arrays_come_back_as_they_lay_in_memory(kind):
    for shape in ((), (0,), (3,), (2, 0, 3), (2, 3), (2, 3, 4), (2, 3, 4, 2)):
        for axes in itertools.permutations(range(len(shape))):
            array = np.arange(math.prod(shape)).reshape(shape).astype(kind).transpose(axes)
            found = back(array)
            assert found.dtype == array.dtype and found.shape == array.shape and found.tobytes() == array.tobytes()
            assert 0 in shape or found.strides == array.strides


def test_random_numbers_go_on():
    rng = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(2,)))
    rng.random(7)
    rng.integers(3, dtype=np.int32)  # leaves half a word over
    other = back({"rng": rng})["rng"]
    drawn = [(each.random(5).tolist(), each.integers(9, size=9, dtype=np.int32).tolist()) for each in (other, rng)]
    assert drawn[0] == drawn[1] and other.bit_generator.seed_seq.spawn_key == (2,)


def test_frames_come_back():
    pixels = np.random.default_rng(0).integers(0, 256, (12, 8), np.uint8)
    ours = np.array([[0.0, 0.1, -0.2], [0.0, 0.9, 0.1], [0.0, 0.1, 0.8]])
    for given in (pixels, np.dstack([pixels] * 3), Planes.of(pixels)._replace(ours=ours)):
        frame = Frame(3, 0.5, given, aspect=2.0)
        found = back((frame,))[0]
        assert (found.index, found.time_s, found.aspect, found.size) == (3, 0.5, 2.0, frame.size)
        assert (found.bgr == frame.bgr).all()
        assert (found.grey(2, (0, 0, 7, 7))[0] == frame.grey(2, (0, 0, 7, 7))[0]).all()
        assert (found.yuv is None) == (frame.yuv is None), "grey is then another"


class Elsewhere(NamedTuple):
    x: int


@dataclass(frozen=True)
class Kept:
    x: int
    tool: object = field(metadata={STORED: False})


def test_what_is_left_out_comes_back_as_none(monkeypatch):
    monkeypatch.setattr(npz, "_PACKAGE", "tests")
    assert back(Kept(3, object())) == Kept(3, None)


@pytest.mark.parametrize("value", [object(), Elsewhere(1), lambda: 0, np.array([object()]), b"bytes", {1: print}])
def test_other_kinds_are_refused(value):
    with pytest.raises(TypeError, match="cannot be stored"):
        flatten("x", value)


TEXTS = [
    "{}", "{", '{"odd": [1]}', '{"os:system": {}}', '{"array": ["7", []]}', '{"deque": [1e400, 1]}', '{"Frame": 1}',
    '{"Frame": [1, 0.5, "pixels", 1.0]}', '{"facetrack_cli.core.types:Frame": {}}', '{"facetrack_cli.nowhere:X": {}}',
    '{"facetrack_cli.core.types:Particles": {"x": 1}}', '{"facetrack_cli.core.types:Particles": [1, 2]}',
    '{"facetrack_cli.core.files:os.system": {}}',
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_texts_that_we_do_not_write_are_refused(text):
    with pytest.raises(ValueError):
        restore("x", {"x": np.array(text)})
