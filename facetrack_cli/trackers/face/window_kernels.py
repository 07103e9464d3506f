# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Loops over windows of points: their correlation with templates.

Of K parts there are up to T templates in two channels, `windows` (K, T, 2, L). Each has unit norm and zero mean in both
channels: rows of the part's own sides, filled up with zeros to `stride` pixels. Beyond an image its outermost pixels
count.
"""

import numpy as np

from facetrack_cli.engine.kernels.compiled import fast, fast_part, part

_ZERO, _TINY = np.float32(0.0), np.float32(1e-6)


def stride(width: int) -> int:
    """The length of a row of `width` pixels: whole vectors."""
    return (width + 7) // 8 * 8


_stride = part(stride)


@fast("f4:3 f4:4 i8:1 i8:2 f8:2 f4:3")
def greatest(seen, windows, count, sides, corner, maps):
    """`maps` (K, S, S): the greatest correlation at the whole pixels from `corner` (K, 2) on.

    `seen` (2, H, W) are the channels of an image. Part k has `count[k]` templates of `sides[k]` = (w, h) pixels.
    """
    side, wide, high = maps.shape[1], 0, 0
    for k in range(len(sides)):  # np.max has its kernel import scipy.linalg, a tenth of a start
        wide, high = max(wide, sides[k, 0]), max(high, sides[k, 1])
    region = np.empty((2, side + high - 1, side + _stride(wide) - 1), np.float32)
    strip = np.empty((2, (side + high - 1) * _stride(wide)), np.float32)
    energy, sums = np.empty((side, side), np.float32), np.empty((2, region.shape[2]), np.float32)
    for k in range(len(windows)):
        w, h = sides[k, 0], sides[k, 1]
        row = _stride(w)
        _region(seen, int(corner[k, 0]) - w // 2, int(corner[k, 1]) - h // 2, side + h - 1, region)
        _energies(region, w, h, sums, energy)
        for j in range(side):
            # rows one after the other, so that a window is one piece
            for c in range(2):
                for y in range(side + h - 1):
                    for x in range(row):
                        strip[c, y * row + x] = region[c, y, j + x]
            for i in range(side):
                first, second = strip[0, i * row : (i + h) * row], strip[1, i * row : (i + h) * row]
                best = np.float32(-np.inf)
                for t in range(count[k]):
                    one, two, r = windows[k, t, 0], windows[k, t, 1], _ZERO
                    for x in range(h * row):
                        r += first[x] * one[x] + second[x] * two[x]
                    best = max(best, r)
                maps[k, i, j] = best / np.sqrt(energy[i, j] + _TINY)


@fast_part
def _region(seen, left, top, rows, region):
    """The pixels from (left, top) on, less their means: so float32 is enough for sums of squares."""
    height, width = seen.shape[1:]
    for c in range(2):
        mean = _ZERO
        for y in range(rows):
            source = seen[c, min(max(top + y, 0), height - 1)]
            for x in range(region.shape[2]):
                region[c, y, x] = source[min(max(left + x, 0), width - 1)]
                mean += region[c, y, x]
        mean /= np.float32(rows * region.shape[2])
        for y in range(rows):
            for x in range(region.shape[2]):
                region[c, y, x] -= mean


@fast_part
def _energies(region, w, h, sums, energy):
    """The sums of squares of windows about their means, both channels together."""
    side, share = len(energy), np.float32(1.0 / (w * h))
    energy[:] = _ZERO
    for c in range(2):
        sums[:] = _ZERO
        for y in range(h - 1):
            for x in range(region.shape[2]):
                sums[0, x] += region[c, y, x]
                sums[1, x] += region[c, y, x] ** 2
        for i in range(side):
            for x in range(region.shape[2]):
                sums[0, x] += region[c, i + h - 1, x]
                sums[1, x] += region[c, i + h - 1, x] ** 2
            one, two = _ZERO, _ZERO
            for x in range(w - 1):
                one += sums[0, x]
                two += sums[1, x]
            for j in range(side):
                one += sums[0, j + w - 1]
                two += sums[1, j + w - 1]
                energy[i, j] += max(two - one * one * share, _ZERO)
                one -= sums[0, j]
                two -= sums[1, j]
            for x in range(region.shape[2]):
                sums[0, x] -= region[c, i, x]
                sums[1, x] -= region[c, i, x] ** 2


@fast("f4:3 f4:4 i8:1 i8:2 f8:3 f4:3 f8:3")
def matched(seen, windows, count, sides, at, found, like):
    """The windows at places `at` (M, K, 2), read bilinearly: `like` (M, K, T), their correlation with each template.

    `found` (K, 2, L) are those of the last places, of unit norm. Of templates that a part lacks nothing is said.
    """
    height, width = seen.shape[1:]
    for m in range(len(at)):
        for k in range(len(windows)):
            w, h = sides[k, 0], sides[k, 1]
            row = _stride(w)
            left, top = at[m, k, 0] - (w - 1) / 2, at[m, k, 1] - (h - 1) / 2
            x0, y0 = int(np.floor(left)), int(np.floor(top))
            fx, fy = np.float32(left - x0), np.float32(top - y0)
            squares = _ZERO
            for c in range(2):
                total, window = _ZERO, found[k, c]
                for y in range(h):
                    upper = seen[c, min(max(y0 + y, 0), height - 1)]
                    lower = seen[c, min(max(y0 + y + 1, 0), height - 1)]
                    for x in range(w):
                        a, b = min(max(x0 + x, 0), width - 1), min(max(x0 + x + 1, 0), width - 1)
                        above, below = upper[a] + fx * (upper[b] - upper[a]), lower[a] + fx * (lower[b] - lower[a])
                        value = above + fy * (below - above)
                        window[y * row + x] = value
                        total += value
                total /= np.float32(w * h)
                for y in range(h):
                    for x in range(y * row, y * row + w):
                        window[x] -= total
                        squares += window[x] ** 2
            share = np.float32(1.0) / np.sqrt(squares + _TINY)
            for x in range(h * row):
                found[k, 0, x] *= share
                found[k, 1, x] *= share
            for t in range(count[k]):
                one, two, r = windows[k, t, 0], windows[k, t, 1], _ZERO
                for x in range(h * row):
                    r += found[k, 0, x] * one[x] + found[k, 1, x] * two[x]
                like[m, k, t] = r
