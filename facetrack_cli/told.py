"""What a tracker that adapts tells of a target, as members of its object in JSON; the CSV has no room for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from facetrack_cli.digits import dumps, fixed

if TYPE_CHECKING:
    from facetrack_cli.types import Told

# a1 to a4 to 5 decimals: of a box of 1,000 pixels that is a hundredth of one
_FIVE, _FOUR, _THREE = fixed(5), fixed(4), fixed(3)
_AFFINE: tuple[Callable[[Any], str], ...] = (_FIVE, _FIVE, _FIVE, _FIVE, _THREE, _THREE)
NUMBERS = ("entropy", "scale", "noise", "error")
KEYS = frozenset(("posterior", "affine", *NUMBERS))
_key = lru_cache(4096)(dumps)  # the names of a gallery come again in every frame


def members(told: Told) -> list[str]:
    """`"key":value` of what is known: posterior, entropy, scale, noise, error, affine, in this order.

    What is not finite is left out: of the posterior a name, of the affine map all of it.
    """
    found = []
    if told.posterior is not None:
        found.append(f'"posterior":{_object(told.posterior)}')
    found += [f'"{name}":{text}' for name in NUMBERS if (text := _FOUR(getattr(told, name)))]
    if told.affine is not None:
        numbers = [form(value) for form, value in zip(_AFFINE, told.affine, strict=True)]
        if all(numbers):
            found.append(f'"affine":[{",".join(numbers)}]')
    return found


def _object(posterior: Mapping[str, float]) -> str:
    return "{" + ",".join([f"{_key(name)}:{text}" for name, p in posterior.items() if (text := _FOUR(p))]) + "}"
