"""The one loop that writes a run: results go into sinks, frame by frame, and all files appear together at its end.

    Results --(a FrameResult a frame)--> Table, PosteriorWriter, RunMonitor, Video

Errors, the wish to stop and checkpoints are known here alone: whatever ends the results, what came before is kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import platform
import shutil
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import cv2
import numba
import numpy as np

from facetrack_cli.core import files
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.npz import Kind, Stored, flatten, restore
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.engine.loop import TrackState
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder import manifest
from facetrack_cli.run_folder.lease import FolderLease, here, utc_now
from facetrack_cli.runs.plan import Job, Outcome, Plan, Report, resolve, silent
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.runs.workers import Painter
from facetrack_cli.trajectory.diagnostics import KNOWN
from facetrack_cli.trajectory.reader import to_record
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import FOOTER, SCHEMA, VERSION, WRITERS, Format, Header
from facetrack_cli.video.source import Source

if TYPE_CHECKING:
    from facetrack_cli.video.writer import VideoWriter

FOLDER: Final = ".checkpoint"
KIND: Final = Kind("facetrack-checkpoint", 1, "checkpoint of a run", "facetrack run")
EVERY_S, EVERY_FRAMES = 30.0, 1000  # between two checkpoints, whichever is less
STATE: Final = "state.npz"
Results: TypeAlias = Generator[FrameResult, None, None]  # of a clip, of a film, of joined chunks
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


class Sink:
    """Takes the results of a run, and writes or counts them. A file is written under the temporary name of `path`."""

    path: Path | None = None
    missing: OutputError | None = None  # why there is no file, though all others are whole

    def begin(self, clip: ClipFacts, header: Header, mark: Any) -> None:
        """Called before the first result. `mark` is what `mark` returned in a run that continues, else None."""

    def write(self, result: FrameResult) -> None:
        """Take one more frame."""

    def mark(self) -> Any:
        """The state from which `begin` can continue; what was written until then is on the disk."""

    def end(self, done: Outcome) -> None:
        """Called after the last result, before any sink is closed. It may add to the outcome, which tables write."""

    def close(self, done: Outcome) -> None:
        """End the file."""

    def discard(self) -> None:
        """Remove the temporary file, if it is still there."""
        if self.path is not None:
            files.discard(self.path)


@dataclass
class RunState:
    """The state of a run: the `frame` to track next, the outcome so far, the tracker's state, the sinks' marks."""

    frame: int
    outcome: Outcome
    at: TrackState = field(default_factory=TrackState)
    sinks: tuple[Any, ...] = ()


class Recorder:
    """A run while it is written, in a `with`: `open` its sinks, `begin`, `write` each result, `close`.

    Without `close` nothing is left. A run with a folder has its lease, keeps checkpoints, and writes run.json; one
    without is streamed, or stays in memory. Raises OutputError, and BusyError where another process writes there. In a
    batch it notes that its clip failed.

    A checkpoint is the whole state of a run, from which the same run goes on: its rows are byte for byte those of a run
    that was never ended; its video is drawn from them at the end. Trackers of OpenCV do not give their state away,
    that of a section from outside may be of any class, and with a lag rows wait in memory: those runs begin from their
    first frame.
    """

    def __init__(self, plan: Plan, stop: Stop | None = None, looked: Report = silent) -> None:
        self.plan, self.sinks = plan, list[Sink]()
        self._stop, self._looked, job = stop or Stop(), looked, plan.job
        self.lease = None if job.out is None else FolderLease(job.out, self._stop)
        self.state = RunState(0, Outcome(source=job.clip, streamed=job.out is None))
        self._checkpoint, self._key = Path(), ""  # the last state, which the key tells from those of other runs
        self._kept_s, self._kept_frames, self._marked = time.monotonic(), 0, dict[str, Any]()
        self._unkept = ""  # why there are no checkpoints
        self.total: int | None = None  # the number of frames that the clip says it has, if it does
        # adds to the outcome how the results ended, and whether nothing ended them early; InputError to keep nothing
        self.ended: Callable[[Outcome, bool], None] = silent

    @property
    def outcome(self) -> Outcome:
        return self.state.outcome

    def __enter__(self) -> Recorder:
        with contextlib.ExitStack() as opened:
            if self.lease is not None and (out := self.plan.job.out) is not None:
                opened.callback(files.remove_folders, files.make_folder(out))
                opened.enter_context(self.lease)
                self._entered_s = time.monotonic()
                manifest.recover(out, self.lease)
                self.plan = resolve(self.plan.job, locked=True)  # somebody may have written since
                self._about: dict[str, Any] = {"asked": self.plan.asked, "networks": self.plan.job.recipe.networks}
                self._about |= {"began": utc_now(), "host": here()[0]}
                vars(self.outcome).update(self._about)
            self._opened = opened.pop_all()
        return self

    def open(self, sinks: Sequence[Sink], start: Start | None = None) -> None:
        """Take the sinks, in whose order a result is written. With a `start` it goes on from the last checkpoint of
        the same job, if that is to be used; the sinks have what was written until then.
        """
        job, last, self.sinks = self.plan.job, None, list(sinks)
        if start is None or job.out is None:
            return
        if job.recipe.filters and not job.lag:
            clip = manifest.clip_stat(job.clip)
            same = [self.plan.asked, _versions(), to_record(start), clip and (clip.bytes, clip.changed_ns)]
            self._key = hashlib.sha256(dumps(same).encode(errors="surrogateescape")).hexdigest()
            self._checkpoint = job.out / FOLDER / STATE
            files.check_plain(self._checkpoint.parent, self._checkpoint)
            with contextlib.suppress(InputError):  # there is none, or it is damaged
                last = KIND.read(self._checkpoint, self._restored) if job.resume and not job.overwrite else None
        if isinstance(last, RunState):
            with contextlib.suppress(InputError, OSError):  # a table was edited, or is gone
                for sink in sinks:
                    if isinstance(sink, Table) and sink.path is not None:
                        manifest.check_belongs(sink.path)
                vars(last.outcome).update(self._about, resumed=last.outcome.frames)
                self.state, self._kept_frames = last, last.outcome.frames
                return
        shutil.rmtree(job.out / FOLDER, ignore_errors=True)

    def _restored(self, stored: Stored) -> Any:
        return restore("run", stored.file) if stored.text("key") == self._key else None

    def begin(self, clip: ClipFacts, start: Start, more: Header, first: FrameResult) -> None:
        """Begin the files, before the `first` result is written; `more` is what JSON says beside clip and start."""
        self._began_s = time.perf_counter()  # the rate leaves the start-up out
        self.total = clip.frames_hint and clip.frames_hint + self.outcome.resumed
        self.outcome.clip = manifest.clip_stat(self.plan.job.clip)
        if self.lease is not None:
            far = {"frame": self.outcome.frames, "frames": self.total}
            self.lease.note({"clip": str(self.plan.job.clip), "run": self.outcome.record(), **far})
        header = _header(self.plan.job, clip, start, more, first.rows)
        for sink, mark in zip(self.sinks, self.state.sinks or [None] * len(self.sinks), strict=True):
            sink.begin(clip, header, mark)

    def write(self, result: FrameResult) -> None:
        """Write one more frame. Without targets, as between joined chunks, it counts in a film alone."""
        if self._marked:  # now that there is one frame more: after the last nothing is kept
            with contextlib.suppress(OutputError, OSError):  # without a checkpoint the run goes on all the same
                self._checkpoint.parent.mkdir(exist_ok=True)
                KIND.write(self._checkpoint, self._marked)
            self._marked = {}
        if any(target.notes for target in result.targets):
            self.outcome.warnings = (*self.outcome.warnings, *result.notes)[:_MAX_NOTES]
        if result.targets or self.plan.everyone:
            for sink in self.sinks:
                sink.write(result)
            self.outcome.count(result.rows)
        self.state.frame = result.frame.index + 1
        if self.lease is not None:
            self.lease.progress(self.outcome.frames, self.total)
        frames, now = self.outcome.frames, time.monotonic()
        if not self._key or not self.state.at.states:
            return
        if frames - self._kept_frames >= EVERY_FRAMES or now - self._kept_s >= EVERY_S:
            self._kept_s, self._kept_frames = now, frames
            self.state.sinks = tuple(sink.mark() for sink in self.sinks)
            try:
                self._marked = {"key": np.array(self._key), **flatten("run", self.state)}
            except TypeError as e:  # a class of a section from outside
                self._key, self._unkept = "", f"no checkpoint: {e}; the same command begins at the first frame"

    def record(self, clip: ClipFacts, start: Start, more: Header, results: Results, report: Report = silent) -> Outcome:
        """Write the results until they end, also because the run is to stop, or by an error. They raise StoppedError
        where nothing is to be kept.

        `report` hears how many frames are written, and how many there are, None if that is not known. An error after
        the first frame is in the outcome, beside what was kept; before it, it is raised, and no file is left.
        """
        begun, error = False, None
        with contextlib.closing(results):
            try:
                for result in results:
                    if not begun:
                        self.begin(clip, start, more, result)
                        begun = True
                    self.write(result)
                    report(self.outcome.frames, self.total)
                    del result  # or two frames are in memory while the next one is tracked
            except StoppedError:
                return Outcome(source=self.plan.job.clip, stopped=self._stop.reason)
            except Exception as e:  # whatever it is, what was tracked is kept
                error = e
        if self.outcome.frames > self.outcome.resumed:
            return self.close(self._stop.reason if self._stop() else None, error)
        if error is not None:
            raise error
        self.outcome.stopped = self._stop.reason
        return self.outcome

    def close(self, stopped: str | None = None, error: Exception | None = None) -> Outcome:
        """Finish every file, let all of them replace the old ones, and return what became of the clip.

        `stopped` says why the run ended early, `error` goes into the outcome.
        """
        done, job = self.outcome, self.plan.job
        self.ended(done, stopped is None and error is None)
        error = error or done.failure
        done.stopped = stopped or (None if error is None else str(error))
        if done.stopped is None and done.clip is not None and not job.chunk:  # the clip of a chunk is the same for all
            try:
                done.source_sha256 = self._digest_of(done.clip)
            except StoppedError:
                done.stopped = self._stop.reason
            done.clip = replace(done.clip, sha256=done.source_sha256)
        if self._unkept and done.stopped is not None:  # or the bytes of a whole run depended on its time
            done.warnings += (self._unkept,)
        done.complete = done.complete and done.stopped is None
        errors: list[Exception] = []
        steps: list[Callable[[Outcome], None]] = [sink.end for sink in reversed(self.sinks)]
        for step in (*steps, *(sink.close for sink in self.sinks)):
            try:
                step(done)
            except Exception as e:
                errors.append(e)
        missing = next((sink.missing for sink in self.sinks if sink.missing is not None), None)
        if self.lease is not None and job.out is not None:
            # a text file that a full disk cut short is kept, a video is not
            paths = [sink.path for sink in self.sinks if sink.path is not None]
            done.paths = [path for path in paths if files.temporary_path(path).is_file()]
            done.ended, done.seconds = utc_now(), round(time.monotonic() - self._entered_s, 3)
            unwritten = next((str(e) for e in errors), None)
            run: manifest.Manifest = replace(
                done, stopped=done.stopped or unwritten, complete=done.complete and not errors
            )
            if job.batch and error is not None and not isinstance(error, OutputError):
                run = manifest.failed(run, error)
            try:
                manifest.commit(self.lease, job.out, done.paths, run)
                done.warnings += (*manifest.outdated(job.out, job.init if isinstance(job.init, Path) else None),)
            except (OutputError, OSError) as e:  # the lease is lost, or the disk is full
                errors.append(files.cannot_write(Path(e.filename or job.out), e) if isinstance(e, OSError) else e)
                done.paths = ()
            if done.stopped is None and not errors and missing is None:
                shutil.rmtree(job.out / FOLDER, ignore_errors=True)
        error = error or next(iter(errors), None)
        if job.strict and not done.complete and done.stopped is None:
            error = error or InputError(done.warnings[-1])
        done.stopped = done.stopped if error is None else None
        done.complete = done.complete and error is None
        done.failure = error or missing  # said last, as the command's error
        done.warnings = tuple(line for line in done.warnings if line != str(done.failure) and line not in done.verdict)
        done.frames_per_s = (done.frames - done.resumed - 1) / max(time.perf_counter() - self._began_s, 1e-9)
        return done

    def _digest_of(self, clip: manifest.Clip) -> str:
        """The checksum of the clip, whose time is not that of its frames. StoppedError once the run is to stop."""
        began = time.perf_counter()

        def heard(count: int) -> None:
            if self._stop():
                raise StoppedError
            if count < clip.bytes:
                self._looked(count // 10**6, clip.bytes // 10**6, "checksum of the clip", "MB")

        digest = manifest.clip_digest(self.plan.job.clip, heard)
        self._began_s += time.perf_counter() - began
        return digest

    def __exit__(self, kind: object = None, error: object = None, trace: object = None) -> None:
        """Drop what was not closed."""
        with self._opened:
            for sink in self.sinks:
                with contextlib.suppress(Exception):
                    sink.discard()
            job = self.plan.job
            if self.lease is not None and job.out is not None and job.batch and isinstance(error, Exception):
                manifest.note_failure(self.lease, job.out, manifest.Manifest(**self._about), job.clip, error)


def _header(job: Job, clip: ClipFacts, start: Start, more: Header, rows: Trajectory) -> Header:
    """What JSON says at its beginning; `rows` are those of the first frame."""
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


def outputs(into: Recorder) -> list[Sink]:
    """The video, if one is drawn, and a table of each format that was asked for."""
    job = into.plan.job
    # of chunks that are joined it is drawn from their rows
    video = [Video(job, job.out)] if job.out is not None and into.plan.draws and job.split is None else []
    return [*video, *(Table(job.out, form) for form in job.formats)]


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
        with contextlib.suppress(OSError):
            self._sink.sync()
        return self._sink.place()

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

    def trajectory(self, done: Outcome) -> Trajectory:
        """The rows, whose header says what a JSON file says of its run."""
        stopped = done.stopped if done.failure is None else str(done.failure)
        header = {**self._header, **{name: getattr(done, name) for name in FOOTER}, "stopped": stopped}
        return self._collected.trajectory(header=header, path=done.source)


class Video(Sink):
    """The annotated video, painted and encoded in a thread of its own.

    `missing` says why there is none; the tables are whole all the same. That of a run that goes on is drawn at its end,
    from all rows.
    """

    def __init__(self, job: Job, out: Path) -> None:
        self._job, self._target = job, out / manifest.VIDEO
        self._into: tuple[Painter, VideoWriter] | None = None

    def begin(self, clip: ClipFacts, header: Header, mark: Any) -> None:
        from facetrack_cli.video.overlay import Overlay
        from facetrack_cli.video.writer import VideoWriter

        if mark is not None:
            return
        self.path = self._target
        overlay = Overlay(clip.size, fps=float(clip.fps), title=self._job.recipe.name)
        video = VideoWriter(self.path, clip.size, clip.fps, clip.aspect, audio_from=clip.sound, replace=False)

        def paint(result: FrameResult) -> None:
            if self.missing is None:
                image = overlay.draw(result)
                try:
                    video.write(image, result.frame.time_s)
                except OutputError as e:
                    self.missing = e

        self._into = Painter(paint, threaded=self._job.threads > 1), video

    def write(self, result: FrameResult) -> None:
        if self._into is not None:
            self._into[0].put(result)

    def mark(self) -> bool:
        return True

    def end(self, done: Outcome) -> None:
        """The video ends before the tables, so that they can say what was wrong with it."""
        if self._into is None:
            return
        painter, video = self._into
        try:
            painter.end()
        finally:
            try:
                video.close()
            except OutputError as e:
                self.missing = self.missing or e
            done.warnings += (*video.warnings, *(() if self.missing is None else (str(self.missing),)))

    def discard(self) -> None:
        if self._into is not None:
            with contextlib.suppress(BaseException):
                self._into[0].end()
            self._into[1].discard()
