"""Images as they come: from a camera, or MJPEG or YUV4MPEG2 (y4m) on a pipe. One is held at a time."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO, Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Image

MOST: Final = 64 << 20  # bytes of one encoded image, and of one y4m frame
_CHUNK: Final = 1 << 16
_LINE: Final = 4096  # bytes of a header of y4m
_PIPE: Final = "standard input"
_REMEDY: Final = "pipe MJPEG or y4m, as from ffmpeg -i ... -f mjpeg -"


def camera(number: int) -> Iterator[Image]:
    """The images of a camera, until it is taken away. InputError where there is none."""
    capture = cv2.VideoCapture(number)
    try:
        got, image = capture.read() if capture.isOpened() else (False, None)
        if not got or image is None:
            raise InputError(f"{number}: there is no camera of this number, or another program has it")
        while got and image is not None:
            yield np.asarray(image, np.uint8)
            got, image = capture.read()
    finally:
        capture.release()


def piped(stream: BinaryIO) -> Iterator[Image]:
    """The images of a pipe, as (H, W, 3) uint8 BGR. InputError for what is neither MJPEG nor y4m, or too large."""
    head = stream.read(9)
    if head == b"YUV4MPEG2":
        yield from _y4m(stream)
    elif head[:2] == b"\xff\xd8":
        yield from _mjpeg(stream, head)
    else:
        what = "is empty" if not head else "is neither MJPEG nor y4m"
        raise InputError(f"{_PIPE}: {what}; {_REMEDY}")


def _mjpeg(stream: BinaryIO, data: bytes) -> Iterator[Image]:
    """Each JPEG ends at the first end-of-image mark: inside of its data, 0xFF is followed by 0 or a restart mark."""
    held, searched, count = bytearray(data), 2, 0
    while True:
        end = held.find(b"\xff\xd9", searched)
        if end >= 0:
            image = cv2.imdecode(np.frombuffer(bytes(held[: end + 2]), np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                raise InputError(f"{_PIPE}: image {count} is damaged; {_REMEDY}")
            yield np.asarray(image, np.uint8)
            count += 1
            del held[: end + 2]
            searched = 0
            continue
        searched = max(len(held) - 1, 0)
        if len(held) > MOST:
            raise InputError(f"{_PIPE}: image {count} has no end in {MOST >> 20} MB; {_REMEDY}")
        more = stream.read1(_CHUNK) if hasattr(stream, "read1") else stream.read(_CHUNK)
        if not more:
            return
        held += more


def _y4m(stream: BinaryIO) -> Iterator[Image]:
    header = stream.readline(_LINE).decode("ascii", "replace")
    known = dict(re.findall(r" ([A-Z])(\S+)", header))
    try:
        width, height = int(known["W"]), int(known["H"])
    except (KeyError, ValueError):
        raise InputError(f"{_PIPE}: is a y4m without a size; {_REMEDY}") from None
    colours = known.get("C", "420")
    if not re.fullmatch(r"420(jpeg|mpeg2|paldv)?", colours):
        raise InputError(f"{_PIPE}: is y4m of colours {colours}, and 420 is read; add -pix_fmt yuv420p")
    size = width * height + 2 * ((width + 1) // 2) * ((height + 1) // 2)
    if not 0 < size <= MOST or width % 2 or height % 2:
        raise InputError(
            f"{_PIPE}: is y4m of {width}x{height}; sides must be even, and a frame at most {MOST >> 20} MB"
        )
    while line := stream.readline(_LINE):
        data = stream.read(size)
        if not line.startswith(b"FRAME") or len(data) < size:
            raise InputError(f"{_PIPE}: a frame of y4m is damaged or cut short; {_REMEDY}")
        planes = np.frombuffer(data, np.uint8).reshape(height * 3 // 2, width)
        yield np.asarray(cv2.cvtColor(planes, cv2.COLOR_YUV2BGR_I420), np.uint8)
