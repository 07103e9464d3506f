"""Values as plain arrays and a text: what a tracker has learned, so that it can go on from there.

A value is made of numbers, texts, arrays, tuples, lists, dicts, sets, random generators, and facetrack's own named
tuples and dataclasses. It comes back bit for bit, with the memory layout of its arrays, on which sums depend.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections import deque
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.npz import Stored

Arrays: TypeAlias = dict[str, NDArray[Any]]
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
        fields = [one for one in dataclasses.fields(value) if one.metadata.get(STORED, True)]
        return {"of": _name(kind), "fields": {one.name: _flat(getattr(value, one.name), arrays) for one in fields}}
    if isinstance(value, tuple) and hasattr(value, "_fields") and _ours(kind):
        return {"of": _name(kind), "fields": {name: _flat(getattr(value, name), arrays) for name in value._fields}}
    if kind is deque:
        return {"deque": [_flat(one, arrays) for one in value], "most": value.maxlen}
    if kind.__name__ in _KINDS and kind is _KINDS[kind.__name__]:
        those = sorted(value) if isinstance(value, set | frozenset) else value
        return {kind.__name__: [_flat(one, arrays) for one in those]}
    if isinstance(value, Mapping):
        return {"dict": [[_flat(key, arrays), _flat(one, arrays)] for key, one in value.items()]}
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
    if "of" in flat:
        return _made(flat["of"], {name: _value(one, arrays) for name, one in flat["fields"].items()})
    if "dict" in flat:
        return {_value(key, arrays): _value(one, arrays) for key, one in flat["dict"]}
    if "deque" in flat:
        return deque((_value(one, arrays) for one in flat["deque"]), flat["most"])
    [(kind, those)] = flat.items()
    return _KINDS[kind](_value(one, arrays) for one in those)


def _made(name: str, fields: dict[str, Any]) -> Any:
    module, _, path = name.partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ValueError(f"{name} is none of {_PACKAGE}'s")
    kind: Any = import_module(module)
    for one in path.split("."):
        kind = getattr(kind, one)
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
    found: Any = sys.modules.get(kind.__module__)
    for one in kind.__qualname__.split("."):
        found = getattr(found, one, None)
    return kind.__module__.partition(".")[0] == _PACKAGE and found is kind


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
    text, those = flatten(value)
    return {name: np.array(text), **{f"{name}/{key}": one for key, one in those.items()}}


def read_value(stored: Stored, name: str) -> Any:
    """The value that `flat_value` gave to a file. ValueError for anything else."""
    prefix = f"{name}/"
    names = [key for key in stored.file.files if key.startswith(prefix)]
    return restore(stored.text(name), {key.removeprefix(prefix): stored.file[key] for key in names})
