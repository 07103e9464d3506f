"""OpenCV's own trackers of a box, to compare with: MIL, CSRT, KCF and MOSSE, with their default parameters.

A tracker that reports its target as lost makes the part `lost`, and the box stays. MIL and CSRT hardly ever report it.
"""

import ctypes
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Final, TypeAlias

import cv2
import numpy as np
from numpy.random import Generator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import BOX, Box, Frame
from facetrack_cli.recipe.model import OpenCvRecipe
from facetrack_cli.trajectory.trajectory import Status, TargetResult, one_part

MIN_SIDE: Final = 6  # pixels: MIL looks for ever for features in a box of 4x4
State: TypeAlias = "tuple[Any, tuple[int, int, int, int]]"  # OpenCV's tracker, and the last box


def find(tracker: str) -> Any:
    """What makes a tracker of that name, None where this build of OpenCV has none."""
    module: Any = getattr(cv2, "legacy", None) if tracker == "mosse" else cv2
    return getattr(module, f"Tracker{tracker.upper()}_create", None)


def check(recipe: OpenCvRecipe) -> None:
    """RecipeError if this build of OpenCV has no such tracker."""
    if find(recipe.tracker) is None:
        remedy = "pip uninstall opencv-python-headless, then pip install 'opencv-contrib-python-headless<5'"
        what = f"the installed OpenCV {cv2.__version__} has no {recipe.tracker.upper()} tracker"
        raise recipe.error("tracker", f"{what}; {remedy}")


@dataclass(frozen=True)
class OpenCvTarget:
    """A target followed by one of OpenCV's trackers. `box` is its place in the first frame; `origin` who said so."""

    name: str
    box: Box
    tracker: str
    origin: str
    parts: ClassVar = (BOX,)
    windows: ClassVar[Mapping[str, tuple[float, float]]] = {}

    def begin(self, rng: Generator, frame: Frame) -> tuple[State, TargetResult]:
        """Raises InputError for a box too small, or too large, for this tracker."""
        box = self._whole(frame)
        cv2.setRNGSeed(seed := int(rng.integers(1, 2**31)))
        with suppress(TypeError, OSError, AttributeError):  # on Windows there is no one C library, which MIL draws from
            ctypes.CDLL(None).srand(seed)
        tracker = find(self.tracker)()
        try:
            tracker.init(frame.bgr, box)
        except cv2.error as e:
            cannot = f"OpenCV's {self.tracker.upper()} cannot begin with the box {list(box)} of {self.name} ({e.err})"
            remedy = "give one that leaves some of the image around it"
            raise InputError(f"{self.origin}: {cannot}; {remedy}") from None
        return (tracker, box), self._result(frame, box, "init")

    def advance(
        self, rng: Generator, state: State, frame: Frame, footprints: object = ()
    ) -> tuple[State, TargetResult]:
        tracker, last = state
        try:
            found, box = tracker.update(frame.bgr)
        except cv2.error:  # as MIL does where no place is left to look at
            found, box = False, last
        if not found or box[2] < 1 or box[3] < 1:  # a tracker that has lost its target reports an empty box
            return state, self._result(frame, last, "lost")
        return (tracker, box), self._result(frame, box, "tracked")

    def footprint(self, state: State, *, ahead: bool) -> None:
        """OpenCV's trackers know nothing of each other."""

    def _whole(self, frame: Frame) -> tuple[int, int, int, int]:
        """The start's box over whole pixels, inside the frame and off its right and lower edge."""
        width, height = frame.size
        # corner and size each on their own: a square stays one
        x, y, w, h = (round(side) for side in self.box)
        left, top, right, bottom = max(x, 0), max(y, 0), min(x + w, width - 1), min(y + h, height - 1)
        if right - left < MIN_SIDE or bottom - top < MIN_SIDE:
            small = f"covers less than {MIN_SIDE}x{MIN_SIDE} pixels of the image"
            raise InputError(f"{self.origin}: the box of {self.name} {small}; give a larger one")
        return left, top, right - left, bottom - top

    def _result(self, frame: Frame, box: Box, status: Status) -> TargetResult:
        x, y = centre(box)
        place = {"x": [x], "y": [y], "w": [box[2]], "h": [box[3]]}
        rows = one_part(self.name, BOX, [frame.index], time_s=[frame.time_s], status=[status], **place)
        return TargetResult(rows, np.zeros((0, 1, 2)))
