"""One clip to its outputs: what is asked, where it goes, and how everything is closed whatever happens."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numba
import numpy as np

from facetrack_cli.core.errors import InputError, OutputError, UsageError
from facetrack_cli.core.files import (
    FileSink,
    StreamSink,
    beside,
    cannot_write,
    check_folder,
    make_folder,
    remove_folders,
)
from facetrack_cli.core.sets import Lock
from facetrack_cli.core.types import Correction, Frame, Start
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.runs import pipeline
from facetrack_cli.runs.again import Fingerprint, asked, previous
from facetrack_cli.runs.posterior import POSTERIOR, PosteriorWriter, check_smoothing
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import Begin, frames_of
from facetrack_cli.tracking.build.build import tracker_for
from facetrack_cli.tracking.loop import track
from facetrack_cli.tracking.smoothed import lagged
from facetrack_cli.trajectory.diagnostics import EVIDENCE, KNOWN
from facetrack_cli.trajectory.header import is_there, to_record
from facetrack_cli.trajectory.killed import recover, settle
from facetrack_cli.trajectory.manifest import OWNED, Manifest, commit
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import SCHEMA, VERSION, WRITERS, Footer, Format, Header, Writer
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import Source
from facetrack_cli.video.writer import VideoWriter

VIDEO = "annotated.mp4"
LAG_BYTES = 1 << 30  # of the frames that wait for later ones
_File: TypeAlias = FileSink | StreamSink | VideoWriter | PosteriorWriter
Report: TypeAlias = Callable[[int, "int | None"], None]  # frames done, frames in all if that is known


@dataclass(frozen=True)
class Job(Begin):
    """What is asked of one clip. `out` None streams the one format to standard output.

    `lag`: by how many frames rows come later, given the frames up to then. `posterior`: whether it is kept. `strict`:
    whether a clip that is damaged is an error, of which what was tracked is kept.
    """

    recipe: Recipe
    out: Path | None
    _: KW_ONLY
    formats: tuple[Format, ...] = ("csv", "json")
    video: bool = True
    overwrite: bool = False
    threads: int = 2
    lag: int = 0
    posterior: bool = False
    strict: bool = False


@dataclass
class Outcome:
    """What became of one clip. `lost` counts the lost frames of each part; `lost_at_end` are those lost in the last.

    `evidence` sums up each target's.
    `error` ended the run early; what was tracked until then is kept. `note` says where the search for a face began it.
    """

    clip: Path
    files: Sequence[Path] = ()
    frames: int = 0
    frames_per_s: float = 0.0
    lost: dict[str, int] = field(default_factory=dict)
    lost_at_end: tuple[str, ...] = ()
    evidence: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    complete: bool = True
    stopped: str | None = None
    error: Exception | None = None
    streamed: bool = False
    note: str = ""
    again: Manifest | None = None  # the run was done before: nothing was tracked now

    @classmethod
    def of(cls, job: Job, known: Manifest) -> Outcome:
        """That of a run that its folder holds already."""
        assert job.out is not None
        return cls(
            job.clip,
            files=[job.out / name for name in known.files],
            frames=known.frames,
            lost=known.lost_frames,
            lost_at_end=known.lost_at_end,
            complete=known.complete,
            error=InputError(known.warnings[-1]) if job.strict and not known.complete else None,
            again=known,
        )

    def count(self, result: FrameResult) -> None:
        """Take in one more frame."""
        rows = result.rows
        self.frames += 1
        self.lost_at_end = tuple("/".join(rows.names[i]) for i in rows.which[rows.status == "lost"].tolist())
        for part in self.lost_at_end:
            self.lost[part] = self.lost.get(part, 0) + 1
        for target, found in rows.diagnostics.items():
            if np.isfinite(nats := found.get(EVIDENCE.name)).all():
                self.evidence[target] = self.evidence.get(target, 0.0) + float(nats.sum())

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.clip}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames" if self.frames > 1 else "1 frame"]
        if self.again is not None:
            parts.insert(0, "done before")
        elif self.frames > 1:
            parts.append(f"{self.frames_per_s:.1f} frames/s")
        if self.lost:
            parts.append("lost: " + ", ".join(f"{part} in {n}" for part, n in self.lost.items()))
        if self.stopped or not self.complete:
            parts.append(self.stopped or "incomplete")
        where = "standard output" if self.streamed else "nothing"
        if self.files:
            where = f"{self.files[0].parent}{os.sep} ({', '.join(file.name for file in self.files)})"
        return f"{self.clip} -> {where}: {'; '.join(parts)}"


def run(job: Job, stop: Stop, report: Report = lambda done, total: None) -> Outcome:
    """Track one clip into its files; raises, and leaves no file, if nothing was tracked. `stop` is asked each frame.

    An error after the first frame is in the outcome, beside what was kept. What the folder holds of the same job is
    left as it is if it was not cut short by an error, a signal or a kill; else the clip is tracked again.
    """
    check(job)
    known = None if job.overwrite else previous(job)
    if known is not None and known.stopped is None and (VIDEO in known.files or not job.video):
        return Outcome.of(job, known)
    with Outputs(job) as outputs:
        return track_clip(job, outputs, stop, report)


def track_clip(job: Job, outputs: Outputs, stop: Stop, report: Report = lambda done, total: None) -> Outcome:
    """Track one clip; its results go to `outputs`. Raises and stops as `run`."""
    done = Outcome(job.clip, streamed=job.out is None)
    began, last, notes = 0.0, 0, tuple[str, ...]()

    def record(result: FrameResult) -> None:
        nonlocal began, last, notes
        if done.frames == 0:
            began, notes = time.perf_counter(), result.notes  # the rate leaves the start-up out
            outputs.begin(source, start, result.rows)
        outputs.write(result.rows)
        outputs.keep(result)
        done.count(result)
        last = result.frame.index
        report(done.frames, source.frames_hint)

    try:
        start = job.find(job.recipe, stopped=stop)
    except InputError:
        if not stop():
            raise
        done.stopped = stop.reason
        return done
    done.note = start.note
    with job.open(start.frame) as source:
        source.strict = job.strict
        check_lag(job, source)
        tracker = tracker_for(job.recipe, start, source.size)
        try:

            def tracked(frames: Iterator[Frame]) -> Iterator[FrameResult]:
                results = track(tracker, frames, job.recipe.seed, clip=str(job.clip))
                return lagged(results, job.lag) if job.lag else results

            pipeline.run(
                frames_of(source, start.frame, job.origin(start)),
                tracked,
                record,
                outputs.paint if job.video else None,
                threaded=job.threads > 1,
                stopped=stop,
            )
        except Exception as e:  # whatever it is, what was tracked is kept
            done.error = e
        if done.frames == 0:
            if done.error is not None:
                raise done.error
            done.stopped = stop.reason
            return done
        stopped = stop.reason if stop() else None if done.error is None else str(done.error)
        beyond = [] if stopped or job.stop is not None else past_end(start.corrections, last, start.origin)
        footer = Footer(
            complete=source.complete and stopped is None,
            stopped=stopped,
            warnings=(*source.warnings, *notes, *beyond),
            lost_frames=done.lost,
            variable_fps=source.variable,
            evidence=done.evidence,
        )
        try:
            footer = outputs.close(footer, done)
        except Exception as e:
            done.error = done.error or e
    if job.strict and not source.complete and stopped is None:
        done.error = done.error or InputError(source.warnings[-1])
    failed = done.error or outputs.missing  # said last, as the command's error
    done.files, done.warnings = outputs.written, tuple(line for line in footer.warnings if line != str(failed))
    done.frames_per_s = (done.frames - 1) / max(time.perf_counter() - began, 1e-9)
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


# --- outputs -------------------------------------------------------------------------------------------------------


def check(job: Job) -> None:
    """Refuse what cannot work before anything is opened: results in the way, an output that is the input."""
    if job.lag or job.posterior:
        check_smoothing(job.recipe)
    if job.out is not None:
        if is_there(job.out):
            settle(job.out)
        overwrite = job.overwrite or previous(job) is not None  # what is cut short is replaced
        init = job.init if isinstance(job.init, Path) else None
        check_folder(job.out, OWNED, overwrite=overwrite, inputs=(job.clip, init, job.recipe.path))


def check_lag(job: Job, source: Source) -> None:
    """Refuse a lag whose frames, which are all kept, take too much memory."""
    of_frame = 3 * source.size[0] * source.size[1]
    if job.lag * of_frame > LAG_BYTES:
        most = f"at most --lag {LAG_BYTES // of_frame} at {source.size[0]}x{source.size[1]}"
        raise UsageError(f"{job.clip}: {job.lag} frames of this size take too much memory; {most}, or take --smooth")


class Outputs:
    """The files of one job: they appear when the job closes them; one that fails before its first frame leaves none."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._sinks: list[FileSink | StreamSink] = []
        self._made: list[Path] = []
        self._video: VideoWriter | None = None
        self._overlay: Overlay | None = None
        self._writers: list[Writer] = []
        self._posterior: PosteriorWriter | None = None
        self._lock: Lock | None = None
        self.written: list[Path] = []
        self.missing: OutputError | None = None  # why there is no video; the tables are whole all the same

    def __enter__(self) -> Outputs:
        out = self._job.out
        if out is None:
            self._sinks = [StreamSink(sys.stdout.buffer)]  # a stream that is closed says so when it is written
            return self
        self._made = make_folder(out)
        try:
            self._lock = Lock(out).__enter__()
            recover(out, self._lock)
            check(self._job)  # again, as somebody may have written since
            for form in self._job.formats:
                self._sinks.append(FileSink(out / f"trajectory.{form}"))
        except OutputError:
            self.__exit__()
            raise
        return self

    def begin(self, source: Source, start: Start, rows: Trajectory) -> None:
        """Write the headers and start the encoder; `rows` are those of the first frame."""
        header = _header(self._job, source, start, rows)
        self._fingerprint = Fingerprint(self._job.clip)
        if self._lock is not None:
            self._run = Manifest(asked=asked(self._job), clip=self._fingerprint.clip)
            self._lock.note({"run": self._run.model_dump()})
        for form, sink in zip(self._job.formats, self._sinks, strict=True):
            self._writers.append(WRITERS[form](sink, header))
        if self._job.out is not None and self._job.posterior:
            corrections = header["init"].get("corrections", [])
            self._posterior = PosteriorWriter(self._job.out / POSTERIOR, rows.targets, corrections)
        if self._job.out is not None and self._job.video:
            self._overlay = Overlay(source.size, fps=float(source.fps), title=self._job.recipe.name)
            sound = source.path if source.is_video else None
            video = self._job.out / VIDEO
            self._video = VideoWriter(video, source.size, source.fps, audio_from=sound, replace=False)

    def write(self, rows: Trajectory) -> None:
        """Write the rows of one frame."""
        for writer in self._writers:
            writer.write(rows)

    def keep(self, result: FrameResult) -> None:
        """Write what the filters know after one frame, if it is asked for."""
        if self._posterior is not None:
            self._posterior.add(result)

    def paint(self, result: FrameResult) -> None:
        """Draw one result and pass it to the encoder."""
        assert self._overlay is not None and self._video is not None
        if self.missing is None:
            image = self._overlay.draw(result)
            try:
                self._video.write(image, result.frame.time_s)
            except OutputError as e:
                self.missing = e

    def close(self, footer: Footer, done: Outcome) -> Footer:
        """Finish every file, let all replace the old ones, and return the footer; what failed is raised after that.

        The video comes first, so that the trajectory can tell what was wrong with it; `missing` says if there is none.
        """
        errors: list[Exception] = []
        clip = self._fingerprint.end(whole=footer.stopped is None)
        footer = footer._replace(source_sha256=clip.sha256 if clip else "")
        if self._video is not None:
            self._finish(self._video, self._video.close, errors)
            lost = [e for e in errors if isinstance(e, OutputError)]
            self.missing = self.missing or next(iter(lost), None)
            errors = [e for e in errors if e not in lost]
            said = (*self._video.warnings, *(() if self.missing is None else (str(self.missing),)))
            footer = footer._replace(warnings=(*footer.warnings, *said))
        for writer, sink in zip(self._writers, self._sinks, strict=True):
            self._finish(sink, partial(writer.close, footer), errors)
        if self._posterior is not None:
            self._finish(self._posterior, self._posterior.close, errors)
        if self._job.out is not None:
            stopped = footer.stopped or next((str(e) for e in errors), None)
            whole = footer.complete and stopped is None
            ended: dict[str, Any] = {"complete": whole, "stopped": stopped, "warnings": footer.warnings, "clip": clip}
            ended |= {"frames": done.frames, "lost_frames": done.lost, "lost_at_end": done.lost_at_end}
            try:
                commit(self._job.out, self.written, self._run.model_copy(update=ended), anyway=True)
            except OSError as e:
                self.written = []
                errors.append(cannot_write(Path(e.filename or self._job.out), e))
        if errors:
            raise errors[0]
        return footer

    def _finish(self, file: _File, end: Callable[[], None], errors: list[Exception]) -> None:
        try:
            end()
        except Exception as e:
            errors.append(e)
        # a text file that a full disk cut short is kept, a video is not
        if file.path is not None and beside(file.path).is_file():
            self.written.append(file.path)

    def __exit__(self, *_: object) -> None:
        """Drop what was not closed, and the folders made for it."""
        for sink in self._sinks:
            sink.discard()
        for made in (self._video, self._posterior):
            if made is not None:
                made.discard()
        if self._lock is not None:
            self._lock.__exit__()
        remove_folders(self._made)


class Memory(Outputs):
    """Results collected into a `trajectory`, whose header says what a JSON file says of its run."""

    trajectory: Trajectory

    def __enter__(self) -> Memory:
        self._collected = Collector()
        return self

    def begin(self, source: Source, start: Start, rows: Trajectory) -> None:
        self._header = {"schema": SCHEMA, "version": VERSION, **_header(self._job, source, start, rows)}

    def write(self, rows: Trajectory) -> None:
        self._collected.add(rows)

    def close(self, footer: Footer, done: Outcome) -> Footer:
        header = {**self._header, **footer._asdict()}
        self.trajectory = self._collected.trajectory(header=header, path=self._job.clip)
        return footer


def _header(job: Job, source: Source, start: Start, rows: Trajectory) -> Header:
    # those that every facetrack knows are not declared
    declared = {one.name: one for found in rows.diagnostics.values() for one in found.declared if one.name not in KNOWN}
    return {
        "versions": {  # of what the numbers may depend on beside facetrack itself
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "numba": numba.__version__,
        },
        "source": {"path": str(job.clip), "size": list(source.size), "fps": round(float(source.fps), 6)},
        "recipe": {"name": job.recipe.name, **to_dict(job.recipe)},
        "seed": job.recipe.seed,
        "init": {"from": start.origin, **to_record(start)},
        **({"smoothed": {"lag": job.lag}} if job.lag else {}),
        **({"diagnostics": [one.record() for one in declared.values()]} if declared else {}),
    }
