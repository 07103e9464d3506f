"""How a long clip is cut into chunks that are tracked each by itself, and the file that says so.

Chunks overlap, and begin at keyframes where there are some about the wished place. Where a clip is cut at corrections
chunks do not overlap: what follows a complete correction depends on nothing that was tracked before
(`tracking/corrected.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.files import cannot_write, make_folder, replacing
from facetrack_cli.core.types import Array, Start, Whole
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.tracking.build.build import build_tracker
from facetrack_cli.tracking.corrected import is_complete
from facetrack_cli.trajectory.header import StartRecord, to_record

OVERLAP_S: Final = 5.0
CHUNKS: Final = "chunks"
FILE: Final = "plan.json"
Starts: TypeAlias = Literal["detect", "init"]


class Split(NamedTuple):
    """How long chunks are to be, in frames or in seconds, and where those after the first begin."""

    length: float
    frames: bool
    starts: Starts

    def record(self) -> dict[str, str]:
        return {"length": f"{self.length:.15g}{'f' if self.frames else 's'}", "starts": self.starts}


class Chunk(NamedTuple):
    """One chunk of a clip. `correction`: the frame of the correction that it begins with; None: where a face is found,
    however late.
    """

    correction: int | None = None


class Plan(BaseModel):
    """The start of a clip, and its `cuts`, the frames [first, stop) of each chunk; the last stop may be None: the end.

    `key` tells what was asked.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    key: str
    origin: str
    note: str
    record: dict[str, Any]
    cuts: tuple[tuple[int, int | None], ...]

    @classmethod
    def of(cls, key: str, start: Start, cuts: Sequence[tuple[int, int | None]]) -> Plan:
        return cls(key=key, origin=start.origin, note=start.note, record=to_record(start), cuts=tuple(cuts))

    @property
    def start(self) -> Start:
        return replace(StartRecord.model_validate(self.record).start_from(self.origin), note=self.note)

    def write(self, out: Path) -> None:
        """Write it beside the chunks of a run. Raises OutputError."""
        path = out / CHUNKS / FILE
        make_folder(path.parent)
        try:
            with replacing(path) as file:
                file.write(self.model_dump_json().encode())
        except OSError as e:
            raise cannot_write(path, e) from e


def read_plan(out: Path) -> Plan:
    """The plan of a run's folder. Raises InputError."""
    path = out / CHUNKS / FILE
    try:
        return Plan.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as e:
        raise InputError(f"{path}: is not as facetrack run --split writes it; give --overwrite") from e


def folder_of(out: Path, chunk: int) -> Path:
    return out / CHUNKS / f"{chunk:05d}"


def cut_by_length(
    first: int, times: Array, split: Split, keys: Sequence[int] | Whole, clip: str
) -> list[tuple[int, int]]:
    """[first, stop) of chunks of the frames from `first` to the last of `times` (T,), in s; each overlaps the next.

    A chunk begins at the last of `keys` before the wished place, if that is not half a chunk away.
    """
    end, steps = len(times), np.diff(times[first:])
    overlap = OVERLAP_S
    if split.frames and len(steps):
        overlap /= float(np.median(steps))
    if split.length < 2 * overlap:
        least = f"{round(2 * overlap)}f" if split.frames else f"{2 * overlap:g}s"
        raise UsageError(f"{clip}: chunks overlap by {OVERLAP_S:g} s; give --split {least} or more")
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
    """[first, stop) of chunks that begin where a correction tells of all targets; as long as is wished, or longer."""
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
