"""The ffmpeg program of imageio-ffmpeg: what a file holds, and its packets, which are read without decoding."""

import contextlib
import math
import re
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import imageio_ffmpeg

KEY, CORRUPT, DISCARD = 1, 2, 4  # libavcodec's flags of a packet
# what demuxers say when data ends early or differs from the index
_DAMAGE = re.compile(
    r"(?i)partial file|ended prematurely|packet corrupt|corrupt input packet|invalid as first byte|"
    r"exceeds (?:max length|containing)|truncat"
)
_CAUSE = re.compile(
    "No space left on device|Disk quota exceeded|File too large|Read-only file system|Input/output error|"
    "Permission denied"
)
_PREFIX = re.compile(r"^(?:\[[^\]]*\] )+")
TS_PACKET = 188  # bytes
_AVI_INDEX = 1 << 26  # bytes at the end of an AVI file in which its index is looked for
NO_TIME = -(2**63)
_DURATION = re.compile(r"^  Duration: (\d+):(\d+):(\d+\.\d+)(?:, start: (-?\d+\.\d+))?", re.MULTILINE)
_OPENH264 = re.compile(r"Video: h264 \((?:Constrained Baseline|Main|High)\).*yuv420p\([^)]*progressive\)")


def source_argument(path: Path) -> str:
    """The path as ffmpeg and OpenCV must be given it: absolute, so that no name reads as an option or a protocol."""
    return str(path.absolute())


def cause(text: str) -> str:
    """The cause of a failure in ffmpeg's messages: the error of the system if there is one, else their last line."""
    system = _CAUSE.search(text)
    lines = [_PREFIX.sub("", line).strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Last message repeated", "Conversion failed"))]
    return system.group() if system else "".join(lines[-1:])


class Program(contextlib.AbstractContextManager["Program"]):
    """A running ffmpeg, which the terminal's Ctrl-C does not reach. OSError or RuntimeError if it cannot be started."""

    def __init__(self, arguments: Sequence[str], *, stdin: int = subprocess.DEVNULL, stdout: int = subprocess.DEVNULL):
        words = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-hide_banner", *arguments]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - a file and not a pipe, which somebody would have to empty
        try:
            self.child = subprocess.Popen(words, stdin=stdin, stdout=stdout, stderr=self._said, start_new_session=True)
        except BaseException:
            self._said.close()
            raise

    def messages(self) -> str:
        """What it has printed to stderr, once it has ended."""
        self.child.wait()
        self._said.seek(0)
        return self._said.read().decode("utf-8", "replace")

    def __exit__(self, *_: object) -> None:
        self.child.kill()  # harmless where it has ended
        with contextlib.suppress(OSError):  # what a pipe still held is lost
            self.child.__exit__(None, None, None)  # closes the pipes and waits
        self._said.close()


def run(arguments: Sequence[str]) -> tuple[int, str]:
    """Run ffmpeg to its end: exit code and messages."""
    with Program(arguments) as program:
        return program.child.wait(), program.messages()


def contents(path: Path) -> tuple[str, str, str]:
    """The codecs of the first video and audio stream of a file, "" if there is none, and what ffmpeg says of it."""
    text = run(["-i", source_argument(path)])[1]
    streams = re.findall(r"^  Stream #0:\d+.*?: (Video|Audio): (\w+)(.*)$", text, re.MULTILINE)
    video = [codec for kind, codec, rest in streams if kind == "Video" and "(attached pic)" not in rest]
    audio = [codec for kind, codec, _ in streams if kind == "Audio"]
    return next(iter(video), ""), next(iter(audio), ""), text


def strict_decoder(path: Path) -> str:
    """A decoder that notices more errors of this file than FFmpeg's own does; "" if there is none."""
    source = ["-i", source_argument(path)]
    if not _OPENH264.search(run(source)[1]):
        return ""
    first = ["-v", "quiet", *source, "-map", "0:v:0", "-c", "copy", "-frames:v", "1", "-f", "h264", "-"]
    with Program(first, stdout=subprocess.PIPE) as program:
        assert program.child.stdout is not None
        data = program.child.stdout.read()
    # where the first picture is not one at which all begins anew, those after it may lack what they are predicted from
    units = [data[at.end()] & 31 for at in re.finditer(rb"(?s)\x00\x00\x01(?=.)", data)]
    return "libopenh264" if 5 in units else ""


class Packet(NamedTuple):
    """One packet; times of decoding and of showing in ticks, or NO_TIME. After a `new_header` sizes may change."""

    stream: int
    dts: int
    pts: int
    duration: int
    flags: int
    new_header: bool


class Listing:
    """The packets of ffmpeg with these arguments, iterable once; then `messages`. `ticks` are in seconds, by stream."""

    def __init__(self, *arguments: str) -> None:
        self._arguments = arguments
        self.ticks: dict[int, Fraction] = {}
        self.messages = ""

    def __iter__(self) -> Iterator[Packet]:
        with Program([*self._arguments, "-f", "framecrc", "-"], stdout=subprocess.PIPE) as program:
            assert program.child.stdout is not None
            for line in program.child.stdout:
                if line.startswith(b"#tb "):
                    stream, _, tick = line[4:].decode().partition(":")
                    self.ticks[int(stream)] = Fraction(tick.strip())
                elif not line.startswith(b"#"):
                    fields = line.split(b",")
                    # the flags of a packet that is a key and nothing else are left out
                    has_flags = len(fields) > 6 and fields[6].startswith(b" F=0x")
                    flags = int(fields[6].strip()[4:], 16) if has_flags else KEY
                    number, dts, pts, duration = map(int, fields[:4])
                    yield Packet(number, dts, pts, duration, flags, b"New Extradata" in line)
            self.messages = program.messages()

    def time(self, packet: Packet) -> float:
        """When a packet is shown, in seconds; -inf if unknown."""
        stamp = packet.dts if packet.pts == NO_TIME else packet.pts
        return -math.inf if stamp == NO_TIME else stamp * float(self.ticks[packet.stream])


def ending(path: Path) -> tuple[float, float, float, str]:
    """What reading all packets of a file shows, without decoding them; memory stays flat.

    In seconds: the duration that the container claims, or 0; the time from the first frame to the last; the end of
    video and audio, from the container's start. Then what ffmpeg said of missing or broken data, or "".
    """
    listing = Listing("-i", source_argument(path), "-map", "0:v:0", "-map", "0:a?", "-c", "copy")
    first, last, end, pictures = math.inf, -math.inf, 0.0, 0
    for packet in listing:
        pictures += packet.stream == 0
        time, tick = listing.time(packet), listing.ticks[packet.stream]
        end = max(end, time + packet.duration * float(tick))
        if packet.stream == 0 and time > -0.0005:  # what an edit list hides comes before 0
            first, last = min(first, time), max(last, time)
    claimed = _DURATION.search(listing.messages)
    hours, minutes, seconds, start = map(float, claimed.groups("0") if claimed else (0, 0, 0, 0))
    if container(path) == "matroska":  # whose duration is the time at which it ends, also where it begins late
        end += max(start, 0.0)
    damage = next((_PREFIX.sub("", line) for line in listing.messages.splitlines() if _DAMAGE.search(line)), "")
    damage = re.sub(r" \(.*?\)", "", damage).strip(" .")
    if not damage and (indexed := _avi_index(path)) > pictures:
        damage = f"{indexed - pictures} frames of its index are missing"
    if not damage and container(path) == "ts":
        damage = _unmarked(path)
    return hours * 3600 + minutes * 60 + seconds, max(last - first, 0.0), end, damage


def first_time(path: Path) -> float:
    """When the first frame of a file is shown, in seconds from the container's start."""
    listing = Listing("-i", source_argument(path), "-map", "0:v:0", "-frames:v", "1", "-c", "copy")
    return max((listing.time(packet) for packet in listing), default=0.0)


def _avi_index(path: Path) -> int:
    """How many packets of video the index of an AVI file names, without empty ones, which repeat a frame; 0 if none."""
    if container(path) != "avi":
        return 0
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - _AVI_INDEX, 0))
        _, found, index = file.read().rpartition(b"idx1")
    entries = range(4, min(len(index), 4 + int.from_bytes(index[:4], "little")) - 15, 16)
    names = [index[at : at + 4] for at in entries if any(index[at + 12 : at + 16])]
    return max((names.count(name) for name in {*names} if name[2:] in (b"dc", b"db")), default=0) if found else 0


def _unmarked(path: Path) -> str:
    """What is wrong with the packets of a transport stream, which all begin with one mark; "" if nothing is."""
    with path.open("rb") as file:
        while block := file.read(TS_PACKET << 12):
            if len(block) % TS_PACKET:
                return "it ends within a packet"
            if block[::TS_PACKET].count(b"G") < len(block) // TS_PACKET:
                return "a packet lacks its mark"
    return ""


def container(path: Path) -> str:
    """A file's format by its first bytes: "mp4", "avi", "matroska", "mpeg" (program stream), "ts" (transport) or ""."""
    with path.open("rb") as file:
        head = file.read(2 * TS_PACKET + 1)
    if head[::TS_PACKET] == b"GGG":
        return "ts"
    if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide"):
        return "mp4"
    families = {b"RIFF": "avi", b"\x1a\x45\xdf\xa3": "matroska", b"\x00\x00\x01\xba": "mpeg"}
    return families.get(head[:4], "")
