"""Unbroken stretches of a mask."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from facetrack_cli.core.types import Mask


def spans(mask: Mask) -> Iterator[tuple[int, int]]:
    """(first, last + 1) of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def runs(mask: Mask) -> Iterator[tuple[int, int]]:
    """[begin, end) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def stretches(mask: Mask) -> list[tuple[int, int]]:
    """(first, last) index of each unbroken stretch of True."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
