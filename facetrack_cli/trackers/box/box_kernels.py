# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Cells of gradients, the linear algebra of a correlation filter over them, and densities of particles.

Densities are those of a marginal particle filter, over all particles of the frame before (Klaas et al. 2005).
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact, fast, inline, moments

COLOURS = 1 << 15  # of 5 bits a channel
CHANNELS = 31  # 18 signed orientations, 9 unsigned ones, 4 of texture
_CLIP, _TEXTURE, _FLAT = np.float32(0.2), np.float32(0.2357), np.float32(1e-4)
_10, _30, _50, _70 = (np.float32(math.tan(math.radians(angle))) for angle in (10, 30, 50, 70))
_ZERO, _HALF, _ONE, _UNIT = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(1 / 255)
_LEVELS, _RATIOS = np.arange(256) / 255, np.arange(3072, dtype=np.float32) * np.float32(1 / 2040)
_LINEAR = np.rint(2040 * np.where(_LEVELS <= 0.04045, _LEVELS / 12.92, ((_LEVELS + 0.055) / 1.055) ** 2.4)).astype(int)
_ROOTS = np.rint(32768 * np.where(_RATIOS < 216 / 24389, _RATIOS * 841 / 108 + 4 / 29, np.cbrt(_RATIOS))).astype(int)
_CHROMA = np.float32(60.0)  # levels of a and b that count as much as the whole range of grey
_WHOLE, _PER_TURN = 1.5 * 2.0**52, math.log2(math.e)  # a number whose neighbours are 1 away; exp(x) = 2^(x _PER_TURN)
# log 2 as a sum, the first with zeros at its end
_TURN = float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33")
_TAYLOR = tuple(1 / math.factorial(k) for k in range(13, -1, -1))


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


@exact("f4:1 i8:1 i8:1 f4 f4:1")
def tally(histogram, bins, part, rate, out):
    """`out`: the histogram moved by `rate` towards that of the pixels `part`, of which `bins` say the colours."""
    keep, more = _ONE - rate, rate / np.float32(len(part))
    for k in range(len(out)):
        out[k] = keep * histogram[k]
    for n in part:
        out[bins[n]] += more


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
        many = len(features) // 4 * 4
        for k in range(0, many, 4):  # four at a time: sums are loaded and stored as often as features are
            p, q, r, s = components[c, k], components[c, k + 1], components[c, k + 2], components[c, k + 3]
            first, second, third, fourth = features[k], features[k + 1], features[k + 2], features[k + 3]
            for m in range(len(row)):
                row[m] += p * first[m] + q * second[m] + r * third[m] + s * fourth[m]
        for k in range(many, len(features)):
            weight, feature = components[c, k], features[k]
            for m in range(len(row)):
                row[m] += weight * feature[m]
        for m in range(len(row)):
            row[m] *= window[m]


@fast("f4:3 f4:3 f4 f4:3")
def remember(memory, x, rate, out):
    """`memory` (P, 2, F), Hermitian matrices (C, C) of F frequencies, moved by `rate` towards x x^H of x (2, C, F).

    P = C (C + 1) / 2 are the entries on and above the diagonal, by rows; real parts before imaginary ones.
    """
    keep, p = _ONE - rate, 0
    for i in range(x.shape[1]):
        ar, ai = x[0, i], x[1, i]
        for j in range(i, x.shape[1]):
            br, bi, real, imaginary = x[0, j], x[1, j], out[p, 0], out[p, 1]
            for f in range(len(ar)):
                real[f] = keep * memory[p, 0, f] + rate * (ar[f] * br[f] + ai[f] * bi[f])
                imaginary[f] = keep * memory[p, 1, f] + rate * (ai[f] * br[f] - ar[f] * bi[f])
            p += 1


@fast("f4:3 f4:3 f4 f4:1 f8 f4:3")
def turn(r, memory, least, counts, last, p):
    """The next direction p (2, C, F) of conjugate gradients from the residual r (2, C, F).

    It is preconditioned by the diagonal of the matrices of `memory`, half of its mean and `least`. Returns the product
    of both, and takes that of the step before as `last`, 0 at first; a frequency `counts` (F,) times.
    """
    z, k, total = np.empty_like(r), 0, 0.0
    for c in range(r.shape[1]):
        z[0, c], z[1, c], k = memory[k, 0], memory[k, 0], k + r.shape[1] - c
    least += np.float32(0.5 * z.mean())
    for part in range(2):
        for c in range(r.shape[1]):
            product = _ZERO
            for f in range(len(counts)):
                z[part, c, f] = r[part, c, f] / (z[part, c, f] + least)
                product += counts[f] * z[part, c, f] * r[part, c, f]
            total += float(product)
    share = np.float32(total / last) if last > 0.0 else _ZERO
    for part in range(2):
        for c in range(r.shape[1]):
            for f in range(len(counts)):
                p[part, c, f] = z[part, c, f] + share * p[part, c, f]
    return total


@fast("f4:3 f4:3 f4:3 f4:1 f8 f4:3 f4:3 f4:3")
def descend(memory, p, beyond, counts, product, v, r, walled):
    """A step along p of v, r and `walled`, in place: the matrices of `memory` times p, and `beyond`, are taken from r.

    All are (2, C, F); `product` is that of r and the direction that `turn` returns.
    """
    out, k, total = beyond.copy(), 0, 0.0
    for i in range(p.shape[1]):
        ir, ii, oir, oii = p[0, i], p[1, i], out[0, i], out[1, i]
        for j in range(i, p.shape[1]):
            real, imaginary, jr, ji = memory[k, 0], memory[k, 1], p[0, j], p[1, j]
            for f in range(len(ir)):
                oir[f] += real[f] * jr[f] - imaginary[f] * ji[f]
                oii[f] += real[f] * ji[f] + imaginary[f] * jr[f]
            if j > i:
                ojr, oji = out[0, j], out[1, j]
                for f in range(len(ir)):
                    ojr[f] += real[f] * ir[f] + imaginary[f] * ii[f]
                    oji[f] += real[f] * ii[f] - imaginary[f] * ir[f]
            k += 1
    for part in range(2):
        for c in range(p.shape[1]):
            along = _ZERO
            for f in range(len(counts)):
                along += counts[f] * p[part, c, f] * out[part, c, f]
            total += float(along)
    alpha = np.float32(product / max(total, 1e-20))
    for part in range(2):
        for c in range(p.shape[1]):
            for f in range(len(counts)):
                v[part, c, f] += alpha * p[part, c, f]
                r[part, c, f] -= alpha * out[part, c, f]
                walled[part, c, f] += alpha * beyond[part, c, f]


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


@exact("f4:2 f4 f8:2")
def highest(response, least, out):
    """Local maxima of a response (H, W) of at least `least`, the highest first: rows (column, row, height) of `out`.

    A parabola through the neighbours gives the place between samples (LMCF looks at several too; Wang et al. 2017).
    Returns how many there are, of those that are not on the border.
    """
    count = 0
    for i in range(1, len(response) - 1):
        for j in range(1, response.shape[1] - 1):
            here = response[i, j]
            if here < least or (count == len(out) and here <= out[count - 1, 2]):
                continue
            top = True
            for k in range(i - 1, i + 2):
                for m in range(j - 1, j + 2):
                    top &= response[k, m] <= here
            if top:
                count = min(count + 1, len(out))
                k = count - 1
                while k > 0 and out[k - 1, 2] < here:
                    out[k] = out[k - 1]
                    k -= 1
                out[k, 0], out[k, 1], out[k, 2] = j, i, here
    for k in range(count):
        j, i, middle = int(out[k, 0]), int(out[k, 1]), out[k, 2]
        for axis in range(2):
            a, b = response[i - axis, j - 1 + axis], response[i + axis, j + 1 - axis]
            bend = np.float64(a) + b - 2.0 * middle
            off = 0.5 * (np.float64(a) - b) / bend if bend < -1e-12 else 0.0
            out[k, axis] += off
            out[k, 2] -= 0.25 * (np.float64(a) - b) * off
    return count


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


@exact("f8:2 f8:2 f8:2 f8:1 f8:1")
def log_mixture(z, mean, std, log_w, out):
    """out (N,): log sum_j exp(log_w_j - |(z - mean_j) / std_j|^2 / 2) of z (N, 3), `mean` and `std` (J, 3)."""
    parts = np.empty(len(mean))
    for n in range(len(z)):
        top, total = -math.inf, 0.0
        for j in range(len(mean)):
            parts[j] = log_w[j]
            for k in range(3):
                parts[j] -= 0.5 * ((z[n, k] - mean[j, k]) / std[j, k]) ** 2
            top = max(top, parts[j])
        for part in parts:
            total += math.exp(part - top)
        out[n] = math.log(total) + top


@inline
def _exponentials(x, turns):
    """exp(x) of x (n,) in place, -700 at least, vectorised as the library's is not; `turns` (n,) is written over.

    x = k log 2 + r, and exp(r) is Taylor's polynomial. A sum with `_WHOLE` has k in its lowest bits.
    """
    for i in range(len(x)):
        turns[i] = x[i] * _PER_TURN + _WHOLE
        k, p = turns[i] - _WHOLE, 0.0
        r = x[i] - k * _TURN[0] - k * _TURN[1]
        for share in _TAYLOR:
            p = p * r + share
        x[i] = p
    bits, k = x.view(np.int64), turns.view(np.int64)
    for i in range(len(x)):
        bits[i] += k[i] << 52


@exact("f8:2 f8:2 f8:1 f8x2 f8x8 f8:1 f8:2 f8:1 f8:1 f8:2")
def arrive(z, parents, log_w, sigma, walk, u, e, shown, hidden, x):
    """log sum_m w_m p(z_n, visible | m) of places and log scales z (N, 3), in `shown` (N,), and of hidden in `hidden`.

    `parents` (M, 6) are the particles of the last frame, log_w (M,) their weights. They move by the `sigma` of a
    `VisibleWalk` and by `walk`: its scale, velocity, acceleration, P(hides), those to be shown near and to return
    elsewhere, and the limits of the scale. x (N, 6) are z with velocities drawn of p(velocity | z): u (N,), uniform in
    0..1, draws the parent, and whether the target was hidden on its way, and e (N, 2), standard normal, the rest.

    Returns the probability of a return elsewhere, which is in neither, and the mean scale of the parents.
    """
    scale, a, b, hide, show, leave, least, most = walk
    many, returns, size = len(parents), 0.0, 0.0
    mean, (logs, factor), (parts, turns) = np.empty((3, many)), np.empty((2, 2 * many)), np.empty((2, 2 * many))
    for m in range(many):
        parent, w = parents[m], math.exp(log_w[m])
        s, before, away = parent[2], parent[5], (1.0 - parent[5]) * leave
        mean[0, m], mean[1, m], mean[2, m] = parent[0] + a * parent[3], parent[1] + a * parent[4], math.log(s)
        near = before * (1.0 - hide) + (1.0 - before) * show
        returns, size = returns + w * away, size + w * s
        for k, share in ((m, near), (m + many, max(1.0 - near - away, 0.0))):
            step = sigma[k // many] * s
            factor[k] = -0.5 / step**2
            logs[k] = log_w[m] + np.log(share) - 2.0 * math.log(step) - math.log(scale) - 1.5 * math.log(2.0 * math.pi)
    for n in range(len(z)):
        for k in (0, many):
            for m in range(many):
                dx, dy, ds = z[n, 0] - mean[0, m], z[n, 1] - mean[1, m], (z[n, 2] - mean[2, m]) / scale
                parts[k + m] = logs[k + m] + factor[k + m] * (dx * dx + dy * dy) - 0.5 * ds * ds
        top = other = -1e300
        for m in range(many):
            top, other = max(top, parts[m]), max(other, parts[many + m])
        for m in range(many):
            parts[m], parts[many + m] = max(parts[m] - top, -700.0), max(parts[many + m] - other, -700.0)
        _exponentials(parts, turns)
        seen = unseen = 0.0
        for m in range(many):
            seen, unseen = seen + parts[m], unseen + parts[many + m]
            parts[m], parts[many + m] = seen, unseen
        shown[n], hidden[n] = math.log(seen) + top, math.log(unseen) + other
        share = 1.0 / (1.0 + math.exp(min(hidden[n] - shown[n], 700.0)))
        left, k = u[n] / share * seen, 0
        if u[n] > share:
            left, k = (u[n] - share) / (1.0 - share) * unseen, many
        while k < 2 * many - 1 and parts[k] < left:
            k += 1
        chosen, noise = parents[k % many], math.sqrt(b * (1.0 - b)) * sigma[k // many]
        for i in range(2):
            v = a * chosen[3 + i]
            x[n, i] = z[n, i]
            x[n, 3 + i] = v + b * (z[n, i] - chosen[i] - v) + noise * chosen[2] * e[n, i]
        x[n, 2], x[n, 5] = min(max(math.exp(z[n, 2]), least), most), 0.0
    return returns, size


@exact("f8:2 f8:1 f8:1 f8x5 f8:3")
def carry(x, noise, step, walk, moved):
    """`moved` (N, 1, 6) of particles x (N, 6) by a `step` (2,), with their mean velocities.

    `walk` has the walk's scale, velocity, acceleration, and the limits of the scale. The scales of each two particles
    change by `noise` (N / 2,), standard normal, and by its opposite.
    """
    scale, a, b, least, most = walk
    for n in range(len(x)):
        grown, out = math.exp(scale * noise[n // 2]), moved[n, 0]
        out[2] = min(max(x[n, 2] * grown if n % 2 == 0 else x[n, 2] / grown, least), most)
        for i in range(2):
            out[i], out[3 + i] = x[n, i] + step[i], a * (1.0 - b) * x[n, 3 + i] + b * step[i]
        out[5] = x[n, 5]


@exact("f8:3 f8:1 f8x2 f8:2 f8:3 f8:1")
def sum_up(x, log_w, size, state, cov, side_std):
    """The estimate `state`, `cov`, `side_std` of a box of a `size` by particles x (N, 1, 6), as `engine.spaces` says.

    Returns the effective sample size of the weights. What counts are particles that are visible, or if the target
    rather is hidden, those.
    """
    w, shown, total, squares, own, spread = np.exp(log_w), 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(len(x)):
        shown, squares = shown + w[n] * x[n, 0, 5], squares + w[n] ** 2
    for n in range(len(x)):
        w[n] *= x[n, 0, 5] if shown >= 0.5 else 1.0 - x[n, 0, 5]
        total += w[n]
    for n in range(len(x)):
        w[n] /= total
        own += w[n] ** 2
    more = np.full(1, (1.0 + own) / max(1.0 - own, 1e-12))
    moments(x, w, more, state, cov)
    for n in range(len(x)):
        spread += w[n] * (x[n, 0, 2] - state[0, 2]) ** 2
    for i in range(2):
        side_std[i] = size[i] * math.sqrt(spread * more[0])
    state[0, 5] = shown
    return 1.0 / squares
