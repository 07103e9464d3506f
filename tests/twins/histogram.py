"""Slow, plain twins of kernels/histogram.py and its likelihood, written from the formulas and from nothing of ours."""

import math


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
