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
    from facetrack_cli.recipe.model import Recipe
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

    if isinstance(job.init, Start):
        return place_start(job, job.init)
    if job.box is not None:
        first = job.start if job.init_frame is None else job.init_frame
        return place_start(job, Start(first, {"face": TargetStart(box=job.box)}, "--box"))
    path = starts.find_init(job.clip) if job.init is None else None if job.init == HAAR else Path(job.init)
    if path is None:
        return _look(job, stop)
    start = starts.read_init(path)
    return place_start(job, start if job.init_frame is None else replace(start, frame=job.init_frame))


def _look(job: Job, stop: Stop) -> Start | None:
    origin = "the search" if job.init_frame is None else "--init-frame"
    first = job.start if job.init_frame is None else job.init_frame
    _check_frame(job, first, origin)
    with open_clip(job, first) as source:
        try:
            return search(job.recipe, frames_of(source, first, origin, stop), str(job.clip))
        except InputError:
            if stop():
                return None
            raise


def place_start(job: Job, start: Start) -> Start:
    """The start with what it does not say: points of a target that is a box alone, targets that the recipe names."""
    _check_frame(job, start.frame, origin_of(job, start))

    def first() -> Frame:
        with open_clip(job, start.frame) as source:
            return next(frames_of(source, start.frame, origin_of(job, start)))

    return completed(job.recipe, start, first, str(job.clip), said_in=str(job.clip) if job.box else start.origin)


def completed(recipe: Recipe, start: Start, first: Callable[[], Frame], clip: str, *, said_in: str) -> Start:
    """The start with what it does not say; `first` gives its frame, `said_in` is who gave the box."""
    from facetrack_cli.tracking.start import box_start, check_start, name_targets

    names = list(start.targets)
    if recipe.followed:
        frame = None
        if not set(recipe.followed) <= set(names):
            frame = first()
            check_start(start, frame.size, ())
        return name_targets(start, recipe.followed, frame, left_out=recipe.left_out, clip=clip)
    given = start.targets[names[0]]
    if len(names) > 1 or given.points or given.box is None or not recipe.points:
        return start
    [found] = box_start(first(), given.box, recipe.points, clip=said_in).targets.values()
    return replace(start, targets={names[0]: replace(found, windows=given.windows)})


def search(recipe: Recipe, frames: Iterator[Frame], clip: str) -> Start:
    """The start at the first face that is found in `frames`. Raises InputError if there is none."""
    from facetrack_cli.tracking.start import haar_start, name_targets

    def complete(frame: Frame, start: Start) -> Start:
        return name_targets(start, recipe.followed, frame, left_out=recipe.left_out, clip=clip)

    return haar_start(frames, recipe.points, clip=clip, complete=complete)


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
