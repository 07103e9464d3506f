"""Spans: half-open intervals [begin, end) of rows, frames or places."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from facetrack_cli.core.types import Mask

_Number = TypeVar("_Number", int, float)


def spans(mask: Mask, apart: Mask | None = None) -> list[tuple[int, int]]:
    """[begin, end) of each run of True in `mask` (T,).

    `apart` (T - 1,) is True between two rows that belong to different runs even if both are True.
    """
    joined = mask[:-1] & mask[1:]
    if apart is not None:
        joined &= ~apart
    begins = np.flatnonzero(mask & ~np.append(False, joined))
    ends = np.flatnonzero(mask & ~np.append(joined, False)) + 1
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def union(found: Iterable[tuple[_Number, _Number]], gap: float = 0.0) -> list[tuple[_Number, _Number]]:
    """The spans, in order, joined where they overlap, touch, or are at most `gap` apart."""
    joined: list[tuple[_Number, _Number]] = []
    for begin, end in sorted(found):
        if joined and begin - joined[-1][1] <= gap:
            joined[-1] = joined[-1][0], max(joined[-1][1], end)
        else:
            joined.append((begin, end))
    return joined
