"""Where the track of a clip starts: an init file, a box, or a face that is looked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from facetrack_cli.core.errors import InputError
from facetrack_cli.runs.job import HAAR, Job
from facetrack_cli.runs.signals import Stop

if TYPE_CHECKING:
    from facetrack_cli.core.types import Frame, Start
    from facetrack_cli.video.source import Source


def open_clip(job: Job, first: int) -> Source:
    from facetrack_cli.video.source import open_source

    return open_source(job.clip, fps=job.fps, start=first, stop=job.stop)


def frames_of(source: Source, first: int, origin: str, stop: Callable[[], bool] = lambda: False) -> Iterator[Frame]:
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
    from facetrack_cli.core.types import Start, TargetStart
    from facetrack_cli.tracking import start as starts

    if job.box is not None:
        first = job.start if job.init_frame is None else job.init_frame
        return place_start(job, Start(first, {"face": TargetStart(box=job.box)}, "--box"))
    path = starts.find_init(job.clip) if job.init is None else None if job.init == HAAR else Path(job.init)
    if path is None:
        return _look(job, stop)
    start = starts.read_init(path)
    return place_start(job, start if job.init_frame is None else replace(start, frame=job.init_frame))


def _look(job: Job, stop: Stop) -> Start | None:
    from facetrack_cli.tracking.start import haar_start

    origin = "the search" if job.init_frame is None else "--init-frame"
    first = job.start if job.init_frame is None else job.init_frame
    _check_frame(job, first, origin)
    with open_clip(job, first) as source:
        try:
            return haar_start(
                frames_of(source, first, origin, stop),
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
    from facetrack_cli.tracking.start import box_start, check_start

    _check_frame(job, start.frame, origin_of(job, start))
    names = list(start.targets)
    if job.recipe.followed:
        if set(job.recipe.followed) <= set(names):
            return _named(job, start, None)
        with open_clip(job, start.frame) as source:
            frame = next(frames_of(source, start.frame, origin_of(job, start)))
        check_start(start, frame.size, ())
        return _named(job, start, frame)
    given = start.targets[names[0]]
    if len(names) > 1 or given.points or given.box is None or not job.recipe.points:
        return start
    with open_clip(job, start.frame) as source:
        frame = next(frames_of(source, start.frame, origin_of(job, start)))
    said_in = str(job.clip) if job.box is not None else start.origin
    placed = box_start(frame, given.box, job.recipe.points, clip=said_in)
    [found] = placed.targets.values()
    return replace(start, targets={names[0]: replace(found, windows=given.windows)})


def _named(job: Job, start: Start, frame: Frame | None) -> Start:
    """The start with the targets that the recipe names, if it names any."""
    from facetrack_cli.tracking.start import name_targets

    return name_targets(start, job.recipe.followed, frame, left_out=job.recipe.left_out, clip=str(job.clip))


def origin_of(job: Job, start: Start) -> str:
    """Who said at which frame to start."""
    return start.origin if job.init_frame is None else "--init-frame"


def _check_frame(job: Job, frame: int, origin: str) -> None:
    if job.start <= frame and (job.stop is None or frame < job.stop):
        return
    asked = f"from {job.start} on" if job.stop is None else f"{job.start} to {job.stop - 1}"
    raise InputError(
        f"{job.clip}: {origin} begins at frame {frame}, but frames {asked} were asked for; "
        "change --start or --stop, give another --init-frame, or look for the face with --init haar"
    )
