"""Recipes run over a clip with many seeds, for what compares, repeats and checks them.

All seeds of a plan advance side by side over one decoding of the clip, so memory stays flat but for the results.
Every tracker is given a frame of its own, and only what it does itself is timed. With several processes plans, and
then their seeds, are shared out; what a seed yields does not depend on that.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import Frame, Start, Whole
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import DiedError, cores, side_by_side
from facetrack_cli.tracking.build.build import tracker_for
from facetrack_cli.tracking.loop import track
from facetrack_cli.trajectory.trajectory import Collector, Trajectory, joined, one_part
from facetrack_cli.video.source import open_source

Report: TypeAlias = Callable[[int, int], None]  # frames tracked over all seeds, and in all; 0 where that is not known

Ended: TypeAlias = "Generator[SeedRun | Failure, None, None]"
_ENDED = "a process of -j ended by itself (too little memory?); run without -j"


@dataclass(frozen=True)
class Plan:
    """A recipe on a clip, with some seeds. `label` names it in results; `stop` is the frame to end before."""

    label: str
    clip: Path
    recipe: Recipe
    start: Start
    seeds: tuple[int, ...]
    stop: int | None = None
    fps: Fraction | None = None


@dataclass(frozen=True, eq=False)
class SeedRun:
    """One seed's trajectory. `frames_per_s` is the tracker's alone: decoding is not counted, nor the first frame.

    `warnings` says what was wrong with the clip, a line each.
    """

    label: str
    seed: int
    trajectory: Trajectory
    frames_per_s: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Failure:
    """A plan that could not be run, and why."""

    label: str
    error: FacetrackError


def run_plans(
    plans: Sequence[Plan],
    workers: int = 1,
    stopped: Stop | None = None,
    report: Report = lambda done, total: None,
    *,
    partial: bool = False,
) -> Ended:
    """Run all plans, in `workers` processes: their runs in the order of plans and seeds, or one failure for a plan.

    Once `stopped` says so, nothing more is yielded; with `partial` what the runs at work have so far still is.
    """
    stopped = stopped or Stop()
    if workers == 1:
        yield from _in_turn(plans, stopped, report, partial)
    else:
        yield from _in_processes(plans, workers, stopped, report, partial)


# --- one plan ------------------------------------------------------------------------------------------------------


class _Feed:
    """Hands each tracker the present frame, whenever it asks for its next."""

    def __init__(self) -> None:
        self.frame: Frame | None = None

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        assert self.frame is not None
        # pictures derived from a frame are kept in it: each tracker is to make, and be timed for, its own
        return Frame(self.frame.index, self.frame.time_s, self.frame.bgr)


def outline(plan: Plan, frames: Whole, size: tuple[int, int]) -> Trajectory:
    """What is known of a run of this plan before it: the names of its rows, in these frames, and no place.

    Raises what the plan's recipe and start are refused for without a look at the picture of that (width, height).
    """
    tracker = tracker_for(plan.recipe, plan.start, size)
    one = np.ones(len(frames))  # every part of every tracker has a size
    rows = [one_part(target.name, part, frames, w=one, h=one) for target in tracker for part in target.parts]
    return joined(rows, path=plan.clip, header=_header(size))


def _header(size: tuple[int, int]) -> dict[str, Any]:
    """As a trajectory's JSON says it; see `evaluation.match`."""
    return {"source": {"size": list(size)}}


def _run(
    plan: Plan, seeds: Sequence[int], stopped: Callable[[], bool], tell: Callable[[int], None], partial: bool = False
) -> list[SeedRun]:
    """The runs of some seeds of a plan; none if it is stopped, or, with `partial`, those up to the frame before.

    `tell` hears of each frame how many tracked it.
    """
    with open_source(plan.clip, fps=plan.fps, start=plan.start.frame, stop=plan.stop) as source:
        tracker = tracker_for(plan.recipe, plan.start, source.size)
        feed = _Feed()
        runs = [track(tracker, iter(feed), seed, clip=str(plan.clip)) for seed in seeds]
        logs = [Collector() for _ in seeds]
        seconds = [0.0 for _ in seeds]
        count = 0
        notes: tuple[str, ...] = ()
        for frame in source:
            if stopped():
                if partial and count:
                    break
                return []
            feed.frame = frame
            for i, run in enumerate(runs):
                began = time.perf_counter()
                result = next(run)
                seconds[i] += (time.perf_counter() - began) * (count > 0)
                logs[i].add(result.rows)
                notes = notes or result.notes
            count += 1
            tell(len(seeds))
        if count == 0:
            raise InputError(f"{plan.clip}: frame {plan.start.frame}, where {plan.start.origin} begins, cannot be read")
    about = {"path": source.path, "header": _header(source.size)}
    warnings = (*source.warnings, *notes)
    return [
        SeedRun(plan.label, seed, log.trajectory(**about), (count - 1) / max(spent, 1e-9), warnings)
        for seed, log, spent in zip(seeds, logs, seconds, strict=True)
    ]


# --- all plans -----------------------------------------------------------------------------------------------------


def _in_turn(plans: Sequence[Plan], stopped: Stop, report: Report, partial: bool) -> Ended:
    done, total = 0, _total(plans)

    def tell(frames: int) -> None:
        nonlocal done
        done += frames
        report(done, total)

    for plan in plans:
        try:
            found = _run(plan, plan.seeds, stopped, tell, partial)
        except FacetrackError as e:
            yield Failure(plan.label, e)
            continue
        if stopped() and not partial:
            return
        yield from found


def _in_processes(plans: Sequence[Plan], workers: int, stopped: Stop, report: Report, partial: bool) -> Ended:
    total = _total(plans)
    pieces = -(-workers // max(len(plans), 1))  # of each plan, so that no process is idle
    tasks = [(plan, share, partial) for plan in plans for share in _shares(plan.seeds, pieces)]
    ends = list(itertools.accumulate(len(_shares(plan.seeds, pieces)) for plan in plans))
    found: dict[int, object] = {}
    threads = max(1, cores() // workers)
    ended = side_by_side(tasks, _work, workers, stopped, lambda done: report(done, total), threads=threads)
    try:
        for plan, end in zip(plans, ends, strict=True):
            shares = range(end - len(_shares(plan.seeds, pieces)), end)
            while not found.keys() >= {*shares} and (one := next(ended, None)) is not None:
                found[one[0]] = one[1]
            if stopped() and not partial:
                return
            results = [found.pop(i) for i in shares if i in found]
            error = next((one for one in results if isinstance(one, Exception)), None)
            if isinstance(error, DiedError):
                error = FacetrackError(_ENDED)
            if isinstance(error, FacetrackError):
                yield Failure(plan.label, error)
            elif error is not None:
                raise error
            else:
                yield from (run for runs in results if isinstance(runs, list) for run in runs)
    finally:
        ended.close()  # type: ignore[attr-defined]


def _work(task: tuple[Plan, tuple[int, ...], bool], stop: Stop, report: Callable[[int], None]) -> list[SeedRun]:
    plan, seeds, partial = task
    done = 0

    def tell(frames: int) -> None:
        nonlocal done
        done += frames
        report(done)

    return _run(plan, seeds, stop, tell, partial)


def _total(plans: Sequence[Plan]) -> int:
    """Frames to track over all seeds, as far as the clips' own word for it goes; 0 if one says nothing."""
    lengths: dict[tuple[Path, int, int | None], int] = {}
    for plan in plans:
        key = plan.clip, plan.start.frame, plan.stop
        if key not in lengths:
            try:
                with open_source(plan.clip, fps=plan.fps, start=plan.start.frame, stop=plan.stop) as source:
                    lengths[key] = source.frames_hint or 0
            except FacetrackError:  # its turn will come
                lengths[key] = 0
    each = [len(plan.seeds) * lengths[plan.clip, plan.start.frame, plan.stop] for plan in plans]
    return sum(each) if all(each) else 0


def _shares(seeds: Sequence[int], pieces: int) -> list[tuple[int, ...]]:
    """The seeds in order, in at most so many runs of nearly equal length."""
    pieces = min(pieces, len(seeds))
    edges = [round(i * len(seeds) / pieces) for i in range(pieces + 1)]
    return [tuple(seeds[a:b]) for a, b in itertools.pairwise(edges)]
