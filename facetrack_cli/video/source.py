"""Where frames come from: a video file, or the images of a folder, as an iterable of `Frame`; and what a file is.

Frames are counted from 0 of the file, also when reading starts later; `time_s` counts from the file's start, by the
file's own clock, as players do, and grows from frame to frame: where sound begins before the pictures, the first of
them comes later than 0. The number of frames that a container claims is only a hint.

A clip that ends early gives all the frames before the damage; then `complete` is False and `warnings` says what is
missing. A clip is incomplete, too, if FFmpeg calls a packet or a frame damaged: the decoder conceals damage and goes
on, so that all frames are there, but some are not what the clip showed. At its end a clip must be as long as its
container says, in bytes and in seconds. Ogg, WMV and MPEG program streams do not say it: of them a cut between two
packets is not noticed.
"""

import math
import re
import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

from facetrack_cli.core.errors import InputError, UsageError, reading
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.video import images
from facetrack_cli.video.decode import MIN_JUMP_FRAMES, Decoder, LostError, fitted
from facetrack_cli.video.images import Pictures

AGAIN: Final = "copy or download it again"
_KINDS: Final = (
    "3g2 3gp apng asf avi divx dv f4v flv gif m2ts m2v m4v mj2 mjpeg mjpg mkv mov mp4 mpe mpeg mpg mts mxf ogm ogv qt "
    "rm rmvb ts vob webm wmv y4m"
)
_VIDEOS: Final = frozenset(f".{kind}" for kind in _KINDS.split())
_ADDRESS: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(?=[^/])")  # a drive of Windows has one letter
_TS_PACKET: Final = 188  # bytes
_MP4_BOXES: Final = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")


def is_clip(path: Path) -> bool:
    """Whether a file that is found in a folder is a clip: a video, or an animation."""
    return (path.suffix.lower() in _VIDEOS or images.is_animated(path)) and path.is_file()


def is_image(path: Path) -> bool:
    """Whether a file is a single image."""
    return path.suffix.lower() in images.SUFFIXES and not images.is_animated(path)


def brings_rate(clip: Path) -> bool:
    """Whether a clip has a frame rate that is read, as all but images: of a folder, an animated WebP."""
    several = clip.is_dir() or images.listing(clip) is not None or clip.suffix.lower() == ".webp"
    return not several and not is_image(clip)


def given_rate(clip: Path, fps: float) -> Fraction | None:
    """The rate at which a clip was read, of frames per second, where it does not bring it itself."""
    return None if brings_rate(clip) else Fraction(fps).limit_denominator(1001)


def is_live(clip: Path) -> bool:
    """Whether an input is a camera, by its number or device, or standard input."""
    name = str(clip)
    return name == "-" or name.startswith("/dev/video") or (name.isdecimal() and not clip.exists())


def address_of(path: Path) -> str | None:
    """The address on the network of which a path has lost a slash; None for a path."""
    scheme = _ADDRESS.match(str(path))
    return scheme and f"{scheme[1]}://{str(path)[scheme.end() :]}"


def check_local(path: Path) -> None:
    """InputError for an address on the network."""
    if address := address_of(path):
        raise InputError(f"{address}: is an address on the network; download it first, then give the file")


def check_file(path: Path) -> None:
    """Raise InputError for a path that is no file that can be read, or an empty one."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(f"{path}: the name holds bytes that are no UTF-8 text; rename the file") from None
    with reading(path, "check the name and the permissions"):
        if not path.exists():
            hint = "a pipe cannot be read, save the clip to a file" if str(path) == "-" else "check the name"
            raise InputError(f"{path}: no such file or folder; {hint}")
        if not path.is_file():
            raise InputError(f"{path}: neither a file nor a folder; save the clip to a file")
        with path.open("rb") as file:
            if not file.read(1):
                raise InputError(f"{path}: the file is empty; {AGAIN}")


def missing_part(path: Path) -> str:
    """What an AVI file lacks by its size, or an MPEG transport stream by the marks of its packets; "" of a whole one.

    FFmpeg itself says it of an MP4.
    """
    with path.open("rb") as file:
        size, head = path.stat().st_size, file.read(2 * _TS_PACKET + 1)
        length = 8 + int.from_bytes(head[4:8], "little")
        if head[:4] == b"RIFF" and size < length < 0x7FFFFFFF:  # a writer may leave the largest number there
            return f"{length - size} bytes are missing"
        if head[::_TS_PACKET] == b"GGG":  # the mark with which each packet begins
            file.seek(0)
            while block := file.read(_TS_PACKET << 12):
                if len(block) % _TS_PACKET:
                    return "it ends within a packet"
                if block[::_TS_PACKET].count(b"G") < len(block) // _TS_PACKET:
                    return "a packet lacks its mark"
    return ""


FOLDER_FPS = Fraction(25)
_JITTER_S = 0.0015  # containers that keep whole milliseconds move a frame by less than this


class Source(AbstractContextManager["Source"], ABC):
    """Frames of one clip, iterable once; `size` (width, height) has rotation applied, `fps` is the nominal rate.

    `aspect` is the width of a pixel over its height, `begins_s` the time of the clip's first frame.
    """

    def __init__(
        self, path: Path, file: Decoder | Pictures, size: tuple[int, int], fps: Fraction, start: int, stop: int | None
    ):
        self.path, self.size, self.fps, self._file = path, size, fps, file
        self.is_video, self.aspect, self.begins_s = False, Fraction(1), 0.0
        self.stream: int | None = None  # of a video, if one was named
        self.frames_hint: int | None = None  # the likely number of frames to come
        # filled while iterating
        self.variable: bool | None = None  # whether the times of frames differ from `fps`, once it is known
        self.warnings: list[str] = []  # one line each
        self.complete = True  # False once it is known that frames are missing or wrong
        self._start, self._stop = start, stop
        self._closed = False
        self._lock = threading.Lock()  # what reads must not be closed while it is at work

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """The frames, once. Raises InputError when the clip ends before the first."""

    def close(self) -> None:
        """End the iteration, also from another thread, and free the file; once closed, closing again does nothing."""
        self._closed = True
        with self._lock:
            self._file.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _cut(self, message: str) -> None:
        self.complete = False
        self.warnings.append(message)

    def _scaled(self, what: str, size: tuple[int, int]) -> None:
        sizes = "{}x{}, the first is {}x{}".format(*size, *self.size)
        self.warnings.append(f"{what} is {sizes}; all are scaled to the first")

    def _past_end(self, frames: int) -> InputError:
        there = f"the clip has {frames} frames (0 to {frames - 1})"
        return InputError(f"{self.path}: frame {self._start} is past the end, {there}; start earlier")


class VideoSource(Source):
    """A video file, decoded by PyAV. Where its packets allow it, frames long before `start` are not decoded."""

    def __init__(self, path: Path, start: int, stop: int | None, stream: int | None = None):
        try:
            self._bytes, self.decoder = path.stat().st_size, Decoder(path, stream)
        except (OSError, ValueError) as error:
            lack, why = "", f"not a video that can be read; give another file or a folder of images, or {AGAIN}"
            with suppress(OSError), path.open("rb") as file:
                unread = file.read(8)[4:] in _MP4_BOXES and hasattr(error, "log")  # it is FFmpeg's
                lack = "its index (moov) is missing" if unread else missing_part(path)
            raise InputError(f"{path}: {f'cut short or damaged ({lack}); {AGAIN}' if lack else why}") from None
        super().__init__(path, self.decoder, self.decoder.size, self.decoder.fps, start, stop)
        self.is_video, self.stream = True, stream
        self.aspect, self.begins_s = self.decoder.aspect, self.decoder.begins_s
        if len(streams := self.decoder.streams) > 1:
            each = [f"{video.index} ({video.codec_context.width}x{video.codec_context.height})" for video in streams]
            what = f"has {len(each)} video streams, {' and '.join(sorted(each))}; {each[0]} is read"
            self.warnings.append(f"{path}: {what}, --stream N takes another")
        if (claimed := self.decoder.claimed) is not None:
            self.frames_hint = max(min(claimed, stop or claimed) - start, 0)

    def __iter__(self) -> Iterator[Frame]:
        start, stop, period_s = self._start, self._stop, float(1 / self.fps)
        before_s, decoder = -1.0, self.decoder
        if start > MIN_JUMP_FRAMES:  # frames before are skipped where packets tell which frame is which
            with self._lock:
                decoder.approach(start, lambda: self._closed)
        while stop is None or decoder.next < stop:
            with self._lock:
                if self._closed:
                    return
                raw = self._next()
                frame = None if raw is None or decoder.next <= start else decoder.picture(raw)
                ended = raw is None
                del raw  # free it before the next one is decoded
            if ended:
                break
            if before_s >= 0 and abs(decoder.time_s - before_s - period_s) > _JITTER_S:
                self.variable = True
            before_s = decoder.time_s
            if frame is not None:
                if decoder.resized is not None and decoder.resized[0] == frame.index:
                    self._scaled(f"{self.path}: frame {frame.index}", decoder.resized[1])
                yield frame
        else:  # the rest of the file does not matter
            self._judge_frames({at for at in decoder.damage if at < decoder.next})
            return
        if decoder.next <= start:
            raise self._past_end(decoder.next)
        self.variable = bool(self.variable)
        self._judge(decoder.next, decoder.time_s)

    def _next(self) -> Any:
        """The next frame; the first again where a jump to `start` has led astray."""
        try:
            return self.decoder.read()
        except LostError:
            if self.decoder.next > self._start:
                raise
            self.decoder.restart()
            return self.decoder.read()

    def _judge(self, frames: int, last_s: float) -> None:
        """Say so if frames are missing after the last one that was decoded, or are not what the clip showed."""
        # one that was removed is read to its end
        if self.path.exists() and self.path.stat().st_size != self._bytes:
            self._cut(f"{self.path}: changed while it was read, after {frames} frames; run it again")
            return
        decoder, missing = self.decoder, ""
        with suppress(OSError):
            missing = missing_part(self.path) or decoder.complaint
        if not missing and decoder.end_s >= decoder.claimed_s - max(1.0, 0.03 * decoder.claimed_s):
            self._judge_frames(decoder.damage)
            return
        claimed, period_s = decoder.claimed or 0, float(1 / self.fps)
        seconds = f"({last_s + period_s:.1f} of {max(decoder.claimed_s, claimed * period_s):.1f} s)"
        read = f"{frames} frames{f' of about {claimed} {seconds}' if claimed > frames else ''} could be read"
        why = f" ({missing})" if missing else ""
        self._cut(f"{self.path}: cut short or damaged{why}: {read}; {AGAIN} for the rest")

    def _judge_frames(self, damage: set[int]) -> None:
        """Say so if frames are not what the clip showed."""
        if damage:
            frames = f"about frame {min(damage)}{f' and {len(damage) - 1} later ones' if len(damage) > 1 else ''}"
            self._cut(f"{self.path}: damaged: the decoder reports errors at {frames}, which may look wrong; {AGAIN}")


class FolderSource(Source):
    """Images of a folder in natural order, at a constant rate, scaled to the size of the first.

    `files` has the file of each frame: of a stack its file as often as it has pages.
    """

    def __init__(self, path: Path, pictures: Pictures, fps: Fraction, start: int, stop: int | None):
        super().__init__(path, pictures, (0, 0), fps, start, stop)
        self._pictures, self.files, self._resized, self.variable = pictures, pictures.files, False, False
        if start >= len(self.files):
            raise self._past_end(len(self.files))
        self.frames_hint = len(self.files[start:stop])
        first = pictures.numbers(start)
        self.size = first.shape[1], first.shape[0]
        if first.dtype.itemsize > 1:  # the same whatever is read
            with suppress(images.UnreadableError):
                pictures.measure_levels()
            if pictures.levels != images.ALL_LEVELS:
                what = "{}: 16-bit images that use the numbers {} to {}".format(path, *pictures.levels)
                self.warnings.append(f"{what}; these are black and white, so that all of it is seen")

    def frame(self, index: int) -> Frame:
        """Any frame of the folder. Raises images.UnreadableError."""
        with self._lock:
            image = self._pictures.read(index)
        if (size := image.shape[1::-1]) != self.size:
            if not self._resized:
                self._scaled(str(self.files[index]), size)
            self._resized, image = True, fitted(image, self.size)
        return Frame(index, float(index / self.fps), image)

    def __iter__(self) -> Iterator[Frame]:
        total = len(self.files)
        with self._pictures:  # the last file, where somebody has closed the source meanwhile
            for index in range(total)[self._start : self._stop]:
                if self._closed:
                    return
                try:
                    frame = self.frame(index)
                except images.UnreadableError as error:
                    what = f"{error.why}; stopped after {index} of {total} frames, {error.remedy}"
                    self._cut(f"{self.files[index]}: {what}")
                    return
                yield frame


def open_source(
    path: Path, *, fps: Fraction | None = None, start: int = 0, stop: int | None = None, stream: int | None = None
) -> Source:
    """Open a video file, a folder of images, a glob of images in one folder (`a*.png`), or a single image.

    Frames from `start` up to, not including, `stop`. `fps` is the rate of images (default 25); a video has its own
    clock and refuses it. `stream` is the number of a video's stream (default: FFmpeg's own choice).
    Raises InputError when there is nothing to read, UsageError for impossible arguments.
    """
    if stop is not None and stop <= start:
        raise UsageError(f"{path}: nothing to read from frame {start} up to {stop}; stop must be greater than start")
    check_local(path)
    if (files := images.listing(path)) is None:
        check_file(path)
        files = None if brings_rate(path) else [path]
    if files is not None:
        if not files:
            raise InputError(f"{path}: no images in it; {', '.join(sorted(images.SUFFIXES))} are read")
        return FolderSource(path, Pictures(files), fps or FOLDER_FPS, start, stop)
    if fps is not None:
        raise UsageError(f"{path}: a video keeps its own frame rate; give --fps for images only")
    return VideoSource(path, start, stop, stream)


# --- any frame --------------------------------------------------------------------------------------------------------

CACHE_BYTES: Final = 256 << 20  # of decoded frames, the neighbours of those that were asked for
BEHIND: Final = 8, 250  # so many frames before a wanted one are kept, after a jump and when going backwards


class Frames(AbstractContextManager["Frames"]):
    """Any frame of a video or an image folder, the one that `open_source` gives under its number. Thread-safe.

    `size` is (width, height), upright. Raises what `open_source` raises.
    """

    def __init__(self, path: Path, *, fps: Fraction | None = None, stream: int | None = None):
        self.path, self._source = path, open_source(path, fps=fps, stream=stream)
        self.size, self.fps, self.aspect = self._source.size, self._source.fps, float(self._source.aspect)
        self._last = self._reached = 0
        self._end: int | None = None  # the number of frames, once it is certain
        self._recent = OrderedDict[int, tuple[float, Image]]()  # times and pixels, the least recently used first
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._most = max(CACHE_BYTES // math.prod((*self.size, 3)), 1)
        if isinstance(self._source, FolderSource):
            self._end = len(self._source.files)
        elif isinstance(self._source, VideoSource):
            self._decoder = self._source.decoder
            if not self._decoder.claimed:
                self._decoder.read_packets(self._closed.is_set)
            self._approach(0)

    @property
    def count(self) -> int:
        """How many frames can be read, as far as is known."""
        if self._end is not None:
            return self._end
        packets = self._decoder.packets  # once: another thread may set it
        return max((self._decoder.claimed or 0) if packets is None else len(packets.pts), self._reached)

    @property
    def exact(self) -> bool:
        """Whether `count` is certain."""
        return self._end is not None

    def read(self, index: int) -> Frame:
        """The frame with this number; its pixels may be shared with other calls and must not be written to.

        Raises InputError past the end, after which `count` is exact, and RuntimeError when closed, also meanwhile.
        """
        with self._lock:
            ahead = index >= 0 and (self._end is None or index < self._end)
            if ahead and index not in self._recent and not self._closed.is_set():
                self._approach(index)
            if self._closed.is_set():
                raise RuntimeError("these frames are closed; open them again")
            if index not in self._recent:
                there = f"the clip has {self.count} frames (0 to {self.count - 1}); choose one of them"
                raise InputError(f"{self.path}: there is no frame {index}, {there}")
            self._recent.move_to_end(index)
            self._last = index
            return Frame(index, *self._recent[index], aspect=self.aspect)

    def close(self) -> None:
        """End what is being read, also in other threads, and free the file; closing again does nothing."""
        self._closed.set()
        with self._lock:
            self._source.close()
            self._recent.clear()

    def __exit__(self, *_: object) -> None:
        self.close()

    # what follows is called with the lock

    def _approach(self, index: int) -> None:
        """Put a frame into `_recent`, if the clip has it."""
        if isinstance(self._source, FolderSource):
            try:
                self._keep(self._source.frame(index))
            except images.UnreadableError:
                self._end = index  # a source ends before an image that cannot be read
                raise
            return
        backwards, decoder = 0 < self._last - index <= BEHIND[1], self._decoder
        before = min(BEHIND[backwards], self._most * 3 // 4)
        decoder.approach(index, self._closed.is_set)
        while decoder.next <= index and not self._closed.is_set():
            try:
                raw = decoder.read()
                if raw is None and decoder.index is not None and decoder.next != len(decoder.index.pts):
                    raise LostError(f"{self.path}: ends at frame {decoder.next}")
            except LostError:
                self._recent.clear()
                decoder.restart()
                continue
            self._reached = max(self._reached, decoder.next)
            if raw is None:
                self._end = decoder.next
                return
            if decoder.next > index - before:
                self._keep(decoder.picture(raw))

    def _keep(self, frame: Frame) -> None:
        self._recent[frame.index] = frame.time_s, frame.pixels
        if len(self._recent) > self._most:
            self._recent.popitem(last=False)
