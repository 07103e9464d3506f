"""Axes: limits, labels of ticks, and the axis of time with frames below and seconds above."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STEPS = (1, 2, 2.5, 5, 10)
_SECONDS = (
    0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000,
)  # fmt: skip


def limit(axes: Axes, values: Iterable[Array], floor: float | None = None, ticks: int = 4) -> None:
    """The `limits` of the vertical axis, with few ticks."""
    from matplotlib.ticker import MaxNLocator

    found = limits(values, floor)
    if found is None:
        return
    axes.set_ylim(found)
    places = MaxNLocator(ticks, steps=_STEPS).tick_values(*found)
    inside = [float(place) for place in places if found[0] <= place <= found[1]]
    axes.set_yticks(inside, numbers(inside))


def limits(values: Iterable[Array], floor: float | None = None) -> tuple[float, float] | None:
    """Limits a little wider than `values`, at least 1 apart, None where nothing is known.

    Where the whole range is more than eight times that of the middle 98 % of the rows, they follow the middle: a few
    rows far outside do not compress all others.
    """
    every = np.concatenate([v[np.isfinite(v)] for v in values] or [np.empty(0)])
    if not every.size:
        return None
    low, high = float(every.min()), float(every.max())
    middle = np.quantile(every[:: max(1, len(every) // 500_000)], (0.01, 0.99))
    tall = max(float(middle[1] - middle[0]), 1.0)
    if high - low > 8 * tall:
        low, high = max(low, float(middle[0]) - tall), min(high, float(middle[1]) + tall)
    if floor is not None:
        high += max(1.0 - (high - floor), 0)
        return floor, high + 0.06 * (high - floor)
    short = max(1.0 - (high - low), 0) / 2
    low, high = low - short, high + short
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def numbers(ticks: Sequence[float]) -> list[str]:
    """Labels of ticks, with as many decimals as one of them needs."""
    if any(abs(tick) >= 1e7 for tick in ticks):
        return [f"{tick:.3g}" for tick in ticks]
    decimals = next((d for d in range(4) if all(abs(t - round(t, d)) < 1e-9 for t in ticks)), 4)
    return [f"{tick + 0.0:,.{decimals}f}".replace("-", "\N{MINUS SIGN}") for tick in ticks]


def frame_axis(axes: Axes, frame: Whole, most: int = 11) -> None:
    """An axis of frames, which increase, with at most `most` ticks."""
    from matplotlib.ticker import MaxNLocator

    first, last = float(frame[0]), float(frame[-1])
    margin = max(0.5, 0.004 * (last - first), 1e-9 * last)
    axes.set_xlim(first - margin, last + margin)
    axes.set_xlabel("frame")
    axes.xaxis.set_major_locator(MaxNLocator(max(2, most - 1), integer=True, min_n_ticks=1, steps=_STEPS))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.tick_params(bottom=True)


def second_axis(axes: Axes, table: Trajectory, most: int) -> bool:
    """An axis of seconds above that of frames; False where seconds are not known or do not increase."""
    time_s = table.times
    known = np.isfinite(time_s)
    if known.sum() < 2 or (np.diff(time_s[known]) <= 0).any():
        return False
    above = axes.secondary_xaxis("top")
    above.set_ticks(*ticks(table.frames[known], time_s[known], most))
    above.tick_params(length=2, pad=2)
    above.spines["top"].set_visible(False)
    return True


def ticks(frame: Whole, time_s: Array, most: int = 11) -> tuple[list[float], list[str]]:
    """About `most` frames at round times, and their labels: 1.5 s, 2:30 (minutes), 1:02:30 (hours)."""
    first, last = float(time_s[0]), float(time_s[-1])
    length = last - first
    step = next((s for s in _SECONDS if length / s <= most), 36000.0 * np.ceil(length / 36000 / most))
    seconds = np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1) * step + 0.0  # no minus zero
    places = np.interp(seconds, time_s, frame).tolist()
    if last < 120 or step < 1:
        decimals = 0 if step >= 1 else 1 if step >= 0.1 else 2
        return places, [f"{t:,.{decimals}f} s" for t in seconds.tolist()]
    whole = [round(t) for t in seconds.tolist()]
    if last < 3600:
        return places, [f"{t // 60}:{t % 60:02}" for t in whole]
    return places, [f"{t // 3600}:{t // 60 % 60:02}:{t % 60:02}" for t in whole]
