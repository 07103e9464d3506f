# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Loops over images of a face: channels of gradients and redness, and regressions that read them.

Logarithms come from tables, means over squares from running sums. Channels are smoothed down the image everywhere, and
across it at the points alone that are read.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import between, exact, fast, fast_part, part

Single: TypeAlias = NDArray[np.float32]
Image: TypeAlias = NDArray[np.uint8]
_ZERO, _ONE, _TWO, _THREE, _FOUR, _FIVE = (np.float32(k) for k in range(6))
_ALL, _HALF, _FINE = np.float32(1 / 625), np.float32(0.5), np.float32(1 / 32)
_BITS, _BYTE = np.uint32(8), np.uint32(255)
_FLAT, _EVEN, _TINY = np.float32(0.02), np.float32(0.05), np.float32(1e-6)
_REACH = 4  # pixels that smoothing reads on either side
_NEAR, _AROUND = 13, 23  # pixels on either side of a mean
_GREY = np.log(np.arange(8 * 255 + 1) / 8 + 16).astype(np.float32)  # by an eighth of a grey level
_OF_NINE = _GREY[(16 * np.arange(9 * 255 + 1) + 9) // 18]  # by the sum of nine grey levels
_COLOUR = np.log(np.arange(256) + 8.0).astype(np.float32)
_TURNS = np.arange(8) * (2 * np.pi / 8)
_WAYS = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1).astype(np.float32)
DIRECTIONS = len(_WAYS)


@fast("u1:3")
def looks(image):
    """log(grey + 16), and the redness log((red + 8) / (green + 8)), (2, H, W), of a contiguous image (H, W, 3)."""
    height, width, _ = image.shape
    out = np.empty((2, height, width), np.float32)
    for y in range(height):
        for x in range(width):
            b, g, r = np.int32(image[y, x, 0]), np.int32(image[y, x, 1]), np.int32(image[y, x, 2])
            out[0, y, x] = _GREY[(934 * b + 4809 * g + 2449 * r + 512) >> 10]
            out[1, y, x] = _COLOUR[r] - _COLOUR[g]
    return out


def smoothed_channels(image: Image) -> Single:
    """Channels (C, H, W + 8) of colours (H, W, 3), smoothed down the image, with a border on the left and on the right.

    In each direction the square of a gradient's share along it, over its length and the usual length; then redness,
    brightness and the slope of redness down the image. All is relative to what is around. H and W are 24 or more; the
    border reflects.
    """
    return np.asarray(_channels(looks(np.ascontiguousarray(image))), np.float32)


@fast("f4:3")
def _channels(seen):
    return _smoothed(seen)


@fast("u1:3 f8:2 f4:2")
def read_eyes(patches, offsets, out):
    """What is read of patches (2, H, W) of grey levels: `out` (2, G C + 1) at `offsets` (G, 2), and at last a 1.

    The second patch is mirrored. Channels are as `smoothed_channels` of means over 3 x 3 levels, but without redness,
    and relative to the whole patch.
    """
    for eye in range(len(patches)):
        _read_eye(patches[eye], eye == 1, offsets, out[eye])


@fast("u1:3 f8:2 f4:2 f8:2 f8x4 i8:2 f8:2 f8:1")
def place_eyes(patches, offsets, lids, middles, narrow, order, at, odds):
    """Corners and lids `at` (8, 2) of eyes with their `middles` (2, 2), and their log odds `odds` (8,).

    `lids` (9, G C + 1) multiplies what `read_eyes` reads. The patches lie along the line of the eyes. Of `narrow` are
    their zoom, the width below which an eye loses log odds, those that it loses by a pixel, and those that both lose;
    `order` (2, 4) are the rows of each eye.
    """
    read, output = np.empty(lids.shape[1], np.float32), np.empty(len(lids), np.float32)
    zoom, least, steep, lost = narrow
    across, down = middles[1, 0] - middles[0, 0], middles[1, 1] - middles[0, 1]
    apart = zoom * max(np.sqrt(across**2 + down**2), 1e-9)
    a, b = across / apart, down / apart
    for eye in range(len(patches)):
        _read_eye(patches[eye], eye == 1, offsets, read)
        _multiply(lids, read[:-1], output)
        for i in range(4):
            x, y = (-output[2 * i] if eye else output[2 * i]), output[2 * i + 1]
            k = order[eye, i]
            at[k, 0], at[k, 1] = middles[eye, 0] + a * x - b * y, middles[eye, 1] + b * x + a * y
            width = np.sqrt((output[0] - output[2]) ** 2 + (output[1] - output[3]) ** 2)
            odds[k] = output[8] + min(steep * (width - least), 0.0) + lost


@fast_part
def _read_eye(patch, mirrored, offsets, out):
    height, width = patch.shape
    sums, seen = np.empty(width, np.int32), np.empty((1, height, width), np.float32)
    for y in range(height):
        above, below = patch[abs(y - 1)], patch[height - 1 - abs(height - 2 - y)]
        for x in range(width):
            sums[x] = np.int32(above[x]) + np.int32(patch[y, x]) + np.int32(below[x])
        for x in range(width):
            left, right = sums[abs(x - 1)], sums[width - 1 - abs(width - 2 - x)]
            seen[0, y, width - 1 - x if mirrored else x] = _OF_NINE[left + sums[x] + right]
    channels = _smoothed(seen)
    _read(channels, np.zeros((1, 2)), offsets, 1.0, out[:-1].reshape(1, len(offsets), len(channels)))
    out[-1] = _ONE


@exact("u1:1 u1:1 u1:1 i8 i8 i8x2 i8 u1:3")
def shrink(lit, u, v, wide, half, size, read, out):
    """The means `out` (H, W, 3) of planes of `size` pixels with rows of `wide` and `half` bytes, as OpenCV has them.

    Each is of `read` pixels of a row, and of as many rows of `lit`.
    """
    _shrink(lit, wide, size[0], size[1], read, read, out[:, :, 0])
    _shrink(u, half, size[0] // 2, size[1] // 2, read, 1, out[:, :, 1])
    _shrink(v, half, size[0] // 2, size[1] // 2, read, 1, out[:, :, 2])


@part
def _shrink(flat, wide, width, height, read, rows, out):
    (down, across), share = out.shape, np.float32(1.0) / np.float32(rows * read)
    columns = np.empty(across * read, np.int64)
    for x in range(len(columns)):
        columns[x] = int(x * (1.0 / (len(columns) / width)))
    for i in range(down):
        sums = np.zeros(across, np.int32)
        for r in range(i * rows, (i + 1) * rows):
            row = flat[int(r * (1.0 / (down * rows / height))) * wide :]
            for j in range(across):
                for x in range(j * read, (j + 1) * read):
                    sums[j] += row[columns[x]]
        for j in range(across):
            out[i, j] = np.rint(np.float32(sums[j]) * share)


@exact("u1:2 u1:2 u1:2 i8x3 i8x3 f8:2 f8 f8:2 u1:3")
def see(lit, u, v, at, tint_at, views, middle, matrix, out):
    """Views `out` (M, rows, side) of a frame's planes; `views` (M, 4) are as `Similarity.view` has them.

    (left, top, factor) of `lit`, and of both tints, are as `Frame.planes` has them, `middle` of a view is its centre.
    With 3/2 side rows the tints follow, at every other pixel. All become those of BT.601 by a `matrix` (3, 3), if that
    is not empty. Of a plane in grey alone the tints are not read.
    """
    side = out.shape[2]
    half, tinted = side // 2, out.shape[1] > side
    tints = np.empty((2, half, half), np.uint8)
    for m in range(len(views)):
        _warp(lit, views[m], at, middle, 1.0, out[m])
        if tinted or len(matrix) > 0:
            _warp(u, views[m], tint_at, 0.5 * middle - 0.25, 2.0, tints[0])
            _warp(v, views[m], tint_at, 0.5 * middle - 0.25, 2.0, tints[1])
        if len(matrix) > 0:
            _mix(out[m], tints, matrix)
        if tinted:
            out[m, side:] = tints.reshape(side - half, side)


@part
def _mix(lit, tints, matrix):
    """Both by another matrix, of so few bits that these sums are exact; as `Planes` has them."""
    side, more = tints.shape[2], np.empty(tints.shape[2], np.int32)
    for i in range(side):
        for j in range(side):
            p, q = tints[0, i, j] - 128.0, tints[1, i, j] - 128.0
            more[j] = _mixed(matrix[0], p, q) - 128
            tints[0, i, j], tints[1, i, j] = _mixed(matrix[1], p, q), _mixed(matrix[2], p, q)
        for row in lit[2 * i : 2 * i + 2]:
            for j in range(2 * side):
                row[j] = min(max(np.int32(np.int32(row[j]) + more[j >> 1]), np.int32(0)), np.int32(255))


@part
def _mixed(row, p, q):
    return np.int32(min(max(np.rint(row[1] * p + row[2] * q + 128.0), 0.0), 255.0))


@part
def _warp(image, view, at, middle, step, out):
    """The first rows `out` (side, side) of a plane at every `step` pixels of a view, as OpenCV 4 has them, bit for bit.

    Places are read to 1/32 pixel. The border's pixels go on.
    """
    (height, width), side, flat, (begin, first, factor) = image.shape, out.shape[1], image.reshape(image.size), at
    a, b, off = step * view[2] / factor, step * view[3] / factor, (factor - 1) / 2
    u, v = (view[0] - begin - off) / factor - (a - b) * middle, (view[1] - first - off) / factor - (b + a) * middle
    across, down, where = np.empty(side, np.int32), np.empty(side, np.int32), np.empty(side, np.int32)
    fx, fy, four = np.empty(side, np.float32), np.empty(side, np.float32), np.empty(side, np.uint32)
    if min(width, height) < 2:  # neighbours that are read, and count for nothing
        flat = np.append(flat, np.zeros(width + 1, np.uint8))
    # the last places in 1/32 pixel, and the last pixels that have a neighbour
    none, right, bottom, wide = np.int32(0), np.int32(32 * (width - 1)), np.int32(32 * (height - 1)), np.int32(width)
    before, above, one, below = np.int32(max(width - 2, 0)), np.int32(max(height - 2, 0)), np.uint64(1), np.uint64(wide)
    for x in range(side):
        across[x], down[x] = np.int32(np.rint(a * x * 1024.0)), np.int32(np.rint(b * x * 1024.0))
    for y in range(side):
        left, top = np.int32(np.rint((-b * y + u) * 1024.0) + 16), np.int32(np.rint((a * y + v) * 1024.0) + 16)
        for x in range(side):  # what is not cast is int64, which takes half as long again
            j = min(max(np.int32(np.int32(left + across[x]) >> 5), none), right)
            i = min(max(np.int32(np.int32(top + down[x]) >> 5), none), bottom)
            p, q = min(np.int32(j >> 5), before), min(np.int32(i >> 5), above)
            fx[x] = np.float32(np.int32(j - np.int32(p << 5))) * _FINE
            fy[x] = np.float32(np.int32(i - np.int32(q << 5))) * _FINE
            where[x] = np.int32(np.int32(q * wide) + p)
        # a loop of its own: loads from anywhere do not vectorise, all else does
        for x in range(side):
            k = np.uint64(where[x])
            upper = np.uint32(flat[k]) | np.uint32(flat[k + one]) << _BITS
            lower = np.uint32(flat[k + below]) | np.uint32(flat[k + below + one]) << _BITS
            four[x] = upper | lower << (_BITS + _BITS)
        row = out[y]
        for x in range(side):
            row[x] = np.int32(between(four[x], _BITS, _BYTE, fx[x], fy[x]) + _HALF)


@fast_part
def _smoothed(seen):
    (many, height, width), whole = seen.shape, len(seen) > 1
    directions = len(_WAYS)
    out = np.empty((directions + 2 * many - 1, height, width + 2 * _REACH), np.float32)
    scratch = np.empty((7, height, width), np.float32)
    across, down, others, raw, usual = scratch[0], scratch[1], scratch[2:5], scratch[5], scratch[6]
    _slopes(seen[0], across, down)
    if whole:
        _slopes(seen[1], raw, others[2])
        _over_rms(others[2], _NEAR, raw)
        for k in range(2):
            _mean(seen[1 - k], False, _AROUND, raw)
            for y in range(height):
                for x in range(width):
                    others[k, y, x] = seen[1 - k, y, x] - raw[y, x]
            _over_rms(others[k], _AROUND, raw)
        for y in range(height):
            for x in range(width):
                raw[y, x] = across[y, x] ** 2 + down[y, x] ** 2
        _mean(raw, False, _NEAR, usual)
    else:
        total, first, second = _ZERO, _ZERO, _ZERO
        for y in range(height):
            for x in range(width):
                total += across[y, x] ** 2 + down[y, x] ** 2
                first += seen[0, y, x]
        count = np.float32(height * width)
        first /= count
        for y in range(height):
            for x in range(width):
                others[0, y, x] = seen[0, y, x] - first
                second += others[0, y, x] ** 2
        share = _ONE / (np.sqrt(second / count) + _EVEN)
        for y in range(height):
            for x in range(width):
                others[0, y, x] *= share
                usual[y, x] = total / count
    for y in range(height):
        for x in range(width):
            size = np.sqrt(across[y, x] ** 2 + down[y, x] ** 2)
            usual[y, x] = _ONE / (size * (np.sqrt(max(usual[y, x], _ZERO)) + _FLAT) + _TINY)
    for k in range(len(out)):
        if k < directions:
            u, v = _WAYS[k, 0], _WAYS[k, 1]
            for y in range(height):
                for x in range(width):
                    along = max(u * across[y, x] + v * down[y, x], _ZERO)
                    raw[y, x] = along * along * usual[y, x]
            _smooth_down(raw, out[k])
        else:
            _smooth_down(others[k - directions], out[k])
    return out


@fast_part
def _slopes(values, across, down):
    """Sobel's slopes."""
    height, width = values.shape
    for y in range(height):
        above, here, below = values[abs(y - 1)], values[y], values[height - 1 - abs(height - 2 - y)]
        for x in range(1, width - 1):
            across[y, x] = (
                above[x + 1] - above[x - 1] + _TWO * (here[x + 1] - here[x - 1]) + below[x + 1] - below[x - 1]
            )
            down[y, x] = below[x - 1] - above[x - 1] + _TWO * (below[x] - above[x]) + below[x + 1] - above[x + 1]
        across[y, 0] = across[y, width - 1] = _ZERO  # the border reflects
        down[y, 0] = _TWO * (below[1] - above[1] + below[0] - above[0])
        last = width - 1
        down[y, last] = _TWO * (below[last - 1] - above[last - 1] + below[last] - above[last])


@fast_part
def _over_rms(values, reach, around):
    """Values become those over the root of the mean of squares around, and a little."""
    _mean(values, True, reach, around)
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            # sums of float32 that cancel may come out below 0
            values[y, x] /= np.sqrt(max(around[y, x], _ZERO)) + _EVEN


@fast_part
def _mean(values, squares, reach, out):
    """The means over squares that reach so far, of values or of their squares.

    Sums go down the image, and of these across it, eight rows at a time, of which four are in registers.
    """
    height, width = values.shape
    column, sums, total = np.zeros(width, np.float32), np.zeros((8, width), np.float32), np.empty(8, np.float32)
    share = _ONE / np.float32((2 * reach + 1) ** 2)
    for d in range(-reach, reach + 1):
        row = values[abs(d)]
        for x in range(width):
            column[x] += row[x] ** 2 if squares else row[x]
    for first in range(0, height, 8):
        many = min(8, height - first)
        for i in range(many):
            y, line = first + i, sums[i]
            enters, leaves = values[height - 1 - abs(height - 2 - y - reach)], values[abs(y - reach)]
            for x in range(width):
                line[x] = column[x] * share
                column[x] += enters[x] ** 2 - leaves[x] ** 2 if squares else enters[x] - leaves[x]
            total[i] = line[0]
            for d in range(1, reach + 1):
                total[i] += _TWO * line[d]
        for i in range(0, many, 4):
            s0, s1, s2, s3 = sums[i], sums[i + 1], sums[i + 2], sums[i + 3]
            t0, t1, t2, t3 = total[i], total[i + 1], total[i + 2], total[i + 3]
            y, last = first + i, height - 1
            row0, row1, row2, row3 = out[y], out[min(y + 1, last)], out[min(y + 2, last)], out[min(y + 3, last)]
            for x in range(width):
                row3[x], row2[x], row1[x], row0[x] = t3, t2, t1, t0  # of the last rows the first one holds
                entering, leaving = width - 1 - abs(width - 2 - x - reach), abs(x - reach)
                t0 += s0[entering] - s0[leaving]
                t1 += s1[entering] - s1[leaving]
                t2 += s2[entering] - s2[leaving]
                t3 += s3[entering] - s3[leaving]


@fast_part
def _smooth_down(values, out):
    """Sums with the weights 1 2 3 4 5 4 3 2 1, two means over 5 pixels but for a factor, and a border beside them."""
    height, width = values.shape
    last = height - 1
    for y in range(height):
        here, row = values[y], out[y]
        a1, a2, a3, a4 = values[abs(y - 1)], values[abs(y - 2)], values[abs(y - 3)], values[abs(y - 4)]
        b1, b2 = values[last - abs(last - y - 1)], values[last - abs(last - y - 2)]
        b3, b4 = values[last - abs(last - y - 3)], values[last - abs(last - y - 4)]
        for x in range(width):
            near = _FIVE * here[x] + _FOUR * (a1[x] + b1[x]) + _THREE * (a2[x] + b2[x])
            row[_REACH + x] = near + _TWO * (a3[x] + b3[x]) + a4[x] + b4[x]
        for d in range(1, _REACH + 1):
            row[_REACH - d], row[width + _REACH - 1 + d] = row[_REACH + d], row[width + _REACH - 1 - d]


@fast
def read(seen, x, offsets):
    """(K, G, C): the channels `seen` at the pixels nearest to the places x (K, 2) and `offsets` (G, 2) beside them."""
    out = np.empty((len(x), len(offsets), len(seen)), np.float32)
    _read(seen, x, offsets, 1.0, out)
    return out


@fast_part
def _read(seen, x, offsets, scale, out):
    height, width = seen.shape[1], seen.shape[2] - 2 * _REACH
    for k in range(len(x)):
        for g in range(len(offsets)):
            column = min(max(round(x[k, 0] + scale * offsets[g, 0]), 0), width - 1)
            row = min(max(round(x[k, 1] + scale * offsets[g, 1]), 0), height - 1)
            for c in range(len(seen)):
                p = seen[c, row, column : column + 9]
                near = _FIVE * p[4] + _FOUR * (p[3] + p[5]) + _THREE * (p[2] + p[6]) + _TWO * (p[1] + p[7])
                out[k, g, c] = (near + p[0] + p[8]) * _ALL


@fast("f4:3 f8:2 f8:2 f8:2 f8:2 f8:2 f8:1 f4:3")
def find_corners(seen, parts, rest, mean, first, offsets, scales, stages):
    """What `EyeRegression` finds of corners (4, 2), by nose and mouth at `parts` (5, 2)."""
    x, last = mean.copy(), len(first) - 1
    for j in range(len(x)):
        for i in range(2):
            x[j, i] += first[last, 2 * j + i]
            for k in range(last):
                x[j, i] += (parts[k // 2, k % 2] - rest[k // 2, k % 2]) * first[k, 2 * j + i]
    return _run_stages(seen, x, offsets, scales, stages)


@fast("f4:3 f8:2 f8:2 f8:1 f4:3 f8 f4:2 f4:1")
def place(seen, x, offsets, scales, stages, scale, odds, out):
    """x (K, 2) after S stages (S, 2 K, F + 1), which read at `offsets` (G, 2) times the `scales` (S,) around them.

    Their log odds `out` (K,) are by `odds` (F / K + 1, J), of what is read there at `scale`.
    """
    x, last = _run_stages(seen, x, offsets, scales, stages), len(odds) - 1
    phi = np.empty((len(x), len(offsets), len(seen)), np.float32)
    _read(seen, x, offsets, scale, phi)
    flat = phi.reshape(len(x), last)
    out[:] = odds[last, : len(x)]
    for f in range(last):
        for k in range(len(x)):
            out[k] += flat[k, f] * odds[f, k]
    return x


@fast_part
def _multiply(matrix, values, out):
    """out (J,) of a matrix (J, F + 1), the last column of which counts as it is, and values (F,)."""
    for j in range(len(out)):
        row, total = matrix[j], matrix[j, len(values)]
        for f in range(len(values)):
            total += row[f] * values[f]
        out[j] = total


@fast_part
def _run_stages(seen, x, offsets, scales, stages):
    x, move = x.copy(), np.empty(2 * len(x), np.float32)
    phi = np.empty((len(x), len(offsets), len(seen)), np.float32)
    flat = phi.ravel()
    for s in range(len(stages)):
        _read(seen, x, offsets, scales[s], phi)
        _multiply(stages[s], flat, move)
        for k in range(len(x)):
            x[k, 0] += move[2 * k]
            x[k, 1] += move[2 * k + 1]
    return x
