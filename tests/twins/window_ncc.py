"""A slow, plain twin of the correlation of trackers/face/window_ncc.py. Imports nothing of ours."""

import math

import numpy as np


def channels(image, x, y, w, h):
    """(h, w, 2): log grey and redness of a window around a whole pixel of an image (H, W, 3); beyond, the border's."""
    height, width = image.shape[:2]
    found = np.empty((h, w, 2))
    for i in range(h):
        for j in range(w):
            row, column = y + i - h // 2, x + j - w // 2
            b, g, r = (float(v) for v in image[min(max(row, 0), height - 1), min(max(column, 0), width - 1)])
            found[i, j] = (math.log(0.114 * b + 0.587 * g + 0.299 * r + 16), 2 * math.log((r + 8) / (g + 8)))
    return found


def correlation(first, second):
    """The zero-mean normalised cross-correlation of two windows (h, w, 2), both channels together."""
    a, b = (one - one.mean(axis=(0, 1)) for one in (first, second))
    return float((a * b).sum() / math.sqrt((a * a).sum() * (b * b).sum()))


def greatest(image, templates, x, y):
    """The greatest correlation of the window around a whole pixel with one of the templates."""
    h, w = templates[0].shape[:2]
    seen = channels(image, x, y, w, h)
    return max(correlation(seen, one) for one in templates)


def between(image, templates, x, y):
    """The same at any place: bilinear between whole pixels."""
    x0, y0 = math.floor(x), math.floor(y)
    u, v = x - x0, y - y0
    return sum(
        weight * greatest(image, templates, column, row)
        for column, row, weight in (
            (x0, y0, (1 - u) * (1 - v)),
            (x0 + 1, y0, u * (1 - v)),
            (x0, y0 + 1, (1 - u) * v),
            (x0 + 1, y0 + 1, u * v),
        )
    )


def learned(like, number, age, beside, odds, at, x, w, good, visible, usual, used, r, sure):
    """What one part learns in a frame: (g, v, usual, used, whether it gives a template, whether young ones go).

    `like` (T,) is its correlation with templates, r that of maps; particles x (N, 2) have weights w (N,).
    """
    old = [like[t] for t in range(number) if age[t] >= 3]
    q = (good - max(old, default=-math.inf)) / max(good - beside, 0.05)
    said = min(max(odds, -4), 4)
    evidence = min(max((0.45 - q) / 0.1, -1), 6) + said
    ahead = 0.99 * visible + 0.1 * (1 - visible)
    v = ahead / (ahead + (1 - ahead) * math.exp(-evidence))
    usual = usual + v / 50 * (said - usual)
    spread = math.sqrt(max((w * (x[:, i] - at[i]) ** 2).sum() for i in range(2)))
    clear = v > 0.5 and spread < sure and odds >= usual - 2
    best = int(np.argmax(like[:number]))
    new = clear and like[best] < 0.7 and len(used) > 1
    if clear and not new:
        used = 0.98 * used + 0.02 * (np.arange(len(used)) == best)
    return good + v / 50 * (r - good), v, usual, used, new, v < 0.5 and len(old) < number
