"""Tracking of images as they come: from a camera, an address of the network, or a pipe.

One image is held at a time. Each frame gives a line of JSON with its age, as soon as it is tracked. Of everybody in a
film a line comes up to eight frames late: so many take a cut and a look of the detector.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from itertools import chain, groupby
from pathlib import Path
from queue import Empty, SimpleQueue
from types import SimpleNamespace
from typing import Any, BinaryIO, Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.face_points import DETECTORS, DetectorName
from facetrack_cli.core.types import Box, Frame, Image
from facetrack_cli.engine.loop import TrackState
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import Tracker, frames_of_images
from facetrack_cli.runs.signals import never
from facetrack_cli.start.presence import MultiFaceTracker
from facetrack_cli.start.search import Faces
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.video.decode import FORMATS, pixels, silence
from facetrack_cli.video.images import MOST_PIXELS, check_pixels
from facetrack_cli.video.shots import Shot, passing_shots
from facetrack_cli.video.source import address_of, is_live, open_source

LOOK_S: Final = 0.1  # between two looks at the wish to stop
OPEN_S, READ_S = 10.0, 10.0  # seconds without a byte, after which an address is given up
LEAST_WAIT_S, MOST_WAIT_S = 1.0, 30.0  # until an address is opened again
FPS: Final = 25.0  # where images do not say theirs
_PIPE: Final = "standard input"
_FORMATS: Final = f"{FORMATS},jpeg_pipe"
_PROTOCOLS: Final = "rtsp,rtsps,rtp,udp,tcp,tls,srt,http,https,crypto"
_REMEDY: Final = "check the name, and whether ffplay shows it; a pipe takes what ffmpeg reads, as -f yuv4mpegpipe"


def images_of(clip: Path, say: Callable[[str], None]) -> Iterator[Image | Frame]:
    """The images of a camera, an address, standard input, or a clip; frames where these say when they are shown."""
    if str(clip) == "-":
        pipe: Any = sys.stdin.buffer
        # a file of its own: at its end the interpreter would wait for a thread that reads from sys.stdin
        with open(pipe.fileno(), "rb", closefd=False) if hasattr(pipe, "raw") else nullcontext(pipe) as stream:
            yield from piped(stream)
    elif str(clip).isdecimal():
        yield from camera(int(str(clip)))
    elif is_live(clip) or address_of(clip):
        yield from received(address_of(clip) or str(clip), say)
    else:
        with open_source(clip) as source:
            yield from source


def follow(
    images: Iterator[Image | Frame],
    recipe: Recipe,
    init: Path | DetectorName | Box | None,
    write: Callable[[str], None],
    stopped: Callable[[], bool] = never,
    *,
    faces: Faces = "one",
) -> int:
    """Track `images` and write a line for each; the number of lines. Times are those of frames, else seconds since the
    first image came. Of all `faces` each is a target.

    Raises InputError for images that are none, or no start in the first of them.
    """
    came: dict[int, float] = {}
    shown: dict[int, float] = {}

    def counted() -> Iterator[Image]:
        began = None
        for index, image in enumerate(awaited(images, stopped)):
            now = came[index] = time.monotonic()
            began = now if began is None else began
            own = image.time_s if isinstance(image, Frame) else math.nan
            shown[index] = now - began if math.isnan(own) else own
            yield image.bgr if isinstance(image, Frame) else image

    count = 0
    try:
        frames = frames_of_images(counted(), shown.pop)
        if faces == "all":
            results = everybody(frames, recipe, next((name for name in DETECTORS if name == init), None))
        else:
            results = Tracker(recipe, init=init)._follow(frames)
        for result in results:
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
    targets = []
    for rows in (target.rows for target in result.targets):
        parts: list[dict[str, Any]] = []
        for i, which in enumerate(rows.which.tolist()):
            values = {name: float(getattr(rows, name)[i]) for name in ("x", "y", "w", "h", "confidence")}
            finite = {name: round(value, 4) if math.isfinite(value) else None for name, value in values.items()}
            parts.append({"part": rows.names[which][1], **finite, "status": str(rows.status[i])})
        targets.append({"target": rows.target, "parts": parts})
    return {"frame": result.frame.index, "time_s": round(time_s, 4), "age_s": round(age_s, 4), "targets": targets}


def camera(number: int) -> Iterator[Image]:
    """The images of a camera, until it is taken away. InputError where there is none."""
    said = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # what is wrong is one line, ours
    try:
        capture = cv2.VideoCapture(number)
    finally:
        cv2.utils.logging.setLogLevel(said)
    try:
        got, image = capture.read() if capture.isOpened() else (False, None)
        if not got or image is None:
            raise InputError(f"{number}: there is no camera of this number, or another program has it")
        while got and image is not None:
            yield np.asarray(image, np.uint8)
            got, image = capture.read()
    finally:
        capture.release()


def received(address: str, say: Callable[[str], None]) -> Iterator[Image]:
    """The images of a device, or of an address of the network, which is opened again when it ends.

    Each time it is said. InputError for what gives no image at first.
    """
    network = "://" in address
    options = {}
    if network:  # there alone a description of a stream may open more of it
        options = {
            "format_whitelist": f"{_FORMATS},rtsp,rtp,sdp",
            "protocol_whitelist": _PROTOCOLS,
            "rtsp_transport": "tcp",
        }
    wait = 0.0
    while True:
        try:
            for frame in _decoded(address, options, address):
                wait = LEAST_WAIT_S
                yield frame.bgr
            why = "it has ended"
        except InputError as e:
            if not wait:
                raise
            why = str(e).removeprefix(f"{address}: ")
        if not network or not wait:
            return
        say(f"{address}: {why}; it is opened again in {wait:g} s")
        time.sleep(wait)
        wait = min(2 * wait, MOST_WAIT_S)


def piped(stream: BinaryIO) -> Iterator[Frame]:
    """The frames of a pipe in any format of video that needs no seeking; MJPEG has no times.

    InputError for what is no video, or too large.
    """
    # read() would wait until a whole block has come
    now = SimpleNamespace(read=stream.read1 if hasattr(stream, "read1") else stream.read)
    yield from _decoded(now, {"format_whitelist": _FORMATS}, _PIPE)


def _decoded(file: Any, options: dict[str, str], name: str) -> Iterator[Frame]:
    """The frames of a device, an address or a file that is read as it comes; the time of one that has none is nan."""
    import av

    silence()
    device = "v4l2" if isinstance(file, str) and file.startswith("/dev/") else None
    options = options if device else {**options, "probesize": "1000000"}
    try:
        with av.open(file, "r", format=device, options=options, timeout=(OPEN_S, READ_S)) as container:
            if not container.streams.video:
                raise InputError(f"{name}: has no video; {_REMEDY}")
            video = container.streams.video[0]
            timed, began = container.format.name not in ("mjpeg", "jpeg_pipe"), None
            video.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
            check_pixels(Path(name), video.codec_context.width, video.codec_context.height)
            for index, raw in enumerate(container.decode(video)):
                began = raw.time if began is None else began
                time_s = (raw.time or 0.0) - (began or 0.0)
                yield Frame(index, time_s if timed else math.nan, pixels(raw))
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{name}: {reason(error)}; {_REMEDY}") from None


def everybody(frames: Iterator[Frame], recipe: Recipe, by: DetectorName | None) -> Iterator[FrameResult]:
    """A result for each frame, in which every face is a target; no track is carried over a cut."""
    at, look = TrackState(), detector(by)
    for _, passed in groupby(passing_shots(frames), key=lambda numbered: numbered[0]):
        shown = (frame for _, frame in passed)
        first = next(shown)
        shot = Shot(first.index, None, first.index, None)
        film = MultiFaceTracker(recipe, [shot], look, first.size, FPS, recipe.seed)
        yield from film.follow(chain([first], shown), at)
