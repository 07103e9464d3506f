# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""The loops of the adaptive tracker (Zhou, Chellappa & Moghaddam 2003).

First patches of affine parallelograms, read bilinearly and normalised (eq. 3). Then densities of patches under a
mixture for each pixel, and how it learns (eq. 6-11). A pixel has three components, in the order w, s, f: weights m,
centres mu, standard deviations sigma, all (3, d).

Last B of eq. 12, least squares by the largest singular values. Not by LAPACK: on busy cores its threads take a hundred
times as long for matrices as small as these, and the last digits depend on how many there are.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import between, fast, fast_part, inline, join, look_up

Array: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = NDArray[np.float32]
# pixels whose sums are multiplied before one logarithm: 32 lanes in float64, of 15 factors up to 4 each
_LANES, _TOGETHER = 32, 15 * 32
_MIN_EXPONENT = np.float32(-126.0)
_ONE, _ZERO, _NEVER = np.float32(1.0), np.float32(0.0), np.float32(-1e30)
MIN_VARIANCE = 0.25  # of grey levels squared; below it a patch is flat
_PIXEL_BITS, _PIXEL_MASK = np.uint32(8), np.uint32(0xFF)
_MIN_WEIGHT = 1e-30  # below it a weight counts as 0
_HALF, _BIAS, _BITS = np.float32(0.5), np.int32(127), np.int32(23)
# of 2^f on [-0.5, 0.5], by least relative error: 1e-7
_C1, _C2, _C3 = np.float32(0.693147004), np.float32(0.240222424), np.float32(0.0555073395)
_C4, _C5 = np.float32(0.00967151392), np.float32(0.00132647157)


@inline
def _read_inside(joined, width, place, grid, at, part, four, row):
    """Grey levels of all points into `row`; `place` (u, v, b1, b2, b3, b4) in pixels of `joined`, all within."""
    gx, gy, fx, fy = grid[0], grid[1], part[0], part[1]
    u0, v0 = np.float32(place[0]), np.float32(place[1])
    b1, b2, b3, b4 = np.float32(place[2]), np.float32(place[3]), np.float32(place[4]), np.float32(place[5])
    stride = np.int32(width)
    for k in range(len(at)):
        u, v = u0 + b1 * gx[k] + b2 * gy[k], v0 + b3 * gx[k] + b4 * gy[k]
        i, j = np.int32(v), np.int32(u)
        fx[k], fy[k] = u - np.float32(j), v - np.float32(i)
        at[k] = i * stride + j
    look_up(joined, _PIXEL_BITS, _PIXEL_MASK, at, part, four, row)


@inline
def _read_anywhere(joined, width, height, place, whole, grid, seen, row):
    """As `_read_inside`, of points anywhere; how many of them are `seen`: those within `whole` (u, v from, u, v to)."""
    count = 0
    for k in range(len(row)):
        x, y = float(grid[0, k]), float(grid[1, k])
        u, v = place[0] + place[2] * x + place[3] * y, place[1] + place[4] * x + place[5] * y
        row[k], seen[k] = _ZERO, _ZERO
        # not a number fails this too
        if u >= whole[0] and v >= whole[1] and u <= whole[2] and v <= whole[3]:
            u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
            j, i = int(u), int(v)
            row[k] = between(joined[i * width + j], _PIXEL_BITS, _PIXEL_MASK, np.float32(u - j), np.float32(v - i))
            seen[k] = _ONE
            count += 1
    return count


@inline
def _normalise(row, seen, count, out):
    """`row` with mean 0 and variance 1 over the points `seen` into `out`; all 0 if they are too few or it is flat."""
    total, squares = _ZERO, _ZERO
    for k in range(len(row)):
        total += row[k]
    mean = total / np.float32(max(count, 1))
    for k in range(len(row)):
        row[k] = (row[k] - mean) * seen[k]
        squares += row[k] * row[k]
    variance = squares / np.float32(max(count, 1))
    shown = 2 * count >= len(row) and variance >= MIN_VARIANCE
    scale = _ONE / np.float32(math.sqrt(variance))
    for k in range(len(out)):
        out[k] = row[k] * scale if shown else _ZERO


@fast("u1:2 i8 i8 i8 i8 i8 f8x4 f8:2 f8 f8 i8 i8")
def read_patches(grey, left, top, factor, width, height, extent, x, w, h, rows, cols):
    """Patches (N, rows * cols) float32 at x (N, 6) = (cx, cy, a1, a2, a3, a4), pixels of the whole image.

    Point (i, j) is read at (cx, cy) + [[a1, a2], [a3, a4]] (w ((j + .5) / cols - .5), h ((i + .5) / rows - .5)).
    `grey` (H, W) uint8 shows the whole image of width x height from (left, top) on, reduced by `factor`, at least
    within `extent`, where all the points within the image lie. Points beyond the whole image are 0 and count neither in
    mean nor in variance; a patch with more than half of them, or one that is flat, is 0 throughout.
    """
    d, shrink = rows * cols, 1.0 / factor
    # one block more on each side, between whose centre and the next the outermost points are read
    x0 = min(max(int((extent[0] - left) * shrink) - 1, 0), grey.shape[1] - 1)
    y0 = min(max(int((extent[1] - top) * shrink) - 1, 0), grey.shape[0] - 1)
    n_x = min(max(int((extent[2] - left) * shrink) + 2, x0 + 1), grey.shape[1]) - x0
    n_y = min(max(int((extent[3] - top) * shrink) + 2, y0 + 1), grey.shape[0]) - y0
    joined = join(grey[y0 : y0 + n_y, x0 : x0 + n_x], np.uint32, _PIXEL_BITS)
    # from the whole image's pixels to those of `joined`
    off_x, off_y = left + x0 * factor + 0.5 * (factor - 1), top + y0 * factor + 0.5 * (factor - 1)
    whole = ((-0.5 - off_x) * shrink, (-0.5 - off_y) * shrink,
             (width - 0.5 - off_x) * shrink, (height - 0.5 - off_y) * shrink)  # fmt: skip
    grid = np.empty((2, d), np.float32)
    for i in range(rows):
        for j in range(cols):
            grid[0, i * cols + j], grid[1, i * cols + j] = w * ((j + 0.5) / cols - 0.5), h * ((i + 0.5) / rows - 0.5)
    most_x, most_y = 0.5 * abs(w), 0.5 * abs(h)
    at, part, four = np.empty(d, np.int32), np.empty((2, d), np.float32), np.empty(d, np.uint32)
    row, some, every = np.empty(d, np.float32), np.empty(d, np.float32), np.ones(d, np.float32)
    out = np.empty((x.shape[0], d), np.float32)
    for n in range(x.shape[0]):
        u, v = (x[n, 0] - off_x) * shrink, (x[n, 1] - off_y) * shrink
        place = (u, v, x[n, 2] * shrink, x[n, 3] * shrink, x[n, 4] * shrink, x[n, 5] * shrink)
        half_u = abs(place[2]) * most_x + abs(place[3]) * most_y
        half_v = abs(place[4]) * most_x + abs(place[5]) * most_y
        if u - half_u >= 0.0 and v - half_v >= 0.0 and u + half_u <= n_x - 1.0 and v + half_v <= n_y - 1.0:
            _read_inside(joined, n_x, place, grid, at, part, four, row)
            seen, count = every, d
        else:
            seen, count = some, _read_anywhere(joined, n_x, n_y, place, whole, grid, some, row)
        _normalise(row, seen, count, out[n])
    return out


@inline
def _exp2(x):
    """2^x of x up to 0, float32, to a relative error of 4e-7; at least 2^-126."""
    x = x if x > _MIN_EXPONENT else _MIN_EXPONENT
    # towards 0 after half is taken off: the nearest whole number
    whole = np.int32(x - _HALF)
    f = x - np.float32(whole)
    power = np.float32(np.int32((whole + _BIAS) << _BITS).view(np.float32))
    return power * (_ONE + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * _C5)))))


@inline
def _components(mu, rate, log, start, end):
    """(mu, rate, log) of w, s and f for the pixels from `start` to `end`."""
    return (
        (mu[0, start:end], rate[0, start:end], log[0, start:end]),
        (mu[1, start:end], rate[1, start:end], log[1, start:end]),
        (mu[2, start:end], rate[2, start:end], log[2, start:end]),
    )


@inline
def _exponent(y, component, k, laplace):
    """log2 of a component's density of the value y in pixel k."""
    mu, rate, log = component
    off = y - mu[k]
    return log[k] - rate[k] * (abs(off) if laplace else off * off)


@inline
def _sum(a, b, c):
    """(top, share): 2^a + 2^b + 2^c is share 2^top, and top the largest of the three."""
    # `max` would check for nan, in twice the time
    high, low = a if a > b else b, b if a > b else a
    top, middle = high if high > c else c, c if high > c else high
    return top, _ONE + _exp2(middle - top) + _exp2(low - top)


@inline
def _sum_with(a, b, c, more):
    """As `_sum`, of four."""
    top, share = _sum(a, b, c)
    both = top if top > more else more
    return both, share * _exp2(top - both) + _exp2(more - both)


@inline
def _log2_product(values, lanes):
    """log2 of the product of `values`, float32 within 1..4, _TOGETHER of them at most."""
    lanes[:] = _ONE
    for start in range(0, len(values), _LANES):
        some = values[start : start + _LANES]
        for k in range(len(some)):
            lanes[k] *= some[k]
    product = 1.0
    for k in range(_LANES):
        product *= float(lanes[k])
    return math.log2(product)


@fast("f4:2r f4:2 f4:2 f4:2 f8 b1")
def log_densities(y, mu, rate, log, outlier, laplace):
    """log p (N,) of patches y (N, d): eq. 6, the sum over the pixels of the log of each one's mixture.

    A component's density is 2^(log - rate |y - mu|^2), with the first power if `laplace`; mu, rate, log are (3, d)
    float32. `outlier` is a density that is added in every pixel; 0 for none.
    """
    count, d = y.shape
    out = np.zeros(count)
    shares, lanes = np.empty(_TOGETHER, np.float32), np.empty(_LANES, np.float32)
    uniform = np.float32(math.log2(outlier)) if outlier > 0.0 else _ZERO
    for start in range(0, d, _TOGETHER):
        end = min(start + _TOGETHER, d)
        w, s, f = _components(mu, rate, log, start, end)
        for n in range(count):
            row, share, total = y[n, start:end], shares[: end - start], _ZERO
            for k in range(len(row)):
                a, b, c = (
                    _exponent(row[k], w, k, laplace), _exponent(row[k], s, k, laplace), _exponent(row[k], f, k, laplace)
                )  # fmt: skip
                top, share[k] = _sum_with(a, b, c, uniform) if outlier > 0.0 else _sum(a, b, c)
                total += top
            out[n] += (float(total) + _log2_product(share, lanes)) * math.log(2.0)
    return out


@fast("f4:2r f4:2 f4:2 f4:2")
def errors(y, m, mu, sigma):
    """phi (N,) of patches y (N, d): the mean over the pixels of sum_i m_i ((y - mu_i) / sigma_i)^2."""
    count, d = y.shape
    out, rate = np.empty(count), m / (sigma * sigma)
    for n in range(count):
        total = _ZERO
        for k in range(d):
            w, s, f = y[n, k] - mu[0, k], y[n, k] - mu[1, k], y[n, k] - mu[2, k]
            total += w * w * rate[0, k] + s * s * rate[1, k] + f * f * rate[2, k]
        out[n] = total / d
    return out


@fast("f4:1r f4:2 f4:2 f4:2 f8:2 f4:2 f4:2 f8 b1 f8 f8 f8")
def update(y, m, mu, sigma, moments, rate, log, outlier, laplace, alpha, least_sigma, least_mixing):
    """m, mu, sigma (3, d) float32 and the moments (2, d) float64 after the patch y (d,): eq. 7-11.

    A pixel with y = 0 was not seen and keeps what it had. A component of weight 0 keeps that.
    """
    d, keep = len(y), 1.0 - alpha
    own_w, own_s, own_f = np.empty(d, np.float32), np.empty(d, np.float32), np.empty(d, np.float32)
    w_part, s_part, f_part = _components(mu, rate, log, 0, d)
    uniform = np.float32(math.log2(outlier)) if outlier > 0.0 else _NEVER
    for k in range(d):  # o_i of eq. 7
        a, b = _exponent(y[k], w_part, k, laplace), _exponent(y[k], s_part, k, laplace)
        c = _exponent(y[k], f_part, k, laplace)
        top = a if a > b else b
        top = top if top > c else c
        top = top if top > uniform else uniform
        a, b, c = _exp2(a - top), _exp2(b - top), _exp2(c - top)
        share = _ONE / (a + b + c + _exp2(uniform - top))
        own_w[k], own_s[k], own_f[k] = a * share, b * share, c * share
    new_m, new_mu, new_sigma, new_moments = np.empty_like(m), mu.copy(), sigma.copy(), np.empty_like(moments)
    old_w, old_s, old_f = m[0], m[1], m[2]
    new_w, new_s, new_f = new_m[0], new_m[1], new_m[2]
    w_centre, centre, spread = new_mu[0], new_mu[1], new_sigma[1]
    first, second, new_first, new_second = moments[0], moments[1], new_moments[0], new_moments[1]
    for k in range(d):
        value, seen = float(y[k]), y[k] != _ZERO
        w, s, f = float(old_w[k]), float(old_s[k]), float(old_f[k])
        w_on, s_on, f_on = w > 0.0, s > 0.0, f > 0.0
        gain = alpha * own_s[k]
        w, s, f = alpha * own_w[k] + keep * w, gain + keep * s, alpha * own_f[k] + keep * f
        moves, some = seen & s_on, s > _MIN_WEIGHT
        # with alpha = 1 and nothing owned no moment is left: S stays
        whole = s if some else (old_s[k] if s_on else 1.0)
        mean = (gain * value + keep * first[k] if some else first[k]) / whole
        square = (gain * value * value + keep * second[k] if some else second[k]) / whole
        variance = square - mean * mean
        variance = variance if variance > least_sigma * least_sigma else least_sigma * least_sigma
        centre[k] = np.float32(mean) if moves else centre[k]
        spread[k] = np.float32(math.sqrt(variance)) if moves else spread[k]
        w_centre[k] = y[k] if seen else w_centre[k]
        w, s, f = (
            (w if w > least_mixing else least_mixing) if w_on else 0.0,
            (s if s > least_mixing else least_mixing) if s_on else 0.0,
            (f if f > least_mixing else least_mixing) if f_on else 0.0,
        )
        total, learns = w + s + f, seen & (w + s + f > _MIN_WEIGHT)
        new_w[k] = np.float32(w / total) if learns else old_w[k]
        new_s[k] = np.float32(s / total) if learns else old_s[k]
        new_f[k] = np.float32(f / total) if learns else old_f[k]
        # what floors and rounding did to m_s is done to its moments, or S would move with it
        new_first[k] = mean * new_s[k] if moves else first[k]
        new_second[k] = square * new_s[k] if moves else second[k]
    return new_m, new_mu, new_sigma, new_moments


@fast("f4:2r f4:2")
def best_matches(y, templates):
    """The largest NCC of patches y (N, d) of mean 0 with any of the templates (n, d) -> (N,); 0 of a flat one."""
    count, d = y.shape
    out, means, squares = np.full(count, -1.0), np.zeros(len(templates)), np.zeros(len(templates))
    for i in range(len(templates)):
        row, total, square = templates[i], _ZERO, _ZERO
        for k in range(d):
            total += row[k]
        mean = np.float32(total / d)
        for k in range(d):
            square += (row[k] - mean) * (row[k] - mean)
        means[i], squares[i] = mean, square
    for n in range(count):
        row, square = y[n], _ZERO
        for k in range(d):
            square += row[k] * row[k]
        for i in range(len(templates)):
            other, mean, cross = templates[i], np.float32(means[i]), _ZERO
            for k in range(d):
                cross += row[k] * (other[k] - mean)
            lengths = math.sqrt(float(square) * squares[i])
            out[n] = max(out[n], cross / lengths if lengths > 1e-6 else 0.0)
    return out


# --- eq. 12

_EPSILON = 2.3e-16
_WIDE = 8  # columns that are turned together: the six of a motion, filled up
_SWEEPS = 60  # for one value at most; it takes two


@fast("f4:2r i8:1 f4:1r")
def differences(y, chosen, patch):
    """y[chosen] - patch (J, d), and the products of its rows (J, J) float64; y (N, d), chosen (J,), patch (d,)."""
    count, d = len(chosen), len(patch)
    even = count + count % 2  # by pairs, of which the last may be filled with nothing
    rows, products = np.zeros((even, d), np.float32), np.empty((even, even))
    for n in range(count):
        row, seen = rows[n], y[chosen[n]]
        for k in range(d):
            row[k] = seen[k] - patch[k]
    # four sums for four reads, where one at a time would be two reads each
    for i in range(0, even, 2):
        a, b = rows[i], rows[i + 1]
        for j in range(0, i + 2, 2):
            c, e = rows[j], rows[j + 1]
            ac, ae, bc, be = _ZERO, _ZERO, _ZERO, _ZERO
            for k in range(d):
                ac += a[k] * c[k]
                ae += a[k] * e[k]
                bc += b[k] * c[k]
                be += b[k] * e[k]
            products[i, j], products[i, j + 1], products[i + 1, j], products[i + 1, j + 1] = ac, ae, bc, be
            products[j, i], products[j + 1, i], products[j, i + 1], products[j + 1, i + 1] = ac, ae, bc, be
    return rows[:count], np.ascontiguousarray(products[:count, :count])


@fast("f8:2 f4:2 f4:1")
def mapped(gain, rows, off):
    """gain (6, J) times rows (J, d) times off (d,) -> (6,)."""
    out = np.zeros(len(gain))
    for n in range(len(rows)):
        row, total = rows[n], _ZERO
        for k in range(len(off)):
            total += row[k] * off[k]
        for i in range(len(gain)):
            out[i] += gain[i, n] * total
    return out


@fast_part
def _reflect(w, v, beta, along):
    """w (n, 8) less beta v v^T w; v (k,) goes with its first k rows; `along` (8,) is scratch."""
    along[:] = 0.0
    for i in range(len(v)):
        for j in range(_WIDE):
            along[j] += v[i] * w[i, j]
    for i in range(len(v)):
        by = beta * v[i]
        for j in range(_WIDE):
            w[i, j] -= by * along[j]


@fast_part
def _tridiagonal(a, diagonal, beside, betas, p):
    """Householder's reduction of the symmetric a (n, n) in place, by its lower triangle: row k keeps its reflector.

    p (n,) is scratch.
    """
    n = len(a)
    for k in range(n - 1, 0, -1):
        v, squares = a[k, :k], 0.0
        for i in range(k - 1):
            squares += v[i] * v[i]
        diagonal[k], beside[k - 1] = a[k, k], v[k - 1]
        if squares > 0.0:
            alpha = -math.copysign(math.sqrt(squares + v[k - 1] * v[k - 1]), v[k - 1])
            v[k - 1] -= alpha
            beta, cross = 2.0 / (squares + v[k - 1] * v[k - 1]), 0.0
            beside[k - 1], betas[k] = alpha, beta
            for i in range(k):
                row, total, v_i = a[i, :i], 0.0, v[i]
                for j in range(i):
                    total += row[j] * v[j]
                    p[j] += row[j] * v_i
                p[i] = total + a[i, i] * v_i
            for i in range(k):
                p[i] *= beta
                cross += p[i] * v[i]
            for i in range(k):
                p[i] -= 0.5 * beta * cross * v[i]
            for i in range(k):
                row, v_i, p_i = a[i, : i + 1], v[i], p[i]
                for j in range(i + 1):
                    row[j] -= v_i * p[j] + p_i * v[j]
    diagonal[0] = a[0, 0]


@fast_part
def _diagonal(d, e, w, turns, at):
    """The implicit QL method on the tridiagonal matrix of d (n,) and, beside it, e (n,); w (n, 8) is turned with it.

    Keeps the turns (cosine, sine) and the rows they are `at`. Returns their number, -1 without convergence.
    """
    n, count = len(d), 0
    for low in range(n):
        sweeps = 0
        while True:
            m = low
            while m < n - 1 and abs(e[m]) > _EPSILON * (abs(d[m]) + abs(d[m + 1])):
                m += 1
            if m == low:
                break
            sweeps += 1
            if sweeps > _SWEEPS or count + m - low > len(at):
                return -1
            g = (d[low + 1] - d[low]) / (2.0 * e[low])
            g = d[m] - d[low] + e[low] / (g + math.copysign(math.sqrt(g * g + 1.0), g))
            s, c, p, whole = 1.0, 1.0, 0.0, True
            for i in range(m - 1, low - 1, -1):
                f, b = s * e[i], c * e[i]
                r = math.sqrt(f * f + g * g)
                e[i + 1] = r
                if r == 0.0:
                    d[i + 1] -= p
                    e[m], whole = 0.0, False
                    break
                s, c = f / r, g / r
                g = d[i + 1] - p
                r = (d[i] - g) * s + 2.0 * c * b
                p = s * r
                d[i + 1] = g + p
                g = c * r - b
                turns[count, 0], turns[count, 1], at[count] = c, s, i
                count += 1
                for j in range(_WIDE):
                    lower, upper = w[i, j], w[i + 1, j]
                    w[i + 1, j], w[i, j] = s * lower + c * upper, c * lower - s * upper
            if whole:
                d[low] -= p
                e[low], e[m] = g, 0.0
    return count


@fast("f8:2 f8:2 i8 f8")
def gain(x, products, components, rank):
    """X V_q S_q^-2 V_q^T (6, J), of motions x (J, 6) and Y^T Y = V S^2 V^T, `products` (J, J).

    q is `components`, less those whose singular value is below `rank` times the largest. V is never formed: what turns
    Y^T Y into S^2 is done to X, and undone. All 0 for values that are no numbers.
    """
    n = len(products)
    if n == 0:
        return np.zeros((6, n))
    a, w, room, along = products.copy(), np.zeros((n, _WIDE)), 4 * n * n + 64, np.empty(_WIDE)
    w[:, :6] = x
    # about 1.7 sweeps a value, of half the length in the mean
    turns, at = np.empty((room, 2)), np.empty(room, np.int32)
    d, e, betas, p = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    _tridiagonal(a, d, e, betas, p)
    for k in range(n - 1, 0, -1):
        _reflect(w, a[k, :k], betas[k], along)
    count = _diagonal(d, e, w, turns, at)
    top, solved = d[0], count >= 0
    for k in range(n):
        top = d[k] if d[k] > top else top
        # not a number fails this too
        solved = solved and d[k] < np.inf
    if not solved:
        return np.zeros((6, n))
    least = max(rank * rank * top, 1e-12)
    for i in range(n):
        larger = 0
        for k in range(n):
            larger += 1 if d[k] > d[i] or (d[k] == d[i] and k > i) else 0
        by = 1.0 / d[i] if larger < components and d[i] > least else 0.0
        for j in range(_WIDE):
            w[i, j] *= by
    for t in range(count - 1, -1, -1):
        i, c, s = at[t], turns[t, 0], turns[t, 1]
        for j in range(_WIDE):
            lower, upper = w[i, j], w[i + 1, j]
            w[i, j], w[i + 1, j] = c * lower + s * upper, c * upper - s * lower
    for k in range(1, n):
        _reflect(w, a[k, :k], betas[k], along)
    return np.ascontiguousarray(w[:, :6].T)
