"""Annotated frames to an MP4 that plays everywhere: H.264, yuv420p, the source's times and the source's sound.

Every frame keeps its own time, and none is repeated. Times within a millisecond of the nominal rate's grid are moved
onto it, so that a clip of constant rate comes out with a strictly constant one. The sound is added in a second pass,
as AAC: if that fails, there is still the video.

A video may be `cut` into pieces that are encoded by themselves and joined at the end. A piece that is finished stays
where it is whatever ends the program, and the video goes on from there.
"""

import contextlib
import heapq
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.files import discard, publish, sync, temporary_path
from facetrack_cli.core.types import Image
from facetrack_cli.video.decode import open_container, sound_of, weights

if TYPE_CHECKING:
    from av.container import InputContainer, OutputContainer

_LARGE = 3_000_000  # pixels: of larger frames x264 buffers few, because each needs 60 MB
_STRIP = 1 << 18  # pixels that are converted at a time, which bounds memory


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    """OutputError, in its one line, where the system or the encoder refuses to write the video."""
    import av

    try:
        yield
    except (OSError, RuntimeError, ValueError, av.FFmpegError) as error:
        remedy = "free some space, choose another output folder, or use --no-video"
        raise OutputError(f"{path}: the video cannot be written ({reason(error)}); {remedy}") from error


def _mp4(path: Path, timescale: int) -> "OutputContainer":
    """A new MP4 whose clock has so many ticks a second. An absolute path never reads as an option or a protocol."""
    import av

    options = {"movflags": "+faststart", "video_track_timescale": str(timescale)}
    return av.open(str(path.absolute()), "w", format="mp4", options=options)


class Encoder:
    """Encodes frames of `size` into the MP4 `target`, which errors call `path`. OutputError if that is not possible.

    `timescale` are the ticks a second of the file's clock, `aspect` is the width of a pixel over its height.
    """

    def __init__(
        self, path: Path, target: Path, size: tuple[int, int], fps: Fraction, timescale: int, aspect: Fraction
    ) -> None:
        self.target, self._path, self._tick = target, path, Fraction(1, timescale)
        self._planes, self._lasts, self._ended = Planes(size), round(timescale / fps), False
        width, height = self._planes.size
        large = width * height > _LARGE
        # a lookahead in a thread of its own, and the macroblock tree, whose assembly reads memory that nobody has
        # written, make other bytes now and then of the same frames; superfast leaves out the tree
        few = ":bframes=0:ref=1:sliced-threads=1" if large else ""
        options = {"preset": "superfast", "crf": "21", "x264-params": f"sync-lookahead=0{few}"}
        with _writing(path):
            target.open("wb").close()
            self._file = _mp4(target, timescale)
            self._stream = self._file.add_stream("libx264", rate=fps, options=options)
            context = self._stream.codec_context
            context.width, context.height, context.pix_fmt = width, height, "yuv420p"
            context.time_base, context.sample_aspect_ratio = self._tick, aspect.limit_denominator(255)
            context.colorspace = context.color_primaries = context.color_trc = self._planes.matrix
            context.color_range, context.thread_type = 1, "AUTO"  # 16 to 235
            context.thread_count = 3 if large else 0

    def write(self, image: Image, tick: int) -> None:
        """Append one frame, shown from a tick on."""
        import av

        with _writing(self._path):
            frame = av.VideoFrame.from_ndarray(self._planes.of(image), format="yuv420p")
            frame.pts, frame.time_base = tick, self._tick
            self._put(self._stream.encode(frame))

    def end(self) -> None:
        """Finish the file."""
        with _writing(self._path):
            self._put(self._stream.encode(None))
            self._file.close()
        self._ended = True

    def drop(self) -> None:
        """Remove the file, unless it is finished."""
        if not self._ended:
            with contextlib.suppress(Exception):
                self._file.close()
            self.target.unlink(missing_ok=True)

    def _put(self, packets: Sequence[Any]) -> None:
        for packet in packets:
            packet.duration = self._lasts  # of the last one; the others last until the next
            self._file.mux(packet)


class Planes:
    """Turns BGR images of `size` (width, height) into YUV 4:2:0 of limited range, by the `matrix` of H.273's number.

    `size` becomes that of what comes out: odd sides get one more line, which is black.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        (width, height), (right, bottom) = size, (size[0] % 2, size[1] % 2)
        self.size = width, height = width + right, height + bottom
        self._more = (0, bottom, 0, right) if right or bottom else None
        self.matrix = 1 if size[1] >= 720 else 6  # BT.709 or 601, as players assume where they ignore the tag
        self._weights = weights(*((0.2126, 0.0722) if self.matrix == 1 else (0.299, 0.114)))
        self._planes = np.empty((height // 2 * 3, width), np.uint8)
        y, uv = np.split(self._planes.ravel(), [width * height])
        self._y, self._uv = y.reshape(height, width), uv.reshape(2, height // 2, width // 2)
        self._rows = max(_STRIP // width, 2) // 2 * 2

    def of(self, image: Image) -> Image:
        """The planes of (H, W, 3) uint8, one below the other; they are overwritten by those of the next image.

        A chroma sample is the mean of its four pixels: `cv2.COLOR_BGR2YUV_I420` takes it from one, and thin coloured
        lines get holes; it does not know BT.709 either.
        """
        if self._more is not None:
            image = np.asarray(cv2.copyMakeBorder(image, *self._more, cv2.BORDER_CONSTANT), np.uint8)
        width, height = self.size
        for top in range(0, height, self._rows):
            yuv = cv2.transform(image[top : top + self._rows], self._weights)
            cv2.extractChannel(yuv, 0, self._y[top : top + self._rows])
            small = cv2.resize(yuv, (width // 2, len(yuv) // 2), interpolation=cv2.INTER_AREA)
            for channel, plane in enumerate(self._uv, 1):
                cv2.extractChannel(small, channel, plane[top // 2 : top // 2 + len(small)])
        return self._planes


_SNAP_S = 0.0011  # containers that keep whole milliseconds move a frame by up to half of one, at either end
_LONGEST = 2**29  # ticks that a frame is shown at most: an MP4 holds 2**31, over several frames that are reordered
_SLOW_S = 60  # frames that are shown for longer have a coarser clock
_SOUND_RATE, _SOUND_BITS = 48_000, 160_000  # a second


class Cut(NamedTuple):
    """Where a video stands after some frames: what it goes on from. `pieces` are the ticks at which they begin.

    `first_s` is the time of the first frame, `left_out_s` what is left out of gaps that no MP4 can hold.
    """

    frames: int = 0
    first_s: float = 0.0
    left_out_s: float = 0.0
    last_tick: int = 0
    pieces: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()


class VideoWriter(contextlib.AbstractContextManager["VideoWriter"]):
    """Writes BGR frames of `size` (width, height) to an MP4 at `path`, which appears there when `close` is called.

    `fps` is the nominal rate. `audio_from` is the clip whose sound is kept, from the first frame written to the end of
    the last. Odd sizes are padded by one black line or column, which H.264 requires. With `replace=False` the finished
    file keeps its temporary name. Pieces go to the folder `pieces`; those of a video that was written up to a `Cut` are
    there. `aspect` is the width of a pixel over its height. `warnings` (one line each) says what could not be
    kept, `published` whether the file is at `path`. Raises OutputError when the file cannot be written.
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
        pieces: Path | None = None,
        after: Cut = Cut(),  # noqa: B008 -- it cannot be changed
    ):
        self.path, self.size, self.warnings = path, size, list(after.warnings)
        self._fps, self._audio_from, self._replace, self._folder = fps, audio_from, replace, pieces
        self._aspect = aspect
        # ticks of the file's clock: a frame lasts a whole number of them, and a tick at most 0.1 ms
        finest = 10_000 if fps * _SLOW_S > 1 else 1000
        self._timescale = fps.numerator * -(-finest // fps.numerator)
        self._at = after
        self._number = 0  # of the piece that is written
        self._encoder: Encoder | None = None
        self._failed: OutputError | None = None
        self.published = self._closed = False
        if not after.pieces:
            self._start()

    def write(self, image: Image, time_s: float) -> None:
        """Append one (H, W, 3) uint8 BGR frame, shown from `time_s` on the source's clock; times must not fall."""
        width, height = self.size
        if self._closed:
            raise ValueError("write to a closed VideoWriter")
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(f"frame is {image.dtype} {image.shape}, the video takes uint8 {(height, width, 3)}")
        if self._failed is not None:
            raise self._failed
        frames, first_s, left_out_s, last_tick, pieces, _ = self._at
        first_s = first_s if frames else time_s
        time_s -= left_out_s
        elapsed_s = time_s - first_s
        nearest = round(elapsed_s * self._fps) / self._fps
        on_grid = abs(float(nearest) - elapsed_s) <= min(_SNAP_S, 0.25 / float(self._fps))
        tick = int(nearest * self._timescale) if on_grid else round(elapsed_s * self._timescale)
        if frames:
            tick = max(tick, last_tick + 1)
            if (beyond := tick - last_tick - _LONGEST) > 0:
                tick -= beyond
                left_out_s += beyond / self._timescale
                if not self.warnings:
                    gap = f"{(beyond + _LONGEST) / self._timescale / 3600:.1f} hours at {time_s:.0f} s"
                    shown = f"{_LONGEST / self._timescale / 3600:.1f}, which is the longest in an MP4"
                    self.warnings.append(f"{self.path}: a gap of {gap} is shown as {shown}")
        if self._encoder is None:
            self._start()
        if len(pieces) == self._number:
            pieces = (*pieces, tick)
        assert self._encoder is not None
        self._at = Cut(frames, first_s, left_out_s, last_tick, pieces)
        try:
            self._encoder.write(image, tick - pieces[-1])
        except OutputError:
            self._closed = True
            raise
        self._at = Cut(frames + 1, first_s, left_out_s, tick, pieces)

    def cut(self) -> tuple[Cut, Callable[[], None]]:
        """End a piece: where the video stands then, and what finishes the piece, in any thread, before `close`."""
        encoder, number, folder = self._encoder, self._number, self._folder
        assert encoder is not None and folder is not None

        def finish() -> None:
            try:
                encoder.end()
                with _writing(self.path):
                    folder.mkdir(exist_ok=True)
                    sync(encoder.target)
                    encoder.target.replace(_piece(folder, number))
                    sync(folder)
            except OutputError as e:
                self._failed = e
                raise

        self._encoder, self._number = None, number + 1
        return self._at._replace(warnings=tuple(self.warnings)), finish

    def close(self) -> None:
        """Finish the file and put it at `path`; closing again does nothing. Without any frame there is no file."""
        if self._at.frames == 0:
            self.discard()
        if self._closed:
            return
        self._closed, whole = True, False
        try:
            if self._failed is not None:
                raise self._failed
            if self._encoder is not None:
                self._encoder.end()
            if len(self._at.pieces) > 1 or self._encoder is None:
                self._join()
            whole = True
            self._add_audio()
        finally:
            self._drop(keep=whole)
            if whole and self._replace:
                try:
                    with _writing(self.path):
                        publish(self.path)
                    self.published = True
                finally:
                    discard(self.path)  # which is gone once it is published

    def discard(self) -> None:
        """Stop the encoder and leave no file, whatever stood at `path` before stays; does nothing once closed."""
        if not self._closed:
            self._closed = True
            self._drop()

    def __exit__(self, *_: object) -> None:
        self.close()  # what was written until an interruption is kept too

    @property
    def _target(self) -> Path:
        return temporary_path(self.path)

    def _start(self) -> None:
        """Start the encoder of the next piece; that of the first one writes what may be the whole video."""
        self._number = len(self._at.pieces)
        target = self._target if self._number == 0 else self._target.with_suffix(f".{self._number}.mp4")
        self._encoder = Encoder(self.path, target, self.size, self._fps, self._timescale, self._aspect)

    def _join(self) -> None:
        """Put the pieces together, each at its time."""
        assert self._folder is not None
        files = [_piece(self._folder, number) for number in range(len(self._at.pieces))]
        with _writing(self.path), _mp4(self._target, self._timescale) as whole:
            if self._encoder is not None:
                self._encoder.target.replace(files[-1])
            stream, last = None, -(2**62)
            for file, start in zip(files, self._at.pieces, strict=True):
                with open_container(file) as piece:
                    stream = stream or whole.add_stream_from_template(piece.streams.video[0])
                    for packet in _packets(piece, stream):
                        packet.pts, last = packet.pts + start, max(packet.dts + start, last + 1)
                        packet.dts = last
                        whole.mux(packet)

    def _add_audio(self) -> None:
        """Add the source's sound to the video just written; without it, a warning."""
        import av

        source, silent = self._audio_from, self._target
        if source is None or not source.is_file():
            return
        mixed = silent.with_suffix(".audio.mp4")
        try:
            codec, late_s = sound_of(source)
            if not codec:
                return
            ticks = self._at.last_tick - self._at.pieces[0]
            length = float(ticks / Fraction(self._timescale) + 1 / self._fps)
            with open_container(source) as clip, open_container(silent) as video, _mp4(mixed, self._timescale) as out:
                pictures = out.add_stream_from_template(video.streams.video[0])
                sound = _sound(clip, out, self._at.first_s + late_s, length)
                for packet in heapq.merge(_packets(video, pictures), sound, key=lambda one: one.dts * one.time_base):
                    out.mux(packet)
            mixed.replace(silent)
        except (OSError, RuntimeError, ValueError, av.FFmpegError) as error:
            what = f"that of {source} cannot be used ({reason(error)})"
            self.warnings.append(f"{self.path}: written without sound, {what}")
        finally:
            mixed.unlink(missing_ok=True)

    def _drop(self, *, keep: bool = False) -> None:
        """End the encoder, and unless `keep` remove the file."""
        if self._encoder is not None:
            self._encoder.drop()
            if self._encoder.target != self._target:
                self._encoder.target.unlink(missing_ok=True)
        if not keep:
            discard(self.path)


def _piece(folder: Path, number: int) -> Path:
    return folder / f"{number:05}.mp4"


def _packets(video: "InputContainer", to: Any) -> Iterator[Any]:
    for packet in video.demux(video.streams.video[0]):
        if packet.size:
            packet.stream = to
            yield packet


def _sound(clip: "InputContainer", out: "OutputContainer", start: float, length: float) -> Iterator[Any]:
    """The first sound of a clip as packets of AAC, from `start` on, in s from the clip's own, for `length` seconds."""
    import av

    sound = clip.streams.audio[0]
    layout = "mono" if sound.channels == 1 else "stereo"
    stream = out.add_stream("aac", rate=_SOUND_RATE, bit_rate=_SOUND_BITS, layout=layout)
    begins, graph = start + (clip.start_time or 0) / 1e6, av.filter.Graph()
    cut = graph.add("atrim", start=f"{begins:.6f}", end=f"{begins + length:.6f}")
    nodes = [graph.add_abuffer(template=sound), cut, graph.add("asetpts", f"PTS-{begins:.6f}/TB")]
    graph.link_nodes(*nodes, graph.add("abuffersink")).configure()

    with contextlib.suppress(EOFError):  # at the end of what is cut out
        for frame in chain(_decoded(clip, sound), [None]):
            graph.push(frame)
            with contextlib.suppress(BlockingIOError):  # until it wants more
                while True:
                    yield from stream.encode(graph.pull())  # type: ignore[arg-type]
    yield from stream.encode(None)


def _decoded(clip: "InputContainer", sound: Any) -> Iterator[Any]:
    import av

    for packet in clip.demux(sound):
        with contextlib.suppress(av.InvalidDataError):  # damage: the rest is heard
            yield from packet.decode()
