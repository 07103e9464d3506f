"""The Python interface: track a video or any images, by the same functions as the command line."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import chain, dropwhile, tee
from pathlib import Path
from typing import Literal, TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.face_points import DETECTORS, DetectorName
from facetrack_cli.core.types import Box, Frame, Image, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import default_recipe, load_recipe
from facetrack_cli.recipe.model import Recipe, seeded
from facetrack_cli.runs.clip import track_clip
from facetrack_cli.runs.job import Job, check, silent
from facetrack_cli.runs.people import cast_in
from facetrack_cli.runs.posterior import check_smoothing
from facetrack_cli.runs.progress import Bar, Progress, watched
from facetrack_cli.runs.recording import ClipFacts, Memory, Recorder
from facetrack_cli.runs.signals import Stop, never
from facetrack_cli.runs.start import completed, search
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.people import under_names
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory
from facetrack_cli.trajectory.writers import Format
from facetrack_cli.video.overlay.overlay import Overlay

Init: TypeAlias = str | Path | Start | Box
IMAGES = "the images"


def track_video(
    path: str | Path,
    recipe: str | Path | Recipe | None = None,
    *,
    init: Init | None = None,
    seed: int | None = None,
    start: int = 0,
    stop: int | None = None,
    fps: float | None = None,
    lag: int = 0,
    faces: Literal["one", "all"] = "one",
    report: Callable[[int, int | None], None] | None = None,
) -> Trajectory:
    """Track a video file, or a folder of images, from its start to its end; what `facetrack run` does, in memory.

    `recipe` is a recipe, the name of a shipped one, or a file; None: correlation_filter where `init` is a box, else
    face. `init` says where the track starts: an init file; "haar" or "yunet" to look for a face; a box (left, top,
    width, height) in pixels; a `Start`. None: the init file beside the clip, else a face. `start` and `stop` are the
    first frame and the frame to stop before, `fps` the rate of a folder of images. With `lag`, each row takes so many
    later frames into account. `faces` "all": everybody, over cuts; each person is a target, and the trajectory's
    `people` says who is seen when. `report` is called with the frames done and the frames in all, if that is known;
    without it a bar is shown on a terminal and in Jupyter.

    The trajectory's `header` says what a trajectory.json says: source, recipe, seed, init, warnings, `complete`.
    Raises a FacetrackError (RecipeError, InputError) as the command line would print it; what is wrong after the first
    frame ends the trajectory there, with `complete` False and the reason in `stopped`.
    """
    job = Job(
        Path(path),
        chosen_recipe(recipe, seed, init),
        None,
        video=False,
        init=_init(init, start),
        start=start,
        stop=stop,
        fps=None if fps is None else Fraction(fps).limit_denominator(1001),
        lag=lag,
        faces=faces,
    )
    check(job, kept=True)
    with Memory(job) as memory, contextlib.closing(Bar() if report is None and watched() else Progress(True)) as shown:
        shown.begin(job.clip.name)
        error = track_clip(job, memory, Stop(), report or shown.update, shown.looked).error
    if error is not None and not isinstance(error, FacetrackError):
        raise error  # a fault of ours is not the end of a clip
    found = memory.trajectory
    if job.everyone:
        known = cast_in(job, found, never, silent)
        header = {**found.header, "people": known.people.model_dump(mode="json")}
        found = replace(under_names(found, known.tracks), header=header)
    return found


def track_frames(
    images: Iterable[Image],
    recipe: str | Path | Recipe | None = None,
    *,
    init: Init | None = None,
    seed: int | None = None,
    fps: float = 25.0,
    lag: int = 0,
    clock: Callable[[int], float] | None = None,
) -> Iterator[FrameResult]:
    """Track images as they come: from a webcam, a list, an array (T, H, W, 3); a result for each, from the start on.

    Images are (H, W, 3) uint8 in OpenCV's order, blue first, or (H, W) grey, all of one size. `recipe` and `init` are
    those of `track_video`, but there is nothing beside the images: None looks for a face, in at most 250 images.
    With `lag`, each comes so many images later, and its rows take them into account. `clock` is asked for the time of
    each image, in s, by its number; without it images come at `fps`.
    Raises InputError for images that are none, or no start in them.
    """
    chosen = chosen_recipe(recipe, seed, init)
    if lag:
        check_smoothing(chosen)
    frames = _frames(images, clock or (lambda index: index / fps))
    begin = chosen_start(init)
    if begin is None or isinstance(begin, str):
        looked, frames = tee(frames)
        start = search(chosen, looked, IMAGES, by=begin, whole=False)  # all that are looked at are kept
        del looked  # or it would keep all frames
    else:
        start = begin
    frames = dropwhile(lambda frame: frame.index < start.frame, frames)
    found = next(frames, None)
    if found is None:
        raise InputError(f"{IMAGES}: there is no frame {start.frame}, where {start.origin} begins")
    first = found
    start = completed(chosen, start, lambda: first, IMAGES)
    results = track(tracker_for(chosen, start, first.size, fps), chain([first], frames), chosen.seed, clip=IMAGES)
    for result in lagged(results, lag) if lag else results:
        yield replace(result, start=start) if result.frame.index == start.frame else result


class Recording(Recorder):
    """Writes the results of `track_frames` into the folder `out`, in a `with`, as `facetrack run` does.

        with Recording("out", recipe=recipe) as out:
            for result in track_frames(images, recipe):
                out.write(result)

    `recipe` is that of `track_frames`; `clip` names the images in the files, `fps` is their rate. The files appear
    when the block ends; after an exception they hold the frames up to there. Raises InputError for a first result
    without a start, and OutputError for a folder that holds something else, unless `overwrite`.
    """

    def __init__(
        self,
        out: str | Path,
        recipe: str | Path | Recipe | None = None,
        *,
        clip: str | Path = IMAGES,
        fps: float = 25.0,
        formats: Sequence[Format] = ("csv", "json"),
        video: bool = True,
        overwrite: bool = False,
    ) -> None:
        chosen, rate = chosen_recipe(recipe, None, None), Fraction(fps).limit_denominator(1001)
        super().__init__(Job(Path(clip), chosen, Path(out), formats=tuple(formats), video=video, overwrite=overwrite))
        self._rate = rate

    def write(self, result: FrameResult) -> None:
        """Write one more frame."""
        if not self.outcome.frames:
            if result.start is None:
                raise InputError(f"{self.job.out}: the first result has no start; write results of track_frames")
            self.begin(ClipFacts(str(self.job.clip), result.frame.size, self._rate), result.start)
        super().write(result)

    def __exit__(self, kind: object = None, error: object = None, trace: object = None) -> None:
        done = None
        if self.outcome.frames:
            stopped = "interrupted" if isinstance(error, KeyboardInterrupt) else None
            done = self.close(stopped=stopped, error=error if isinstance(error, Exception) else None)
        super().__exit__(kind, error, trace)
        if done is not None and done.error is not None and error is None:
            raise done.error


def draw(result: FrameResult, overlay: Overlay | None = None) -> Image:
    """A new image (H, W, 3) with what the tracker says drawn on its frame; trails need one `overlay` for all frames."""
    return (overlay or Overlay(result.frame.size)).draw(result)


def chosen_recipe(recipe: str | Path | Recipe | None, seed: int | None, init: Init | None) -> Recipe:
    if recipe is None:
        recipe = default_recipe(box=init is not None and not isinstance(init, str | Path | Start))
    if not isinstance(recipe, Recipe):
        recipe = load_recipe(str(recipe))
    return seeded(recipe, seed)


def _init(init: Init | None, start: int) -> Path | DetectorName | Start | None:
    if init is None or isinstance(init, Start):
        return init
    if isinstance(init, str | Path):
        return next((name for name in DETECTORS if name == init), Path(init))
    try:
        left, top, width, height = (float(side) for side in init)
    except (TypeError, ValueError):
        raise InputError(f"init {init!r} is neither a file, a box (left, top, width, height), nor a Start") from None
    return Start(start, {"face": TargetStart(box=(left, top, width, height))}, "init")


def chosen_start(init: Init | None) -> Start | DetectorName | None:
    """Where a track of images begins: at a start, or at the first face that a detector finds."""
    begin = _init(init, 0)
    return read_init(begin) if isinstance(begin, Path) else begin


def _frames(images: Iterable[Image], clock: Callable[[int], float]) -> Iterator[Frame]:
    size: tuple[int, int] | None = None
    for index, image in enumerate(images):
        frame = frame_of(image, index, clock(index), size)
        size = frame.size
        yield frame


def frame_of(given: Image, index: int, time_s: float, size: tuple[int, int] | None) -> Frame:
    """An image as a frame. InputError for what is no image, or not of the `size` (width, height) of those before."""
    image = np.asarray(given)
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise InputError(
            f"image {index}: is {image.dtype} {image.shape}; give (height, width, 3) uint8, blue first, or grey"
        )
    if image.ndim == 2:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    frame = Frame(index, time_s, image)
    if size is not None and frame.size != size:
        raise InputError(f"image {index}: is {frame.size[0]}x{frame.size[1]}, not {size[0]}x{size[1]} as the first")
    return frame
