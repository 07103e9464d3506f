# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""The loop over the rows of a calibration, as confidence.py says what it computes; nan stays nan."""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact, part

AS_IT_IS, HIDDEN, LOST = 0, 1, 2


@part
def _within(x, low, high):
    return low if x < low else high if x > high else x


@part
def _between(knots, count, x):
    """Linear between the first `count` of the knots (2, M), level beyond them."""
    i = 0
    while i < count - 2 and x > knots[0, i + 1]:
        i += 1
    if count == 1 or x <= knots[0, 0]:
        return knots[1, 0]
    share = (x - knots[0, i]) / (knots[0, i + 1] - knots[0, i])
    return knots[1, i] + (1.0 if share > 1.0 else share) * (knots[1, i + 1] - knots[1, i])


@exact
def calibrate(rows, boxes, lost, init, size, slopes, ends, knots, counts, spread, cap, likely, how):
    """Overwrites confidence and spread of `rows` (10, R), and says `how` (R,) they are seen; returns if that changes.

    `rows` are confidence, w, h, ess, particles, std_x, std_y, cov_xy, std_w and std_h; `boxes`, `lost` and `init` (R,)
    say which of them are. Of points and of boxes are `slopes` (2, 6) of the features, `ends` (2, 2), the intercept and
    the least p, which is nan without a logistic regression, `knots` (2, 2, M), and their `counts` (2,), 0 without any
    and -1 without a map.
    """
    f, gone, changes = np.empty(6), False, False
    for i in range(len(boxes)):
        gone |= lost[i] and boxes[i]
    for i in range(len(boxes)):
        kind, side, c, ess, p = 1 if boxes[i] else 0, size, rows[0, i], rows[3, i], np.nan
        if counts[kind] >= 0 and not math.isnan(c):
            if boxes[i] or size == 0.0:
                side = math.sqrt(rows[1, i] * rows[2, i])
            f[0], f[1], f[4] = c, math.log((c + 0.01) / (1.01 - c)), 1.0 if lost[i] else 0.0
            f[2] = math.log(_within(math.hypot(rows[5, i], rows[6, i]) / side, 1e-3, 10.0))
            f[3] = math.log10(_within(ess / rows[4, i], 1e-3, 1.0))
            # what is small in the picture is placed less exactly, in terms of its size
            f[5], p = math.log(_within(side, 3.0, 1000.0)), ends[kind, 0]
            for j in range(6):
                p += slopes[kind, j] * f[j] if slopes[kind, j] != 0.0 else 0.0
            if not math.isnan(ends[kind, 1]):
                p = _within(1.0 / (1.0 + math.exp(-_within(p, -700.0, 700.0))), ends[kind, 1], 1.0 - ends[kind, 1])
            if counts[kind] > 0 and not math.isnan(p):
                p = _between(knots[kind], counts[kind], p)
        if gone and lost[i] and p > cap:
            p = cap
        factor = 1.0 if math.isnan(ess) or counts[kind] < 0 else spread[kind]
        for j in range(5, 10):
            rows[j, i] *= factor**2 if j == 7 else factor
        kept, how[i] = init[i] or math.isnan(c) or math.isnan(ess), AS_IT_IS
        if not kept:
            rows[0, i] = p
            if p < likely:
                how[i] = LOST
            elif lost[i] and not math.isnan(p):
                how[i] = HIDDEN
        changes |= how[i] != AS_IT_IS
    return changes
