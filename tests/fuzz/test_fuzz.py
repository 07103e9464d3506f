"""Every command answers hostile inputs in one clear line, or takes them.

In commands IN is the folder of valid inputs, and @ the file that is damaged.
"""

import json
import re
import shutil
import struct
import sys
import time
import zlib
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from tests.fuzz import guided, hostile
from tests.support.media import write_video
from tests.support.samples import FOLDER, read_pictures

resource = pytest.importorskip("resource", reason="tells how much memory a process takes")

MOST_S, MOST_BYTES, MOST_LETTERS = 30, 1 << 30, 1000
DOCUMENTED = (0, 2, 3, 4, 5, 6)
NOISE = re.compile(r"Traceback|internal error|please report|not enough memory|Exception ignored")
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
FRAMES = 5
BOX = "--box 115,58,113,113"
RUN = "-o out --no-video -q --threads 1 --stop 3"
MIL = f"{BOX} --config mil"


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Valid inputs: a clip of a few frames, runs of it, and a file of every kind."""
    folder = tmp_path_factory.mktemp("valid")

    pictures = read_pictures("occlusion")[:FRAMES]
    (folder / "frames").mkdir()
    for index, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / "frames" / f"{index}.png"), picture)
    write_video(folder / "clip.mp4", frames=pictures)
    start = (FOLDER / "occlusion.init.yaml").read_text(encoding="utf-8")
    for name in ("clip", "frames"):
        (folder / f"{name}.init.yaml").write_text(start, encoding="utf-8")
    lines = (FOLDER / "occlusion.truth.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "truth.csv").write_text("".join(lines[: 1 + 5 * FRAMES]), encoding="utf-8")
    shutil.copy(FOLDER / "people.npz", folder / "gallery.npz")
    shutil.copy(FOLDER.parent / "configs" / "mouth_prior.npz", folder / "prior.npz")
    shutil.copy(FOLDER.parent / "configs" / "calibration" / "factorized_robust.json", folder / "calibration.json")
    words = ["run", folder / "clip.mp4", "--config", "factorized_robust", "-o", folder / "run", "--threads", "1", "-q"]
    assert main([*map(str, words), "--format", "csv,json,jsonl"]) == 0
    return folder


class Case(NamedTuple):
    """A command line, the files that it reads here, and what an error must name one of; "" for nothing."""

    words: list[str]
    files: dict[str, bytes]
    named: tuple[str, ...]


def peak():
    """Bytes of memory that this process has had at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def check_answer(facetrack, case):
    """Run a case in the current folder, and judge its answer."""
    for name, content in case.files.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(content)
    before, memory, began = {*Path().rglob("*")}, peak(), time.monotonic()
    code, out, err = facetrack(*case.words)
    assert time.monotonic() - began < MOST_S and peak() - memory < MOST_BYTES
    assert code in DOCUMENTED and not NOISE.search(err) and not CONTROL.search(err), err
    lines = [line for line in err.splitlines() if line.startswith("facetrack: error: ")]
    checks = case.words[:2] == ["recipes", "check"]
    failed = code in (2, 3)
    assert len(lines) == 1 or not failed or checks, err
    assert not failed or checks or not case.named or any(name in lines[0] for name in case.named), (case.named, lines)
    assert code not in (5, 6) or lines or out, "says nothing"
    typed = sum(map(len, case.words))  # may be quoted
    said = lines + (out.splitlines() if checks else [])
    assert max(map(len, said), default=0) <= MOST_LETTERS + 2 * typed
    assert not Path("pwned").exists(), "runs code of the input"
    made = [path for path in Path().rglob("*") if path not in before and path.is_file()]
    assert not [path for path in made if ".part" in path.name]
    kept = [json.loads(path.read_bytes())["complete"] for path in Path().glob("out/**/trajectory.json")]
    assert not failed or not made or kept == [False], made
    assert all(Path(name).read_bytes() == content for name, content in case.files.items())


def png(width, height):
    """A black grey image."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(1)
    rows = b"".join(packer.compress(bytes(width + 1)) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def odd_calibration(valid):
    tree = json.loads((valid / "calibration.json").read_text())
    tree["maps"]["points"]["method"] = ["isotonic"] * 500
    return json.dumps(tree).encode()


def arrays_of(path):
    with np.load(path) as file:
        return dict(file)


def pickled(valid):
    opens = np.array([hostile.Opens()], object)
    return hostile.npz({**arrays_of(valid / "gallery.npz"), "names": opens, "format": opens})


def odd_prior(valid):
    return hostile.npz(arrays_of(valid / "prior.npz"), shapes=(10**9, 5, 2))


def odd_metadata(valid):
    """Of a JPEG, of which Pillow warns on standard error."""
    exif = b"Exif\0\0II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\xff\xff\0\0\x01\0"
    whole = cv2.imencode(".jpg", cv2.imread(str(valid / "frames" / "0.png")))[1].tobytes()
    return whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:]


HEAD = "frame,time_s,target,part,x,y"
APART = f"{HEAD},w,h,status\n0,0,face,box,10,10,5,5,tracked\n1000000000,1,face,box,10,10,5,5,lost\n"
FACES = "".join(f"{t},{t / 25},face{i},nose,{i},10\n" for t in range(FRAMES) for i in range(1000))
COLOURED = "".join(f"{t},{t / 25},\x1b[31mface\x07,nose,10,10\n" for t in range(FRAMES))
ODD_NAME = "\x1b]0;x\x07\x1b[31m.csv"
# a command, the file that it reads, its content (or what makes it of the valid inputs), and what an error names
NAMED = {
    "recipe-that-never-ends": ("recipes check /dev/zero", "", "", ""),
    "name-that-is-too-long": (f"eval {'x' * 300}.csv --truth IN/truth.csv", "", "", ""),
    "output-whose-path-is-too-long": (f"run IN/frames {MIL} -o {'x/' * 3000}", "", "", ""),
    "command-that-colours-the-terminal": ("\x1b]0;x\x07run", "", "", ""),
    "output-that-colours-the-terminal": ("plot IN/run -o \x1b]0;x\x07.png", "", "", ""),
    "one-frame-in-an-hour": (f"run IN/frames --fps 1/3600 {MIL} -o out -q --stop 3", "", "", ""),
    "frame-number-beyond-any-clip": (f"run IN/frames {MIL} -o out --init-frame {'9' * 30}", "", "", ""),
    "recipe-of-9000-unknown-keys": (
        "recipes check x.yaml", "x.yaml", "".join(f"key{i}: {i}\n" for i in range(9000)), "x.yaml",
    ),
    "trajectory-nested-100000-deep": ("export x.json --to dlc", "x.json", '{"a":' * 100_000 + "1" + "}" * 100_000, "x"),
    "line-of-20-megabytes": (
        "export x.jsonl --to dlc", "x.jsonl", f'{{"type":"header","a":"{"a" * 20_000_000}"}}\n', "x.jsonl",
    ),
    "frames-a-thousand-million-apart": ("export x.csv --to otb -o out.txt", "x.csv", APART, "x.csv"),
    "plot-of-frames-a-thousand-million-apart": ("plot x.csv -o out.png", "x.csv", APART, "x.csv"),
    "truth-of-a-thousand-targets": ("eval IN/run --truth x.csv", "x.csv", f"{HEAD}\n{FACES}", "run"),
    "names-that-colour-the-terminal": ("eval IN/run --truth x.csv", "x.csv", f"{HEAD}\n{COLOURED}", "run"),
    "file-name-that-colours-the-terminal": (f"eval {ODD_NAME} --truth IN/truth.csv", ODD_NAME, "frame,x,y\n", ""),
    "calibration-with-a-list-for-a-name": (
        f"run IN/frames --config factorized --set confidence.calibration=x.json {RUN}", "x.json", odd_calibration, "x",
    ),
    "gallery-that-is-a-pickle": ("gallery show x.npz", "x.npz", pickled, "x.npz"),
    "prior-whose-header-promises-much": ("prior show x.npz", "x.npz", odd_prior, "x.npz"),
    "image-of-400-million-pixels": (f"run frames {MIL} {RUN}", "frames/0.png", lambda _: png(20_000, 20_000), "0.png"),
    "image-one-pixel-high": (f"run frames {MIL} {RUN}", "frames/0.png", lambda _: png(60_000, 1), "--box"),
    "image-with-damaged-metadata": (f"run frames {MIL} {RUN}", "frames/0.jpg", odd_metadata, "0.jpg"),
}  # fmt: skip


@pytest.mark.one_in(4)
@pytest.mark.parametrize("name", NAMED)
def test_hostile_inputs_with_names_are_answered(facetrack, clips, name):
    command, file, content, named = NAMED[name]
    data = content(clips) if callable(content) else content.encode()
    check_answer(facetrack, Case(command.split(" "), {file: data} if file else {}, (named,) if named else ()))


@pytest.mark.parametrize("parser", guided.parsers())
def test_parsers_take_what_is_whole_and_refuse_the_rest(parser):
    """As the nightly fuzzers do, which are guided by coverage: guided.py."""
    parse = guided.parsers()[parser]
    assert sum(guided.taken(parse, seed) for seed in guided.seeds(parser)), "all are tried"
    for data in guided.damaged(parser, 50):
        guided.taken(parse, data)


READING = f"""
    run IN/frames --config factorized {RUN} --init @
    run IN/frames --config factorized {RUN} --set prior.file=@
    run IN/frames --config factorized {RUN} --set confidence.calibration=@
    run IN/frames --config factorized {RUN} --gallery @
    run IN/frames {RUN} --config @
    run IN/frames {RUN} --config adaptive_recognition {BOX} --gallery @
    run @ {RUN}
    recipes check @
    recipes show @
    init @
    prior show @
    prior fit @
    gallery show @
    gallery fit @
    eval @ --truth IN/truth.csv
    eval IN/run --truth @
    export @ --to mot
    export IN/run --to coco -o out.json --media @
    plot @
    plot IN/run -o out.png --truth @
    report @
    report IN/run -o out.html --clip @
    fix @ --init IN/truth.csv
    fix IN/run --init @
    regress @
    compare @ --config sir
    compare IN/frames --config mil --stop 2 --truth @
"""
READING = [line.strip() for line in READING.strip().splitlines()]
ODD = ("x" * 300 + ".csv", "x/" * 3000 + "x.csv", "", " ", "\udcff.csv", "x\ny.csv", "~", "/proc/self/mem")


@pytest.mark.one_in(3)
@pytest.mark.parametrize("command", READING)
def test_something_else_stands_where_a_file_is_to_be(facetrack, clips, command):
    """A folder, links that lead to themselves and nowhere, nothing, an empty file, and names that are none."""
    before = shutil.copytree(clips / "run", Path.cwd().with_name("before"))
    Path("folder").mkdir()
    Path("loop.csv").symlink_to("loop.csv")
    Path("gone.npz").symlink_to("nowhere")
    Path("empty.yaml").touch()
    Path("file").touch()
    for name in ("folder", "loop.csv", "gone.npz", "empty.yaml", "missing.json", "file/y.csv", *ODD):
        named = () if name in ODD else (name, "file", "--gallery")
        check_answer(facetrack, Case([word.replace("@", name) for word in command.split(" ")], {}, named))
        shutil.rmtree("out", ignore_errors=True)
    left, now = ([path.read_bytes() for path in sorted(folder.iterdir())] for folder in (before, clips / "run"))
    assert left == now
