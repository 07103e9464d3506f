"""A video file decoded by PyAV, and the numbers of its frames by their packets, by which any frame is sought.

Colours are computed by the matrix and the range that a clip says, as FFmpeg and OpenCV (from 4.13 on) do, and like
them by BT.601 where it says none. Frames of 4:2:0 in limited range, which nearly all clips have, stay planes until
their colours are read; planes of another matrix become those of BT.601.
"""

from __future__ import annotations

import contextlib
import math
import weakref
from array import array
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.types import Array, Frame, Image, Planes, Whole
from facetrack_cli.video.images import MOST_PIXELS, check_pixels

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.codeccontext import VideoCodecContext
    from av.video.frame import VideoFrame
    from av.video.plane import VideoPlane
    from av.video.stream import VideoStream

_DEFAULT_FPS: Final = Fraction(25)
MIN_JUMP_FRAMES: Final = 16  # decoding fewer frames takes less time than a jump over them
_CHECKED_FRAMES: Final = 24  # so many frames from the start must agree with the packets
_MAX_TRIES: Final = 3  # a seek that arrives too late is repeated from an earlier keyframe
_MAX_THREADS: Final = 8  # of the decoder, each of which holds frames
# larger frames are decoded several at a time; FFmpeg does not always tell which of them are damaged then
_MAX_ALONE_PIXELS: Final = 1_000_000
_PRIMING_S: Final = 0.05  # of AAC and MP3
_OBLONG: Final = 8  # a ratio of the sides of a pixel beyond this is a mistake in the file
_SHAPE: Final = 1.03  # ratio of two scales up to which an image is stretched: sides are rounded
_BT601: Final = 5
# by H.273's numbers of matrices, the luma weights of red and blue
_LUMA: Final = {
    1: (0.2126, 0.0722), 4: (0.30, 0.11), 5: (0.299, 0.114), 6: (0.299, 0.114), 7: (0.212, 0.087),
    9: (0.2627, 0.0593), 10: (0.2627, 0.0593),
}  # fmt: skip
_FULL_RANGE: Final = 2  # libavutil's number of a range from 0 to 255
_LESS: Final = ((219 / 255, 16.0), *[(224 / 255, 128 - 128 * 224 / 255)] * 2)  # of Y, U and V, to the range of others
# FFmpeg goes by what a file holds: a playlist would make it open other files, and text is drawn as letters
FORMATS: Final = (
    "3gp,aac,apng,asf,av1,avi,dv,flac,flv,gif,h264,hevc,ivf,m4v,matroska,mjpeg,mov,mp3,mp4,mpeg,mpegts,mpegvideo,mxf,"
    "nut,obu,ogg,rm,vc1,wav,webm,wtv,yuv4mpegpipe"
)
# these filters change nothing, but parse the headers of each packet, and raise where they are invalid
_PARSERS: Final = {"h264": "h264", "hevc": "hevc", "av1": "av1", "mpeg2video": "mpeg2"}


class Index(NamedTuple):
    """Of each frame in the order of showing: `pts` (T,) in ticks of the stream, `times` (T,) in s from the first.

    `keys` (M,) are the frames at which decoding can begin, `entries` (M,) the ticks to seek to for them.
    """

    pts: Whole
    times: Array
    keys: Whole
    entries: Whole


class LostError(InputError):
    """A frame that was reached by a jump is not the one that the packets tell."""


class Decoder(contextlib.AbstractContextManager["Decoder"]):
    """A video file, decoded frame after frame. Not thread-safe. Raises OSError or ValueError if it gives no frame.

    `stream` is the number of the video stream; without it `streams` are those of which the first is taken.

    `size` is the (width, height) of the first frame, upright, `aspect` the width of a pixel over its height, and `fps`
    the nominal rate. `next` is the number of the frame that `read` gives next, `time_s` the time of the last one, from
    the start of the file; the first one is shown at `begins_s`. `resized` is the first frame, and its size, that is
    not of the `size` that all are brought to. `claimed` is the number of frames
    that the container claims, `claimed_s` its duration, and `end_s` the end of the video and sound that were read.
    `damage` are the numbers, nearly, of frames that are damaged, and `complaint` what the demuxer said of it first.
    """

    def __init__(self, path: Path, stream: int | None = None) -> None:
        self.path, self.stream = path, stream
        self.packets: Index | None = None  # read for the first jump
        self.indexed = False
        self._open(path, stream)

    def _open(self, path: Path, stream: int | None) -> None:
        self._container = open_container(path)
        self.streams = recordings(self._container) if stream is None else []
        video = self.streams[0] if self.streams else video_stream(self._container, stream)
        if video is None:
            self._container.close()
            raise ValueError("no video")
        self._video, self._sound = video, self._container.streams.audio
        self._end = weakref.finalize(self, _end, video.codec_context, self._container)
        check_pixels(path, video.codec_context.width, video.codec_context.height)
        large = video.codec_context.width * video.codec_context.height > _MAX_ALONE_PIXELS
        video.codec_context.thread_type = "AUTO"
        video.codec_context.thread_count = min(cv2.getNumberOfCPUs(), _MAX_THREADS) if large else 1
        self.fps = _fraction(video.guessed_rate or video.average_rate)
        self.claimed_s = (self._container.duration or 0) / 1e6
        claimed = video.frames or math.floor(self.claimed_s * self.fps + 0.5)
        self.claimed = claimed if 1 <= claimed < 1e9 else None
        # a Matroska file says when it ends, another one how long it is
        matroska = self._container.format.name.startswith("matroska")
        self._by_dts = self._container.format.name == "avi"  # which has no times of showing
        self._begin_s = 0.0 if matroska else (self._container.start_time or 0) / 1e6
        self._tick = float(video.time_base or 1)
        self._origin = 0  # ticks of the first frame
        self.index: Index | None = None  # by which it jumped: its frames are numbered by their packets, not by counting
        self.damage: set[int] = set()
        self.complaint = ""
        self.resized: tuple[int, tuple[int, int]] | None = None
        self.next, self.time_s, self.end_s = 0, 0.0, 0.0
        decoded = self._decoded()
        if (first := next(decoded, None)) is None:
            self.close()
            raise ValueError("no frame")
        self._frames: Iterator[VideoFrame] = chain([first], decoded)
        self.size, shape = (first.width, first.height), video.sample_aspect_ratio or Fraction(1)
        self._ways = {first.rotation: _orientation(first)}
        if self._ways[first.rotation][0]:
            self.size, shape = self.size[::-1], 1 / shape
        self.aspect = shape if 1 / _OBLONG < shape < _OBLONG else Fraction(1)
        self.begins_s, _ = _shown_at(first, self._container)

    def read(self) -> VideoFrame | None:
        """The next frame; None at the end. Raises LostError."""
        if (raw := next(self._frames, None)) is None:
            return None
        if self.index is not None:
            if self.next >= len(self.index.pts) or raw.pts != self.index.pts[self.next]:
                what = f"{self.path}: frame {self.next} is not there at the time that its packet says"
                raise LostError(f"{what}; convert the clip, or track it in one piece")
            self.time_s = self.begins_s + float(self.index.times[self.next])
        else:
            stamp = raw.dts if self._by_dts else raw.pts
            if self.next == 0:
                self._origin, self.time_s = stamp or 0, self.begins_s
            else:  # some frames have no stamp, or one that is not later
                now_s = -1.0 if stamp is None else self.begins_s + (stamp - self._origin) * self._tick
                self.time_s = now_s if now_s > self.time_s else self.time_s + float(1 / self.fps)
        self.next += 1
        return raw

    def picture(self, raw: VideoFrame) -> Frame:
        """The frame that was read last, as players show it."""
        if (way := self._ways.get(raw.rotation)) is None:  # what tells it keeps a frame in memory for some time
            way = self._ways[raw.rotation] = _orientation(raw)
        frame = Frame(self.next - 1, self.time_s, pixels(raw, way), aspect=float(self.aspect))
        if frame.size == self.size:
            return frame
        self.resized = self.resized or (frame.index, frame.size)
        return Frame(frame.index, frame.time_s, fitted(frame.bgr, self.size), aspect=frame.aspect)

    def read_packets(self, stopped: Callable[[], bool]) -> Index | None:
        """Read `packets` once; None if they do not tell which frame is which."""
        if not self.indexed:
            self.indexed = True
            with contextlib.suppress(OSError, ValueError):
                self.packets = read_index(self.path, stopped, self.stream)
        return self.packets

    def approach(self, number: int, stopped: Callable[[], bool]) -> None:
        """Come to a frame or before it, by a jump to a keyframe or from the start, if reading onward takes longer.

        Raises OSError or ValueError where the file cannot be opened again.
        """
        import av

        if 0 <= number - self.next <= MIN_JUMP_FRAMES:
            return
        if (index := self.read_packets(stopped)) is not None:
            place = max(int(np.searchsorted(index.keys, number, side="right")) - 1, 0)
            if number >= self.next >= index.keys[place] - MIN_JUMP_FRAMES:
                return
            for entry in index.entries[max(place - _MAX_TRIES + 1, 0) : place + 1][::-1].tolist():
                try:
                    self._container.seek(entry, stream=self._video)
                except av.FFmpegError:  # of a damaged file
                    break
                self._frames = self._decoded()
                for raw in self._frames:
                    at = int(np.searchsorted(index.pts, -1 if raw.pts is None else raw.pts))
                    if at > number:
                        break
                    if index.pts[at] == raw.pts and at in index.keys:
                        self._frames = chain([raw], self._frames)
                        self.index, self.next = index, at
                        self.damage.clear()  # of frames that lack those that they are predicted from
                        return
        if index is not None or number < self.next:
            self.restart()

    def restart(self) -> None:
        """Count frames from the start again, and never jump."""
        self.close()
        self.packets = None
        self._open(self.path, self.stream)

    def close(self) -> None:
        """Free the file; closing again does nothing."""
        self._end()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _decoded(self) -> Iterator[VideoFrame]:
        import av

        packets, at = self._container.demux(self._video, *self._sound), self.next
        while (packet := self._demux(packets, at)) is not None:
            stamp = packet.dts if packet.pts is None else packet.pts
            if packet.size and stamp and (tick := packet.time_base):
                end_s = (stamp + (packet.duration or 0)) * tick.numerator / tick.denominator
                self.end_s = max(self.end_s, end_s - self._begin_s)
            if packet.stream.index != self._video.index:
                continue
            at += packet.size > 0
            if packet.is_corrupt:
                self.damage.add(at)
            try:
                frames = self._video.decode(packet)
            except av.FFmpegError:
                self.damage.add(at)
                continue
            for raw in frames:
                if raw.is_corrupt:
                    self.damage.add(self.next)
                yield raw

    def _demux(self, packets: Iterator[Any], at: int) -> Any:
        """The next packet; None at the end. FFmpeg tells some errors of a file in its log only."""
        import av

        (before, _), complaint = av.logging.get_last_error(), ""
        try:
            packet = next(packets, None)
        except av.FFmpegError as error:
            complaint, packet = reason(error), av.Packet()  # which brings the frames that the decoder still holds
            packet.stream = self._video
        errors, last = av.logging.get_last_error()
        if errors > before and last is not None and last[1] == self._container.format.name:
            complaint = last[2].strip(" .\n")
        if complaint:
            self.damage.add(at)
            self.complaint = self.complaint or complaint
        return packet


def _end(context: VideoCodecContext, container: InputContainer) -> None:
    """Free a file. The threads of the decoder end first: while they are waited for none of them can log an error."""
    if context.is_open:
        context.flush_buffers()
    container.close()


def silence() -> None:
    """FFmpeg shows no errors, unless somebody has asked for them: they are counted."""
    import av

    if av.logging.get_level() is None:
        av.logging.set_level(av.logging.PANIC)


def open_container(path: Path) -> InputContainer:
    """A local file as FFmpeg reads it. Raises OSError or ValueError for what is not one of its formats of video."""
    import av

    silence()
    # an absolute path never reads as an option or a protocol
    options = {"format_whitelist": FORMATS, "protocol_whitelist": "file"}
    try:
        container = av.open(str(path.absolute()), options=options, metadata_errors="replace")
    except EOFError as error:  # PyAV's is Python's, which Click takes for Ctrl-C
        raise ValueError(reason(error)) from error
    for video in container.streams.video:
        if video.codec_context:
            video.codec_context.options = {"max_pixels": str(MOST_PIXELS)}  # also of frames whose size is another one
    return container


def recordings(container: InputContainer) -> list[VideoStream]:
    """The video streams that can be decoded and are no pictures beside a clip; FFmpeg's own choice comes first.

    A stream that says that it has less than a tenth of the frames of another, as a camera's preview, is none of them.
    """
    from av.stream import Disposition

    no_clip = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
    streams = [video for video in container.streams.video if not video.disposition & no_clip and video.codec_context]
    most = max((video.frames for video in streams), default=0)
    streams = [video for video in streams if not video.frames or video.frames * 10 >= most]
    return sorted(streams, key=lambda video: video is not container.streams.best("video"))


def video_stream(container: InputContainer, number: int | None = None) -> VideoStream | None:
    """The video stream of that number in the file, else the first of `recordings`. InputError without such a number."""
    if number is None:
        return next(iter(recordings(container)), None)
    there = {video.index: video for video in container.streams.video if video.codec_context}
    if number not in there:
        numbers = ", ".join(map(str, there)) or "none"
        raise InputError(f"{container.name}: has no video stream {number}; those there are {numbers}")
    return there[number]


def sound_of(path: Path) -> tuple[str, float]:
    """A file's codec of sound, or "", and by how many s its frames are shown late. Raises OSError or ValueError."""
    with open_container(path) as container:
        video, sound = video_stream(container), container.streams.audio
        first = None if video is None else next(container.decode(video), None)
        late_s = 0.0 if first is None else _shown_at(first, container)[1]
        return sound[0].codec.name if sound else "", late_s


def _shown_at(first: VideoFrame, container: InputContainer) -> tuple[float, float]:
    """When the first frame of a file is shown, in s from the file's start, and what is left out of that.

    Sound that is encoded begins some milliseconds early, to no purpose: so much is left out.
    """
    at_s = 0.0 if first.time is None else max(first.time - (container.start_time or 0) / 1e6, 0.0)
    late = container.format.name != "avi" and at_s > _PRIMING_S  # which has no times of showing
    return (at_s, 0.0) if late else (0.0, at_s)


def pixels(raw: VideoFrame, way: tuple[bool, bool, bool] | None = None) -> Image | Planes:
    """What `Frame` takes of a decoded frame, as players show it: `way` is how."""
    way, sides = _orientation(raw) if way is None else way, (raw.width, raw.height)
    matrix = int(raw.colorspace) if int(raw.colorspace) in _LUMA else _BT601
    if raw.format.name not in ("yuv420p", "yuvj420p") or sides[0] % 2 or sides[1] % 2:
        image = np.asarray(raw.to_ndarray(format="bgr24", src_colorspace=matrix, dst_colorspace=_BT601), np.uint8)
        return np.ascontiguousarray(_oriented(image, way))
    ours = None if _LUMA[matrix] == _LUMA[_BT601] else _to_bt601(matrix)
    if raw.planes[0].line_size < 0:  # upside down in memory
        y, u, v, _ = Planes.of(np.asarray(raw.to_ndarray(), np.uint8))
    else:  # which are not copied, since new memory costs more than what is read of them
        y, u, v = map(_view, raw.planes)
    if raw.color_range == _FULL_RANGE:
        y, u, v = (
            np.asarray(cv2.convertScaleAbs(plane, None, *by), np.uint8)
            for plane, by in zip((y, u, v), _LESS, strict=True)
        )
    if any(way):
        y, u, v = (np.ascontiguousarray(_oriented(plane, way)) for plane in (y, u, v))
    return Planes(y, u, v, ours)


def _view(plane: VideoPlane) -> Image:
    return np.frombuffer(memoryview(plane), np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]


@lru_cache
def _to_bt601(matrix: int) -> Array:
    """(3, 3) Y, Cb and Cr by those of another matrix, in so few bits that sums of float32 are exact."""
    ours, theirs = list[Array](), list[Array]()
    for rows, (red, blue) in ((ours, _LUMA[_BT601]), (theirs, _LUMA[matrix])):  # of blue, green, red, in limited range
        luma = np.array([blue, 1 - red - blue, red])
        cb, cr = (np.array([1, 0, 0]) - luma) / (1 - blue) / 2, (np.array([0, 0, 1]) - luma) / (1 - red) / 2
        rows += [219 / 255 * luma, 224 / 255 * cb, 224 / 255 * cr]
    return np.asarray(np.rint(np.array(ours) @ np.linalg.inv(theirs) * 2**14) / 2**14)


def _orientation(raw: VideoFrame) -> tuple[bool, bool, bool]:
    """Whether a frame is shown with rows for columns, then mirrored, then upside down, by its display matrix."""
    try:
        matrix = raw.side_data.get("DISPLAYMATRIX")
    except ValueError:  # PyAV has no name for what FFmpeg tells beside it, as EXIF
        from av.sidedata.sidedata import Type

        Type._missing_ = classmethod(lambda kind, value: kind.SEI_UNREGISTERED)  # type: ignore[method-assign, assignment]
        matrix = raw.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return False, False, False
    # of a place (x, y) in the file, (x a + y c, x b + y d) is shown; what is no quarter turn is rounded to one
    a, b, _, c, d = np.frombuffer(cast(bytes, matrix), np.int32)[:5].tolist()
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return False, a < 0, d < 0
    return True, c < 0, b < 0


def _oriented(image: Image, way: tuple[bool, bool, bool]) -> Image:
    across, mirrored, upside_down = way
    image = image.swapaxes(0, 1) if across else image
    return image[:: -1 if upside_down else 1, :: -1 if mirrored else 1]


def fitted(image: Image, size: tuple[int, int]) -> Image:
    """A BGR image scaled to `size` (width, height); what has another shape by more than `_SHAPE` gets black borders."""
    scales = [whole / side for whole, side in zip(size, image.shape[1::-1], strict=True)]
    zoom, most = min(scales), max(scales)
    width, height = size if most <= zoom * _SHAPE else (max(round(s * zoom), 1) for s in image.shape[1::-1])
    how = cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR
    small = cv2.resize(image, (width, height), interpolation=how)
    left, top = (size[0] - width) // 2, (size[1] - height) // 2
    borders = top, size[1] - height - top, left, size[0] - width - left
    return np.asarray(cv2.copyMakeBorder(small, *borders, cv2.BORDER_CONSTANT), np.uint8)


def read_index(path: Path, stopped: Callable[[], bool] = lambda: False, stream: int | None = None) -> Index | None:
    """Read all packets of a video without decoding them; None if not every packet gives one frame, or once `stopped`.

    Memory is a few bytes a frame. Raises OSError or ValueError.
    """
    import av

    with Decoder(path, stream) as decoder:
        first = [-1 if raw.pts is None else raw.pts for raw in islice(iter(decoder.read, None), _CHECKED_FRAMES)]
        reorders = bool(decoder._video.codec_context.has_b_frames)
    pts, keys, ended = array("q"), array("q"), False
    with open_container(path) as container:
        video = video_stream(container, stream)
        assert video is not None
        codec, kind = video.codec_context.name, container.format.name
        # a program stream tells the time of some frames only, and AVI that of none
        if kind == "mpeg" or (kind == "avi" and reorders):
            return None
        parser = av.BitStreamFilterContext(f"{_PARSERS[codec]}_metadata", video) if codec in _PARSERS else None
        try:
            for packet in container.demux(video):
                if not packet.size:
                    continue
                if stopped() or ended or packet.pts is None:
                    return None
                ended = packet.is_corrupt  # the last one of a file whose end is missing
                if ended or packet.is_discard or _is_hidden(codec, packet):
                    continue
                pts.append(packet.pts)
                if packet.is_keyframe:
                    # a transport stream has no index, and is searched for times of decoding
                    keys.extend((packet.pts, packet.dts or packet.pts if kind == "mpegts" else packet.pts))
                if parser is not None:
                    parser.filter(packet)  # which empties the packet
        except av.FFmpegError:
            return None
        tick = float(video.time_base or 1)
    # frames before the first lack those that they are predicted from
    shown = np.sort(np.array(pts, np.int64))
    shown = shown[shown >= first[0]]
    if shown[: len(first)].tolist() != first or (np.diff(shown) == 0).any():
        return None
    entries = np.array(keys, np.int64).reshape(-1, 2)
    entries = entries[np.argsort(entries[:, 0])]
    entries = entries[entries[:, 0] >= first[0]]
    return Index(shown, (shown - shown[0]) * tick, np.searchsorted(shown, entries[:, 0]), entries[:, 1])


def _is_hidden(codec: str, packet: Any) -> bool:
    """Whether a packet holds a frame that is not shown; VP8 and VP9 have them, to predict others from."""
    if codec not in ("vp8", "vp9"):
        return False
    data = memoryview(packet)
    if codec == "vp8":
        return not data[0] & 0x10
    # shown are: a superframe, which packs hidden frames with a shown one; a repeated frame; a frame with the flag set
    return not (data[-1] & 0xE0 == 0xC0 or data[0] & 0x0A)


def _fraction(rate: Fraction | None) -> Fraction:
    """A frame rate as a fraction; below one in 1001 s, as those of time lapses are, by the time between two frames."""
    if rate is None or not 0 < rate <= 1000:
        return _DEFAULT_FPS
    return rate.limit_denominator(1001) if rate > Fraction(1, 1001) else 1 / (1 / rate).limit_denominator(1001)
