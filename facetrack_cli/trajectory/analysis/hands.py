"""What hands do beside a head, as probabilities in each frame: whether they are held still, and what they touch (ours).

Lengths are in sizes of the face: the median over the clip of the square root of its box's area. A hand that is lost for
`GAP_S` at most, as one that motion blurs, is on the straight line between.

- `speed` is that of the straight line through a hand's places within `REACH_S`. Its noise is that of the places, by the
  lower quartile of their second differences, since a hand that moves has large ones. From the speed's square is taken
  what noise alone makes of it.
- `held` is the probability that the speed is below `HOLD`, which is itself known to `BORDER`.
- `touches_hand` and `touches_face`: that two boxes, each as the ellipse within it, meet. Their gap is that of two
  ellipses along the line of their centres, and its noise that of the centres in the rows and `OUTLINE` of the outlines.
  It is the picture that is asked, not how far from the camera each is.
"""

import math
from typing import Final

import numpy as np

from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array, Mask
from facetrack_cli.trajectory.analysis.measures import Measure, Measured, above
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, joined

GAP_S, REACH_S = 0.4, 0.07
HOLD, BORDER = 1.0, 0.3  # face sizes a second: below is a hold, give or take
OUTLINE: Final = 0.1  # face sizes
QUARTILE: Final = 0.3186  # of the absolute value of a standard normal number
HAND_MEASURES: Final = (
    Measure("speed", "face sizes a second", "speed of a hand in the image"),
    Measure("held", "probability", "that a hand is held still"),
    Measure("touches_hand", "probability", "that a hand meets the other hand in the image"),
    Measure("touches_face", "probability", "that a hand meets the face in the image"),
)


@np.errstate(all="ignore")
def hand_measures(table: Trajectory) -> dict[str, dict[str, Measured]]:
    """The measures of each hand of a trajectory by name; none without a head that has a box."""
    boxes = {one.target: one for one in table.parts if one.part == BOX}
    hands, heads = [name for name in HANDS if name in boxes], [name for name in boxes if name not in HANDS]
    if not hands or len(heads) != 1:
        return {}
    parts = [boxes[name] for name in (*hands, *heads)]
    frame, found = aligned(parts, "status", "x", "y", "w", "h", "std_x", "std_y")
    seen = np.isin(found["status"], SEEN)
    x, y, w, h, *spreads = (np.where(seen, found[key], np.nan) for key in ("x", "y", "w", "h", "std_x", "std_y"))
    size = float(np.nanmedian(np.sqrt(w[:, -1] * h[:, -1]))) if np.isfinite(w[:, -1]).any() else np.nan
    time_s = joined(parts).times
    if not size > 0 or len(frame) < 2 or not np.isfinite(time_s).all():
        return {}
    at = np.stack([_bridged(one / size, time_s) for one in (x, y)], axis=-1)  # (T, K, 2)
    half = np.stack([_bridged(one / size / 2, time_s) for one in (w, h)], axis=-1)
    var = np.nan_to_num(spreads[0] ** 2 + spreads[1] ** 2) / 2 / size**2
    measures: dict[str, dict[str, Measured]] = {}
    for k, name in enumerate(hands):
        speed, noise = _speed(at[:, k], seen[:, k], time_s)
        values = {"speed": speed, "held": above(HOLD - speed, math.hypot(noise, BORDER))}
        for j in range(len(parts)):
            if j != k:
                off = at[:, j] - at[:, k]
                apart = np.hypot(*off.T)
                way = off / np.maximum(apart, 1e-9)[:, None]
                reach = sum(1 / np.maximum(np.hypot(*(way / half[:, i]).T), 1e-9) for i in (j, k))
                spread = np.sqrt(var[:, j] + var[:, k] + OUTLINE**2)
                values["touches_face" if j == len(hands) else "touches_hand"] = above(reach - apart, spread)
        std = {"speed": np.where(np.isfinite(speed), noise, np.nan)}
        has = [one for one in HAND_MEASURES if one.name in values]
        measures[name] = {
            key: Measured(key, unit, frame, time_s, values[key], *[std.get(key, speed * np.nan)] * 2)
            for key, unit, *_ in has
        }
    return measures


def _bridged(values: Array, time_s: Array) -> Array:
    """(T, K): where a column is nan for `GAP_S` at most, the straight line between."""
    values = values.copy()
    for column in values.T:
        known = np.flatnonzero(np.isfinite(column))
        for a, b in zip(known[:-1].tolist(), known[1:].tolist(), strict=True):
            if b - a > 1 and time_s[b] - time_s[a] <= GAP_S:
                column[a:b] = np.interp(time_s[a:b], time_s[[a, b]], column[[a, b]])
    return values


def _speed(at: Array, seen: Mask, time_s: Array) -> tuple[Array, float]:
    """(T,) the speed of places (T, 2), nan where they are, and its spread."""
    step = max(float(np.median(np.diff(time_s))), 1e-6)
    k = max(round(REACH_S / step), 1)
    weights = np.arange(-k, k + 1) / np.sum(np.arange(-k, k + 1) ** 2)
    there = np.flatnonzero(seen[:-2] & seen[1:-1] & seen[2:])
    turns = np.abs(np.diff(at, n=2, axis=0)[there]).ravel()
    noise = float(np.quantile(turns, 0.25)) / QUARTILE / np.sqrt(6) if turns.size else np.nan
    spread = max(noise * float(np.hypot.reduce(weights)), 1e-3) / step
    speed = np.full(len(at), np.nan)
    for a, b in spans(np.isfinite(at.sum(axis=1)), np.diff(time_s) > 1.5 * step):
        if b - a > k:
            padded = np.pad(at[a:b], ((k, k), (0, 0)), mode="reflect", reflect_type="odd")
            way = np.stack([np.convolve(one, weights[::-1], mode="valid") for one in padded.T]) / step
            speed[a:b] = np.sqrt(np.maximum(np.sum(way**2, axis=0) - 2 * spread**2, 0.0))
    return speed, spread
