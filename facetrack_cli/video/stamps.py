"""When each picture of a video is shown, read off its packets, which takes much less time than decoding them.

Packets and pictures go together if every packet has a presentation time of its own and gives one picture. Where that
cannot be told for sure there are no stamps, and frames have to be counted by decoding. What is not noticed: a picture
that is damaged while its headers are whole, and a change of size within a stream.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
import threading
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import IO, TypeVar

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array
from facetrack_cli.video import ffmpeg

_Found = TypeVar("_Found")
_KEY, _CORRUPT, _DISCARD = 1, 2, 4  # libavcodec's flags of a packet
_REORDERED = 64  # no codec shows a picture so many packets before or after its turn
_NO_TIME = -(2**63)
# harmless: what is said of a stream that begins in the middle, and of a file whose end is missing
_CUT = re.compile(r"partial file|ended prematurely")
_HARMLESS = re.compile(rf"non-existing [SP]PS|no frame!|message repeated|{_CUT.pattern}")
# these filters change nothing, but parse the headers of every picture and complain of those that make no sense
_CHECKS = {
    "h264": "h264_metadata",
    "hevc": "hevc_metadata",
    "av1": "av1_metadata",
    "mpeg2video": "mpeg2_metadata",
}


@dataclass(frozen=True, eq=False)
class Stamps:
    """Of each picture, in the order in which they are shown, `positions` (T,): its time in seconds as OpenCV tells it.

    `keys` (M,) are the pictures at which decoding can begin, `entries` (M,) the position to seek to for each of them.
    `indexed`: the container knows its keys, so that seeking to an entry or a bit later arrives at it; else only seeking
    to a bit earlier does, and decoding starts before the key. `counted`: it knows their number, and OpenCV ends there.
    """

    positions: Array
    keys: NDArray[np.int64]
    entries: Array
    indexed: bool
    counted: bool


class Reader:
    """Reads the packets of one video; `stop` may be called from another thread and makes `read` return None."""

    def __init__(self, path: Path):
        self._path = path
        self._child: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._stopped = False

    def stop(self) -> None:
        with self._lock:
            self._stopped = True
            if self._child is not None:
                self._child.kill()

    def read(self, first_position: float) -> Stamps | None:
        """The stamps of a video whose first picture OpenCV places at `first_position`; None if there are none to trust.

        Memory is a few bytes a picture. Raises OSError, RuntimeError or ValueError when ffmpeg cannot be asked.
        """
        found = re.search(r"^  Stream #0:\d+.*?: Video: (\w+)", ffmpeg.contents(self._path).messages, re.MULTILINE)
        if found is None:
            return None
        codec = found.group(1)
        first = self._run(("-frames:v", "1", "-fps_mode", "passthrough", "-enc_time_base", "demux"), _first_picture)[0]
        check = ("-bsf:v", _CHECKS[codec]) if codec in _CHECKS else ()
        packets, messages = self._run(("-copyinkf", "-c", "copy", *check), _packets)
        if codec in ("vp8", "vp9") and packets is not None:
            shown, _ = self._run(("-copyinkf", "-c", "copy"), lambda pipe: _shown(pipe, codec), "ivf")
            packets = packets.only(shown)
        if self._stopped or first is None or packets is None:
            return None
        if any(line.strip() and not _HARMLESS.search(line) for line in messages.splitlines()):
            if not check or not _CUT.search(messages):
                return None
            # of a file whose end is missing the last packet may make no sense, but no other
            plain, messages = self._run(("-copyinkf", "-c", "copy"), _packets)
            if plain is None or not np.array_equal(plain.pts[:-1], packets.pts[: len(plain.pts) - 1]):
                return None
        with self._path.open("rb") as file:
            head = file.read(12)
        return _stamps(packets, first, first_position, head)

    def _run(
        self, options: Sequence[str], read: Callable[[IO[bytes]], _Found], form: str = "framecrc"
    ) -> tuple[_Found, str]:
        """What `read` makes of ffmpeg's output, and the errors that it reports."""
        command = [ffmpeg.executable(), "-nostdin", "-v", "error", "-copyts", "-i", ffmpeg.source_argument(self._path)]
        command += ["-map", "0:v:0", *options, "-f", form, "-"]
        # a file, not a pipe: nobody has to empty it while the packets are read
        with tempfile.TemporaryFile() as messages:
            with self._lock:
                if self._stopped:
                    raise ValueError("stopped")
                self._child = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=messages,
                    start_new_session=True,
                )
            with self._child as child:
                assert child.stdout is not None
                try:
                    found = read(child.stdout)
                except BaseException:
                    child.kill()
                    raise
            messages.seek(0)
            return found, messages.read().decode("utf-8", "replace")


@dataclass(frozen=True, eq=False)
class _Packets:
    """In the order of decoding (T,): time of showing and of decoding in ticks of `base` seconds, libavcodec's flags."""

    base: Fraction
    pts: NDArray[np.int64]
    dts: NDArray[np.int64]
    flags: NDArray[np.uint8]

    def only(self, shown: NDArray[np.bool_]) -> _Packets | None:
        if len(shown) != len(self.pts):
            return None
        return _Packets(self.base, self.pts[shown], self.dts[shown], self.flags[shown])


def _first_picture(pipe: IO[bytes]) -> Fraction | None:
    """When the first picture that can be decoded is shown."""
    base = None
    first = None
    for line in pipe:
        if line.startswith(b"#tb 0:"):
            base = Fraction(line[6:].decode().strip())
        elif not line.startswith(b"#") and base is not None and first is None:
            first = int(line.split(b",")[2]) * base
    return first


def _packets(pipe: IO[bytes]) -> _Packets | None:
    pts, dts, flags = array("q"), array("q"), array("B")
    base: Fraction | None = None
    for line in pipe:
        if line.startswith(b"#"):
            if line.startswith(b"#tb 0:"):
                base = Fraction(line[6:].decode().strip())
            continue
        fields = line.split(b",")
        dts.append(int(fields[1]))
        pts.append(int(fields[2]))
        # framecrc leaves out the flags of a packet that is a key and nothing else
        has = len(fields) > 6 and fields[6].startswith(b" F=0x")
        flags.append(int(fields[6].strip()[4:], 16) & 255 if has else _KEY)
        if len(flags) > 1 and b"New Extradata" in line:  # from here on the pictures may be of another size
            return None
    if base is None or not pts:
        return None
    return _Packets(base, np.array(pts, np.int64), np.array(dts, np.int64), np.array(flags, np.uint8))


def _shown(pipe: IO[bytes], codec: str) -> NDArray[np.bool_]:
    """Which packets of an IVF stream hold a picture that is shown; VP8 and VP9 have others, to predict from."""
    shown = bytearray()
    pipe.read(32)
    while len(header := pipe.read(12)) == 12:
        data = pipe.read(int.from_bytes(header[:4], "little"))
        if not data:
            shown.append(False)
        elif codec == "vp8":
            shown.append(bool(data[0] & 0x10))
        else:  # several in one packet, one of which is shown; one that was decoded before; one that is shown
            shown.append(data[-1] & 0xE0 == 0xC0 or bool(data[0] & 0x08) or bool(data[0] & 0x02))
    return np.frombuffer(bytes(shown), bool)


def _stamps(packets: _Packets, first: Fraction, first_position: float, head: bytes) -> Stamps | None:
    flags = packets.flags
    kept = (flags & _DISCARD) == 0  # what an edit list hides is decoded, but not shown
    start = first / packets.base
    if start.denominator != 1 or _NO_TIME in packets.pts[kept] or (flags[:-1] & _CORRUPT).any():
        return None
    kept &= packets.pts >= int(start)  # before it are pictures that lack what they are predicted from
    pts, dts, key = packets.pts[kept], packets.dts[kept], (flags[kept] & _KEY) != 0
    order = np.argsort(pts, kind="stable")
    steps = np.diff(pts[order])
    if not len(pts) or (steps == 0).any() or np.abs(order - np.arange(len(order))).max() > _REORDERED:
        return None
    counted = head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide") or head.startswith(b"RIFF")  # MP4, AVI
    indexed = counted or head.startswith(b"\x1a\x45\xdf\xa3")  # Matroska
    if not indexed and len(steps) and steps.min() < 0.75 * np.median(steps):  # half pictures in packets of their own
        return None
    tick = packets.base.numerator / packets.base.denominator
    origin = int(start) - round(first_position / tick)
    keys = np.flatnonzero(key[order])
    entries = (pts if indexed else dts)[order][keys]
    # as OpenCV reckons, so that not a bit is different
    return Stamps((pts[order] - origin) * tick * 1000 / 1000, keys, (entries - origin) * tick, indexed, counted)
