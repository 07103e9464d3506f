"""Corrections along the clip: a target begins again in each frame in which a user corrected it.

There its particles stand together, as in the first frame, and its random numbers come from a stream of their own,
(seed, target, frame). A given part stands where the correction says; a part that is kept, or not named, stands where
it was, rounded as in the CSV. The rows after it depend on the first frame, the correction, and the images from there
on, and on nothing that was tracked before: a part of a run that is tracked alone has the rows of the whole run.

A given box or point is learned again; the other points keep the appearance of the first frame. With `learn` false
nothing is learned; with `learn` true all visible points and the size of the face are. An absent part has rows without a
place until a later correction places it. A confirmed part lies right in that frame: its row says so, and nothing begins
again. None of this is in the papers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.npz import STORED
from facetrack_cli.core.types import BOX, Correction, Frame, TargetStart
from facetrack_cli.engine.loop import Footprint, Target, Tracker
from facetrack_cli.trajectory.trajectory import DECIMALS, TargetResult, Trajectory, of_frame

STREAM: Final = 2**31  # keeps the streams of corrections apart from those of targets


@dataclass(frozen=True, eq=False)
class State:
    """`first`: the state after the first frame. `target` tracks now, with `inner`, None while nothing is to be seen.

    `learned` is the frame of the correction that it was built for, with what that gave; None of the one at the start.
    `rng` are its random numbers since the last correction; before the first, None, they are the loop's.
    """

    first: Any
    streams: np.random.SeedSequence
    target: Target = field(metadata={STORED: False})
    inner: Any
    rng: Generator | None = None
    learned: tuple[int, TargetStart] | None = None


@dataclass(frozen=True, eq=False)
class CorrectedTarget:
    """A target and its corrections by their frames, all after the one in which it begins.

    `points`: whether it is placed by points; `learns`: whether it is learned again if a correction leaves that open.
    `place` finds the visible points in a box given alone, `build` makes the target that learns from a frame.

    With `first`, the first frame of the whole run, it begins at one of its corrections, a complete one. Its rows equal
    those of the whole run, provided that it keeps its index in the tracker: the index seeds its generator.
    """

    target: Target
    corrections: Mapping[int, Correction]
    points: bool
    learns: bool
    place: Callable[[Frame, Correction], TargetStart]
    build: Callable[[Frame, TargetStart], Target]
    first: Frame | None = None

    @property
    def name(self) -> str:
        return self.target.name

    @property
    def parts(self) -> tuple[str, ...]:
        return self.target.parts

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        return self.target.windows

    def begin(self, rng: Generator, frame: Frame) -> tuple[State, TargetResult]:
        streams = rng.bit_generator.seed_seq
        assert isinstance(streams, np.random.SeedSequence)
        inner, result = self.target.begin(rng, frame if self.first is None else self.first)
        state = State(inner, streams, self.target, inner)
        return (state, result) if self.first is None else self.correct(state, frame, self.corrections[frame.index])

    def advance(
        self, rng: Generator, state: State, frame: Frame, footprints: Sequence[Footprint]
    ) -> tuple[State, TargetResult]:
        correction = self.corrections.get(frame.index)
        if correction is not None and correction.confirmed:
            after, result = replace(self, corrections={}).advance(rng, state, frame, footprints)
            return after, result._replace(rows=with_confirmed(result.rows, [correction]))
        if correction is not None and is_complete(correction, self.parts):
            return self.correct(state, frame, correction)
        if state.inner is None:
            after, result = state, self._absent(frame)
        else:
            inner, result = state.target.advance(state.rng or rng, state.inner, frame, footprints)
            after = replace(state, inner=inner)
        return (after, result) if correction is None else self.correct(state, frame, completed(correction, result.rows))

    def footprint(self, state: State, *, ahead: bool) -> Footprint | None:
        return None if state.inner is None else state.target.footprint(state.inner, ahead=ahead)

    def correct(self, state: State, frame: Frame, correction: Correction) -> tuple[State, TargetResult]:
        """The state after `frame`, in which a `complete` correction says where the target is."""
        absent, target_start = correction.hidden(self.parts), TargetStart(correction.box, correction.points)
        if set(absent) >= set(correctable_parts(self.parts)):
            result = self._absent(frame)
            rows = replace(result.rows, by_hand=np.isin(self.parts, absent))
            return replace(state, inner=None), result._replace(rows=rows)
        if self.points and target_start.box is not None and not target_start.points:
            target_start = self.place(frame, correction)
        by_hand = tuple(part for part in self.parts if part in target_start.points or not self.points)
        if self.points:
            # a part is compared by as much of the image as at the start
            target_start = TargetStart(points={**correction.kept, **target_start.points}, windows=self.windows)
        streams = state.streams
        key = (*streams.spawn_key, STREAM, frame.index)
        rng = np.random.default_rng(np.random.SeedSequence(streams.entropy, spawn_key=key))
        if self.learns if correction.learn is None else correction.learn:
            target, learned = self.build(frame, target_start), (frame.index, target_start)
            inner, result = target.begin(rng, frame)
        else:
            target, learned, restarting = self.target, None, cast(Any, self.target)
            relearned = by_hand if correction.learn is None and self.points else ()
            inner, result = restarting.restart(rng, frame, state.first, target_start, absent, relearned)
        rows, sure = result.rows, np.isin(self.parts, by_hand)
        # what is kept is where the tracker was, though it may be learned again
        others = np.where(target is not self.target, "tracked", rows.status)
        judged = np.where(sure & ~np.isnan(rows.confidence), 1.0, rows.confidence)
        marked = np.isin(self.parts, (*by_hand, *absent))
        rows = replace(rows, status=np.where(sure, "init", others), confidence=judged, by_hand=marked)
        return replace(state, target=target, inner=inner, rng=rng, learned=learned), result._replace(rows=rows)

    def _absent(self, frame: Frame) -> TargetResult:
        """The result while nothing of the target is visible."""
        names = tuple((self.name, part) for part in self.parts)
        rows = of_frame(names, frame, {}, status=["absent"] * len(names))
        return TargetResult(rows, np.zeros((0, len(names), 2)))


def restored(tracker: Tracker, states: Sequence[Any], frame: Callable[[int], Frame]) -> list[Any]:
    """The stored states of a tracker, with what corrected targets learned; `frame` gives a frame of the clip."""
    complete = list(states)
    for i, (target, state) in enumerate(zip(tracker, states, strict=True) if states else ()):
        if isinstance(target, CorrectedTarget):
            learned = state.learned
            built = target.target if learned is None else target.build(frame(learned[0]), learned[1])
            complete[i] = replace(state, target=built)
    return complete


def with_confirmed(rows: Trajectory, corrections: Iterable[Correction]) -> Trajectory:
    """The rows; confirmed rows that have a place become tracked, certain and by hand."""
    sure = np.zeros(len(rows), np.bool_)
    for correction in corrections:
        if parts := correction.confirmed:
            named = [name == correction.target and (parts is True or part in parts) for name, part in rows.names]
            sure |= (rows.frame == correction.frame) & np.array(named, np.bool_)[rows.which]
    sure &= np.isfinite(rows.x) & (rows.status != "absent")
    if not sure.any():
        return rows
    return replace(
        rows,
        status=np.where(sure, "tracked", rows.status),
        confidence=np.where(sure & ~np.isnan(rows.confidence), 1.0, rows.confidence),
        by_hand=rows.by_hand | sure,
    )


def is_complete(correction: Correction, parts: Sequence[str]) -> bool:
    """Whether it says of all `parts` of its target where they are, or that they are absent; a box alone does."""
    by_box = correction.box is not None and (not correction.points or tuple(parts) == (BOX,))
    if correction.confirmed or correction.absent is True or by_box:
        return True
    return {*correction.points, *correction.kept, *correction.absent} >= set(correctable_parts(parts))


def correctable_parts(parts: Sequence[str]) -> tuple[str, ...]:
    """The parts that a correction may place: of a face the points before its box; a network places the others."""
    return tuple(parts[: parts.index(BOX)] if BOX in parts else parts) or tuple(parts)


def completed(correction: Correction, rows: Trajectory) -> Correction:
    """The correction with its other parts as in `rows` of its frame: placed, to the digits of the CSV, or absent."""
    parts = [part for _, part in rows.names]
    if is_complete(correction, parts):
        return correction
    assert correction.absent is not True
    kept, absent = dict(correction.kept), list(correction.absent)
    for (_, part), x, y in zip(rows.names, rows.x.tolist(), rows.y.tolist(), strict=True):
        if part not in (*correction.points, *kept, *absent) and part in correctable_parts(parts):
            if math.isnan(x) or math.isnan(y):
                absent.append(part)
            else:
                kept[part] = round(x, DECIMALS["x"]), round(y, DECIMALS["y"])
    return replace(correction, kept=kept, absent=all_or(absent, parts))


def all_or(absent: Sequence[str], parts: Sequence[str]) -> tuple[str, ...] | Literal[True]:
    """The absent parts as a correction stores them: True if all `parts` are absent."""
    return True if set(absent) >= set(correctable_parts(parts)) else tuple(absent)
