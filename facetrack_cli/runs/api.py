"""The Python interface: track a video or any images, by the same functions as the command line.

`Tracker` takes one image at a time, for services and cameras.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.core.face_points import DETECTORS, DetectorName
from facetrack_cli.core.npz import Kind, Stored, flatten, restore
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Box, Frame, Image, Start, TargetStart
from facetrack_cli.engine.loop import TrackState, track
from facetrack_cli.recipe.load import default_recipe, load_recipe
from facetrack_cli.recipe.model import Recipe, seeded, to_dict
from facetrack_cli.runs.clip import track_clip
from facetrack_cli.runs.people import cast_in
from facetrack_cli.runs.plan import Job, check_count, check_smoothing, completed, resolve, silent, with_names
from facetrack_cli.runs.record import ClipFacts, Recorder, Rows, outputs
from facetrack_cli.runs.signals import Stop, never
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.init_file import read_init
from facetrack_cli.start.search import Search
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.people import under_names
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory
from facetrack_cli.trajectory.writers import Format
from facetrack_cli.video.overlay import Overlay

Init: TypeAlias = str | Path | Start | Box
IMAGES = "the images"
KIND: Final = Kind("facetrack-tracker", 1, "state of a tracker", "facetrack.Tracker(...).save(path)")


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

    Parameters
    ----------
    path : the video file, or the folder of images.
    recipe : a recipe, the name of a shipped recipe, or a file; None: correlation_filter where `init` is a box, else
        face.
    init : where the track starts: an init file; "haar" or "yunet" to look for a face; a box (left, top, width, height)
        in pixels; a `Start`. None: the init file beside the clip, else a face.
    seed : of the random numbers; None: that of the recipe.
    start, stop : the first frame, and the frame to stop before.
    fps : the rate of a folder of images, in frames per second.
    lag : each row takes so many later frames into account.
    faces : "all": everybody, over cuts; each person is a target, and the trajectory's `people` says who is seen when.
    report : is called with the frames done and the frames in all, or None where that is not known.

    Returns
    -------
    Trajectory : its `header` says what a trajectory.json says: source, recipe, seed, init, warnings, `complete`. What
        is wrong after the first frame ends it there, with `complete` False and the reason in `stopped`.

    Raises
    ------
    RecipeError, InputError, UsageError : with the line that the command prints.
    """
    asked: Any = {"init": _init(init, start), "start": start, "stop": stop, "lag": lag, "faces": faces}
    rate = None if fps is None else _rate(fps)
    job = Job(Path(path), chosen_recipe(recipe, seed, init), None, video=False, fps=rate, **asked)
    plan = resolve(job, kept=True)
    sink = Rows()
    with Recorder(plan) as into:
        done = track_clip(into, Stop(), report or silent, silent, sink)
    if done.failure is not None and not isinstance(done.failure, FacetrackError):
        raise done.failure  # a fault of ours is not the end of a clip
    rows = sink.trajectory(done)
    if plan.everyone:
        film = cast_in(job, rows, never, silent)
        header = {**rows.header, "people": film.people.model_dump(mode="json")}
        rows = replace(under_names(rows, film.tracks), header=header)
    return rows


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

    Parameters
    ----------
    images : (H, W, 3) uint8 in OpenCV's order, blue first, or (H, W) grey, all of one size.
    recipe, init, seed : as of `track_video`, but there is nothing beside the images: without `init` a face is looked
        for, in at most 250 images.
    fps : images per second.
    lag : each result comes so many images later, and its rows take them into account.
    clock : gives the time of an image, in seconds, by its number; without it images come at `fps`.

    Yields
    ------
    FrameResult : of each image from the start on.

    Raises
    ------
    InputError : for an item that is no such image, and where no image has a start.
    """
    tracker = Tracker(recipe, init=init, seed=seed, fps=fps)
    check_count("lag", lag)
    if lag:
        check_smoothing(tracker.recipe)
    shown = clock or (lambda index: index / fps)
    results = tracker._follow(frames_of((shown(index), image) for index, image in enumerate(images)))
    yield from lagged(results, lag) if lag else results


class Recording:
    """Writes the results of `track_frames` into the folder `out`, in a `with`, as `facetrack run` does.

        with Recording("out", recipe=recipe) as out:
            for result in track_frames(images, recipe):
                out.write(result)

    The files appear when the block ends; after an exception they hold the frames up to there.

    Parameters
    ----------
    out : str or Path
        The folder, which is made.
    recipe : str, Path, Recipe or None
        That of `track_frames`.
    clip : str or Path
        What the images are called in the files.
    fps : float
        Their rate, in images a second.
    formats : Sequence of "csv", "json" and "jsonl"
    video : bool
        Whether an annotated video is written.
    overwrite : bool
        Whether results of something else are replaced.

    Raises
    ------
    InputError
        For a first result without a start.
    OutputError
        For a folder that holds something else, unless `overwrite`, and for what cannot be written.
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
        chosen, self._rate = chosen_recipe(recipe, None, None), _rate(fps)
        self.job = Job(Path(clip), chosen, Path(out), formats=tuple(formats), video=video, overwrite=overwrite)

    def __enter__(self) -> "Recording":
        self._into = Recorder(resolve(self.job)).__enter__()
        self._into.open(outputs(self._into))
        return self

    def write(self, result: FrameResult) -> None:
        """Write the rows of one more frame, and draw it; `result` is the next one of `track_frames`.

        Raises
        ------
        InputError : for a first result without a start.
        """
        if not self._into.outcome.frames:
            if result.start is None:
                raise InputError(f"{self.job.out}: the first result has no start; write results of track_frames")
            self._into.begin(ClipFacts(str(self.job.clip), result.frame.size, self._rate), result.start, {}, result)
        self._into.write(result)

    def __exit__(self, kind: Any = None, error: BaseException | None = None, trace: Any = None) -> None:
        done = None
        try:
            if self._into.outcome.frames:
                stopped = "interrupted" if isinstance(error, KeyboardInterrupt) else None
                done = self._into.close(stopped, error if isinstance(error, Exception) else None)
        finally:
            self._into.__exit__()
        if done is not None and done.failure is not None and error is None:
            raise done.failure


def draw(result: FrameResult, overlay: Overlay | None = None) -> Image:
    """An image of a result, as the annotated video shows it.

    Parameters
    ----------
    result : of one frame, by `track_frames` or `Tracker.update`.
    overlay : one for all frames, which draws trails as well; None: a new one, without trails.

    Returns
    -------
    (H, W, 3) uint8, blue first : a new image; the frame stays as it is.
    """
    return (overlay or Overlay(result.frame.size)).draw(result)


def chosen_recipe(recipe: str | Path | Recipe | None, seed: int | None, init: Init | None) -> Recipe:
    if recipe is None:
        recipe = default_recipe(box=init is not None and not isinstance(init, str | Path | Start))
    if not isinstance(recipe, Recipe):
        recipe = load_recipe(str(recipe))
    return seeded(recipe, seed)


def _rate(fps: float) -> Fraction:
    """A rate as written to files. Raises UsageError."""
    if not 0 < fps < math.inf:
        raise UsageError(f"fps {fps!r} is no rate; give frames per second, as 25 or 29.97")
    return Fraction(fps).limit_denominator(1001)


def _init(init: Init | None, start: int) -> Path | DetectorName | Start | None:
    if init is None or isinstance(init, Start):
        return init
    if isinstance(init, str | Path):
        return next((name for name in DETECTORS if name == init), Path(init))
    try:
        left, top, width, height = (float(side) for side in init)
    except (TypeError, ValueError):
        left = top = width = height = math.nan
    if not math.isfinite(left + top + width + height):
        raise InputError(f"init {init!r} is neither a file, a box (left, top, width, height), nor a Start")
    return Start(start, {"face": TargetStart(box=(left, top, width, height))}, "init")


def frames_of(images: Iterable[tuple[float, Image]]) -> Iterator[Frame]:
    """The frames of images, each with its time in s. InputError as `frame_of`."""
    size: tuple[int, int] | None = None
    for index, (time_s, image) in enumerate(images):
        frame = frame_of(image, index, time_s, size)
        size = frame.size
        yield frame


def frame_of(image: Image, index: int, time_s: float, size: tuple[int, int] | None) -> Frame:
    """An image as a frame. InputError for what is no image, or not of the `size` (width, height) of those before."""
    image = np.asarray(image)
    if image.dtype != np.uint8 or not image.size or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        remedy = "give (height, width, 3) uint8, blue first, or grey"
        raise InputError(f"image {index}: is {image.dtype} {image.shape}; {remedy}")
    if image.ndim == 2:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    frame = Frame(index, time_s, image)
    if size is not None and frame.size != size:
        raise InputError(f"image {index}: is {frame.size[0]}x{frame.size[1]}, not {size[0]}x{size[1]} as the first")
    return frame


class Tracker:
    """A tracker that is given one image at a time.

        tracker = facetrack.Tracker("face")
        result = tracker.update(image, time_s)      # None until a face is found
        tracker.save("state.npz")                   # facetrack.Tracker("face", state="state.npz") goes on from there

    The results are those of `track_frames`. Trackers are independent: each may be used in a thread of its own, and one
    tracker by one thread at a time.

    Parameters
    ----------
    recipe, init, seed : as of `track_frames`. Where `init` is None or a detector, images are kept until a face is
        found, at most 250; then the search begins again with the next ones.
    fps : images a second, for recipes with times, and where `update` is told no times.
    state : a file that `save` wrote, of the same recipe and seed.

    Raises
    ------
    RecipeError, InputError, UsageError : for a recipe, an init file, a state or a rate that is none.
    """

    def __init__(
        self,
        recipe: str | Path | Recipe | None = None,
        *,
        init: Init | None = None,
        seed: int | None = None,
        fps: float = 25.0,
        state: str | Path | None = None,
    ) -> None:
        _rate(fps)  # may refuse it
        self.recipe, self.fps = chosen_recipe(recipe, seed, init), fps
        begin = _init(init, 0)
        if isinstance(begin, Path):
            begin = read_init(begin)
        self.start: Start | None = begin if isinstance(begin, Start) else None
        self._by: DetectorName | None = None if isinstance(begin, Start) else begin
        self._size: tuple[int, int] | None = None
        self._next, self._last_s = 0, -1.0
        self._search: Search | None = None
        self._waiting: list[Frame] = []  # for a start
        self._tracker: Any = None
        self._at = TrackState()
        if state is not None:
            self._load(Path(state))

    def update(self, image: Image, time_s: float | None = None) -> FrameResult | None:
        """Track one image more.

        Parameters
        ----------
        image : (H, W, 3) uint8, blue first, or (H, W) grey; all of one size.
        time_s : when it was taken, in seconds, later than the image before; None: by `fps`.

        Returns
        -------
        FrameResult or None : the rows of this image; None while the target is not found.

        Raises
        ------
        InputError : for what is no image, one of another size, or a time that is not later.
        """
        at = self._next / self.fps if time_s is None else float(time_s)
        if not at > self._last_s:
            last = f"{self._last_s:g} s, that of the last"
            raise InputError(f"image {self._next}: its time, {at:g} s, is not after {last}")
        frame = frame_of(image, self._next, at, self._size)
        self._size, self._last_s, self._next = frame.size, at, self._next + 1
        return [None, *self._advance(frame, again=True)][-1]

    def _follow(self, frames: Iterable[Frame]) -> Iterator[FrameResult]:
        """The results of all frames from the start on. InputError if there is no start in them."""
        for frame in chain(frames, [None]):
            yield from self._advance(frame)

    def _advance(self, frame: Frame | None, *, again: bool = False) -> Iterator[FrameResult]:
        """The results that one more frame, or the end (None), adds: of all frames since the start, once it is found.

        Where nobody is found, it begins to search `again`, or raises InputError.
        """
        self._waiting += [] if frame is None else [frame]
        if self.start is None:
            try:
                self._seek(ended=frame is None)
            except InputError:
                several = self._search is not None and len(self._waiting) > 1
                self._search, self._waiting = None, []
                if again and several:
                    return
                raise
        if (start := self.start) is None:
            return
        waiting, self._waiting = [kept for kept in self._waiting if kept.index >= start.frame], []
        if self._tracker is None:
            if not waiting and frame is None:
                raise InputError(f"{IMAGES}: there is no frame {start.frame}, where {start.origin} begins")
            if not waiting:
                return
            self.start = start = completed(self.recipe, start, lambda: waiting[0], IMAGES)
            self._tracker = tracker_for(self.recipe, start, waiting[0].size)
        for result in track(self._tracker, iter(waiting), self.recipe.seed, clip=IMAGES, at=self._at):
            yield replace(result, start=start) if result.frame.index == start.frame else result

    def _seek(self, *, ended: bool = False) -> None:
        """Look for the start in the last frame that waits, or as they have ended. InputError where none has it."""
        if self._search is None:
            complete = partial(with_names, self.recipe, IMAGES)
            self._search = Search(self.recipe.points, detector(self._by), complete, 0.0)
        self.start = self._search.among(self._waiting, IMAGES, ended=ended)

    def save(self, path: str | Path) -> None:
        """Write all that it knows, also while no target is found.

        Parameters
        ----------
        path : the file (.npz), which is replaced. `Tracker(..., state=path)` goes on from it.

        Raises
        ------
        OutputError : for a file that cannot be written.
        UsageError : for a tracker of OpenCV, which does not give its state away.
        """
        kept = [(frame.index, frame.time_s, frame.bgr) for frame in self._waiting]
        state = self.start, self._at, self._size, self._next, self._last_s, kept
        try:
            arrays = flatten("known", state)
        except TypeError:  # what is behind Python has no state to write
            why = f"a tracker of OpenCV, as in {self.recipe.name}, does not give its state away"
            raise UsageError(f"{path}: {why}; take another recipe, or begin it again") from None
        KIND.write(Path(path), {"of": np.array(self._key), **arrays})

    def _load(self, path: Path) -> None:
        def make(stored: Stored) -> Any:
            if stored.text("of") != self._key:
                raise InputError(f"{path}: is of another recipe or seed; give the tracker those that it was saved with")
            return restore("known", stored.file)

        self.start, self._at, self._size, self._next, self._last_s, kept = KIND.read(path, make)
        for index, time_s, image in kept:
            self._waiting.append(Frame(index, time_s, image))
            self._seek()
        if self._at.states and self.start is not None and self._size is not None:
            self._tracker = tracker_for(self.recipe, self.start, self._size)

    @property
    def _key(self) -> str:
        return dumps([to_dict(self.recipe), self.fps])
