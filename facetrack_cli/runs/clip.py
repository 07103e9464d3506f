"""One clip tracked, from its first frame to closed files, and what its run comes to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError, OutputError
from facetrack_cli.core.face_points import DETECTORS, HANDS
from facetrack_cli.core.geometry import centre, square
from facetrack_cli.core.npz import STORED
from facetrack_cli.core.numbers import clock, places
from facetrack_cli.core.types import BOX, Box, Correction, Point, Start
from facetrack_cli.engine.corrected import restored
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import calibrated, fitted
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.run_folder.manifest import POSTERIOR, VIDEO, read_manifest
from facetrack_cli.runs.plan import Job, Outcome, Plan, Report, frames_of, resolve, silent
from facetrack_cli.runs.record import ClipFacts, Recorder, Results, Sink, outputs
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.runs.workers import decoded_ahead
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.precompile import precompiling
from facetrack_cli.trackers.face.detectors import Detector, detector
from facetrack_cli.trackers.face.stabilized import BOX as STILL
from facetrack_cli.trackers.face.stabilized import FACE, Similarity, slope
from facetrack_cli.trajectory.diagnostics import DOUBTFUL, NAMED
from facetrack_cli.trajectory.trajectory import SEEN, FrameResult, Trajectory, mean_confidence
from facetrack_cli.trajectory.writers import Header
from facetrack_cli.video.shots import Shot
from facetrack_cli.video.source import brings_rate

EVERY_FRAMES: Final = 15  # between two looks
LOW: Final = 0.9  # the frame of the lowest mean confidence is named if that is less
SURE_OF_NAMES: Final = 0.8  # probability, below which the names of hands are in doubt
MIN_LOOKS: Final = 3  # fewer looks than this say nothing
_MAX_SPANS: Final = 3  # the longest ones, which are named
Spans: TypeAlias = list[tuple[int, int]]  # first and last frames


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
        with Recorder(plan, stop, looked) as into:
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
        plan = plan._replace(job=replace(job, smooth=False))
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


def track_clip(into: Recorder, stop: Stop, report: Report, looked: Report, *sinks: Sink) -> Outcome:
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
    kept = [*sinks] or outputs(into)
    if job.out is not None:
        kept.append(RunMonitor.of(job.recipe, start))
        if job.smooth:
            from facetrack_cli.runs.finished import PosteriorWriter

            kept.append(PosteriorWriter(job.out))
    into.open(kept, start)
    state = into.state
    state.frame, into.outcome.note = state.frame if into.outcome.resumed else start.frame, start.note
    return _follow(into, start, shots, stop, report)


def _follow(into: Recorder, start: Start, shots: list[Shot], stop: Stop, report: Report) -> Outcome:
    """Track a clip, or the `shots` of a film, from its start, or where the state of its run says that it goes on."""
    job, state = into.plan.job, into.state
    with job.open(state.frame) as source:
        clip, more = ClipFacts.of(job.clip, source), {"shots": [list(shot) for shot in shots]} if shots else {}
        asked = frames_of(source, state.frame, job.origin(start))

        def tracked() -> Results:
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
            if shots and state.at.states and (crowd := state.at.states[0].crowd) is not None:
                from facetrack_cli.start.presence import MAX_FACES

                many = f"more than {MAX_FACES} faces at a time, first in frame {crowd}; the largest are followed"
                warnings += (many,)
            if whole and job.stop is None:
                warnings += past_end(start.corrections, state.frame - 1, start.origin)
            if job.faces == "all" and not shots and not job.chunk:
                alone = f"{job.recipe.name} follows those of frame {start.frame}, by {start.origin}, and no other"
                warnings += (f"--faces all: {alone}; recipe face with --init haar follows everybody, over cuts",)
            done.complete, done.warnings, done.variable_fps = source.complete, warnings, source.variable

        into.ended = ended
        done = into.record(clip, start, more, tracked(), report)
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


@dataclass
class RunMonitor(Sink):
    """Counts in bounded memory what the verdict on one run rests on: where it began, and which frames to look at.

    A detector of faces looks, a few times a second, at the place where a face that was searched for is said to be. It
    takes no part in the tracking, so that a track of something else is told from one of a face even if the tracker is
    sure of it. `detector` None: nobody looks.
    """

    start: Start = field(metadata={STORED: False})
    calibrated: bool  # whether confidence is a probability
    fitted: bool  # or one with other settings, which counts where it is low
    detector: Detector | None = field(metadata={STORED: False})
    frames: int = 0
    first: tuple[int, float] = (0, 0.0)
    looks: int = 0
    seen: int = 0
    several: bool = False  # parts
    judged: int = 0  # frames with a confidence
    sure: float = 0.0  # the sum of their means
    least: tuple[float, int] = (np.inf, 0)
    lost_frames: int = 0
    hidden_frames: int = 0
    lost: Spans = field(default_factory=list)  # where a part is lost
    hands: int = -1  # frames in which a hand is seen; -1 where none is followed
    unnamed: Spans = field(default_factory=list)  # where names of hands are in doubt

    @classmethod
    def of(cls, recipe: Recipe, start: Start) -> RunMonitor:
        name = next((name for name in DETECTORS if name == start.origin), None)
        settings = to_dict(recipe)
        return cls(start, calibrated(settings), fitted(settings), None if name is None else detector(name))

    def begin(self, clip: ClipFacts, header: Header, mark: RunMonitor | None) -> None:
        """Go on from what was counted of the frames before."""
        if mark is not None:
            self.__dict__ |= {**vars(mark), "start": self.start, "detector": self.detector}

    def mark(self) -> RunMonitor:
        return self

    def end(self, done: Outcome) -> None:
        done.verdict, done.doubts, done.look = self.line(), self.doubts(), self.look
        if unseen := self.unseen():
            done.warnings += (unseen,)

    def write(self, result: FrameResult) -> None:
        """Take in one more frame, and look at every few."""
        rows = result.rows
        if not len(rows):  # nobody is there
            return
        index, statuses = int(rows.frame[0]), rows.status.tolist()  # NumPy takes longer to compare few texts
        lost = "lost" in statuses
        if not self.frames:
            self.first = index, float(rows.time_s[0])
        self.frames += 1
        self.several |= len(rows) > 1
        if self.detector is not None and self.frames % EVERY_FRAMES == 0 and {*statuses} != {"lost"}:
            self._look(result, self.detector)
        if lost:
            self.lost_frames += 1
            self.lost = _grown(self.lost, index)
        self.hidden_frames += "hidden" in statuses
        confidence = rows.confidence[rows.status != "init"] if "init" in statuses else rows.confidence
        if (confidence := confidence[np.isfinite(confidence)]).size:
            mean = mean_confidence(confidence)
            self.judged, self.sure = self.judged + 1, self.sure + mean
            if not lost:
                self.least = min(self.least, (mean, index))
        if not any(target in HANDS for target, _ in rows.names):
            return
        hands = np.array([target in HANDS for target, _ in rows.names])[rows.which]
        seen = bool((hands & np.isin(rows.status, SEEN)).any())
        self.hands = max(self.hands, 0) + seen
        named = [reported.get(NAMED.name)[0] for target, reported in rows.diagnostics.items() if target in HANDS]
        if seen and named and min(named) < SURE_OF_NAMES:
            self.unnamed = _grown(self.unnamed, index)

    def line(self) -> str:
        """The verdict in one line."""
        why, by = self.doubts(), self.detector and self.detector.name
        who, lost = "some part " if self.several else "", "never called lost"
        if self.lost_frames:
            lost = f"{who}called lost in {self.lost_frames} of {self.frames} frame{'s' * (self.frames > 1)}"
        hidden = f", {who}hidden in {self.hidden_frames}" if self.hidden_frames else ""
        index, time_s = self.first
        skipped = f", {index} frame{'s' * (index > 1)} of the clip are before it" if index else ""
        begins = f"begins in frame {index} ({clock(time_s)}), by {self.start.origin}{skipped}"
        parts = [f"doubtful: {why}" if why else lost + hidden, begins]
        if self.looks and not why:
            parts.append(f"while it is followed, {by} sees a face there in {self.seen} of {self.looks} looks")
        look = [f"{places(sorted(_longest(self.lost)))} (lost)"] if self.lost else []
        if self.least[0] < LOW:
            raw = "" if self.calibrated else ", not calibrated"
            look.append(f"{self.least[1]} (lowest confidence, {self.least[0]:.2f}{raw})")
        if self.unnamed:
            parts.append(f"which hand is which is in doubt in frames {places(sorted(_longest(self.unnamed)))}")
        if look:
            parts.append(f"look at frames {', '.join(look)}")
        return "; ".join(parts)

    @property
    def look(self) -> tuple[tuple[int, int], ...]:
        """First and last frames to look at first: the longest in which a part is lost, else the least sure one."""
        return tuple(_longest(self.lost)) or ((self.least[1],) * 2,) * (self.least[0] < LOW)

    def doubts(self) -> str:
        """What speaks against the track; "" if nothing does."""
        if why := self.unseen():
            return why
        if not self.hands:
            return f"no hand appears in its {self.frames} frames; if another face signs, begin with its --box X,Y,W,H"
        if self.fitted and self.sure < DOUBTFUL * self.judged:
            return f"its confidence expects {self.sure / self.judged:.0%} of its rows to be right"
        return ""

    def unseen(self) -> str:
        """What the detector's looks speak against the track; "" if nothing."""
        if self.detector is None or self.looks < MIN_LOOKS or self.seen >= DOUBTFUL * self.looks:
            return ""
        looks = f"in {self.seen} of {self.looks} looks alone"
        return f"{self.detector.name} sees a face there {looks}; it may be something else, begin with --box X,Y,W,H"

    def _look(self, result: FrameResult, detector: Detector) -> None:
        name, target = next(iter(self.start.targets.items()))  # the first is that of the face that was searched for
        rows = next((target.rows for target in result.targets if target.rows.target == name), None)
        box = None if rows is None or target.box is None else _face(rows, target.box, target.points)
        if rows is not None and box is not None:
            ends = [target.points[part] for part in ("mouth_left", "mouth_right") if part in target.points]
            at_start = slope(np.array(ends)) if len(ends) == 2 else 0.0
            roll = next(iter(np.radians(rows.angle[np.isfinite(rows.angle)])), at_start)
            quarter = np.pi / 2 * round(2 * roll / np.pi)  # a detector sees faces that are less turned
            upright = Similarity(np.array(centre(box)), box[2] / FACE, quarter).read(result.frame)
            self.looks += 1
            self.seen += detector.measure(upright.bgr, STILL) is not None


def _longest(spans: Spans) -> Spans:
    return sorted(spans, key=lambda span: span[0] - span[1])[:_MAX_SPANS]


def _grown(spans: Spans, index: int) -> Spans:
    """The longest spans, and that which goes on to this frame, however short it is."""
    first = next((a for a, b in spans if b == index - 1), index)
    return [*_longest([span for span in spans if span[0] != first]), (first, index)]


def _face(rows: Trajectory, began: Box, points: Mapping[str, Point]) -> Box | None:
    """The face's box by the rows of a target: its own, or that of the start moved as its points have; None if lost."""
    parts = [rows.names[i][1] for i in rows.which.tolist()]
    there = np.isfinite(rows.x + rows.y) & (rows.status != "lost")
    for k in np.flatnonzero(there).tolist():
        if parts[k] not in points:
            return square(np.array([rows.x[k], rows.y[k]]), max(float(np.sqrt(rows.w[k] * rows.h[k])), 2.0))
    by = [(rows.x[k] - points[p][0], rows.y[k] - points[p][1]) for k, p in enumerate(parts) if there[k] and p in points]
    if not by or BOX in parts:
        return None
    x, y = np.mean(by, axis=0).tolist()
    return began[0] + x, began[1] + y, began[2], began[3]
