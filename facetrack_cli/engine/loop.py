"""The loop over frames: each target steps, and each frame gives one result. `start/assembly.py` makes the targets."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame
from facetrack_cli.trajectory.trajectory import FrameResult, TargetResult


class Footprint(NamedTuple):
    """What a target explains: an upright ellipse of `centre` (2,) and `half` axes (2,), in pixels.

    `target` is its name, `lost` whether it is lost; `state` is that of targets which share one, else None.
    """

    centre: Array
    half: Array
    state: Any = None
    target: str = ""
    lost: bool = False


class Target(Protocol):
    """One target of a recipe, ready to track. `state` is a value that the loop keeps for it from frame to frame.

    Results have a row of each of `parts`; `windows` are width and height in pixels of what a part is compared by, if
    there is such a window.
    """

    @property
    def name(self) -> str: ...
    @property
    def parts(self) -> tuple[str, ...]: ...
    @property
    def windows(self) -> Mapping[str, tuple[float, float]]: ...

    def begin(self, rng: Generator, frame: Frame) -> tuple[Any, TargetResult]:
        """State and result after the first frame. InputError for a start that the frame does not bear out."""
        ...

    def advance(
        self, rng: Generator, state: Any, frame: Frame, footprints: Sequence[Footprint]
    ) -> tuple[Any, TargetResult]:
        """State and result after one more frame, of which the other targets explain `footprints`."""
        ...

    def footprint(self, state: Any, *, ahead: bool) -> Footprint | None:
        """What of the frame the target explains, or `ahead` what of the next it is expected to; None: unknown."""
        ...


Tracker: TypeAlias = tuple[Target, ...]


def stream(seed: int, place: int) -> Generator:
    """Random numbers of the target at a place of its tracker: no target's change by what others draw."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place,) if place else ()))


@dataclass
class TrackState:
    """The state of a track after a frame: a state and a generator for each target; no states before the first frame."""

    states: list[Any] = field(default_factory=list)
    rngs: list[Generator] = field(default_factory=list)


def track(
    tracker: Tracker, frames: Iterator[Frame], seed: int, *, clip: str = "", at: TrackState | None = None
) -> Iterator[FrameResult]:
    """Track over `frames`. The tracker's start belongs to the first frame.

    Targets advance in their order. A target sees the footprints of earlier targets in this frame, and the expected
    footprints of later targets. Equal input gives equal results, bit for bit. The results of a target without exclusion
    do not depend on other targets.

    Parameters
    ----------
    at
        Kept up to date. If it holds states already, tracking resumes from them with the next of the `frames`.

    Raises
    ------
    InputError
        The first frame lacks what a target needs; the message names the `clip`.
    """
    at = TrackState() if at is None else at
    at.rngs = at.rngs or [stream(seed, place) for place in range(len(tracker))]
    for frame in frames:
        results: list[TargetResult] = []
        if at.states:
            for i, (target, rng) in enumerate(zip(tracker, at.rngs, strict=True)):
                footprints = [
                    footprint._replace(target=other.name)
                    for j, other in enumerate(tracker)
                    if j != i and (footprint := other.footprint(at.states[j], ahead=j > i)) is not None
                ]
                at.states[i], result = target.advance(rng, at.states[i], frame, footprints)
                results.append(result)
        else:
            try:
                first = [target.begin(rng, frame) for target, rng in zip(tracker, at.rngs, strict=True)]
            except InputError as e:
                raise InputError(f"{clip}: {e}" if clip else str(e)) from None
            at.states, results = [state for state, _ in first], [result for _, result in first]
        yield FrameResult(frame, tuple(results))
