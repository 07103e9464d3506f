"""Tracking of images as they come: from a camera, an address of the network, or a pipe.

Two images wait at most. Each frame gives a line of JSON, as in JSON lines but with its age, as soon as it is tracked.
Of everybody in a film (`LiveCast`, ours) a line comes up to eight frames late: so many take a cut and a look of the
detector.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.face_points import DetectorName
from facetrack_cli.core.types import BOX, Box, Frame, Image
from facetrack_cli.engine.loop import TrackState
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import Tracker, frames_of
from facetrack_cli.runs.signals import never
from facetrack_cli.runs.workers import decoded_ahead
from facetrack_cli.start.presence import LOOK_FRAMES, MultiFaceTracker
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.people.descriptor import (
    UNKNOWN,
    VIEWS,
    Describer,
    FaceDescriptor,
    TrackSummary,
    cast_of,
    together,
    views_of,
)
from facetrack_cli.trajectory.people import new_name
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.trajectory.writers import json_frames
from facetrack_cli.video.decode import FORMATS, pixels, silence
from facetrack_cli.video.images import MOST_PIXELS, check_pixels
from facetrack_cli.video.shots import Shot, passing_shots
from facetrack_cli.video.source import address_of, is_live, open_source

OPEN_S, READ_S = 10.0, 10.0  # seconds without a byte, after which an address is given up
LEAST_WAIT_S, MOST_WAIT_S = 1.0, 30.0  # until an address is opened again
LEAST_VIEWS: Final = 3  # of a face before it is named
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
    cast: "LiveCast | None" = None,
) -> int:
    """Track `images` and write a line for each; the number of lines. Times are those of frames, else seconds since the
    first image came. With a `cast` everybody is tracked, and a line says who is who.

    Raises InputError for images that are none, or no start in the first of them.
    """
    came, count = dict[int, float](), 0

    def dated(coming: Iterator[tuple[float, Image | Frame]]) -> Iterator[tuple[float, Image]]:
        began = None
        for index, (now, image) in enumerate(coming):
            came[index], began = now, now if began is None else began
            own = image.time_s if isinstance(image, Frame) else math.nan
            yield now - began if math.isnan(own) else own, image.bgr if isinstance(image, Frame) else image

    try:
        timed = ((time.monotonic(), image) for image in images)  # as it comes: it waits for those before it
        with decoded_ahead(timed, most=1, stopped=stopped) as coming:
            frames = frames_of(dated(coming))
            results = Tracker(recipe, init=init)._follow(frames) if cast is None else cast.follow(frames, recipe)
            for result in results:
                at = came[result.frame.index]
                came = {index: now for index, now in came.items() if index > result.frame.index}
                nobody = f'"frame":{result.frame.index},"time_s":{result.frame.time_s:.4f},"targets":[]'
                line = [f'"age_s":{time.monotonic() - at:.4f}', next(json_frames(result.rows), nobody)]
                if cast is not None:
                    there = [target.rows.target for target in result.targets]
                    line.append(f'"people":{json.dumps({name: cast.names.get(name) for name in there})}')
                write(f"{{{','.join(line)}}}")
                count += 1
    except InputError:  # also where the images end before the target is found
        if not stopped():
            raise
    return count


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
    network, wait = "://" in address, 0.0
    # on a network alone a description of a stream may open more of it
    listed = {"format_whitelist": f"{_FORMATS},rtsp,rtp,sdp", "protocol_whitelist": _PROTOCOLS}
    options = {**listed, "rtsp_transport": "tcp"} if network else {}
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
    """The frames of a pipe, of any format that needs no seeking; MJPEG has no times. InputError as of `_decoded`."""
    # read() would wait until a whole block has come
    now = SimpleNamespace(read=stream.read1 if hasattr(stream, "read1") else stream.read)
    yield from _decoded(now, {"format_whitelist": _FORMATS}, _PIPE)


def _decoded(file: Any, options: dict[str, str], name: str) -> Iterator[Frame]:
    """The frames of a device, an address or a file that is read as it comes; nan is the time of one that has none.

    InputError for what is no video, or too large.
    """
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
                yield Frame(index, (raw.time or 0.0) - (began or 0.0) if timed else math.nan, pixels(raw))
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{name}: {reason(error)}; {_REMEDY}") from None


@dataclass
class _Followed:
    """A track that goes on; the looks of `track` are those that `reader` has, the last of the frame `looked`."""

    reader: Describer
    track: TrackSummary
    looked: int


class LiveCast:
    """Who the tracks of a film are of, of `known` people and others; `names` has those that are there and named."""

    def __init__(self, by: DetectorName | None, fps: float, known: Mapping[str, FaceDescriptor]) -> None:
        self.names: dict[str, str] = {}
        self._detector, self._fps = detector(by), fps
        self._looks = dict(known)  # of each person
        self._now: dict[str, _Followed] = {}

    def follow(self, frames: Iterator[Frame], recipe: Recipe) -> Iterator[FrameResult]:
        """A result for each frame, in which every face is a target; no track is carried over a cut."""
        at = TrackState()
        for number, passed in groupby(passing_shots(frames), key=lambda numbered: numbered[0]):
            first = next(passed)[1]
            shot = Shot(first.index, None, first.index, None)
            film = MultiFaceTracker(recipe, [shot], self._detector, first.size, recipe.seed)
            for result in film.follow(chain([first], (frame for _, frame in passed)), at):
                self._see(result, number)
                yield result

    def _see(self, result: FrameResult, shot: int) -> None:
        """Take in one frame more: where its tracks are, and now and then what they look like."""
        there = {target.rows.target for target in result.targets}
        for name in [name for name in self._now if name not in there]:  # in order: a set has another in each process
            self._end(name)
        at = result.frame.index
        for rows in (target.rows for target in result.targets):
            box = rows.find(rows.target, BOX)
            if box is None or not (views := views_of(box)):
                continue
            place = tuple(box.boxes[0].tolist())
            now = self._now.get(rows.target)
            if now is None:
                nothing = TrackSummary(rows.target, at, at + 1, place, place, shot, FaceDescriptor(*[box.x[:0]] * 6))
                now = self._now[rows.target] = _Followed(Describer(self._detector), nothing, at - LOOK_FRAMES)
            now.track = now.track._replace(stop=at + 1, ends=place)
            if at >= now.looked + LOOK_FRAMES and len(now.reader.scores) < VIEWS:
                now.looked = at
                now.reader.see(result.frame, views[0])
                if rows.target not in self.names and len(now.reader.scores) >= LEAST_VIEWS:
                    self._name(rows.target)

    def _name(self, track: str) -> None:
        """Name a track by its looks beside those of the tracks that are there; not yet, where that is in doubt."""
        there = [now for now in self._now.values() if now.reader.is_face]
        at = next((i for i, now in enumerate(there) if now.track.name == track), None)
        if at is None:
            return
        seen = [now.track._replace(looks=now.reader.looks()) for now in there]
        cast = cast_of(seen, [*self._looks.values()], self._fps)
        person = int(cast.person[at])
        doubtful = any(doubt.track == at for doubt in cast.doubts)
        if person == UNKNOWN or (doubtful and len(there[at].reader.scores) < VIEWS):
            return
        name = next(iter([*self._looks][person : person + 1]), "") or new_name(self._looks)
        if all(self.names.get(other) != name for other in self._now):  # nobody is there twice
            self.names[track] = name
            self._looks.setdefault(name, there[at].reader.looks())

    def _end(self, track: str) -> None:
        ended, name = self._now.pop(track), self.names.pop(track, None)
        if name is not None and ended.reader.is_face:
            both = together([self._looks[name], ended.reader.looks()])
            self._looks[name] = FaceDescriptor(*(array[-4 * VIEWS :] for array in both))
