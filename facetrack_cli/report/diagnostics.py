"""Who a tracker says that its targets are, in words."""

from __future__ import annotations

import math

import numpy as np

from facetrack_cli.report.events import Clock
from facetrack_cli.report.text import at_clock, percent
from facetrack_cli.trajectory.diagnostics import SURE
from facetrack_cli.trajectory.trajectory import Trajectory


def named(table: Trajectory, clock: Clock) -> list[str]:
    """A sentence for each target that was named: who it is at the end, how sure, and since when it is."""
    found = []
    for target in table.targets:
        one = table.of_target(target)[0]
        known = np.flatnonzero(one.identity != "")
        if not known.size:
            continue
        name, sure = str(one.identity[known[-1]]), float(one.identity_prob[known[-1]])
        whose = f"{target} is named" if len(table.targets) > 1 else "It is named"
        said = f"{whose} {name} at the end" + (
            f", with a probability of {percent(sure)}" if math.isfinite(sure) else ""
        )
        passed = table.recognised(target, name)
        if passed is not None:
            said += f"; that passed {SURE:g} in frame {passed:,}, at {at_clock(clock.at(passed))}"
        elif math.isfinite(sure):
            said += f"; that never passed {SURE:g}"
        found.append(f"{said}.")
    return found
