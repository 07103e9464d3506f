"""Landmarks of iBUG (300-W, 300VW): a file a frame, `annot/000001.pts`. Files and pixels are counted from 1.

    version: 1
    n_points: 68
    {
    123.5 200.25
    ...
    }

The pixels follow Matlab: the centre of the top left one is 1, 1. The target is "face", with the parts point_01, ... in
the file's order; of 68 points five have names too. The lips' points are on the outer border, as ours are.
"""

import re
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.formats.lines import Lines, read_text
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS
from facetrack_cli.trajectory.trajectory import Trajectory, build

# iBUG's numbers of the 68 points, from 1; left and right as seen in the image, which is where iBUG begins to count
NAMED = {"nose": 31, "mouth_left": 49, "mouth_right": 55, "lip_upper": 52, "lip_lower": 58}
_HEAD = re.compile(r"\s*version:\s*\S+\s+n_points:\s*(\d{1,4})\s*\{", re.IGNORECASE)


def read_pts(path: Path, *, shift: int = 0) -> Trajectory:
    """A folder of .pts files, numbered by the last digits of their names, or one file. InputError with the line."""
    files = sorted(path.glob("*.pts")) or sorted(path.glob("annot/*.pts")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: no .pts file in this folder, nor in annot/ below it; name the folder with them")
    frames: dict[int, Path] = {}
    for file in files:
        digits = re.findall(r"\d+", file.stem)
        if not digits and len(files) > 1:
            raise InputError(f"{file}: no number in its name; name the files by their frames, the first 000001.pts")
        number = int(digits[-1]) if digits else 1
        if not 1 <= number <= MAX_FRAME:
            raise InputError(f"{file}: no frame has the number {number}; .pts files are counted from 1")
        if number in frames:
            raise InputError(f"{file}: frame {number} is also in {frames[number].name}; keep one of them")
        frames[number] = file
    points = [_points(file) for file in files]
    for file, found in zip(files, points, strict=True):
        if len(found) != len(points[0]):
            raise InputError(f"{file}: has {len(found)} points, {files[0].name} {len(points[0])}; a folder is one clip")
    count = len(points[0])
    numbers = {**(NAMED if count == 68 else {}), **{f"point_{number:02d}": number for number in range(1, count + 1)}}
    xy = np.stack(points, axis=1)[[number - 1 for number in numbers.values()]] - 1  # (parts, T, 2)
    x, y = xy.reshape(-1, 2).T
    unnamed = "" if count == 68 else ", which have no names of ours"
    header = {"read_as": f".pts: {count} points{unnamed}, files and pixels from 1"}
    which = np.repeat(np.arange(len(numbers)), len(files))
    frame = np.tile(np.array(list(frames), dtype=np.int64) - 1 + shift, len(numbers))
    place = {"x": x, "y": y, "status": np.where(np.isnan(x), "absent", "visible")}
    return build([("face", name) for name in numbers], which, frame, **place, path=path, header=header)


def _points(path: Path) -> Array:
    """(points, 2), as the file has them; nan where it says so."""
    text = read_text(path)
    head = _HEAD.match(text)
    if head is None:
        raise InputError(f'{path}:1: a .pts file begins with the lines "version: 1", "n_points: 68" and "{{"')
    body, brace, rest = text[head.end() :].partition("}")
    first = text.count("\n", 0, head.end()) + 1
    lines = Lines.numbered(path, body.split("\n"), first)
    found = lines.numbers(2, "x y")
    with np.errstate(invalid="ignore"):
        lines.refuse(np.isnan(found).sum(axis=1) == 1, "nan in half a point; give both numbers, or nan nan")
        lines.refuse((np.abs(found) > MAX_PIXELS).any(axis=1), "the point is farther out than any image; correct it")
    if not brace or rest.strip() or len(found) != int(head[1]) or not len(found):
        there = f"{len(found)} points between the braces, and n_points says {head[1]}"
        raise InputError(f"{path}: {there}; was the file cut short?")
    return found
