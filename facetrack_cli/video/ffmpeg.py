"""Questions put to the ffmpeg program that imageio-ffmpeg carries: what a file holds, how much of it can be read."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import imageio_ffmpeg

# what demuxers say when data ends early or is not what the index promised
_DAMAGE = re.compile(
    r"partial file|ended prematurely|packet corrupt|corrupt input packet|invalid as first byte|"
    r"exceeds (?:max length|containing)|truncat",
    re.IGNORECASE,
)
_CAUSE = re.compile(
    r"No space left on device|Disk quota exceeded|File too large|Read-only file system|Input/output error|"
    r"Permission denied"
)
_PREFIX = re.compile(r"^(?:\[[^\]]*\] )+")
_NO_TIME = str(-(2**63))  # how framecrc prints a packet without a time stamp
_DURATION = re.compile(r"^  Duration: (\d+):(\d+):(\d+\.\d+)", re.MULTILINE)


def executable() -> str:
    """The path of the ffmpeg program; RuntimeError when there is none."""
    return str(imageio_ffmpeg.get_ffmpeg_exe())


def source_argument(path: Path) -> str:
    """The path as ffmpeg and OpenCV must be given it: absolute, so that no name reads as an option or a protocol."""
    return str(path.absolute())


def cause(text: str) -> str:
    """The cause of a failure in ffmpeg's messages: the system's word if there is one, else their last line."""
    system = _CAUSE.search(text)
    if system:
        return system.group()
    lines = [_PREFIX.sub("", line).strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Last message repeated", "Conversion failed"))]
    return lines[-1] if lines else ""


def run(arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run ffmpeg to its end, out of reach of the terminal's Ctrl-C; its output is text."""
    return subprocess.run(
        [executable(), "-nostdin", "-hide_banner", *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
        start_new_session=True,
    )


@dataclass(frozen=True, slots=True)
class Contents:
    """What a file holds: whether there are moving pictures, the codec of the first sound, and ffmpeg's words."""

    video: bool
    audio: str | None
    messages: str


def contents(path: Path) -> Contents:
    """Look at the head of a file. Never raises for what the file holds."""
    text = run(["-i", source_argument(path)]).stderr
    streams = re.findall(r"^  Stream #0:\d+.*?: (Video|Audio): (\w+)(.*)$", text, re.MULTILINE)
    video = any(kind == "Video" and "(attached pic)" not in rest for kind, _, rest in streams)
    audio = next((codec for kind, codec, _ in streams if kind == "Audio"), None)
    return Contents(video, audio, text)


@dataclass(frozen=True, slots=True)
class Packets:
    """What reading a file to its end, without decoding, has shown. Times in seconds.

    `duration_s` is what the container claims, None when it claims nothing; `video_s` the time from the first picture
    to the last; `video_start_s` and `end_s` count from the container's start, `end_s` over pictures and sound.
    `damage` is what ffmpeg said of missing or broken data, "" if nothing.
    """

    duration_s: float | None
    video_start_s: float
    video_s: float
    end_s: float
    damage: str


def packets(path: Path, *, first_only: bool = False) -> Packets:
    """Read all packets of a file, or only the first picture's; memory stays flat."""
    command = [executable(), "-nostdin", "-hide_banner", "-i", source_argument(path)]
    command += ["-map", "0:v:0", *(["-frames:v", "1"] if first_only else ["-map", "0:a?"])]
    command += ["-c", "copy", "-f", "framecrc", "-"]
    start, last, end = 0.0, 0.0, 0.0
    seen = False
    ticks: dict[str, float] = {}
    # a file, not a pipe: nobody has to empty it while the packets are read
    with (
        tempfile.TemporaryFile() as messages,
        subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=messages,
            text=True,
            start_new_session=True,
        ) as child,
    ):
        assert child.stdout is not None
        try:
            for line in child.stdout:
                if line.startswith("#tb "):
                    stream, _, base = line[4:].partition(":")
                    ticks[stream] = float(Fraction(base.strip()))
                elif not line.startswith("#"):
                    stream, dts, pts, duration = [field.strip() for field in line.split(",")[:4]]
                    tick = ticks[stream]
                    stamp = pts if pts != _NO_TIME else dts
                    if stamp == _NO_TIME:
                        continue
                    time = int(stamp) * tick
                    end = max(end, time + int(duration) * tick)
                    if stream == "0" and time > -0.0005:  # what an edit list hides comes before 0
                        start = time if not seen else min(start, time)
                        last = time if not seen else max(last, time)
                        seen = True
        except BaseException:
            child.kill()
            raise
        child.wait()
        messages.seek(0)
        text = messages.read().decode("utf-8", "replace")
    claimed = _DURATION.search(text)
    duration_s = None
    if claimed:
        hours, minutes, seconds = claimed.groups()
        duration_s = int(hours) * 3600 + int(minutes) * 60 + float(seconds)
    damage = next((_PREFIX.sub("", line) for line in text.splitlines() if _DAMAGE.search(line)), "")
    damage = re.sub(r" \(.*?\)", "", damage).strip(" .")
    return Packets(duration_s, start, last - start, end, damage)
