"""One clip to its outputs: where they go, where the track starts, and how everything is closed whatever happens."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from facetrack_cli.errors import InputError
from facetrack_cli.outputs import Outputs, check
from facetrack_cli.stopping import Stop
from facetrack_cli.trajectory import Footer, Format

if TYPE_CHECKING:
    from facetrack_cli.recipe import Recipe
    from facetrack_cli.track import Tracker
    from facetrack_cli.types import Box, Correction, Frame, Result, Start
    from facetrack_cli.video.source import Source

HAAR: Final = "haar"
LEAST_WINDOW: Final = 3.0  # pixels; windows are not made smaller
Report: TypeAlias = Callable[[int, "int | None"], None]  # frames done, frames in all if that is known


@dataclass(frozen=True)
class Job:
    """What is asked of one clip. `out` None streams the one format to standard output.

    `init` is an init file, "haar" to look for a face whatever lies beside the clip, or None for the usual order.
    """

    clip: Path
    recipe: Recipe
    out: Path | None
    formats: tuple[Format, ...] = ("csv", "json")
    video: bool = True
    init: Path | Literal["haar"] | None = None
    box: Box | None = None
    init_frame: int | None = None
    start: int = 0
    stop: int | None = None
    fps: Fraction | None = None
    overwrite: bool = False
    threads: int = 2


@dataclass(frozen=True)
class Outcome:
    """What became of one clip. `lost` counts the lost frames of each part; `lost_at_end` are those lost in the last.

    `error` ended the run early; what was tracked until then is kept.
    """

    clip: Path
    files: tuple[Path, ...] = ()
    frames: int = 0
    frames_per_s: float = 0.0
    lost: dict[str, int] = field(default_factory=dict)
    lost_at_end: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    complete: bool = True
    stopped: str | None = None
    error: Exception | None = None
    streamed: bool = False

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.clip}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames", f"{self.frames_per_s:.1f} frames/s"] if self.frames > 1 else ["1 frame"]
        if self.lost:
            parts.append("lost: " + ", ".join(f"{part} in {n}" for part, n in self.lost.items()))
        if self.stopped:
            parts.append(self.stopped)
        elif not self.complete:
            parts.append("incomplete")
        return f"{self.clip} -> {_where(self.files, self.streamed)}: {'; '.join(parts)}"


def _where(files: tuple[Path, ...], streamed: bool) -> str:
    if not files:
        return "standard output" if streamed else "nothing"
    return f"{files[0].parent}{os.sep} ({', '.join(f.name for f in files)})"


def run(job: Job, stop: Stop, report: Report = lambda done, total: None) -> Outcome:
    """Track one clip into its outputs. `stop` is asked between frames.

    Raises a FacetrackError when nothing was tracked, and leaves no file then; an error after the first frame is in
    the outcome, beside what was kept.
    """
    check(job)
    from facetrack_cli.build import build_tracker
    from facetrack_cli.start import check_start

    with Outputs(job) as outputs:
        start = find_start(job, stop)
        if start is None:
            return Outcome(job.clip, stopped=stop.reason)
        with _open(job, start.frame) as source:
            check_start(start, source.size, job.recipe.points)
            tracker = build_tracker(job.recipe, start)
            check_windows(job.recipe, tracker, source.size, start.origin)
            return _track(job, source, start, tracker, outputs, stop, report)


def _track(
    job: Job, source: Source, start: Start, tracker: Tracker, outputs: Outputs, stop: Stop, report: Report
) -> Outcome:
    from facetrack_cli import pipeline
    from facetrack_cli.track import track

    tally = _Tally()
    total = source.frames_hint

    def record(result: Result) -> None:
        if tally.frames == 0:
            outputs.begin(source, start)
        for writer in outputs.writers:
            writer.write(result)
        tally.count(result)
        report(tally.frames, total)

    error: Exception | None = None
    try:
        pipeline.run(
            _frames(source, start.frame, _origin(job, start)),
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

    def count(self, result: Result) -> None:
        if self.frames == 0:
            self._began = time.perf_counter()
            self.notes = result.notes
        self.frames += 1
        self.last = result.frame.index
        self.lost_at_end = tuple(
            f"{target.name}/{part.name}" for target in result.targets for part in target.parts if part.status == "lost"
        )
        self.lost.update(self.lost_at_end)

    def rate(self) -> float:
        return (self.frames - 1) / max(time.perf_counter() - self._began, 1e-9)


def _open(job: Job, first: int) -> Source:
    from facetrack_cli.video.source import open_source

    return open_source(job.clip, fps=job.fps, start=first, stop=job.stop)


def _frames(source: Source, first: int, origin: str, stop: Callable[[], bool] = lambda: False) -> Iterator[Frame]:
    """The frames from the `first`, which `origin` asked for; InputError, which says so, if that one cannot be had."""
    frames = iter(source)
    try:
        frame = next(frames, None)
    except InputError as e:
        raise InputError(f"{e} (frame {first} is where {origin} begins)") from None
    if frame is None:
        raise InputError(source.warnings.pop() if source.warnings else f"{source.path}: frame {first} cannot be read")
    while frame is not None and not stop():
        yield frame
        frame = next(frames, None)


def find_start(job: Job, stop: Stop) -> Start | None:
    """Where to begin: the init file or box given, the init file beside the clip, or a face. None when stopped.

    Raises InputError when there is no such place in the frames asked for.
    """
    from facetrack_cli import start as starts
    from facetrack_cli.types import Start, TargetStart

    if job.box is not None:
        first = job.start if job.init_frame is None else job.init_frame
        return place_start(job, Start(first, {"face": TargetStart(box=job.box)}, "--box"))
    path = starts.find_init(job.clip) if job.init is None else None if job.init == HAAR else Path(job.init)
    if path is None:
        return _look(job, stop)
    start = starts.read_init(path)
    return place_start(job, start if job.init_frame is None else replace(start, frame=job.init_frame))


def _look(job: Job, stop: Stop) -> Start | None:
    from facetrack_cli.start import haar_start

    origin = "the search" if job.init_frame is None else "--init-frame"
    first = job.start if job.init_frame is None else job.init_frame
    _check_frame(job, first, origin)
    with _open(job, first) as source:
        try:
            return haar_start(
                _frames(source, first, origin, stop),
                job.recipe.points,
                clip=str(job.clip),
                complete=lambda frame, start: _named(job, start, frame),
            )
        except InputError:
            if stop():
                return None
            raise


def place_start(job: Job, start: Start) -> Start:
    """The start with what it does not say: points of a target that is a box alone, targets that the recipe names."""
    from facetrack_cli.start import box_start, check_start

    _check_frame(job, start.frame, _origin(job, start))
    names = list(start.targets)
    if job.recipe.followed:
        if set(job.recipe.followed) <= set(names):
            return _named(job, start, None)
        with _open(job, start.frame) as source:
            frame = next(_frames(source, start.frame, _origin(job, start)))
        check_start(start, frame.size, ())
        return _named(job, start, frame)
    given = start.targets[names[0]]
    if len(names) > 1 or given.points or given.box is None or not job.recipe.points:
        return start
    with _open(job, start.frame) as source:
        frame = next(_frames(source, start.frame, _origin(job, start)))
    said_in = str(job.clip) if job.box is not None else start.origin
    placed = box_start(frame, given.box, job.recipe.points, clip=said_in)
    [found] = placed.targets.values()
    return replace(start, targets={names[0]: replace(found, windows=given.windows)})


def _named(job: Job, start: Start, frame: Frame | None) -> Start:
    """The start with the targets that the recipe names, if it names any."""
    from facetrack_cli.start import name_targets

    return name_targets(start, job.recipe.followed, frame, left_out=job.recipe.left_out, clip=str(job.clip))


def _origin(job: Job, start: Start) -> str:
    """Who said at which frame to start."""
    return start.origin if job.init_frame is None else "--init-frame"


def check_windows(recipe: Recipe, tracker: Tracker, size: tuple[int, int], origin: str) -> None:
    """Refuse windows and boxes beyond the picture: hardly anything but its border, and memory without end.

    `origin` says who gave the boxes.
    """
    for target in tracker:
        for part, (w, h) in target.windows.items():
            if max(w / size[0], h / size[1]) <= 1 or max(w, h) <= LEAST_WINDOW:
                continue
            picture = f"larger than the picture of {size[0]}x{size[1]}; make it smaller"
            if not recipe.points:
                raise InputError(f"{origin}: the box of {target.name}, {w:g}x{h:g} pixels, is {picture}")
            raise recipe.error("target.windows", f"the window of {part} would be {w:.0f}x{h:.0f} pixels, {picture}")


def _check_frame(job: Job, frame: int, origin: str) -> None:
    if job.start <= frame and (job.stop is None or frame < job.stop):
        return
    asked = f"from {job.start} on" if job.stop is None else f"{job.start} to {job.stop - 1}"
    raise InputError(
        f"{job.clip}: {origin} begins at frame {frame}, but frames {asked} were asked for; "
        "change --start or --stop, give another --init-frame, or look for the face with --init haar"
    )
