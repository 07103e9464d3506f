"""Annotated frames to an MP4 that plays everywhere: H.264, yuv420p, the source's times and the source's sound.

Every frame keeps its own time, and none is repeated. Times within a millisecond of the nominal rate's grid are moved
onto it, so that a clip of constant rate comes out with a strictly constant one. The sound is copied in a second pass:
if that fails, there is still the video.

A video may be `cut` into pieces that are encoded by themselves and joined at the end. A piece that is finished stays
where it is whatever ends the program, and the video goes on from there.
"""

import contextlib
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, NamedTuple

import cv2
import imageio_ffmpeg
import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.files import discard, publish, sync, temporary_path
from facetrack_cli.core.types import Image
from facetrack_cli.video.decode import FORMATS, sound_of, weights

_TICK_S = 1e-6  # by which the pipe to the encoder counts time
_LARGE = 3_000_000  # pixels: of larger frames x264 buffers few, because each needs 60 MB
_STRIP = 1 << 18  # pixels that are converted at a time, which bounds memory


_CAUSE = re.compile(
    "No space left on device|Disk quota exceeded|File too large|Read-only file system|Input/output error|"
    "Permission denied"
)
_PREFIX = re.compile(r"^(?:\[[^\]]*\] )+")


def cause(text: str) -> str:
    """The cause of a failure in ffmpeg's messages: the error of the system if there is one, else their last line."""
    if system := _CAUSE.search(text):
        return system.group()
    lines = [_PREFIX.sub("", line).strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Last message repeated", "Conversion failed"))]
    return "".join(lines[-1:])


class Program(contextlib.AbstractContextManager["Program"]):
    """A running ffmpeg, which Ctrl-C does not reach. OSError or RuntimeError if it cannot be started."""

    def __init__(self, arguments: Sequence[str], *, stdin: int = subprocess.DEVNULL):
        words = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-hide_banner", *arguments]
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - a file and not a pipe, which somebody would have to empty
        try:
            self.child = subprocess.Popen(
                words, stdin=stdin, stdout=subprocess.DEVNULL, stderr=self._stderr, start_new_session=True
            )
        except BaseException:
            self._stderr.close()
            raise

    def messages(self) -> str:
        """What it has printed to stderr, once it has ended."""
        self.child.wait()
        self._stderr.seek(0)
        return self._stderr.read().decode("utf-8", "replace")

    def __exit__(self, *_: object) -> None:
        self.child.kill()  # harmless where it has ended
        with contextlib.suppress(OSError):  # what a pipe still held is lost
            self.child.__exit__(None, None, None)  # closes the pipes and waits
        self._stderr.close()


def run_ffmpeg(arguments: Sequence[str]) -> tuple[int, str]:
    """Run ffmpeg to its end: exit code and messages."""
    with Program(arguments) as program:
        return program.child.wait(), program.messages()


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    """OutputError, in its one line, where the system refuses to write the video."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise OutputError(f"{path}: {reason(error)}; choose another output folder") from error


class Encoder:
    """Encodes frames of `size` into the MP4 `target`, which errors call `path`. OutputError if that is not possible.

    `timescale` are the ticks a second of the file's clock, `aspect` is the width of a pixel over its height.
    """

    def __init__(
        self, path: Path, target: Path, size: tuple[int, int], fps: Fraction, timescale: int, aspect: Fraction
    ) -> None:
        self.target, self._path, self._fps, self._timescale = target, path, fps, timescale
        self._aspect = aspect.limit_denominator(255)
        self._planes, self._head = Planes(size), False
        with _writing(path):
            target.open("wb").close()
        try:
            self.program = Program(self._command(), stdin=subprocess.PIPE)
        except (OSError, RuntimeError) as error:
            target.unlink(missing_ok=True)
            raise OutputError(f"{path}: ffmpeg cannot be started ({reason(error)})") from error
        with contextlib.suppress(ImportError, AttributeError, OSError):  # a larger pipe: fewer context switches a frame
            import fcntl

            fcntl.fcntl(self.pipe, fcntl.F_SETPIPE_SZ, 1 << 20)  # type: ignore[attr-defined,unused-ignore]

    def write(self, image: Image, elapsed_s: float) -> None:
        """Append one frame, shown so long after the first one."""
        try:
            if not self._head:
                self._head = True
                self.pipe.write(_matroska_head(*self._planes.size, self._fps))
            data = self._planes.of(image).data
            self.pipe.write(_matroska_block(round(elapsed_s / _TICK_S), data.nbytes))
            self.pipe.write(data)
        except OSError as error:
            raise self._failure(error) from error

    def end(self) -> None:
        """Finish the file."""
        try:
            self.pipe.close()
        except OSError as error:
            raise self._failure(error) from error
        if self.program.child.wait() != 0:
            raise self._failure(None)

    def drop(self) -> bool:
        """End the program; whether the file is finished, or else it is removed."""
        whole = self.program.child.poll() == 0
        self.program.__exit__()
        if not whole and self.target.is_file():
            self.target.unlink(missing_ok=True)
        return whole

    @property
    def pipe(self) -> IO[bytes]:
        assert self.program.child.stdin is not None
        return self.program.child.stdin

    def _command(self) -> list[str]:
        matrix, (width, height) = self._planes.matrix, self._planes.size
        tags = f"setparams=colorspace={matrix}:color_primaries={matrix}:color_trc={matrix}:range=tv"
        tags += f",setsar={self._aspect}" if self._aspect != 1 else ""
        large = width * height > _LARGE
        command = ["-nostats", "-v", "error", "-y", *("-thread_queue_size", "1") * large, "-f", "matroska", "-i", "-"]
        # a lookahead in a thread of its own, and the macroblock tree, whose assembly reads memory that nobody has
        # written, make other bytes now and then of the same frames; superfast leaves out the tree
        command += ["-vf", tags, "-c:v", "libx264", "-preset", "superfast", "-crf", "23"]
        few = ":bframes=0:ref=1:sliced-threads=1" if large else ""
        command += [*("-threads", "3") * large, "-x264-params", f"sync-lookahead=0{few}"]
        command += ["-fps_mode", "passthrough", "-enc_time_base", f"1/{self._timescale}"]
        return [*command, *as_mp4(self.target, self._timescale)]

    def _failure(self, error: OSError | None) -> OutputError:
        """What to raise once the encoder has failed: its own words, where it left any."""
        with contextlib.suppress(OSError):
            self.pipe.close()
        code, why, remedy = self.program.child.wait(), cause(self.program.messages()), "free some space"
        self.drop()
        if not why and code:
            why = f"ffmpeg was killed by signal {-code}" if code < 0 else f"ffmpeg ended with code {code}"
            remedy = "run it again"
        why = why or (reason(error) if error else "ffmpeg ended early")
        return OutputError(f"{self._path}: the video cannot be written ({why}); {remedy} or use --no-video")


def as_mp4(path: Path, timescale: int) -> list[str]:
    """ffmpeg's arguments for an MP4 at `path` whose clock has so many ticks a second.

    Paths are absolute, so that no name reads as an option or a protocol.
    """
    options = ["-video_track_timescale", str(timescale), "-movflags", "+faststart", "-f", "mp4"]
    return [*options, str(path.absolute())]


class Planes:
    """Turns BGR images of `size` (width, height) into YUV 4:2:0 of limited range, as `matrix` (ffmpeg's name) says.

    `size` becomes that of what comes out: odd sides get one more line, which is black.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        (width, height), (right, bottom) = size, (size[0] % 2, size[1] % 2)
        self.size = width, height = width + right, height + bottom
        self._more = (0, bottom, 0, right) if right or bottom else None
        self.matrix = "bt709" if size[1] >= 720 else "smpte170m"  # as players assume where they ignore the tag
        self._weights = weights(*((0.2126, 0.0722) if self.matrix == "bt709" else (0.299, 0.114)))
        self._planes = np.empty(width * height // 2 * 3, np.uint8)
        y, uv = np.split(self._planes, [width * height])
        self._y, self._uv = y.reshape(height, width), uv.reshape(2, height // 2, width // 2)
        self._rows = max(_STRIP // width, 2) // 2 * 2

    def of(self, image: Image) -> Image:
        """The planes of (H, W, 3) uint8, one after the other, flat; they are overwritten by those of the next image.

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


# Just enough of Matroska (RFC 9559) for one track of uncompressed YUV 4:2:0, each frame with a time


def _element(identity: str, value: bytes | int) -> bytes:
    data = value.to_bytes(8, "big") if isinstance(value, int) else value
    return bytes.fromhex(identity) + (len(data) | 1 << 56).to_bytes(8, "big") + data


def _matroska_head(width: int, height: int, fps: Fraction) -> bytes:
    ebml = _element("4282", b"matroska") + _element("4287", 4) + _element("4285", 2)
    info = _element("2AD7B1", round(_TICK_S * 1e9)) + _element("4D80", b"facetrack") + _element("5741", b"facetrack")
    video = _element("B0", width) + _element("BA", height) + _element("2EB524", b"I420")
    track = _element("D7", 1) + _element("73C5", 1) + _element("83", 1) + _element("9C", 0)
    track += _element("23E383", round(10**9 / fps))  # without it, the last frame would last no time and not be shown
    track += _element("86", b"V_UNCOMPRESSED") + _element("E0", video)
    segment = bytes.fromhex("18538067") + b"\x01" + b"\xff" * 7  # of unknown length: it ends with the pipe
    tracks = _element("1654AE6B", _element("AE", track))
    return _element("1A45DFA3", ebml) + segment + _element("1549A966", info) + tracks


def _matroska_block(ticks: int, size: int) -> bytes:
    """All that goes before the `size` bytes of one frame: a cluster of its own, since only clusters hold long times."""
    time = _element("E7", ticks)
    block = b"\xa3" + (size + 4 | 1 << 56).to_bytes(8, "big") + b"\x81\x00\x00\x80"
    return bytes.fromhex("1F43B675") + (len(time) + len(block) + size | 1 << 56).to_bytes(8, "big") + time + block


_COPIED_AUDIO = frozenset(("aac", "mp3", "ac3", "eac3", "alac"))  # what players expect in an MP4; the rest becomes AAC
_LOCAL_CLIPS = ("-protocol_whitelist", "file", "-format_whitelist")  # as PyAV opens a clip
_SNAP_S = 0.0011  # containers that keep whole milliseconds move a frame by up to half of one, at either end
_LONGEST = 2**29  # ticks that a frame is shown at most: an MP4 holds 2**31, over several frames that are reordered
_SLOW_S = 60  # frames that are shown for longer have a coarser clock


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
    there. `aspect` is the width of a pixel over its height. `warnings` (one line each) says what could not be kept.
    Raises OutputError when the file cannot be written.
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
        self._closed = False
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
            self._encoder.write(image, (tick - pieces[-1]) / self._timescale)
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
                with _writing(self.path):
                    encoder.end()
                    encoder.drop()
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
        self._closed = True
        whole = False
        try:
            if self._failed is not None:
                raise self._failed
            if self._encoder is not None:
                try:
                    self._encoder.end()
                except OutputError:
                    raise
                except BaseException:  # it needs only a moment more; a second interruption drops the video
                    with contextlib.suppress(OutputError):
                        self._encoder.end()
                    whole = self._encoder.drop() and len(self._at.pieces) == 1
                    raise
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
        pieces, names = self._at.pieces, self._target.with_suffix(".pieces.txt")
        files = [_piece(self._folder, number) for number in range(len(pieces))]
        try:
            with _writing(self.path):
                if self._encoder is not None:
                    self._encoder.target.replace(files[-1])
                lines = ["ffconcat version 1.0"]
                for file, start, end in zip(files, pieces, [*pieces[1:], None], strict=True):
                    lines.append("file '" + str(file.absolute()).replace("'", r"'\''") + "'")
                    if end is not None:
                        lines.append(f"duration {(end - start) / self._timescale:.6f}")
                names.write_text("\n".join(lines) + "\n", encoding="utf-8")
                command = ["-v", "error", "-y", "-f", "concat", "-safe", "0", *_LOCAL_CLIPS, f"concat,{FORMATS}"]
                command += ["-i", str(names.absolute()), "-map", "0:v:0", "-c", "copy"]
                code, messages = run_ffmpeg([*command, *as_mp4(self._target, self._timescale)])
        finally:
            names.unlink(missing_ok=True)
        if code:
            why = cause(messages) or f"ffmpeg ended with code {code}"
            raise OutputError(f"{self.path}: the video cannot be put together ({why}); free some space or run it again")

    def _add_audio(self) -> None:
        """Add the source's sound to the video just written; without it, a warning."""
        source, silent = self._audio_from, self._target
        if source is None or not source.is_file():
            return
        mixed = silent.with_suffix(".audio.mp4")
        try:
            codec, late_s = sound_of(source)
            if not codec:
                return
            start = self._at.first_s + late_s
            ticks = self._at.last_tick - self._at.pieces[0]
            length = float(ticks / Fraction(self._timescale) + 1 / self._fps)
            command = ["-v", "error", "-y", "-i", str(silent.absolute())]
            command += ["-itsoffset", f"{-start:.6f}", *_LOCAL_CLIPS, FORMATS, "-i", str(source.absolute())]
            command += ["-map", "0:v:0", "-map", "1:a:0", "-map_metadata", "-1", "-c:v", "copy"]
            # copying drops what comes before time 0 by itself
            recode = ["-af", "atrim=start=0", "-c:a", "aac", "-b:a", "160k"]
            command += ["-c:a", "copy"] if codec in _COPIED_AUDIO else recode
            code, messages = run_ffmpeg([*command, "-t", f"{length:.6f}", *as_mp4(mixed, self._timescale)])
            if code:
                raise RuntimeError(cause(messages))
            mixed.replace(silent)
        except (OSError, RuntimeError, ValueError) as error:
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
