"""Tracking of images as they come: from a camera, or MJPEG or YUV4MPEG2 (y4m) on a pipe.

One image is held at a time. Each frame gives a line of JSON with its age, as soon as it is tracked.
"""

from __future__ import annotations

import json
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, BinaryIO, Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Box, Frame, Image
from facetrack_cli.recipe.face import DetectorName
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import track_frames
from facetrack_cli.runs.signals import never
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory
from facetrack_cli.video import images
from facetrack_cli.video.source import open_source

MAX_IMAGE_BYTES: Final = 64 << 20  # of one encoded image, and of one y4m frame
LOOK_S: Final = 0.1  # between two looks at the wish to stop
_CHUNK_BYTES: Final = 1 << 16
_MAX_LINE_BYTES: Final = 4096  # of a header of y4m
_PIPE: Final = "standard input"
_REMEDY: Final = "pipe MJPEG or y4m, as from ffmpeg -i ... -f mjpeg -"


def is_live(clip: Path) -> bool:
    """Whether an input is a camera, by its number, or standard input."""
    return str(clip) == "-" or (str(clip).isdecimal() and not clip.exists())


def images_of(clip: Path) -> Iterator[Image | Frame]:
    """The images of a camera, of standard input, or of a clip; frames where these say when they are shown."""
    if str(clip) == "-":
        pipe: Any = sys.stdin.buffer
        # a file of its own: at its end the interpreter would wait for a thread that reads from sys.stdin
        with open(pipe.fileno(), "rb", closefd=False) if hasattr(pipe, "raw") else nullcontext(pipe) as stream:
            yield from piped(stream)
    elif is_live(clip):
        yield from camera(int(str(clip)))
    else:
        with open_source(clip) as source:
            yield from source


def follow(
    images: Iterator[Image | Frame],
    recipe: Recipe,
    init: Path | DetectorName | Box | None,
    write: Callable[[str], None],
    stopped: Callable[[], bool] = never,
) -> int:
    """Track `images` and write a line for each; the number of lines. Times are those of frames, else seconds since the
    first image came.

    Raises InputError for images that are none, or no start in the first of them.
    """
    came: dict[int, float] = {}
    shown: dict[int, float] = {}

    def counted() -> Iterator[Image]:
        began = None
        for index, image in enumerate(awaited(images, stopped)):
            now = came[index] = time.monotonic()
            began = now if began is None else began
            shown[index] = image.time_s if isinstance(image, Frame) else now - began
            yield image.bgr if isinstance(image, Frame) else image

    count = 0
    try:
        for result in track_frames(counted(), recipe, init=init, clock=shown.pop):
            at = came[result.frame.index]
            for index in [index for index in came if index <= result.frame.index]:
                del came[index]
            line = record(result, result.frame.time_s, time.monotonic() - at)
            write(json.dumps(line, allow_nan=False))
            count += 1
    except InputError:  # also where the images end before the target is found
        if not stopped():
            raise
    return count


def awaited(images: Iterator[Image | Frame], stopped: Callable[[], bool]) -> Iterator[Image | Frame]:
    """The images until `stopped`; a thread reads each once it is asked for, as a read that waits cannot be ended."""
    asked, came = SimpleQueue[bool](), SimpleQueue[Any]()

    def read() -> None:
        while asked.get():
            try:
                came.put(next(images, None))
            except Exception as e:
                came.put(e)

    threading.Thread(target=read, name="images", daemon=True).start()
    asked.put(True)
    try:
        while not stopped():
            with suppress(Empty):
                found = came.get(timeout=LOOK_S)
                if isinstance(found, Exception):
                    raise found
                if found is None:
                    break
                yield found
                asked.put(True)
    finally:
        asked.put(False)


def record(result: FrameResult, time_s: float, age_s: float) -> dict[str, Any]:
    """A frame as JSON: what is not finite is null."""
    targets = [{"target": one.rows.target, "parts": list(_parts(one.rows))} for one in result.targets]
    return {"frame": result.frame.index, "time_s": round(time_s, 4), "age_s": round(age_s, 4), "targets": targets}


def _parts(rows: Trajectory) -> Iterator[dict[str, Any]]:
    for i, which in enumerate(rows.which.tolist()):
        values = {name: float(getattr(rows, name)[i]) for name in ("x", "y", "w", "h", "confidence")}
        finite = {name: round(value, 4) if abs(value) < float("inf") else None for name, value in values.items()}
        yield {"part": rows.names[which][1], **finite, "status": str(rows.status[i])}


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


def piped(stream: BinaryIO) -> Iterator[Image | Frame]:
    """The images of a pipe, (H, W, 3) uint8 BGR, or its frames, of y4m that tells its rate.

    InputError for what is neither MJPEG nor y4m, or too large.
    """
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
            data = bytes(held[: end + 2])
            size, image = images.header_size(data), None
            if size is not None:
                images.check_pixels(Path(f"{_PIPE}: image {count}"), *size)
                image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                raise InputError(f"{_PIPE}: image {count} is damaged, or very large; {_REMEDY}")
            yield np.asarray(image, np.uint8)
            count += 1
            del held[: end + 2]
            searched = 0
            continue
        searched = max(len(held) - 1, 0)
        if len(held) > MAX_IMAGE_BYTES:
            raise InputError(f"{_PIPE}: image {count} has no end in {MAX_IMAGE_BYTES >> 20} MB; {_REMEDY}")
        more = stream.read1(_CHUNK_BYTES) if hasattr(stream, "read1") else stream.read(_CHUNK_BYTES)
        if not more:
            return
        held += more


def _y4m(stream: BinaryIO) -> Iterator[Image | Frame]:
    header = stream.readline(_MAX_LINE_BYTES).decode("ascii", "replace")
    known = dict(re.findall(r" ([A-Z])(\S+)", header))
    try:
        width, height = int(known["W"]), int(known["H"])
    except (KeyError, ValueError):
        raise InputError(f"{_PIPE}: is a y4m without a size; {_REMEDY}") from None
    colours = known.get("C", "420")
    if not re.fullmatch(r"420(jpeg|mpeg2|paldv)?", colours):
        raise InputError(f"{_PIPE}: is y4m of colours {colours}, and 420 is read; add -pix_fmt yuv420p")
    size = width * height + 2 * ((width + 1) // 2) * ((height + 1) // 2)
    if min(width, height) < 1 or size > MAX_IMAGE_BYTES or width % 2 or height % 2:
        raise InputError(
            f"{_PIPE}: is y4m of {width}x{height}; sides must be even, and a frame at most {MAX_IMAGE_BYTES >> 20} MB"
        )
    rate, index = re.fullmatch(r"([1-9][0-9]*):([1-9][0-9]*)", known.get("F", "")), 0
    while line := stream.readline(_MAX_LINE_BYTES):
        data = stream.read(size)
        if not line.startswith(b"FRAME") or len(data) < size:
            raise InputError(f"{_PIPE}: a frame of y4m is damaged or cut short; {_REMEDY}")
        planes = np.frombuffer(data, np.uint8).reshape(height * 3 // 2, width)
        image = np.asarray(cv2.cvtColor(planes, cv2.COLOR_YUV2BGR_I420), np.uint8)
        yield image if rate is None else Frame(index, index * int(rate[2]) / int(rate[1]), image)
        index += 1
