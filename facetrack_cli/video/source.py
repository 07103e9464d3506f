"""Where frames come from: a video file, or the images of a folder, as an iterable of `Frame`.

Frames are counted from 0 of the file, also when reading starts later; `time_s` counts from the file's first frame, by
the file's own clock, and grows from frame to frame. The number of frames that a container claims is only a hint.

A clip that ends early gives all the frames before the damage; then `complete` is False and `warnings` says what is
missing. So it is if the decoder reports errors (`decoder_log.py`): it conceals them and goes on, so all frames are
there, but some are not what the clip showed. A video with fewer frames than the container claims (or any MPEG program
stream, which claims nothing) is read again without decoding, and is incomplete if the demuxer reports missing data, if
packets follow where the decoder stopped, or if they end clearly before the claimed duration. In Ogg and WMV, which do
not say that more should follow, a cut between two packets is not noticed.
"""

import math
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, cast
from weakref import WeakSet

# OpenCV and its ffmpeg read these when they are loaded; their messages would mix with ours on stderr
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# OpenCV gives up after so many packets that are not of the video, and where sound outlasts it loses the last frames
os.environ.setdefault("OPENCV_FFMPEG_READ_ATTEMPTS", "1000000000")

import cv2

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import Array, Frame, Image
from facetrack_cli.video import decoder_log, ffmpeg, images
from facetrack_cli.video.archive import Archive, is_archive
from facetrack_cli.video.checksums import broken_clusters
from facetrack_cli.video.kinds import is_image
from facetrack_cli.video.playlists import check_local
from facetrack_cli.video.refused import AGAIN, check_file, why_not

if os.environ["OPENCV_LOG_LEVEL"] == "SILENT":  # where OpenCV was loaded before
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

FOLDER_FPS = Fraction(25)
_ANEW = "convert the clip, or track it in one piece"
_PLACES = 6  # of errors that are named
_MOST_NAMED = 1000  # errors that are kept
_THREADS = 8  # of the decoder at most: each holds frames
_TEXT = "ansi"  # ffmpeg draws the text of .txt files
_AGAIN_BY = {"VP80": "libvpx", "VP90": "libvpx-vp9"}  # decoders that notice what FFmpeg's own do not
_JITTER_S = 0.0015  # containers that keep whole milliseconds move a frame by less than this


class Source(AbstractContextManager["Source"], ABC):
    """Frames of one clip, iterable once; `size` (width, height) has rotation applied, `fps` is the nominal rate."""

    def __init__(self, path: Path, size: tuple[int, int], fps: Fraction, start: int, stop: int | None):
        self.path, self.size, self.fps = path, size, fps
        self.is_video = False
        self.frames_hint: int | None = None  # the likely number of frames to come
        # filled while iterating
        self.variable: bool | None = None  # whether the times of frames differ from `fps`, once it is known
        self.warnings: list[str] = []  # one line each
        self.complete = True  # False once it is known that frames are missing or wrong
        self.strict = False  # whether a video that seems whole is decoded once more, by the strictest decoder
        self._start, self._stop = start, stop
        self._begun = self._closed = False

    def __iter__(self) -> Iterator[Frame]:
        """The frames. Raises InputError when the clip ends before the first, RuntimeError when iterated before."""
        if self._begun:
            raise RuntimeError("a source is read only once; open it again")
        self._begun = True
        return self._frames()

    @abstractmethod
    def _frames(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """End the iteration, also from another thread, and free the file; once closed, closing again does nothing."""
        self._closed = True

    def __exit__(self, *_: object) -> None:
        self.close()

    def _cut(self, message: str) -> None:
        self.complete = False
        self.warnings.append(message)

    def _past_end(self, frames: int) -> InputError:
        there = f"the clip has {frames} frames (0 to {frames - 1})"
        return InputError(f"{self.path}: frame {self._start} is past the end, {there}; start earlier")


class Capture:
    """A video file opened by OpenCV, which decodes one frame after the other. Not thread-safe.

    `next` is the number of the frame that `grab` goes to. `position` is the time of the frame grabbed last as OpenCV
    gives it, `time` counts from the first frame; both in s. `claimed` is the number of frames that the container
    claims. After a seek to a keyframe, the frames before the number `key` may be damaged. `damage` holds errors that
    the decoder reported, each with the frame before which it did so; it decodes a few frames ahead. They may be those
    of another capture unless this one was `alone`.
    """

    alone: bool
    _open: ClassVar[WeakSet["Capture"]] = WeakSet()
    _opening: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, path: Path):
        with self._opening:
            others = list(self._open)
            for other in others:
                other.alone = False
            self._open.add(self)
        threads = min(cv2.getNumberOfCPUs(), _THREADS)
        self._opencv = cv2.VideoCapture(ffmpeg.source_argument(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
        self.alone = decoder_log.start() and not others
        self.damage: list[tuple[int, str]] = []
        self._noted = decoder_log.noted()  # what is said of the streams while they are opened comes again
        self.next = self.key = 0
        self.time = self.position = self.origin = 0.0
        self.rate = self._opencv.get(cv2.CAP_PROP_FPS)
        self.fps = _fraction(self.rate)
        self.period = float(1 / self.fps)
        count = self._opencv.get(cv2.CAP_PROP_FRAME_COUNT)
        self.claimed = int(count) if math.isfinite(count) and 1 <= count < 1e9 else None
        self.codec = int(self._opencv.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode("latin-1")

    def grab(self) -> bool:
        """Decode the next frame; False at the end."""
        grabbed = self._opencv.grab()
        noted = decoder_log.noted()
        if noted != self._noted:
            said = decoder_log.complaints(self._noted, self.next)
            self.damage += [(self.next, text) for text in said[: max(_MOST_NAMED - len(self.damage), 0)]]
            self._noted = noted
        if not grabbed:
            return False
        self.position = self._opencv.get(cv2.CAP_PROP_POS_MSEC) / 1000
        if self.next == 0:
            self.origin = self.position
        else:
            self.time = following(self.time, self.position - self.origin, self.period)
        self.next += 1
        return True

    def image(self) -> Image | None:
        """The frame grabbed last as (H, W, 3) BGR, rotation applied; None if it cannot be decoded."""
        return cast("Image | None", self._opencv.retrieve()[1])

    def seek(self, frame: int) -> bool:
        """Grab the frame at which OpenCV arrives when told to go to that number, which may be a different one."""
        self._opencv.set(cv2.CAP_PROP_POS_FRAMES, frame)
        grabbed = self._opencv.grab()
        self.position = self._opencv.get(cv2.CAP_PROP_POS_MSEC) / 1000
        return grabbed

    def release(self) -> None:
        with self._opening:
            self._open.discard(self)
        self._opencv.release()


def _fraction(rate: float) -> Fraction:
    """A frame rate as a fraction; below one in 1001 s, as those of time lapses are, by the time between two frames."""
    if not 0 < rate <= 1000:
        return FOLDER_FPS
    return Fraction(rate).limit_denominator(1001) if rate > 1 / 1001 else 1 / Fraction(1 / rate).limit_denominator(1001)


def following(time: float, elapsed: float, period: float) -> float:
    """The time in s of the frame that follows one at `time`, and is `elapsed` after the first by its own stamp."""
    step = elapsed - time  # the last frames of some AVI and MPEG files have no stamp, or one that is not later
    return time + (step if step > 0 else period)


class VideoSource(Source):
    """A video file, decoded by OpenCV."""

    def __init__(self, path: Path, start: int, stop: int | None):
        capture = Capture(path)
        image = capture.image() if capture.grab() else None
        # the cover image of a music file is a video of 90,000 frames a second for OpenCV
        if image is None or capture.codec == _TEXT or (capture.rate > 1000 and not ffmpeg.contents(path)[0]):
            capture.release()
            raise why_not(path)
        super().__init__(path, (image.shape[1], image.shape[0]), capture.fps, start, stop)
        self.is_video = True
        if capture.claimed is not None:
            self.frames_hint = max(min(capture.claimed, stop or capture.claimed) - start, 0)
        self._capture = capture
        self._length = _length(path)
        self._lock = threading.Lock()
        # brings a capture to the first frame that is wanted, without those before; and the position that each must have
        self.sought: tuple[Callable[[Capture, int], Capture | None], Array] | None = None

    def close(self) -> None:
        with self._lock:  # the capture must not be released while it is at work
            self._closed = True
            self._capture.release()

    def _frames(self) -> Iterator[Frame]:
        start, stop = self._start, self._stop
        shape, first, time = (self.size[1], self.size[0], 3), 0, 0.0
        with self._lock:
            if self.sought is not None and start > 0 and not self._closed:
                at = self.sought[0](self._capture, start)
                self._capture, first = at or Capture(self.path), start if at else 0
                if at is None:
                    self._capture.grab()
        index, capture = first, self._capture
        while stop is None or index < stop:
            image = None  # free the last one before the next is decoded
            with self._lock:
                if self._closed:
                    return
                if index > first and not capture.grab():
                    break
                image = capture.image() if index >= start else None
            known = self.sought[1] if first and self.sought else None
            if known is not None and (index >= len(known) or known[index] != capture.position):
                raise InputError(f"{self.path}: frame {index} is not there at the time that its packet says; {_ANEW}")
            step, time = capture.time - time, capture.time
            if index > first and abs(step - capture.period) > _JITTER_S:
                self.variable = True
            if index >= start:
                if image is None or image.shape != shape:
                    what = "cannot be decoded" if image is None else f"is {image.shape[1]}x{image.shape[0]}"
                    what = f"{self.path}: frame {index} {what}, those before are {shape[1]}x{shape[0]}"
                    self._cut(f"{what}; stopped after {index} frames, convert the clip to one size")
                    return
                yield Frame(index, time, image)
            index += 1
        else:  # `stop` was reached, the rest of the file does not matter
            self._judge_frames(stop)
            return
        if index <= start:
            raise self._past_end(index)
        self.variable = bool(self.variable)
        self._judge(index, time)

    def _judge(self, frames: int, last_s: float) -> None:
        """Say so if frames are missing after the last one that was decoded, or are not what the clip showed."""
        # one that was removed is read to its end
        if self.path.exists() and _length(self.path) != self._length:
            self._cut(f"{self.path}: changed while it was read, after {frames} frames; run it again")
        elif cut := self._missing(frames, last_s, self._capture.period):
            self._cut(f"{self.path}: cut short or damaged{cut}{self._errors(None, '; ')}; {AGAIN} for the rest")
        else:
            self._judge_frames(None)

    def _judge_frames(self, until: int | None) -> None:
        """Say so if frames are not what the clip showed; `until`: up to which it was read, if not to its end."""
        if wrong := self._errors(until):
            self._cut(f"{self.path}: damaged: {wrong}, frames may be wrong; {AGAIN}")

    def _errors(self, until: int | None, before: str = "") -> str:
        """The errors that a decoder reports, after `before`; "" if there are none."""
        capture = self._capture
        at, said = sorted({frame for frame, _ in capture.damage}), [text for _, text in capture.damage]
        if not capture.alone:  # whose errors these are is not known
            at, said = [], decoder_log.decoded_again(self.path, frames=until)
        if not said and until is None and not before:
            if broken := self._broken_clusters():
                return f"{broken} parts of the file differ from their checksums"
            by = _AGAIN_BY.get(capture.codec) or (ffmpeg.strict_decoder(self.path) if self.strict else "")
            said = decoder_log.decoded_again(self.path, by) if by else []
        if not said:
            return ""
        places = ", ".join(map(str, at[:_PLACES])) + (f" and {len(at) - _PLACES} later ones" if at[_PLACES:] else "")
        where = f" at about frame{'s' * (len(at) > 1)} {places}" if at else ""
        return f"{before}the decoder reports errors{where} ({said[0].strip(' .')})"

    def _broken_clusters(self) -> int:
        try:
            return broken_clusters(self.path) if ffmpeg.container(self.path) == "matroska" else 0
        except OSError:
            return 0

    def _missing(self, frames: int, last_s: float, period: float) -> str:
        """What is missing if the file went on, or should have gone on, after the last frame; "" if nothing is."""
        claimed = self._capture.claimed or 0
        try:
            if frames >= claimed > 0 and ffmpeg.container(self.path) not in ("mpeg", "ts"):
                return ""
            claimed_s, video_s, end_s, damage = ffmpeg.ending(self.path)
        except (OSError, RuntimeError, ValueError):  # no ffmpeg program: only a count that differs clearly is noticed
            return f": only {frames} of about {claimed} frames could be read" if frames < 0.9 * claimed else ""
        early = end_s < claimed_s - max(1.0, 0.03 * claimed_s)
        if not (damage or early or video_s > last_s + max(0.5, 5 * period)):
            return ""
        seconds = f"({last_s + period:.1f} of {max(claimed_s, claimed * period):.1f} s)"
        read = f"{frames} frames{f' of about {claimed} {seconds}' if claimed > frames else ''} could be read"
        return f"{f' ({damage})' if damage else ''}: {read}"


def _length(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return -1


class FolderSource(Source):
    """Images of a folder or an archive in natural order, at a constant rate. Those to be read must be of one size."""

    def __init__(
        self,
        path: Path,
        files: Sequence[Path],
        fps: Fraction,
        start: int,
        stop: int | None,
        data: Callable[[Path], bytes | None] = lambda file: None,
    ):
        super().__init__(path, (0, 0), fps, start, stop)
        self._data = data  # the bytes of a file that is not on disk
        if start >= len(files):
            raise self._past_end(len(files))
        self.variable, self.files = False, files
        read = files[start:stop]
        self.frames_hint = len(read)
        height, width = images.read(read[0], None, data(read[0])).shape[:2]
        self.size = width, height
        for file in read[1:]:
            size = images.header_size(file, data(file))
            if size is not None and size != self.size:
                first = f"{read[0].name} has {width}x{height}; a folder must hold frames of one size"
                raise InputError(f"{file}: {size[0]}x{size[1]} pixels, but {first}")

    def frame(self, index: int) -> Frame:
        """Any frame of the folder. Raises images.UnreadableError."""
        file = self.files[index]
        return Frame(index, float(index / self.fps), images.read(file, self.size, self._data(file)))

    def _frames(self) -> Iterator[Frame]:
        total = len(self.files)
        for index in range(total)[self._start : self._stop]:
            if self._closed:
                return
            try:
                frame = self.frame(index)
            except images.UnreadableError as error:
                file = self.files[index]
                self._cut(f"{file}: {error.why}; stopped after {index} of {total} frames, {error.remedy}")
                return
            yield frame


def open_source(path: Path, *, fps: Fraction | None = None, start: int = 0, stop: int | None = None) -> Source:
    """Open a video file, a folder or a .zip of images, a glob of images in one folder (`a*.png`), or a single image.

    Frames from `start` up to, not including, `stop`. `fps` is the rate of images (default 25); a video has its own
    clock and refuses it. Raises InputError when there is nothing to read, UsageError for impossible arguments.
    """
    if start < 0:
        raise UsageError(f"{path}: cannot start at frame {start}; frames count from 0")
    if stop is not None and stop <= start:
        raise UsageError(f"{path}: nothing to read from frame {start} up to {stop}; stop must be greater than start")
    if fps is not None and fps <= 0:
        raise UsageError(f"{path}: {fps} is no frame rate; give frames per second greater than 0")
    check_local(path)
    files = images.listing(path)
    if files is not None:
        if not files:
            raise InputError(f"{path}: no images in this folder; {', '.join(sorted(images.SUFFIXES))} are read")
        return FolderSource(path, files, fps or FOLDER_FPS, start, stop)
    check_file(path)
    if is_archive(path):
        packed = Archive(path)
        return FolderSource(path, packed.files, fps or FOLDER_FPS, start, stop, packed.read)
    if is_image(path):
        return FolderSource(path, [path], fps or FOLDER_FPS, start, stop)
    if fps is not None:
        raise UsageError(f"{path}: a video keeps its own frame rate; give --fps for images only")
    return VideoSource(path, start, stop)
