"""A video file decoded by PyAV, and the numbers of its frames by their packets, by which any frame is sought.

Colours are computed by BT.601, also where a clip says BT.709: so does OpenCV, with whose images the models are trained.
Frames of 4:2:0 in limited range, which nearly all clips have, stay planes until their colours are read.
"""

from __future__ import annotations

import contextlib
import math
import weakref
from array import array
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.types import Array, Image, Whole, planes_of
from facetrack_cli.video.images import MOST_PIXELS, check_pixels

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.codeccontext import VideoCodecContext
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_DEFAULT_FPS: Final = Fraction(25)
MIN_JUMP_FRAMES: Final = 16  # decoding fewer frames takes less time than a jump over them
_CHECKED_FRAMES: Final = 24  # so many frames from the start must agree with the packets
_MAX_TRIES: Final = 3  # a seek that arrives too late is repeated from an earlier keyframe
_MAX_THREADS: Final = 8  # of the decoder, each of which holds frames
# larger frames are decoded several at a time; FFmpeg does not always tell which of them are damaged then
_MAX_ALONE_PIXELS: Final = 1_000_000
_FULL_RANGE: Final = 2  # libavutil's number of a range from 0 to 255
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

    `size` is the (width, height) of the first frame, upright, and `fps` the nominal rate. `next` is the number of the
    frame that `read` gives next, `time_s` the time of the last one, from the first. `claimed` is the number of frames
    that the container claims, `claimed_s` its duration, and `end_s` the end of the video and sound that were read.
    `damage` are the numbers, nearly, of frames that are damaged, and `complaint` what the demuxer said of it first.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._container = open_container(path)
        video = video_stream(self._container)
        if video is None:
            self._container.close()
            raise ValueError("no video")
        self._video, self._sound = video, self._container.streams.audio
        self._end = weakref.finalize(self, _end, video.codec_context, self._container)
        check_pixels(path, video.codec_context.width, video.codec_context.height)
        video.codec_context.options = {"max_pixels": str(MOST_PIXELS)}  # also of frames whose size is another one
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
        self._index: Index | None = None  # by which it jumped
        self.damage: set[int] = set()
        self.complaint = ""
        self.next, self.time_s, self.end_s = 0, 0.0, 0.0
        decoded = self._decoded()
        first = next(decoded, None)
        if first is None:
            self.close()
            raise ValueError("no frame")
        self._frames: Iterator[VideoFrame] = chain([first], decoded)
        turned = round(first.rotation / 90) % 2
        self.size = (first.height, first.width) if turned else (first.width, first.height)

    def read(self) -> VideoFrame | None:
        """The next frame; None at the end. Raises LostError."""
        raw = next(self._frames, None)
        if raw is None:
            return None
        if self._index is not None:
            if self.next >= len(self._index.pts) or raw.pts != self._index.pts[self.next]:
                what = f"{self.path}: frame {self.next} is not there at the time that its packet says"
                raise LostError(f"{what}; convert the clip, or track it in one piece")
            self.time_s = float(self._index.times[self.next])
        else:
            stamp = raw.dts if self._by_dts else raw.pts
            if self.next == 0:
                self._origin = stamp or 0
            else:  # some frames have no stamp, or one that is not later
                elapsed_s = -1.0 if stamp is None else (stamp - self._origin) * self._tick
                self.time_s = elapsed_s if elapsed_s > self.time_s else self.time_s + float(1 / self.fps)
        self.next += 1
        return raw

    def seek(self, number: int, index: Index) -> bool:
        """Go to the last keyframe before a frame, so that reading onward gives it. False if that is not possible."""
        place = int(np.searchsorted(index.keys, number, side="right")) - 1
        for entry in index.entries[max(place - _MAX_TRIES + 1, 0) : place + 1][::-1].tolist():
            self._container.seek(entry, stream=self._video)
            self._frames = self._decoded()
            for raw in self._frames:
                at = int(np.searchsorted(index.pts, -1 if raw.pts is None else raw.pts))
                if at > number:
                    break
                if index.pts[at] == raw.pts and at in index.keys:
                    self._frames = chain([raw], self._frames)
                    self._index, self.next = index, at
                    self.damage.clear()  # of frames that lack those that they are predicted from
                    return True
        return False

    @property
    def jumped(self) -> bool:
        """Whether its frames are numbered by their packets, and not by counting."""
        return self._index is not None

    def close(self) -> None:
        """Free the file; closing again does nothing."""
        self._end()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _decoded(self) -> Iterator[VideoFrame]:
        import av

        packets, at = self._container.demux(self._video, *self._sound), self.next
        while (packet := self._demux(packets, at)) is not None:
            if packet.size and packet.time_base and (stamp := packet.dts if packet.pts is None else packet.pts):
                end_s = float((stamp + (packet.duration or 0)) * packet.time_base)
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

        (before, _), said = av.logging.get_last_error(), ""
        try:
            packet = next(packets, None)
        except av.FFmpegError as error:
            said, packet = reason(error), av.Packet()  # an empty packet brings the frames that the decoder still holds
            packet.stream = self._video
        errors, last = av.logging.get_last_error()
        if errors > before and last is not None and last[1] == self._container.format.name:
            said = last[2].strip(" .\n")
        if said:
            self.damage.add(at)
            self.complaint = self.complaint or said
        return packet


def _end(context: VideoCodecContext, container: InputContainer) -> None:
    """Free a file. The threads of the decoder end first: while they are waited for none of them can log an error."""
    if context.is_open:
        context.flush_buffers()
    container.close()


def open_container(path: Path) -> InputContainer:
    """A local file as FFmpeg reads it. Raises OSError or ValueError for what is not one of its formats of video."""
    import av

    if av.logging.get_level() is None:
        av.logging.set_level(av.logging.PANIC)  # errors are counted, and none is shown
    # an absolute path never reads as an option or a protocol
    options = {"format_whitelist": FORMATS, "protocol_whitelist": "file"}
    try:
        return av.open(str(path.absolute()), options=options, metadata_errors="replace")
    except EOFError as error:  # PyAV's is Python's, which Click takes for Ctrl-C
        raise ValueError(reason(error)) from error


def video_stream(container: InputContainer) -> VideoStream | None:
    """The first video stream that can be decoded and is no cover image."""
    from av.stream import Disposition

    streams = (one for one in container.streams.video if Disposition.attached_pic not in one.disposition)
    return next((one for one in streams if one.codec_context is not None), None)


def sound_of(path: Path) -> tuple[str, float]:
    """The codec of a file's sound, "" if it has none, and when its first image is shown, in s from the file's start.

    Raises OSError or ValueError.
    """
    with open_container(path) as container:
        video, sound = video_stream(container), container.streams.audio
        first = None if video is None else next(container.decode(video), None)
        begins_s = 0.0 if first is None or first.time is None else first.time - (container.start_time or 0) / 1e6
        return sound[0].codec.name if sound else "", max(begins_s, 0.0)


def pixels(raw: VideoFrame) -> Image:
    """A decoded frame as `Frame.pixels`, turned upright."""
    turns = round(raw.rotation / 90) % 4
    sides = raw.width, raw.height
    if raw.format.name != "yuv420p" or raw.color_range == _FULL_RANGE or sides[0] % 2 or sides[1] % 2:
        image = np.asarray(raw.to_ndarray(format="bgr24", src_colorspace="ITU601", dst_colorspace="ITU601"), np.uint8)
        return np.ascontiguousarray(np.rot90(image, turns))
    planes = np.asarray(raw.to_ndarray(), np.uint8)
    if not turns:
        return planes
    turned = np.concatenate([np.rot90(part, turns).ravel() for part in planes_of(planes)])
    return turned.reshape(-1, sides[turns % 2])


def read_index(path: Path, stopped: Callable[[], bool] = lambda: False) -> Index | None:
    """Read all packets of a video without decoding them; None if not every packet gives one frame, or once `stopped`.

    Memory is a few bytes a frame. Raises OSError or ValueError.
    """
    import av

    with Decoder(path) as decoder:
        first = [-1 if raw.pts is None else raw.pts for raw in islice(iter(decoder.read, None), _CHECKED_FRAMES)]
        reorders = bool(decoder._video.codec_context.has_b_frames)
    pts, keys, ended = array("q"), array("q"), False
    with open_container(path) as container:
        video = video_stream(container)
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
