"""One clip to its outputs: where they go, where the track starts, and how everything is closed whatever happens."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from facetrack_cli.runs.job import Job, Outcome, Report
from facetrack_cli.runs.outputs import Outputs, Receiver, check
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import find_start, frames_of, open_clip, origin_of
from facetrack_cli.trajectory.writers import Footer

if TYPE_CHECKING:
    from facetrack_cli.core.types import Correction, Start
    from facetrack_cli.tracking.loop import Tracker
    from facetrack_cli.trajectory.trajectory import FrameResult
    from facetrack_cli.video.source import Source


def run(job: Job, stop: Stop, report: Report = lambda done, total: None) -> Outcome:
    """Track one clip into its files. `stop` is asked between frames.

    Raises a FacetrackError when nothing was tracked, and leaves no file then; an error after the first frame is in
    the outcome, beside what was kept.
    """
    check(job)
    with Outputs(job) as outputs:
        return track_clip(job, outputs, stop, report)


def track_clip(job: Job, outputs: Receiver, stop: Stop, report: Report = lambda done, total: None) -> Outcome:
    """Track one clip; its results go to `outputs`. Raises and stops as `run`."""
    start = find_start(job, stop)
    if start is None:
        return Outcome(job.clip, stopped=stop.reason)
    from facetrack_cli.tracking.build.build import tracker_for

    with open_clip(job, start.frame) as source:
        return _track(job, source, start, tracker_for(job.recipe, start, source.size), outputs, stop, report)


def _track(
    job: Job, source: Source, start: Start, tracker: Tracker, outputs: Receiver, stop: Stop, report: Report
) -> Outcome:
    from facetrack_cli.runs import pipeline
    from facetrack_cli.tracking.loop import track

    tally = _Tally()
    total = source.frames_hint

    def record(result: FrameResult) -> None:
        if tally.frames == 0:
            outputs.begin(source, start, result.rows)
        outputs.write(result.rows)
        tally.count(result)
        report(tally.frames, total)

    error: Exception | None = None
    try:
        pipeline.run(
            frames_of(source, start.frame, origin_of(job, start)),
            lambda frames: track(tracker, frames, job.recipe.seed, clip=str(job.clip)),
            record,
            outputs.paint if job.video else None,
            threaded=job.threads > 1,
            stopped=stop,
        )
    except Exception as e:  # whatever it is, what was tracked is kept
        error = e
    if tally.frames == 0:
        if error is not None:
            raise error
        return Outcome(job.clip, stopped=stop.reason)

    stopped = stop.reason if stop() else str(error) if error is not None else None
    beyond = [] if stopped or job.stop is not None else past_end(start.corrections, tally.last, start.origin)
    footer = Footer(
        complete=source.complete and stopped is None,
        stopped=stopped,
        warnings=(*source.warnings, *tally.notes, *beyond),
        lost_frames=tally.lost,
        variable_fps=source.variable,
    )
    try:
        footer = outputs.close(footer)
    except Exception as e:
        error = error or e
    return Outcome(
        job.clip,
        files=tuple(outputs.written),
        frames=tally.frames,
        frames_per_s=tally.rate(),
        lost=dict(tally.lost),
        lost_at_end=tally.lost_at_end,
        warnings=footer.warnings,
        complete=footer.complete and error is None,
        stopped=None if error is not None else stopped,
        error=error,
        streamed=job.out is None,
    )


def past_end(corrections: Iterable[Correction], last: int, origin: str) -> list[str]:
    """A line for each correction that the clip, whose last frame is `last`, never came to; `origin` says them."""
    return [
        f"{origin}: the correction of {one.target} at frame {one.frame} is past the end, frame {last}"
        for one in corrections
        if one.frame > last
    ]


class _Tally:
    """Counts frames and lost parts, keeps notes, and measures the rate from the first frame on, start-up apart."""

    def __init__(self) -> None:
        self.frames = 0
        self.last = 0
        self.lost: Counter[str] = Counter()
        self.lost_at_end: tuple[str, ...] = ()
        self.notes: tuple[str, ...] = ()
        self._began = 0.0

    def count(self, result: FrameResult) -> None:
        if self.frames == 0:
            self._began = time.perf_counter()
            self.notes = result.notes
        self.frames += 1
        self.last = result.frame.index
        rows = result.rows
        self.lost_at_end = tuple("/".join(rows.names[i]) for i in rows.which[rows.status == "lost"].tolist())
        self.lost.update(self.lost_at_end)

    def rate(self) -> float:
        return (self.frames - 1) / max(time.perf_counter() - self._began, 1e-9)
