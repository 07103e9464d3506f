"""The axis of time: frames below, seconds above where they are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.report.figures.data import frames_of
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000)


def set_time(top: Axes, bottom: Axes, table: Trajectory, most: int = 11) -> bool:
    """Limits and at most so many ticks of the shared axis of time: frames below, and seconds above if it says True."""
    from matplotlib.ticker import MaxNLocator

    frames = frames_of([s.frame for s in table.parts])
    first, last = float(frames[0]), float(frames[-1])
    margin = max(0.5, 0.004 * (last - first), 1e-9 * last)
    bottom.set_xlim(first - margin, last + margin)
    bottom.set_xlabel("frame")
    bottom.xaxis.set_major_locator(MaxNLocator(max(2, most - 1), integer=True, min_n_ticks=1, steps=[1, 2, 2.5, 5, 10]))
    bottom.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    bottom.tick_params(bottom=True)
    known = times(table)
    if known is None:
        return False
    places, labels = ticks(*known, most)
    above = top.secondary_xaxis("top")
    above.set_ticks(places, labels)
    above.tick_params(length=2, pad=2)
    above.spines["top"].set_visible(False)
    return True


def times(table: Trajectory) -> tuple[Array, Array] | None:
    """(frames, seconds) where seconds are known and increase, whatever the clip's rate; None if there are not two."""
    one = len(frames_of([s.frame for s in table.parts])) == len(table.parts[0])
    series = table.parts[:1] if one else table.parts  # all say the same
    frame = np.concatenate([s.frame for s in series]).astype(np.float64)
    time_s = np.concatenate([s.time_s for s in series])
    known = np.isfinite(time_s)
    frame, at = np.unique(frame[known], return_index=True)
    time_s = time_s[known][at]
    if len(frame) < 2 or (np.diff(time_s) <= 0).any():
        return None
    return frame, time_s


def ticks(frame: Array, time_s: Array, most: int = 11) -> tuple[list[float], list[str]]:
    """Frames at which round times fall, about `most`, and their labels: 1.5 s, 2:30 (minutes), 1:02:30 (hours)."""
    first, last = float(time_s[0]), float(time_s[-1])
    length = last - first
    step = next((s for s in STEPS if length / s <= most), 36000.0 * np.ceil(length / 36000 / most))
    seconds = np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1) * step + 0.0  # no minus zero
    places = np.interp(seconds, time_s, frame).tolist()
    if last < 120 or step < 1:
        decimals = 0 if step >= 1 else 1 if step >= 0.1 else 2
        return places, [f"{t:,.{decimals}f} s" for t in seconds.tolist()]
    whole = [round(t) for t in seconds.tolist()]
    if last < 3600:
        return places, [f"{t // 60}:{t % 60:02}" for t in whole]
    return places, [f"{t // 3600}:{t // 60 % 60:02}:{t % 60:02}" for t in whole]
