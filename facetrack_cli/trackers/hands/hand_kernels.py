# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Steps and weights of two hands, particle by particle; what they mean stands in `target.py`.

Places x (N, 2, 4) and the `face` (2,) are in sizes of the face's first box, of which the face now has `size` and which
are `scale` pixels of the maps (H, W) float32. `strength` is what the share of skin in a hand adds to log p.
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact, part

HIDES = 0.5  # of `skin`, which two hands that overlap need once: between two discs apart, 0, and a union, 1
NEWS = 0.4  # share of the last step in the velocity
REST = np.array([[-1.4, 4.6], [1.4, 4.6]])  # where hands hang, about the face's middle, in its sizes
REACH = (0.0, 1.6, 3.2, 3.6)  # ellipse of an arm's reach about the face's middle, in its sizes: x, y, half axes
ANYWHERE = 0.1  # share of the hands that appear anywhere within reach, and not about where they were
BEYOND, WITHIN = 12.0, 0.8  # what a place beyond that share of the ellipse loses of log p
_BEYOND, _WITHIN = np.float32(BEYOND), np.float32(WITHIN)
SHOULDERS = np.array([[-0.9, 1.1], [0.9, 1.1]])  # about the face's middle, in its sizes
BEYOND_HAND = (1.6, 2.2)  # radii from a hand's middle to where no skin is, seen from the shoulder
FAR_END = 0.15  # what skin there takes away, of what it would give within the hand
MIDDLE = 0.2  # what skin on two opposite sides takes away
ARM = (0.8, 0.4, 3.0)  # sizes from one hand to another place of its arm: from, to surely, to at most
SPREAD = 0.6  # pixels of the reduced frame, about a place of most skin
WINDOW = 0.8  # radii, standard deviation of the window in which the axis of a hand is measured
CHANGED_WIDTH = 1.0  # grey levels, of the logistic function of a change
LEARNS, HELD = 0.1, 0.02  # share of a frame in the head's template, and where it has changed or a hand is before it
DARK, BRIGHT, ENOUGH = 20, 240, 0.1  # levels that tell the light, and which share of a lattice must be between them
LEAST_GAIN = 0.01  # of a channel: less is left as it is
STEEP, STEADY = 1.5, 0.03  # mean slopes, of which an edge changes by less if the camera stands still
_ALONG = (0.2, 0.35, 0.5, 0.65, 0.8)
_OPPOSITE = np.array([[2 * math.cos(k * math.pi / 6), 2 * math.sin(k * math.pi / 6)] for k in range(6)])  # radii
_TINY, _FAR = 1e-12, 9.0  # of a density, and standard deviations beyond which it is less than that


@part
def _at(values, x, y):
    """The value at a place in pixels; -9 beyond the border."""
    height, width = values.shape
    column, row = int(np.rint(x)), int(np.rint(y))
    if column < -1 or column > width or row < -1 or row > height:
        return -9.0
    return np.float64(values[min(max(row, 0), height - 1), min(max(column, 0), width - 1)])


@part
def _skin(evidence, x, y, scale, ox, oy, hides):
    """The skin at a place, but for what another hand there `hides`."""
    return 0.0 if (x - ox) ** 2 + (y - oy) ** 2 < hides**2 else max(_at(evidence, x * scale, y * scale), 0.0)


@part
def _joined(evidence, ax, ay, bx, by, scale):
    """Whether there is skin all along the line between two places, 0 to 1."""
    least = math.inf
    for t in _ALONG:
        least = min(least, _at(evidence, scale * (ax + t * (bx - ax)), scale * (ay + t * (by - ay))))
    return min(max((least - 0.2) / 0.4, 0.0), 1.0)


@part
def _arm(evidence, ax, ay, bx, by, scale, size, nearest):
    """How surely two places are of one bare arm: skin all along the line, `nearest` sizes apart at least."""
    apart = math.hypot(ax - bx, ay - by) / size
    within = min(max((apart - nearest) / ARM[1], 0.0), 1.0) * min(max((ARM[2] - apart) / 0.5, 0.0), 1.0)
    return within * _joined(evidence, ax, ay, bx, by, scale) if within > 0.0 else 0.0


@part
def _spread(evidence, x, y, far, sigma):
    """Variances along x and y and covariance of the skin within `far` pixels of a place; -1 without any.

    Skin counts by a normal window of standard deviation `sigma` about the place.
    """
    height, width = evidence.shape
    s = mx = my = xx = yy = xy = 0.0
    for row in range(max(int(np.rint(y - far)), 0), min(int(np.rint(y + far + 1)), height)):
        for column in range(max(int(np.rint(x - far)), 0), min(int(np.rint(x + far + 1)), width)):
            if evidence[row, column] > 0.0:
                dx, dy = column - x, row - y
                w = evidence[row, column] * math.exp(-0.5 * (dx * dx + dy * dy) / sigma**2)
                s, mx, my = s + w, mx + w * dx, my + w * dy
                xx, yy, xy = xx + w * dx * dx, yy + w * dy * dy, xy + w * dx * dy
    if s < 1e-3:
        return -1.0, -1.0, 0.0
    mx, my = mx / s, my / s
    return max(xx / s - mx * mx, 0.0), max(yy / s - my * my, 0.0), xy / s - mx * my


@part
def _drawn(often, u):
    """The index that a uniform number draws."""
    k, total = 0, often[0]
    while k < len(often) - 1 and total <= u:
        k += 1
        total += often[k]
    return k


@exact("f4:2 f8 f8 f8:1 f8 f8 f8 f4:2 f8:2 f8:1")
def fit_skin(share, strength, skin, face, size, scale, least, fit, at, heights):
    """log p(y | x) of a hand at each pixel, `fit` (H, W), by the `share` of skin there and the reach of an arm.

    Its highest places above `least` are `at` (P, 2), at most as many as `heights` (P,), which fall; returns how many.
    """
    (height, width), (x, y, a, b), count = share.shape, REACH, 0
    strength, skin, along = np.float32(strength), np.float32(skin), np.empty(width, np.float32)
    for j in range(width):
        along[j] = (((j / scale - face[0]) / size - x) / a) ** 2
    for i in range(height):
        down, row, of = np.float32((((i / scale - face[1]) / size - y) / b) ** 2), fit[i], share[i]
        for j in range(width):
            beyond = _BEYOND * (_WITHIN - np.sqrt(along[j] + down))
            row[j] = strength * (of[j] - skin) + min(beyond, np.float32(0.0))
    for i in range(height):
        for j in range(width):
            here = fit[i, j]
            if here <= least or (count == len(heights) and here <= heights[count - 1]):
                continue
            highest = True
            for k in range(max(i - 2, 0), min(i + 3, height)):
                for m in range(max(j - 2, 0), min(j + 3, width)):
                    highest &= fit[k, m] <= here
            if highest:
                count = min(count + 1, len(heights))
                k = count - 1
                while k > 0 and heights[k - 1] < here:
                    at[k], heights[k] = at[k - 1], heights[k - 1]
                    k -= 1
                at[k, 0], at[k, 1], heights[k] = j, i, here
    return count


@exact("u1:3 u1:3 i8")
def same_light(first, now, thin):
    """Whether no channel of `now` (H, W, 3) has changed by a factor since `first`, on each `thin`-th row and column.

    The factor is the median over pixels; it is also the same light where too few of them tell.
    """
    low, high = np.float32(1.0 - LEAST_GAIN), np.float32(1.0 + LEAST_GAIN)
    (height, width, _), usable, of = now.shape, 0, 0
    below, within = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for y in range(0, height, thin):
        for x in range(0, width, thin):
            of, tells = of + 1, True
            for c in range(3):
                tells &= DARK <= first[y, x, c] <= BRIGHT and DARK <= now[y, x, c] <= BRIGHT
            usable += tells
            for c in range(3 if tells else 0):
                factor = np.float32(now[y, x, c]) / np.float32(first[y, x, c])
                below[c] += factor <= low
                within[c] += factor < high
    return usable < ENOUGH * of or (below.max() <= usable // 2 < within.min())


@exact("u1:2 u1:2 u1:2")
def edges(before, after, slope):
    """How many edges of `before` (H, W) are steep, by its `slope`, and at how many of these `after` is another."""
    (height, width), total, steep, moved = slope.shape, 0, 0, 0
    for y in range(height):
        for x in range(width):
            total += slope[y, x]
    least = STEEP * total / (height * width)
    for y in range(height):
        for x in range(width):
            if slope[y, x] > least:
                steep += 1
                moved += abs(np.int32(after[y, x]) - np.int32(before[y, x])) > np.rint(STEADY * slope[y, x])
    return steep, moved


@exact("f8:3 b1:2 b1:1 f8:3 f8:3 f8:2 f8:1 f8:1 f8:1 f8:1 f8 f4:2 f4:2 f8:1 f8 f8 f8:1")
def move(
    x, seen, parted, luck, noise, peaks, often, steps, shares, chances, strength, evidence, covered, face, size, scale,
    weight,
):  # fmt: skip
    """Particles moved by a frame, in place, and the logarithm of p(x | x') / q(x) in `weight` (N,).

    `luck` (2, 4, N) is uniform, `noise` (2, 3, N, 2) standard normal. `peaks` (P, 2) are the places of most skin in
    pixels, proposed as `often` (P,) as that; `steps` and `shares` (3,) those of the motion. `chances` (3,) are those to
    appear, to vanish, and to be proposed; `covered` is 1 at the face.
    """
    sigma, appears, vanishes, proposed = SPREAD / scale, chances[0], chances[1], chances[2]
    for n in range(len(x)):
        total = 0.0
        for hand in range(2):
            mine, was = x[n, hand], seen[n, hand]
            u, e = luck[hand], noise[hand]
            now = u[0, n] >= vanishes if was else u[0, n] < appears and len(peaks) > 0
            x0, y0, vx, vy = mine[0], mine[1], mine[2], mine[3]
            if now:
                step = steps[_drawn(shares, u[1, n])]
                ax, ay = x0 + vx + step * e[n, 0], y0 + vy + step * e[n, 1]
                if len(peaks):
                    if not was or u[3, n] < proposed:
                        k = _drawn(often, u[2, n])
                        ax, ay = peaks[k, 0] / scale + sigma * e[n, 0], peaks[k, 1] / scale + sigma * e[n, 1]
                    q = 0.0
                    for k in range(len(peaks)):
                        away = (ax - peaks[k, 0] / scale) ** 2 + (ay - peaks[k, 1] / scale) ** 2
                        if away < (_FAR * sigma) ** 2:
                            q += often[k] * math.exp(-0.5 * away / sigma**2)
                    q /= 2 * math.pi * sigma**2
                    if was:
                        away, moved = (ax - x0 - vx) ** 2 + (ay - y0 - vy) ** 2, 0.0
                        for k in range(3):
                            var = steps[k] ** 2
                            if away < _FAR**2 * var:
                                moved += shares[k] / (2 * math.pi * var) * math.exp(-0.5 * away / var)
                        total += math.log((moved + _TINY) / ((1 - proposed) * moved + proposed * q + _TINY))
                    else:  # it is about where it was, or anywhere within reach; but never before the face
                        near = math.exp(-0.5 * ((ax - x0) ** 2 + (ay - y0) ** 2)) / (2 * math.pi)
                        near = (1 - ANYWHERE) * near + ANYWHERE / (math.pi * REACH[2] * REACH[3])
                        total += math.log(near / (q + _TINY)) - BEYOND * max(_at(covered, ax * scale, ay * scale), 0.0)
                # nor does one leap along its own bare arm, to the elbow
                total -= strength * _arm(evidence, x0, y0, ax, ay, scale, size, ARM[0])
                mine[0], mine[1] = ax, ay
            else:
                for k in range(2):
                    rest = face[k] + size * REST[hand, k]
                    mine[k] += 0.5 * mine[2 + k] + 0.03 * (rest - mine[k]) + 0.15 * e[n, k]
            if was and now:
                vx, vy = NEWS * (ax - x0) + (1 - NEWS) * vx, NEWS * (ay - y0) + (1 - NEWS) * vy
            elif now:
                vx = vy = 0.0
            else:
                vx, vy = 0.5 * vx, 0.5 * vy
            mine[2], mine[3], seen[n, hand] = vx, vy, now
        if not (seen[n, 0] and seen[n, 1]):
            parted[n] = False
        elif not parted[n]:
            parted[n] = _joined(evidence, x[n, 0, 0], x[n, 0, 1], x[n, 1, 0], x[n, 1, 1], scale) <= 0.0
        weight[n] = total


@exact("f8:3 b1:2 b1:1 f4:2 f4:2 f4:2 f8:1 f8 f8 f8 f8 f8 f8:1")
def weigh(x, seen, parted, fit, share, evidence, face, size, scale, radius, strength, skin, out):
    """Adds log p(y, x) of both hands, but for the motion, to `out` (N,); `fit` is log p(y | x) of a hand at each pixel,
    `share` that of skin in it. `radius` is that of a hand in sizes of the face now, `skin` what a hand has.
    """
    far = radius * size
    for n in range(len(x)):
        total, least, both = 0.0, math.inf, seen[n, 0] and seen[n, 1]
        hides = 1.2 * far if both else 0.0
        for hand in range(2):
            if not seen[n, hand]:
                continue
            px, py, ox, oy = x[n, hand, 0], x[n, hand, 1], x[n, 1 - hand, 0], x[n, 1 - hand, 1]
            total += _at(fit, px * scale, py * scale)
            least = min(least, _at(share, px * scale, py * scale))
            wx, wy = px - face[0] - size * SHOULDERS[hand, 0], py - face[1] - size * SHOULDERS[hand, 1]
            length = max(math.hypot(wx, wy), 1e-6)
            beyond = sides = 0.0
            for k in range(2):
                reach = far * BEYOND_HAND[k] / length
                beyond += 0.5 * _skin(evidence, px + reach * wx, py + reach * wy, scale, ox, oy, hides)
            for k in range(6):
                dx, dy = far * _OPPOSITE[k, 0], far * _OPPOSITE[k, 1]
                one = _skin(evidence, px + dx, py + dy, scale, ox, oy, hides)
                sides = max(sides, min(one, _skin(evidence, px - dx, py - dy, scale, ox, oy, hides)))
            total -= strength * (FAR_END * beyond + MIDDLE * sides)
        if both:
            ax, ay, bx, by = x[n, 0, 0], x[n, 0, 1], x[n, 1, 0], x[n, 1, 1]
            shared = min(1.3 * max(1 - math.hypot(ax - bx, ay - by) / (2 * far), 0.0), 1.0)
            one = _arm(evidence, ax, ay, bx, by, scale, size, ARM[0] if parted[n] else -ARM[1])
            total -= strength * (shared * max(least - HIDES * skin, 0.0) + one * max(least, 0.0))
        out[n] += total


@exact("f8:3 b1:2 f8:1 f4:2 f8 f4:2 f8 f8:1 f8:2 f8:3 f8:1 f8:1 f8:2")
def gather(x, seen, w, skin_at, scale, evidence, radius, p, at, cov, near, skin, form):
    """Each hand where most of the particles that see it are; all of them where none does. See `Belief`.

    `skin_at` is the share of skin in a hand at each pixel, `radius` that of a hand in pixels.
    """
    share = np.empty(len(w))
    for hand in range(2):
        p[hand] = total = 0.0
        for n in range(len(w)):
            p[hand] += w[n] * seen[n, hand]
        for n in range(len(w)):
            share[n] = w[n] if p[hand] <= 1e-6 else w[n] * seen[n, hand]
            total += share[n]
        mx = my = 0.0
        for k in range(6):  # mean shift, from the mean
            sx = sy = s = 0.0
            best = 0
            for n in range(len(w)):
                one, px, py = share[n] / total, x[n, hand, 0], x[n, hand, 1]
                if share[n] > share[best]:
                    best = n
                if k and one > 0.0:
                    one *= math.exp(-2.0 * ((px - mx) ** 2 + (py - my) ** 2))
                sx, sy, s = sx + one * px, sy + one * py, s + one
            if s < 1e-9:
                mx, my = x[best, hand, 0], x[best, hand, 1]
            else:
                mx, my = sx / s, sy / s
        xx = xy = yy = s = 0.0
        for n in range(len(w)):
            dx, dy = x[n, hand, 0] - mx, x[n, hand, 1] - my
            if dx * dx + dy * dy < 0.25:
                one = share[n] / total
                xx, xy, yy, s = xx + one * dx * dx, xy + one * dx * dy, yy + one * dy * dy, s + one
        at[hand, 0], at[hand, 1], near[hand] = mx, my, s if p[hand] > 1e-6 else 0.0
        s, skin[hand] = max(s, 1e-9), min(max(_at(skin_at, mx * scale, my * scale), 0.0), 1.0)
        cov[hand, 0, 0], cov[hand, 0, 1], cov[hand, 1, 0], cov[hand, 1, 1] = xx / s, xy / s, xy / s, yy / s
        across, down, _ = _spread(evidence, mx * scale, my * scale, 1.5 * radius, math.inf)
        form[hand, 0] = min(max(4 * math.sqrt(across), radius), 3 * radius) if across >= 0.0 else 2 * radius
        form[hand, 1] = min(max(4 * math.sqrt(down), radius), 3 * radius) if down >= 0.0 else 2 * radius
        across, down, both = _spread(evidence, mx * scale, my * scale, math.ceil(2 * radius), WINDOW * radius)
        form[hand, 2] = 2 * both / (across + down) if across + down > 0.0 else 0.0


@exact("f4:3 f4:3 f4:1 f8 f8:2 f8 f4:2 f4:2 f4:1")
def learn_head(seen, head, weights, limit, hands, radius, change, new, apart):
    """Learn how a head looks, `head` (h, w, 3), from how it is `seen`, less where a hand is before it.

    In `change` (h, w) is by how much each pixel differs from the likest one beside it, smoothed by `weights`, and in
    `new` p that a hand does that, 1/2 at a change of `limit`. Returns how many pixels are not within `radius` of
    `hands` (n, 2); their change is in `apart`.
    """
    (height, width, _), reach, count = seen.shape, len(weights) // 2, 0
    row = np.empty(width + 2 * reach, np.float32)
    for y in range(height):
        for x in range(width):
            least = np.float32(math.inf)
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    most = np.float32(0.0)
                    for c in range(3):
                        most = max(most, abs(seen[y, x, c] - head[j, i, c]))
                    least = min(least, most)
            row[reach + x] = least
        for k in range(reach):
            row[reach - 1 - k], row[reach + width + k] = row[reach + 1 + k], row[reach + width - 2 - k]
        for x in range(width):
            new[y, x] = np.float32(0.0)
        for k in range(len(weights)):
            for x in range(width):
                new[y, x] += weights[k] * row[x + k]
    for y in range(height):
        for x in range(width):
            change[y, x] = np.float32(0.0)
        for k in range(-reach, reach + 1):
            j = min(abs(y + k), 2 * (height - 1) - abs(y + k))  # beyond a border, as in a mirror
            for x in range(width):
                change[y, x] += weights[k + reach] * new[j, x]
    for y in range(height):
        for x in range(width):
            p = 1.0 / (1.0 + math.exp(min(max((limit - change[y, x]) / CHANGED_WIDTH, -30.0), 30.0)))
            new[y, x], free = p, True
            for k in range(len(hands)):
                free &= (x - hands[k, 0]) ** 2 + (y - hands[k, 1]) ** 2 > radius**2
            if free:
                apart[count] = change[y, x]
                count += 1
            rate = HELD + (LEARNS - HELD) * (1.0 - p) if free else HELD
            for c in range(3):
                head[y, x, c] += rate * (seen[y, x, c] - head[y, x, c])
    return count
