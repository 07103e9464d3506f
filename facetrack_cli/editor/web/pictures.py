"""The pictures that a page shows: frames as JPEG in several sizes, and regions of them as lossless PNG."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.types import Image
from facetrack_cli.video.seek import Cache, Frames

CACHE_BYTES = 64 << 20
REDUCTIONS = (1, 2, 4, 8)
_QUALITY = 90
_Key: TypeAlias = tuple[int, ...]


class Pictures:
    """Encoded frames of a clip; what was asked for lately is kept. Thread-safe: equal requests encode only once.

    `encoded` counts the pictures that had to be encoded.
    """

    def __init__(self, frames: Frames):
        self._frames = frames
        self._recent: Cache[_Key, bytes] = Cache(CACHE_BYTES)
        self._under_way: dict[_Key, Future[bytes]] = {}
        self._lock = threading.Lock()
        self.encoded = 0

    def jpeg(self, index: int, reduce: int = 1) -> bytes:
        """A frame as JPEG, its sides divided by 1, 2, 4 or 8 and rounded up, by area means.

        It covers the whole picture whatever its sides are, so that it can be stretched over it. Raises UsageError for
        another `reduce`, and what `Frames.read` raises.
        """
        if reduce not in REDUCTIONS:
            raise UsageError(f"a picture cannot be reduced by {reduce}; give one of {', '.join(map(str, REDUCTIONS))}")

        def encode() -> bytes:
            image = self._frames.read(index).bgr
            if reduce > 1:
                size = -(-image.shape[1] // reduce), -(-image.shape[0] // reduce)
                image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
            return _encode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))

        return self._once((index, reduce), encode)

    def crop(self, index: int, x: int, y: int, w: int, h: int) -> bytes:
        """The pixels x .. x+w-1, y .. y+h-1 of a frame, as far as it has them, as PNG.

        Raises UsageError if it has none of them, and what `Frames.read` raises.
        """
        width, height = self._frames.size
        left, top, right, bottom = max(x, 0), max(y, 0), min(x + w, width), min(y + h, height)
        if left >= right or top >= bottom:
            raise UsageError(
                f"the frame has {width}x{height} pixels, and none of those of {w}x{h} from ({x}, {y}) on; choose others"
            )

        def encode() -> bytes:
            region = self._frames.read(index).bgr[top:bottom, left:right]
            return _encode(".png", region, (cv2.IMWRITE_PNG_COMPRESSION, 1))

        return self._once((index, left, top, right, bottom), encode)

    def _once(self, key: _Key, encode: Callable[[], bytes]) -> bytes:
        """What is known by a key, from the cache, from whoever is at it, or from `encode`."""
        with self._lock:
            known = self._recent.get(key)
            if known is not None:
                return known
            other = self._under_way.get(key)
            mine: Future[bytes] = Future()
            if other is None:
                self._under_way[key] = mine
        if other is not None:
            return other.result()
        try:
            data = encode()
        except BaseException as error:
            mine.set_exception(error)
            raise
        else:
            with self._lock:
                self.encoded += 1
            self._recent.put(key, data, len(data))
            mine.set_result(data)
            return data
        finally:
            with self._lock:
                del self._under_way[key]


def _encode(suffix: str, image: Image, options: tuple[int, int]) -> bytes:
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise RuntimeError(f"OpenCV cannot write {suffix}")
    return data.tobytes()
