"""The shift between two images: right for sides of which OpenCV pads to an even length, and to an odd one."""

import cv2
import numpy as np
import pytest

from facetrack_cli.trackers.hands.evidence import shift_between

ODD = [(240, 135), (135, 240), (80, 45), (45, 80), (75, 60), (60, 75), (81, 75), (25, 27)]
EVEN = [(80, 60), (160, 120), (120, 90), (128, 96), (64, 120)]


def parts(size, x, y, seed=0):
    """Two parts of one texture, the second of which sees it moved by (x, y)."""
    width, height = size
    rng = np.random.default_rng(seed)
    whole = cv2.GaussianBlur(rng.random((height + 20, width + 20), np.float32) * 255, (0, 0), 1.5)
    return whole[10 : 10 + height, 10 : 10 + width].copy(), whole[10 - y : 10 - y + height, 10 - x : 10 - x + width]


def test_these_sizes_are_of_both_kinds():
    lengths = [[cv2.getOptimalDFTSize(side) % 2 for side in size] for size in ODD]
    assert all(any(odd) for odd in lengths)
    assert not any(cv2.getOptimalDFTSize(side) % 2 for size in EVEN for side in size)


@pytest.mark.parametrize("size", [*ODD, *EVEN])
def test_equal_images_are_not_shifted_and_moved_ones_by_their_motion(size):
    same, _ = parts(size, 0, 0)
    shift, sure = shift_between(same, same.copy())
    assert shift == pytest.approx([0, 0], abs=1e-3) and sure > 0.95
    for x, y in ((2, -1), (-3, 2), (0, 4)):
        before, after = parts(size, x, y)
        kept = before.copy()
        shift, sure = shift_between(before, after)
        assert shift == pytest.approx([x, y], abs=0.1) and sure > 0.6
        assert (before == kept).all()


def test_half_a_pixel_is_half_a_pixel():
    for size in ((240, 135), (160, 120)):
        large, moved = parts((2 * size[0], 2 * size[1]), 1, 0)
        small = [cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (large, moved)]
        assert shift_between(*small)[0] == pytest.approx([0.5, 0], abs=0.3)
