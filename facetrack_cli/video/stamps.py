"""When each frame of a video is shown, from its packets, which takes much less time than decoding them.

Packets and frames correspond if every packet has a presentation time of its own and gives one frame. Where that is not
certain there are no stamps, and frames have to be counted by decoding. What is not noticed: a frame that is damaged
while its headers are whole, and a change of size within a stream.
"""

from __future__ import annotations

import re
import subprocess
import threading
from array import array
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array
from facetrack_cli.video import ffmpeg
from facetrack_cli.video.source import Capture, following

CHECKED = 24  # so many frames from the start must agree with the stamps
_REORDERED = 64  # no codec shows a frame so many packets before or after its turn
_NO_TIME = -(2**63)
# harmless: what is said of a stream that begins in the middle, and of a file whose end is missing
_CUT = re.compile(r"partial file|ended prematurely")
_HARMLESS = re.compile(rf"non-existing [SP]PS|no frame!|message repeated|{_CUT.pattern}")
# these filters change nothing, but parse the headers of every frame and report those that are invalid
_CHECKS = {
    "h264": "h264_metadata",
    "hevc": "hevc_metadata",
    "av1": "av1_metadata",
    "mpeg2video": "mpeg2_metadata",
}


@dataclass(frozen=True, eq=False)
class Stamps:
    """Of each frame, in the order in which they are shown: `times` (T,), in seconds, as a source counts them.

    `positions` (T,) are the times as OpenCV gives them.
    `keys` (M,) are the frames at which decoding can begin, `entries` (M,) the position to seek to for each of them.
    `indexed`: the container has an index of its keys, so that seeking to an entry or slightly later arrives at it; else
    only seeking to slightly earlier does, and decoding starts before the key. `counted`: it holds the number of frames,
    and OpenCV ends there.
    """

    times: Array
    positions: Array
    keys: NDArray[np.int64]
    entries: Array
    indexed: bool
    counted: bool


class StoppedError(Exception):
    """Reading was stopped from another thread."""


def read_stamps(path: Path, period: float, stop: threading.Event) -> Stamps | None:
    """The stamps of a video with the nominal `period`, s, of a frame; None where they cannot be trusted.

    Memory is a few bytes a frame. Raises OSError, RuntimeError or ValueError when ffmpeg cannot be asked, StoppedError
    once `stop` is set.
    """
    codec = ffmpeg.contents(path).video
    capture = Capture(path)
    heads = [capture.position for _ in range(CHECKED) if capture.grab()]
    capture.release()
    if codec is None or not heads:
        return None
    source = ("-v", "error", "-copyts", "-i", ffmpeg.source_argument(path), "-map", "0:v:0")
    listing = ffmpeg.Listing(*source, "-frames:v", "1", "-fps_mode", "passthrough", "-enc_time_base", "demux")
    first = next((packet.pts * listing.ticks[0] for packet in listing if packet.pts is not None), None)
    copied = (*source, "-copyinkf", "-c", "copy")
    check = ("-bsf:v", _CHECKS[codec]) if codec in _CHECKS else ()
    packets, messages = _packets(ffmpeg.Listing(*copied, *check), stop)
    if first is None or packets is None:
        return None
    if any(line.strip() and not _HARMLESS.search(line) for line in messages.splitlines()):
        if not check or not _CUT.search(messages):
            return None
        # of a file whose end is missing the last packet may be invalid, but no other
        plain, _ = _packets(ffmpeg.Listing(*copied), stop)
        if plain is None or not np.array_equal(plain.pts[:-1], packets.pts[: len(plain.pts) - 1]):
            return None
    if codec in ("vp8", "vp9"):
        with ffmpeg.Program([*copied, "-f", "ivf", "-"], stdout=subprocess.PIPE) as program:
            assert program.child.stdout is not None
            shown = _shown(program.child.stdout, codec, stop)
        if len(shown) != len(packets.pts):
            return None
        packets = packets.only(shown)
    with path.open("rb") as file:
        stamps = _stamps(packets, first, heads[0], period, file.read(12))
    if stamps is None or heads != stamps.positions[:CHECKED].tolist():
        return None
    ends_early = stamps.counted and capture.claimed is not None and capture.claimed < len(stamps.positions)
    return None if ends_early else stamps


@dataclass(frozen=True, eq=False)
class _Packets:
    """In the order of decoding (T,): time of showing and of decoding in ticks of `tick` seconds, libavcodec's flags."""

    tick: Fraction
    pts: NDArray[np.int64]
    dts: NDArray[np.int64]
    flags: NDArray[np.uint8]

    def only(self, those: NDArray[np.bool_]) -> _Packets:
        return _Packets(self.tick, self.pts[those], self.dts[those], self.flags[those])


def _packets(listing: ffmpeg.Listing, stop: threading.Event) -> tuple[_Packets | None, str]:
    """All packets, None if there are none or frames may change their size; and what ffmpeg said."""
    pts, dts, flags = array("q"), array("q"), array("B")
    for packet in listing:
        if stop.is_set():
            raise StoppedError
        if packet.new_header and flags:
            return None, ""
        pts.append(_NO_TIME if packet.pts is None else packet.pts)
        dts.append(_NO_TIME if packet.dts is None else packet.dts)
        flags.append(packet.flags & 255)
    if not pts:
        return None, listing.messages
    arrays = np.array(pts, np.int64), np.array(dts, np.int64), np.array(flags, np.uint8)
    return _Packets(listing.ticks[0], *arrays), listing.messages


def _shown(pipe: IO[bytes], codec: str, stop: threading.Event) -> NDArray[np.bool_]:
    """Which packets of an IVF stream hold a frame that is shown; VP8 and VP9 have others, to predict from."""
    shown = bytearray()
    pipe.read(32)
    while len(header := pipe.read(12)) == 12:
        if stop.is_set():
            raise StoppedError
        data = pipe.read(int.from_bytes(header[:4], "little"))
        if not data:
            shown.append(False)
        elif codec == "vp8":
            shown.append(bool(data[0] & 0x10))
        else:  # several in one packet, one of which is shown; one that was decoded before; one that is shown
            shown.append(data[-1] & 0xE0 == 0xC0 or bool(data[0] & 0x08) or bool(data[0] & 0x02))
    return np.frombuffer(bytes(shown), bool)


def _stamps(packets: _Packets, first: Fraction, first_position: float, period: float, head: bytes) -> Stamps | None:
    """Stamps if every frame from the `first` that can be decoded, s, has one packet and a time of its own."""
    flags = packets.flags
    kept = (flags & ffmpeg.DISCARD) == 0  # what an edit list hides is decoded, but not shown
    start = first / packets.tick
    if start.denominator != 1 or _NO_TIME in packets.pts[kept] or (flags[:-1] & ffmpeg.CORRUPT).any():
        return None
    shown = packets.only(kept & (packets.pts >= int(start)))  # frames before it lack what they are predicted from
    order = np.argsort(shown.pts, kind="stable")
    pts, key = shown.pts[order], (shown.flags[order] & ffmpeg.KEY) != 0
    steps = np.diff(pts)
    if not len(pts) or (steps == 0).any() or np.abs(order - np.arange(len(order))).max() > _REORDERED:
        return None
    counted = head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide") or head.startswith(b"RIFF")  # MP4, AVI
    indexed = counted or head.startswith(b"\x1a\x45\xdf\xa3")  # Matroska
    if not indexed and len(steps) and steps.min() < 0.75 * np.median(steps):  # half frames in packets of their own
        return None
    tick = packets.tick.numerator / packets.tick.denominator
    origin = int(start) - round(first_position / tick)
    keys = np.flatnonzero(key)
    entries = (pts if indexed else shown.dts[order])[keys]
    # in the same steps as OpenCV, so that every bit is the same
    positions = (pts - origin) * tick * 1000 / 1000
    times = accumulate(
        (positions[1:] - positions[0]).tolist(), lambda t, elapsed: following(t, elapsed, period), initial=0.0
    )
    return Stamps(np.array(list(times)), positions, keys, (entries - origin) * tick, indexed, counted)
