"""Cases that no seed is likely to find, or that were found once: kept by name."""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from random import Random

import numpy as np

from tests.fuzz.bench import FRAMES, Bench
from tests.fuzz.hostile import Opens, npy, npz
from tests.fuzz.judge import Case

BOX = ["--box", "115,58,113,113"]
RUN = ["-o", "out", "--no-video", "-q", "--threads", "1", "--stop", "3"]
NAMED: dict[str, Callable[[Random, Bench, Case], list[str]]] = {}


def _case(make: Callable[[Bench, Case], list[str]]) -> Callable[[Bench, Case], list[str]]:
    NAMED[make.__name__.strip("_").replace("_", "-")] = lambda _, bench, case: make(bench, case)
    return make


def _frames(bench: Bench) -> str:
    return str(bench.path("frames"))


# --- YAML and JSON ---------------------------------------------------------------------------------------------------


@_case
def _recipe_of_aliases_of_aliases(bench: Bench, case: Case) -> list[str]:
    lines = [
        "a0: &a0 [x, x, x, x, x, x, x, x, x]",
        *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)),
    ]
    return ["recipes", "check", case.put("x.yaml", "\n".join(lines).encode())]


@_case
def _init_of_aliases_of_aliases(bench: Bench, case: Case) -> list[str]:
    lines = [
        "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]",
        *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)),
    ]
    return ["run", _frames(bench), "--init", case.put("x.yaml", "\n".join(lines).encode()), *RUN]


@_case
def _recipe_that_calls_python(bench: Bench, case: Case) -> list[str]:
    return ["recipes", "check", case.put("x.yaml", b"description: !!python/object/apply:os.system ['touch pwned']\n")]


@_case
def _recipe_of_9000_unknown_keys(bench: Bench, case: Case) -> list[str]:
    return ["recipes", "check", case.put("x.yaml", "".join(f"key{i}: {i}\n" for i in range(9000)).encode())]


@_case
def _recipe_nested_100000_deep(bench: Bench, case: Case) -> list[str]:
    return ["recipes", "check", case.put("x.yaml", b"a: " + b"[" * 100_000 + b"]" * 100_000)]


@_case
def _trajectory_nested_100000_deep(bench: Bench, case: Case) -> list[str]:
    return ["export", case.put("trajectory.json", b'{"a":' * 100_000 + b"1" + b"}" * 100_000), "--to", "dlc"]


@_case
def _line_of_20_megabytes(bench: Bench, case: Case) -> list[str]:
    return [
        "export",
        case.put("trajectory.jsonl", b'{"type":"header","a":"' + b"a" * 20_000_000 + b'"}\n'),
        "--to",
        "dlc",
    ]


@_case
def _calibration_with_a_list_for_a_name(bench: Bench, case: Case) -> list[str]:
    tree = bench.tree("calibration.json")
    tree["maps"]["points"]["method"] = ["isotonic"] * 500
    file = case.put("x.json", json.dumps(tree).encode())
    return ["run", _frames(bench), "--config", "factorized", "--set", f"confidence.calibration={file}", *RUN]


@_case
def _init_of_300_targets(bench: Bench, case: Case) -> list[str]:
    lines = "".join(f"t{i}: {{box: [{i % 200}, {i % 100}, 40, 40]}}\n" for i in range(300))
    return ["run", _frames(bench), "--init", case.put("x.yaml", f"frame: 0\n{lines}".encode()), "--config", "mil", *RUN]


@_case
def _trajectory_with_a_number_of_5000_digits(bench: Bench, case: Case) -> list[str]:
    return [
        "export",
        case.put("x.json", b'{"schema":"facetrack-trajectory","version":' + b"9" * 5000 + b"}"),
        "--to",
        "dlc",
    ]


@_case
def _jsonl_with_a_number_of_5000_digits(bench: Bench, case: Case) -> list[str]:
    lines = bench.text("run/trajectory.jsonl").splitlines(keepends=True)
    lines[2] = lines[2].replace('"frame":1', '"frame":' + "9" * 5000)
    return ["export", case.put("x.jsonl", "".join(lines).encode()), "--to", "dlc"]


# --- archives of arrays ----------------------------------------------------------------------------------------------


@_case
def _gallery_that_is_a_pickle(bench: Bench, case: Case) -> list[str]:
    arrays = bench.arrays("gallery.npz")
    arrays = {**arrays, "names": np.array([Opens()], object), "format": np.array([Opens()], object)}
    return ["gallery", "show", case.put("x.npz", npz(arrays)), "-o", "out.png"]


@_case
def _gallery_with_a_name_of_100000_letters(bench: Bench, case: Case) -> list[str]:
    arrays = bench.arrays("gallery.npz")
    names = arrays["names"].astype("U100000")
    names[0] = "a" * 100_000
    return ["gallery", "show", case.put("x.npz", npz({**arrays, "names": names})), "-o", "out.png"]


@_case
def _prior_that_inflates_to_4_gigabytes(bench: Bench, case: Case) -> list[str]:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, one in bench.arrays("prior.npz").items():
            if name != "shapes":
                archive.writestr(f"{name}.npy", npy(one))
        with archive.open("shapes.npy", "w", force_zip64=True) as member:
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                header, {"descr": "<f8", "fortran_order": False, "shape": (50_000_000, 5, 2)}
            )
            member.write(header.getvalue())
            for _ in range(500):
                member.write(bytes(8_000_000))
    return ["prior", "show", case.put("x.npz", file.getvalue()), "-o", "out.png"]


@_case
def _prior_whose_header_promises_much(bench: Bench, case: Case) -> list[str]:
    whole = npz(bench.arrays("prior.npz"), shapes=(10**9, 5, 2))
    return ["prior", "show", case.put("x.npz", whole), "-o", "out.png"]


# --- images ----------------------------------------------------------------------------------------------------------


def _png(width: int, height: int) -> bytes:
    """A grey image of nothing."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(width + 1)) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@_case
def _image_of_400_million_pixels(bench: Bench, case: Case) -> list[str]:
    case.put("frames/0.png", _png(20_000, 20_000))
    return ["run", "frames", *BOX, "--config", "mil", *RUN]


@_case
def _image_of_150_million_pixels(bench: Bench, case: Case) -> list[str]:
    case.put("frames/0.png", _png(15_000, 10_000))
    return ["run", "frames", *BOX, "--config", "mil", *RUN]


@_case
def _image_one_pixel_high(bench: Bench, case: Case) -> list[str]:
    case.put("frames/0.png", _png(60_000, 1))
    case.named = ("--box",)
    return ["run", "frames", *BOX, "--config", "mil", *RUN]


# --- what is no plain file -------------------------------------------------------------------------------------------


@_case
def _truth_that_never_ends(bench: Bench, case: Case) -> list[str]:
    case.named = ("/dev/zero",)
    return ["eval", str(bench.path("run")), "--truth", "/dev/zero"]


@_case
def _trajectory_that_never_ends(bench: Bench, case: Case) -> list[str]:
    (case.folder / "x.csv").symlink_to("/dev/full")
    case.named = ("x.csv",)
    return ["export", "x.csv", "--to", "mot"]


@_case
def _recipe_that_never_ends(bench: Bench, case: Case) -> list[str]:
    return ["recipes", "check", "/dev/zero"]


@_case
def _gallery_that_never_ends(bench: Bench, case: Case) -> list[str]:
    case.named = ("/dev/zero",)
    return ["gallery", "show", "/dev/zero", "-o", "out.png"]


@_case
def _truth_from_a_pipe_that_nobody_fills(bench: Bench, case: Case) -> list[str]:
    os.mkfifo(case.folder / "x.csv")
    case.named = ("x.csv",)
    return ["eval", str(bench.path("run")), "--truth", "x.csv"]


@_case
def _folder_shown_as_a_gallery(bench: Bench, case: Case) -> list[str]:
    return ["gallery", "show", "."]


@_case
def _run_folder_linked_to_itself(bench: Bench, case: Case) -> list[str]:
    shutil.copytree(bench.path("run"), case.folder / "run")
    (case.folder / "run" / "trajectory.json").unlink()
    (case.folder / "run" / "trajectory.json").symlink_to("trajectory.json")
    return ["smooth", "run", "-o", "out", "-q"]


# --- numbers ---------------------------------------------------------------------------------------------------------


@_case
def _frames_a_thousand_million_apart(bench: Bench, case: Case) -> list[str]:
    rows = "0,0,face,box,10,10,5,5\n1000000000,1,face,box,10,10,5,5\n"
    return [
        "export",
        case.put("x.csv", f"frame,time_s,target,part,x,y,w,h\n{rows}".encode()),
        "--to",
        "otb",
        "-o",
        "out.txt",
    ]


@_case
def _plot_of_frames_a_thousand_million_apart(bench: Bench, case: Case) -> list[str]:
    rows = "0,0,face,box,10,10,5,5,tracked\n1000000000,1,face,box,10,10,5,5,lost\n"
    return ["plot", case.put("x.csv", f"frame,time_s,target,part,x,y,w,h,status\n{rows}".encode()), "-o", "out.png"]


@_case
def _truth_of_a_thousand_targets(bench: Bench, case: Case) -> list[str]:
    rows = "".join(f"{t},{t / 25},face{i},nose,{i},10\n" for t in range(FRAMES) for i in range(1000))
    file = case.put("x.csv", f"frame,time_s,target,part,x,y\n{rows}".encode())
    case.named = (file, "run")
    return ["eval", str(bench.path("run")), "--truth", file]


@_case
def _names_that_colour_the_terminal(bench: Bench, case: Case) -> list[str]:
    rows = "".join(f"{t},{t / 25},\x1b[31mface\x07,nose,10,10\n" for t in range(FRAMES))
    file = case.put("x.csv", f"frame,time_s,target,part,x,y\n{rows}".encode())
    case.named = (file, "run")
    return ["eval", str(bench.path("run")), "--truth", file]


@_case
def _file_name_that_colours_the_terminal(bench: Bench, case: Case) -> list[str]:
    case.put("\x1b]0;x\x07\x1b[31m.csv", b"frame,x,y\n")
    case.named = ()
    return ["eval", "\x1b]0;x\x07\x1b[31m.csv", "--truth", str(bench.path("truth.csv"))]


@_case
def _name_that_is_too_long(bench: Bench, case: Case) -> list[str]:
    return ["eval", "x" * 300 + ".csv", "--truth", str(bench.path("truth.csv"))]


@_case
def _name_that_is_too_long_for_repeat(bench: Bench, case: Case) -> list[str]:
    return ["repeat", "x" * 300 + ".csv"]


@_case
def _command_that_colours_the_terminal(bench: Bench, case: Case) -> list[str]:
    return ["\x1b]0;x\x07run"]


@_case
def _output_that_colours_the_terminal(bench: Bench, case: Case) -> list[str]:
    return ["plot", str(bench.path("run")), "-o", "\x1b]0;x\x07.png"]


@_case
def _image_with_damaged_metadata(bench: Bench, case: Case) -> list[str]:
    """Pillow says what it thinks of them on standard error."""
    import cv2

    exif = b"Exif\0\0II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\xff\xff\0\0\x01\0"
    whole = cv2.imencode(".jpg", cv2.imread(str(bench.path("frames/0.png"))))[1].tobytes()
    content = whole[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + whole[2:]
    case.put("frames/0.jpg", content)
    return ["run", "frames", *BOX, "--config", "mil", *RUN]


@_case
def _path_that_is_too_long(bench: Bench, case: Case) -> list[str]:
    return ["run", "x/" * 3000 + "clip.mp4", "-o", "out"]


@_case
def _output_whose_path_is_too_long(bench: Bench, case: Case) -> list[str]:
    return ["run", _frames(bench), *BOX, "--config", "mil", "-o", "x/" * 3000]


@_case
def _one_frame_in_an_hour(bench: Bench, case: Case) -> list[str]:
    return ["run", _frames(bench), "--fps", "1/3600", *BOX, "--config", "mil", "-o", "out", "-q", "--stop", "3"]


@_case
def _resolution_that_is_no_number(bench: Bench, case: Case) -> list[str]:
    return ["plot", str(bench.path("run")), "-o", "out.png", "--dpi", "nan"]


@_case
def _width_that_is_no_number(bench: Bench, case: Case) -> list[str]:
    return ["plot", str(bench.path("run")), "-o", "out.png", "--width", "nan"]


@_case
def _share_that_is_infinite(bench: Bench, case: Case) -> list[str]:
    return [
        "repeat",
        _frames(bench),
        *BOX,
        "--config",
        "mil",
        "--stop",
        "3",
        "--seeds",
        "2",
        "--apart",
        "inf",
        "-o",
        "out",
        "-q",
    ]


@_case
def _threads_without_number(bench: Bench, case: Case) -> list[str]:
    return ["run", _frames(bench), *BOX, "--config", "mil", "-o", "out", "--threads", "99999999999"]


@_case
def _frame_number_beyond_any_clip(bench: Bench, case: Case) -> list[str]:
    return ["run", _frames(bench), *BOX, "--config", "mil", "-o", "out", "--init-frame", "9" * 30]
