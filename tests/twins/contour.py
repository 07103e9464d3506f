"""A slow, plain twin of the contour kernel, written from the formulas and from nothing of ours."""

import itertools
import math


def grey_at(image, x, y):
    """Bilinear grey value, or None beyond the centres of the border pixels."""
    height, width = len(image), len(image[0])
    if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        return None
    x0, y0 = math.floor(x), math.floor(y)
    total = 0.0
    for yy, wy in ((y0, y0 + 1 - y), (y0 + 1, y - y0)):
        for xx, wx in ((x0, x0 + 1 - x), (x0 + 1, x - x0)):
            if wx > 0 and wy > 0:
                total += wx * wy * float(image[yy][xx])
    return total


def edges(image, x, y, dx, dy, steps, threshold):
    """Where the edges along a normal are, in steps of (dx, dy) from (x, y); `steps` values are read on either side."""
    grey = {i: grey_at(image, x + i * dx, y + i * dy) for i in range(-steps, steps + 1)}
    contrast = {}  # by the place between the two values in the middle
    for i in range(-steps + 1, steps - 1):
        four = [grey[j] for j in (i - 1, i, i + 1, i + 2)]
        if None not in four:
            contrast[i + 0.5] = abs((four[3] + four[2]) / 2 - (four[1] + four[0]) / 2)
    found = []
    for place, here in contrast.items():
        before, after = contrast.get(place - 1), contrast.get(place + 1)
        if before is not None and after is not None and here > threshold and here > before and here >= after:
            found.append(place + (before - after) / (before - 2 * here + after) / 2)
    return found


def nearest_edges(image, x, origin, factor, points, normals, reach, threshold):
    """The distance of the nearest edge on each normal within `reach`, or inf: a list of lists, (N, L)."""
    steps = math.ceil(reach / factor) + 4
    out = []
    for cx, cy, s in x:
        row = []
        for (px, py), (nx, ny) in zip(points, normals, strict=True):
            at_x = (cx + px * s - origin[0] - (factor - 1) / 2) / factor
            at_y = (cy + py * s - origin[1] - (factor - 1) / 2) / factor
            found = [] if s <= 0 else edges(image, at_x, at_y, nx, ny, steps, threshold)
            distances = [abs(place) * factor for place in found]
            row.append(min([d for d in distances if d <= reach], default=math.inf))
        out.append(row)
    return out


def ellipse(w, h, count):
    """Points in the middle of `count` equal arcs of the ellipse with axes w and h, and its normals, by small steps."""
    fine = 20000
    turn = [2 * math.pi * i / fine for i in range(fine + 1)]
    corners = [(w / 2 * math.cos(t), h / 2 * math.sin(t)) for t in turn]
    arc = [0.0]
    for before, after in itertools.pairwise(corners):
        arc.append(arc[-1] + math.dist(before, after))
    points, normals = [], []
    i = 0
    for k in range(count):
        while arc[i] < (k + 0.5) / count * arc[-1]:
            i += 1
        points.append(corners[i])
        nx, ny = corners[i][0] / (w / 2) ** 2, corners[i][1] / (h / 2) ** 2  # the gradient of the ellipse's equation
        normals.append((nx / math.hypot(nx, ny), ny / math.hypot(nx, ny)))
    return points, normals
