"""Files that name other files, and addresses: FFmpeg goes by what a file holds, and would open what it names."""

import re
from pathlib import Path

from facetrack_cli.core.errors import InputError

_HEAD = 1 << 16
# HLS, ffconcat, DASH, IMF, Smooth Streaming, SDP, VobSub, ASX, SMIL, PLS: as their demuxers recognise them
_AT_START = re.compile(rb"(?i)#EXTM3U|ffconcat version|# VobSub index|v=0\r?\n|\[playlist\]|<asx|<smil|\[reference\]")
_ANYWHERE = re.compile(rb"(?i)<MPD|<CompositionPlaylist|<AssetMap|<SmoothStreamingMedia|\bc=IN IP[46]|#EXT-X-")
# a drive of Windows has one letter
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(?=[^/])")


def check_local(path: Path) -> None:
    """InputError for an address on the network, of which a path has lost a slash."""
    if found := _ADDRESS.match(str(path)):
        address = f"{found[1]}://{str(path)[found.end() :]}"
        raise InputError(f"{address}: is an address on the network; download it first, then give the file")


def is_playlist(path: Path) -> bool:
    """Whether a file is a playlist, or text that is taken for one, by its first 64 kB. Raises OSError."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
        while head[:3] == b"ID3" and len(head) >= 10:  # which FFmpeg skips before any format
            size = sum((byte & 127) << 7 * place for place, byte in enumerate(reversed(head[6:10])))
            file.seek(file.tell() - len(head) + 10 + size)
            head = file.read(_HEAD)
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    return bool(_AT_START.match(text) or _ANYWHERE.search(text.partition(b"\0")[0]))
