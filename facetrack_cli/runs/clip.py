"""One clip tracked, from its first frame to closed outputs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from functools import partial

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Frame
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.runs import pipeline
from facetrack_cli.runs.checkpoint import Run, forget
from facetrack_cli.runs.job import Job, Outcome, Report, check, check_lag, ended, silent
from facetrack_cli.runs.join import join
from facetrack_cli.runs.outputs import Outputs
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import frames_of
from facetrack_cli.runs.verdict import Watch
from facetrack_cli.tracking.build.build import tracker_for
from facetrack_cli.tracking.corrected import restored, resumed_at
from facetrack_cli.tracking.kernels.precompile import Precompiler
from facetrack_cli.tracking.loop import TrackState, track
from facetrack_cli.tracking.smoothed import lagged
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.trajectory.writers import Footer
from facetrack_cli.video.source import FolderSource


def run(job: Job, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Track one clip into its files; raises, and leaves no file, if nothing was tracked. `stop` is asked each frame.
    Of one that is split the pieces, which are there, are joined. While a face is looked for `looked` hears of it.

    An error after the first frame is in the outcome, beside what was kept. What the folder holds of the same job is
    left as it is if it was not cut short by an error, a signal or a kill; else the clip is tracked again.
    """
    check(job)
    if (known := ended(job)) is not None:
        if job.out is not None:
            forget(job.out)  # by a kill checkpoints may outlive the run
        return known
    with Outputs(job) as outputs:
        if (known := ended(job)) is not None:  # meanwhile, by another process
            return known
        if job.split is not None:
            return join(job, outputs, stop, report)
        return track_clip(job, outputs, stop, report, looked)


def track_clip(job: Job, outputs: Outputs, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Track one clip; its results go to `outputs`. Raises and stops as `run`."""
    done = Outcome(job.clip, streamed=job.out is None)
    began, last, before, notes = 0.0, 0, 0, tuple[str, ...]()

    def record(result: FrameResult) -> None:
        nonlocal began, last, notes
        if not began:
            began, notes = time.perf_counter(), notes or result.notes  # the rate leaves the start-up out
            outputs.begin(source, start, result.rows)
        outputs.write(result.rows)
        outputs.keep(result)
        done.count(result)
        if watch is not None:
            watch.count(result)
        last = result.frame.index
        known = partial(Run, last + 1, done.frames, done.lost, done.evidence, notes, at, watch=watch)
        outputs.mark(known, done.frames)
        report(done.frames, source.frames_hint and source.frames_hint + before)

    try:
        with Precompiler(to_dict(job.recipe), job.threads) as compiler:
            start = job.find(job.recipe, stopped=stop, looked=looked)
            compiler.finish(stop)
    except InputError:
        if not stop():
            raise
        done.stopped = stop.reason
        return done
    done.note = start.note
    at, first, resumed = TrackState(), start.frame, outputs.resume(start)
    begins = None if job.piece is None else job.piece.correction
    if begins is not None:
        first = begins
    if resumed is not None:
        first, notes, at = resumed.frame, resumed.notes, resumed.at
        done.frames, done.lost, done.evidence = resumed.frames, dict(resumed.lost), dict(resumed.evidence)
        done.resumed, before = first, resumed.frames
    watch = None if job.out is None else Watch.of(job.recipe, start).after(resumed and resumed.watch)
    with job.open(first) as source:
        source.strict = job.strict
        check_lag(job, source)
        tracker = tracker_for(job.recipe, start, source.size, source.fps)
        if begins is not None and resumed is None:
            tracker = resumed_at(tracker, job.frame(start.frame))
        at.states = restored(tracker, at.states, job.frame)
        try:

            def tracked(frames: Iterator[Frame]) -> Iterator[FrameResult]:
                results = track(tracker, frames, job.recipe.seed, clip=str(job.clip), at=at)
                return lagged(results, job.lag) if job.lag else results

            pipeline.run(
                frames_of(source, first, job.origin(start)),
                tracked,
                record,
                outputs.paint if job.video else None,
                threaded=job.threads > 1,
                stopped=stop,
            )
        except Exception as e:  # whatever it is, what was tracked is kept
            done.error = e
        if done.frames == before:
            if done.error is not None:
                raise done.error
            done.stopped = stop.reason
            return done
        stopped = stop.reason if stop() else None if done.error is None else str(done.error)
        beyond = [] if stopped or job.stop is not None else past_end(start.corrections, last, start.origin)
        unseen = [why] if watch is not None and (why := watch.unseen()) else []
        footer = Footer(
            complete=source.complete and stopped is None,
            stopped=stopped,
            warnings=(*source.warnings, *notes, *beyond, *unseen),
            lost_frames=done.lost,
            variable_fps=source.variable,
            evidence=done.evidence,
        )
        try:
            footer = outputs.close(footer, done)
        except Exception as e:
            done.error = done.error or e
    if watch is not None:
        done.verdict, done.doubtful = watch.line(), bool(watch.doubts())
        if job.fps is None and done.frames > 1 and isinstance(source, FolderSource):
            done.verdict += f"; images have no rate: {source.fps} frames/s is taken, or that of --fps"
    if job.strict and not source.complete and stopped is None:
        done.error = done.error or InputError(source.warnings[-1])
    failed = done.error or outputs.missing  # said last, as the command's error
    said = outputs.told(footer, failed)
    done.files, done.warnings = outputs.written, tuple(line for line in said if line not in unseen)  # in the verdict
    done.frames_per_s = (done.frames - before - 1) / max(time.perf_counter() - began, 1e-9)
    done.complete = footer.complete and done.error is None
    done.stopped = stopped if done.error is None else None
    done.error = failed
    return done


def past_end(corrections: Iterable[Correction], last: int, origin: str) -> list[str]:
    """A line for each correction that the clip, whose last frame is `last`, never came to; `origin` says them."""
    return [
        f"{origin}: the correction of {one.target} at frame {one.frame} is past the end, frame {last}"
        for one in corrections
        if one.frame > last
    ]
