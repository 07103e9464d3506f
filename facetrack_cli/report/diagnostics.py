"""What a tracker that adapts told of its targets, as the report says it: in words, and drawn on its pictures."""

from __future__ import annotations

import math

import numpy as np

from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.report.events import Clock
from facetrack_cli.report.text import percent
from facetrack_cli.trajectory.diagnostics import SURE, ToldSeries
from facetrack_cli.trajectory.table import Table


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
