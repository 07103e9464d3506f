"""Annotated frames to an MP4 that plays everywhere: H.264, yuv420p, the source's times, and its sound as AAC.

Every frame keeps its own time, and none is repeated. Times within a millisecond of the nominal rate's grid are moved
onto it, so that a clip of constant rate comes out with a strictly constant one.
"""

import contextlib
import math
from collections.abc import Generator, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, Final

import av
import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.files import discard, publish, temporary_path, writing
from facetrack_cli.core.types import Image
from facetrack_cli.video.decode import open_container, sound_delay

_LARGE: Final = 3_000_000  # pixels: of larger frames x264 buffers few, because each needs 60 MB
_SNAP_S: Final = 0.0011  # containers that keep whole milliseconds move a frame by up to half of one, at either end
_LONGEST: Final = 2**29  # ticks that a frame is shown at most: an MP4 holds 2**31, over several that are reordered


class VideoWriter(contextlib.AbstractContextManager["VideoWriter"]):
    """Writes BGR frames of `size` (width, height) to an MP4 at `path`, which appears there when `close` is called.

    `fps` is the nominal rate, `aspect` the width of a pixel over its height. `audio_from` is the clip whose sound is
    kept, from the first frame written to the end of the last. Odd sizes are padded by one black line or column, which
    H.264 requires. With `replace=False` the finished file keeps its temporary name. `warnings` (one line each) says
    what could not be kept. Raises OutputError when the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        fps: Fraction,
        aspect: Fraction = Fraction(1),
        *,
        audio_from: Path | None = None,
        replace: bool = True,
    ):
        self.path, self.size, self.warnings = path, size, list[str]()
        self._fps, self._replace, self._sound = Fraction(fps), replace, self._heard(audio_from)
        self._frames = self._tick = 0  # frames written, and the time of the last
        self._first_s = self._last_s = self._left_out_s = 0.0
        self._closed = False
        # ticks of the file's clock: a frame lasts a whole number of them, and a tick at most 0.1 ms
        self._timescale = fps.numerator * -(-10_000 // fps.numerator)
        self._part = temporary_path(path).absolute()  # a name that is no option and no protocol
        with writing(path, "choose another output folder"):
            self._part.open("wb").close()
        (width, height), clock = size, Fraction(1, self._timescale)
        options = {"movflags": "+faststart", "video_track_timescale": str(self._timescale)}
        self._file = av.open(str(self._part), "w", format="mp4", options=options)
        large = width * height > _LARGE
        # a lookahead in a thread of its own, and the macroblock tree, whose assembly reads memory that nobody has
        # written, make other bytes now and then of the same frames; superfast leaves out the tree
        options = {"preset": "superfast", "crf": "23", "x264-params": "sync-lookahead=0"}
        options["x264-params"] += ":bframes=0:ref=1:sliced-threads=1" if large else ""
        self._video = video = self._file.add_stream("libx264", self._fps, options=options, time_base=clock)
        video.width, video.height = width + width % 2, height + height % 2
        # as players assume where they ignore the tag; numbers of H.273
        matrix, number = ("bt709", 1) if height >= 720 else ("smpte170m", 6)
        context: Any = video.codec_context
        context.thread_type, context.thread_count = "FRAME", 3 if large else 0
        context.color_range, context.sample_aspect_ratio = 1, aspect.limit_denominator(255)  # 16 to 235
        context.colorspace = context.color_primaries = context.color_trc = number
        # chroma is the mean of four pixels, or thin coloured lines would get holes; H.264 has even sides
        how = f"out_color_matrix={matrix}:out_range=tv:flags=area+accurate_rnd+full_chroma_inp"
        self._change = change = av.filter.Graph()
        buffer = change.add_buffer(width=width, height=height, format="bgr24", time_base=clock)  # type: ignore[arg-type]
        steps = (("pad", "ceil(iw/2)*2:ceil(ih/2)*2"), ("scale", how), ("format", "yuv420p"), ("buffersink", None))
        change.link_nodes(buffer, *(change.add(*step) for step in steps)).configure()

    def write(self, image: Image, time_s: float) -> None:
        """Append one (H, W, 3) uint8 BGR frame, shown from `time_s` on the source's clock; times must not fall."""
        width, height = self.size
        if self._closed:
            raise ValueError("write to a closed VideoWriter")
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(f"frame is {image.dtype} {image.shape}, the video takes uint8 {(height, width, 3)}")
        self._first_s, self._last_s = (self._first_s, self._last_s) if self._frames else (time_s, time_s)
        longest_s = _LONGEST / self._timescale
        if (beyond_s := time_s - self._last_s - longest_s) > 0:
            self._left_out_s += beyond_s
            gap = f"a gap of {(time_s - self._last_s) / 3600:.1f} hours at {self._last_s:.0f} s"
            self.warnings += [f"{self.path}: {gap} is shown as {longest_s / 3600:.1f}"] * (not self.warnings)
        self._last_s = time_s
        elapsed_s = time_s - self._first_s - self._left_out_s
        nearest = round(elapsed_s * self._fps) / self._fps
        on_grid = abs(float(nearest) - elapsed_s) <= min(_SNAP_S, 0.25 / float(self._fps))
        tick = int(nearest * self._timescale) if on_grid else round(elapsed_s * self._timescale)
        self._tick = max(tick, self._tick + 1) if self._frames else tick
        frame = av.VideoFrame.from_ndarray(image, "bgr24")
        frame.pts, frame.time_base = self._tick, Fraction(1, self._timescale)
        self._change.vpush(frame)
        shown = self._change.vpull()
        shown.duration = int(self._timescale / self._fps)  # without it, the last frame would last no time
        self._frames += 1
        self._append(shown)

    def close(self) -> None:
        """Finish the file and put it at `path`; closing again does nothing. Without any frame there is no file."""
        if self._frames == 0:
            self.discard()
        if self._closed:
            return
        self._closed, whole = True, False
        try:
            self._append(None)
            whole = True
            if self._replace:
                with writing(self.path, "choose another output folder"):
                    publish(self.path)
        finally:
            if self._replace or not whole:
                discard(self.path)  # which is gone once it is published

    def discard(self) -> None:
        """Leave no file, whatever stood at `path` before stays; does nothing once closed."""
        if not self._closed:
            self._drop()

    def __exit__(self, *_: object) -> None:
        self.close()  # what was written until an interruption is kept too

    def _append(self, frame: Any) -> None:
        """Encode a frame, and the sound up to its end; after None, the end, the file is closed."""
        try:
            with writing(self.path, "use --no-video"):
                while (packet := next(self._sound, None)) is not None:
                    self._file.mux(packet)
                self._file.mux(self._video.encode(frame))
                if frame is None:
                    self._sound.close()
                    self._file.close()
        except OutputError:
            self._drop()
            raise

    def _drop(self) -> None:
        self._closed = True
        self._sound.close()
        discard(self.path)  # first, or its parts would be put in order
        with contextlib.suppress(OSError):
            self._file.close()
        discard(self.path)

    def _heard(self, source: Path | None) -> Generator[Any, None, None]:
        """The packets of a clip's sound, if it has any; None where more frames must come first."""
        at_s, last = 0.0, -math.inf
        try:
            if source is None or not source.is_file() or (late_s := sound_delay(source)) is None:
                return
            with open_container(source) as clip:
                sound, to = clip.streams.audio[0], self._file.add_stream("aac", bit_rate=160_000)
                yield None
                before_s = self._first_s + late_s + (clip.start_time or 0) / 1e6
                for frame in chain(_decoded(sound), [None]):
                    if frame is not None:
                        frame.pts = (frame.pts or 0) - round(before_s / frame.time_base)
                        if frame.pts < 0:
                            continue
                    for packet in to.encode(frame):
                        if packet.dts is None or packet.dts <= last:  # where the clip's clock goes back
                            continue
                        at_s, last = float(packet.dts * packet.time_base), packet.dts
                        while at_s > self._tick / self._timescale + 1 / float(self._fps):
                            yield None
                        yield packet
        except (OSError, RuntimeError, ValueError) as error:
            what = f"that of {source} cannot be used ({reason(error)})"
            self.warnings.append(f"{self.path}: without sound from {at_s:.1f} s on, {what}")


def _decoded(sound: Any) -> Iterator[Any]:
    for packet in sound.container.demux(sound):
        with contextlib.suppress(av.FFmpegError):  # what is damaged is left out
            yield from packet.decode()
