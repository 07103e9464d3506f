"""An annotator who is simulated, for `corrections.py`: he knows the ground truth, and puts right what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import BOX, Array, Correction, Frame, Mask, Start
from facetrack_cli.engine.corrected import CorrectedTarget, completed
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trajectory.trajectory import TargetResult

WATCHED = 5
"""Frames on end that are wrong before he goes back, and the least distance of two corrections."""
BOUND = 1 / 4
OVERLAP = 0.3
FAR = 2**30  # a frame that no clip has


@dataclass(frozen=True, eq=False)
class Truth:
    """Of one target over T frames with K parts: `places` (T, K, 4) of x, y, w, h, and which can be `seen` (T, K).

    `bound` in pixels, of points; `covered` (T, K) is known to be hidden.
    """

    target: str
    parts: tuple[str, ...]
    places: Array
    seen: Mask
    covered: Mask
    bound: float

    def measure(self, t: int, found: Array) -> Array:
        """(K,) error or overlap of what was found (K, 4)."""
        if self.parts == (BOX,):
            one, other = (np.concatenate([a[:, :2] - (a[:, 2:] - 1) / 2, a[:, 2:]], 1) for a in (found, self.places[t]))
            return iou(one, other)
        error: Array = np.hypot(*(found[:, :2] - self.places[t, :, :2]).T)
        return error

    def wrong(self, t: int, found: Array) -> Mask:
        """(K,) whether a part that can be seen is wrong."""
        value = self.measure(t, found)
        off: Mask = self.seen[t] & ((value < OVERLAP) if self.parts == (BOX,) else (value > self.bound))
        return off


class Way(NamedTuple):
    """How a clip is corrected: whether at all, and what is learned then."""

    corrects: bool
    learn: bool | None = None


class Outcome(NamedTuple):
    """`value` is the error or overlap, `beside` that of what is to be seen while something else is covered."""

    corrections: int
    value: float
    beside: float
    right: float


@dataclass(frozen=True, eq=False)
class Work:
    """A target of a clip, to be watched."""

    recipe: Recipe
    start: Start
    frames: Sequence[Frame]
    truth: Truth

    def run(self, seed: int, way: Way) -> Outcome:
        """Track with `seed`, and correct."""
        truth = self.truth
        number = list(self.start.targets).index(truth.target)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,) if number else ()))
        target = self._target(number)
        state, result = target.begin(rng, self._frame(0))
        found, wrong = [result], [truth.wrong(0, _places(result))]
        made, since = 0, 1
        while (t := len(found)) < len(self.frames):
            state, result = target.advance(rng, state, self._frame(t), ())
            found.append(result)
            wrong.append(truth.wrong(t, _places(result)))
            at = _first_wrong(wrong, truth.seen, since) if way.corrects else None
            if at is not None:
                correction = self._correction(at, found[at], wrong[at], way.learn)
                del found[at:], wrong[at:]
                state, result = target.correct(state, self._frame(at), correction)
                found.append(result)
                wrong.append(truth.wrong(at, _places(result)))
                made, since = made + 1, at + WATCHED
        values = np.array([truth.measure(t, _places(one)) for t, one in enumerate(found)])
        beside = truth.seen & truth.covered.any(axis=1, keepdims=True)
        right = ~np.array(wrong)[truth.seen.any(axis=1)].any(axis=1)
        nowhere = float("nan")
        return Outcome(
            made,
            float(values[truth.seen].mean()),
            float(values[beside].mean()) if beside.any() else nowhere,
            float(right.mean()),
        )

    def _frame(self, t: int) -> Frame:
        """Afresh: what is derived from an image is kept in its frame, and would fill the memory."""
        frame = self.frames[t]
        return Frame(frame.index, frame.time_s, frame.bgr)

    def _target(self, number: int) -> CorrectedTarget:
        never = Correction(FAR, self.truth.target, absent=True)
        target = build_tracker(self.recipe, replace(self.start, corrections=(never,)))[number]
        assert isinstance(target, CorrectedTarget)
        return replace(target, corrections={})

    def _correction(self, t: int, found: TargetResult, wrong: Mask, learn: bool | None) -> Correction:
        truth, frame = self.truth, self.frames[t].index
        if truth.parts == (BOX,):
            x, y, w, h = truth.places[t, 0].tolist()
            box = (x - (w - 1) / 2, y - (h - 1) / 2, w, h)
            return Correction(frame, truth.target, box=box, learn=learn)
        given = {}
        for k in np.flatnonzero(wrong & (found.rows.status != "absent")).tolist():
            given[truth.parts[k]] = (float(truth.places[t, k, 0]), float(truth.places[t, k, 1]))
        return completed(Correction(frame, truth.target, points=given, learn=learn), found.rows)


def _places(result: TargetResult) -> Array:
    rows = result.rows
    return np.stack([rows.x, rows.y, rows.w, rows.h], axis=1)


def _first_wrong(wrong: Sequence[Mask], seen: Mask, since: int) -> int | None:
    """The frame from which, up to now, some part was wrong in as many frames with a ground truth as he watches."""
    if not wrong[-1].any():
        return None
    rows = list(islice((t for t in range(len(wrong) - 1, since - 1, -1) if seen[t].any()), WATCHED))
    return rows[-1] if len(rows) == WATCHED and np.all([wrong[t] for t in rows], axis=0).any() else None
