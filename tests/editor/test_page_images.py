"""The frames as the page shows them: their content and size, and that none is encoded twice."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.editor.web import frame as frame_images
from facetrack_cli.editor.web.frame import FrameImages
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
    data = FrameImages(frames).jpeg(2, reduce)
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
    shown = FrameImages(frames)
    for x, y, w, h in ((10, 5, 20, 8), (-5, -6, 12, 12), (80, 40, 50, 50), (-10, -10, 500, 500), (82, 45, 1, 1)):
        data = shown.crop(3, x, y, w, h)
        assert data.startswith(b"\x89PNG")
        expected = smooth(3)[max(y, 0) : y + h, max(x, 0) : x + w]
        np.testing.assert_array_equal(decode(data), expected)


def test_refusals(frames: Frames) -> None:
    shown = FrameImages(frames)
    for region in ((83, 0, 5, 5), (0, 46, 5, 5), (-5, 0, 5, 5), (10, 10, 0, 5), (10, 10, 5, -1)):
        with pytest.raises(InputError, match="the frame has 83x46 pixels, and none of those of"):
            shown.crop(0, *region)
    for _ in range(2):
        with pytest.raises(InputError, match="no frame 4"):
            shown.jpeg(4)


def test_the_last_images_are_kept_by_their_bytes(frames: Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    one = len(FrameImages(frames).jpeg(0))
    encode, encoded = frame_images._encode, []

    def counted(*arguments: object) -> bytes:
        encoded.append(1)
        return encode(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(frame_images, "_encode", counted)
    monkeypatch.setattr(frame_images, "CACHE_BYTES", int(2.5 * one))
    shown = FrameImages(frames)
    first = shown.jpeg(0)
    assert shown.jpeg(0) is first and len(encoded) == 1
    for index in (1, 2, 3):
        shown.jpeg(index)
        assert shown._encoded._kept.bytes <= 2.5 * one
    assert len(encoded) == 4
    assert shown.jpeg(0) == first and len(encoded) == 5
    assert shown.crop(0, 0, 0, 5, 5) == shown.crop(0, -3, -3, 8, 8) and len(encoded) == 6  # the same region


def test_the_same_image_is_encoded_once_for_all_threads(frames: Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = FrameImages(frames)
    encode, going, go_on, encoded = frame_images._encode, threading.Event(), threading.Event(), []

    def slow(*arguments: object) -> bytes:
        encoded.append(1)
        going.set()
        go_on.wait()
        return encode(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(frame_images, "_encode", slow)
    got: list[bytes] = []
    threads = [threading.Thread(target=lambda: got.append(shown.jpeg(1, 2))) for _ in range(5)]
    threads[0].start()
    going.wait()
    for thread in threads[1:]:
        thread.start()
    assert not got
    go_on.set()
    for thread in threads:
        thread.join()
    assert len(got) == 5 and len(set(map(id, got))) == 1 and len(encoded) == 1
    assert not shown._encoded._locks, "no lock is kept"


def test_another_image_does_not_wait(frames: Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = FrameImages(frames)
    read, going, go_on = frames.read, threading.Event(), threading.Event()

    def slow(index: int) -> object:
        if index == 1:
            going.set()
            assert go_on.wait(60)
        return read(index)

    monkeypatch.setattr(frames, "read", slow)
    thread = threading.Thread(target=shown.jpeg, args=(1,))
    thread.start()
    going.wait()
    assert shown.jpeg(2).startswith(b"\xff\xd8\xff")
    go_on.set()
    thread.join()


def test_a_failure_is_not_kept(frames: Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = FrameImages(frames)
    read, going, go_on = frames.read, threading.Event(), threading.Event()

    def fail(index: int) -> object:
        going.set()
        go_on.wait()
        raise InputError("broken; repair it")

    monkeypatch.setattr(frames, "read", fail)
    errors: list[str] = []

    def work() -> None:
        try:
            shown.jpeg(1)
        except InputError as error:
            errors.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(3)]
    threads[0].start()
    going.wait()
    for thread in threads[1:]:
        thread.start()
    go_on.set()
    for thread in threads:
        thread.join()
    assert errors == ["broken; repair it"] * 3
    monkeypatch.setattr(frames, "read", read)
    assert decode(shown.jpeg(1)).shape == (46, 83, 3)
