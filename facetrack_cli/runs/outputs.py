"""The results of one job: what is refused before anything runs, and files that are closed whatever happens."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numba
import numpy

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import FileSink, StreamSink
from facetrack_cli.core.output_folder import check_folder, make_folder, remove_folders
from facetrack_cli.core.types import Start
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.runs.job import Job
from facetrack_cli.trajectory.diagnostics import KNOWN
from facetrack_cli.trajectory.start import to_record
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import SCHEMA, VERSION, WRITERS, Footer, Header, Writer
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import Source
from facetrack_cli.video.writer import VideoWriter

VIDEO = "annotated.mp4"


def check(job: Job) -> None:
    """Refuse what cannot work before anything is opened: results in the way, an output that is the input."""
    if job.out is not None:
        names = [*[VIDEO] * job.video, *(f"trajectory.{form}" for form in job.formats)]
        init = job.init if isinstance(job.init, Path) else None
        check_folder(job.out, names, overwrite=job.overwrite, inputs=(job.clip, init, job.recipe.path))


class Outputs:
    """The files of one job: they appear when the job closes them; one that fails before its first frame leaves none."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._sinks: list[FileSink | StreamSink] = []
        self._made: list[Path] = []
        self._video: VideoWriter | None = None
        self._overlay: Overlay | None = None
        self._writers: list[Writer] = []
        self.written: list[Path] = []

    def __enter__(self) -> Outputs:
        out = self._job.out
        if out is None:
            self._sinks = [StreamSink(sys.stdout.buffer)]  # a stream that is closed says so when it is written
            return self
        self._made = make_folder(out)
        try:
            for form in self._job.formats:
                self._sinks.append(FileSink(out / f"trajectory.{form}"))
        except OutputError:
            self.__exit__()
            raise
        return self

    def begin(self, source: Source, start: Start, rows: Trajectory) -> None:
        """Write the headers and start the encoder; `rows` are those of the first frame."""
        header = _header(self._job, source, start, rows)
        for form, sink in zip(self._job.formats, self._sinks, strict=True):
            self._writers.append(WRITERS[form](sink, header))
        if self._job.out is not None and self._job.video:
            self._overlay = Overlay(source.size, fps=float(source.fps), title=self._job.recipe.name)
            sound = source.path if source.is_video else None
            self._video = VideoWriter(self._job.out / VIDEO, source.size, source.fps, audio_from=sound)

    def write(self, rows: Trajectory) -> None:
        """Write the rows of one frame."""
        for writer in self._writers:
            writer.write(rows)

    def paint(self, result: FrameResult) -> None:
        """Draw one result and pass it to the encoder."""
        assert self._overlay is not None and self._video is not None
        self._video.write(self._overlay.draw(result), result.frame.time_s)

    def close(self, footer: Footer) -> Footer:
        """Finish every file and return the footer written; what could not be finished is raised after the others are.

        The video comes first, so that the trajectory can tell what was wrong with it.
        """
        errors: list[Exception] = []
        if self._video is not None:
            self._finish(self._video, self._video.close, errors)
            footer = footer._replace(warnings=(*footer.warnings, *self._video.warnings))
        for writer, sink in zip(self._writers, self._sinks, strict=True):
            self._finish(sink, partial(writer.close, footer), errors)
        if errors:
            raise errors[0]
        return footer

    def _finish(
        self, file: FileSink | StreamSink | VideoWriter, end: Callable[[], None], errors: list[Exception]
    ) -> None:
        try:
            end()
        except Exception as e:
            errors.append(e)
        # a text file that a full disk cut short is kept, a video is not
        if file.path is not None and file.published:
            self.written.append(file.path)

    def __exit__(self, *_: object) -> None:
        """Drop what was not closed, and the folders made for it."""
        for sink in self._sinks:
            sink.discard()
        if self._video is not None:
            self._video.discard()
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

    def close(self, footer: Footer) -> Footer:
        header = {**self._header, **footer._asdict()}
        self.trajectory = self._collected.trajectory(header=header, path=self._job.clip)
        return footer


def _header(job: Job, source: Source, start: Start, rows: Trajectory) -> Header:
    # those that every facetrack knows are not declared
    declared = {one.name: one for found in rows.diagnostics.values() for one in found.declared if one.name not in KNOWN}
    return {
        "versions": {  # of what the numbers may depend on beside facetrack itself
            "python": platform.python_version(),
            "numpy": numpy.__version__,
            "opencv": cv2.__version__,
            "numba": numba.__version__,
        },
        "source": {"path": str(job.clip), "size": list(source.size), "fps": round(float(source.fps), 6)},
        "recipe": {"name": job.recipe.name, **to_dict(job.recipe)},
        "seed": job.recipe.seed,
        "init": {"from": start.origin, **to_record(start)},
        **({"diagnostics": [one.record() for one in declared.values()]} if declared else {}),
    }
