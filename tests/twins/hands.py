"""Slow, plain twins of trackers/hands/hand_kernels.py: all particles at once, from the formulas of `target.py`."""

import math

import cv2
import numpy as np

from facetrack_cli.trackers.hands import hand_kernels as of

ALONG = np.array([0.2, 0.35, 0.5, 0.65, 0.8])
AROUND = np.array([[math.cos(turn), math.sin(turn)] for turn in np.arange(6) * math.pi / 6])
TINY = 1e-12


def at(values, places):
    """The values at places (..., 2) in pixels; -9 beyond the border."""
    height, width = values.shape
    column, row = np.rint(places[..., 0]).astype(np.int64), np.rint(places[..., 1]).astype(np.int64)
    out = (column < -1) | (column > width) | (row < -1) | (row > height)
    return np.where(out, -9.0, values[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(float))


def joined(evidence, a, b, scale):
    line = scale * (a[:, None] + ALONG[:, None] * (b - a)[:, None])
    return np.clip((np.maximum(at(evidence, line), 0.0).min(axis=1) - 0.2) / 0.4, 0, 1)


def arm(evidence, a, b, scale, size, nearest=of.ARM[0]):
    apart = np.hypot(*(a - b).T) / size
    within = np.clip((apart - nearest) / of.ARM[1], 0, 1) * np.clip((of.ARM[2] - apart) / 0.5, 0, 1)
    return joined(evidence, a, b, scale) * within


def mixture(places, peaks, often, sigma):
    """(N,): the density of proposals about the peaks."""
    squared = np.sum((places[:, None] - peaks) ** 2, axis=2)
    return (np.exp(-0.5 * squared / sigma**2) @ often) / (2 * math.pi * sigma**2)


def transition(steps, shares, off):
    """(N,): the density of steps `off` (N, 2)."""
    var = np.square(steps)
    return np.exp(-0.5 * np.sum(off**2, axis=1)[:, None] / var) @ (shares / (2 * math.pi * var))


def drawn(often, luck):
    return np.minimum(np.cumsum(often).searchsorted(luck, side="right"), len(often) - 1)


def move(
    x, seen, parted, luck, noise, peaks, often, steps, shares, chances, strength, evidence, covered, face, size, scale
):
    """x, seen, parted and weight after a frame."""
    x, seen, weight, (appears, vanishes, proposed) = x.copy(), seen.copy(), np.zeros(len(x)), chances
    for hand in (0, 1):
        before, was, u, e = x[:, hand].copy(), seen[:, hand].copy(), luck[hand], noise[hand]
        now = np.where(was, u[0] >= vanishes, (u[0] < appears) & (len(peaks) > 0))
        ahead = before[:, :2] + before[:, 2:]
        to = ahead + np.array(steps)[drawn(shares, u[1])][:, None] * e
        if len(peaks):
            there = (peaks[drawn(often, u[2])] + of.SPREAD * e) / scale
            to = np.where((~was | (u[3] < proposed))[:, None], there, to)
            q, moved = mixture(to, peaks / scale, often, of.SPREAD / scale), transition(steps, shares, to - ahead)
            stays = np.log(moved + TINY) - np.log((1 - proposed) * moved + proposed * q + TINY)
            near = np.exp(-0.5 * np.sum((to - before[:, :2]) ** 2, axis=1)) / (2 * math.pi)
            near = (1 - of.ANYWHERE) * near + of.ANYWHERE / (math.pi * of.REACH[2] * of.REACH[3])
            comes = np.log(near) - np.log(q + TINY) - of.BEYOND * np.maximum(at(covered, to * scale), 0.0)
            weight += np.where(now, np.where(was, stays, comes), 0.0)
        weight -= np.where(now, strength * arm(evidence, before[:, :2], to, scale, size), 0.0)
        hidden = before[:, :2] + 0.5 * before[:, 2:] + 0.03 * (face + size * of.REST[hand] - before[:, :2])
        x[:, hand, :2] = np.where(now[:, None], to, hidden + 0.15 * e)
        speed = np.where(was[:, None], of.NEWS * (to - before[:, :2]) + (1 - of.NEWS) * before[:, 2:], 0.0)
        x[:, hand, 2:] = np.where(now[:, None], speed, 0.5 * before[:, 2:])
        seen[:, hand] = now
    parted = seen.all(axis=1) & (parted | (joined(evidence, x[:, 0, :2], x[:, 1, :2], scale) <= 0))
    return x, seen, parted, weight


def weigh(x, seen, parted, fit, share, evidence, face, size, scale, radius, strength, skin):
    """(N,): log p(y, x) of both hands, but for the motion."""
    both, each = seen.all(axis=1), at(fit, x[..., :2] * scale)

    def skin_at(off):
        """Of skin at places (N, 2, ..., 2) off from each hand, what is not the other hand's."""
        extra = tuple(range(2, off.ndim - 1))
        there, other = np.expand_dims(x[..., :2], extra) + off, np.expand_dims(x[:, ::-1, :2], extra)
        near = np.hypot(*np.moveaxis(there - other, -1, 0)) < 1.2 * radius * size
        hides = near & np.expand_dims(seen[:, ::-1], extra)
        return np.where(hides, 0.0, np.maximum(at(evidence, there * scale), 0.0))

    way = x[..., :2] - (face + size * of.SHOULDERS)
    way = way / np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-6)[..., None]
    beyond = skin_at((radius * size * np.array(of.BEYOND_HAND))[:, None] * way[..., None, :]).mean(axis=2)
    sides = skin_at((radius * size * np.stack([2 * AROUND, -2 * AROUND]))[None, None]).min(axis=2).max(axis=2)
    each = each - strength * (of.FAR_END * beyond + of.MIDDLE * sides)
    apart = np.hypot(*(x[:, 0, :2] - x[:, 1, :2]).T) / size
    shared = np.minimum(1.3 * np.maximum(1 - apart / (2 * radius), 0.0), 1.0)
    nearest = np.where(parted, of.ARM[0], -of.ARM[1])
    one, least = (
        arm(evidence, x[:, 0, :2], x[:, 1, :2], scale, size, nearest),
        at(share, x[..., :2] * scale).min(axis=1),
    )
    twice = shared * np.maximum(least - of.HIDES * skin, 0.0) + one * np.maximum(least, 0.0)
    return np.sum(np.where(seen, each, 0.0), axis=1) - np.where(both, strength * twice, 0.0)


def fit_skin(share, strength, skin, face, size, scale):
    row, column = np.indices(share.shape)
    x, y, a, b = of.REACH
    far = np.hypot(((column / scale - face[0]) / size - x) / a, ((row / scale - face[1]) / size - y) / b)
    return strength * (share - skin) + np.minimum(of.BEYOND * (of.WITHIN - far), 0.0)


def peaks(fit, least, most):
    """Places (P, 2) and heights (P,) of what no pixel within 2 exceeds, the highest first."""
    top = np.flatnonzero((fit >= cv2.dilate(fit, np.ones((5, 5)))) & (fit > least))
    best = top[np.argsort(-fit.ravel()[top], kind="stable")[:most]]
    return np.stack(np.divmod(best, fit.shape[1])[::-1], axis=1), fit.ravel()[best]


def gather(x, seen, w, share_at, scale, evidence, radius):
    """p (2,), at (2, 2), cov (2, 2, 2), near (2,), skin (2,), form (2, 3)."""
    found = []
    for hand in (0, 1):
        p, places = w @ seen[:, hand], x[:, hand, :2]
        share = w * seen[:, hand] if p > 1e-6 else w
        share = share / share.sum()
        middle = share @ places
        for _ in range(5):
            close = share * np.exp(-0.5 * np.sum((places - middle) ** 2, axis=1) / 0.25)
            middle = places[share.argmax()] if close.sum() < 1e-9 else close @ places / close.sum()
        off = places - middle
        there = share * (np.hypot(*off.T) < 0.5)
        cov = (off.T * there) @ off / max(there.sum(), 1e-9)
        skin = np.clip(at(share_at, middle * scale), 0, 1)
        form = spread(evidence, middle * scale, radius)
        found.append((p, middle, cov, there.sum() if p > 1e-6 else 0.0, skin, form))
    return tuple(map(np.array, zip(*found, strict=True)))


def spread(evidence, middle, radius):
    """Width, height and lean of the skin about a place in pixels."""
    row, column = np.indices(evidence.shape)
    near = [
        (abs(row - middle[1]) <= far + 0.5) & (abs(column - middle[0]) <= far + 0.5)
        for far in (1.5 * radius, math.ceil(2 * radius))
    ]
    window = np.exp(-0.5 * ((column - middle[0]) ** 2 + (row - middle[1]) ** 2) / (of.WINDOW * radius) ** 2)
    covs = []
    for weight in (evidence * near[0], evidence * near[1] * window):
        places = np.column_stack([column.ravel(), row.ravel()]).astype(float)
        covs.append(np.cov(places.T, aweights=weight.ravel(), ddof=0) if weight.sum() >= 1e-3 else None)
    sizes = [2 * radius] * 2 if covs[0] is None else np.clip(4 * np.sqrt(np.diag(covs[0])), radius, 3 * radius)
    return np.array([*sizes, 0.0 if covs[1] is None else 2 * covs[1][0, 1] / np.trace(covs[1])])


def learn_head(seen, head, limit, hands, radius):
    """The head that is learned, change, p of a hand, and the change where no hand is."""
    wide = np.pad(head, ((1, 1), (1, 1), (0, 0)), constant_values=np.inf)
    shifted = [wide[y : y + len(head), x : x + head.shape[1]] for y in range(3) for x in range(3)]
    change = cv2.GaussianBlur(np.min([np.abs(seen - one).max(axis=2) for one in shifted], axis=0), (0, 0), 1.0)
    new = 1 / (1 + np.exp((limit - change) / of.CHANGED_WIDTH))
    row, column = np.indices(change.shape)
    free = (
        np.hypot(column - hands[:, 0, None, None], row - hands[:, 1, None, None]).min(axis=0, initial=np.inf) > radius
    )
    rate = np.where(free, of.HELD + (of.LEARNS - of.HELD) * (1 - new), of.HELD)
    return head + rate[..., None] * (seen - head), change, new, change[free]


def same_light(first, now, thin):
    """By the median factor of each channel."""
    both = [image[::thin, ::thin].reshape(-1, 3) for image in (first, now)]
    usable = np.all([(image >= of.DARK) & (image <= of.BRIGHT) for image in both], axis=(0, 2))
    if usable.sum() < of.ENOUGH * len(usable):
        return True
    before, after = (image[usable] for image in both)
    factor = np.sort(after / before.astype(np.float32), axis=0)[len(before) // 2]
    return bool(np.all((factor > 1 - of.LEAST_GAIN) & (factor < 1 + of.LEAST_GAIN)))


def edges(before, after, slope):
    """The number of steep edges, and of those that have changed."""
    steep = slope > of.STEEP * slope.mean()
    return steep.sum(), (steep & (cv2.absdiff(before, after) > np.rint(of.STEADY * slope))).sum()
