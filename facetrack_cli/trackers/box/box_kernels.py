# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Cells of gradients, the linear algebra of a correlation filter over them, and densities of particles.

Densities are those of a marginal particle filter, over all particles of the frame before (Klaas et al. 2005).
"""

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact, fast

Array: TypeAlias = NDArray[np.float64]
Single: TypeAlias = NDArray[np.float32]
CHANNELS = 31  # 18 signed orientations, 9 unsigned ones, 4 of texture
_CLIP, _TEXTURE, _FLAT = np.float32(0.2), np.float32(0.2357), np.float32(1e-4)
_WAYS: Single = np.array([[math.cos(k * math.pi / 9), math.sin(k * math.pi / 9)] for k in range(9)], np.float32)
_ZERO, _HALF, _ONE, _UNIT = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(1 / 255)


def gradients(grey: Single, cell: int, out: Single) -> None:
    """Histograms of oriented gradients (Felzenszwalb et al. 2010, section 6.1) of grey (H, W) float32, 0..1.

    A cell has `cell` x `cell` pixels, and H and W are multiples of it; `out` (31, H / cell, W / cell) float32.
    """
    _gradients(grey, cell, *_room(grey.shape[0], grey.shape[1], cell), out)


def _room(height: int, width: int, cell: int) -> tuple[Single, Single, Single, NDArray[np.int32]]:
    """What `_gradients` works in: bins, their energy, and what it knows of a row of pixels."""
    rows, columns = height // cell + 2, width // cell + 2
    bins, energy = np.empty((rows, columns, 18), np.float32), np.empty((rows, columns), np.float32)
    return bins, energy, np.empty((3, width), np.float32), np.empty(width, np.int32)


@exact
def _gradients(grey, cell, bins, energy, row_of, which, out):
    height, width = grey.shape
    rows, columns = height // cell, width // cell
    bins[:] = _ZERO
    energy[:] = _ZERO
    inverse = np.float32(1.0 / cell)
    dx, dy, most = row_of[0], row_of[1], row_of[2]
    for y in range(height):
        row, above, below = grey[y], grey[max(y - 1, 0)], grey[min(y + 1, height - 1)]
        for x in range(1, width - 1):
            dx[x] = row[x + 1] - row[x - 1]
        dx[0], dx[width - 1] = row[1] - row[0], row[width - 1] - row[width - 2]
        for x in range(width):
            dy[x] = below[x] - above[x]
            most[x] = _ZERO
            which[x] = 0
        for k in range(9):  # a loop over pixels inside vectorises
            u, v = _WAYS[k, 0], _WAYS[k, 1]
            for x in range(width):
                along = u * dx[x] + v * dy[x]
                if abs(along) > most[x]:
                    most[x] = abs(along)
                    which[x] = k if along > 0 else k + 9
        at = (np.float32(y) + _HALF) * inverse + _HALF
        i = int(at)
        fy = at - np.float32(i)
        for x in range(width):
            size = np.sqrt(dx[x] * dx[x] + dy[x] * dy[x])
            at = (np.float32(x) + _HALF) * inverse + _HALF
            j, k = int(at), which[x]
            fx = at - np.float32(j)
            lower = fy * size
            upper = size - lower
            bins[i, j, k] += (_ONE - fx) * upper
            bins[i, j + 1, k] += fx * upper
            bins[i + 1, j, k] += (_ONE - fx) * lower
            bins[i + 1, j + 1, k] += fx * lower
    for i in range(rows + 2):
        for j in range(columns + 2):
            for k in range(9):
                both = bins[i, j, k] + bins[i, j, k + 9]
                energy[i, j] += both * both
    for i in range(rows):
        for j in range(columns):
            _normalise(bins[i + 1, j + 1], energy[i : i + 3, j : j + 3], out[:, i, j])


@exact
def _normalise(bins, energy, out):
    """The channels `out` (31,) of one cell from its `bins` (18,), and the `energy` (3, 3) of it and its neighbours."""
    a = _ONE / np.sqrt(energy[0, 0] + energy[1, 0] + energy[0, 1] + energy[1, 1] + _FLAT)
    b = _ONE / np.sqrt(energy[0, 1] + energy[1, 1] + energy[0, 2] + energy[1, 2] + _FLAT)
    c = _ONE / np.sqrt(energy[1, 0] + energy[2, 0] + energy[1, 1] + energy[2, 1] + _FLAT)
    d = _ONE / np.sqrt(energy[1, 1] + energy[2, 1] + energy[1, 2] + energy[2, 2] + _FLAT)
    ta, tb, tc, td = _ZERO, _ZERO, _ZERO, _ZERO
    for k in range(18):
        pa, pb, pc, pd = (
            min(bins[k] * a, _CLIP),
            min(bins[k] * b, _CLIP),
            min(bins[k] * c, _CLIP),
            min(bins[k] * d, _CLIP),
        )
        out[k] = _HALF * (pa + pb + pc + pd)
        ta, tb, tc, td = ta + pa, tb + pb, tc + pc, td + pd
    for k in range(9):
        both = bins[k] + bins[k + 9]
        out[18 + k] = _HALF * (
            min(both * a, _CLIP) + min(both * b, _CLIP) + min(both * c, _CLIP) + min(both * d, _CLIP)
        )
    out[27], out[28], out[29], out[30] = _TEXTURE * ta, _TEXTURE * tb, _TEXTURE * tc, _TEXTURE * td


def gradients_of_scales(image: NDArray[np.uint8], x: float, y: float, sides: Any, cell: int, out: Single) -> None:
    """The gradients of S windows around (x, y) of grey `image` (H, W) uint8, `sides` (S, 2) pixels wide and high.

    `out` (S, 31, h, w) float32, h x w cells each; windows are read bilinearly, beyond the image its nearest pixel.
    """
    height, width = out.shape[2] * cell, out.shape[3] * cell
    window, part = np.empty((height, width), np.float32), np.empty(width, np.float32)
    columns = np.empty((2, width), np.int64)
    _of_scales(image, x, y, sides, cell, window, columns, part, *_room(height, width, cell), out)


@exact
def _of_scales(image, x, y, sides, cell, window, columns, part, bins, energy, row_of, which, out):
    (height, width), left, right = window.shape, columns[0], columns[1]
    last_row, last_column = image.shape[0] - 1, image.shape[1] - 1
    for s in range(len(sides)):
        across, down = sides[s, 0] / width, sides[s, 1] / height
        for j in range(width):
            u = min(max(x + (j - 0.5 * (width - 1)) * across, 0.0), 1.0 * last_column)
            left[j] = int(u)
            right[j] = min(left[j] + 1, last_column)
            part[j] = u - left[j]
        for i in range(height):
            v = min(max(y + (i - 0.5 * (height - 1)) * down, 0.0), 1.0 * last_row)
            above = int(v)
            upper, lower, row = image[above], image[min(above + 1, last_row)], window[i]
            fy = np.float32(v - above)
            for j in range(width):
                a, b, fx = left[j], right[j], part[j]
                first = np.float32(upper[a]) + fx * (np.float32(upper[b]) - np.float32(upper[a]))
                second = np.float32(lower[a]) + fx * (np.float32(lower[b]) - np.float32(lower[a]))
                row[j] = (first + fy * (second - first)) * _UNIT
        _gradients(window, cell, bins, energy, row_of, which, out[s])


@fast
def project(components, features, window, out):
    """out (C, M): `components` (C, L) times `features` (L, M), and times the `window` (M,)."""
    for c in range(len(out)):
        row = out[c]
        row[:] = _ZERO
        for k in range(len(features)):
            weight, feature = components[c, k], features[k]
            for m in range(len(row)):
                row[m] += weight * feature[m]
        for m in range(len(row)):
            row[m] *= window[m]


@fast
def remember(memory, x, rate):
    """`memory` (P, 2, F), Hermitian matrices (C, C) of F frequencies, moved by `rate` towards x x^H of x (2, C, F).

    P = C (C + 1) / 2 are the entries on and above the diagonal, by rows; real parts before imaginary ones.
    """
    keep, p = _ONE - rate, 0
    for i in range(x.shape[1]):
        ar, ai = x[0, i], x[1, i]
        for j in range(i, x.shape[1]):
            br, bi, real, imaginary = x[0, j], x[1, j], memory[p, 0], memory[p, 1]
            for f in range(len(ar)):
                real[f] = keep * real[f] + rate * (ar[f] * br[f] + ai[f] * bi[f])
                imaginary[f] = keep * imaginary[f] + rate * (ai[f] * br[f] - ar[f] * bi[f])
            p += 1


@fast
def multiply(memory, v, out):
    """`out` (2, C, F): the matrices of `memory` times v (2, C, F)."""
    out[:] = _ZERO
    p = 0
    for i in range(v.shape[1]):
        ir, ii, oir, oii = v[0, i], v[1, i], out[0, i], out[1, i]
        for j in range(i, v.shape[1]):
            real, imaginary, jr, ji = memory[p, 0], memory[p, 1], v[0, j], v[1, j]
            for f in range(len(ir)):
                oir[f] += real[f] * jr[f] - imaginary[f] * ji[f]
                oii[f] += real[f] * ji[f] + imaginary[f] * jr[f]
            if j > i:
                ojr, oji = out[0, j], out[1, j]
                for f in range(len(ir)):
                    ojr[f] += real[f] * ir[f] + imaginary[f] * ii[f]
                    oji[f] += real[f] * ii[f] - imaginary[f] * ir[f]
            p += 1


@fast
def respond(filters, x, out):
    """`out` (2, F): the sum over channels of conj(filters) x, both (2, C, F)."""
    out[:] = _ZERO
    real, imaginary = out[0], out[1]
    for c in range(x.shape[1]):
        fr, fi, xr, xi = filters[0, c], filters[1, c], x[0, c], x[1, c]
        for f in range(len(real)):
            real[f] += fr[f] * xr[f] + fi[f] * xi[f]
            imaginary[f] += fr[f] * xi[f] - fi[f] * xr[f]


def read_cubic(values: Single, x: Array, y: Array, out: Array) -> None:
    """`values` (H, W) at the places x (N,), y (N,) by Catmull and Rom's cubic; beyond the border as at it."""
    _read_cubic(values, x, y, *np.empty((2, 4)), out)


@exact
def _read_cubic(values, x, y, wx, wy, out):
    height, width = values.shape
    for n in range(len(x)):
        u, v = min(max(x[n], 0.0), width - 1.0), min(max(y[n], 0.0), height - 1.0)
        j, i = int(u), int(v)
        for w, t in ((wx, u - j), (wy, v - i)):
            w[0] = 0.5 * t * (t * (2.0 - t) - 1.0)
            w[1] = 0.5 * (t * t * (3.0 * t - 5.0) + 2.0)
            w[2] = 0.5 * t * (t * (4.0 - 3.0 * t) + 1.0)
            w[3] = 0.5 * t * t * (t - 1.0)
        total = 0.0
        for k in range(4):
            row = values[min(max(i + k - 1, 0), height - 1)]
            for m in range(4):
                total += wy[k] * wx[m] * row[min(max(j + m - 1, 0), width - 1)]
        out[n] = total


def arrive(
    z: Array, mean: Array, step: Array, scale: float, log_shown: Array, log_hidden: Array, u: Array,
    shown: Array, hidden: Array, which: Any,
) -> None:  # fmt: skip
    """log sum_m w_m p(z_n | m) of places and log scales z (N, 3), where the target is visible, and where it is hidden.

    A particle m of the last frame is expected at `mean` (M, 3), with standard deviations `step` (M, 2), visible and
    hidden, along x and y, and `scale` of the log scale; `log_shown`, `log_hidden` (M,) are the logarithms of its weight
    times the probability of either. Sums go to `shown`, `hidden` (N,). `which` (N,) is the m from which z_n came, or
    M + m where it was hidden, drawn by u (N,), uniform in 0..1.
    """
    logs, factor, parts = np.empty((3, 2, len(mean)))
    _arrive(z, mean, step, scale, log_shown, log_hidden, u, shown, hidden, which, logs, factor, parts.reshape(-1))


@exact
def _arrive(z, mean, step, scale, log_shown, log_hidden, u, shown, hidden, which, logs, factor, parts):
    many = len(mean)
    for m in range(many):
        for k in range(2):
            factor[k, m] = -0.5 / step[m, k] ** 2
            logs[k, m] = -2.0 * math.log(step[m, k]) - math.log(scale) - 1.5 * math.log(2.0 * math.pi)
        logs[0, m] += log_shown[m]
        logs[1, m] += log_hidden[m]
    for n in range(len(z)):
        top = -math.inf
        for m in range(many):
            dx, dy, ds = z[n, 0] - mean[m, 0], z[n, 1] - mean[m, 1], (z[n, 2] - mean[m, 2]) / scale
            away = dx * dx + dy * dy
            for k in range(2):
                value = logs[k, m] + factor[k, m] * away - 0.5 * ds * ds
                parts[k * many + m] = value
                top = max(top, value)
        seen = unseen = 0.0
        for m in range(many):
            parts[m] = math.exp(parts[m] - top)
            seen += parts[m]
        for m in range(many, 2 * many):
            parts[m] = math.exp(parts[m] - top)
            unseen += parts[m]
        shown[n] = math.log(seen) + top if seen > 0.0 else -math.inf
        hidden[n] = math.log(unseen) + top if unseen > 0.0 else -math.inf
        left, chosen = u[n] * (seen + unseen), 2 * many - 1
        for i in range(2 * many):
            left -= parts[i]
            if left <= 0.0 and parts[i] > 0.0:
                chosen = i
                break
        which[n] = chosen
