"""The checksums that a Matroska file carries: of each cluster, where its writer put one there (RFC 9559, 6.1)."""

import zlib
from pathlib import Path
from typing import BinaryIO

_SEGMENT, _CLUSTER = b"\x18\x53\x80\x67", b"\x1f\x43\xb6\x75"
_CRC = b"\xbf\x84"  # the identity and the size of the element, which comes first of its parent's
_BLOCK = 1 << 20


def broken_clusters(path: Path) -> int:
    """How many clusters differ from their checksums; those without one, or of unknown length, do not. OSError."""
    broken = 0
    with path.open("rb") as file:
        _element(file)  # the head
        if _element(file)[0] != _SEGMENT:
            return 0
        while (found := _element(file))[0] and found[1] >= 0:
            identity, size = found
            after = file.tell() + size
            if identity == _CLUSTER and size > 6 and file.read(2) == _CRC:
                said = int.from_bytes(file.read(4), "little")
                broken += said != _checksum(file, size - 6)
            file.seek(after)
    return broken


def _element(file: BinaryIO) -> tuple[bytes, int]:
    """The identity and the size of the next element, whose contents come next but for a segment's; b"" at the end."""
    first = file.read(1)
    identity = first + file.read(max(8 - first[0].bit_length(), 0) if first else 0)
    head = file.read(1)
    if not head or not head[0]:
        return b"", -1
    length = 9 - head[0].bit_length()
    value = int.from_bytes(head + file.read(length - 1), "big") & (1 << 7 * length) - 1
    size = -1 if value == (1 << 7 * length) - 1 else value
    if identity == b"\x1a\x45\xdf\xa3":
        file.seek(size, 1)
    return identity, size


def _checksum(file: BinaryIO, size: int) -> int:
    crc = 0
    while size > 0 and (data := file.read(min(size, _BLOCK))):
        crc, size = zlib.crc32(data, crc), size - len(data)
    return crc
