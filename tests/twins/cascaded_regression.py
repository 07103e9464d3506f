"""Slow, plain twins of the channels of trackers/face/cascaded_regression.py, and how they are read. Nothing of ours."""

import math


def mirrored(i, n):
    """The index in 0..n-1 that stands for i beyond the border: the border's pixel is not repeated."""
    while not 0 <= i < n:
        i = -i if i < 0 else 2 * (n - 1) - i
    return i


def table(height, width, value):
    return [[value(i, j) for j in range(width)] for i in range(height)]


def around(values, side, weight=lambda di, dj: 1.0):
    """Of each place the weighted sum over a square of `side` around it."""
    height, width, r = len(values), len(values[0]), side // 2
    return table(height, width, lambda i, j: sum(
        weight(di, dj) * values[mirrored(i + di, height)][mirrored(j + dj, width)]
        for di in range(-r, r + 1) for dj in range(-r, r + 1)
    ))  # fmt: skip


def mapped(f, *tables):
    return table(len(tables[0]), len(tables[0][0]), lambda i, j: f(*(one[i][j] for one in tables)))


def mean(values, side):
    return mapped(lambda s: s / side**2, around(values, side))


def rms(values, side):
    return mapped(math.sqrt, mean(mapped(lambda v: v * v, values), side))


def across(values):
    return around(values, 3, lambda di, dj: dj * (2 if di == 0 else 1))


def down(values):
    return around(values, 3, lambda di, dj: di * (2 if dj == 0 else 1))


def relative(values, side=47):
    off = mapped(lambda v, m: v - m, values, mean(values, side))
    return mapped(lambda v, s: v / (s + 0.05), off, rms(off, side))


def edges(grey, usually, directions):
    dx, dy = across(grey), down(grey)
    size = mapped(math.hypot, dx, dy)
    usual = usually(size)
    found = []
    for k in range(directions):
        turn = 2 * math.pi * k / directions

        def edge(dx, dy, size, usual, turn=turn):
            """The gradient along a direction, times the cosine of its angle to it; none the other way."""
            along = max(dx * math.cos(turn) + dy * math.sin(turn), 0.0)
            return along**2 / (size * (usual + 0.02) + 1e-6)

        found.append(mapped(edge, dx, dy, size, usual))
    return found


def channels(image, directions=8):
    """11 tables of an image (H, W, 3) of whole numbers, blue first: edges in 8 directions, redness, grey, slope."""
    height, width = len(image), len(image[0])
    b, g, r = (mapped(round, mean(table(height, width, lambda i, j, c=c: float(image[i][j][c])), 3)) for c in range(3))
    grey = mapped(lambda b, g, r: math.log(0.114 * b + 0.587 * g + 0.299 * r + 16), b, g, r)
    red = mapped(lambda g, r: math.log((r + 8) / (g + 8)), g, r)
    found = edges(grey, lambda size: rms(size, 27), directions)
    slope = down(red)
    found += [relative(red), relative(grey), mapped(lambda v, s: v / (s + 0.05), slope, rms(slope, 27))]
    return [mean(mean(one, 5), 5) for one in found]


def patch_channels(levels, directions=8):
    """9 tables of grey levels (H, W): edges in 8 directions, and grey, relative to the whole."""
    count = len(levels) * len(levels[0])
    grey = mapped(lambda s: math.log(math.floor(8 * s / 9 + 0.5) / 8 + 16), around(levels, 3))

    def usual(values):
        whole = math.sqrt(sum(v * v for row in values for v in row) / count)
        return mapped(lambda _: whole, values)

    found, mid = edges(grey, usual, directions), sum(map(sum, grey)) / count
    off = mapped(lambda v: v - mid, grey)
    return [mean(mean(one, 5), 5) for one in (*found, mapped(lambda v, s: v / (s + 0.05), off, usual(off)))]


def read(tables, x, scale, grid=5, step=5.0):
    """phi: of each part of x (K, 2) the channels at a grid around it, row by row, and at the end a 1."""
    height, width, phi = len(tables[0]), len(tables[0][0]), []
    for u, v in x:
        for i in range(grid):
            for j in range(grid):
                column = round(u + scale * step * (j - (grid - 1) / 2))
                row = round(v + scale * step * (i - (grid - 1) / 2))
                at = min(max(row, 0), height - 1), min(max(column, 0), width - 1)
                phi += [one[at[0]][at[1]] for one in tables]
    return [*phi, 1.0]
