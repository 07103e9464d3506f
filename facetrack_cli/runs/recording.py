"""The files of one clip, written frame by frame: they appear together when they are closed, whatever ended the run."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
import numba
import numpy as np

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import (
    FileSink,
    Place,
    StreamSink,
    cannot_write,
    make_folder,
    remove_folders,
    temporary_path,
    writing,
)
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder import checkpoint
from facetrack_cli.run_folder.checkpoint import Checkpoints, forget
from facetrack_cli.run_folder.fingerprint import ClipDigest, quick_digest
from facetrack_cli.run_folder.lease import FolderLease, here, utc_now
from facetrack_cli.run_folder.manifest import (
    POSTERIOR,
    VIDEO,
    Manifest,
    check_belongs,
    commit,
    failed,
    outdated,
    recover,
)
from facetrack_cli.runs.job import Job, Outcome, check, note_failure
from facetrack_cli.runs.pipeline import Painter
from facetrack_cli.runs.posterior import PosteriorWriter, WriterState, has_blocks
from facetrack_cli.runs.verdict import Watch
from facetrack_cli.tracking import loop
from facetrack_cli.trajectory.diagnostics import KNOWN
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED, to_record
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import FOOTER, SCHEMA, VERSION, WRITERS, Header, Writer
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import Source
from facetrack_cli.video.writer import VideoWriter

_MAX_NOTES: Final = 5  # lines that the tracker has for the user, which are kept
_Closed: TypeAlias = VideoWriter | FileSink | StreamSink | PosteriorWriter


@dataclass
class RunState:
    """Where a run stands: the `frame` that is tracked next, its outcome so far, and the state of its tracker.

    `tables` are the places reached in its tables, `posterior` the place in posterior.npz.
    """

    frame: int
    outcome: Outcome
    at: loop.TrackState = field(default_factory=loop.TrackState)
    notes: tuple[str, ...] = ()
    watch: Watch | None = None
    tables: tuple[Place, ...] = ()
    posterior: WriterState | None = None


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


class Recorder:
    """The files of one job, in a `with`: `begin`, `write` each frame, `close`. Without `close` they leave nothing.

    `lock` is the lock of the job's folder; None of a stream.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.state = RunState(0, Outcome(clip=job.clip, streamed=job.out is None))
        self.lock: FolderLease | None = None
        self._sinks: list[FileSink | StreamSink] = []
        self._made: list[Path] = []
        self._writers: list[Writer] = []
        self._video: VideoWriter | None = None
        self._painter: Painter | None = None
        self._missing: OutputError | None = None  # why there is no video; the tables are whole all the same
        self._posterior: PosteriorWriter | None = None
        self._checkpoints: Checkpoints | None = None
        self._painted: Any = None  # state of the video in the checkpoint: its pieces, and what the overlay remembers
        self._began_s = 0.0
        self._before = 0  # frames of the run that is gone on with

    @property
    def outcome(self) -> Outcome:
        return self.state.outcome

    def __enter__(self) -> Recorder:
        out = self.job.out
        if out is None:
            self._sinks = [StreamSink(sys.stdout.buffer)]  # a stream that is closed says so when it is written
            return self
        self._made = make_folder(out)
        try:
            self.lock = FolderLease(out).__enter__()
            recover(out, self.lock)
            self._entered_s = time.monotonic()
            self._run = Manifest(
                asked=self.job.digest(), networks=self.job.recipe.networks, host=here()[0], began=utc_now()
            )
            check(self.job, locked=True)  # again, as somebody may have written since
            self._sinks += [FileSink(out / f"trajectory.{form}") for form in self.job.formats]
        except OutputError:
            self.__exit__()
            raise
        return self

    def resume(self, start: Start) -> RunState:
        """Where the last run of the same job stood, if that is known and wished; else the beginning."""
        job = self.job
        self.state.frame, self.outcome.note = start.frame, start.note
        if job.out is not None:
            watch = self.state.watch = Watch.of(job.recipe, start)
            found = None
            if job.recipe.filters and not job.lag:
                told = dumps([self._run.asked, _versions(), to_record(start), quick_digest(job.clip)])
                key = hashlib.sha256(told.encode(errors="surrogateescape")).hexdigest()
                self._checkpoints = Checkpoints(job.out, key, video=job.video and not job.everyone)
                found = self._checkpoints.find() if job.resume and not job.overwrite else None
            if found is not None and isinstance(found[0], RunState) and self._go_on(job.out, found[0]):
                self.state, self._painted = found
                self.outcome.resumed = self.state.frame
                self.state.watch = watch.after(self.state.watch)
            else:
                forget(job.out)
        self._before = self.outcome.frames
        return self.state

    def _go_on(self, out: Path, state: RunState) -> bool:
        """Whether what the last run wrote is there, and taken over."""
        assert self._checkpoints is not None
        if state.posterior is not None and not has_blocks(self._checkpoints.folder, state.posterior):
            return False
        tables = [out / f"trajectory.{form}" for form in self.job.formats]
        try:
            for path in tables:
                check_belongs(path)
        except (InputError, OSError):
            return False
        for path, sink, place in zip(tables, self._sinks, state.tables, strict=True):
            assert isinstance(sink, FileSink)
            with writing(path):
                sink.go_on(path, place)
        return True

    def begin(self, source: ClipFacts, start: Start, more: Header = MappingProxyType({})) -> None:
        """Take the clip and its start, which the headers name, with `more`; the files begin with the first frame."""
        self._source, self._start, self._more = source, start, more

    @property
    def total(self) -> int | None:
        """The number of frames that the clip says it has, with those of the run before; None if not known."""
        hint = self._source.frames_hint
        return hint and hint + self._before

    def write(self, result: FrameResult) -> None:
        """Write one more frame."""
        self.state.notes = (*self.state.notes, *result.notes)[:_MAX_NOTES]
        self.write_rows(result.rows)
        if self._posterior is not None:
            self._posterior.add(result)
        if self.state.watch is not None:
            self.state.watch.count(result)
        self.state.frame = result.frame.index + 1
        self._mark()
        self.paint(result)

    def write_rows(self, rows: Trajectory) -> None:
        """Write the rows of one frame, or of several."""
        if not self._began_s:
            self._open(rows)
        for writer in self._writers:
            writer.write(rows)
        self.outcome.count(rows)
        if self.lock is not None:
            self.lock.progress(self.outcome.frames, self.total)

    def paint(self, result: FrameResult) -> None:
        """Paint a result and encode it, while the next one is tracked."""
        if self._painter is not None:
            self._painter.put(result)

    def _open(self, rows: Trajectory) -> None:
        """Write the headers, and start the encoder; `rows` are those of the first frame that is tracked now."""
        job, source, goes_on = self.job, self._source, self.outcome.resumed is not None
        self._began_s = time.perf_counter()  # the rate leaves the start-up out
        header = {**_header(job, source, self._start, rows), **self._more}
        self._digest = ClipDigest(job.clip, whole=not job.chunk)
        if self.lock is not None:
            self._run.clip = self._digest.clip
            self.lock.progress(self._before, self.total)
            self.lock.note({"clip": str(job.clip), "run": self._run.record()})
        for form, sink in zip(job.formats, self._sinks, strict=False):  # none in memory
            self._writers.append(WRITERS[form](sink, header, begun=goes_on))
        if job.out is None:
            return
        if job.posterior and self._checkpoints is not None:
            corrections, folder = header["init"].get("corrections", []), self._checkpoints.folder
            self._posterior = PosteriorWriter(
                job.out / POSTERIOR, folder, rows.targets, corrections, self.state.posterior
            )
        if job.video and not job.everyone:  # names are known at the end
            self._start_video(job.out / VIDEO)

    def _start_video(self, path: Path) -> None:
        source, checkpoints = self._source, self._checkpoints
        overlay = Overlay(source.size, fps=float(source.fps), title=self.job.recipe.name)
        about: dict[str, Any] = {"audio_from": source.sound, "replace": False}
        if checkpoints is not None:
            about["pieces"] = checkpoints.folder
        if self._painted is not None:
            about["after"], overlay.memory = self._painted
        video = self._video = VideoWriter(path, source.size, source.fps, source.aspect, **about)
        painted = 0 if self._painted is None else self._painted[0].frames

        def paint(result: FrameResult) -> None:
            nonlocal painted
            if self._missing is not None:
                return
            image = overlay.draw(result)
            try:
                video.write(image, result.frame.time_s)
            except OutputError as e:
                self._missing = e
                return
            painted += 1
            if checkpoints is not None:
                checkpoints.release(video=True)
                if painted % checkpoint.PIECE_FRAMES == 0:
                    cut, finish = video.cut()
                    checkpoints.mark_video(painted, (cut, overlay.memory), finish)

        self._painter = Painter(paint, threaded=self.job.threads > 1)

    def _mark(self) -> None:
        """Keep a checkpoint, if it is time to."""
        if self._checkpoints is None:
            return
        self._checkpoints.release()
        if self.state.at.states and self._checkpoints.is_due(self.outcome.frames):
            sinks = [sink for sink in self._sinks if isinstance(sink, FileSink)]
            self.state.tables = tuple(sink.place() for sink in sinks)
            self.state.posterior = None if self._posterior is None else self._posterior.state

            def sync() -> None:
                for sink in sinks:
                    sink.sync()

            self._checkpoints.mark(self.outcome.frames, self.state, sync)

    def close(self, *, stopped: str | None = None, error: Exception | None = None, **ended: Any) -> Outcome:
        """Finish every file, let all of them replace the old ones, and return what became of the clip.

        `stopped` says why the run ended early, `error` goes into the outcome; `ended` are further fields of it. The
        video comes first, so that the tables can tell what was wrong with it.
        """
        done, watch = self.outcome, self.state.watch
        for name, value in ended.items():
            setattr(done, name, value)
        done.stopped = stopped or (None if error is None else str(error))
        done.complete = done.complete and done.stopped is None
        clip = self._digest.end(whole=done.stopped is None)
        done.source_sha256 = clip.sha256 if clip else ""
        errors: list[Exception] = []
        self._end_video(errors)
        for writer, sink in zip(self._writers, self._sinks, strict=True):
            self._finish(sink, partial(writer.close, done), errors)
        if self._posterior is not None:
            self._finish(self._posterior, self._posterior.close, errors)
        older: list[str] = []
        if self.job.out is not None:
            told = {name: getattr(done, name) for name in ("frames", "lost_frames", "lost_at_end", "warnings")}
            halted = done.stopped or next((str(e) for e in errors), None)
            run = replace(self._run, **told, clip=clip, stopped=halted, complete=done.complete and halted is None)
            if watch is not None:
                run = replace(run, doubts=watch.doubts(), look=watch.look, borne_out=watch.bears_out)
            done.network = run.network
            run = replace(
                run, resumed=self._before, ended=utc_now(), seconds=round(time.monotonic() - self._entered_s, 3)
            )
            if self.job.batch and error is not None and not isinstance(error, OutputError):
                run = failed(run, error)
            older = self._commit(self.job.out, run, errors)
            if halted is None and not errors and self._missing is None:
                forget(self.job.out)
        error = error or next(iter(errors), None)
        if self.job.strict and not done.complete and done.stopped is None:
            error = error or InputError(done.warnings[-1])
        done.stopped = done.stopped if error is None else None
        done.complete = done.complete and error is None
        done.error = error or self._missing  # said last, as the command's error
        if watch is not None:
            done.verdict, done.doubtful = watch.line(), bool(watch.doubts())
        unseen = "" if watch is None else watch.unseen()  # which the verdict says
        done.warnings = tuple(line for line in (*done.warnings, *older) if line not in (str(done.error), unseen))
        done.frames_per_s = (done.frames - self._before - 1) / max(time.perf_counter() - self._began_s, 1e-9)
        return done

    def _end_video(self, errors: list[Exception]) -> None:
        if self._painter is not None:
            try:
                self._painter.end()
            except Exception as e:
                errors.append(e)
        if self._checkpoints is not None:
            self._checkpoints.end()
        if self._video is not None:
            failures: list[Exception] = []
            self._finish(self._video, self._video.close, failures)
            self._missing = self._missing or next((e for e in failures if isinstance(e, OutputError)), None)
            errors += [e for e in failures if not isinstance(e, OutputError)]
            said = (*self._video.warnings, *(() if self._missing is None else (str(self._missing),)))
            self.outcome.warnings += said

    def _finish(self, file: _Closed, end: Callable[[], None], errors: list[Exception]) -> None:
        try:
            end()
        except Exception as e:
            errors.append(e)
        # a text file that a full disk cut short is kept, a video is not
        if file.path is not None and temporary_path(file.path).is_file():
            self.outcome.files = (*self.outcome.files, file.path)

    def _commit(self, out: Path, run: Manifest, errors: list[Exception]) -> list[str]:
        """Let the finished files replace the old ones; lines on what is there of the track before."""
        assert self.lock is not None
        try:
            commit(self.lock, out, self.outcome.files, run)
            return [*outdated(out), *_kept_corrections(self.job, out)]
        except OutputError as e:  # the lock is lost
            errors.append(e)
        except OSError as e:
            errors.append(cannot_write(Path(e.filename or out), e))
        self.outcome.files = ()
        return []

    def __exit__(self, kind: object = None, error: object = None, trace: object = None) -> None:
        """Drop what was not closed, and the folders made for it; in a batch say of an error that the clip failed."""
        if self._painter is not None:
            with contextlib.suppress(BaseException):
                self._painter.end()
        if self._checkpoints is not None:
            self._checkpoints.end()
        for sink in self._sinks:
            sink.discard()
        for made in (self._video, self._posterior):
            if made is not None:
                made.discard()
        if self.lock is not None:
            if self.job.batch and isinstance(error, Exception):
                note_failure(self.job, self.lock, error, begun=self._run)
            self.lock.__exit__()
        remove_folders(self._made)


class Memory(Recorder):
    """Results collected into a `trajectory`, whose header says what a JSON file says of its run; none is resumed."""

    trajectory: Trajectory

    def __enter__(self) -> Memory:
        self._collected = Collector()
        return self

    def _open(self, rows: Trajectory) -> None:
        self._header = {"schema": SCHEMA, "version": VERSION, **_header(self.job, self._source, self._start, rows)}
        super()._open(rows)

    def write_rows(self, rows: Trajectory) -> None:
        super().write_rows(rows)
        self._collected.add(rows)

    def close(self, *, stopped: str | None = None, error: Exception | None = None, **ended: Any) -> Outcome:
        done = super().close(stopped=stopped, error=error, **ended)
        halted = stopped or (None if error is None else str(error))
        header = {**self._header, **{name: getattr(done, name) for name in FOOTER}, "stopped": halted}
        self.trajectory = self._collected.trajectory(header=header, path=self.job.clip)
        return done


def _kept_corrections(job: Job, folder: Path) -> list[str]:
    """A line on each file of corrections there, of the track before, that this run did not begin with."""
    files = [folder / name for name in (CORRECTED, UNSAVED)]
    begun = os.path.realpath(job.init) if isinstance(job.init, Path) else ""
    there = [path for path in files if path.is_file() and os.path.realpath(path) != begun]
    return [
        f"{path}: corrections of the track before, kept and not in this one; --init {path} takes them" for path in there
    ]


def _versions() -> Mapping[str, str]:
    """Of what the numbers may depend on beside facetrack itself."""
    known = {"python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__}
    return {**known, "numba": numba.__version__}


def _header(job: Job, source: ClipFacts, start: Start, rows: Trajectory) -> dict[str, Any]:
    # those that every facetrack knows are not declared
    declared = {one.name: one for found in rows.diagnostics.values() for one in found.declared if one.name not in KNOWN}
    return {
        "versions": _versions(),
        "source": source.record(),
        "recipe": {"name": job.recipe.name, **to_dict(job.recipe)},
        "seed": job.recipe.seed,
        "init": {"from": start.origin, **to_record(start)},
        **({"smoothed": {"lag": job.lag}} if job.lag else {}),
        **({"diagnostics": [one.record() for one in declared.values()]} if declared else {}),
    }
