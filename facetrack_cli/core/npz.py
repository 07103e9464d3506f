"""Files of plain arrays: .npz without pickle, with a format and a version, written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import io
import shutil
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, BinaryIO, TypeVar
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import (
    MAX_DIRECTORY_BYTES,
    MAX_FILE_BYTES,
    MAX_TABLE_BYTES,
    cannot_write,
    check_readable,
    temporary_path,
    write_new,
)

T = TypeVar("T")
_HEADER = (ValueError, TypeError, IndexError, EOFError, SyntaxError, TokenError)  # NumPy reads it by Python's tokenizer
_DIRECTORY = zipfile._ECD_SIZE  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Kind:
    """A kind of file: `format` and `version` in it, what messages call it ("gallery"), the command that makes it."""

    format: str
    version: int
    what: str
    command: str

    @property
    def head(self) -> dict[str, Any]:
        """The arrays that a file begins with."""
        return {"format": np.array(self.format), "version": np.array(self.version, "<i8")}

    def write(self, path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Equal arrays give equal bytes; a file that is there is replaced. Raises OutputError."""
        buffer = io.BytesIO()
        np.savez(buffer, **{**self.head, **arrays})
        write_new(path, buffer.getvalue(), overwrite=True)

    def read(self, path: Path, make: Callable[[Stored], T]) -> T:
        """The object that `make` makes of the arrays. InputError for any damage, and where `make` raises ValueError."""
        remedy = f"make one with `{self.command}`"
        try:
            check_readable(path, MAX_TABLE_BYTES, self.what)
            with path.open("rb") as raw:
                check_inflated(path, raw, self.what)
                file = np.load(raw, allow_pickle=False)
                if not isinstance(file, np.lib.npyio.NpzFile):
                    raise InputError(f"{path}: is a bare array, not a {self.what}; {remedy}")
                found = {name: file[name] for name in ("format", "version") if name in file.files}
                if str(found.get("format")) != self.format:
                    raise InputError(f"{path}: is not a {self.what}; {remedy}")
                if found.get("version") is None or found["version"].ravel()[0] != self.version:
                    version = f"{found.get('version')}, and this facetrack reads version {self.version}"
                    again = f"make it again with `{self.command}`"
                    raise InputError(f"{path}: is a {self.what} of format version {version}; {again}")
                return make(Stored(file))
        except FileNotFoundError as e:
            raise InputError(f"{path}: there is no such {self.what}; {remedy}") from e
        except OSError as e:
            why = f"cannot be read: {e.strerror or e}"
            raise InputError(f"{path}: {why}; name a {self.what}, as `{self.command}` writes it") from e
        except KeyError as e:
            raise InputError(f"{path}: the {self.what} lacks an array: {e.args[0]}; {remedy}") from e
        except (*_HEADER, MemoryError, RuntimeError, BadZipFile, zlib.error) as e:
            plain = isinstance(e, ValueError) and "pickle" not in str(e)
            why = " ".join(str(e).split()) if plain else "it is no .npz of plain arrays"
            raise InputError(f"{path}: is not a usable {self.what}: {why}; {remedy}") from e


def check_inflated(path: Path, raw: BinaryIO, what: str) -> None:
    """InputError for an archive of a few bytes that holds very many; arrays of numbers are not packed so tightly."""
    check_directory(path, raw)
    with contextlib.suppress(BadZipFile), ZipFile(raw) as archive:
        whole, packed = sum(one.file_size for one in archive.infolist()), path.stat().st_size
        if whole > MAX_FILE_BYTES and whole > 100 * packed:
            raise InputError(f"{path}: is no {what}: its {packed} bytes hold {whole / 1e6:.0f} MB; name the right file")
    raw.seek(0)


def check_directory(path: Path, raw: BinaryIO) -> None:
    """InputError for an archive that lists very many files, each of which takes memory, before the list is read."""
    if (end := zipfile._EndRecData(raw)) and end[_DIRECTORY] > MAX_DIRECTORY_BYTES:  # type: ignore[attr-defined]
        held = f"lists files in {end[_DIRECTORY] / 1e6:.0f} MB, and at most {MAX_DIRECTORY_BYTES / 1e6:.0f} MB are read"
        raise InputError(f"{path}: {held}; unpack it")


@dataclass(frozen=True)
class Stored:
    """The arrays of a file: each method returns one, and raises ValueError if it is of another kind."""

    file: Any

    def __contains__(self, key: str) -> bool:
        return key in self.file.files

    def texts(self, key: str) -> tuple[str, ...]:
        return tuple(map(str, self._array(key, "U", 1)))

    def text(self, key: str) -> str:
        return str(self._array(key, "U", 0))

    def whole(self, key: str) -> tuple[int, ...]:
        return tuple(map(int, self._array(key, "iu", 1)))

    def number(self, key: str) -> float:
        return float(self._array(key, "f", 0))

    def reals(self, key: str, ndim: int) -> NDArray[Any]:
        """An array of `ndim` axes, of the precision that it was stored in."""
        found = self._array(key, "f", ndim)
        return found.astype(found.dtype.newbyteorder("="))

    def _array(self, key: str, kinds: str, ndim: int) -> NDArray[Any]:
        found: NDArray[Any] = self.file[key]
        if found.dtype.kind not in kinds or found.ndim != ndim:
            raise ValueError(f"{key} is of {found.dtype} and {found.ndim} axes")
        return found


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], blocks: Sequence[Path] = ()) -> None:
    """Write arrays, and then all arrays of the files `blocks`, into the temporary file of a path. OutputError.

    Equal arrays give equal bytes.
    """
    try:
        with ZipFile(temporary_path(path), "w", ZIP_DEFLATED, compresslevel=1) as archive:

            def member(name: str) -> IO[bytes]:
                info = ZipInfo(name)  # of 1980
                info.compress_type = ZIP_DEFLATED
                return archive.open(info, "w")

            for name, one in arrays.items():
                with member(f"{name}.npy") as file:
                    np.lib.format.write_array(file, one, allow_pickle=False)
            for block in blocks:
                with ZipFile(block) as before:
                    for name in before.namelist():
                        with before.open(name) as old, member(name) as file:
                            shutil.copyfileobj(old, file)
    except (OSError, BadZipFile) as e:
        raise cannot_write(path, e if isinstance(e, OSError) else OSError(errno.EIO, str(e))) from e
