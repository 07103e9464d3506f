"""Recipes run over a clip with many seeds, for what compares, repeats and checks them.

All seeds of a plan advance side by side over one decoding of the clip, so memory stays flat but for the results.
Every tracker is given a frame of its own, and only what it does itself is timed. With several processes plans, and
then their seeds, are shared out; what a seed yields does not depend on that.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import signal
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from fractions import Fraction
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import Frame, Start, Whole
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.batch import cores, use_threads, worker_context
from facetrack_cli.runs.signals import Stop
from facetrack_cli.tracking.build.build import tracker_for
from facetrack_cli.tracking.loop import track
from facetrack_cli.trajectory.trajectory import Collector, Trajectory, joined, one_part
from facetrack_cli.video.source import open_source

Report: TypeAlias = Callable[[int, int], None]  # frames tracked over all seeds, and in all; 0 where that is not known

Ended: TypeAlias = "Generator[SeedRun | Failure, None, None]"
_Shared: TypeAlias = "Synchronized[int]"
_ENDED = "a process of -j ended by itself (too little memory?); run without -j"
_LOOK_S = 0.2  # between two looks at the signals and at how far the processes are


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
        yield from _side_by_side(plans, workers, stopped, report, partial)


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


def _side_by_side(plans: Sequence[Plan], workers: int, stopped: Stop, report: Report, partial: bool) -> Ended:
    total = _total(plans)

    def tell() -> None:
        report(done.value, total)

    pieces = -(-workers // max(len(plans), 1))  # of each plan, so that no process is idle
    context = worker_context()
    ending, done = context.Value("i", 0), context.Value("q", 0)
    threads = max(1, cores() // workers)
    pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(ending, done, threads))
    try:
        futures = [[_submit(pool, plan, share, partial) for share in _shares(plan.seeds, pieces)] for plan in plans]
        for plan, shares in zip(plans, futures, strict=True):
            try:
                found = [run for share in shares for run in _await(share, ending, stopped, tell, partial)]
            except FacetrackError as e:
                yield Failure(plan.label, e)
                continue
            except BrokenProcessPool:
                time.sleep(_LOOK_S)  # a signal to the whole group ends the processes too, perhaps before we hear of it
                if stopped():
                    return
                yield Failure(plan.label, FacetrackError(_ENDED))  # what is whole already is kept
                continue
            if stopped() and not partial:
                return
            yield from found
    finally:
        ending.value = 1
        pool.shutdown(cancel_futures=True)


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


def _submit(pool: ProcessPoolExecutor, plan: Plan, share: tuple[int, ...], partial: bool) -> Future[list[SeedRun]]:
    """What a share of a plan will come to, also where a process has ended already and none will take it."""
    try:
        return pool.submit(_work, plan, share, partial)
    except BrokenProcessPool as e:
        broken: Future[list[SeedRun]] = Future()
        broken.set_exception(e)
        return broken


def _await(
    share: Future[list[SeedRun]], ending: _Shared, stopped: Stop, tell: Callable[[], None], partial: bool
) -> list[SeedRun]:
    while True:
        if stopped():
            ending.value = 1
            return share.result() if partial and not share.cancel() else []
        tell()
        with contextlib.suppress(NotYet):
            return share.result(timeout=_LOOK_S)


class _Common:
    """What a process shares with the one that started it."""

    ending: _Shared
    done: _Shared


def _begin(ending: _Shared, done: _Shared, threads: int) -> None:
    # Ctrl-C reaches every process of a terminal; the parent alone acts on it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _Common.ending, _Common.done = ending, done
    use_threads(threads)


def _work(plan: Plan, seeds: tuple[int, ...], partial: bool) -> list[SeedRun]:
    parent = multiprocessing.parent_process()

    def tell(frames: int) -> None:
        with _Common.done.get_lock():
            _Common.done.value += frames

    def stopped() -> bool:
        return bool(_Common.ending.value) or (parent is not None and not parent.is_alive())

    return _run(plan, seeds, stopped, tell, partial)
