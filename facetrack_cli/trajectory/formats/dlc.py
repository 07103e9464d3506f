"""DeepLabCut's CSV: header rows scorer, bodyparts, coords, then a row a frame with x, y, likelihood of every part.

With several targets there are four header rows, the second being `individuals`. DeepLabCut reads it as its own files:
`pandas.read_csv(file, header=[0, 1, 2], index_col=0)`, with several targets `header=[0, 1, 2, 3]`.

- The index is the 0-based frame. A frame in which nothing was tracked has no row.
- `likelihood` is the confidence; lost parts keep their place, which is the tracker's estimate, and have a low one.
  Cells are empty where the place is not known, and the likelihood where the confidence is not.
- Whole numbers are pixel centres, as here. A part `box` is the centre of a box; its size has no room in this format.
"""

from __future__ import annotations

import csv
import io

import numpy as np

from facetrack_cli.trajectory.trajectory import DECIMALS, Trajectory

COORDS = ("x", "y", "likelihood")


def write_dlc(table: Trajectory, scorer: str = "facetrack") -> str:
    """The text of the file; every target's parts in the table's order. `scorer` names what tracked."""
    columns = [(one, coord) for one in table.parts for coord in COORDS]
    heads = [["scorer", *[scorer] * len(columns)]]
    if len(table.targets) > 1:
        heads.append(["individuals", *(one.target for one, _ in columns)])
    heads.append(["bodyparts", *(one.part for one, _ in columns)])
    heads.append(["coords", *(coord for _, coord in columns)])
    frames = table.frames
    cells = np.full((len(frames), len(columns)), "", dtype=object)
    for k, one in enumerate(table.parts):
        rows = np.searchsorted(frames, one.frame)
        known = np.isfinite(one.x) & np.isfinite(one.y)
        for c, (values, name) in enumerate(((one.x, "x"), (one.y, "y"), (one.confidence, "confidence"))):
            written = zip(values.tolist(), (known & np.isfinite(values)).tolist(), strict=True)
            cells[rows, 3 * k + c] = [f"{value:.{DECIMALS[name]}f}" if there else "" for value, there in written]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows(heads)
    writer.writerows([frame, *row] for frame, row in zip(frames.tolist(), cells.tolist(), strict=True))
    return text.getvalue()
