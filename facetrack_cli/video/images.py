"""Image files: which files of a folder are frames, in what order, and how one becomes (H, W, 3) uint8 BGR."""

import re
import warnings
from collections.abc import Iterable
from contextlib import AbstractContextManager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, cast

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, reading, reason
from facetrack_cli.core.types import Image

# of damaged metadata Pillow says much, and without the file's name
warnings.filterwarnings("ignore", module=r"PIL\.")

MOST_PIXELS = 100_000_000
_KINDS = ("bmp", "jp2", "jpe", "jpeg", "jpg", "pgm", "png", "pnm", "ppm", "tif", "tiff", "webp")
SUFFIXES = frozenset(f".{kind}" for kind in _KINDS)
# modes whose numbers are neither grey levels nor RGB
_READ_AS = {"1": "L", **dict.fromkeys(("P", "PA", "LA", "La", "RGBa"), "RGBA")}
_READ_AS |= dict.fromkeys(("CMYK", "YCbCr", "LAB", "HSV"), "RGB")
_STACKS: Final = frozenset((".tif", ".tiff", ".webp"))  # which may hold several pictures
_DEEP: Final = frozenset((".png", ".tif", ".tiff"))  # whose colours may have 16 bits
_NUMBER: Final = re.compile(r"-?[0-9]+(\.[0-9]+)?")
ALL_LEVELS: Final = 0, 0xFFFF
_SAMPLES: Final = 16  # images by which the range of 16 bits is measured


class UnreadableError(InputError):
    """An image file that cannot be a frame; `why` and `remedy` are the parts of the message."""

    def __init__(self, path: Path, why: str, remedy: str = "repair the image or remove it") -> None:
        super().__init__(f"{path}: {why}; {remedy}")
        self.why, self.remedy = why, remedy


def listing(path: Path) -> list[Path] | None:
    """The images of a folder or a glob in natural order; None when the path is neither."""
    with reading(path, "check the name and the permissions"):
        is_glob = re.search(r"[*?\[]", path.name) and not path.exists()
        if not (is_glob or path.is_dir()):
            return None
        paths = path.parent.glob(path.name) if is_glob else path.iterdir()
        files = [f for f in paths if f.suffix.lower() in SUFFIXES and not f.name.startswith(".") and f.is_file()]
    return ordered(files)


def ordered(files: Iterable[Path]) -> list[Path]:
    """Files by their names if all are numbers, also negative ones and fractions as 0.04; else by digits in them."""
    stems = {file: re.sub(r"\.[^.]*$", "", file.name) for file in files}
    if all(map(_NUMBER.fullmatch, stems.values())):
        # comparing fractions takes long
        numbers = {file: Fraction(stem) if "." in stem else int(stem) for file, stem in stems.items()}
        return sorted(numbers, key=lambda file: (numbers[file], file.name))
    return sorted(stems, key=lambda file: natural_key(file.name))


def natural_key(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """A key that sorts names by the numbers in them: 2.jpg before 10.jpg."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part], name


class Pictures(AbstractContextManager["Pictures"]):
    """The pictures of image files, in their order: of a stack each page.

    `files` has the file of each picture, `levels` what is black and white in pictures of 16 bits.
    """

    def __init__(self, files: Iterable[Path]) -> None:
        self._held, self._file = Path(), cast(Any, None)
        self._pages = [(file, page) for file in files for page in range(pages(file))]
        self.files, self.levels = [file for file, _ in self._pages], ALL_LEVELS

    def measure_levels(self) -> None:
        """Set `levels` to the range that 16-bit pictures use, by some of them.

        It has as many bits as they, or where none is near 0, it is what lies between: a camera of 12 bits writes 0 to
        4095, a thermal one 27000 to 31000.
        """
        samples = (self.numbers(index) for index in range(0, len(self.files), max(len(self.files) // _SAMPLES, 1)))
        ends = [(int(image.min()), int(image.max())) for image in samples if image.dtype.itemsize > 1]
        if ends:
            low, high = min(ends)[0], max(high for _, high in ends)
            white = 2 ** max(high.bit_length(), 8) - 1
            self.levels = (low, high) if high > 0xFF and low > white // 4 else (0, white)

    def read(self, index: int) -> Image:
        """A picture as (H, W, 3) uint8 BGR, contiguous.

        The EXIF orientation is applied, 16 bits are scaled to 8, transparency is composited over black. Raises
        UnreadableError.
        """
        pixels = self.numbers(index)
        black, white = self.levels
        if pixels.dtype.itemsize > 1 and self.levels == ALL_LEVELS:
            pixels = (pixels >> 8).astype(np.uint8)
        elif pixels.dtype.itemsize > 1:
            scaled = (pixels.astype(np.float32) - black) * (255 / max(white - black, 1))
            pixels = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
        if pixels.shape[2] == 4:
            alpha = pixels[..., 3:].astype(np.uint16)
            rgb = pixels[..., :3]
            pixels = rgb if alpha.min() == 255 else ((rgb * alpha + 127) // 255).astype(np.uint8)
        return np.ascontiguousarray(pixels[..., ::-1])

    def numbers(self, index: int) -> Any:
        """What is in the file: (H, W, 3) or (H, W, 4), red first, uint8 or of 16 bits. Raises UnreadableError."""
        path, page = self._pages[index]
        try:
            file = self._opened(path)
            about = file.metadata(index=page, exclude_applied=False)
            mode, (width, height) = str(about["mode"]), about["shape"]
            if mode in ("I", "F") and path.suffix.lower() != ".png":
                why, remedy = "is a 32-bit image, which has no agreed range", "convert it to 8 or 16 bits"
                raise UnreadableError(path, why, remedy)
            check_pixels(path, width, height)
            pixels: Any = np.asarray(file.read(index=page, rotate=True, mode=_READ_AS.get(mode)))
        except _damaged() as error:
            self.close()
            if "can not handle the given uri" in str(error):
                raise UnreadableError(path, "is not an image, or of an unknown kind") from error
            cause = error.__cause__ if isinstance(error.__cause__, Exception) else error  # what Pillow says
            raise UnreadableError(path, f"cannot be read as an image ({reason(cause)})") from error
        deep = _sixteen(path) if mode == "RGB" and not page and path.suffix.lower() in _DEEP else None
        pixels = deep if deep is not None and deep.shape == pixels.shape else pixels
        return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)

    def _opened(self, path: Path) -> Any:
        """A file, which stays open until another is: the pages of a stack are found one after the other."""
        import imageio.v3 as iio  # and Pillow, where images are read: a short run takes as long as its imports

        if self._held != path or self._file is None:
            self.close()
            self._held, self._file = path, iio.imopen(path, "r", plugin="pillow")
        return self._file

    def close(self) -> None:
        """Close the file that is open."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def __exit__(self, *_: object) -> None:
        self.close()


def _damaged() -> tuple[type[Exception], ...]:
    """What Pillow raises."""
    from PIL.Image import DecompressionBombError

    return OSError, SyntaxError, EOFError, LookupError, TypeError, ValueError, RuntimeError, DecompressionBombError


def _sixteen(path: Path) -> Any:
    """A colour image of 16 bits, of which Pillow reads 8; None of any other."""
    from PIL import Image as Pillow

    with Pillow.open(path) as image:
        if ";16" not in str(image.tile):  # how its pixels are stored
            return None
    pixels = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    return None if pixels is None else pixels[..., ::-1]


def pages(path: Path, kinds: Iterable[str] = _STACKS) -> int:
    """How many pictures a file of these kinds holds; 1 of any other, and of a small one beside a large."""
    from PIL import Image as Pillow

    if path.suffix.lower() in kinds:
        with suppress(Exception), Pillow.open(path) as image:  # what is wrong with the file is said when it is read
            count, size = int(getattr(image, "n_frames", 1)), image.size
            if count > 1:
                image.seek(1)
            return count if image.size == size else 1
    return 1


def check_pixels(path: Path, width: int, height: int) -> None:
    """UnreadableError for an image that claims more pixels than are read: before memory is taken for them."""
    if width * height > MOST_PIXELS:
        most = f"at most {MOST_PIXELS // 10**6} megapixels are read"
        raise UnreadableError(path, f"is too large for a frame: {width}x{height}, and {most}", "make it smaller")


def is_animated(path: Path) -> bool:
    """Whether a PNG (APNG) or WebP holds several frames."""
    return pages(path, (".png", ".webp")) > 1
