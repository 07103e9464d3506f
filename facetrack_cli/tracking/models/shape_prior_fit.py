"""A shape prior from annotated clips: truth files, or trajectories that somebody has checked.

In every file, each target's first frame in which all parts are seen is its neutral one; every such frame gives one
training shape, registered to it as in section 3.3 (see priors.py). Of many, as few are kept as cover them all: farthest
point first, so that a clip which is neutral for a minute and smiles for a second keeps the smile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import Array
from facetrack_cli.tracking.models.shape_prior import ShapePrior
from facetrack_cli.trajectory.csv_reader import read_csv
from facetrack_cli.trajectory.row import Row

SEEN = ("visible", "init", "tracked", "")
LEAST_DISTANCE = 0.01  # mouth widths; a shape nearer than this to one that is kept adds nothing
NARROWEST = 0.05  # mouth widths; a narrower kernel would punish a tracker's own noise


@dataclass(frozen=True, slots=True)
class FileReport:
    """What one file gave: frames in it, and those of them in which every part is seen."""

    path: Path
    frames: int
    used: int

    @property
    def skipped(self) -> int:
        return self.frames - self.used


@dataclass(frozen=True, slots=True)
class Fit:
    """The prior, what each file gave to it, and the kernel's standard deviation that suits it, in mouth widths."""

    prior: ShapePrior
    files: tuple[FileReport, ...]
    sigma: float


def fit_prior(
    paths: Sequence[Path],
    parts: Sequence[str] | None = None,
    stable: str = "nose",
    scale: tuple[str, str] = ("mouth_left", "mouth_right"),
    max_shapes: int = 500,
) -> Fit:
    """A prior of `parts` (all that the first file has, if None) from truth or trajectory files.

    Rows that are hidden, absent, lost or without a position do not count as seen. The suggested sigma is the mean
    distance of a shape to its nearest neighbour, 0.05 at least. The same files give the same prior. Raises UsageError
    for part names that cannot go together, InputError for a file that cannot be used.
    """
    if not paths:
        raise UsageError("no truth file is named; give one or more, such as clip.truth.csv")
    if max_shapes < 1:
        raise UsageError(f"at most {max_shapes} shapes leave no prior; keep 1 or more")
    tables = [_read(path) for path in paths]
    names = tuple(parts) if parts is not None else _parts_of(tables[0])
    if len(set(names)) != len(names):
        raise UsageError(f"a part is named twice among {', '.join(names)}")
    if scale[0] == scale[1]:
        raise UsageError(f"the scale is the distance of two parts, and both are {scale[0]}")
    for name in (stable, *scale):
        if name not in names:
            where = "among the parts that are asked for" if parts is not None else f"in {paths[0]}"
            raise UsageError(
                f"there is no part {name} {where} ({', '.join(names)}); name another with --stable or --scale"
            )
    shapes: list[Array] = []
    files: list[FileReport] = []
    for path, targets in zip(paths, tables, strict=True):
        report, found = _shapes_of(path, targets, names, stable, scale)
        files.append(report)
        shapes.append(found)
    every = np.concatenate(shapes)
    kept = every[_spread_out(every.reshape(len(every), -1), max_shapes)]
    prior = ShapePrior(names, kept, stable, scale)
    return Fit(prior, tuple(files), suggested_sigma(prior))


def suggested_sigma(prior: ShapePrior) -> float:
    """A kernel's standard deviation that joins the shapes of a prior to one density, in mouth widths."""
    return max(prior.spacing(), NARROWEST)


Target = dict[int, dict[str, Row]]  # frame -> part -> row


def _read(path: Path) -> dict[str, Target]:
    targets: dict[str, Target] = {}
    for row in read_csv(path):
        frame = targets.setdefault(row.target, {}).setdefault(row.frame, {})
        if row.part in frame:
            raise InputError(
                f"{path}: frame {row.frame} has part {row.part} of {row.target} twice; keep one row for each part"
            )
        frame[row.part] = row
    if not targets:
        raise InputError(f"{path}: there is no row in it; a truth file has one for each frame and part")
    return targets


def _parts_of(targets: dict[str, Target]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part for target in targets.values() for frame in target.values() for part in frame))


def _shapes_of(
    path: Path, targets: dict[str, Target], names: tuple[str, ...], stable: str, scale: tuple[str, str]
) -> tuple[FileReport, Array]:
    missing = [name for name in names if name not in _parts_of(targets)]
    if missing:
        raise InputError(
            f"{path}: there is no part {', '.join(missing)}; annotate it, or name the parts to learn with --parts"
        )
    shapes: list[Array] = []
    for target, frames in targets.items():
        seen = [(number, points) for number in sorted(frames) if (points := _points(frames[number], names)) is not None]
        if not seen:
            continue
        number, first = seen[0]
        left, right = (first[names.index(name)] for name in scale)
        length = math.hypot(*(right - left))
        if length < 1.0:
            raise InputError(
                f"{path}: frame {number}: {scale[0]} and {scale[1]} of {target} are {length:.2f} pixels apart, "
                "which gives no scale; correct them"
            )
        moved = np.stack([points for _, points in seen]) - first
        shapes.append((moved - moved[:, [names.index(stable)]]) / length)
    total = sum(len(frames) for frames in targets.values())
    if not shapes:
        raise InputError(
            f"{path}: none of its {total} frames shows all of {', '.join(names)}; "
            "annotate one, or name the parts to learn with --parts"
        )
    found = np.concatenate(shapes)
    far = np.abs(found).max(axis=(1, 2))
    if far.max() > 10.0:
        raise InputError(
            f"{path}: a part moves {far.max():.0f} times the distance of {scale[0]} and {scale[1]} away from {stable}; "
            "correct that row, or name another --scale"
        )
    return FileReport(path, total, len(found)), found


def _points(frame: dict[str, Row], names: tuple[str, ...]) -> Array | None:
    rows = [frame.get(name) for name in names]
    places = [(row.x, row.y) for row in rows if row is not None and row.status in SEEN]
    if len(places) < len(names) or any(x is None or y is None for x, y in places):
        return None
    return np.array(places, np.float64)


def _spread_out(flat: Array, most: int) -> list[int]:
    """Indices, in order, of at most `most` rows: the first, then again and again the row farthest from all chosen."""
    chosen = [0]
    nearest = ((flat - flat[0]) ** 2).sum(1)
    while len(chosen) < most:
        index = int(nearest.argmax())
        if nearest[index] < LEAST_DISTANCE**2:
            break
        chosen.append(index)
        nearest = np.minimum(nearest, ((flat - flat[index]) ** 2).sum(1))
    return sorted(chosen)
