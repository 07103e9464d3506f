"""Landmarks of iBUG (300-W, 300VW): a file a frame, `annot/000001.pts`. Files and pixels are counted from 1.

    version: 1
    n_points: 68
    {
    123.5 200.25
    ...
    }

The pixels follow Matlab: the centre of the top left one is 1, 1, and 1 is subtracted. The target is "face", with the
parts point_01, point_02, ... in the file's order; of 68 points five have names too, the parts that our recipes track.
The lips' points are those on the outer border, as ours are (`start/files.py`).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.formats.lines import read_text
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS
from facetrack_cli.trajectory.trajectory import Trajectory, joined, one_part

TARGET = "face"
# iBUG's numbers of the 68 points, from 1; left and right as seen in the picture, which is where iBUG begins to count
NAMED = {"nose": 31, "mouth_left": 49, "mouth_right": 55, "lip_upper": 52, "lip_lower": 58}
_HEAD = re.compile(r"version:\s*\S+\s+n_points:\s*(\d{1,4})\s*\{", re.IGNORECASE)


def read_pts(path: Path, *, shift: int = 0) -> Trajectory:
    """A folder of .pts files, each numbered by the last digits of its name, or one file. A row of nan is absent.

    Raises InputError, with file and line, for what is no .pts file, for two files of one frame, and if their numbers of
    points differ.
    """
    files = _files(path)
    frames: dict[int, Path] = {}
    for file in files:
        digits = re.findall(r"\d+", file.stem)
        if not digits and len(files) > 1:
            raise InputError(
                f"{file}: no number in its name; name the files by their frames, as 000001.pts is the first"
            )
        number = int(digits[-1]) if digits else 1
        if not 1 <= number <= MAX_FRAME:
            raise InputError(f"{file}: no frame has the number {number}; .pts files are counted from 1")
        if number in frames:
            raise InputError(f"{file}: frame {number} is also in {frames[number].name}; keep one of them")
        frames[number] = file
    points = [_points(file) for file in frames.values()]
    for file, found in zip(frames.values(), points, strict=True):
        if len(found) != len(points[0]):
            raise InputError(f"{file}: has {len(found)} points, {files[0].name} {len(points[0])}; a folder is one clip")
    xy = np.stack(points) - 1  # (T, points, 2)
    count = xy.shape[1]
    parts = NAMED if count == 68 else {}
    names = [*parts, *(f"point_{number:02d}" for number in range(1, count + 1))]
    numbers = [*parts.values(), *range(1, count + 1)]
    frame = np.array(list(frames), dtype=np.int64) - 1 + shift
    absent = np.isnan(xy[:, :, 0])
    parts_found = [
        one_part(
            TARGET,
            name,
            frame,
            x=xy[:, number - 1, 0],
            y=xy[:, number - 1, 1],
            status=np.where(absent[:, number - 1], "absent", "visible"),
        )
        for name, number in zip(names, numbers, strict=True)
    ]
    unnamed = "" if parts else ", which have no names of ours"
    header = {"read_as": f".pts: {count} points{unnamed}, files and pixels from 1"}
    return joined(parts_found, path=path, header=header)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    for folder in (path, path / "annot"):
        if files := sorted(folder.glob("*.pts")):
            return files
    raise InputError(f"{path}: no .pts file in this folder, nor in annot/ below it; name the folder that holds them")


def _points(path: Path) -> Array:
    """(points, 2), as the file has them."""
    text = read_text(path)
    head = _HEAD.match(text.lstrip())
    if head is None:
        raise InputError(f'{path}:1: a .pts file begins with the lines "version: 1", "n_points: 68" and "{{"')
    count = int(head[1])
    body, brace, after = text.lstrip()[head.end() :].partition("}")
    try:
        points = np.array(body.split(), dtype=np.float64).reshape(count, 2)
        plain = count > 0 and bool(brace) and not after.strip() and bool((np.abs(points) <= MAX_PIXELS).all())
    except ValueError:
        plain = False
    return points if plain else _line_by_line(path, text, text.count("\n", 0, text.index("{")), count)


def _line_by_line(path: Path, text: str, before: int, count: int) -> Array:
    """The points again, line by line: to allow nan, and to say what is wrong. The brace opens after `before` lines."""
    found: list[list[float]] = []
    closed = False
    for number, line in enumerate(text.split("\n")[before:], before + 1):
        line = line.partition("{")[2].strip() if number == before + 1 else line.strip()
        place = f"{path}:{number}"
        if not line:
            continue
        if closed:
            raise InputError(f"{place}: {line[:40]!r} after the closing brace; keep the points between the braces")
        if line == "}":
            closed = True
            continue
        try:
            values = [float(cell) for cell in line.split()]
        except ValueError:
            values = []
        if len(values) != 2:
            raise InputError(f"{place}: {line[:40]!r} is no point; a line holds x and y with a blank between them")
        if np.isnan(values).any() != np.isnan(values).all():
            raise InputError(f"{place}: nan in half a point; give both numbers, or nan nan")
        if not np.isnan(values).any() and not max(map(abs, values)) <= MAX_PIXELS:
            raise InputError(f"{place}: the point is farther out than any picture; correct it")
        found.append(values)
    if not closed or len(found) != count or count == 0:
        raise InputError(f"{path}: {len(found)} points, but n_points says {count}; was the file cut short?")
    return np.array(found, dtype=np.float64)
