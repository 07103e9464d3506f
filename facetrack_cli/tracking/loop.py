"""The loop over frames: bind, step, estimate, judge; a result a frame.

A tracker is a tuple of targets, put together by `build.py`: particle filters, or what is wrapped to stand beside them
(`opencv.py`). What a target knows of a clip is a value that this loop carries from frame to frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.tracking.exclusion import Cover
from facetrack_cli.trajectory.trajectory import FrameResult, TargetResult


class Target(Protocol):
    """One target of a recipe, ready to track. `state` is a value that the loop keeps for it from frame to frame."""

    @property
    def name(self) -> str: ...

    @property
    def parts(self) -> tuple[str, ...]:
        """What its results have a row of."""

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        """Width and height in pixels of the picture that each part is compared by, of those that have one."""

    def begin(self, rng: np.random.Generator, frame: Frame) -> tuple[Any, TargetResult]:
        """The state after the first frame, and what there is to say of it."""

    def advance(
        self, rng: np.random.Generator, state: Any, frame: Frame, covers: Sequence[Cover]
    ) -> tuple[Any, TargetResult]:
        """The state after one more frame, and what there is to say of it; `covers`: what the other targets explain."""

    def cover(self, state: Any, *, ahead: bool) -> Cover | None:
        """What of the picture it explains, or, `ahead`, is expected to in the next frame; None if it does not say."""


Tracker: TypeAlias = tuple[Target, ...]


def track(tracker: Tracker, frames: Iterator[Frame], seed: int, *, clip: str = "") -> Iterator[FrameResult]:
    """Track over `frames`, the first of which is the one that the tracker's start belongs to.

    Targets take their turn in their order: those that came before are known where they are in this frame, the others
    where they are expected to be. The same tracker, frames and seed give the same results, bit for bit, and so does a
    target that keeps off no other one, whatever else is tracked after it. Raises InputError, which names the `clip`, if
    the first frame does not show what a target needs.
    """
    # a stream of its own for each target, so that one does not change by what others draw
    streams = [np.random.SeedSequence(seed, spawn_key=(i,) if i else ()) for i in range(len(tracker))]
    rngs = [np.random.default_rng(stream) for stream in streams]
    states: list[Any] = []
    for frame in frames:
        results = []
        if states:
            for i, (target, rng) in enumerate(zip(tracker, rngs, strict=True)):
                covers = [
                    other.cover(state, ahead=j > i)
                    for j, (other, state) in enumerate(zip(tracker, states, strict=True))
                    if j != i
                ]
                states[i], result = target.advance(rng, states[i], frame, [one for one in covers if one is not None])
                results.append(result)
        else:
            try:
                ended = [target.begin(rng, frame) for target, rng in zip(tracker, rngs, strict=True)]
            except InputError as e:
                raise InputError(f"{clip}: {e}" if clip else str(e)) from None
            states, results = [state for state, _ in ended], [result for _, result in ended]
        yield FrameResult(frame, tuple(results))
