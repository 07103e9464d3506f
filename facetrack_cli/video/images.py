"""Image files: which files of a folder are frames, in what order, and how one becomes (H, W, 3) uint8 BGR."""

import io
import re
import warnings
import zlib
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, suppress
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Any, Final, TypeVar, cast
from zipfile import BadZipFile, ZipFile, ZipInfo, is_zipfile

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, reading, reason
from facetrack_cli.core.npz import check_directory
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
_CLOCK: Final = re.compile(r".*?[0-9]+[-_:h][0-5]?[0-9][-_:m][0-5]?[0-9](\.[0-9]+)?")
_Name = TypeVar("_Name")


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
    return ordered(files, lambda file: file.name)


def ordered(files: Iterable[_Name], name: Callable[[_Name], str]) -> list[_Name]:
    """Files by the numbers in their names, as all of them are meant.

    A name is one number, also a negative one or a fraction, as 0.04, if all are; or ends in a fraction of seconds, as
    1-02-03.45, if all do, or if the zeros at the ends of fractions are left out. Else each run of digits is a number.
    """
    stems = {file: re.sub(r"\.[^.]*$", "", name(file)) for file in files}
    texts = stems.values()
    if all(map(_NUMBER.fullmatch, texts)):
        return sorted(stems, key=lambda file: (Fraction(stems[file]), name(file)))
    fractions = [stem.rpartition(".")[2] for stem in texts if re.search(r"[0-9]\.[0-9]+$", stem)]
    padded = max((len(digits) for digits in fractions if digits[0] == "0" and len(digits) > 1), default=0)
    # a counter that is padded with zeros is never shorter than those that have them
    cut = min(map(len, fractions), default=0) < padded and all(stem[-1:].isdecimal() for stem in texts)
    if fractions and (cut or all(map(_CLOCK.fullmatch, texts))):
        return sorted(stems, key=lambda file: _fraction_key(stems[file], name(file)))
    return sorted(stems, key=lambda file: natural_key(name(file)))


def _fraction_key(stem: str, name: str) -> tuple[Any, ...]:
    whole, _, fraction = stem.partition(".") if stem.count(".") < 2 else stem.rpartition(".")
    return natural_key(whole)[0], Fraction(f"0.{fraction or 0}"), name


def natural_key(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """A key that sorts names by the numbers in them: 2.jpg before 10.jpg."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part], name


class Pictures(AbstractContextManager["Pictures"]):
    """The pictures of image files, which may be in an archive, in their order: of a stack each page.

    `files` has the file of each picture, `levels` what is black and white in pictures of 16 bits.
    """

    def __init__(self, files: Iterable[Path], archive: "Archive | None" = None) -> None:
        self._archive, self._held, self._file = archive, Path(), cast(Any, None)
        self._pages = [(file, page) for file in files for page in range(pages(file, self._data))]
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
            pixels = (
                pixels[..., :3] if alpha.min() == 255 else ((pixels[..., :3] * alpha + 127) // 255).astype(np.uint8)
            )
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
        deep = _sixteen(path, self._data(path)) if mode == "RGB" and not page and path.suffix.lower() in _DEEP else None
        pixels = deep if deep is not None and deep.shape == pixels.shape else pixels
        return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)

    def _opened(self, path: Path) -> Any:
        """A file, which stays open until another is: the pages of a stack are found one after the other."""
        import imageio.v3 as iio  # and Pillow, where images are read: a short run takes as long as its imports

        if self._held != path or self._file is None:
            self.close()
            self._held, data = path, self._data(path)
            self._file = iio.imopen(path if data is None else data, "r", plugin="pillow")
        return self._file

    def _data(self, path: Path) -> bytes | None:
        return None if self._archive is None else self._archive.read(path)

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

    known = OSError, SyntaxError, EOFError, LookupError, TypeError, ValueError, RuntimeError
    return *known, DecompressionBombError


def _picture(path: Path, data: bytes | None = None) -> Any:
    """A picture as Pillow opens it, whose bytes may be given as `data`."""
    from PIL import Image as Pillow

    return Pillow.open(path if data is None else io.BytesIO(data))


def _sixteen(path: Path, data: bytes | None) -> Any:
    """A colour image of 16 bits, of which Pillow reads 8; None of any other."""
    with _picture(path, data) as image:
        if ";16" not in str(image.tile):  # how its pixels are stored
            return None
    encoded = np.fromfile(path, np.uint8) if data is None else np.frombuffer(data, np.uint8)
    pixels = cv2.imdecode(encoded, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    return None if pixels is None else pixels[..., ::-1]


def pages(path: Path, data: Callable[[Path], bytes | None] = lambda file: None) -> int:
    """How many pictures a TIFF or WebP file holds; 1 of any other, and of a small one beside a large."""
    if path.suffix.lower() not in _STACKS:
        return 1
    try:
        with _picture(path, data(path)) as image:
            count, size = int(getattr(image, "n_frames", 1)), image.size
            if count > 1:
                image.seek(1)
            return count if image.size == size else 1
    except Exception:  # what is wrong with the file is said when it is read
        return 1


def check_pixels(path: Path, width: int, height: int) -> None:
    """UnreadableError for an image that claims more pixels than are read: before memory is taken for them."""
    if width * height > MOST_PIXELS:
        most = f"at most {MOST_PIXELS // 10**6} megapixels are read"
        raise UnreadableError(path, f"is too large for a frame: {width}x{height}, and {most}", "make it smaller")


def is_animated(path: Path) -> bool:
    """Whether a PNG (APNG) or WebP holds several frames."""
    if path.suffix.lower() in (".png", ".webp"):
        with suppress(*_damaged()), _picture(path) as image:  # which is said when it is read
            return bool(getattr(image, "is_animated", False))  # not all kinds of files say so
    return False


# Images in a .zip archive

MOST_BYTES: Final = 256 << 20  # bytes of an image, unpacked
_HIDDEN: Final = re.compile(r"(^|/)(\.|__MACOSX)")
_BROKEN: Final = (BadZipFile, EOFError, OSError, RuntimeError, NotImplementedError, ValueError, zlib.error)


def is_archive(path: Path) -> bool:
    """Whether a file is a .zip archive by its name and its end. Raises OSError."""
    return path.suffix.lower() == ".zip" and path.is_file() and is_zipfile(path)


def holds_images(path: Path) -> bool:
    """Whether an archive has an image, or cannot be read, of which more is said once it is opened."""
    try:
        return bool(Archive(path).files)
    except InputError:
        return True


class Archive:
    """The images of one folder of an archive; `files` are their paths, as if the archive were a folder.

    Raises InputError for an archive that is damaged, locked, or has images in several folders.
    """

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as raw:
                check_directory(path, raw)
            self._zip = ZipFile(path)
        except _BROKEN as e:
            raise InputError(f"{path}: cannot be read as an archive ({reason(e)}); copy or download it again") from e
        entries = {PurePosixPath(entry.filename): entry for entry in self._zip.infolist() if not entry.is_dir()}
        shown = [name for name in entries if name.suffix.lower() in SUFFIXES and not _HIDDEN.search(str(name))]
        if len(folders := {name.parent for name in shown}) > 1:
            two = " and ".join(sorted(map(str, folders))[:2])
            raise InputError(f"{path}: has images in several folders, as {two}; one clip has them in one")
        self._entries: dict[Path, ZipInfo] = {path / name: entries[name] for name in ordered(shown, lambda n: n.name)}
        self.files = list(self._entries)

    def read(self, file: Path) -> bytes:
        """The bytes of one image. Raises UnreadableError; no more is unpacked than an image may have."""
        entry = self._entries[file]
        if entry.file_size > MOST_BYTES:
            raise UnreadableError(file, f"is too large for a frame: {entry.file_size / 1e6:.0f} MB unpacked")
        try:
            with self._zip.open(entry) as opened:
                return opened.read(entry.file_size + 1)
        except _BROKEN as e:
            raise UnreadableError(file, f"cannot be unpacked ({reason(e)})", "make the archive again") from e
