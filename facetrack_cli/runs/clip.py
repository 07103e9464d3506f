"""One clip tracked, from its first frame to closed files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from facetrack_cli.core.errors import FacetrackError, InputError, OutputError
from facetrack_cli.core.types import Correction, Start
from facetrack_cli.engine.corrected import restored
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.manifest import POSTERIOR, VIDEO, read_manifest
from facetrack_cli.runs import record
from facetrack_cli.runs.plan import Job, Outcome, Plan, Report, frames_of, resolve, silent
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.runs.verdict import RunMonitor
from facetrack_cli.runs.workers import decoded_ahead
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.precompile import precompiling
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.video.shots import Shot
from facetrack_cli.video.source import brings_rate


def run(job: Job, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Track one clip into its files, or join its chunks, once they are tracked.

    What the folder holds of the same job is left as it is if it was not cut short by an error, a signal or a kill; else
    the clip is tracked again. `report` hears how many frames are done, and how many there are, None if that is not
    known; `looked` the same of the search for a face. An error after the first frame is in the outcome, beside what was
    kept. Raises FacetrackError if nothing was tracked; no file is left then.
    """
    plan = resolve(job)
    if (ended := plan.ended()) is not None:
        return ended
    tracked = plan.tracked
    # only named, smoothed or drawn it is not
    if tracked is not None and (plan.names or not job.smooth or POSTERIOR in tracked.files):
        done = replace(Outcome.of(job, tracked), again=False)
    else:
        with record.Recorder(plan, stop) as into:
            plan = into.plan
            if (ended := plan.ended()) is not None:  # meanwhile, by another process
                return ended
            if job.split is None:
                done = track_clip(into, stop, report, looked)
            else:
                from facetrack_cli.runs.split import join_chunks

                done = join_chunks(into, stop, report)
    if done.stopped is not None or job.out is None or isinstance(done.failure, OutputError):
        return done
    if done.failure is not None:  # what was tracked of the clip is drawn all the same
        plan = replace(plan, job=replace(job, smooth=False))
    undrawn = plan.draws and bool(done.paths) and job.out / VIDEO not in done.paths
    unfinished = undrawn or plan.job.smooth or (plan.names and done.failure is None)
    return _finished(plan, done, stop, looked) if unfinished else done


def _finished(plan: Plan, done: Outcome, stop: Stop, looked: Report) -> Outcome:
    """Name, smooth or draw a tracked run; an error is in the outcome. Once `stop`, the same command does it."""
    job, out = plan.job, plan.job.out
    assert out is not None
    what = "nam" if plan.names else "smooth" if job.smooth else "paint"
    try:
        # imported where a run asks for it: a short run takes as long as its imports
        if plan.names:
            from facetrack_cli.runs.people import name_run

            done.note, done.verdict = name_run(job, stop, looked), ""  # which was of tracks without names
        else:
            from facetrack_cli.runs.finished import finish_run

            done.warnings += (*finish_run(job, out, lambda n, of: looked(n, of, f"{what}ing"), stop),)
    except StoppedError:
        done.stopped = stop.reason
        done.warnings += (f"not {what}ed; the same command again does it",)
    except FacetrackError as e:
        done.failure = done.failure or e
    if (run := read_manifest(out)) is not None:
        done.paths = [out / name for name in run.files]
        done.lost_frames, done.lost_at_end, done.smoothed = run.lost_frames, run.lost_at_end, run.smoothed
    return done


def track_clip(into: record.Recorder, stop: Stop, report: Report, looked: Report, *sinks: record.Sink) -> Outcome:
    """Track one clip into some sinks, without any into its tables, and what else its folder holds. Raises as `run`."""
    plan, job = into.plan, into.plan.job
    try:
        with precompiling(to_dict(job.recipe), job.threads) as compile_all:  # while the start is looked for
            if plan.everyone:
                from facetrack_cli.runs.people import ORIGIN, film_shots

                start, shots = Start(job.first, {}, ORIGIN), film_shots(job, stop, looked)
            else:
                start, shots = job.find(job.recipe, stopped=stop, looked=looked), []
            compile_all(stop, looked)
    except InputError:
        if not stop():
            raise
        return Outcome(source=job.clip, streamed=job.out is None, stopped=stop.reason)
    kept = [*sinks] or record.outputs(into)
    if job.out is not None:
        kept.append(RunMonitor.of(job.recipe, start))
        if job.smooth:
            from facetrack_cli.runs.finished import PosteriorWriter

            kept.append(PosteriorWriter(job.out))
    into.open(kept, start)
    state = into.state
    state.frame, into.outcome.note = state.frame if into.outcome.resumed else start.frame, start.note
    return _follow(into, start, shots, stop, report)


def _follow(into: record.Recorder, start: Start, shots: list[Shot], stop: Stop, report: Report) -> Outcome:
    """Track a clip, or the `shots` of a film, from its start, or where the state of its run says that it goes on."""
    job, state = into.plan.job, into.state
    with job.open(state.frame) as source:
        clip, more = record.ClipFacts.of(job.clip, source), {"shots": [list(shot) for shot in shots]} if shots else {}
        asked = frames_of(source, state.frame, job.origin(start))

        def tracked() -> record.Results:
            with decoded_ahead(asked, threaded=job.threads > 1, stopped=stop) as frames:
                if shots:
                    from facetrack_cli.start.presence import MultiFaceTracker

                    faces = MultiFaceTracker(job.recipe, shots, detector(job.by), source.size, job.recipe.seed)
                    yield from faces.follow(frames, state.at)
                    return
                tracker = tracker_for(job.recipe, start, source.size)
                state.at.states = restored(tracker, state.at.states, job.frame)
                results = track(tracker, frames, job.recipe.seed, clip=str(job.clip), at=state.at)
                if job.lag:
                    from facetrack_cli.trackers.smoothed import lagged

                    results = lagged(results, job.lag)
                yield from results

        def ended(done: Outcome, whole: bool) -> None:
            if shots and whole and not job.chunk and not state.outcome.evidence:
                raise InputError(f"{job.clip}: no face found in frames {start.frame} to {state.frame - 1}")
            warnings = (*source.warnings, *done.warnings)
            if shots:
                from facetrack_cli.runs.people import crowded

                warnings += crowded(state.at)
            if whole and job.stop is None:
                warnings += past_end(start.corrections, state.frame - 1, start.origin)
            if job.faces == "all" and not shots and not job.chunk:
                alone = f"{job.recipe.name} follows those of frame {start.frame}, by {start.origin}, and no other"
                warnings += (f"--faces all: {alone}; recipe face with --init haar follows everybody, over cuts",)
            done.complete, done.warnings, done.variable_fps = source.complete, warnings, source.variable

        into.ended = ended
        done = into.record(clip, start, more, tracked(), stop, report)
    if done.verdict and job.fps is None and done.frames > 1 and not brings_rate(job.clip):
        done.verdict += f"; images have no rate: {clip.fps} frames/s is taken, or that of --fps"
    return done


def past_end(corrections: Iterable[Correction], last: int, origin: str) -> tuple[str, ...]:
    """A line for each correction that the clip, whose last frame is `last`, never came to; `origin` says them."""
    return tuple(
        f"{origin}: the correction of {correction.target} at frame {correction.frame} is past the end, frame {last}"
        for correction in corrections
        if correction.frame > last
    )
