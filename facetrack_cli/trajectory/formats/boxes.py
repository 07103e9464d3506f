"""Boxes as plain text: CSV with the header frame,x,y,w,h; OTB and GOT-10k, one box a line without frame numbers.

- `boxes`: frames and pixels from 0; x, y are the left and top edges. Columns in any order, others are passed over.
- `otb`: left, top, width, height with comma, tab or blanks between them. Pixels are counted from 1, as in Matlab, and
  1 is subtracted. Line 1 is the first frame. A line of zeros or nan: the target is absent.
- `got10k`: the same, also from 1 ("All coordinate values are 1-based", its author in got-10k/toolkit#6). Absent is also
  a box without width or height, four times -1, and what `absence.label` marks if it lies beside. Where `cover.label`
  beside it is 0, nothing of the target can be seen: hidden. Its toolkit leaves such frames out of every measure.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Texts, Whole
from facetrack_cli.trajectory.formats.lines import (
    FROM_ONE,
    Line,
    boxes,
    decimal,
    lines_by_frame,
    lines_with_frame,
    no_frame_twice,
    numbers,
    read_text,
    whole,
)
from facetrack_cli.trajectory.trajectory import Trajectory

LTWH = "left,top,width,height"
BOX_COLUMNS = ("frame", "x", "y", "w", "h")


def read_boxes(path: Path, *, shift: int = 0) -> Trajectory:
    """CSV with the header frame,x,y,w,h: frames from 0, the left and top edges in pixels from 0."""
    header, *lines = lines_with_frame(read_text(path))
    names = [name.strip().strip('"').lower() for name in header.text.split(",")]
    if {"target", "part"} <= set(names):
        raise InputError(
            f"{path}:{header.number}: has the columns target and part, and with them x, y are centres; "
            "read it as facetrack's own table"
        )
    missing = [name for name in BOX_COLUMNS if name not in names]
    if missing:
        raise InputError(
            f"{path}:{header.number}: the header has no column {', '.join(missing)}; it should read frame,x,y,w,h"
        )
    if not lines:
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    values = numbers(path, lines, len(names), ",".join(names), [names.index(name) for name in BOX_COLUMNS])
    frame = whole(path, lines, values[:, 0], "frame", 0)
    no_frame_twice(path, lines, frame[:, None], "frame")
    return _read(path, boxes(path, lines, frame + shift, values[:, 1:]), "boxes: frame,x,y,w,h, all from 0")


def read_otb(path: Path, *, shift: int = 0) -> Trajectory:
    """OTB text: a box a line, pixels from 1; line i, from 0, is frame i + `shift`."""
    lines = lines_by_frame(path, read_text(path))
    found = boxes(path, lines, _frames(lines, shift), _from_one(path, lines))
    return _read(path, found, f"OTB text: {LTWH} a line, pixels from 1 (--truth-format vot: from 0)")


def read_got10k(path: Path, *, shift: int = 0) -> Trajectory:
    """GOT-10k text: a box a line, pixels from 1, with absence.label and cover.label where they lie beside it."""
    lines = lines_by_frame(path, read_text(path))
    absence, cover = (_labels(path.parent / f"{name}.label", path, len(lines)) for name in ("absence", "cover"))
    status: Texts = np.full(len(lines), "visible", dtype="<U8")
    if cover is not None:
        status[cover == 0] = "hidden"
    if absence is not None:
        status[absence != 0] = "absent"
    ltwh = _from_one(path, lines)
    found = boxes(path, lines, _frames(lines, shift), ltwh, status=status, no_area_is_absent=True)
    used = " and ".join(
        f"{name}.label" for name, there in (("absence", absence), ("cover", cover)) if there is not None
    )
    return _read(path, found, f"GOT-10k text: {LTWH} a line, pixels from 1{', with ' if used else ''}{used}")


def write_otb(one: Trajectory) -> str:
    """A box a line, pixels from 1, at most 4 decimals: `read_otb` with the first frame as `shift` gives it back.

    The format has no frame numbers: line 1 is the series' first frame, as in OTB's own files of clips that begin late
    (David at frame 300). A place that is not known is nan,nan,nan,nan. Lost rows are written: they are the estimate.
    Raises InputError for a gap between frames, or a row with a place and no size.
    """
    gaps = np.flatnonzero(np.diff(one.frame) != 1)
    if gaps.size:
        at = gaps[0]
        raise InputError(
            f"{one.name}: no row between frames {one.frame[at]} and {one.frame[at + 1]}, and a format without "
            "frame numbers has no room for a gap; export to mot or vot"
        )
    return "".join(",".join([decimal(v) for v in box]) + "\n" for box in (known_boxes(one) + FROM_ONE).tolist())


def write_got10k(one: Trajectory) -> str:
    """As `write_otb`: both count pixels from 1 and keep a box a line. The toolkit wants it as `<clip>_001.txt`."""
    return write_otb(one)


def known_boxes(one: Trajectory) -> Array:
    """(T, 4) left, top, width, height from 0; nan where the place is not known. InputError for a place without size."""
    found = one.boxes
    sizeless = np.flatnonzero(np.isnan(found).any(axis=1) & ~np.isnan(one.x))
    if sizeless.size:
        raise InputError(
            f"{one.name}: frame {one.frame[sizeless[0]]} has no w and h, and these formats hold boxes; "
            "export points to coco or dlc"
        )
    return found


def _from_one(path: Path, lines: list[Line]) -> Array:
    ltwh: Array = numbers(path, lines, 4, LTWH) - FROM_ONE
    return ltwh


def _frames(lines: list[Line], shift: int) -> Whole:
    return np.arange(len(lines), dtype=np.int64) + shift


def _labels(path: Path, boxes_file: Path, rows: int) -> Array | None:
    if not path.is_file():
        return None
    found = numbers(path, lines_by_frame(path, read_text(path)), 1, "one number")[:, 0]
    if len(found) != rows:
        raise InputError(
            f"{path}: has {len(found)} lines, {boxes_file.name} beside it {rows}; "
            "they belong to different clips: move one away"
        )
    return found


def _read(path: Path, found: Trajectory, read_as: str) -> Trajectory:
    return replace(found, path=path, header={"read_as": read_as})
