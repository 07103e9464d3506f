"""VOT text, as vot-toolkit reads and writes it: a region a line, values between commas, pixels counted from 0.

- Four values: a rectangle left, top, width, height. Eight: the corners of a polygon, x1, y1, ..., x4, y4, kept as
  `corners`; its x, y, w, h are the axis-aligned bounding box, width = right - left, as the toolkit converts polygons.
  Its angle is not known: four clicked corners need not be a rectangle.
- One value is a code. In truth, 0 ("unknown") and regions of nan say that the target is absent.
- A file with a code 1 is a result: 1 is the frame where the tracker was set on the target, whose box the format does
  not repeat (status init, no place); 2 is a failure (status lost, no place); 0 is a frame that was not tracked, and has
  no row; regions are tracked.
- `m...` is a mask in run lengths. Masks are not read.

The toolkit counts pixels from 0: the Python one draws a region onto the picture as the numbers stand.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.formats.boxes import known_boxes
from facetrack_cli.trajectory.formats.lines import Line, boxes, decimal, delimiter, lines_by_frame, numbers, read_text
from facetrack_cli.trajectory.reader import MAX_PIXELS
from facetrack_cli.trajectory.trajectory import Trajectory

REGION = "left,top,width,height or x1,y1,...,x4,y4"
UNKNOWN, INIT, FAILURE = 0, 1, 2
MOST_LINES = 10**7  # four days of video


def read_vot(path: Path, *, shift: int = 0) -> Trajectory:
    """VOT truth or results; line i, counted from 0, is frame i + `shift`.

    Raises InputError, with the line, for masks, polygons of other than four corners, and what is no region at all.
    """
    lines = lines_by_frame(path, read_text(path))
    between = delimiter(next((line.text for line in lines if "," in line.text), lines[0].text))
    shapes = np.array([len(line.text.split(between)) for line in lines], dtype=np.int64)
    for row in np.flatnonzero(~np.isin(shapes, (1, 4, 8)) | [line.text[0] in "mM" for line in lines]):
        raise InputError(f"{path}:{lines[row].number}: {_why_not(lines[row].text, int(shapes[row]))}")
    t = len(lines)
    codes, ltwh, corners = np.full(t, np.nan), np.full((t, 4), np.nan), np.full((t, 4, 2), np.nan)
    for columns in np.unique(shapes).tolist():
        rows = np.flatnonzero(shapes == columns)
        values = numbers(path, [lines[row] for row in rows], columns, REGION)
        if columns == 1:
            codes[rows] = _codes(path, [lines[row] for row in rows], values[:, 0])
        elif columns == 4:
            ltwh[rows] = values
        else:
            corners[rows] = _corners(path, [lines[row] for row in rows], values)
            low, high = corners[rows].min(axis=1), corners[rows].max(axis=1)
            ltwh[rows] = np.concatenate([low, high - low], axis=1)
    result = bool((codes == INIT).any())
    if not result and (codes == FAILURE).any():
        row = np.flatnonzero(codes == FAILURE)[0]
        raise InputError(
            f"{path}:{lines[row].number}: the code 2, a failure, in a file without a 1, where a track begins"
        )
    kept = np.flatnonzero(codes != UNKNOWN) if result else np.arange(t)
    found = boxes(path, [lines[row] for row in kept], kept + shift, ltwh[kept])
    where = np.where(np.isnan(found.x)[:, None, None], np.nan, corners[kept])
    status = found.status
    if result:
        status = np.select([codes[kept] == INIT, np.isnan(found.x)], ["init", "lost"], "tracked")
    return replace(
        found,
        status=status,
        corners=None if np.isnan(where).all() else where,
        path=path,
        header={"read_as": f"VOT {'result' if result else 'text'}: pixels from 0"},
    )


def write_vot(one: Trajectory) -> str:
    """A result of vot-toolkit from frame 0 on: 1 in the first frame of the series, then a region a line, 4 decimals.

    Frames before the first and in gaps are 0, a place that is not known is 2. Lost rows are written: they are the
    estimate. Rows with corners are polygons. `read_vot` gives all rows back but for the place in the first frame.
    Raises InputError for a row with a place and no size, and for a frame below 0.
    """
    if one.frame[0] < 0:
        raise InputError(f"{one.name}: frame {one.frame[0]} is before the clip's first; VOT text begins at frame 0")
    if one.frame[-1] >= MOST_LINES:
        raise InputError(f"{one.name}: frame {one.frame[-1]} is too far on for VOT text, which has a line a frame")
    lines = ["0"] * (int(one.frame[-1]) + 1)
    regions = known_boxes(one).tolist()
    corners = np.full((len(one), 8), np.nan) if one.corners is None else one.corners.reshape(-1, 8)
    for frame, box, polygon in zip(one.frame.tolist(), regions, corners.tolist(), strict=True):
        region = polygon if polygon[0] == polygon[0] else box
        lines[frame] = ",".join(map(decimal, region)) if region[0] == region[0] else "2"
    lines[int(one.frame[0])] = "1"
    return "\n".join(lines) + "\n"


def _why_not(text: str, values: int) -> str:
    if text[0] in "mM":
        return "a mask; masks are not read: give the regions as rectangles or polygons"
    if values > 4 and values % 2 == 0:
        return f"a polygon of {values // 2} corners; polygons of four corners and rectangles are read"
    return f"{values} values; a line holds {REGION}"


def _codes(path: Path, lines: list[Line], codes: Array) -> Array:
    for row in np.flatnonzero(~np.isin(codes, (UNKNOWN, INIT, FAILURE)) & ~np.isnan(codes)):
        raise InputError(
            f"{path}:{lines[row].number}: {codes[row]:.15g} is no code of VOT; 0 is unknown, 1 the start, 2 a failure"
        )
    return np.where(np.isnan(codes), UNKNOWN, codes)


def _corners(path: Path, lines: list[Line], values: Array) -> Array:
    unknown = np.isnan(values)
    with np.errstate(invalid="ignore"):
        for wrong, why in (
            (
                unknown.any(axis=1) & ~unknown.all(axis=1),
                "nan in a polygon; give all eight numbers, or eight times nan",
            ),
            ((np.abs(values) > MAX_PIXELS).any(axis=1), "the polygon is farther out than any picture; correct it"),
        ):
            if wrong.any():
                raise InputError(f"{path}:{lines[np.flatnonzero(wrong)[0]].number}: {why}")
    return values.reshape(-1, 4, 2)
