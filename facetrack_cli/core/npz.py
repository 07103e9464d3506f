"""Files of plain arrays: .npz without pickle, with a format and a version, written whole or not at all."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import io
import json
import shutil
import sys
import zipfile
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, BinaryIO, Final, TypeAlias, TypeVar
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

Arrays: TypeAlias = dict[str, NDArray[Any]]
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
    """InputError for an archive of a few bytes that holds very many; arrays of numbers are not packed so tightly."""
    check_directory(path, raw)
    with contextlib.suppress(BadZipFile), ZipFile(raw) as archive:
        whole, packed = sum(member.file_size for member in archive.infolist()), path.stat().st_size
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

            def member(name: str) -> IO[bytes]:
                info = ZipInfo(name)  # of 1980
                info.compress_type = ZIP_DEFLATED
                return archive.open(info, "w")

            for name, array in arrays.items():
                with member(f"{name}.npy") as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)
            for block in blocks:
                with ZipFile(block) as before:
                    for name in before.namelist():
                        with before.open(name) as old, member(name) as file:
                            shutil.copyfileobj(old, file)
    except (OSError, BadZipFile) as e:
        raise cannot_write(path, e if isinstance(e, OSError) else OSError(errno.EIO, str(e))) from e


# --- values as arrays: what a tracker has learned, so that it can go on from there ------------------------------------

# A value is made of numbers, texts, arrays, tuples, lists, dicts, sets, random generators, and facetrack's own named
# tuples, dataclasses and frames. It comes back bit for bit, with the memory layout of its arrays, on which sums depend.
_PACKAGE: Final = __name__.partition(".")[0]
_KINDS: Final[Mapping[str, type]] = {"tuple": tuple, "list": list, "set": set, "frozenset": frozenset, "deque": deque}
STORED: Final = "stored"  # metadata of a dataclass's field: False leaves it out, and it comes back as None


def flatten(value: Any) -> tuple[str, Arrays]:
    """The value as a text and the arrays in it. TypeError for what is of another kind, as an object of OpenCV."""
    arrays: Arrays = {}
    return json.dumps(_flat(value, arrays)), arrays


def restore(text: str, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """The value of a text and its arrays. ValueError for what `flatten` does not write."""
    try:
        return _value(json.loads(text), arrays)
    except (KeyError, TypeError, AttributeError, IndexError, ImportError) as e:
        raise ValueError(f"is no stored value ({type(e).__name__}: {e})") from e


def _flat(value: Any, arrays: Arrays) -> Any:
    if value is None or type(value) in (bool, int, float, str):
        return value
    kind = type(value)
    if kind is np.ndarray and value.dtype.hasobject is False and value.dtype.names is None:
        return {"array": _keep(value, arrays), "axes": _axes(value)}
    if isinstance(value, np.generic):
        return {"scalar": _keep(np.asarray(value), arrays)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if kind is np.random.SeedSequence:
        return {"seeds": [value.entropy, list(value.spawn_key)]}
    if kind is np.random.Generator:
        state = value.bit_generator.state
        return {"random": state, "seeds": _flat(value.bit_generator.seed_seq, arrays)}
    if dataclasses.is_dataclass(value) and _ours(kind):
        fields = [item for item in dataclasses.fields(value) if item.metadata.get(STORED, True)]
        return {"of": _name(kind), "fields": {item.name: _flat(getattr(value, item.name), arrays) for item in fields}}
    if isinstance(value, tuple) and hasattr(value, "_fields") and _ours(kind):
        return {"of": _name(kind), "fields": {name: _flat(getattr(value, name), arrays) for name in value._fields}}
    if _ours(kind) and hasattr(kind, "__getnewargs_ex__"):
        return {"of": _name(kind), "args": _flat(value.__getnewargs_ex__(), arrays)}
    if kind is deque:
        return {"deque": [_flat(item, arrays) for item in value], "most": value.maxlen}
    if kind.__name__ in _KINDS and kind is _KINDS[kind.__name__]:
        items = sorted(value) if isinstance(value, set | frozenset) else value
        return {kind.__name__: [_flat(item, arrays) for item in items]}
    if isinstance(value, Mapping):
        return {"dict": [[_flat(key, arrays), _flat(item, arrays)] for key, item in value.items()]}
    raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be stored")


def _value(flat: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if not isinstance(flat, dict):
        return flat
    if "array" in flat:
        return _laid_out(arrays[flat["array"]], flat["axes"])
    if "scalar" in flat:
        return arrays[flat["scalar"]][()]
    if "path" in flat:
        return Path(flat["path"])
    if "random" in flat:
        rng = np.random.default_rng(_value(flat["seeds"], arrays))
        rng.bit_generator.state = flat["random"]
        return rng
    if "seeds" in flat:
        return np.random.SeedSequence(flat["seeds"][0], spawn_key=flat["seeds"][1])
    if "args" in flat:
        return _made(flat["of"], _value(flat["args"], arrays))
    if "of" in flat:
        return _made(flat["of"], {name: _value(item, arrays) for name, item in flat["fields"].items()})
    if "dict" in flat:
        return {_value(key, arrays): _value(item, arrays) for key, item in flat["dict"]}
    if "deque" in flat:
        return deque((_value(item, arrays) for item in flat["deque"]), flat["most"])
    [(kind, items)] = flat.items()
    return _KINDS[kind](_value(item, arrays) for item in items)


def _made(name: str, fields: dict[str, Any] | tuple[tuple[Any, ...], dict[str, Any]]) -> Any:
    module, _, path = name.partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ValueError(f"{name} is none of {_PACKAGE}'s")
    kind: Any = import_module(module)
    for level in path.split("."):
        kind = getattr(kind, level)
    if not isinstance(fields, dict):
        if not isinstance(kind, type) or not hasattr(kind, "__getnewargs_ex__"):
            raise ValueError(f"{name} is no value")
        return kind(*fields[0], **fields[1])
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        made = object.__new__(kind)  # as it was: nothing is computed or checked again
        for field in dataclasses.fields(kind):
            object.__setattr__(made, field.name, fields[field.name] if field.metadata.get(STORED, True) else None)
        return made
    if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return kind(**fields)
    raise ValueError(f"{name} is no value")


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _ours(kind: type) -> bool:
    named: Any = sys.modules.get(kind.__module__)
    for level in kind.__qualname__.split("."):
        named = getattr(named, level, None)
    return kind.__module__.partition(".")[0] == _PACKAGE and named is kind


def _keep(array: NDArray[Any], arrays: Arrays) -> str:
    key = str(len(arrays))
    arrays[key] = np.ascontiguousarray(array.transpose(_axes(array))).reshape([array.shape[i] for i in _axes(array)])
    return key


def _axes(array: NDArray[Any]) -> list[int]:
    """The axes of an array by falling strides: how it lies in memory."""
    return sorted(range(array.ndim), key=lambda i: (-array.strides[i], i))


def _laid_out(packed: NDArray[Any], axes: list[int]) -> NDArray[Any]:
    return packed.transpose(np.argsort(axes)) if axes else packed


def flat_value(name: str, value: Any) -> Arrays:
    """The value as arrays of an .npz file, under a name."""
    text, arrays = flatten(value)
    return {name: np.array(text), **{f"{name}/{key}": array for key, array in arrays.items()}}


def read_value(stored: Stored, name: str) -> Any:
    """The value that `flat_value` gave to a file. ValueError for anything else."""
    prefix = f"{name}/"
    names = [key for key in stored.file.files if key.startswith(prefix)]
    return restore(stored.text(name), {key.removeprefix(prefix): stored.file[key] for key in names})
