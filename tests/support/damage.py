"""Damage to files, made from a seed, as disks, networks and interrupted copies do to a clip; and calls that fail."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import NoReturn

KINDS = ("bytes", "burst", "zeros", "dropped", "swapped", "cut", "byte", "bit")


def damaged(data: bytes, kind: str, seed: int, *, head: int = 2048) -> bytes:
    """A copy of a file with one kind of damage after its `head`, which holds what tells where the frames are.

    bytes: 4 to 40 bytes anywhere have other values; burst: a block of random bytes; zeros: a block of zeros, as a bad
    sector; dropped: a block is missing; swapped: two blocks have changed places; cut: the end is missing; byte, bit:
    one of them has another value.
    """
    chance = random.Random(f"{kind} {seed}")
    out, size = bytearray(data), len(data)
    first = min(head, size // 4)
    block = min(chance.choice((16, 188, 512, 1500, 4096)), size // 8)
    at = chance.randrange(first, size - 2 * block)
    if kind == "bytes":
        for _ in range(chance.randint(4, 40)):
            out[chance.randrange(first, size)] ^= chance.randrange(1, 256)
    elif kind == "burst":
        out[at : at + block] = chance.randbytes(block)
    elif kind == "zeros":
        out[at : at + block] = bytes(block)
    elif kind == "dropped":
        del out[at : at + block]
    elif kind == "swapped":
        other = chance.randrange(at + block, size - block + 1)
        out[at : at + block], out[other : other + block] = out[other : other + block], out[at : at + block]
    elif kind == "cut":
        del out[at:]
    else:
        out[at] ^= chance.randrange(1, 256) if kind == "byte" else 1 << chance.randrange(8)
    return bytes(out)


def raising(error: BaseException | type[BaseException]) -> Callable[..., NoReturn]:
    """What raises this, however it is called."""

    def fails(*_: object, **__: object) -> NoReturn:
        raise error

    return fails
