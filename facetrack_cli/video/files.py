"""What a file is: a clip of its own, an image, or neither, and whether a part of it is missing."""

import re
import shlex
from collections import defaultdict
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO, Final

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.video import images
from facetrack_cli.video.images import holds_images, is_archive

AGAIN: Final = "copy or download it again"
_KINDS: Final = (
    "3g2 3gp apng asf avi divx dv f4v flv gif m2ts m2v m4v mj2 mjpeg mjpg mkv mov mp4 mpe mpeg mpg mts mxf ogm ogv qt "
    "rm rmvb ts vob webm wmv y4m"
)
_VIDEOS: Final = frozenset(f".{kind}" for kind in _KINDS.split())
_ADDRESS: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(?=[^/])")  # a drive of Windows has one letter
_CONCAT: Final = re.compile(rb"(\xef\xbb\xbf)?(\s*#[^\n]*\n)*\s*(ffconcat version|file\s+['\"\w./\\])")
_GOPRO: Final = re.compile(r"(G[A-Z])([0-9]{2})([0-9]{4})|GOPR([0-9]{4})", re.IGNORECASE)
_TS_PACKET: Final = 188  # bytes
_MP4_BOXES: Final = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")


def is_clip(path: Path) -> bool:
    """Whether a file that is found in a folder is a clip: a video, an animation, or an archive of images."""
    suffix = path.suffix.lower()
    named = suffix in _VIDEOS or (suffix == ".zip" and holds_images(path)) or images.is_animated(path)
    return named and path.is_file()


def chapters(clips: Sequence[Path]) -> list[Path]:
    """Those of some clips that may be chapters of one recording: numbered on, or as cameras name them; else none."""
    recordings = defaultdict[tuple[str, str], list[Path]](list)
    for clip in clips:
        if clip.suffix.lower() not in _VIDEOS:
            continue
        if camera := _GOPRO.fullmatch(clip.stem):
            recordings[str(clip.parent), camera[3] or camera[4]].append(clip)
        elif numbered := re.fullmatch(r"(.*?)([0-9]{4,})", clip.stem):  # as cameras number
            recordings[str(clip.parent / f"{numbered[1]}_"), clip.suffix].append(clip)
    for parts in recordings.values():
        numbers = [int((re.findall("[0-9]+", part.stem) or ["0"])[-1]) for part in parts]
        on = numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        if len(parts) > 1 and (_GOPRO.fullmatch(parts[0].stem) or on):
            return parts
    return []


def is_image(path: Path) -> bool:
    """Whether a file is a single image."""
    return path.suffix.lower() in images.SUFFIXES and not images.is_animated(path)


def brings_rate(clip: Path) -> bool:
    """Whether a clip has a frame rate of its own, as all have but images: of a folder, a glob, an archive, or alone."""
    several = clip.is_dir() or images.listing(clip) is not None or is_archive(clip)
    return not several and not is_image(clip)


def given_rate(clip: Path, fps: float) -> Fraction | None:
    """The rate at which a clip was read, of frames per second, where it does not bring it itself."""
    return None if brings_rate(clip) else Fraction(fps).limit_denominator(1001)


def is_live(clip: Path) -> bool:
    """Whether an input is a camera, by its number or device, or standard input."""
    name = str(clip)
    return name == "-" or name.startswith("/dev/video") or (name.isdecimal() and not clip.exists())


def address_of(path: Path) -> str | None:
    """The address on the network of which a path has lost a slash; None for a path."""
    scheme = _ADDRESS.match(str(path))
    return scheme and f"{scheme[1]}://{str(path)[scheme.end() :]}"


def check_local(path: Path) -> None:
    """InputError for an address on the network."""
    if address := address_of(path):
        raise InputError(f"{address}: is an address on the network; download it first, then give the file")


def check_file(path: Path) -> None:
    """Raise InputError for a path that is no file that can be read, an empty one, or a list of files to be joined."""
    try:
        str(path).encode()
        if not path.exists():
            hint = "a pipe cannot be read, save the clip to a file" if str(path) == "-" else "check the name"
            raise InputError(f"{path}: no such file or folder; {hint}")
        if not path.is_file():
            raise InputError(f"{path}: neither a file nor a folder; save the clip to a file")
        with path.open("rb") as file:
            begins = file.read(4096)
            if not begins:
                raise InputError(f"{path}: the file is empty; {AGAIN}")
            if path.suffix.lower() not in _VIDEOS and _CONCAT.match(begins):
                how = f"ffmpeg -f concat -safe 0 -i {shlex.quote(str(path))} -c copy joined.mp4"
                raise InputError(f"{path}: is a list of files that are one clip; join them, and give that: {how}")
    except UnicodeEncodeError:
        raise InputError(f"{path}: the name holds bytes that are no UTF-8 text; rename the file") from None
    except OSError as error:
        raise InputError(f"{path}: {reason(error)}; check the name and the permissions") from error


def missing_part(path: Path) -> str:
    """What a file lacks by the sizes that its container tells, or by the marks of its packets; "" if it is whole.

    MP4, AVI and MPEG transport streams are known.
    """
    with path.open("rb") as file:
        size, head = path.stat().st_size, file.read(2 * _TS_PACKET + 1)
        if head[::_TS_PACKET] == b"GGG":
            return _unmarked(file)
        end, names = 0, set[bytes]()
        if head[4:8] in _MP4_BOXES:
            end, names = _boxes(file, size)
        elif head[:4] == b"RIFF":
            length = int.from_bytes(head[4:8], "little")
            end = 8 + length if length < 0x7FFFFFFF else 0  # a writer may leave the largest number there
        if names and b"moov" not in names:
            return "its index (moov) is missing"
        return f"{end - size} bytes are missing" if end > size else ""


def _boxes(file: BinaryIO, size: int) -> tuple[int, set[bytes]]:
    """Where the last box of an MP4 ends, and the names of its boxes."""
    at, names = 0, set[bytes]()
    while at < size:
        file.seek(at)
        head = file.read(16)
        length = int.from_bytes(head[:4], "big")
        length = int.from_bytes(head[8:], "big") if length == 1 else length or size - at  # 0: up to the end
        if length < 8 or not head[4:8].isalnum():
            break
        names.add(head[4:8])
        at += length
    return at, names


def _unmarked(file: BinaryIO) -> str:
    """What is wrong with the packets of a transport stream, which all begin with one mark; "" if nothing is."""
    file.seek(0)
    while block := file.read(_TS_PACKET << 12):
        if len(block) % _TS_PACKET:
            return "it ends within a packet"
        if block[::_TS_PACKET].count(b"G") < len(block) // _TS_PACKET:
            return "a packet lacks its mark"
    return ""
