"""When each frame of a video is shown, from its packets, which takes much less time than decoding them.

Packets and frames correspond if every packet has a presentation time of its own and gives one frame. Where that is not
certain there are no stamps, and frames have to be counted by decoding. What is not noticed: a frame that is damaged
while its headers are whole, and a change of size within a stream.
"""

import math
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

from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.video import ffmpeg
from facetrack_cli.video.source import Capture, following

CHECKED = 24  # so many frames from the start must agree with the stamps
_REORDERED = 64  # no codec shows a frame so many packets before or after its turn
# harmless: what is said of a stream that begins in the middle, and of a file whose end is missing
_CUT = re.compile(r"partial file|ended prematurely")
_HARMLESS = re.compile(rf"non-existing [SP]PS|no frame!|message repeated|{_CUT.pattern}")
# these filters change nothing, but parse the headers of every frame and report those that are invalid
_FILTERS = {codec: f"{codec.removesuffix('video')}_metadata" for codec in ("h264", "hevc", "av1", "mpeg2video")}


@dataclass(frozen=True, eq=False)
class Stamps:
    """Of each frame, in the order of showing: `times` (T,) and `positions` (T,), in s, as `Capture` gives them.

    `keys` (M,) are the frames at which decoding can begin, `entries` (M,) the positions to seek to for them. `indexed`:
    the container has an index of its keys, so that seeking to an entry or slightly later arrives at it; else only
    seeking to slightly earlier does, and decoding starts before the key.
    """

    times: Array
    positions: Array
    keys: Whole
    entries: Array
    indexed: bool


def read_stamps(path: Path, stop: threading.Event) -> Stamps | None:
    """The stamps of a video; None where they cannot be trusted.

    Memory is a few bytes a frame. Raises OSError, RuntimeError or ValueError when ffmpeg cannot be asked, among them
    InterruptedError once `stop` is set.
    """
    codec = ffmpeg.contents(path)[0]
    capture = Capture(path)
    heads = [capture.position for _ in range(CHECKED) if capture.grab()]
    capture.release()
    source = ("-v", "error", "-copyts", "-i", ffmpeg.source_argument(path), "-map", "0:v:0")
    decoded = ffmpeg.Listing(*source, "-frames:v", "1", "-fps_mode", "passthrough", "-enc_time_base", "demux")
    first = next((packet.pts * decoded.ticks[0] for packet in decoded if packet.pts != ffmpeg.NO_TIME), None)
    copied = (*source, "-copyinkf", "-c", "copy")
    filtered = ("-bsf:v", _FILTERS[codec]) if codec in _FILTERS else ()
    listing = ffmpeg.Listing(*copied, *filtered)
    packets = _packets(listing, stop)
    if first is None or packets is None or not len(packets) or not heads:
        return None
    if any(line.strip() and not _HARMLESS.search(line) for line in listing.messages.splitlines()):
        if not filtered or not _CUT.search(listing.messages):
            return None
        # of a file whose end is missing the last packet may be invalid, but no other
        plain = _packets(ffmpeg.Listing(*copied), stop)
        if plain is None or not np.array_equal(plain[:-1, 0], packets[: len(plain) - 1, 0]):
            return None
    if codec in ("vp8", "vp9"):
        with ffmpeg.Program([*copied, "-f", "ivf", "-"], stdout=subprocess.PIPE) as program:
            assert program.child.stdout is not None
            shown = _shown(program.child.stdout, codec, stop)
        if len(shown) != len(packets):
            return None
        packets = packets[shown]
    family = ffmpeg.container(path)
    stamps = _stamps(packets, listing.ticks[0], first, heads[0], capture.period, family in ("mp4", "avi", "matroska"))
    if stamps is None or heads != stamps.positions[:CHECKED].tolist():
        return None
    ends_early = family in ("mp4", "avi") and len(stamps.times) > (capture.claimed or math.inf)  # as OpenCV does
    return None if ends_early else stamps


def _packets(listing: ffmpeg.Listing, stop: threading.Event) -> Whole | None:
    """(T, 3): times of showing and of decoding in ticks, and flags of all packets; None if frames may change size."""
    values = array("q")
    for packet in listing:
        if stop.is_set():
            raise InterruptedError
        if packet.new_header and values:
            return None
        values.extend((packet.pts, packet.dts, packet.flags))
    return np.array(values, np.int64).reshape(-1, 3)


def _shown(pipe: IO[bytes], codec: str, stop: threading.Event) -> Mask:
    """Which packets of an IVF stream hold a frame that is shown; VP8 and VP9 have others, to predict from."""
    shown = bytearray()
    pipe.read(32)
    while len(header := pipe.read(12)) == 12:
        if stop.is_set():
            raise InterruptedError
        data = pipe.read(int.from_bytes(header[:4], "little"))
        if codec == "vp8" or not data:
            shown.append(bool(data and data[0] & 0x10))
        else:  # several in one packet, one of which is shown; one that was decoded before; one that is shown
            shown.append(data[-1] & 0xE0 == 0xC0 or bool(data[0] & 0x0A))
    return np.frombuffer(bytes(shown), bool)


def _stamps(
    packets: NDArray[np.int64], tick: Fraction, first: Fraction, position: float, period: float, indexed: bool
) -> Stamps | None:
    """Stamps if every frame from the `first` that can be decoded, s, has one packet and a time of its own.

    `packets` are those of `_packets`, `position` is the first frame's, in s, and `period` the nominal one of a frame.
    """
    pts, _, flags = packets.T
    kept = (flags & ffmpeg.DISCARD) == 0  # what an edit list hides is decoded, but not shown
    start = first / tick
    if start.denominator != 1 or ffmpeg.NO_TIME in pts[kept] or (flags[:-1] & ffmpeg.CORRUPT).any():
        return None
    shown = packets[kept & (pts >= int(start))]  # frames before it lack what they are predicted from
    order = np.argsort(shown[:, 0], kind="stable")
    pts, dts, flags = shown[order].T
    steps = np.diff(pts)
    if not len(pts) or (steps == 0).any() or np.abs(order - np.arange(len(order))).max() > _REORDERED:
        return None
    if not indexed and len(steps) and steps.min() < 0.75 * np.median(steps):  # half frames in packets of their own
        return None
    seconds = tick.numerator / tick.denominator
    origin = int(start) - round(position / seconds)
    keys = np.flatnonzero(flags & ffmpeg.KEY)
    # in the same steps as OpenCV and `Capture`, so that every bit is the same
    positions = ((pts - origin) * seconds * 1000 / 1000).tolist()
    elapsed = [position - positions[0] for position in positions[1:]]
    times = list(accumulate(elapsed, lambda time, since: following(time, since, period), initial=0.0))
    entries = ((pts if indexed else dts)[keys] - origin) * seconds
    return Stamps(np.array(times), np.array(positions), keys, entries, indexed)
