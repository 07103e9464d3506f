"""How a long clip is cut into pieces that are tracked each by itself, and the file that says so.

Pieces overlap, and begin at keyframes where there are some about the wished place. Where a clip is cut at corrections
pieces do not overlap: what follows a complete correction depends on nothing that was tracked before
(`tracking/corrected.py`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Array, Start, Whole
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.tracking.build.build import build_tracker
from facetrack_cli.tracking.corrected import is_complete
from facetrack_cli.trajectory.header import StartRecord, to_record

OVERLAP_S: Final = 5.0
FILE: Final = "plan.npz"
KIND: Final = Kind("facetrack-plan", 1, "plan of pieces", "facetrack run --split")
Starts: TypeAlias = Literal["detect", "init"]


class Split(NamedTuple):
    """How long pieces are to be, in frames or in seconds, and where those after the first begin."""

    length: float
    frames: bool
    starts: Starts

    def record(self) -> dict[str, str]:
        return {"length": f"{self.length:.15g}{'f' if self.frames else 's'}", "starts": self.starts}


@dataclass(frozen=True)
class Piece:
    """One piece of a clip. `plan` is the file that says how the clip is cut.

    `correction`: the frame of the correction that it begins with; None: where a face is found, however late.
    """

    plan: Path
    correction: int | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """`cuts` are the frames [first, stop) of each piece; `end` the last stop, None: all that there are.

    `start` is that of the clip.
    """

    start: Start
    cuts: tuple[tuple[int, int | None], ...]

    def write(self, path: Path, key: str) -> None:
        """Write it for those who ask the same, which `key` tells. Raises OutputError."""
        start = {"from": self.start.origin, "note": self.start.note, **to_record(self.start)}
        cuts = [[first, -1 if stop is None else stop] for first, stop in self.cuts]
        arrays = {"key": np.array(key), "start": np.array(dumps(start)), "cuts": np.array(cuts, np.int64).ravel()}
        KIND.write(path, arrays)


def read_plan(path: Path) -> tuple[str, Plan]:
    """The key of a plan, and the plan. Raises InputError."""

    def make(stored: Stored) -> tuple[str, Plan]:
        said, cuts = json.loads(stored.text("start")), stored.whole("cuts")
        origin, note = said.pop("from"), said.pop("note")
        start = replace(StartRecord.model_validate(said).start_from(origin), note=note)
        pairs = zip(cuts[::2], cuts[1::2], strict=True)
        return stored.text("key"), Plan(start, tuple((a, None if b < 0 else b) for a, b in pairs))

    return KIND.read(path, make)


def cut_by_length(
    first: int, times: Array, split: Split, keys: Sequence[int] | Whole, clip: str
) -> list[tuple[int, int]]:
    """[first, stop) of pieces of the frames from `first` to the last of `times` (T,), in s; each overlaps the next.

    A piece begins at the last of `keys` before the wished place, if that is not half a piece away.
    """
    end, steps = len(times), np.diff(times[first:])
    overlap = OVERLAP_S
    if split.frames and len(steps):
        overlap /= float(np.median(steps))
    if split.length < 2 * overlap:
        least = f"{round(2 * overlap)}f" if split.frames else f"{2 * overlap:g}s"
        raise UsageError(f"{clip}: pieces overlap by {OVERLAP_S:g} s; give --split {least} or more")
    clock = np.arange(end, dtype=np.float64) if split.frames else times
    begins, sought = [first], np.asarray(keys, np.int64)
    while True:
        wished = clock[begins[-1]] + split.length
        at = int(np.searchsorted(clock, wished))
        if at >= end or clock[-1] - wished < 2 * overlap:
            break
        half = int(np.searchsorted(clock, wished - split.length / 2))
        near = sought[(sought >= half) & (sought <= at)]
        begins.append(int(near[-1]) if len(near) else at)
    stops = [min(int(np.searchsorted(times, times[begin] + OVERLAP_S)), end) for begin in begins[1:]]
    return list(zip(begins, [*stops, end], strict=True))


def cut_by_corrections(recipe: Recipe, start: Start, times: Array, split: Split, clip: str) -> list[tuple[int, int]]:
    """[first, stop) of pieces that begin where a correction tells of all targets; as long as is wished, or longer."""
    whole: dict[int, set[str]] = {}
    parts = {target.name: target.parts for target in build_tracker(recipe, start)}
    for one in start.corrections:
        if is_complete(one, parts[one.target]):
            whole.setdefault(one.frame, set()).add(one.target)
    able = np.array(sorted(frame for frame, named in whole.items() if named == {*parts} and frame < len(times)), int)
    if not len(able):
        of = " and ".join(parts) if len(parts) < 4 else f"all {len(parts)} targets"
        raise UsageError(
            f"{clip}: {start.origin} has no correction of all parts of {of} in one frame, where it could be cut; "
            "make some with facetrack fix, take --starts detect, or leave --split out"
        )
    clock = np.arange(len(times), dtype=np.float64) if split.frames else times
    begins = [start.frame]
    while len(rest := able[clock[able] >= clock[begins[-1]] + split.length / 2]):
        begins.append(int(rest[np.argmin(np.abs(clock[rest] - clock[begins[-1]] - split.length))]))
    return list(zip(begins, [*begins[1:], len(times)], strict=True))
