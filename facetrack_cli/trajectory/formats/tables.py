"""Tables for spreadsheets and data frames: one row a frame, head poses, and measures of a face.

All keep the conventions of trajectory.csv: frames and pixels from 0, x and y the centre, "" what is not known.
Where a row is a frame there is one for each of `every_frame`, since readers count them.
"""

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import POINTS
from facetrack_cli.core.numbers import csv_text
from facetrack_cli.core.types import BOX, Whole
from facetrack_cli.trajectory.analysis.head_pose import SHAPE, head_pose
from facetrack_cli.trajectory.analysis.measures import HAND_MEASURES, MEASURES, Measured
from facetrack_cli.trajectory.clock import every_frame
from facetrack_cli.trajectory.trajectory import DECIMALS, Trajectory, aligned

WIDE = ("x", "y", "w", "h", "confidence", "status")
STD = ("", "_std", "_noise")
POSE = ("frame", "time_s", "target", "pitch", "yaw", "roll", "std_pitch", "std_yaw", "std_roll", "ambiguous")


class Clip(NamedTuple):
    """A clip's name, and its trajectory."""

    name: str
    table: Trajectory


def write_csv_wide(table: Trajectory) -> str:
    """A CSV with one row a frame: frame, time_s, of each part `target_part_x`, y, w, h, confidence, status, and of each
    measure (measures.py) `target_mouth_opening`, `target_mouth_opening_std`, ...

    Of a part `box` the name is the target's alone. The text begins with a byte order mark only where a name is not
    ASCII: spreadsheets need it then. A name that they would take for a formula is put behind an underscore.
    """
    frames, times = timed(table)
    _, columns = aligned(table.parts, *WIDE, frame=frames)
    cells = np.full((len(frames), 2 + len(WIDE) * len(table.parts)), "", dtype=object)
    cells[:, 0] = frames
    cells[:, 1] = times
    for at, (name, values) in enumerate(columns.items(), 2):
        cells[:, at :: len(WIDE)] = values if name == "status" else texts(values, DECIMALS[name])
    names = [f"{_called(*pair)}_{column}" for pair in table.names for column in WIDE]
    for target, measures in table.measures.items():
        cells = np.hstack([cells, _measured(measures, [*measures], frames)])
        names += [f"{_called(target, name)}{end}" for name in measures for end in STD]
    text = csv_text(["frame", "time_s", *names], cells.tolist())
    return text if "".join(names).isascii() else "\ufeff" + text


def write_pose(table: Trajectory) -> str:
    """A CSV with a row for each frame and target that has points: roll, yaw, pitch in degrees, and their spread.

    InputError if no target has enough points for a pose.
    """
    rows: list[list[Any]] = []
    frames, times = timed(table)
    for name in table.targets:
        if (pose := head_pose(table.of_target(name))) is not None:
            cells = np.full((len(frames), 7), "", dtype=object)
            angles = texts(np.hstack([pose.angles, pose.std]), 2)
            cells[pose.frame, :6] = angles
            cells[pose.frame, 6] = np.where(angles[:, 0] == "", "", pose.ambiguous.astype(int))
            lines = zip(frames.tolist(), times.tolist(), cells.tolist(), strict=True)
            rows += ([frame, time, name, *row] for frame, time, row in lines)
    if not rows:
        raise InputError(f"a pose needs four parts that are not in a plane, among {', '.join(SHAPE)}")
    return csv_text(POSE, sorted(rows, key=itemgetter(0)))


def write_measures(clips: Sequence[Clip], many: bool = False) -> str:
    """A CSV with a row for each frame and target: those measures that any target has, and of each `_std` and `_noise`.

    Of `many` clips the first column has their names.
    """
    measures = [{target: found for target, found in clip.table.measures.items() if found} for clip in clips]
    known = {name for targets in measures for found in targets.values() for name in found}
    names = [measure.name for measure in (*MEASURES, *HAND_MEASURES) if measure.name in known]
    if not names:
        face = f"a measure needs parts of a face, among {', '.join(POINTS)}, and its box or its eyes"
        raise InputError(f"{face}, or hands beside the box of a head")
    lines: list[list[Any]] = []
    for clip, targets in zip(clips, measures, strict=True):
        frames, times = timed(clip.table)
        cells = [_measured(found, names, frames).tolist() for found in targets.values()]
        for frame, time, *rows in zip(frames.tolist(), times.tolist(), *cells, strict=True):
            begin = [*([clip.name] if many else []), frame, time]
            lines += ([*begin, target, *row] for target, row in zip(targets, rows, strict=True))
    first = [*(["clip"] if many else []), "frame", "time_s", "target"]
    return csv_text([*first, *(name + end for name in names for end in STD)], lines)


def _measured(measures: Mapping[str, Measured], names: Sequence[str], frames: Whole) -> Any:
    """(T, 3 N) texts of N measures, their spreads and noises in T frames, "" of what is not known."""
    values = np.full((len(names), len(STD), len(frames)), np.nan)
    for k, name in enumerate(names):
        if name in measures:
            values[k][:, np.searchsorted(frames, measures[name].frame)] = measures[name][4:]
    return texts(values.reshape(-1, len(frames)).T, 4)


def _called(target: str, part: str) -> str:
    return part if not target else target if part == BOX else f"{target}_{part}"


def timed(table: Trajectory) -> tuple[Whole, Any]:
    """The frames of `every_frame`, and their times as text, by which readers know a constant rate to 1e-5 of a step."""
    frames, times = every_frame(table)
    steps = np.diff(times)
    return frames, texts(times, 9 if np.any(steps < 1 / 61) else 7)


def texts(values: Any, decimals: int) -> Any:
    """The numbers as text with so many decimals, and never -0; "" for what is not known."""
    return np.where(np.isfinite(values), np.char.mod(f"%.{decimals}f", np.round(values, decimals) + 0.0), "")
