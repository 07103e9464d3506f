"""One image at a time: `Tracker`, for services and cameras."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.face_points import DetectorName
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.snapshot import flat_value, read_value
from facetrack_cli.core.types import Frame, Image, Start
from facetrack_cli.engine.loop import TrackState, track
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.runs.api import IMAGES, Init, chosen_recipe, chosen_start, frame_of
from facetrack_cli.runs.start import completed, search
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.trajectory.trajectory import FrameResult

KIND: Final = Kind("facetrack-tracker", 1, "state of a tracker", "facetrack.Tracker(...).save(path)")


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
    RecipeError, InputError : for a recipe, an init file or a state that is none.
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
        self.recipe, self.fps = chosen_recipe(recipe, seed, init), fps
        begin = chosen_start(init)
        self.start: Start | None = begin if isinstance(begin, Start) else None
        self._by: DetectorName | None = None if isinstance(begin, Start) else begin
        self._size: tuple[int, int] | None = None
        self._next, self._last_s = 0, -1.0
        self._search: _Search | None = None
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
            raise InputError(
                f"image {self._next}: its time, {at:g} s, is not after {self._last_s:g} s, that of the last"
            )
        frame = frame_of(image, self._next, at, self._size)
        self._size, self._last_s, self._next = frame.size, at, self._next + 1
        waiting = [frame]
        if self.start is None:
            self._search = self._search or _Search(self.recipe, self._by)
            found = self._search.give(frame)
            if found is None:
                return None
            waiting, self._search = self._search.kept, None
            if isinstance(found, InputError):  # nobody in all of them
                return None
            self.start = found
        if self._tracker is None:
            waiting = [one for one in waiting if one.index >= self.start.frame]
            if not waiting:
                return None
            first = waiting[0]
            self.start = completed(self.recipe, self.start, lambda: first, IMAGES)
            self._tracker = tracker_for(self.recipe, self.start, first.size, self.fps)
        *_, result = track(self._tracker, iter(waiting), self.recipe.seed, clip=IMAGES, at=self._at)
        return result

    def save(self, path: str | Path) -> None:
        """Write all that it knows, also while no target is found.

        Raises
        ------
        OutputError : for a file that cannot be written.
        UsageError : for a tracker of OpenCV, which does not give its state away.
        """
        kept = [] if self._search is None else [(one.index, one.time_s, one.bgr) for one in self._search.kept]
        known = self.start, self._at, self._size, self._next, self._last_s, kept
        try:
            arrays = flat_value("known", known)
        except TypeError:  # what is behind Python has no state to write
            why = f"a tracker of OpenCV, as in {self.recipe.name}, does not give its state away"
            raise UsageError(f"{path}: {why}; take another recipe, or begin it again") from None
        KIND.write(Path(path), {"of": np.array(self._key), **arrays})

    def _load(self, path: Path) -> None:
        def make(stored: Stored) -> Any:
            if stored.text("of") != self._key:
                raise InputError(f"{path}: is of another recipe or seed; give the tracker those that it was saved with")
            return read_value(stored, "known")

        self.start, self._at, self._size, self._next, self._last_s, kept = KIND.read(path, make)
        if kept:
            self._search = _Search(self.recipe, self._by)
            for index, time_s, image in kept:
                self._search.give(Frame(index, time_s, image))
        if self._at.states and self.start is not None and self._size is not None:
            self._tracker = tracker_for(self.recipe, self.start, self._size, self.fps)

    @property
    def _key(self) -> str:
        return dumps([to_dict(self.recipe), self.fps])


class _Search:
    """A search for a face that is given its frames one by one; a thread of its own waits for the next.

    `kept` are the frames so far.
    """

    def __init__(self, recipe: Recipe, by: DetectorName | None) -> None:
        self.kept: list[Frame] = []
        given, answers = SimpleQueue[Frame | None](), SimpleQueue[Start | Exception | None]()
        self._given, self._answers = given, answers

        def frames() -> Iterator[Frame]:
            while True:
                answers.put(None)  # it wants one more
                if (frame := given.get()) is None:
                    return
                yield frame

        def run() -> None:
            try:
                answers.put(search(recipe, frames(), IMAGES, by=by, whole=False))
            except Exception as e:
                answers.put(e)

        threading.Thread(target=run, name="search", daemon=True).start()
        weakref.finalize(self, given.put, None)
        self._first = answers.get()

    def give(self, frame: Frame) -> Start | InputError | None:
        """The start, None while it is not known, or why there is none in all frames."""
        if isinstance(self._first, Exception):  # as of a detector that is not installed
            raise self._first
        self.kept.append(frame)
        self._given.put(frame)
        found = self._answers.get()
        if isinstance(found, Exception) and (not isinstance(found, InputError) or len(self.kept) == 1):
            raise found
        return found if isinstance(found, InputError | Start) else None
