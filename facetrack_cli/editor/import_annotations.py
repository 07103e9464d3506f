"""Corrections from an annotation tool: where its export differs from the rows of the run that were exported."""

from collections import defaultdict
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX, Correction, TargetStart
from facetrack_cli.engine.corrected import all_or
from facetrack_cli.run_folder.finished import Run
from facetrack_cli.trajectory.formats.cvat import read_cvat
from facetrack_cli.trajectory.formats.labelstudio import read_labelstudio
from facetrack_cli.trajectory.select import hide_outside
from facetrack_cli.trajectory.trajectory import DECIMALS, UNSEEN, Trajectory, every_frame

MOVED: Final = 0.05  # pixels: CVAT keeps two decimals


def imported_corrections(path: Path, run: Run, rows: Trajectory) -> tuple[Correction, ...]:
    """The corrections in which the keyframes of an annotation tool's file differ from `rows` of a run; () for none.

    A visible part is placed by hand if its place is more than MOVED pixels from its row, if that is not seen, and in
    the first frame after it was not visible. A part that is not visible, and whose row is seen, is absent from there
    on. InputError for a file that cannot be read, and for a part that the run lacks.
    """
    found, rows = read_annotations(path, run, rows), hide_outside(rows, run.header.source.size)
    given: dict[tuple[int, str], dict[str, tuple[float, ...] | None]] = defaultdict(dict)
    for one in found.parts:
        row = rows.find(one.target, one.part)
        if row is None:
            there = ", ".join("/".join(pair) if pair[1] != BOX else pair[0] for pair in rows.names)
            raise InputError(f"{path}: {one.name} is not in the run, which has {there}; correct the label")
        # the box of a head that carries points is not absent by itself
        carries = one.part == BOX and len(run.parts[one.target]) > 1
        for frame, place in _changes(one.take(one.status != "absent") if carries else one, row):
            given[frame, one.target][one.part] = place
    return tuple(_correction(*key, parts, run) for key, parts in sorted(given.items()))


def read_annotations(path: Path, run: Run, rows: Trajectory) -> Trajectory:
    """The file of an annotation tool: CVAT's XML, or Label Studio's JSON. InputError if it is neither."""
    begins = ""
    if path.is_file():
        with path.open("rb") as file:
            begins = file.read(256).decode("utf-8-sig", "replace").lstrip()
    if begins[:1] in ("[", "{"):
        return read_labelstudio(path, run.header.source.size, every_frame(rows), fps=run.header.source.fps)
    return read_cvat(path)


def _changes(one: Trajectory, row: Trajectory) -> list[tuple[int, tuple[float, ...] | None]]:
    """Frames in which a part is corrected: to its place (x, y), or box, or to None, absent."""
    found: list[tuple[int, tuple[float, ...] | None]] = []
    gone = False  # by a correction of these
    boxes, places = one.boxes.tolist(), np.stack([one.x, one.y], axis=1).tolist()
    for n in np.flatnonzero(one.by_hand).tolist():
        frame, at = int(one.frame[n]), row.row(int(one.frame[n]))
        known = at is not None and bool(np.isfinite(row.x[at] + row.y[at]))
        lost = not known or row.status[at] in UNSEEN
        if one.status[n] == "absent":
            if not lost and not gone:
                found.append((frame, None))
                gone = True
            continue
        box = one.part == BOX
        place = tuple(round(value, DECIMALS["x"]) for value in (boxes[n] if box else places[n]))
        there = (row.boxes[at] if box else np.array([row.x[at], row.y[at]])) if known else np.array(np.nan)
        if gone or not np.abs(there - place).max() <= MOVED or (lost and one.status[n] == "visible"):
            found.append((frame, place))
        gone = False
    return found


def _correction(frame: int, target: str, parts: dict[str, tuple[float, ...] | None], run: Run) -> Correction:
    absent = all_or([part for part, place in parts.items() if place is None], run.parts[target])
    if absent is True:
        return Correction(frame, target, absent=True)
    box = parts.get(BOX)
    points = {part: (place[0], place[1]) for part, place in parts.items() if place is not None and part != BOX}
    given = TargetStart(box=None if box is None else (box[0], box[1], box[2], box[3]), points=points)
    return Correction(frame, target, given, absent=absent)
