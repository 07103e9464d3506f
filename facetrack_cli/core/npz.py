"""Files of plain arrays: .npz without pickle, with a format and a version, written whole or not at all."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import io
import json
import pkgutil
import shutil
import zipfile
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO, Final, NamedTuple, TypeAlias, TypeVar
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile

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
from facetrack_cli.core.types import Frame

Arrays: TypeAlias = dict[str, NDArray[Any]]
T = TypeVar("T")
_HEADER = (ValueError, TypeError, IndexError, EOFError, SyntaxError, TokenError)  # NumPy reads it by Python's tokenizer
_DIRECTORY = zipfile._ECD_SIZE  # type: ignore[attr-defined]


class Kind(NamedTuple):
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
                head = {name: file[name] for name in ("format", "version")} if hasattr(file, "files") else {}
                if str(head.get("format")) != self.format:
                    raise InputError(f"{path}: is not a {self.what}; {remedy}")
                if head["version"].ravel()[0] != self.version:
                    version = f"{head['version']}, and this facetrack reads version {self.version}"
                    raise InputError(f"{path}: is a {self.what} of format version {version}; {remedy}")
                return make(Stored(file))
        except OSError as e:
            raise InputError(f"{path}: cannot be read: {e.strerror or e}; {remedy}") from e
        except (*_HEADER, KeyError, MemoryError, RuntimeError, BadZipFile, zlib.error) as e:
            plain = isinstance(e, ValueError | KeyError) and "pickle" not in str(e)
            why = " ".join(str(e).split()) if plain else "it is no .npz of plain arrays"
            raise InputError(f"{path}: is not a usable {self.what}: {why}; {remedy}") from e


def check_inflated(path: Path, raw: BinaryIO, what: str) -> None:
    """InputError for an archive that lists very many files, each of which takes memory, or of a few bytes that holds
    very many: arrays of numbers are not packed so tightly.
    """
    if (end := zipfile._EndRecData(raw)) and end[_DIRECTORY] > MAX_DIRECTORY_BYTES:  # type: ignore[attr-defined]
        raise InputError(f"{path}: is no {what}: it lists files in {end[_DIRECTORY] / 1e6:.0f} MB; name the right file")
    with contextlib.suppress(BadZipFile), ZipFile(raw) as archive:
        whole, packed = sum(member.file_size for member in archive.infolist()), path.stat().st_size
        if whole > MAX_FILE_BYTES and whole > 100 * packed:
            raise InputError(f"{path}: is no {what}: its {packed} bytes hold {whole / 1e6:.0f} MB; name the right file")
    raw.seek(0)


@dataclass(frozen=True, eq=False)
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
        array = self._array(key, "f", ndim)
        return array.astype(array.dtype.newbyteorder("="))

    def _array(self, key: str, kinds: str, ndim: int) -> NDArray[Any]:
        array: NDArray[Any] = self.file[key]
        if array.dtype.kind not in kinds or array.ndim != ndim:
            raise ValueError(f"{key} is of {array.dtype} and {array.ndim} axes")
        return array


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], blocks: Sequence[Path] = ()) -> None:
    """Write arrays, and then all arrays of the files `blocks`, into the temporary file of a path. OutputError.

    Equal arrays give equal bytes.
    """
    try:
        with ZipFile(temporary_path(path), "w", ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w") as file:  # of 1980
                    np.lib.format.write_array(file, array, allow_pickle=False)
            for block in map(ZipFile, blocks):
                with block:
                    for name in block.namelist():
                        with block.open(name) as old, archive.open(name, "w") as file:
                            shutil.copyfileobj(old, file)
    except (OSError, BadZipFile) as e:
        raise cannot_write(path, e if isinstance(e, OSError) else OSError(errno.EIO, str(e))) from e


# --- values as arrays: what a tracker has learned, so that it can go on from there ------------------------------------

# A value is made of numbers, texts, arrays, the kinds of `_KINDS`, and facetrack's own named tuples and dataclasses. It
# comes back bit for bit, with the memory layout of its arrays, on which sums depend. In JSON each but for numbers and
# texts is a mapping from the name of its kind to its parts.
_PACKAGE: Final = __name__.partition(".")[0]
STORED: Final = "stored"  # metadata of a dataclass's field: False leaves it out, and it comes back as None


def _generator(parts: list[Any]) -> np.random.Generator:
    rng = np.random.default_rng(parts[1])
    rng.bit_generator.state = parts[0]
    return rng


# what a value of a kind is taken apart into, and what makes it of these parts again
_KINDS: Final[Mapping[type, tuple[Callable[[Any], Iterable[Any]], Callable[[list[Any]], Any]]]] = {
    tuple: (list, tuple),
    list: (list, list),
    set: (sorted, set),
    frozenset: (sorted, frozenset),
    deque: (lambda value: [value.maxlen, *value], lambda parts: deque(parts[1:], parts[0])),
    Mapping: (lambda value: value.items(), dict),
    Path: (lambda value: [str(value)], lambda parts: Path(*parts)),
    np.generic: (lambda value: [np.asarray(value)], lambda parts: parts[0][()]),
    np.random.SeedSequence: (
        lambda value: [value.entropy, value.spawn_key],
        lambda parts: np.random.SeedSequence(parts[0], spawn_key=parts[1]),
    ),
    np.random.Generator: (lambda value: [value.bit_generator.state, value.bit_generator.seed_seq], _generator),
    Frame: (
        lambda value: [value.index, value.time_s, value.yuv or value.pixels, value.aspect],
        lambda parts: Frame(*parts[:3], aspect=parts[3]),
    ),
}
_MAKERS: Final = {kind.__name__: make for kind, (_, make) in _KINDS.items()}


def flatten(name: str, value: Any) -> Arrays:
    """The value as arrays of an .npz file, under a name. TypeError for another kind, as an object of OpenCV."""
    arrays: Arrays = {}

    def flat(value: Any) -> Any:
        kind = type(value)
        if value is None or kind in (bool, int, float, str):
            return value
        if kind is np.ndarray and value.dtype.hasobject is False and value.dtype.names is None:
            key, axes = f"{name}/{len(arrays)}", sorted(range(value.ndim), key=lambda i: (-value.strides[i], i))
            # as it lies in memory
            arrays[key] = np.ascontiguousarray(value.transpose(axes)).reshape([value.shape[i] for i in axes])
            return {"array": [key, axes]}
        if kind.__module__.partition(".")[0] == _PACKAGE and (names := _fields(kind)):
            fields = {name: flat(getattr(value, name)) for name, is_stored in names.items() if is_stored}
            return {f"{kind.__module__}:{kind.__qualname__}": fields}
        for known in (kind, Mapping, Path, np.generic):
            if known in _KINDS and isinstance(value, known):
                return {known.__name__: [flat(part) for part in _KINDS[known][0](value)]}
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be stored")

    return {name: np.array(json.dumps(flat(value))), **arrays}


def restore(name: str, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """The value that `flatten` gave to a file under a name. ValueError for anything else."""

    def value(flat: Any) -> Any:
        if not isinstance(flat, dict):
            return flat
        [(kind, held)] = flat.items()
        if kind == "array":
            array = arrays[held[0]]
            return array.transpose(np.argsort(held[1])) if held[1] else array
        if ":" in kind:
            return _made(kind, {name: value(item) for name, item in held.items()})
        return _MAKERS[kind]([value(part) for part in held])

    try:
        return value(json.loads(str(arrays[name])))
    except (KeyError, TypeError, AttributeError, IndexError, OverflowError, ImportError) as e:
        raise ValueError(f"is no stored value ({type(e).__name__}: {e})") from e


def _fields(kind: type) -> dict[str, bool]:
    """The fields of a named tuple or a dataclass, and whether they are stored; none of other kinds."""
    if dataclasses.is_dataclass(kind):
        return {item.name: item.metadata.get(STORED, True) for item in dataclasses.fields(kind)}
    return dict.fromkeys(getattr(kind, "_fields", ()), True) if issubclass(kind, tuple) else {}


def _made(name: str, fields: dict[str, Any]) -> Any:
    """A named tuple or a dataclass of facetrack, as it was: nothing is computed or checked again."""
    if name.partition(":")[0].partition(".")[0] != _PACKAGE:
        raise ValueError(f"{name} is none of {_PACKAGE}'s")
    kind: Any = pkgutil.resolve_name(name)
    names = _fields(kind)
    if f"{kind.__module__}:{kind.__qualname__}" != name or not names:
        raise ValueError(f"{name} is no value")
    if issubclass(kind, tuple):
        return kind(**fields)
    made = object.__new__(kind)
    for field, is_stored in names.items():
        object.__setattr__(made, field, fields[field] if is_stored else None)
    return made
