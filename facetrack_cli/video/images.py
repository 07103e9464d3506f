"""Pictures on disk: which of a folder's files are frames, in what order, and how one becomes (H, W, 3) uint8 BGR."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Image

SUFFIXES = frozenset(
    (".bmp", ".jp2", ".jpe", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp")
)

# modes whose numbers are no grey levels or RGB as they stand
_READ_AS = {
    "1": "L",
    "P": "RGBA",
    "PA": "RGBA",
    "LA": "RGBA",
    "La": "RGBA",
    "RGBa": "RGBA",
    "CMYK": "RGB",
    "YCbCr": "RGB",
    "LAB": "RGB",
    "HSV": "RGB",
}


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
    """A key that sorts names as people count: 2.jpg before 10.jpg."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part], name


def read(path: Path) -> Image:
    """Read one picture as (H, W, 3) uint8 BGR, contiguous.

    Turned as EXIF says, 16-bit scaled to 8, transparency laid over black.
    Raises OSError or ValueError when it cannot be read.
    """
    try:
        with iio.imopen(path, "r", plugin="pillow") as file:
            mode = str(file.metadata(exclude_applied=False)["mode"])
            if mode in ("I", "F") and path.suffix.lower() != ".png":
                raise _NoRangeError("is a 32-bit image, which has no agreed range")
            options: dict[str, Any] = {"index": 0, "rotate": True, "mode": _READ_AS.get(mode)}
            pixels: Any = np.asarray(file.read(**options))
    except (OSError, SyntaxError, EOFError, IndexError, KeyError, TypeError, RuntimeError) as error:  # Pillow's ways
        if "can not handle the given uri" in str(error):
            raise ValueError("is not an image, or of an unknown kind") from error
        raise ValueError(f"cannot be read as an image ({error})") from error
    if pixels.dtype.itemsize == 2:
        pixels = (pixels >> 8).astype(np.uint8)
    if pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, axis=2)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:].astype(np.uint16)
        pixels = pixels[..., :3] if alpha.min() == 255 else ((pixels[..., :3] * alpha + 127) // 255).astype(np.uint8)
    return np.ascontiguousarray(pixels[..., ::-1])


def header_size(path: Path) -> tuple[int, int] | None:
    """(width, height) from the header, turned as EXIF says; None when there is no telling."""
    try:
        with iio.imopen(path, "r", plugin="pillow") as file:
            metadata = file.metadata(exclude_applied=False)
    except Exception:  # whatever is wrong with it is said when its turn comes
        return None
    width, height = metadata["shape"]
    return (height, width) if metadata.get("Orientation", 1) in (5, 6, 7, 8) else (width, height)


class _NoRangeError(ValueError):
    pass


def remedy(error: Exception) -> str:
    """What to do about a picture that `read` refused."""
    return "convert it to 8 or 16 bits" if isinstance(error, _NoRangeError) else "repair the image or remove it"


def reason(error: Exception) -> str:
    """An exception's message, on one line and without the path that the caller names anyway."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    text = " ".join(str(text).split())
    return text if len(text) <= 120 else text[:117] + "..."
