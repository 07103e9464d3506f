"""Cases that no seed is likely to find, or that were found once: kept by name."""

from __future__ import annotations

import json
import shutil
import struct
import zlib
from collections.abc import Callable
from random import Random

import cv2
import numpy as np

from tests.fuzz.bench import FRAMES, Bench
from tests.fuzz.hostile import Opens, npz
from tests.fuzz.judge import Case

BOX = "--box 115,58,113,113"
RUN = "-o out --no-video -q --threads 1 --stop 3"
MIL = f"{BOX} --config mil"
NAMED: dict[str, Callable[[Random, Bench, Case], list[str]]] = {}


def _words(command: str, bench: Bench) -> list[str]:
    """The words of a command line, in which IN is the folder of valid inputs."""
    return [word.replace("IN", str(bench.folder), 1) if word.startswith("IN/") else word for word in command.split(" ")]


# command lines of their own: what an error must name, and the command

COMMANDS = {
    "recipe-that-never-ends": ("", "recipes check /dev/zero"),
    "name-that-is-too-long": ("", f"eval {'x' * 300}.csv --truth IN/truth.csv"),
    "output-whose-path-is-too-long": ("", f"run IN/frames {MIL} -o {'x/' * 3000}"),
    "command-that-colours-the-terminal": ("", "\x1b]0;x\x07run"),
    "output-that-colours-the-terminal": ("", "plot IN/run -o \x1b]0;x\x07.png"),
    "one-frame-in-an-hour": ("", f"run IN/frames --fps 1/3600 {MIL} -o out -q --stop 3"),
    "frame-number-beyond-any-clip": ("", f"run IN/frames {MIL} -o out --init-frame {'9' * 30}"),
}
for name, (said, command) in COMMANDS.items():

    def _command(rng: Random, bench: Bench, case: Case, said: str = said, command: str = command) -> list[str]:
        case.named = (said,) if said else ()
        return _words(command, bench)

    NAMED[name] = _command

# commands that read a file: its name, its text, and the command

ALIASES = "a0: &a0 [x, x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
HEAD = "frame,time_s,target,part,x,y"
APART = "0,0,face,box,10,10,5,5,tracked\n1000000000,1,face,box,10,10,5,5,lost\n"
FACES = "".join(f"{t},{t / 25},face{i},nose,{i},10\n" for t in range(FRAMES) for i in range(1000))
COLOURED = "".join(f"{t},{t / 25},\x1b[31mface\x07,nose,10,10\n" for t in range(FRAMES))
TEXTS = {
    "recipe-of-aliases-of-aliases": ("x.yaml", ALIASES, "recipes check x.yaml"),
    "recipe-that-calls-python": (
        "x.yaml",
        "description: !!python/object/apply:os.system ['touch pwned']\n",
        "recipes check x.yaml",
    ),
    "recipe-of-9000-unknown-keys": ("x.yaml", "".join(f"key{i}: {i}\n" for i in range(9000)), "recipes check x.yaml"),
    "recipe-nested-100000-deep": ("x.yaml", f"a: {'[' * 100_000}{']' * 100_000}", "recipes check x.yaml"),
    "trajectory-nested-100000-deep": ("x.json", '{"a":' * 100_000 + "1" + "}" * 100_000, "export x.json --to dlc"),
    "line-of-20-megabytes": ("x.jsonl", f'{{"type":"header","a":"{"a" * 20_000_000}"}}\n', "export x.jsonl --to dlc"),
    "frames-a-thousand-million-apart": ("x.csv", f"{HEAD},w,h,status\n{APART}", "export x.csv --to otb -o out.txt"),
    "plot-of-frames-a-thousand-million-apart": ("x.csv", f"{HEAD},w,h,status\n{APART}", "plot x.csv -o out.png"),
    "truth-of-a-thousand-targets": ("x.csv", f"{HEAD}\n{FACES}", "eval IN/run --truth x.csv"),
    "names-that-colour-the-terminal": ("x.csv", f"{HEAD}\n{COLOURED}", "eval IN/run --truth x.csv"),
}
for name, (file, text, command) in TEXTS.items():

    def _text(
        rng: Random, bench: Bench, case: Case, file: str = file, text: str = text, command: str = command
    ) -> list[str]:
        case.put(file, text.encode())
        if "IN/run " in command:
            case.named = (file, "run")
        return _words(command, bench)

    NAMED[name] = _text


def _case(make: Callable[[Bench, Case], str]) -> None:
    NAMED[make.__name__.strip("_").replace("_", "-")] = lambda _, bench, case: _words(make(bench, case), bench)


@_case
def _calibration_with_a_list_for_a_name(bench: Bench, case: Case) -> str:
    tree = bench.tree("calibration.json")
    tree["maps"]["points"]["method"] = ["isotonic"] * 500
    case.put("x.json", json.dumps(tree).encode())
    return f"run IN/frames --config factorized --set confidence.calibration=x.json {RUN}"


@_case
def _gallery_that_is_a_pickle(bench: Bench, case: Case) -> str:
    arrays = bench.arrays("gallery.npz")
    opens = np.array([Opens()], object)
    case.put("x.npz", npz({**arrays, "names": opens, "format": opens}))
    return "gallery show x.npz -o out.png"


@_case
def _prior_whose_header_promises_much(bench: Bench, case: Case) -> str:
    case.put("x.npz", npz(bench.arrays("prior.npz"), shapes=(10**9, 5, 2)))
    return "prior show x.npz -o out.png"


def _png(width: int, height: int) -> bytes:
    """A black grey image."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(width + 1)) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@_case
def _image_of_400_million_pixels(bench: Bench, case: Case) -> str:
    case.put("frames/0.png", _png(20_000, 20_000))
    return f"run frames {MIL} {RUN}"


@_case
def _image_one_pixel_high(bench: Bench, case: Case) -> str:
    case.put("frames/0.png", _png(60_000, 1))
    case.named = ("--box",)
    return f"run frames {MIL} {RUN}"


@_case
def _image_with_damaged_metadata(bench: Bench, case: Case) -> str:
    """Pillow warns of it on standard error."""
    exif = b"Exif\0\0II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\xff\xff\0\0\x01\0"
    whole = cv2.imencode(".jpg", cv2.imread(str(bench.path("frames/0.png"))))[1].tobytes()
    case.put("frames/0.jpg", whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:])
    return f"run frames {MIL} {RUN}"


@_case
def _run_folder_linked_to_itself(bench: Bench, case: Case) -> str:
    shutil.copytree(bench.path("run"), case.folder / "run")
    (case.folder / "run" / "trajectory.json").unlink()
    (case.folder / "run" / "trajectory.json").symlink_to("trajectory.json")
    return "report run -o out.html -q"


@_case
def _file_name_that_colours_the_terminal(bench: Bench, case: Case) -> str:
    case.put("\x1b]0;x\x07\x1b[31m.csv", b"frame,x,y\n")
    case.named = ()
    return "eval \x1b]0;x\x07\x1b[31m.csv --truth IN/truth.csv"
