"""Slow, plain twins of the likelihoods of a region, written from the formulas and from nothing of ours."""

import itertools
import math

from tests.twins.images import bilinear


def grey_at(image, x, y):
    """Bilinear grey value, or None beyond the centres of the border pixels."""
    height, width = image.shape
    return bilinear(image, x, y) if 0 <= x <= width - 1 and 0 <= y <= height - 1 else None


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


def bin_of(h, s, v, hue_bins, saturation_bins, value_bins, least_saturation, least_value):
    """The bin of a pixel: a pair of hue and saturation bins, or the value bin of a pixel without a hue."""
    if value_bins > 0 and (s < 255 * least_saturation or v < 255 * least_value):
        return v * value_bins // 256
    return h * hue_bins // 180, s * saturation_bins // 256


def cell(i, low, side, parts):
    """Which of `parts` equal pieces of [low, low + side) the whole number i lies in; None if in none."""
    for part in range(parts):
        if low + side * part / parts <= i < low + side * (part + 1) / parts:
            return part
    return None


def counts(pixels, box, size, cols, rows):
    """{(row, column, bin): pixels} and the pixels of the box, beyond the image too.

    pixels (H, W) hold bins; box (cx, cy, s), in pixels of this very image.
    """
    cx, cy, s = box
    w, h = s * size[0], s * size[1]
    left, top = cx - 0.5 * w, cy - 0.5 * h
    found, area = {}, 0
    for i in range(math.floor(top) - 1, math.ceil(top + h) + 2):
        for j in range(math.floor(left) - 1, math.ceil(left + w) + 2):
            r, c = cell(i, top, h, rows), cell(j, left, w, cols)
            if r is None or c is None:
                continue
            area += 1
            if 0 <= i < len(pixels) and 0 <= j < len(pixels[0]):
                key = r, c, pixels[i][j]
                found[key] = found.get(key, 0) + 1
    return found, area


def squared_distance(now, area, reference):
    """D^2 of counts {bin: pixels} in a box of `area` pixels from a reference {bin: share}."""
    if not area:
        return 1.0
    return 1.0 - sum(math.sqrt(n / area * reference.get(key, 0.0)) for key, n in now.items())


def pixel(picture, view, factor, x, y):
    """Bilinear grey value at (x, y) of the whole image, which `picture` (H, W) shows from (left, top) on, reduced.

    None beyond the whole image; between its border and the centres of the outermost blocks, the nearest of these.
    """
    left, top, width, height = view
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        return None
    shift = (factor - 1) / 2
    return bilinear(picture, (x - left - shift) / factor, (y - top - shift) / factor)


def patch(picture, view, factor, box, size, cols, rows):
    """{(row, column): grey value or None} at the centres of the cells of the box (cx, cy, s)."""
    cx, cy, s = box
    w, h = size[0] * s, size[1] * s
    return {
        (i, j): pixel(picture, view, factor, cx - w / 2 + (j + 0.5) * w / cols, cy - h / 2 + (i + 0.5) * h / rows)
        for i in range(rows)
        for j in range(cols)
    }


def distance(a, b, kind, saturation, outside):
    """d_c of eq. 13 of two patches; `outside` is rho of a point that one of them lacks."""
    both = {place for place in a if a[place] is not None and b[place] is not None}
    missing = (len(a) - len(both)) * outside
    differences = [abs(a[place] - b[place]) for place in both]
    if kind == "l2":
        return sum(d * d for d in differences) + missing
    return sum(min(d, saturation) for d in differences) + missing
