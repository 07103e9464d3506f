# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Loops over the points of a face: steps of particles, and what is learned of windows, sensors and landmarks.

`motion.py`, `window_ncc.py` and `landmark_filters.py` say what they compute. S sensors measure K parts: places z are
(S, K, 2), and all else that is said of each part is (S, K). `eyes` are the pixels between the eyes.
"""

import math
from typing import Final

import numpy as np

from facetrack_cli.engine.kernels.compiled import AS_IT_IS, HIDDEN, LOST, exact, invert_cdf, part, read_at

BY_REGRESSION, BY_DETECTOR, BY_NETWORK = 0, 1, 2  # the order of the sensors
# of sensors; lengths in those between the eyes
DRIFT: Final = 0.001  # standard deviation of b in a frame
MAX_NOISE: Final = 0.1  # the greatest r of a sensor
MISLED: Final = 0.1  # r in a face of which a part is hidden: a sensor places all parts together
LEARNS: Final = 0.02  # share of a measurement in r^2
SLIP: Final = 0.1  # standard deviation of what a head moves in a frame and its box does not
MAX_SQUARED_DISTANCE: Final = 9.0  # of squared distances, in variances
WINDOWS: Final = 0.97  # probability that windows see a part that is visible, and nothing like it
BLIND: Final = 0.1  # a sensor's share that is left of a part that is hidden
ASTRAY: Final = 0.25  # standard deviation of z where a sensor takes something else for the part
ENDS: Final = 0.1  # probability a frame that it no longer does
OFTEN: Final = 0.01  # share of a frame in how often it does
LIMITS: Final = (0.01, 0.9)  # of that
MAX_LOG_ODDS: Final = 4.0  # bound of what one frame says of it, and of what the head's filter is told
# of landmarks without windows
KEEP: Final = 0.5
LANDMARK_MEMORY: Final = 100.0  # frames over which s and r are learned, and four times that for the place at rest
LANDMARK_NOISE: Final = (0.005, 0.05)  # bounds of r, in lengths between the eyes
# of what is learned of windows, as window_ncc.py says
MEMORY: Final = 50.0  # frames over which g and b are learned
NEW_BELOW: Final = 0.7  # correlation with all templates below which a visible part gives a new one
DOUBTED, SOFT = 0.45, 0.1
BY_WINDOW, BY_SENSOR = (-1.0, 6.0), (-4.0, 4.0)  # bounds of the terms of the evidence: looks change
YOUNG: Final = 3  # frames
UNLIKE: Final = 2.0  # below what a sensor usually says of a part, which then may be half covered
HIDE, SHOW = 0.01, 0.1  # probabilities a frame
BOUNDS: Final = (0.001, 0.98)  # of v
USED: Final = 0.02  # rate at which it is learned how often a template matches best


@part
def visible_after(before, evidence):
    """P(visible) a frame later than `before`, by the log ratio of the likelihoods of visible and hidden."""
    ahead = before * (1.0 - HIDE) + (1.0 - before) * SHOW
    return 1.0 / (1.0 + (1.0 - ahead) / ahead * math.exp(-evidence))


@part
def _ahead(reliability, error_rate):
    begins = min(ENDS * error_rate / (1.0 - error_rate), 1.0 - ENDS)
    return reliability * (1.0 - begins) + (1.0 - reliability) * ENDS


@part
def _median(values, mask):
    """Of the values (K,) in the mask (K,); 0 of less than three."""
    each, count = np.empty(len(values)), 0
    for k in range(len(values)):
        if mask[k]:
            i, count = count, count + 1
            while i > 0 and each[i - 1] > values[k]:
                each[i] = each[i - 1]
                i -= 1
            each[i] = values[k]
    return 0.5 * (each[(count - 1) // 2] + each[count // 2]) if count > 2 else 0.0


@exact("f8:2 b1:1 f8:1")
def median_shift(offsets, mask, shift):
    """`shift` (2,): the median of the offsets (K, 2) in the mask (K,); 0 of less than three."""
    shift[0], shift[1] = _median(offsets[:, 0], mask), _median(offsets[:, 1], mask)


@part
def _apart(z, var, sure, one, other, k):
    squared = (z[one, k, 0] - z[other, k, 0]) ** 2 + (z[one, k, 1] - z[other, k, 1]) ** 2
    both = min(sure[one, k], sure[other, k]) > 0.0
    return both and squared > MAX_SQUARED_DISTANCE * (var[one, k] + var[other, k])


@part
def _join(z, var, sure, one, other, k):
    """Two readings of a part in the place of the first."""
    if sure[other, k] == 0.0:
        return
    first = 0.0 if _apart(z, var, sure, one, other, k) else sure[one, k] / var[one, k]
    second = sure[other, k] / var[other, k]
    total = max(first + second, 1e-12)
    for i in range(2):
        z[one, k, i] = (first * z[one, k, i] + second * z[other, k, i]) / total
    sure[one, k] = max(sure[one, k], sure[other, k])
    var[one, k] = sure[one, k] / total


@part
def _fuse(z, var, sure, before, eyes, fused, shift):
    """`fused` (K, 2) and `shift` (2,) of readings as `BiasFilter.reading` says; whether they are too far apart."""
    z, var, sure = z.copy(), var.copy(), sure.copy()
    apart, off, seen = False, np.empty_like(before), np.empty(len(before), np.bool_)
    for k in range(len(before)):
        _join(z, var, sure, BY_REGRESSION, BY_NETWORK, k)
        for i in range(2):
            fused[k, i] = z[BY_REGRESSION, k, i] if sure[BY_REGRESSION, k] > 0.0 else np.nan
        apart |= _apart(z, var, sure, BY_REGRESSION, BY_DETECTOR, k)
        _join(z, var, sure, BY_REGRESSION, BY_DETECTOR, k)
        off[k, 0], off[k, 1] = z[BY_REGRESSION, k, 0] - before[k, 0], z[BY_REGRESSION, k, 1] - before[k, 1]
        seen[k] = sure[BY_REGRESSION, k] > 0.5
    median_shift(off, seen, shift)
    share = 1.0 / (1.0 + _median(var[BY_REGRESSION], seen) / (SLIP * eyes) ** 2)
    shift[0], shift[1] = share * shift[0], share * shift[1]
    return apart


@exact("f8:3 f8:1 f8:3 f8:2 f8:2 f8:2 f8:2 f8 f8:2 f8 f8:3 f8:2 f8:2 f8:2 f8:1")
def read(z, visible, bias, var, noise, reliability, error_rate, keep, before, eyes, at, spread, sure, fused, shift):
    """`BiasFilter.reading` of measurements z by its fields: the reading `at`, `spread`, `sure`, and what it returns."""
    least, drift = np.inf, (DRIFT * eyes) ** 2
    for k in range(len(visible)):
        least = min(least, visible[k])
    for s in range(len(z)):
        for k in range(len(visible)):
            spread[s, k] = keep**2 * var[s, k] + drift + (noise[s, k] + (MISLED * eyes) ** 2 * (1.0 - least))
            known = math.isfinite(z[s, k, 0]) and math.isfinite(z[s, k, 1])
            right = _ahead(reliability[s, k], error_rate[s, k])
            sure[s, k] = right * (BLIND + (1.0 - BLIND) * visible[k]) if known else 0.0
            for i in range(2):
                at[s, k, i] = z[s, k, i] - keep * bias[s, k, i] if known else 0.0
    return _fuse(at, spread, sure, before, eyes, fused, shift)


@part
def _compare(z, var, sure, at, cov, visible, own, spread, certain, differ, cross):
    any_, last, off, seen, shift = False, len(z), np.empty_like(at), np.empty(len(at), np.bool_), np.empty(2)
    for s in range(last):
        for k in range(len(at)):
            off[k, 0], off[k, 1], seen[k] = z[s, k, 0] - at[k, 0], z[s, k, 1] - at[k, 1], sure[s, k] > 0.0
        median_shift(off, seen, shift)
        for k in range(len(at)):
            own[s, k, 0], own[s, k, 1] = z[s, k, 0] - shift[0], z[s, k, 1] - shift[1]
            spread[s, k], certain[s, k], cross[s, k] = var[s, k], sure[s, k], 0.0
    for k in range(len(at)):
        own[last, k, 0], own[last, k, 1], spread[last, k] = at[k, 0], at[k, 1], 0.5 * (cov[k, 0, 0] + cov[k, 1, 1])
        certain[last, k], differ[k] = WINDOWS * visible[k], False
        for one in range(1, last + 1):
            for other in range(one):
                differ[k] |= _apart(own, spread, certain, one, other, k)
        any_ |= differ[k]
        both = min(sure[BY_REGRESSION, k], sure[BY_NETWORK, k]) > 0.0
        if both and not _apart(z, var, sure, BY_REGRESSION, BY_NETWORK, k):
            squared = (z[0, k, 0] - z[BY_NETWORK, k, 0]) ** 2 + (z[0, k, 1] - z[BY_NETWORK, k, 1]) ** 2
            cross[BY_REGRESSION, k] = cross[BY_NETWORK, k] = 0.25 * squared
    return any_


@part
def _learn(z, state, cov, visible, log_odds, cross, least, keep, eyes, bias, var, noise, reliability, error_rate):
    """The fields of a `BiasFilter` after a frame, overwritten; `least` (S,) are the least r."""
    parts, off, seen, shift = len(visible), np.empty_like(state), np.empty(len(visible), np.bool_), np.empty(2)
    lowest, drift, astray, most = np.inf, (DRIFT * eyes) ** 2, (ASTRAY * eyes) ** 2, (MAX_NOISE * eyes) ** 2
    for k in range(parts):
        lowest = min(lowest, visible[k])
    for s in range(len(z)):
        says = False
        for k in range(parts):
            for i in range(2):
                bias[s, k, i] *= keep
                off[k, i] = z[s, k, i] - bias[s, k, i] - state[k, i]
            var[s, k] = keep**2 * var[s, k] + drift
            reliability[s, k] = _ahead(reliability[s, k], error_rate[s, k])
            seen[k] = math.isfinite(off[k, 0]) and math.isfinite(off[k, 1])
            says |= seen[k]
        if not says:
            continue
        median_shift(off, seen, shift)
        for k in range(parts):
            total = var[s, k] + noise[s, k] + 0.5 * (cov[k, 0, 0] + cov[k, 1, 1])
            far, evidence, before = total + astray, log_odds[s, k], reliability[s, k]
            if math.isnan(evidence):
                evidence = 0.0
                if seen[k]:
                    alone = 0.5 * ((off[k, 0] - shift[0]) ** 2 + (off[k, 1] - shift[1]) ** 2)
                    evidence = math.log(far / total) - alone * (1.0 / total - 1.0 / far)
            evidence = min(max(evidence, -MAX_LOG_ODDS), MAX_LOG_ODDS)
            right = 1.0 / (1.0 + math.exp(-(math.log(before / (1.0 - before)) + visible[k] * evidence)))
            reliability[s, k] = right
            squared, use, rate = 0.0, 0.0, error_rate[s, k]
            if seen[k]:
                squared = 0.5 * (off[k, 0] ** 2 + off[k, 1] ** 2)
                rate += OFTEN * visible[k] * (1.0 - right - rate)
                # a hidden part misplaces all of them
                use = visible[k] * lowest * right if squared < MAX_SQUARED_DISTANCE * total else 0.0
                for i in range(2):
                    bias[s, k, i] += use * var[s, k] / total * off[k, i]
            error_rate[s, k] = min(max(rate, LIMITS[0]), LIMITS[1])
            wide = noise[s, k] + LEARNS * use * (max(squared, cross[s, k]) - noise[s, k])
            noise[s, k] = min(max(wide, least[s] ** 2), most)
            var[s, k] *= 1.0 - use * var[s, k] / total


@exact("f8:3 f8:2 f8:2 f8:2 f8:3 f8:1 f8:3 f8:2 f8:2 b1:1 f8:2 f8:2 f8:3 f8:1 f8 f8 f8:3 f8:2 f8:2 f8:2 f8:2")
def learn(
    z, var, sure, at, cov, visible, own, spread, certain, differ, cross, odds, measured, least, keep, eyes, bias, b_var,
    noise, right, wrong,
):  # fmt: skip
    """The fields of a `BiasFilter` after a frame, from `bias` on, overwritten, by the `odds` (S + 1, K) of a `Judge`.

    Without `odds`, there are the readings `own`, `spread`, `certain` (S + 1, K) for it, and if any part differs, True
    is returned and nothing learned. `differ` (K,): in which two cannot both be right. `cross` (S, K): a sensor's share
    of the squared distance from an independent one, in square pixels; the filter's place alone would flatter a sensor
    that has moved it.
    """
    if len(odds) == 0 and _compare(z, var, sure, at, cov, visible, own, spread, certain, differ, cross):
        return True
    odds = np.full_like(certain, np.nan) if len(odds) == 0 else odds
    _learn(measured, at, cov, visible, odds, cross, least, keep, eyes, bias, b_var, noise, right, wrong)
    return False


@exact("b1 f8:2 f8:1 f8 f8:2 f8:2 f8:1 f8:1 f8:1 f8:1 f8:2 f8:3 f8:1")
def follow(seen, z, log_odds, eyes, rest, offset, var, motion_var, noise_var, visible, carried, last, least):
    """The fields of a `LandmarkFilter` a frame later, overwritten; z (J, 2) counts where the sensor has `seen` a face.

    `least` (J,) are the least s.
    """
    total, fx, fy, tx, ty, size, along, across = 0.0, 0.0, 0.0, 0.0, 0.0, 1e-9, 0.0, 0.0
    weight = np.empty(len(rest))
    for j in range(len(rest)):
        visible[j] = visible_after(visible[j], min(max(log_odds[j], BY_SENSOR[0]), BY_SENSOR[1]))
        offset[j, 0], offset[j, 1] = KEEP * offset[j, 0], KEEP * offset[j, 1]
        var[j] = KEEP**2 * var[j] + (1.0 - KEEP**2) * motion_var[j]
        weight[j] = min(max(visible[j], BOUNDS[0]), BOUNDS[1])
        total += weight[j]
    if not seen:
        return
    # `rest` moved, turned and scaled to come nearest to z by least squares
    for j in range(len(rest)):
        weight[j] /= total
        fx, fy = fx + weight[j] * rest[j, 0], fy + weight[j] * rest[j, 1]
        tx, ty = tx + weight[j] * z[j, 0], ty + weight[j] * z[j, 1]
    for j in range(len(rest)):
        x, y, u, v = rest[j, 0] - fx, rest[j, 1] - fy, z[j, 0] - tx, z[j, 1] - ty
        along, across = along + weight[j] * (x * u + y * v), across + weight[j] * (x * v - y * u)
        size += weight[j] * (x * x + y * y)
    for j in range(len(rest)):
        x, y = (rest[j, 0] - fx) / size, (rest[j, 1] - fy) / size
        carried[j, 0], carried[j, 1] = tx + along * x - across * y, ty + across * x + along * y
        gain, rate = visible[j] * var[j] / (var[j] + noise_var[j]), visible[j] / LANDMARK_MEMORY
        bend, moved = 0.0, 0.0
        for i in range(2):
            offset[j, i] += gain * (z[j, i] - carried[j, i] - offset[j, i])
            bend += (z[j, i] - 2.0 * last[1, j, i] + last[0, j, i]) ** 2 / 12.0  # noise of z, where it is smooth
            moved += 0.5 * offset[j, i] ** 2
            rest[j, i] += rate / 4.0 * offset[j, i]
            last[0, j, i], last[1, j, i] = last[1, j, i], z[j, i]
        var[j] *= 1.0 - gain
        # what moves is no noise
        noise = noise_var[j] + rate * (min(bend, 4.0 * noise_var[j]) - noise_var[j])
        noise_var[j] = min(max(noise, (LANDMARK_NOISE[0] * eyes) ** 2), (LANDMARK_NOISE[1] * eyes) ** 2)
        motion_var[j] = max(motion_var[j] + rate * (moved - motion_var[j]), least[j] ** 2)


@part
def _relay(to, x, out):
    """Places x (J, 2) times the complex number a + ib, plus u + iv, of `to`."""
    a, b, u, v = to
    for j in range(len(x)):
        out[j, 0], out[j, 1] = a * x[j, 0] - b * x[j, 1] + u, b * x[j, 0] + a * x[j, 1] + v


@exact("f8x4 f8:3 f8:2 f8:3 f8:3 f8:2 f8:3")
def relay(to, x, state, bias, new_x, new_state, new_bias):
    """Places x (N, K, 2) and `state` (K, 2), and offsets `bias` (S, K, 2), in another stabilized image."""
    for n in range(len(x)):
        _relay(to, x[n], new_x[n])
    _relay(to, state, new_state)
    for s in range(len(bias)):
        _relay((to[0], to[1], 0.0, 0.0), bias[s], new_bias[s])


@exact("f8:2 f8:3 f8:1 i8:1 f8:1 f8:2 f8:2 f8:2 f8:1 f8:1 f8:1 f8:2 f8:1 f8:2 i8:1 f8:3")
def show(
    at, cov, seen, below, ess, sides, carried, offset, var, bias_std, visible, head, known, rows, how, corners
):  # fmt: skip
    """Of the parts of a face in a frame the `rows` (14, R), `how` (R,) they are seen, and `corners` (R, 4, 2).

    First are points with windows, at `at` (K, 2) of the stabilized image with `cov` (K, 2, 2), `seen` (K,), and in
    doubt since `below` frames; then the box, which has covariance `head` (2, 2); then those without windows, as their
    `LandmarkFilter` says. `known` are numbers: the map, the picture, and the box, as `FaceParts._rows` lists them.

    Rows are x, y, angle, time, confidence, w, h, ess, particles, and those of the spread. Of what is hidden, the head
    alone says where it is. Hidden are also points without windows with `visible` below `least`, and what is beyond the
    `right` and `bottom` of the picture. What is right with a probability below `least` is lost.
    """
    a, b, cx, cy, middle, scale, near, shown, least, patience, right, bottom, time, particles = known[:14]
    sure, w, h, head_ess, angle, cos, sin, std_w, std_h, status = known[14:]
    k, rows[:], corners[:] = len(at), np.nan, np.nan
    rows[3], rows[8] = time, particles
    for i in range(len(how)):
        if i == k:
            rows[0, i], rows[1, i], rows[2, i], rows[4, i], rows[5, i], rows[6, i] = cx, cy, angle, sure, w, h
            rows[7, i], rows[11, i], rows[12, i], rows[13, i], how[i] = head_ess, head[0, 1], std_w, std_h, int(status)
            rows[9, i], rows[10, i] = math.sqrt(max(head[0, 0], 0.0)), math.sqrt(max(head[1, 1], 0.0))
            for d in range(4):  # clockwise; the border runs through the middle of the outermost pixels
                u, v = (w - 1.0) * (-0.5 if d % 3 == 0 else 0.5), (h - 1.0) * (-0.5 if d < 2 else 0.5)
                corners[i, d, 0], corners[i, d, 1] = cx + cos * u - sin * v, cy + sin * u + cos * v
        else:
            if i < k:
                u, v, p, q, r, s = at[i, 0], at[i, 1], cov[i, 0, 0], cov[i, 1, 1], cov[i, 0, 1], seen[i]
                rows[5, i], rows[6, i], rows[7, i] = scale * sides[i, 0], scale * sides[i, 1], ess[i]
            else:
                j = i - k - 1
                u, v, p = carried[j, 0] + offset[j, 0], carried[j, 1] + offset[j, 1], var[j] + bias_std[j] ** 2
                q, r, s = p, 0.0, visible[j]
            u, v, doubt = u - middle, v - middle, 1.0 - s * shown
            rows[0, i], rows[1, i] = a * u - b * v + cx, b * u + a * v + cy
            x = a * a * p - 2.0 * a * b * r + b * b * q + doubt * head[0, 0]
            y = b * b * p + 2.0 * a * b * r + a * a * q + doubt * head[1, 1]
            rows[9, i], rows[10, i] = math.sqrt(x), math.sqrt(y)
            rows[11, i] = a * b * (p - q) + (a * a - b * b) * r + doubt * head[0, 1]
            there = shown * (1.0 - math.exp(-near * near / (1e-9 if x + y < 1e-9 else x + y)))  # nan stays
            rows[4, i] = there * (s if i < k else 1.0)
            how[i] = HIDDEN if i > k and s < least else AS_IT_IS
            if not there >= least or (i < k and below[i] >= patience):
                how[i] = LOST
        if how[i] == AS_IT_IS and (min(rows[0, i], rows[1, i]) < 0.0 or rows[0, i] > right or rows[1, i] > bottom):
            how[i] = HIDDEN


@exact("f8:2 i8:1 i8:2 f4:3 f8:2 f8:1 f8:1 f8:2 f8:3 f8:1 f8 f8:1 f8:1 f8:1 f8:2 b1:1 b1:1")
def judge(
    like, number, age, maps, corner, beside, odds, state, x, log_w, sure, good, visible, usual, used, new, forgets
):  # fmt: skip
    """What parts at `state` (K, 2) that correlate by `like` (K, T) teach a `WindowState`; some of it is overwritten.

    `new` (K,): parts whose window becomes a template, where the standard deviation of particles x (N, K, 2) is below
    `sure` pixels. `forgets` (K,): parts whose young ones go. Returns whether there are any.
    """
    changes, w = False, np.exp(log_w)
    for k in range(len(like)):
        r, best, young = -np.inf, 0, False
        for t in range(number[k]):
            young |= age[k, t] < YOUNG
            if age[k, t] >= YOUNG:
                r = max(r, like[k, t])
            if like[k, t] > like[k, best]:
                best = t
        q, said = (good[k] - r) / max(good[k] - beside[k], 0.05), min(max(odds[k], BY_SENSOR[0]), BY_SENSOR[1])
        v = visible_after(visible[k], min(max((DOUBTED - q) / SOFT, BY_WINDOW[0]), BY_WINDOW[1]) + said)
        r = read_at(maps[k], state[k, 0] - corner[k, 0], state[k, 1] - corner[k, 1])
        visible[k] = v
        good[k] += v / MEMORY * (r - good[k])
        usual[k] += v / MEMORY * (said - usual[k])
        square = np.zeros(2)
        for n in range(len(x)):
            for i in range(2):
                square[i] += w[n] * (x[n, k, i] - state[k, i]) ** 2
        clear = v > 0.5 and math.sqrt(max(square[0], square[1])) < sure and odds[k] >= usual[k] - UNLIKE
        new[k] = clear and like[k, best] < NEW_BELOW and used.shape[1] > 1
        forgets[k] = v < 0.5 and young
        if clear and not new[k]:
            for t in range(used.shape[1]):
                used[k, t] = (1.0 - USED) * used[k, t] + (USED if t == best else 0.0)
        changes |= new[k] or forgets[k]
    return changes


@part
def _says(sure):
    says = False
    for k in range(len(sure)):  # any() of an array brings all of SciPy into the process
        says |= sure[k] > 0.0
    return says


@part
def weigh(log_w, w):
    """w (N,) in proportion to exp(log_w), equal without a number; returns the logarithm of the sum of exp(log_w)."""
    top, total = -1e30, 0.0  # as `engine.filters.MIN_LOG`
    for value in log_w:
        top = value if not value <= top else top  # nan stays
    for i in range(len(log_w)):
        w[i] = math.exp(max(log_w[i], -1e30) - top) if math.isfinite(top) else 1.0
        total += w[i]
    return top + math.log(total)


@exact
def add_up(z, var, sure, area, at, p, w):
    """The modes `at`, p and w of `motion.modes`."""
    at[0], p[0], w[0], m = 0.0, 0.0, 0.0, 1
    for s in range(len(z)):
        if not _says(sure[s]):
            continue
        for k in range(z.shape[1]):
            right, new = min(max(sure[s, k], 1e-6), 1.0 - 1e-6), 1.0 / var[s, k]
            for i in range(m):
                # it may say nothing
                at[m + i, k, 0], at[m + i, k, 1], p[m + i, k] = at[i, k, 0], at[i, k, 1], p[i, k]
                w[m + i, k] = w[i, k] + math.log1p(-right) - math.log(area)
                total = p[i, k] + new
                off = (z[s, k, 0] - at[i, k, 0]) ** 2 + (z[s, k, 1] - at[i, k, 1]) ** 2
                w[i, k] += math.log(right) - 0.5 * (off * p[i, k] * new / total) - math.log(2.0 * math.pi * var[s, k])
                for d in range(2):
                    at[i, k, d] = (p[i, k] * at[i, k, d] + new * z[s, k, d]) / total
                p[i, k] = total
        m *= 2


@exact
def jump(
    x, uniform, at, var, sure, area, sigma, wide, jumps, rest, keep, anywhere, maps, corner, visible, sharpness, floor,
    moved, log_p,
):  # fmt: skip
    """Particles x (N, K, 2) `moved` by a JumpingWalk given sensors, and their log likelihoods (N, K) with that of maps.

    `uniform` (N, K) and `moved` (N, K, 2) are draws; without the former, `moved` are places to weigh. `at`,
    `var`, `sure` and `area` are what is measured, `anywhere` is the share of draws that is even. `maps`, `corner`,
    `visible`, `sharpness` and `floor` are those of WindowNcc.
    """
    many = 1
    for s in range(len(at)):
        many *= 2 if _says(sure[s]) else 1
    z, p, w = np.empty((many, x.shape[1], 2)), np.empty((many, x.shape[1])), np.empty((many, x.shape[1]))
    add_up(at, var, sure, area, z, p, w)
    many *= 2
    middle, (above, drawn, target, proposal) = np.empty((2, many)), np.empty((4, many))
    wider, often, nearer, width, fall, scale = np.empty((6, many))
    mx = my = top = 0.0
    for k in range(x.shape[1]):
        hidden = (1.0 - visible[k]) * math.exp(-floor * sharpness)
        for c in range(many):
            square = sigma[k] ** 2 if c % 2 == 0 else wide[k] ** 2
            wider[c] = 1.0 + square * p[c // 2, k]
            nearer[c], width[c] = 1.0 - 1.0 / wider[c], math.sqrt(square / wider[c])
            fall[c], scale[c] = -0.5 * wider[c] / square, math.log(wider[c])
            often[c] = w[c // 2, k] + math.log(max(1.0 - jumps if c % 2 == 0 else jumps, 1e-12))
        for n in range(len(x)):
            if n == 0 or x[n, k, 0] != x[n - 1, k, 0] or x[n, k, 1] != x[n - 1, k, 1]:  # parents come in order
                mx, my = rest[k, 0] + keep * (x[n, k, 0] - rest[k, 0]), rest[k, 1] + keep * (x[n, k, 1] - rest[k, 1])
                top = -math.inf
                for c in range(many):
                    u, v = z[c // 2, k, 0] - mx, z[c // 2, k, 1] - my
                    middle[0, c], middle[1, c] = mx + nearer[c] * u, my + nearer[c] * v
                    above[c] = often[c] - 0.5 * (u**2 + v**2) * p[c // 2, k] / wider[c] - scale[c]
                    top = max(top, above[c])
                total = 0.0
                for c in range(many):
                    above[c] = math.exp(above[c] - top)
                    total += above[c]
                for c in range(many):
                    drawn[c] = (1.0 - anywhere) * above[c] / total + anywhere / many
                    target[c], proposal[c] = above[c] / width[c] ** 2, drawn[c] / width[c] ** 2
            if len(uniform) > 0:
                left, c = uniform[n, k] - drawn[0], 0
                while left > 0.0 and c < many - 1:
                    c += 1
                    left -= drawn[c]
                moved[n, k, 0] = middle[0, c] + width[c] * moved[n, k, 0]
                moved[n, k, 1] = middle[1, c] + width[c] * moved[n, k, 1]
            u, v, wanted, given = moved[n, k, 0], moved[n, k, 1], 0.0, 0.0
            for c in range(many):
                density = math.exp(fall[c] * ((u - middle[0, c]) ** 2 + (v - middle[1, c]) ** 2))
                wanted += target[c] * density
                given += proposal[c] * density
            r = read_at(maps[k], u - corner[k, 0], v - corner[k, 1])
            score = (visible[k] * math.exp(sharpness * (r - 1.0)) + hidden) * (wanted / given)
            log_p[n, k] = top + math.log(score) if wanted > 0.0 else -math.inf


@exact(
    "f8:3 f8:1 f8:1 f8:2 f8:1 i8:2 f8:3 f8:2 f8:2 f8 f8:1 f8:1 f8 f8:2 f8 f8 f4:3 f8:2 f8:1 f8 f8 f8:2 f8:1 f8"
    " f8:3 f8:3 f8:1 f8:1"
)
def step(
    x, log_w, first, uniform, second, order, at, var, sure, area, sigma, wide, jumps, rest, keep, anywhere,
    maps, corner, visible, sharpness, floor, to_unit, origin, freedom, moved, after, log_after, ess,
):  # fmt: skip
    """Particles x (N, K, 2) with `log_w` a step of `engine.filters.factorized` later, without a look ahead.

    `first` and `second` (K,), `uniform` and `order` (N, K), which permutes each column, and `moved` are draws.
    `to_unit`, `origin` and `freedom` are those of a StudentPrior, all else is as in `jump`. What follows is `after`
    (N, K, 2) with `log_after`, and `ess` (K,). Returns the log evidence.
    """
    (n, parts), evidence = x.shape[:2], 0.0
    w, points, scores = np.empty((n, parts)), np.empty((n, parts)), np.empty((n, parts))
    chosen, one = np.empty((n, parts), np.int64), np.empty(n)
    for i in range(n):
        w[i] = math.exp(log_w[i])
        for k in range(parts):
            points[i, k] = (i + first[k]) / n
    invert_cdf(w, points, chosen)
    for i in range(n):
        for k in range(parts):
            after[i, k, 0], after[i, k, 1] = x[chosen[i, k], k, 0], x[chosen[i, k], k, 1]
    jump(
        after, uniform, at, var, sure, area, sigma, wide, jumps, rest, keep, anywhere, maps, corner, visible, sharpness,
        floor, moved, scores,
    )  # fmt: skip
    for k in range(parts):
        evidence += weigh(scores[:, k], w[:, k])
        for i in range(n):
            points[i, k] = (i + second[k]) / n
    invert_cdf(w, points, chosen)
    for i in range(n):
        squared = 0.0
        for k in range(parts):
            j = chosen[order[i, k], k]
            after[i, k, 0], after[i, k, 1] = moved[j, k, 0], moved[j, k, 1]
        for j in range(len(origin)):
            unit = -origin[j]
            for k in range(parts):
                unit += after[i, k, 0] * to_unit[2 * k, j] + after[i, k, 1] * to_unit[2 * k + 1, j]
            squared += unit * unit
        log_after[i] = -0.5 * (freedom + len(origin)) * math.log1p(squared / freedom)
    total = weigh(log_after, one)
    log_after -= total
    one /= np.sum(one)
    w[:], ess[:] = 0.0, 0.0  # how much each origin weighs
    for k in range(parts):
        for i in range(n):
            w[chosen[order[i, k], k], k] += one[i]
        for i in range(n):
            ess[k] += w[i, k] ** 2
        ess[k] = 1.0 / ess[k]
    return evidence + total - (parts + 1) * math.log(n)
