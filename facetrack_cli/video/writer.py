"""Annotated frames to an MP4 that plays everywhere: H.264, yuv420p, the source's times and the source's sound.

Every frame keeps its own time, and none is repeated. Times within a millisecond of the nominal rate's grid are moved
onto it, so that a clip of constant rate comes out with a strictly constant one. To carry the times, the frames go to
ffmpeg as uncompressed Matroska; a raw pipe (`imageio_ffmpeg.write_frames`) has no place for them. The sound is copied
in a second pass: if that fails, there is still the video.
"""

import contextlib
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import IO

import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.files import beside, discard, publish
from facetrack_cli.core.types import Image
from facetrack_cli.video import ffmpeg

_COPIED_AUDIO = frozenset(("aac", "mp3", "ac3", "eac3", "alac"))  # what players expect in an MP4; the rest becomes AAC
_SNAP_S = 0.0011  # containers that keep whole milliseconds move a frame by up to half of one, at either end
_TICK_S = 1e-6  # of the pipe to the encoder
_LONGEST = 2**29  # ticks that a frame is shown at most: an MP4 holds 2**31, over several frames that are reordered
_SLOW_S = 60  # frames that are shown for longer have a coarser clock
_LARGE = 3_000_000  # pixels of a frame of which the encoder looks at few others, each of which takes it 60 MB


class VideoWriter(contextlib.AbstractContextManager["VideoWriter"]):
    """Writes BGR frames of `size` (width, height) to an MP4 at `path`, which appears there when `close` is called.

    `fps` is the nominal rate. `audio_from` is the clip whose sound is kept, from the first frame written to the end of
    the last. Odd sizes are padded by one black line or column, which H.264 requires. With `replace=False` the finished
    file stays `beside` its path. `warnings` (one line each) says what could not be kept, `published` whether the file
    is at `path`. Raises OutputError when the file cannot be written.
    """

    def __init__(
        self, path: Path, size: tuple[int, int], fps: Fraction, *, audio_from: Path | None = None, replace: bool = True
    ):
        self.path, self.size, self.warnings = path, size, list[str]()
        self._fps, self._audio_from, self._replace = fps, audio_from, replace
        # ticks of the file's clock: a frame lasts a whole number of them, and a tick at most 0.1 ms
        finest = 10_000 if fps * _SLOW_S > 1 else 1000
        self._timescale = fps.numerator * -(-finest // fps.numerator)
        self._first_s = self._left_out_s = 0.0
        self._frames = self._first_tick = self._last_tick = 0
        self.published = self._closed = False
        try:
            beside(path).open("wb").close()
        except OSError as error:
            raise OutputError(f"{path}: {reason(error)}; choose another output folder") from error
        try:
            self._encoder = ffmpeg.Program(self._command(), stdin=subprocess.PIPE)
        except (OSError, RuntimeError) as error:
            discard(path)
            raise OutputError(f"{path}: ffmpeg cannot be started ({reason(error)})") from error
        with contextlib.suppress(ImportError, AttributeError, OSError):  # a larger pipe: fewer context switches a frame
            import fcntl

            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, 1 << 20)  # type: ignore[attr-defined,unused-ignore]

    def write(self, image: Image, time_s: float) -> None:
        """Append one (H, W, 3) uint8 BGR frame, shown from `time_s` on the source's clock; times must not fall."""
        width, height = self.size
        if self._closed:
            raise ValueError("write to a closed VideoWriter")
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(f"frame is {image.dtype} {image.shape}, the video takes uint8 {(height, width, 3)}")
        time_s -= self._left_out_s
        nearest = round(time_s * self._fps) / self._fps
        on_grid = abs(float(nearest) - time_s) <= min(_SNAP_S, 0.25 / float(self._fps))
        tick = int(nearest * self._timescale) if on_grid else round(time_s * self._timescale)
        try:
            if self._frames == 0:
                self._first_s, self._first_tick = time_s, tick
                self._pipe.write(_matroska_head(width, height, self._fps))
            else:
                tick = max(tick, self._last_tick + 1)
                if (beyond := tick - self._last_tick - _LONGEST) > 0:
                    tick -= beyond
                    self._left_out_s += beyond / self._timescale
                    if not self.warnings:
                        gap = f"{(beyond + _LONGEST) / self._timescale / 3600:.1f} hours at {time_s:.0f} s"
                        shown = f"{_LONGEST / self._timescale / 3600:.1f}, which is the longest in an MP4"
                        self.warnings.append(f"{self.path}: a gap of {gap} is shown as {shown}")
            elapsed = (tick - self._first_tick) / self._timescale
            self._pipe.write(_matroska_block(round(elapsed / _TICK_S), image.nbytes))
            self._pipe.write(np.ascontiguousarray(image).reshape(-1).data)
        except OSError as error:
            raise self._failure(error) from error
        self._last_tick = tick
        self._frames += 1

    def close(self) -> None:
        """Finish the file and put it at `path`; closing again does nothing. Without any frame there is no file."""
        if self._frames == 0:
            self.discard()
        if self._closed:
            return
        self._closed = True
        try:
            try:
                self._end_encoder()
            except OutputError:
                raise
            except BaseException:  # the encoder needs only a moment more; a second interruption drops the video
                with contextlib.suppress(OutputError):
                    self._end_encoder()
                raise
            self._add_audio()
        finally:
            whole = self._encoder.child.poll() == 0
            self._drop(keep=whole)
            if whole and self._replace:
                try:
                    publish(self.path)
                    self.published = True
                except OSError as error:
                    discard(self.path)
                    raise OutputError(f"{self.path}: {reason(error)}; choose another output folder") from error

    def discard(self) -> None:
        """Stop the encoder and leave no file, whatever stood at `path` before stays; does nothing once closed."""
        if not self._closed:
            self._closed = True
            self._drop()

    def __exit__(self, *_: object) -> None:
        self.close()  # what was written until an interruption is kept too

    @property
    def _target(self) -> Path:
        return beside(self.path)

    @property
    def _pipe(self) -> IO[bytes]:
        assert self._encoder.child.stdin is not None
        return self._encoder.child.stdin

    def _command(self) -> list[str]:
        matrix = "bt709" if self.size[1] >= 720 else "smpte170m"  # as players assume where they ignore the tag
        filters = [
            "pad=ceil(iw/2)*2:ceil(ih/2)*2",
            f"scale=out_color_matrix={matrix}:out_range=tv:flags=bicubic+accurate_rnd",  # else 2 levels darker
            "format=yuv420p",
            f"setparams=colorspace={matrix}:color_primaries={matrix}:color_trc={matrix}:range=tv",
        ]
        large = self.size[0] * self.size[1] > _LARGE
        command = ["-nostats", "-v", "error", "-y", *("-thread_queue_size", "1") * large, "-f", "matroska", "-i", "-"]
        # superfast takes 0.8 of the time of this preset and makes files twice as large, faster takes twice its time
        command += ["-vf", ",".join(filters), "-c:v", "libx264", "-preset", "veryfast", "-crf", "20"]
        if large:
            command += ["-threads", "3", "-x264-params", "sync-lookahead=0:rc-lookahead=2:bframes=1:ref=1"]
        command += ["-fps_mode", "passthrough", "-enc_time_base", f"1/{self._timescale}"]
        return [*command, *self._as_mp4(self._target)]

    def _as_mp4(self, path: Path) -> list[str]:
        options = ["-video_track_timescale", str(self._timescale), "-movflags", "+faststart", "-f", "mp4"]
        return [*options, ffmpeg.source_argument(path)]

    def _add_audio(self) -> None:
        """Add the source's sound to the video just written; without it, a warning."""
        source, silent = self._audio_from, self._target
        if source is None or not source.is_file():
            return
        mixed = silent.with_suffix(".audio.mp4")
        try:
            _, codec, _ = ffmpeg.contents(source)
            if not codec:
                return
            # our clock starts at the source's first frame, ffmpeg's at whatever comes first
            start = self._first_s + ffmpeg.first_time(source)
            length = float((self._last_tick - self._first_tick) / Fraction(self._timescale) + 1 / self._fps)
            command = ["-v", "error", "-y", "-i", ffmpeg.source_argument(silent)]
            command += ["-itsoffset", f"{-start:.6f}", "-i", ffmpeg.source_argument(source)]
            command += ["-map", "0:v:0", "-map", "1:a:0", "-map_metadata", "-1", "-c:v", "copy"]
            # copying drops what comes before time 0 by itself
            recode = ["-af", "atrim=start=0", "-c:a", "aac", "-b:a", "160k"]
            command += ["-c:a", "copy"] if codec in _COPIED_AUDIO else recode
            code, said = ffmpeg.run([*command, "-t", f"{length:.6f}", *self._as_mp4(mixed)])
            if code:
                raise RuntimeError(ffmpeg.cause(said))
            mixed.replace(silent)
        except (OSError, RuntimeError, ValueError) as error:
            why = reason(error)
            self.warnings.append(f"{self.path}: written without sound, that of {source} cannot be used ({why})")
        finally:
            mixed.unlink(missing_ok=True)

    def _end_encoder(self) -> None:
        try:
            self._pipe.close()
        except OSError as error:
            raise self._failure(error) from error
        if self._encoder.child.wait() != 0:
            raise self._failure(None)

    def _failure(self, error: OSError | None) -> OutputError:
        """What to raise once the encoder has failed: its own words, where it left any."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._pipe.close()
        code, said = self._encoder.child.wait(), ffmpeg.cause(self._encoder.messages())
        self._drop()
        remedy = "free some space"
        if not said and code:
            said = f"ffmpeg was killed by signal {-code}" if code < 0 else f"ffmpeg ended with code {code}"
            remedy = "run it again"
        said = said or (reason(error) if error else "ffmpeg ended early")
        return OutputError(f"{self.path}: the video cannot be written ({said}); {remedy} or use --no-video")

    def _drop(self, *, keep: bool = False) -> None:
        """End the encoder, and unless `keep` remove the file."""
        self._encoder.__exit__()
        if not keep:
            discard(self.path)


# Just enough of Matroska (RFC 9559) for one track of uncompressed BGR frames, each with a time


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
