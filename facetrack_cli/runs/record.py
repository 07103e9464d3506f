"""The one loop that writes a run: results go into sinks, frame by frame, and all files appear together at its end.

    Results --(a FrameResult a frame)--> Table, PosteriorWriter, RunMonitor, Video

Errors, the wish to stop and checkpoints are known here alone: whatever ends the results, what came before is kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numba
import numpy as np

from facetrack_cli.core import files
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.engine.loop import TrackState
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder import checkpoint, manifest
from facetrack_cli.run_folder.checkpoint import Checkpoints, remove_checkpoints
from facetrack_cli.run_folder.lease import FolderLease, here, utc_now
from facetrack_cli.runs.plan import Job, Outcome, Plan, Report, resolve, silent
from facetrack_cli.runs.signals import Stop, Stopped, StoppedError, never
from facetrack_cli.runs.workers import Painter
from facetrack_cli.trajectory.diagnostics import KNOWN
from facetrack_cli.trajectory.reader import CORRECTED, UNSAVED, to_record
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import FOOTER, SCHEMA, VERSION, WRITERS, Format, Header
from facetrack_cli.video.source import Source

if TYPE_CHECKING:
    from facetrack_cli.video.writer import VideoWriter

_MAX_NOTES: Final = 5  # lines that the tracker has for the user, which are kept


class ClipFacts(NamedTuple):
    """What the files of a run say of its clip, and where its sound is."""

    path: str
    size: tuple[int, int]
    fps: Fraction
    sound: Path | None = None
    frames_hint: int | None = None
    aspect: Fraction = Fraction(1)
    begins_s: float = 0.0
    stream: int | None = None

    @classmethod
    def of(cls, clip: Path, source: Source) -> ClipFacts:
        sound = source.path if source.is_video else None
        odd = source.aspect, round(source.begins_s, 4), source.stream
        return cls(str(clip), source.size, source.fps, sound, source.frames_hint, *odd)

    def record(self) -> dict[str, Any]:
        """What `ClipHeader` reads; members that are as in nearly all clips are left out."""
        odd = {"pixel_aspect": round(float(self.aspect), 6)} if self.aspect != 1 else {}
        odd |= {"begins_s": self.begins_s} if self.begins_s else {}
        odd |= {} if self.stream is None else {"stream": self.stream}
        return {"path": self.path, "size": list(self.size), "fps": round(float(self.fps), 6), **odd}


@dataclass(frozen=True)
class Results:
    """The results of a clip, of a film, of joined chunks: whatever is written as a run.

    `header` gives what JSON says at its beginning, by the rows of the first frame. `frames` raises StoppedError where
    nothing is to be kept. `state` is that of the tracker after the last result, for a checkpoint. `ended` adds to the
    outcome how they ended, and is told whether nothing ended them early; it raises InputError where nothing is to be
    kept.
    """

    clip: ClipFacts
    header: Callable[[Trajectory], Header]
    frames: Generator[FrameResult, None, None] | None = None  # of who writes them one by one
    state: TrackState = field(default_factory=TrackState)
    ended: Callable[[Outcome, bool], None] = lambda done, whole: None


class Sink:
    """Takes the results of a run, and writes or counts them. A file is written under the temporary name of `path`."""

    path: Path | None = None
    every = False  # whether it also takes frames without targets, which are none of the run's
    missing: OutputError | None = None  # why there is no file, though all others are whole

    def begin(self, clip: ClipFacts, header: Header, mark: Any) -> None:
        """Called before the first result. `mark` is what `mark` returned in a run that continues, else None."""

    def write(self, result: FrameResult) -> None:
        """Take one more frame."""

    def mark(self) -> Any:
        """The state from which `begin` can continue."""

    def sync(self) -> None:
        """Flush what was written to the disk, before a checkpoint relies on it. Raises OSError."""

    def end(self, done: Outcome) -> None:
        """Called after the last result, before any sink is closed. It may add to the outcome, which tables write."""

    def close(self, done: Outcome) -> None:
        """End the file."""

    def discard(self) -> None:
        """Remove the temporary file, if it is still there."""


@dataclass
class RunState:
    """The state of a run: the `frame` to track next, the outcome so far, the tracker's state, the sinks' marks."""

    frame: int
    outcome: Outcome
    at: TrackState = field(default_factory=TrackState)
    notes: tuple[str, ...] = ()
    sinks: tuple[Any, ...] = ()


class RunFolder:
    """The folder of a run, in a `with`, while it is written: its lease, its checkpoints, and its run.json.

    Raises OutputError, and BusyError where another process writes there. In a batch it notes that its clip failed.
    """

    def __init__(self, plan: Plan, stopped: Stopped = never) -> None:
        assert plan.job.out is not None
        self.plan, self.path = plan, plan.job.out
        self.checkpoints: Checkpoints | None = None
        self.lease = FolderLease(self.path, stopped)
        self._run = manifest.Manifest(networks=plan.job.recipe.networks, host=here()[0])

    def __enter__(self) -> RunFolder:
        with contextlib.ExitStack() as opened:
            opened.callback(files.remove_folders, files.make_folder(self.path))
            opened.enter_context(self.lease)
            self._entered_s = time.monotonic()
            manifest.recover(self.path, self.lease)
            self.plan = resolve(self.plan.job, locked=True)  # somebody may have written since
            self._run.began, self._run.asked = utc_now(), self.plan.asked
            self._opened = opened.pop_all()
        return self

    def resume(self, start: Start, sinks: Sequence[Sink]) -> RunState | None:
        """The last checkpoint of the same job; None if there is none, or it is not to be used."""
        job, last = self.plan.job, None
        if job.recipe.filters and not job.lag:
            clip = manifest.clip_stat(job.clip)
            same = [self._run.asked, _versions(), to_record(start), clip and (clip.bytes, clip.changed_ns)]
            key = hashlib.sha256(dumps(same).encode(errors="surrogateescape")).hexdigest()
            self.checkpoints = Checkpoints(self.path, key, video=self.plan.draws)
            last = self.checkpoints.find() if job.resume and not job.overwrite else None
        if isinstance(last, RunState):
            with contextlib.suppress(InputError, OSError):  # a table was edited, or is gone
                for sink in sinks:
                    if isinstance(sink, Table) and sink.path is not None:
                        manifest.check_belongs(sink.path)
                last.outcome.resumed = last.frame
                return last
        remove_checkpoints(self.path)
        return None

    def begin(self, digest: manifest.ClipDigest, frames: int, total: int | None) -> None:
        """Note what is being written."""
        self._run.clip = digest.clip
        self.lease.note({"clip": str(self.plan.job.clip), "run": self._run.record(), "frame": frames, "frames": total})

    def end_checkpoints(self, *_: object) -> None:
        """Wait until every checkpoint is written."""
        if self.checkpoints is not None:
            self.checkpoints.end()

    def commit(
        self, done: Outcome, clip: manifest.Clip | None, resumed: int, error: Exception | None, errors: list[Exception]
    ) -> list[str]:
        """Let the finished files replace the old ones. Returns lines on files that are left of an earlier track.

        `error` ended the run; those of writing are added to `errors`.
        """
        members = ("frames", "lost_frames", "lost_at_end", "warnings", "doubts", "look", "borne_out")
        stopped = done.stopped or next((str(e) for e in errors), None)
        run = replace(
            self._run,
            **{name: getattr(done, name) for name in members},
            stopped=stopped,
            complete=done.complete and stopped is None,
            clip=clip,
            resumed=resumed,
            ended=utc_now(),
            seconds=round(time.monotonic() - self._entered_s, 3),
        )
        done.network = run.network
        if self.plan.job.batch and error is not None and not isinstance(error, OutputError):
            run = manifest.failed(run, error)
        try:
            manifest.commit(self.lease, self.path, done.files, run)
            init = os.path.realpath(self.plan.job.init) if isinstance(self.plan.job.init, Path) else ""
            kept = [path for path in (self.path / CORRECTED, self.path / UNSAVED) if path.is_file()]
            apart = [path for path in kept if os.path.realpath(path) != init]
            said = "holds corrections that this track does not have; take them with --init"
            return [*manifest.outdated(self.path), *(f"{path}: {said} {path}" for path in apart)]
        except OutputError as e:  # the lease is lost
            errors.append(e)
        except OSError as e:
            errors.append(files.cannot_write(Path(e.filename or self.path), e))
        done.files = ()
        return []

    def __exit__(self, kind: object = None, error: object = None, trace: object = None) -> None:
        with self._opened:
            self.end_checkpoints()
            if self.plan.job.batch and isinstance(error, Exception):
                manifest.note_failure(self.lease, self.path, self._run, self.plan.job.clip, error)


class Recorder:
    """Writes results into sinks, in a `with`: `begin`, `write` each, `close`. Without `close` they leave nothing.

    Sinks take a result in their order. `folder` is None of a stream, and of what stays in memory; `resumed` is the last
    checkpoint of a run that goes on.
    """

    def __init__(
        self, plan: Plan, sinks: Sequence[Sink], folder: RunFolder | None = None, resumed: RunState | None = None
    ) -> None:
        self.plan, self.sinks, self._folder = plan, sinks, folder
        job = plan.job
        self.state = resumed or RunState(0, Outcome(clip=job.clip, streamed=job.out is None))
        self.outcome, self._before = self.state.outcome, self.state.outcome.frames
        self.total: int | None = None  # the number of frames that the clip says it has, if it does

    def __enter__(self) -> Recorder:
        return self

    def begin(self, results: Results, first: FrameResult) -> None:
        """Begin the files, before the `first` result is written."""
        self._results, self._began_s = results, time.perf_counter()  # the rate leaves the start-up out
        self.state.at, hint = results.state, results.clip.frames_hint
        self.total = hint and hint + self._before
        self._digest = manifest.ClipDigest(self.plan.job.clip, whole=not self.plan.job.chunk)
        if self._folder is not None:
            self._folder.begin(self._digest, self._before, self.total)
        header = results.header(first.rows)
        for sink, mark in zip(self.sinks, self.state.sinks or [None] * len(self.sinks), strict=True):
            sink.begin(results.clip, header, mark)

    def write(self, result: FrameResult) -> None:
        """Write one more frame. Without targets it counts in a film; between joined chunks it is only drawn."""
        self.state.notes = (*self.state.notes, *result.notes)[:_MAX_NOTES]
        counts = bool(result.targets) or self.plan.everyone
        for sink in self.sinks:
            if counts or sink.every:
                sink.write(result)
        if counts:
            self.outcome.count(result.rows)
        self.state.frame = result.frame.index + 1
        if self._folder is not None:
            self._folder.lease.progress(self.outcome.frames, self.total)
            if (checkpoints := self._folder.checkpoints) is not None:
                checkpoints.release()
                if self.state.at.states and checkpoints.is_due(self.outcome.frames):
                    self.state.sinks = tuple(sink.mark() for sink in self.sinks)
                    if any(sink.missing for sink in self.sinks):
                        return  # a run without its video begins anew
                    checkpoints.mark(self.outcome.frames, self.state, [sink.sync for sink in self.sinks])

    def close(self, stopped: str | None = None, error: Exception | None = None) -> Outcome:
        """Finish every file, let all of them replace the old ones, and return what became of the clip.

        `stopped` says why the run ended early, `error` goes into the outcome.
        """
        done, job, folder = self.outcome, self.plan.job, self._folder
        self._results.ended(done, stopped is None and error is None)
        error = error or done.error
        done.stopped = stopped or (None if error is None else str(error))
        done.complete = done.complete and done.stopped is None
        clip = self._digest.end(whole=done.stopped is None)
        done.source_sha256 = clip.sha256 if clip else ""
        errors: list[Exception] = []
        steps: list[Callable[[Outcome], None]] = [sink.end for sink in reversed(self.sinks)]
        steps += [] if folder is None else [folder.end_checkpoints]
        for step in (*steps, *(sink.close for sink in self.sinks)):
            try:
                step(done)
            except Exception as e:
                errors.append(e)
        missing = next((sink.missing for sink in self.sinks if sink.missing is not None), None)
        if folder is not None:
            # a text file that a full disk cut short is kept, a video is not
            paths = [sink.path for sink in self.sinks if sink.path is not None]
            done.files = [path for path in paths if files.temporary_path(path).is_file()]
            lines = folder.commit(done, clip, self._before, error, errors)
            if done.stopped is None and not errors and missing is None:
                remove_checkpoints(folder.path)
            done.warnings = (*done.warnings, *lines)
        error = error or next(iter(errors), None)
        if job.strict and not done.complete and done.stopped is None:
            error = error or InputError(done.warnings[-1])
        done.stopped = done.stopped if error is None else None
        done.complete = done.complete and error is None
        done.error = error or missing  # said last, as the command's error
        done.warnings = tuple(line for line in done.warnings if line != str(done.error) and line not in done.verdict)
        done.frames_per_s = (done.frames - self._before - 1) / max(time.perf_counter() - self._began_s, 1e-9)
        return done

    def __exit__(self, *_: object) -> None:
        """Drop what was not closed."""
        for sink in self.sinks:
            with contextlib.suppress(Exception):
                sink.discard()


def record(results: Results, into: Recorder, stop: Stop, report: Report = silent) -> Outcome:
    """Write the results until they end, also because `stop` says so, or an error.

    `report` hears how many frames are written, and how many there are, None if that is not known. An error after the
    first frame is in the outcome, beside what was kept; before it, it is raised, and no file is left.
    """
    assert results.frames is not None
    before, begun, error = into.outcome.frames, False, None
    with contextlib.closing(results.frames):
        try:
            for result in results.frames:
                if not begun:
                    into.begin(results, result)
                    begun = True
                into.write(result)
                report(into.outcome.frames, into.total)
                del result  # or two frames are in memory while the next one is tracked
        except StoppedError:
            return Outcome(clip=into.plan.job.clip, stopped=stop.reason)
        except Exception as e:  # whatever it is, what was tracked is kept
            error = e
    if into.outcome.frames == before:
        if error is not None:
            raise error
        into.outcome.stopped = stop.reason
        return into.outcome
    return into.close(stop.reason if stop() else None, error)


def header_of(job: Job, clip: ClipFacts, start: Start, more: Header, rows: Trajectory) -> Header:
    """What JSON says at its beginning, with `more`; `rows` are those of the first frame."""
    # those that every facetrack knows are not declared
    kinds = [kind for reported in rows.diagnostics.values() for kind in reported.declared if kind.name not in KNOWN]
    declared = {kind.name: kind for kind in kinds}
    return {
        "versions": _versions(),
        "source": clip.record(),
        "recipe": {"name": job.recipe.name, **to_dict(job.recipe)},
        "seed": job.recipe.seed,
        "init": {"from": start.origin, **to_record(start)},
        **({"smoothed": {"lag": job.lag}} if job.lag else {}),
        **({"diagnostics": [kind.record() for kind in declared.values()]} if declared else {}),
        **more,
    }


def _versions() -> Mapping[str, str]:
    """Of what the numbers may depend on beside facetrack itself."""
    modules = {"numpy": np, "opencv": cv2, "numba": numba}
    return {"python": platform.python_version(), **{name: module.__version__ for name, module in modules.items()}}


def outputs(plan: Plan, folder: RunFolder | None) -> list[Sink]:
    """The video, if one is drawn, and a table of each format that was asked for."""
    video = [Video(plan, folder)] if folder is not None and plan.draws else []
    return [*video, *(Table(plan.job.out, form) for form in plan.job.formats)]


class Table(Sink):
    """A trajectory in a folder, or on standard output, written a frame at a time."""

    def __init__(self, out: Path | None, form: Format) -> None:
        self._form: Format = form
        self.path = None if out is None else out / f"trajectory.{form}"
        self._sink: files.BytesSink | None = None

    def begin(self, clip: ClipFacts, header: Header, mark: files.Place | None) -> None:
        if self.path is None:
            self._sink = files.StreamSink(sys.stdout.buffer)  # a stream that is closed says so when it is written
        else:
            self._sink = files.FileSink(self.path)
            if mark is not None:
                with files.writing(self.path):
                    self._sink.go_on(self.path, mark)
        self._writer = WRITERS[self._form](self._sink, header, resumed=mark is not None)

    def write(self, result: FrameResult) -> None:
        self._writer.write(result.rows)

    def mark(self) -> files.Place:
        assert isinstance(self._sink, files.FileSink)
        return self._sink.place()

    def sync(self) -> None:
        assert isinstance(self._sink, files.FileSink)
        self._sink.sync()

    def close(self, done: Outcome) -> None:
        self._writer.close(done)

    def discard(self) -> None:
        if self._sink is not None:
            self._sink.discard()


class Rows(Sink):
    """Rows in memory."""

    def __init__(self) -> None:
        self._collected = Collector()

    def begin(self, clip: ClipFacts, header: Header, mark: Any) -> None:
        self._header = {"schema": SCHEMA, "version": VERSION, **header}

    def write(self, result: FrameResult) -> None:
        self._collected.add(result.rows)

    def close(self, done: Outcome) -> None:
        self._halted = done.stopped

    def trajectory(self, done: Outcome) -> Trajectory:
        """The rows, whose header says what a JSON file says of its run."""
        header = {**self._header, **{name: getattr(done, name) for name in FOOTER}, "stopped": self._halted}
        return self._collected.trajectory(header=header, path=done.clip)


class Video(Sink):
    """The annotated video, painted and encoded in a thread of its own, in pieces between which a checkpoint falls.

    `missing` says why there is none; the tables are whole all the same.
    """

    every = True
    path: Path

    def __init__(self, plan: Plan, folder: RunFolder) -> None:
        self.path = folder.path / manifest.VIDEO
        self._title, self._threaded, self._folder = plan.job.recipe.name, plan.job.threads > 1, folder
        self._video: VideoWriter | None = None
        self._painter: Painter | None = None
        self._mark: Any = None

    def begin(self, clip: ClipFacts, header: Header, mark: Any) -> None:
        from facetrack_cli.video.overlay import Overlay
        from facetrack_cli.video.writer import Cut, VideoWriter

        self._overlay, cut = Overlay(clip.size, fps=float(clip.fps), title=self._title), Cut()
        if mark is not None:
            cut, self._overlay.memory = mark
        self._painted, self._pieces = cut.frames, self._folder.checkpoints and self._folder.checkpoints.folder
        about: dict[str, Any] = {"audio_from": clip.sound, "replace": False, "pieces": self._pieces, "after": cut}
        self._video = VideoWriter(self.path, clip.size, clip.fps, clip.aspect, **about)
        self._painter = Painter(self._paint, threaded=self._threaded)

    def write(self, result: FrameResult) -> None:
        assert self._painter is not None
        if all(result.frame.size):  # of joined chunks a frame may be gone
            self._painter.put(result)

    def _paint(self, result: FrameResult) -> None:
        assert self._video is not None
        if self.missing is not None:
            return
        image = self._overlay.draw(result)
        try:
            self._video.write(image, result.frame.time_s)
            self._painted += 1
            if self._pieces and self._painted % checkpoint.PIECE_FRAMES == 0:
                cut, finish = self._video.cut()
                finish()
                self._mark = cut, self._overlay.memory
        except OutputError as e:
            self.missing = e

    def mark(self) -> Any:
        """Where the last piece ended, which is the last frame wherever a run is marked."""
        assert self._painter is not None
        self._painter.wait()
        return self._mark

    def end(self, done: Outcome) -> None:
        """The video ends before the tables, so that they can say what was wrong with it."""
        assert self._video is not None and self._painter is not None
        try:
            self._painter.end()
        finally:
            try:
                self._video.close()
            except OutputError as e:
                self.missing = self.missing or e
            done.warnings += (*self._video.warnings, *(() if self.missing is None else (str(self.missing),)))

    def discard(self) -> None:
        if self._painter is not None:
            with contextlib.suppress(BaseException):
                self._painter.end()
        if self._video is not None:
            self._video.discard()
