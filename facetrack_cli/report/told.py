"""What a tracker that adapts told of its targets, as the report says it: in words, and drawn on its pictures."""

from __future__ import annotations

import math

import numpy as np

from facetrack_cli.formats.table import Table
from facetrack_cli.formats.told import SURE, ToldSeries
from facetrack_cli.report.events import Clock
from facetrack_cli.report.text import at_clock, percent
from facetrack_cli.types import Array, PartResult


def named(table: Table, clock: Clock) -> list[str]:
    """A sentence for each target that was named: who it is at the end, how sure, and since when it is."""
    found = []
    for told in table.told:
        known = np.flatnonzero(told.identity != "")
        if told.target not in table.targets or not known.size:
            continue
        name, sure = str(told.identity[known[-1]]), float(told.identity_prob[known[-1]])
        whose = f"{told.target} is named" if len(table.targets) > 1 else "It is named"
        said = f"{whose} {name} at the end" + (
            f", with a probability of {percent(sure)}" if math.isfinite(sure) else ""
        )
        passed = told.passed(name)
        if passed is not None:
            said += f"; that passed {SURE:g} in frame {passed:,}, at {at_clock(clock.at(passed))}"
        elif math.isfinite(sure):
            said += f"; that never passed {SURE:g}"
        found.append(f"{said}.")
    return found


def told_of(table: Table, target: str, frame: int) -> tuple[ToldSeries, int] | None:
    """What is told of a target, and its row of this frame."""
    for told in table.told:
        if told.target == target:
            at = int(np.searchsorted(told.frame, frame))
            return (told, at) if at < len(told.frame) and told.frame[at] == frame else None
    return None


def identity(told: ToldSeries, at: int) -> tuple[str | None, float | None]:
    """Who it is in that row, and how sure; None where that is not known."""
    sure = float(told.identity_prob[at])
    return str(told.identity[at]) or None, sure if math.isfinite(sure) else None


def corners(affine: Array, part: PartResult) -> Array | None:
    """(4, 2) corners, clockwise from the top left, of a part whose sides became parallel to the columns of `affine`.

    `affine` (6,) begins with a1 to a4 of [[a1, a2], [a3, a4]]; the sides' lengths are the part's w and h. None where a
    side has no direction.
    """
    across, down = affine[[0, 2]], affine[[1, 3]]
    lengths = math.hypot(*across), math.hypot(*down)
    if not all(math.isfinite(length) and length > 1e-9 for length in lengths):
        return None
    u, v = across * (part.w / 2 / lengths[0]), down * (part.h / 2 / lengths[1])
    return np.array([part.x, part.y]) + np.stack([-u - v, u - v, u + v, v - u])
