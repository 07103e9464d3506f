"""The frames as the page shows them: their content and size."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.editor.web.frame import crop, jpeg
from facetrack_cli.video.seek import Frames
from tests.support import media

SIZE = (83, 46)  # divisible by none of the reductions but 2, and that only its height


def smooth(index: int) -> np.ndarray:
    """An image that JPEG keeps."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    return np.dstack([2 * x, 3 * y + 10 * index, x + y]).astype(np.uint8)


@pytest.fixture
def frames(tmp_path: Path):
    with Frames(media.write_pictures(tmp_path / "frames", [smooth(index) for index in range(4)])) as opened:
        yield opened


def decode(data: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


@pytest.mark.parametrize("reduce", [1, 2, 4, 8])
def test_a_jpeg_is_the_whole_frame_reduced_by_area_means(frames: Frames, reduce: int) -> None:
    data = jpeg(frames, 2, reduce)
    assert data.startswith(b"\xff\xd8\xff")
    image = decode(data).astype(float)
    width, height = -(-SIZE[0] // reduce), -(-SIZE[1] // reduce)
    assert image.shape == (height, width, 3)
    # a pixel of it is the mean of the part of the frame that it covers when it is stretched over it
    fine = np.repeat(np.repeat(smooth(2).astype(float), height, axis=0), width, axis=1)
    expected = fine.reshape(height, SIZE[1], width, SIZE[0], 3).mean(axis=(1, 3))
    grey = np.array([0.114, 0.587, 0.299])  # JPEG keeps less of the colours
    assert np.abs((image - expected) @ grey).max() < 4.0


def test_a_crop_is_lossless_and_clipped(frames: Frames) -> None:
    for x, y, w, h in ((10, 5, 20, 8), (-5, -6, 12, 12), (80, 40, 50, 50), (-10, -10, 500, 500), (82, 45, 1, 1)):
        data = crop(frames, 3, x, y, w, h)
        assert data.startswith(b"\x89PNG")
        expected = smooth(3)[max(y, 0) : y + h, max(x, 0) : x + w]
        np.testing.assert_array_equal(decode(data), expected)


def test_a_region_outside_and_a_frame_past_the_end_are_refused(frames: Frames) -> None:
    for region in ((83, 0, 5, 5), (0, 46, 5, 5), (-5, 0, 5, 5), (10, 10, 0, 5), (10, 10, 5, -1)):
        with pytest.raises(InputError, match="the frame has 83x46 pixels, and none of those of"):
            crop(frames, 0, *region)
    with pytest.raises(InputError, match="no frame 4"):
        jpeg(frames, 4)
