"""One clip tracked, from its first frame to closed files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.types import Correction, Frame, Start
from facetrack_cli.engine.corrected import restored
from facetrack_cli.engine.loop import Tracker, TrackState, track
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.checkpoint import forget
from facetrack_cli.runs.job import Job, Outcome, Report, check, check_lag, ended, is_tracked, silent
from facetrack_cli.runs.people import crowded, film_results, film_shots, film_start, name_run
from facetrack_cli.runs.pipeline import decoded_ahead
from facetrack_cli.runs.recording import ClipFacts, Recorder
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import frames_of
from facetrack_cli.runs.stitch import join
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.precompile import Precompiler
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.video.files import brings_rate
from facetrack_cli.video.shots import Shot
from facetrack_cli.video.source import Source


def run(job: Job, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Track one clip into its files; raises, and leaves no file, if nothing was tracked. `stop` is asked each frame.
    Of a clip that is split the chunks, which are there, are joined. `looked` hears of the search for a face.

    An error after the first frame is in the outcome, beside what was kept. What the folder holds of the same job is
    left as it is if it was not cut short by an error, a signal or a kill; else the clip is tracked again.
    """
    check(job)
    if (known := ended(job)) is not None:
        if job.out is not None:
            forget(job.out)  # a kill may leave checkpoints of a run that is done
        return known
    tracked = None if job.overwrite or not _names(job) else job.previous()
    if tracked is not None and is_tracked(tracked):  # and was not named
        return name_run(job, Outcome.of(job, tracked), stop, looked)
    with Recorder(job) as out:
        if (known := ended(job)) is not None:  # meanwhile, by another process
            return known
        done = track_clip(job, out, stop, report, looked) if job.split is None else join(job, out, stop, report)
        if job.split is not None:
            done.frames_per_s = 0.0  # rows were joined, not tracked
    return name_run(job, done, stop, looked) if _names(job) and done.error is None and done.stopped is None else done


def _names(job: Job) -> bool:
    """Whether people are named at the end of a job."""
    return job.everyone and not job.chunk and job.out is not None


def track_clip(job: Job, out: Recorder, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Track one clip; each result is written to `out`. Raises and stops as `run`."""
    found = _find_start(job, stop, looked)
    if found is None:
        out.outcome.stopped = stop.reason
        return out.outcome
    start, shots = found
    state = out.resume(start)
    before, error = state.outcome.frames, None
    with job.open(state.frame) as source:
        check_lag(job, source)
        more = {"shots": [list(one) for one in shots]} if shots else {}
        tracker = () if shots else _tracker(job, start, source, state.at)
        out.begin(ClipFacts.of(job.clip, source), start, more)
        asked = frames_of(source, state.frame, job.origin(start))
        try:
            with decoded_ahead(asked, threaded=job.threads > 1, stopped=stop) as frames:
                followed = film_results(job, shots, source, frames, state.at) if shots else None
                for result in followed or _results(job, tracker, frames, state.at):
                    out.write(result)
                    report(state.outcome.frames, out.total)
                    del result  # or two frames are in memory while the next one is tracked
        except Exception as e:  # whatever it is, what was tracked is kept
            error = e
        if state.outcome.frames == before:
            if error is not None:
                raise error
            out.outcome.stopped = stop.reason
            return out.outcome
        stopped = stop.reason if stop() else None
        if shots and error is None and stopped is None and not job.chunk and not out.outcome.evidence:
            raise InputError(f"{job.clip}: no face found in frames {start.frame} to {state.frame - 1}")
        warnings = (*source.warnings, *state.notes, *(crowded(state.at) if shots else ()))
        if stopped is None and error is None and job.stop is None:
            warnings += past_end(start.corrections, state.frame - 1, start.origin)
        if job.faces == "all" and not shots and start.origin not in DETECTORS:
            named = " and ".join(start.targets)
            warnings += (
                f"{start.origin} says where {named} begins, so --faces all follows no other; --init haar does",
            )
        if state.watch is not None and (unseen := state.watch.unseen()):
            warnings += (unseen,)
        done = out.close(
            stopped=stopped, error=error, complete=source.complete, warnings=warnings, variable_fps=source.variable
        )
        if done.verdict and job.fps is None and done.frames > 1 and not brings_rate(job.clip):
            done.verdict += f"; images have no rate: {source.fps} frames/s is taken, or that of --fps"
        return done


def _find_start(job: Job, stop: Stop, looked: Report) -> tuple[Start, list[Shot]] | None:
    """Where the clip's track begins, looked for while kernels are compiled; None if the search was stopped.

    Where everybody is followed these are the shots of the film; else there are none.
    """
    try:
        with Precompiler(to_dict(job.recipe), job.threads) as compiler:
            if job.everyone:
                start, shots = film_start(job.first), film_shots(job, job.first, stop, looked)
            else:
                start, shots = job.find(job.recipe, stopped=stop, looked=looked), []
            compiler.finish(stop, looked)
            return start, shots
    except InputError:
        if not stop():
            raise
        return None


def _tracker(job: Job, start: Start, source: Source, at: TrackState) -> Tracker:
    """The tracker of a clip, in the state that a run before it reached."""
    tracker = tracker_for(job.recipe, start, source.size, source.fps)
    at.states = restored(tracker, at.states, job.frame)
    return tracker


def _results(job: Job, tracker: Tracker, frames: Iterator[Frame], at: TrackState) -> Iterator[FrameResult]:
    results = track(tracker, frames, job.recipe.seed, clip=str(job.clip), at=at)
    return lagged(results, job.lag) if job.lag else results


def past_end(corrections: Iterable[Correction], last: int, origin: str) -> tuple[str, ...]:
    """A line for each correction that the clip, whose last frame is `last`, never came to; `origin` says them."""
    return tuple(
        f"{origin}: the correction of {one.target} at frame {one.frame} is past the end, frame {last}"
        for one in corrections
        if one.frame > last
    )
