"""Small clips for tests, rendered on the spot by the ffmpeg program that imageio-ffmpeg carries.

Frames carry their number in eight vertical bars, one bit each, which survives any compression: `numbered`, `number`.
"""

from __future__ import annotations

import hashlib
import itertools
import subprocess
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Size = tuple[int, int]
SIZE: Size = (64, 48)

OPUS = ("-c:a", "libopus")
# by suffix: an encoder for images, one for sound, and what it takes to make them small and quick
CODECS = {
    ".mp4": ("-c:v", "libx264", "-preset", "ultrafast", "-c:a", "aac", "-movflags", "+faststart"),
    ".mov": ("-c:v", "mjpeg", "-q:v", "3", "-c:a", "pcm_s16le"),
    ".mkv": ("-c:v", "libx264", "-preset", "ultrafast", "-c:a", "aac"),
    ".webm": (*("-c:v", "libvpx", "-deadline", "realtime", "-cpu-used", "8", "-threads", "1", "-b:v", "1M"), *OPUS),
    ".avi": ("-c:v", "mpeg4", "-q:v", "3", "-c:a", "mp3"),
    ".mpg": ("-c:v", "mpeg1video", "-q:v", "3", "-c:a", "mp2"),
    ".ts": ("-c:v", "libx264", "-preset", "ultrafast", "-c:a", "aac"),
}


_WRITTEN: dict[tuple[object, ...], bytes] = {}  # clips by all that they are made of


def ffmpeg(*arguments: str | Path, stdin: bytes | None = None) -> bytes:
    """Run ffmpeg; its standard output. Raises with its messages if it fails."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-v", "error", "-y", *map(str, arguments)]
    done = subprocess.run(command, input=stdin or b"", capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode("utf-8", "replace")
    return done.stdout


def numbered(index: int, size: Size = SIZE) -> Image:
    """An image that says which frame (0..255) it is; its grain spreads a clip's bytes evenly over its frames."""
    width, height = size
    bits = (index >> (np.arange(width) * 8 // width)) & 1
    row = np.where(bits == 1, 200, 20).astype(np.uint8)
    grain = np.random.default_rng(index).integers(0, 50, (height, width, 1), dtype=np.uint8)
    return np.repeat(row[None, :, None] + grain, 3, axis=2)


def number(image: Image) -> int:
    """The number that `numbered` put into an image."""
    height, width = image.shape[:2]
    centres = (np.arange(8) * 2 + 1) * width // 16
    bars = image[height // 4 : height * 3 // 4, centres].mean(axis=(0, 2))
    return int(((bars > 128) << np.arange(8)).sum())


def write_video(
    path: Path,
    *,
    frames: int | Iterable[Image] = 24,
    size: Size = SIZE,
    fps: Fraction | int = 25,
    times: Sequence[float] | None = None,
    sound: str | None = None,
    sound_delay_s: float = 0.0,
    options: Sequence[str] = (),
) -> Path:
    """Write a clip in the container that the suffix names; `frames` is how many numbered ones, or the images.

    `times` (s) makes the rate variable. `sound` is an expression of `t` for ffmpeg's aevalsrc, as long as the images;
    it starts `sound_delay_s` after them, or before them if negative. `options` go last, before the output. A small clip
    that was written before in this process is written again without an encoder.
    """
    pictures = [numbered(index, size) for index in range(frames)] if isinstance(frames, int) else list(frames)
    raw = b"".join(picture.tobytes() for picture in pictures)
    made_of = hashlib.sha256(raw).digest(), pictures[0].shape, fps, str(times), sound, sound_delay_s
    key = (path.suffix, *made_of, *options)
    if key in _WRITTEN:
        path.write_bytes(_WRITTEN[key])
        return path
    height, width = pictures[0].shape[:2]
    rate = Fraction(fps) if times is None else Fraction(1000)
    command: list[str | Path] = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", f"{width}x{height}"]
    command += ["-framerate", str(rate), "-i", "-"]
    length = len(pictures) / rate if times is None else times[-1] + 0.04
    if sound is not None:
        command += ["-itsoffset", str(sound_delay_s), "-f", "lavfi"]
        command += ["-i", f"aevalsrc='{sound}':d={float(length)}:s=44100"]
    command += ["-pix_fmt", "yuvj420p" if path.suffix == ".mov" else "yuv420p", *CODECS[path.suffix]]
    if times is not None:
        steps = "+".join(f"{b - a:.6f}*gte(N,{k + 1})" for k, (a, b) in enumerate(itertools.pairwise(times)))
        command += ["-vf", f"setpts='({times[0]}+{steps})/TB'", "-fps_mode", "passthrough", "-enc_time_base", "1/1000"]
    ffmpeg(*command, *options, path, stdin=raw)
    if path.is_file() and path.stat().st_size < 1 << 20:
        _WRITTEN[key] = path.read_bytes()
    return path


def write_pictures(
    folder: Path,
    frames: int | Iterable[Image] = 12,
    *,
    size: Size = SIZE,
    name: Callable[[int], str] = "{}.png".format,
) -> Path:
    """Write a folder of images, by default 0.png, 1.png, ..., 10.png without leading zeros."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [numbered(index, size) for index in range(frames)] if isinstance(frames, int) else frames
    for index, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / name(index)), picture)
    return folder


def rotated(source: Path, target: Path, degrees: int) -> Path:
    """A copy with rotation metadata: to be shown turned by so many degrees against the clock."""
    ffmpeg("-display_rotation:v:0", str(degrees), "-i", source, "-c", "copy", target)
    return target


def cut(source: Path, target: Path, share: float) -> Path:
    """The first `share` of a file's bytes, as an interrupted download leaves them."""
    data = source.read_bytes()
    target.write_bytes(data[: int(len(data) * share)])
    return target


def without_moov(target: Path) -> Path:
    """An MP4 whose recording was interrupted before the index was written."""
    whole = write_video(target.with_suffix(".whole.mp4"), options=("-movflags", "-faststart"))
    data = whole.read_bytes()
    at = data.rindex(b"moov") - 4
    target.write_bytes(data[:at])
    whole.unlink()
    return target


def sound_only(path: Path) -> Path:
    """A second of sound without images (.m4a, .mp4, .wav)."""
    ffmpeg("-f", "lavfi", "-i", "sine=frequency=440:duration=1", path)
    return path


def read_sound(path: Path) -> NDArray[np.float64]:
    """The first sound of a file, (samples,) at 44,100 Hz in -1..1, with silence where it starts late."""
    raw = ffmpeg(
        "-i", path, "-map", "0:a:0", "-af", "aresample=44100:async=1:first_pts=0", "-ac", "1", "-f", "s16le", "-"
    )
    return np.frombuffer(raw, np.int16) / 32768.0


def read_timed(path: Path) -> list[tuple[float, Image]]:
    """All images of a file as ffmpeg decodes them, each with its time in seconds."""
    every = ("-i", path, "-map", "0:v:0", "-fps_mode", "passthrough", "-enc_time_base", "demux")
    info = ffmpeg(*every, "-f", "framehash", "-").decode()
    base = next(Fraction(line.split(":")[1].strip()) for line in info.splitlines() if line.startswith("#tb 0"))
    width, height = next(
        tuple(int(n) for n in line.split(":")[1].split("x")) for line in info.splitlines() if "#dimensions 0" in line
    )
    times = [float(int(line.split(",")[2]) * base) for line in info.splitlines() if line and line[0] == "0"]
    raw = ffmpeg(*every, "-f", "rawvideo", "-pix_fmt", "bgr24", "-")
    pictures = np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)
    assert len(times) == len(pictures)
    return list(zip(times, pictures, strict=True))
