# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Cells of gradients, the linear algebra of a correlation filter over them, and densities of particles.

Densities are those of a marginal particle filter, over all particles of the frame before (Klaas et al. 2005).
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact, fast

COLOURS = 1 << 15  # of 5 bits a channel
CHANNELS = 31  # 18 signed orientations, 9 unsigned ones, 4 of texture
_CLIP, _TEXTURE, _FLAT = np.float32(0.2), np.float32(0.2357), np.float32(1e-4)
_10, _30, _50, _70 = (np.float32(math.tan(math.radians(angle))) for angle in (10, 30, 50, 70))
_ZERO, _HALF, _ONE, _UNIT = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(1 / 255)
_LEVELS, _RATIOS = np.arange(256) / 255, np.arange(3072, dtype=np.float32) * np.float32(1 / 2040)
_LINEAR = np.rint(2040 * np.where(_LEVELS <= 0.04045, _LEVELS / 12.92, ((_LEVELS + 0.055) / 1.055) ** 2.4)).astype(int)
_ROOTS = np.rint(32768 * np.where(_RATIOS < 216 / 24389, _RATIOS * 841 / 108 + 4 / 29, np.cbrt(_RATIOS))).astype(int)
_CHROMA = np.float32(60.0)  # levels of a and b that count as much as the whole range of grey


@exact("f4:2 i8 f4:3")
def gradients(grey, cell, out):
    """Histograms of oriented gradients (Felzenszwalb et al. 2010, section 6.1) of grey (H, W) float32, 0..1.

    A cell has `cell` x `cell` pixels, and H and W are multiples of it; `out` (31, H / cell, W / cell) float32.
    """
    height, width = grey.shape
    rows, columns = height // cell, width // cell
    bins, votes = np.zeros((rows + 2, 19, columns + 2), np.float32), np.empty((22, columns + 2), np.float32)
    inverse, (which, cell_of) = np.float32(1.0 / cell), np.empty((2, width), np.int32)
    dx, size, part = np.empty((3, width), np.float32)
    for x in range(width):
        at = (np.float32(x) + _HALF) * inverse + _HALF
        cell_of[x] = int(at)
        part[x] = at - np.float32(int(at))
    # loops over a row inside vectorise
    for y in range(height):
        row, above, below = grey[y], grey[max(y - 1, 0)], grey[min(y + 1, height - 1)]
        for x in range(1, width - 1):
            dx[x] = row[x + 1] - row[x - 1]
        dx[0], dx[width - 1] = row[1] - row[0], row[width - 1] - row[width - 2]
        for x in range(width):
            across, down = dx[x], below[x] - above[x]
            size[x] = np.sqrt(across * across + down * down)
            u, v = abs(across), abs(down)
            steep = np.int32(v > _10 * u) + np.int32(v > _30 * u) + np.int32(v > _50 * u) + np.int32(v > _70 * u)
            left = np.int32(across * down < _ZERO)
            back = np.int32((down < _ZERO) | ((down == _ZERO) & (across < _ZERO)))
            way = steep + left * (9 - 2 * steep) + 9 * back
            which[x] = way - 18 * np.int32(way == 18)
        votes[:18] = _ZERO
        for x in range(width):
            j, k = cell_of[x], which[x]
            right = part[x] * size[x]
            votes[k, j] += size[x] - right
            votes[k, j + 1] += right
        at = (np.float32(y) + _HALF) * inverse + _HALF
        i = int(at)
        fy = at - np.float32(i)
        for k in range(18):
            vote, upper, lower = votes[k], bins[i, k], bins[i + 1, k]
            for j in range(columns + 2):
                low = fy * vote[j]
                upper[j] += vote[j] - low
                lower[j] += low
    for i in range(rows + 2):
        energy = bins[i, 18]
        for k in range(9):
            one, other = bins[i, k], bins[i, k + 9]
            for j in range(columns + 2):
                both = one[j] + other[j]
                energy[j] += both * both
    for i in range(rows):
        _normalise(bins, i, votes[18:], out)


@exact
def _normalise(bins, i, norms, out):
    """The channels `out` (31, H, W) of row i of cells from the `bins` (H + 2, 19, W + 2): 18 directions, the energy."""
    above, here, below, columns = bins[i, 18], bins[i + 1, 18], bins[i + 2, 18], out.shape[2]
    a, b, c, d = norms[0], norms[1], norms[2], norms[3]
    for j in range(columns):
        left, middle, right = here[j], here[j + 1], here[j + 2]
        a[j] = _ONE / np.sqrt(above[j] + left + above[j + 1] + middle + _FLAT)
        b[j] = _ONE / np.sqrt(above[j + 1] + middle + above[j + 2] + right + _FLAT)
        c[j] = _ONE / np.sqrt(left + below[j] + middle + below[j + 1] + _FLAT)
        d[j] = _ONE / np.sqrt(middle + below[j + 1] + right + below[j + 2] + _FLAT)
    ta, tb, tc, td = out[27, i], out[28, i], out[29, i], out[30, i]
    out[27:, i] = _ZERO
    for k in range(18):
        one, to = bins[i + 1, k], out[k, i]
        for j in range(columns):
            value = one[j + 1]
            pa, pb = min(value * a[j], _CLIP), min(value * b[j], _CLIP)
            pc, pd = min(value * c[j], _CLIP), min(value * d[j], _CLIP)
            to[j] = _HALF * (pa + pb + pc + pd)
            ta[j] += _TEXTURE * pa
            tb[j] += _TEXTURE * pb
            tc[j] += _TEXTURE * pc
            td[j] += _TEXTURE * pd
    for k in range(9):
        one, other, to = bins[i + 1, k], bins[i + 1, k + 9], out[18 + k, i]
        for j in range(columns):
            value = one[j + 1] + other[j + 1]
            pa, pb = min(value * a[j], _CLIP), min(value * b[j], _CLIP)
            pc, pd = min(value * c[j], _CLIP), min(value * d[j], _CLIP)
            to[j] = _HALF * (pa + pb + pc + pd)


@exact("u1:3 f4:3")
def chroma(image, out):
    """a and b of CIELAB, `out` (2, H, W), of an `image` (H, W, 3) in sRGB, to the levels of `cv2.COLOR_BGR2LAB`.

    OpenCV makes tables for all its conversions before the first one, which takes as long as ten frames.
    """
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            b, g, r = _LINEAR[image[y, x, 0]], _LINEAR[image[y, x, 1]], _LINEAR[image[y, x, 2]]
            fx = _ROOTS[(1777 * r + 1541 * g + 778 * b + 2048) >> 12]
            fy = _ROOTS[(871 * r + 2929 * g + 296 * b + 2048) >> 12]
            fz = _ROOTS[(73 * r + 448 * g + 3575 * b + 2048) >> 12]
            out[0, y, x] = np.float32((500 * (fx - fy) + 16384) >> 15) / _CHROMA
            out[1, y, x] = np.float32((200 * (fy - fz) + 16384) >> 15) / _CHROMA


@exact("u1:3 f4:1 f4:1 i8:1 f4:1")
def colours(image, target, around, bins, p):
    """Of the pixels of `image` (H, W, 3), by rows, which of `COLOURS` each has, and p that it is the target's.

    p is that of histograms of the target and of its surroundings; of a colour that neither has it is a half.
    """
    n = 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            k = (image[y, x, 0] >> 3) << 10 | (image[y, x, 1] >> 3) << 5 | image[y, x, 2] >> 3
            both = target[k] + around[k]
            bins[n], p[n] = k, target[k] / max(both, np.float32(1e-12)) if both > _ZERO else _HALF
            n += 1


@exact("u1:2 f8 f8 f8:2 i8 f4:4")
def gradients_of_scales(image, x, y, sides, cell, out):
    """The gradients of S windows around (x, y) of grey `image` (H, W) uint8, `sides` (S, 2) pixels wide and high.

    `out` (S, 31, h, w) float32, h x w cells each; windows are read bilinearly, beyond the image its nearest pixel.
    """
    height, width = out.shape[2] * cell, out.shape[3] * cell
    window, part = np.empty((height, width), np.float32), np.empty(width, np.float32)
    left, right = np.empty((2, width), np.int64)
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
        gradients(window, cell, out[s])


@fast("f4:2 f4:2 f4:1 f4:2")
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


@fast("f4:3 f4:3 f4")
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


@fast("f4:3 f4:3 f4:3")
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


@fast("f4:3 f4:3 f4:2")
def respond(filters, x, out):
    """`out` (2, F): the sum over channels of conj(filters) x, both (2, C, F)."""
    out[:] = _ZERO
    real, imaginary = out[0], out[1]
    for c in range(x.shape[1]):
        fr, fi, xr, xi = filters[0, c], filters[1, c], x[0, c], x[1, c]
        for f in range(len(real)):
            real[f] += fr[f] * xr[f] + fi[f] * xi[f]
            imaginary[f] += fr[f] * xi[f] - fi[f] * xr[f]


@exact("f4:2 f8:1 f8:1 f8:1")
def read_cubic(values, x, y, out):
    """`values` (H, W) at the places x (N,), y (N,) by Catmull and Rom's cubic; beyond the border as at it."""
    wx, wy = np.empty((2, 4))
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


@exact("f8:2 f8:2 f8:2 f8 f8:1 f8:1 f8:1 f8:1 f8:1 i8:1")
def arrive(z, mean, step, scale, log_shown, log_hidden, u, shown, hidden, which):
    """log sum_m w_m p(z_n | m) of places and log scales z (N, 3), where the target is visible, and where it is hidden.

    A particle m of the last frame is expected at `mean` (M, 3), with standard deviations `step` (M, 2), visible and
    hidden, along x and y, and `scale` of the log scale; `log_shown`, `log_hidden` (M,) are the logarithms of its weight
    times the probability of either. Sums go to `shown`, `hidden` (N,). `which` (N,) is the m from which z_n came, or
    M + m where it was hidden, drawn by u (N,), uniform in 0..1.
    """
    many = len(mean)
    (logs, factor), parts = np.empty((2, 2, many)), np.empty(2 * many)
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
