"""A shape prior from annotated clips: ground truth, or trajectories that somebody has checked.

In every file, each target's first frame in which all parts are seen is its neutral one; every such frame gives one
training shape, registered to it as in section 3.3 (`shape_prior.py`). Of many, those are kept that are far from each
other, so that a clip which is neutral for a minute and smiles for a second keeps the smile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.tracking.models.shape_prior import ShapePrior
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import Trajectory

SEEN = ("visible", "init", "tracked", "")
LEAST_DISTANCE = 0.01  # mouth widths; a shape nearer than this to one that is kept adds nothing
NARROWEST = 0.05  # mouth widths; a narrower kernel would punish a tracker's own noise


class FileReport(NamedTuple):
    """What one file gave: frames in it, and those of them in which every part is seen."""

    path: Path
    frames: int
    used: int

    @property
    def skipped(self) -> int:
        return self.frames - self.used


class Fit(NamedTuple):
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

    Rows that are hidden, absent, lost or without a position do not count as seen. Raises UsageError for part names that
    cannot go together, InputError for a file that cannot be used.
    """
    if not paths:
        raise UsageError("no truth file is named; give one or more, such as clip.truth.csv")
    if max_shapes < 1:
        raise UsageError(f"at most {max_shapes} shapes leave no prior; keep 1 or more")
    tables = [read_trajectory(path) for path in paths]
    names = tuple(parts) if parts is not None else _parts_of(tables[0])
    if len(set(names)) != len(names):
        raise UsageError(f"a part is named twice among {', '.join(names)}")
    if scale[0] == scale[1]:
        raise UsageError(f"the scale is the distance of two parts, and both are {scale[0]}")
    for name in (stable, *scale):
        if name not in names:
            where = "among the parts that are asked for" if parts is not None else f"in {paths[0]}"
            known = ", ".join(names)
            raise UsageError(f"there is no part {name} {where} ({known}); name another with --stable or --scale")
    found = [_shapes_of(path, table, names, stable, scale) for path, table in zip(paths, tables, strict=True)]
    every = np.concatenate([shapes for _, shapes in found])
    kept = every[_spread_out(every.reshape(len(every), -1), max_shapes)]
    prior = ShapePrior(names, kept, stable, scale)
    return Fit(prior, tuple(report for report, _ in found), suggested_sigma(prior))


def suggested_sigma(prior: ShapePrior) -> float:
    """A kernel's standard deviation, in mouth widths: the mean distance of a shape to its nearest neighbour."""
    return max(prior.spacing(), NARROWEST)


def _parts_of(trajectory: Trajectory) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part for _, part in trajectory.names))


def _shapes_of(
    path: Path, trajectory: Trajectory, names: tuple[str, ...], stable: str, scale: tuple[str, str]
) -> tuple[FileReport, Array]:
    if missing := ", ".join(name for name in names if name not in _parts_of(trajectory)):
        raise InputError(f"{path}: there is no part {missing}; annotate it, or name the parts to learn with --parts")
    shapes: list[Array] = []
    total = 0
    for target in trajectory.targets:
        frames, points = _points(trajectory.of_target(target), names)
        total += len(frames)
        seen = np.isfinite(points).all(axis=(1, 2))
        if not seen.any():
            continue
        first = points[seen][0]
        left, right = (first[names.index(name)] for name in scale)
        length = math.hypot(*(right - left))
        if length < 1.0:
            apart = f"are {length:.2f} pixels apart, which gives no scale; correct them"
            raise InputError(f"{path}: frame {frames[seen][0]}: {scale[0]} and {scale[1]} of {target} {apart}")
        moved = points[seen] - first
        shapes.append((moved - moved[:, [names.index(stable)]]) / length)
    if not shapes:
        remedy = "annotate one, or name the parts to learn with --parts"
        raise InputError(f"{path}: none of its {total} frames shows all of {', '.join(names)}; {remedy}")
    found = np.concatenate(shapes)
    far = np.abs(found).max(axis=(1, 2))
    if far.max() > 10.0:
        moves = f"moves {far.max():.0f} times the distance of {scale[0]} and {scale[1]} away from {stable}"
        raise InputError(f"{path}: a part {moves}; correct that row, or name another --scale")
    return FileReport(path, total, len(found)), found


def _points(parts: Sequence[Trajectory], names: Sequence[str]) -> tuple[Whole, Array]:
    """(T,) frames of a target and (T, names, 2) the places of its parts, nan where one is not seen."""
    frames = np.unique(np.concatenate([one.frame for one in parts]))
    points = np.full((len(frames), len(names), 2), np.nan)
    for one in parts:
        if one.part in names:
            seen = np.isin(one.status, SEEN)
            at = np.searchsorted(frames, one.frame[seen])
            points[at, names.index(one.part)] = np.stack([one.x, one.y], axis=1)[seen]
    return frames, points


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
