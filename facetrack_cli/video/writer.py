"""Annotated frames to an MP4 that plays everywhere: H.264, yuv420p, the source's times and the source's sound.

Every frame keeps its own time, and none is repeated. Times within a millisecond of the nominal rate's grid are moved
onto it, so that a clip of constant rate comes out with a strictly constant one. The sound is copied in a second pass:
if that fails, there is still the video.
"""

import contextlib
import os
import re
import subprocess
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.files import discard, publish, temporary_path
from facetrack_cli.core.types import Image
from facetrack_cli.video.decode import FORMATS, sound_of

_TICK_S = 1e-6  # by which the pipe to the encoder counts time
_LARGE = 3_000_000  # pixels: of larger frames x264 buffers few, because each needs 60 MB
_COPIED_AUDIO = frozenset(("aac", "mp3", "ac3", "eac3", "alac"))  # what players expect in an MP4; the rest becomes AAC
_LOCAL_CLIPS = ("-protocol_whitelist", "file", "-format_whitelist", FORMATS)  # as PyAV opens a clip
_SNAP_S = 0.0011  # containers that keep whole milliseconds move a frame by up to half of one, at either end
_LONGEST = 2**29  # ticks that a frame is shown at most: an MP4 holds 2**31, over several that are reordered
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


def _ffmpeg(arguments: Sequence[str]) -> list[str]:
    """A command; its child has a session of its own, so that Ctrl-C does not reach it."""
    brought = [*Path(imageio_ffmpeg.__file__).with_name("binaries").glob("ffmpeg-*")]
    ours = len(brought) == 1 and "IMAGEIO_FFMPEG_EXE" not in os.environ  # which get_ffmpeg_exe would start, to try it
    program = brought[0] if ours else imageio_ffmpeg.get_ffmpeg_exe()
    return [str(program), "-nostdin", "-hide_banner", *arguments]


def run_ffmpeg(arguments: Sequence[str]) -> tuple[int, str]:
    """Run ffmpeg to its end: exit code and messages. OSError or RuntimeError if it cannot be started."""
    nothing, pipe = subprocess.DEVNULL, subprocess.PIPE
    done = subprocess.run(_ffmpeg(arguments), stdin=nothing, stdout=nothing, stderr=pipe, start_new_session=True)
    return done.returncode, done.stderr.decode("utf-8", "replace")


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
        self._fps, self._audio_from, self._replace = fps, audio_from, replace
        self._frames = self._tick = 0  # frames written, and the time of the last
        self._first_s = self._last_s = self._left_out_s = 0.0
        self._closed = False
        # ticks of the file's clock: a frame lasts a whole number of them, and a tick at most 0.1 ms
        self._timescale = fps.numerator * -(-10_000 // fps.numerator)
        # paths are absolute, so that no name reads as an option or a protocol
        self._mp4 = ["-video_track_timescale", str(self._timescale), "-movflags", "+faststart", "-f", "mp4"]
        self._part = temporary_path(path).absolute()
        try:
            self._part.open("wb").close()
        except OSError as error:
            raise self._refused(error) from error
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - a file and not a pipe, which somebody would have to empty
        try:
            command, nothing = _ffmpeg(self._command(aspect.limit_denominator(255))), subprocess.DEVNULL
            self._child = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=nothing, stderr=self._stderr, start_new_session=True
            )
        except BaseException as error:
            self._stderr.close()
            discard(path)
            if isinstance(error, OSError | RuntimeError):
                raise OutputError(f"{path}: ffmpeg cannot be started ({reason(error)})") from error
            raise
        assert self._child.stdin is not None
        self._pipe = self._child.stdin
        with contextlib.suppress(ImportError, AttributeError, OSError):  # a larger pipe: fewer context switches a frame
            import fcntl

            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, 1 << 20)  # type: ignore[attr-defined,unused-ignore]

    def write(self, image: Image, time_s: float) -> None:
        """Append one (H, W, 3) uint8 BGR frame, shown from `time_s` on the source's clock; times must not fall."""
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
        try:
            if not self._frames:
                self._pipe.write(_matroska_head(*self.size, self._fps))
            self._pipe.write(_matroska_block(round(self._tick / self._timescale / _TICK_S), image.nbytes))
            self._pipe.write(np.ascontiguousarray(image).data)
        except OSError as error:
            self._closed = True
            raise self._failure(error) from error
        self._frames += 1

    def close(self) -> None:
        """Finish the file and put it at `path`; closing again does nothing. Without any frame there is no file."""
        if self._frames == 0:
            self.discard()
        if self._closed:
            return
        self._closed = True
        whole = False
        try:
            try:
                self._end()
            except OutputError:
                raise
            except BaseException:  # it needs only a moment more; a second interruption drops the video
                with contextlib.suppress(OutputError):
                    self._end()
                    whole = True
                raise
            whole = True
            self._add_audio()
        finally:
            self._drop(keep=whole)
            if whole and self._replace:
                try:
                    publish(self.path)
                except OSError as error:
                    raise self._refused(error) from error
                finally:
                    discard(self.path)  # which is gone once it is published

    def discard(self) -> None:
        """Stop the encoder and leave no file, whatever stood at `path` before stays; does nothing once closed."""
        if not self._closed:
            self._closed = True
            self._drop()

    def __exit__(self, *_: object) -> None:
        self.close()  # what was written until an interruption is kept too

    def _command(self, aspect: Fraction) -> list[str]:
        width, height = self.size
        matrix = "bt709" if height >= 720 else "smpte170m"  # as players assume where they ignore the tag
        # chroma is the mean of four pixels, or thin coloured lines would get holes; H.264 has even sides
        change = f"pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix={matrix}:out_range=tv:flags=area+accurate_rnd"
        change += f"+full_chroma_inp,format=yuv420p,setparams=colorspace={matrix}:color_primaries={matrix}"
        change += f":color_trc={matrix}:range=tv{f',setsar={aspect}' if aspect != 1 else ''}"
        large = width * height > _LARGE
        command = ["-nostats", "-v", "error", "-y", *("-thread_queue_size", "1") * large, "-f", "matroska", "-i", "-"]
        # a lookahead in a thread of its own, and the macroblock tree, whose assembly reads memory that nobody has
        # written, make other bytes now and then of the same frames; superfast leaves out the tree
        command += ["-vf", change, "-c:v", "libx264", "-preset", "superfast", "-crf", "23"]
        few = ":bframes=0:ref=1:sliced-threads=1" if large else ""
        command += [*("-threads", "3") * large, "-x264-params", f"sync-lookahead=0{few}"]
        command += ["-fps_mode", "passthrough", "-enc_time_base", f"1/{self._timescale}"]
        return [*command, *self._mp4, str(self._part)]

    def _end(self) -> None:
        """Wait until the encoder has finished its file."""
        try:
            self._pipe.close()
        except OSError as error:
            raise self._failure(error) from error
        if self._child.wait() != 0:
            raise self._failure(None)

    def _failure(self, error: OSError | None) -> OutputError:
        """What to raise once the encoder has failed: its own words, where it left any. There is no file then."""
        with contextlib.suppress(OSError):
            self._pipe.close()
        code = self._child.wait()
        self._stderr.seek(0)
        why, remedy = cause(self._stderr.read().decode("utf-8", "replace")), "free some space"
        self._drop()
        if not why and code:
            why = f"ffmpeg was killed by signal {-code}" if code < 0 else f"ffmpeg ended with code {code}"
            remedy = "run it again"
        why = why or (reason(error) if error else "ffmpeg ended early")
        return OutputError(f"{self.path}: the video cannot be written ({why}); {remedy} or use --no-video")

    def _refused(self, error: OSError) -> OutputError:
        return OutputError(f"{self.path}: {reason(error)}; choose another output folder")

    def _add_audio(self) -> None:
        """Add the source's sound to the video just written; without it, a warning."""
        source, mixed = self._audio_from, self._part.with_suffix(".audio.mp4")
        if source is None or not source.is_file():
            return
        try:
            codec, late_s = sound_of(source)
            if not codec:
                return
            command = ["-v", "error", "-y", "-i", str(self._part), "-itsoffset", f"{-self._first_s - late_s:.6f}"]
            command += [*_LOCAL_CLIPS, "-i", str(source.absolute())]
            command += ["-map", "0:v:0", "-map", "1:a:0", "-map_metadata", "-1", "-c:v", "copy"]
            # copying drops what comes before time 0 by itself
            recode = ["-af", "atrim=start=0", "-c:a", "aac", "-b:a", "160k"]
            command += ["-c:a", "copy"] if codec in _COPIED_AUDIO else recode
            length_s = float(Fraction(self._tick, self._timescale) + 1 / self._fps)
            code, messages = run_ffmpeg([*command, "-t", f"{length_s:.6f}", *self._mp4, str(mixed)])
            if code:
                raise RuntimeError(cause(messages))
            mixed.replace(self._part)
        except (OSError, RuntimeError, ValueError) as error:
            what = f"that of {source} cannot be used ({reason(error)})"
            self.warnings.append(f"{self.path}: written without sound, {what}")
        finally:
            mixed.unlink(missing_ok=True)

    def _drop(self, *, keep: bool = False) -> None:
        """End the encoder, and unless `keep` remove the file."""
        self._child.kill()  # harmless where it has ended
        with contextlib.suppress(OSError):  # what the pipe still held is lost
            self._child.__exit__(None, None, None)  # closes it and waits
        self._stderr.close()
        if not keep:
            discard(self.path)


# Just enough of Matroska (RFC 9559) for one track of uncompressed BGR, each frame with a time


def _element(identity: str, value: bytes | int) -> bytes:
    data = value.to_bytes(8, "big") if isinstance(value, int) else value
    return bytes.fromhex(identity) + (len(data) | 1 << 56).to_bytes(8, "big") + data


def _matroska_head(width: int, height: int, fps: Fraction) -> bytes:
    ebml = _element("4282", b"matroska") + _element("4287", 4) + _element("4285", 2)
    info = _element("2AD7B1", round(_TICK_S * 1e9)) + _element("4D80", b"facetrack") + _element("5741", b"facetrack")
    video = _element("B0", width) + _element("BA", height) + _element("2EB524", b"BGR\x18")
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
