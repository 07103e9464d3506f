"""Files of plain arrays: .npz without pickle, with a format and a version, written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import io
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, TypeVar
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import (
    MOST,
    MOST_ROWS,
    beside,
    cannot_write,
    check_readable,
    copy_bytes,
    discard,
    write_new,
)

T = TypeVar("T")


@dataclass(frozen=True)
class Kind:
    """A kind of file: `format` and `version` in it, what messages call it ("gallery"), the command that makes it."""

    format: str
    version: int
    what: str
    command: str

    def write(self, path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Equal arrays give equal bytes; a file that is there is replaced. Raises OutputError."""
        whole: dict[str, Any] = {"format": np.array(self.format), "version": np.array(self.version, "<i8"), **arrays}
        buffer = io.BytesIO()
        np.savez(buffer, **whole)
        write_new(path, buffer.getvalue(), overwrite=True)

    def read(self, path: Path, make: Callable[[Stored], T]) -> T:
        """The object that `make` makes of the arrays. InputError for any damage, and where `make` raises ValueError."""
        remedy = f"make one with `{self.command}`"
        try:
            check_readable(path, MOST_ROWS, self.what)
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
        except (ValueError, TypeError, IndexError, EOFError, MemoryError, RuntimeError, BadZipFile, zlib.error) as e:
            plain = isinstance(e, ValueError) and "pickle" not in str(e)
            why = " ".join(str(e).split()) if plain else "it is no .npz of plain arrays"
            raise InputError(f"{path}: is not a usable {self.what}: {why}; {remedy}") from e


def check_inflated(path: Path, raw: BinaryIO, what: str) -> None:
    """InputError for an archive of a few bytes that holds very many; arrays of numbers are not packed so tightly."""
    with contextlib.suppress(BadZipFile), ZipFile(raw) as archive:
        whole, packed = sum(one.file_size for one in archive.infolist()), path.stat().st_size
        if whole > MOST and whole > 100 * packed:
            raise InputError(f"{path}: is no {what}: its {packed} bytes hold {whole / 1e6:.0f} MB; name the right file")
    raw.seek(0)


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


class Written(NamedTuple):
    """Where a file of blocks stands: its bytes, its blocks, and what its directory will say of each array."""

    bytes: int
    blocks: int
    members: tuple[tuple[str | int, ...], ...]


_MEMBER: Final = (
    *("filename", "compress_type", "create_system", "create_version", "extract_version", "flag_bits"),
    *("internal_attr", "external_attr", "volume", "CRC", "header_offset", "compress_size", "file_size"),
)


class Blocks:
    """A file of a kind that is written `beside` its path, a block of arrays at a time.

    Raises OutputError when it cannot be written.
    """

    def __init__(
        self, kind: Kind, path: Path, arrays: Mapping[str, NDArray[Any]], after: tuple[Path, Written] | None = None
    ) -> None:
        """With these `arrays` first; or `after` what another file holds up to a place."""
        self.path, self._blocks = path, 0
        try:
            self._file = beside(path).open("w+b")
            if after is not None:
                with after[0].open("rb") as before:
                    copied = copy_bytes(before, self._file, after[1].bytes)
                if copied < after[1].bytes:
                    raise OSError(errno.EIO, f"{after[0]} is too short")
            self._zip = ZipFile(self._file, "w", ZIP_DEFLATED, compresslevel=1)
        except OSError as e:
            raise cannot_write(path, e) from e
        if after is not None:
            self._blocks = after[1].blocks
            for values in after[1].members:
                member = ZipInfo(str(values[0]))
                for name, value in zip(_MEMBER, values, strict=True):
                    setattr(member, name, value)
                self._zip.filelist.append(member)
                self._zip.NameToInfo[member.filename] = member
            return
        self._add({"format": np.array(kind.format), "version": np.array(kind.version, "<i8"), **arrays})

    def add(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """One more block; of the first, an array is named `0/name`."""
        self._add({f"{self._blocks}/{name}": one for name, one in arrays.items()})
        self._blocks += 1

    def _add(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        try:
            for name, one in arrays.items():
                info = ZipInfo(f"{name}.npy")  # of 1980: equal arrays give equal bytes
                info.compress_type = ZIP_DEFLATED
                with self._zip.open(info, "w") as member:
                    np.lib.format.write_array(member, one, allow_pickle=False)
        except OSError as e:
            raise cannot_write(self.path, e) from e

    def place(self) -> Written:
        """Where the next block begins; up to there the file is with the system. OSError."""
        self._file.flush()
        members = tuple(tuple(getattr(one, name) for name in _MEMBER) for one in self._zip.filelist)
        return Written(self._file.tell(), self._blocks, members)

    def close(self) -> None:
        try:
            self._zip.close()
            self._file.close()
        except OSError as e:
            self.discard()
            raise cannot_write(self.path, e) from e

    def discard(self) -> None:
        """Close and remove the temporary file, if it is still there."""
        with contextlib.suppress(OSError, ValueError):
            self._zip.close()
        with contextlib.suppress(OSError):
            self._file.close()
        discard(self.path)
