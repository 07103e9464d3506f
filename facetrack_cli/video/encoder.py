"""Frames into a file by ffmpeg: H.264, yuv420p, each frame with its own time.

To carry the times, the frames go to ffmpeg as uncompressed Matroska; a raw pipe (`imageio_ffmpeg.write_frames`) has no
place for them. They go as the planes that H.264 holds: half the bytes of BGR, and ffmpeg converts nothing.
"""

import contextlib
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import IO

import cv2
import numpy as np

from facetrack_cli.core.errors import OutputError, reason
from facetrack_cli.core.types import Array, Image
from facetrack_cli.video import ffmpeg

_TICK_S = 1e-6  # of the pipe to the encoder
_LARGE = 3_000_000  # pixels of a frame of which the encoder holds few others, each of which takes it 60 MB
_STRIP = 1 << 18  # pixels that are converted at a time, which bounds memory


class Encoder:
    """Encodes frames of `size` into the MP4 `target`, which errors call `path`. OutputError if that is not possible.

    `timescale` are the ticks a second of the file's clock, `aspect` is the width of a pixel over its height.
    """

    def __init__(
        self, path: Path, target: Path, size: tuple[int, int], fps: Fraction, timescale: int, aspect: Fraction
    ) -> None:
        self.target, self._path, self._fps, self._timescale = target, path, fps, timescale
        self._aspect = aspect.limit_denominator(255)
        self._planes, self._begun = Planes(size), False
        try:
            target.open("wb").close()
        except OSError as error:
            raise OutputError(f"{path}: {reason(error)}; choose another output folder") from error
        try:
            self.program = ffmpeg.Program(self._command(), stdin=subprocess.PIPE)
        except (OSError, RuntimeError) as error:
            target.unlink(missing_ok=True)
            raise OutputError(f"{path}: ffmpeg cannot be started ({reason(error)})") from error
        with contextlib.suppress(ImportError, AttributeError, OSError):  # a larger pipe: fewer context switches a frame
            import fcntl

            fcntl.fcntl(self.pipe, fcntl.F_SETPIPE_SZ, 1 << 20)  # type: ignore[attr-defined,unused-ignore]

    def write(self, image: Image, elapsed_s: float) -> None:
        """Append one frame, shown so long after the first one."""
        try:
            if not self._begun:
                self._begun = True
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

    def drop(self) -> None:
        """End the program; a file that is not finished is removed."""
        whole = self.whole
        self.program.__exit__()
        if not whole and self.target.is_file():
            self.target.unlink(missing_ok=True)

    @property
    def whole(self) -> bool:
        """Whether the file is finished."""
        return self.program.child.poll() == 0

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
        # superfast with the macroblock tree that it leaves out takes 0.5 to 0.7 of the time of veryfast, and its files
        # are a tenth larger; a lookahead in a thread of its own makes other bytes now and then of the same frames
        command += ["-vf", tags, "-c:v", "libx264", "-preset", "superfast", "-crf", "20"]
        few = "rc-lookahead=2:bframes=0:ref=1:sliced-threads=1" if large else "rc-lookahead=10"
        command += [*("-threads", "3") * large, "-x264-params", f"sync-lookahead=0:mbtree=1:{few}"]
        command += ["-fps_mode", "passthrough", "-enc_time_base", f"1/{self._timescale}"]
        return [*command, *as_mp4(self.target, self._timescale)]

    def _failure(self, error: OSError | None) -> OutputError:
        """What to raise once the encoder has failed: its own words, where it left any."""
        with contextlib.suppress(OSError):
            self.pipe.close()
        code, said = self.program.child.wait(), ffmpeg.cause(self.program.messages())
        self.drop()
        remedy = "free some space"
        if not said and code:
            said = f"ffmpeg was killed by signal {-code}" if code < 0 else f"ffmpeg ended with code {code}"
            remedy = "run it again"
        said = said or (reason(error) if error else "ffmpeg ended early")
        return OutputError(f"{self._path}: the video cannot be written ({said}); {remedy} or use --no-video")


def as_mp4(path: Path, timescale: int) -> list[str]:
    """ffmpeg's arguments for an MP4 at `path` whose clock has so many ticks a second."""
    options = ["-video_track_timescale", str(timescale), "-movflags", "+faststart", "-f", "mp4"]
    return [*options, ffmpeg.source_argument(path)]


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


def weights(red: float, blue: float) -> Array:
    """(3, 4): Y, Cb and Cr of limited range by blue, green, red, 1; given the luma weights of red and blue (H.273)."""
    luma = np.array([blue, 1 - red - blue, red])
    cb, cr = (np.array([1, 0, 0]) - luma) / (1 - blue) / 2, (np.array([0, 0, 1]) - luma) / (1 - red) / 2
    scaled = np.stack([219 * luma, 224 * cb, 224 * cr]) / 255
    return np.column_stack([scaled, [16, 128, 128]])


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
