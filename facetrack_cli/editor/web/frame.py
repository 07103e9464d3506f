"""One frame on the page: the draft (what the user chooses in it), its images, and the proposed faces."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal, TypeAlias

import cv2
import numpy as np
from pydantic import ConfigDict, Field
from pydantic_core import to_jsonable_python

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import inside
from facetrack_cli.core.types import Box, Frame, Image, Start, TargetStart
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.start.init_file import NAME, TARGET
from facetrack_cli.start.search import box_start
from facetrack_cli.start.targets import name_targets
from facetrack_cli.trackers.face.closer import righted
from facetrack_cli.trackers.face.detectors import PARTS, NotHereError, detector, named
from facetrack_cli.trajectory.header import FrameNumber, Pixels, Side
from facetrack_cli.video.seek import Frames

JPEG_QUALITY: Final = 90
MAX_TARGETS: Final = 20
MAX_POINTS: Final = 500
MAX_FACES: Final = 12
Json: TypeAlias = "dict[str, Any]"
Name: TypeAlias = Annotated[str, Field(pattern=f"^(?:{NAME.pattern})$")]


@dataclass(frozen=True, slots=True)
class DraftTarget:
    """One target of a draft: box (left, top, width, height), points (x, y), and absent parts, True for all of them."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    box: tuple[Pixels, Pixels, Side, Side] | None = None
    points: Annotated[Mapping[Name, tuple[Pixels, Pixels]], Field(max_length=MAX_POINTS)] = field(default_factory=dict)
    absent: Annotated[tuple[Name, ...], Field(max_length=MAX_POINTS)] | Literal[True] = ()

    @property
    def empty(self) -> bool:
        return self.box is None and not self.points and not self.absent

    def rounded(self) -> TargetStart:
        """Its box and points to 0.01 px, as init files have them."""
        box: Any = self.box and tuple(round(value, 2) for value in self.box)
        return TargetStart(box, {part: (round(x, 2), round(y, 2)) for part, (x, y) in self.points.items()})


@dataclass(frozen=True, slots=True)
class Draft:
    """What is chosen in one frame, by target: well formed, and not necessarily complete."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    frame: FrameNumber
    targets: Annotated[Mapping[Name, DraftTarget], Field(max_length=MAX_TARGETS)]

    @property
    def empty(self) -> bool:
        return all(target.empty for target in self.targets.values())

    def placed(self) -> dict[str, TargetStart]:
        """The targets that have a box or points, to 0.01 px."""
        return {name: one.rounded() for name, one in self.targets.items() if one.box is not None or one.points}

    def to_json(self) -> Json:
        found: Json = to_jsonable_python(self)
        return found


def draft_of(frame: int, targets: Mapping[str, TargetStart]) -> Draft:
    """The draft of a start or a proposal."""
    return Draft(frame, {name: DraftTarget(one.box, dict(one.points)) for name, one in targets.items()})


def jpeg(frames: Frames, index: int, reduce: int = 1) -> bytes:
    """A frame as JPEG. Its sides are divided by `reduce` and rounded up, and its pixels are area means.

    Raises what `Frames.read` raises. Nothing is kept here: the page keeps the images that it has received.
    """
    image = frames.read(index).bgr
    if reduce > 1:
        size = -(-image.shape[1] // reduce), -(-image.shape[0] // reduce)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return _encode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))


def crop(frames: Frames, index: int, x: int, y: int, w: int, h: int) -> bytes:
    """The pixels x .. x+w-1, y .. y+h-1 of a frame, as far as it has them, as PNG. InputError if it has none."""
    width, height = frames.size
    left, top, right, bottom = max(x, 0), max(y, 0), min(x + w, width), min(y + h, height)
    if left >= right or top >= bottom:
        none = f"none of those of {w}x{h} from ({x}, {y}) on"
        raise InputError(f"the frame has {width}x{height} pixels, and {none}; choose others")
    return _encode(".png", frames.read(index).bgr[top:bottom, left:right], (cv2.IMWRITE_PNG_COMPRESSION, 1))


def _encode(suffix: str, image: Image, options: tuple[int, int]) -> bytes:
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise RuntimeError(f"OpenCV cannot write {suffix}")
    return data.tobytes()


class Proposer:
    """Proposes the faces of a frame. One thread looks for them, since it keeps the cascades; a frame is searched once.

    `points` are the points of the first target.
    """

    def __init__(self, frames: Frames, recipe: Recipe | None, points: Sequence[str]) -> None:
        self._frames, self._recipe = frames, recipe
        self._points = [part for part in points if part in PARTS]
        self._by_hand = [part for part in points if part not in PARTS]
        self._worker = ThreadPoolExecutor(1, "proposals")
        self._found: dict[int, Json] = {}

    def __call__(self, index: int) -> Json:
        """{"frame", "proposals": [{"label", "targets"}], "note"}. Raises InputError if there is no such frame."""
        return self._worker.submit(self._find, index).result()

    def proposed(self, index: int) -> list[Draft]:
        """The drafts that were proposed for a frame; none if nobody asked for proposals there."""
        found = self._found.get(index, {"proposals": []})
        targets = ({name: DraftTarget(**of) for name, of in one["targets"].items()} for one in found["proposals"])
        return [Draft(index, those) for those in targets]

    def close(self) -> None:
        self._worker.shutdown(wait=True, cancel_futures=True)

    def in_box(self, frame: Frame, box: Box, clip: str) -> Draft:
        """The draft of the face in a given box. Raises InputError as `box_start` does."""
        start = box_start(frame, box, self._points, clip=clip)
        return draft_of(frame.index, self._complete(frame, start)[0].targets)

    def _find(self, index: int) -> Json:
        if index in self._found:
            return self._found[index]
        frame = self._frames.read(index)
        notes, proposals = [], []
        look = detector()
        for number, seen in enumerate(look.find(frame)[:MAX_FACES], start=1):
            found = righted(look, frame, seen)
            placed = named(found.placed(frame))
            points = {part: (round(placed[part][0], 2), round(placed[part][1], 2)) for part in self._points}
            visible = {part: at for part, at in points.items() if inside(at, frame.size)}
            start, reason = self._complete(
                frame, Start(index, {TARGET: TargetStart(found.box, visible)}, "the face found")
            )
            targets = {name: {"box": one.box, "points": one.points} for name, one in start.targets.items()}
            proposals.append({"label": f"face {number}", "targets": targets})
            notes.append(reason)
        if not proposals:
            notes.append("no face is found in this frame; draw a box, or look at another frame")
        elif self._by_hand:
            notes.append(f"{', '.join(self._by_hand)}: only by hand")
        note = "; ".join(dict.fromkeys(filter(None, notes))) or None
        self._found[index] = {"frame": index, "proposals": proposals, "note": note}
        return self._found[index]

    def _complete(self, frame: Frame, start: Start) -> tuple[Start, str]:
        """With the other targets that the recipe names, if they are found; else the first one alone, and why."""
        if self._recipe is None or not self._recipe.followed:
            return start, ""
        first, *others = self._recipe.followed
        [face] = start.targets.values()
        alone = Start(start.frame, {first: face}, start.origin)
        try:
            return name_targets(
                alone, self._recipe.followed, frame, left_out=self._recipe.left_out, later=self._recipe.later
            ), ""
        except NotHereError:
            return alone, f"{', '.join(others)}: not found by the colour of the skin; draw the boxes"
        except InputError as e:
            return alone, " ".join(str(e).splitlines())
