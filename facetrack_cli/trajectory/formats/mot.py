"""MOTChallenge text: frame, id, left, top, width, height, and what follows. Frames, ids and pixels are counted from 1.

Ground truth (motchallenge.net/instructions; MOT16 and later): `flag, class, visibility`, nine values. Results and MOT15
ground truth: `conf, x, y, z`, ten values, -1 where not known. Files that end after height or conf are read too.

- Ids become the targets "1", "2", ..., each with the part "box".
- A flag of 0 says that the row is not to be considered: it is left out, as if the frame were not annotated.
- A visibility of 0 is "hidden": the box is known, and nothing of the target can be seen. Anything above is "visible".
- Ten values may be either. If every conf is 0 or 1 it is taken for the flag, else for a confidence, and then all rows
  count, as the benchmark has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Mask
from facetrack_cli.trajectory.formats.boxes import known_boxes
from facetrack_cli.trajectory.formats.lines import (
    FROM_ONE,
    boxes,
    decimal,
    delimiter,
    lines_with_frame,
    no_frame_twice,
    numbers,
    read_text,
    whole,
)
from facetrack_cli.trajectory.trajectory import Trajectory, joined

COLUMNS = {
    6: "frame,id,left,top,width,height",
    7: "frame,id,left,top,width,height,conf",
    9: "frame,id,left,top,width,height,flag,class,visibility",
    10: "frame,id,left,top,width,height,conf,x,y,z",
}


def read_mot(path: Path, *, shift: int = 0, results: bool | None = None) -> Trajectory:
    """A series for each id. `results` says that column 7 is a confidence (True) or a flag (False); None: look.

    Raises InputError, with the line, for what is no MOTChallenge text, and for two rows of one frame and id.
    """
    lines = lines_with_frame(read_text(path))
    columns = len(lines[0].text.split(delimiter(lines[0].text)))
    if columns not in COLUMNS:
        raise InputError(
            f"{path}:{lines[0].number}: {columns} values; MOTChallenge text has {COLUMNS[9]}, or {COLUMNS[10]}"
        )
    values = numbers(path, lines, columns, COLUMNS[columns])
    frame = whole(path, lines, values[:, 0], "frame", 1)
    ident = whole(path, lines, values[:, 1], "id", 1)
    no_frame_twice(path, lines, np.stack([frame, ident], axis=1), "frame and id")
    seventh = values[:, 6] if columns > 6 else np.full(len(lines), np.nan)
    if results is None:
        results = columns != 9 and not np.isin(seventh, (0, 1)).all()
    considered: Mask = np.full(len(lines), True) if results else seventh != 0
    if not considered.any():
        raise InputError(f"{path}: every row has the flag 0, not to be considered; there is nothing in it to measure")
    confidence = np.where((seventh >= 0) & (seventh <= 1), seventh, np.nan) if results else None
    status = np.full(len(lines), "visible", dtype="<U8")
    if columns == 9 and not results:
        status[values[:, 8] == 0] = "hidden"
    ltwh = values[:, 2:6] - FROM_ONE
    order = np.argsort(ident, kind="stable")
    found = []
    for rows in np.split(order, np.flatnonzero(np.diff(ident[order])) + 1):
        rows = rows[considered[rows]]
        if rows.size:
            found.append(
                boxes(
                    path,
                    [lines[row] for row in rows],
                    frame[rows] - 1 + shift,
                    ltwh[rows],
                    target=str(ident[rows[0]]),
                    status=status[rows],
                    confidence=None if confidence is None else confidence[rows],
                )
            )
    dropped = np.count_nonzero(~considered)
    left_out = f", {dropped} rows of flag 0 left out" if dropped else ""
    return joined(found, path=path, header={"read_as": f"MOTChallenge: frames and pixels from 1{left_out}"})


def write_mot(chosen: Sequence[Trajectory]) -> str:
    """Results of MOTChallenge, sorted by frame: ten values a row, at most 4 decimals; conf is -1 where not known.

    A series is an id: its target's name if all are numbers and differ, else 1, 2, ... in their order. Lost rows are
    written: they are the estimate. Rows without a place are not, which is how the format says that nothing was found.
    `read_mot(..., results=True)` gives the rest back. Raises InputError for a row with a place and no size.
    """
    names = [one.target for one in chosen]
    numbered = all(n.isascii() and n.isdigit() and int(n) > 0 for n in names) and len({int(n) for n in names}) == len(
        names
    )
    rows: list[tuple[int, int, str]] = []
    for at, one in enumerate(chosen, 1):
        ident = int(one.target) if numbered else at
        box = known_boxes(one) + FROM_ONE
        for frame, conf, ltwh in zip(one.frame.tolist(), one.confidence.tolist(), box.tolist(), strict=True):
            if ltwh[0] == ltwh[0]:  # not nan
                known = decimal(conf) if conf == conf else "-1"
                rows.append((frame + 1, ident, f"{','.join(map(decimal, ltwh))},{known},-1,-1,-1\n"))
    return "".join(f"{frame},{ident},{rest}" for frame, ident, rest in sorted(rows))
