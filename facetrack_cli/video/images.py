"""Image files: which files of a folder are frames, in what order, and how one becomes (H, W, 3) uint8 BGR."""

import contextlib
import re
import warnings
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.types import Image

# of damaged metadata Pillow says much, and without the file's name
warnings.filterwarnings("ignore", module=r"PIL\.")

_MOST_PIXELS = 100_000_000
_KINDS = ("bmp", "jp2", "jpe", "jpeg", "jpg", "pgm", "png", "pnm", "ppm", "tif", "tiff", "webp")
SUFFIXES = frozenset(f".{kind}" for kind in _KINDS)
# modes whose numbers are neither grey levels nor RGB
_READ_AS = {"1": "L", **dict.fromkeys(("P", "PA", "LA", "La", "RGBa"), "RGBA")}
_READ_AS |= dict.fromkeys(("CMYK", "YCbCr", "LAB", "HSV"), "RGB")


class UnreadableError(InputError):
    """An image file that cannot be a frame; `why` and `remedy` are the parts of the message."""

    def __init__(self, path: Path, why: str, remedy: str = "repair the image or remove it") -> None:
        super().__init__(f"{path}: {why}; {remedy}")
        self.why, self.remedy = why, remedy


def listing(path: Path) -> list[Path] | None:
    """The images of a folder or a glob in natural order; None when the path is neither."""
    try:
        if path.is_dir():
            found = path.iterdir()
        elif re.search(r"[*?\[]", path.name) and not path.exists():
            found = path.parent.glob(path.name)
        else:
            return None
        files = [f for f in found if f.suffix.lower() in SUFFIXES and not f.name.startswith(".") and f.is_file()]
    except OSError as error:
        raise InputError(f"{path}: {reason(error)}; check the name and the permissions") from error
    return sorted(files, key=lambda file: natural_key(file.name))


def natural_key(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """A key that sorts names by the numbers in them: 2.jpg before 10.jpg."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part], name


def read(path: Path, data: bytes | None = None) -> Image:
    """Read one image, whose bytes may be given as `data`, as (H, W, 3) uint8 BGR, contiguous.

    The EXIF orientation is applied, 16 bits are scaled to 8, transparency is composited over black. Raises
    UnreadableError.
    """
    try:
        with iio.imopen(path if data is None else data, "r", plugin="pillow") as file:
            mode = str(file.metadata(exclude_applied=False)["mode"])
            if mode in ("I", "F") and path.suffix.lower() != ".png":
                why = "is a 32-bit image, which has no agreed range"
                raise UnreadableError(path, why, "convert it to 8 or 16 bits")
            width, height = file.metadata(exclude_applied=False)["shape"]
            if width * height > _MOST_PIXELS:
                most = f"at most {_MOST_PIXELS // 10**6} megapixels are read"
                why = f"is too large for a frame: {width}x{height}, and {most}"
                raise UnreadableError(path, why, "make it smaller")
            options: dict[str, Any] = {"index": 0, "rotate": True, "mode": _READ_AS.get(mode)}
            pixels: Any = np.asarray(file.read(**options))
    except (OSError, SyntaxError, EOFError, LookupError, TypeError, ValueError, RuntimeError) as error:  # Pillow's
        if "can not handle the given uri" in str(error):
            raise UnreadableError(path, "is not an image, or of an unknown kind") from error
        raise UnreadableError(path, f"cannot be read as an image ({reason(error)})") from error
    if pixels.dtype.itemsize == 2:
        pixels = (pixels >> 8).astype(np.uint8)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=2)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:].astype(np.uint16)
        pixels = pixels[..., :3] if alpha.min() == 255 else ((pixels[..., :3] * alpha + 127) // 255).astype(np.uint8)
    return np.ascontiguousarray(pixels[..., ::-1])


def is_animated(path: Path) -> bool:
    """Whether a PNG holds several frames (APNG): its animation is announced before its pixels."""
    if path.suffix.lower() != ".png":
        return False
    with contextlib.suppress(OSError), path.open("rb") as file:  # which is said when it is read
        head = file.read(1 << 12)
        if b"IDAT" not in head:  # after a colour profile
            head += file.read(1 << 16)
        return b"acTL" in head[: head.find(b"IDAT") + 1]
    return False
