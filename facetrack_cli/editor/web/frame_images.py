"""The images that the page shows: frames as JPEG in several sizes, and regions of them as lossless PNG."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Final, Generic, TypeVar
from weakref import WeakValueDictionary

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Image
from facetrack_cli.video.seek import Cache, Frames

CACHE_BYTES: Final = 64 << 20
_QUALITY: Final = 90
_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


class OnceCache(Generic[_Key, _Value]):
    """An LRU cache that computes a value once, also if several threads request it at the same time. Thread-safe.

    `most` bounds the sum of the values' `size`. Errors are not kept.
    """

    def __init__(self, most: int, size: Callable[[_Value], int]) -> None:
        self._kept: Cache[_Key, _Value] = Cache(most)
        self._size = size
        self._locks: WeakValueDictionary[_Key, threading.Lock] = WeakValueDictionary()  # of keys in use
        self._lock = threading.Lock()

    def get(self, key: _Key, compute: Callable[[], _Value]) -> _Value:
        with self._lock:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            value = self._kept.get(key)
            if value is None:
                value = compute()
                self._kept.put(key, value, self._size(value))
            return value


class FrameImages:
    """Encoded frames of a clip, the last ones kept. Thread-safe: the same image is encoded once."""

    def __init__(self, frames: Frames):
        self._frames = frames
        self._encoded: OnceCache[tuple[int, ...], bytes] = OnceCache(CACHE_BYTES, len)

    def jpeg(self, index: int, reduce: int = 1) -> bytes:
        """A frame as JPEG, its sides divided by `reduce` and rounded up, by area means.

        It covers the whole frame whatever its sides are, so that it can be stretched over it. Raises what `Frames.read`
        raises.
        """

        def encode() -> bytes:
            image = self._frames.read(index).bgr
            if reduce > 1:
                size = -(-image.shape[1] // reduce), -(-image.shape[0] // reduce)
                image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
            return _encode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))

        return self._encoded.get((index, reduce), encode)

    def crop(self, index: int, x: int, y: int, w: int, h: int) -> bytes:
        """The pixels x .. x+w-1, y .. y+h-1 of a frame, as far as it has them, as PNG.

        Raises InputError if it has none of them, and what `Frames.read` raises.
        """
        width, height = self._frames.size
        left, top, right, bottom = max(x, 0), max(y, 0), min(x + w, width), min(y + h, height)
        if left >= right or top >= bottom:
            raise InputError(
                f"the frame has {width}x{height} pixels, and none of those of {w}x{h} from ({x}, {y}) on; choose others"
            )

        def encode() -> bytes:
            region = self._frames.read(index).bgr[top:bottom, left:right]
            return _encode(".png", region, (cv2.IMWRITE_PNG_COMPRESSION, 1))

        return self._encoded.get((index, left, top, right, bottom), encode)


def _encode(suffix: str, image: Image, options: tuple[int, int]) -> bytes:
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise RuntimeError(f"OpenCV cannot write {suffix}")
    return data.tobytes()
