"""The outputs of one clip: files that are closed whatever happens and appear together, a stream, or memory."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import cv2
import numba
import numpy as np

from facetrack_cli.core.claims import Claim, here, utc_now
from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import FileSink, Place, StreamSink, beside, cannot_write, make_folder, remove_folders
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Start
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.runs.again import Fingerprint, asked, ends
from facetrack_cli.runs.checkpoint import PIECE, Checkpoints, Found, Run, forget
from facetrack_cli.runs.failures import failure, note_failure
from facetrack_cli.runs.job import VIDEO, Job, Outcome, check
from facetrack_cli.runs.posterior import POSTERIOR, PosteriorWriter
from facetrack_cli.trajectory.diagnostics import KNOWN
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED, to_record
from facetrack_cli.trajectory.killed import recover
from facetrack_cli.trajectory.manifest import Manifest, commit, outdated
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import SCHEMA, VERSION, WRITERS, Footer, Format, Header, Writer
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import Source
from facetrack_cli.video.writer import Cut, VideoWriter

_File: TypeAlias = FileSink | StreamSink | VideoWriter | PosteriorWriter


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
        self._claim: Claim | None = None
        self._checkpoints: Checkpoints | None = None
        self._after: Found | None = None
        self._painted = 0
        self.written: list[Path] = []
        self.older: tuple[str, ...] = ()  # lines on what is there from a track before
        self.missing: OutputError | None = None  # why there is no video; the tables are whole all the same

    def __enter__(self) -> Outputs:
        out = self._job.out
        if out is None:
            self._sinks = [StreamSink(sys.stdout.buffer)]  # a stream that is closed says so when it is written
            return self
        self._made = make_folder(out)
        try:
            self._claim = Claim(out).__enter__()
            recover(out, self._claim)
            self._began = time.monotonic()
            self._run = Manifest(
                asked=asked(self._job), networks=self._job.recipe.networks, host=here()[0], began=utc_now()
            )
            check(self._job)  # again, as somebody may have written since
            for form in self._job.formats:
                self._sinks.append(FileSink(out / f"trajectory.{form}"))
        except OutputError:
            self.__exit__()
            raise
        return self

    def resume(self, start: Start) -> Run | None:
        """Where the last run of the same job stood, if that is known and wished: what it wrote is gone on with."""
        job = self._job
        if job.out is None:
            return None
        if job.lag or not job.recipe.filters:
            forget(job.out)
            return None
        told = [self._run.asked, _versions(), to_record(start)]
        with contextlib.suppress(OSError):  # of a clip that cannot be read, which is said when it is opened
            told.append(ends(job.clip))
        key = hashlib.sha256(dumps(told).encode(errors="surrogateescape")).hexdigest()
        self._checkpoints = Checkpoints(job.out, key, video=job.video)
        found = self._checkpoints.find() if job.resume and not job.overwrite else None
        if found is None or not self._go_on(found.run):
            forget(job.out)
            return None
        self._after = found
        return found.run

    def _go_on(self, run: Run) -> bool:
        assert self._job.out is not None and self._checkpoints is not None
        if run.posterior is not None:
            try:
                if self._checkpoints.kept(POSTERIOR).stat().st_size < run.posterior.written.bytes:
                    return False
            except OSError:
                return False
        for form, sink in zip(self._job.formats, self._sinks, strict=True):
            assert isinstance(sink, FileSink)
            if not sink.go_on(self._job.out / f"trajectory.{form}", run.tables[form]):
                return False
        return True

    def mark(self, run: Callable[[Mapping[Format, Place], Any], Run], frames: int) -> None:
        """Keep a checkpoint after so many frames, if it is time to; `run` says where the run stands."""
        if self._checkpoints is None:
            return
        self._checkpoints.release()
        if not self._checkpoints.due(frames):
            return
        sinks = [sink for sink in self._sinks if isinstance(sink, FileSink)]
        tables = {form: sink.place() for form, sink in zip(self._job.formats, sinks, strict=True)}

        def sync() -> None:
            for sink in sinks:
                sink.sync()

        posterior = None
        if self._posterior is not None:
            try:
                posterior = self._posterior.place(self._checkpoints.kept(POSTERIOR))
            except OSError:  # of a file system without links
                return
        self._checkpoints.mark(run(tables, posterior), sync)

    def begin(self, source: Source, start: Start, rows: Trajectory, more: Header = MappingProxyType({})) -> None:
        """Write the headers, with `more` in them, and start the encoder; `rows` are those of the first frame that is
        tracked now.
        """
        header = {**_header(self._job, source, start, rows), **more}
        self._fingerprint = Fingerprint(self._job.clip, whole=self._job.piece is None)
        if self._claim is not None:
            self._run = self._run.model_copy(update={"clip": self._fingerprint.clip})
            before = 0 if self._after is None else self._after.run.frames
            self._claim.frame, self._claim.frames = before, source.frames_hint and source.frames_hint + before
            self._claim.note({"clip": str(self._job.clip), "run": self._run.model_dump()})
        for form, sink in zip(self._job.formats, self._sinks, strict=True):
            self._writers.append(WRITERS[form](sink, header, begun=self._after is not None))
        if self._job.out is not None and self._job.posterior:
            corrections = header["init"].get("corrections", [])
            after = None
            if self._checkpoints is not None and self._after is not None and self._after.run.posterior is not None:
                after = self._checkpoints.kept(POSTERIOR), self._after.run.posterior
            self._posterior = PosteriorWriter(self._job.out / POSTERIOR, rows.targets, corrections, after)
        if self._job.out is not None and self._job.video:
            self._overlay = Overlay(source.size, fps=float(source.fps), title=self._job.recipe.name)
            sound = source.path if source.is_video else None
            video = self._job.out / VIDEO
            pieces, cut = None if self._checkpoints is None else self._checkpoints.folder, Cut()
            if self._after is not None and self._after.painted is not None:
                cut, self._overlay.memory = self._after.painted
                self._painted = cut.frames
            self._video = VideoWriter(
                video, source.size, source.fps, audio_from=sound, replace=False, pieces=pieces, after=cut
            )

    def write(self, rows: Trajectory) -> None:
        """Write the rows of one frame."""
        if self._claim is not None:
            self._claim.frame += 1
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
                return
            self._painted += 1
            if self._checkpoints is not None:
                self._checkpoints.release(video=True)
                if self._painted % PIECE == 0:
                    self._checkpoints.painted(self._video.cut, self._painted, self._overlay.memory)

    def close(self, footer: Footer, done: Outcome) -> Footer:
        """Finish every file, let all replace the old ones, and return the footer; what failed is raised after that.

        The video comes first, so that the trajectory can tell what was wrong with it; `missing` says if there is none.
        """
        errors: list[Exception] = []
        clip = self._fingerprint.end(whole=footer.stopped is None)
        footer = footer._replace(source_sha256=clip.sha256 if clip else "")
        if self._checkpoints is not None:
            self._checkpoints.end()
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
            ended |= {"ended": utc_now(), "seconds": round(time.monotonic() - self._began, 3)}
            if self._job.batch and done.error is not None and not isinstance(done.error, OutputError):
                ended |= failure(done.error)
            try:
                commit(self._job.out, self.written, self._run.model_copy(update=ended), claim=self._claim, anyway=True)
                self.older = (*outdated(self._job.out), *_kept(self._job, self._job.out))
            except OutputError as e:  # the claim is lost
                self.written = []
                errors.append(e)
            except OSError as e:
                self.written = []
                errors.append(cannot_write(Path(e.filename or self._job.out), e))
        if self._job.out is not None and footer.stopped is None and not errors and self.missing is None:
            forget(self._job.out)
        if errors:
            raise errors[0]
        return footer

    def told(self, footer: Footer, error: Exception | None) -> tuple[str, ...]:
        """The warnings of a run, but for the one that is its error, and what is older than its track."""
        return (*(line for line in footer.warnings if line != str(error)), *self.older)

    def _finish(self, file: _File, end: Callable[[], None], errors: list[Exception]) -> None:
        try:
            end()
        except Exception as e:
            errors.append(e)
        # a text file that a full disk cut short is kept, a video is not
        if file.path is not None and beside(file.path).is_file():
            self.written.append(file.path)

    def __exit__(self, kind: object = None, error: object = None, trace: object = None) -> None:
        """Drop what was not closed, and the folders made for it; in a batch say of an error that the clip failed."""
        if self._checkpoints is not None:
            self._checkpoints.end()
        for sink in self._sinks:
            sink.discard()
        for made in (self._video, self._posterior):
            if made is not None:
                made.discard()
        if self._claim is not None:
            if self._job.batch and isinstance(error, Exception):
                note_failure(self._job, error, begun=self._run)
            self._claim.__exit__()
        remove_folders(self._made)


class Memory(Outputs):
    """Results collected into a `trajectory`, whose header says what a JSON file says of its run; none is resumed."""

    trajectory: Trajectory

    def __enter__(self) -> Memory:
        self._collected = Collector()
        return self

    def begin(self, source: Source, start: Start, rows: Trajectory, more: Header = MappingProxyType({})) -> None:
        self._header = {"schema": SCHEMA, "version": VERSION, **_header(self._job, source, start, rows)}

    def write(self, rows: Trajectory) -> None:
        self._collected.add(rows)

    def close(self, footer: Footer, done: Outcome) -> Footer:
        header = {**self._header, **footer._asdict()}
        self.trajectory = self._collected.trajectory(header=header, path=self._job.clip)
        return footer


def _kept(job: Job, folder: Path) -> list[str]:
    """A line on each file of corrections there, of the track before, that this run did not begin with."""
    files = [folder / name for name in (CORRECTED, UNSAVED)]
    begun = os.path.realpath(job.init) if isinstance(job.init, Path) else ""
    there = [path for path in files if path.is_file() and os.path.realpath(path) != begun]
    return [
        f"{path}: corrections of the track before, kept and not in this one; --init {path} takes them" for path in there
    ]


def _versions() -> Header:
    """Of what the numbers may depend on beside facetrack itself."""
    known = {"python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__}
    return {**known, "numba": numba.__version__}


def _header(job: Job, source: Source, start: Start, rows: Trajectory) -> Header:
    # those that every facetrack knows are not declared
    declared = {one.name: one for found in rows.diagnostics.values() for one in found.declared if one.name not in KNOWN}
    return {
        "versions": _versions(),
        "source": {"path": str(job.clip), "size": list(source.size), "fps": round(float(source.fps), 6)},
        "recipe": {"name": job.recipe.name, **to_dict(job.recipe)},
        "seed": job.recipe.seed,
        "init": {"from": start.origin, **to_record(start)},
        **({"smoothed": {"lag": job.lag}} if job.lag else {}),
        **({"diagnostics": [one.record() for one in declared.values()]} if declared else {}),
    }
