# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""B of eq. 12 of Zhou, Chellappa & Moghaddam 2003: least squares by the largest singular values.

Not by LAPACK: on busy cores its threads take a hundred times as long for matrices as small as these, and the last
digits depend on how many there are.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import fast

Array: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = NDArray[np.float32]
_ZERO = np.float32(0.0)
_EPSILON = 2.3e-16
_WIDE = 8  # columns that are turned together: the six of a motion, filled up
_SWEEPS = 60  # for one value at most; it takes two


def differences(y: Rows, chosen: NDArray[np.int64], patch: Rows) -> tuple[Rows, Array]:
    """y[chosen] - patch (J, d), and the products of its rows (J, J) float64; y (N, d), chosen (J,), patch (d,)."""
    count = len(chosen)
    even = count + count % 2  # by pairs, of which the last may be filled with nothing
    rows, products = np.zeros((even, len(patch)), np.float32), np.empty((even, even))
    _differences(y, chosen, patch, rows, products)
    return rows[:count], np.ascontiguousarray(products[:count, :count])


@fast
def _differences(y, chosen, patch, rows, products):
    d, even = len(patch), len(products)
    for n in range(len(chosen)):
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


def mapped(gain: Array, rows: Rows, patch: Rows, wanted: Rows) -> Array:
    """gain (6, J) times rows (J, d) times (patch - wanted) (d,) -> (6,)."""
    out = np.zeros(len(gain))
    _mapped(gain, rows, patch - wanted, out)
    return out


@fast
def _mapped(gain, rows, off, out):
    for n in range(len(rows)):
        row, total = rows[n], _ZERO
        for k in range(len(off)):
            total += row[k] * off[k]
        for i in range(len(gain)):
            out[i] += gain[i, n] * total


@fast
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


@fast
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


@fast
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


def gain(x: Array, products: Array, components: int, rank: float) -> Array:
    """X V_q S_q^-2 V_q^T (6, J), of motions x (J, 6) and Y^T Y = V S^2 V^T, `products` (J, J).

    q is `components`, less those whose singular value is below `rank` times the largest. V is never formed: what turns
    Y^T Y into S^2 is done to X, and undone. All 0 for values that are no numbers.
    """
    n = len(products)
    if n == 0:
        return np.zeros((6, 0))
    a, w, room = products.copy(), np.zeros((n, _WIDE)), 4 * n * n + 64
    w[:, :6] = x
    # about 1.7 sweeps a value, of half the length in the mean
    turns, at = np.empty((room, 2)), np.empty(room, np.int32)
    d, e, betas, p = np.zeros((4, n))
    _solve(a, w, d, e, betas, p, np.empty(_WIDE), turns, at, components, rank)
    return np.ascontiguousarray(w[:, :6].T)


@fast
def _solve(a, w, d, e, betas, p, along, turns, at, components, rank):
    """`gain` in place: a (n, n) are the products, w (n, 8) the motions and then the answer, the others scratch."""
    n = len(a)
    _tridiagonal(a, d, e, betas, p)
    for k in range(n - 1, 0, -1):
        _reflect(w, a[k, :k], betas[k], along)
    count = _diagonal(d, e, w, turns, at)
    top, known = d[0], count >= 0
    for k in range(n):
        top = d[k] if d[k] > top else top
        # not a number fails this too
        known = known and d[k] < np.inf
    if not known:
        w[:] = 0.0
        return
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
