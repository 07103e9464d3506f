"""The default start of a track: a face that a detector finds in several frames in nearly the same place.

A single detection may be of anything. Detections of successive frames that overlap are a candidate. A candidate is a
face if it is found often enough, and shows eyes or a mouth. Of several faces the search takes the face with the largest
area, summed over the frames. It takes a face that does not change, as in a photograph, only if no other face moves, and
a dark face only if no better lit face follows. The points of a face are means over its frames, in its box, of the
places that are near those of the first frame: noise averages out, and a mouth that moves keeps its first shape. Nothing
here is random.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from math import isfinite
from typing import Final, Literal, TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre, inside, overlap
from facetrack_cli.core.types import Box, Frame, Image, Point, Start, TargetStart
from facetrack_cli.tracking.start.detectors import (
    MIN_CONTRAST,
    PARTS,
    Detector,
    Found,
    Haar,
    NotHereError,
    check_parts,
    detector,
)
from facetrack_cli.tracking.start.points import place, shows_features

SEARCHED_FRAMES: Final = 250  # frames that are all searched: ten seconds of most clips
MAX_STEP_FRAMES: Final = 50  # frames from one look to the next later on, at most; before, 2 % of those gone by
MIN_FRAMES: Final = 5  # frames in which a face is found, at least
WAIT_FRAMES: Final = 10  # frames for rivals from the first that a candidate is found in
MAX_GAP_FRAMES: Final = 4  # frames in which a candidate may be missed
MIN_CHANGE: Final = 2.5  # grey levels; a face that changes by less from frame to frame may be a picture
PATCH_PX: Final = 24  # pixels of a side of the patch in which that is seen
SAME_PLACE: Final = 0.02  # sizes of the box; a part that is farther off has moved, nearer it is noise
MIN_OVERLAP: Final = 0.3  # overlap with where it was last found
_ALL_OF_IT: Final = "draw it from the brows to the chin"
Faces: TypeAlias = Literal["one", "all"]


@dataclass
class _Candidate:
    """A candidate for a face: boxes, points and contrast of the frames that show it, and where a track can begin.

    `change`: the largest change of the image in its first box since then, in grey levels.
    """

    boxes: list[tuple[int, Box]]
    points: list[dict[str, Point]] = field(default_factory=list)
    contrast: list[float] = field(default_factory=list)
    begins: dict[int, Start] = field(default_factory=dict)
    features: bool = False
    patch: Image | None = None
    change: float = 0.0

    @property
    def first(self) -> int:
        return self.boxes[0][0]

    @property
    def last(self) -> int:
        return self.boxes[-1][0]

    @property
    def size(self) -> float:
        return float(np.mean([box[2] for _, box in self.boxes]))

    @property
    def worth(self) -> float:
        return float(sum(box[2] * box[3] for _, box in self.boxes))

    def see(self, frame: Frame) -> None:
        """Add a frame that shows it."""
        x, y, w, h = (round(side) for side in self.boxes[0][1])
        seen = cv2.cvtColor(frame.bgr[max(y, 0) : y + h, max(x, 0) : x + w], cv2.COLOR_BGR2GRAY)
        patch = np.asarray(cv2.resize(seen, (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_AREA), np.uint8)
        if self.patch is None:
            self.patch = patch
        # less by what all has changed, as light does
        off = patch.astype(np.float64) - self.patch
        self.change = max(self.change, float(np.abs(off - np.median(off)).mean()))

    def said(self) -> str:
        return f"{self.size:.0f} pixels wide, found in {len(self.boxes)} frame{'s' * (len(self.boxes) > 1)}"


def search_start(
    frames: Iterable[Frame],
    parts: Sequence[str] = PARTS,
    *,
    detector: Detector | None = None,
    faces: Faces = "one",
    bound: int = SEARCHED_FRAMES,
    whole: bool = True,
    clip: str = "the clip",
    complete: Callable[[Frame, Start], Start] = lambda frame, start: start,
) -> Start:
    """The start at the first face that stays: its box, and the parts placed in it (pixels, to 0.01).

    Each of the first `bound` frames is searched. If they show nobody, and `whole`, the search goes on in steps that
    grow to `MAX_STEP_FRAMES`; where a detector finds a face there, each of the next frames is searched again. With
    `faces` "all", faces that are there at the same time are targets `face`, `face_2`, and so on, by their size.
    `complete` adds what else the frame must show, or raises NotHereError.
    InputError, naming the `clip`, if no frame shows all that.
    """
    check_parts(parts)
    finder, coming = detector or Haar(), iter(frames)
    search = first = _Search(parts, finder, complete)
    found = search.through(islice(coming, bound), bound=1)
    last = looked = first.frames[-1] if first.frames else 0
    for frame in coming if whole and not found else ():
        last = frame.index
        if last - looked < min(max(last // MAX_STEP_FRAMES, 1), MAX_STEP_FRAMES):
            continue
        looked = last
        if finder.find(frame):
            search = _Search(parts, finder, complete)
            found = search.through(chain([frame], islice(coming, WAIT_FRAMES + MAX_GAP_FRAMES)), bound=WAIT_FRAMES)
            first.lacking, last = first.lacking or search.lacking, search.frames[-1]
            looked = last
        if found:
            break
    if not found:
        raise first.nobody(clip, last)
    return search.start(found if faces == "all" else found[:1], found)


class _Search:
    def __init__(self, parts: Sequence[str], detector: Detector, complete: Callable[[Frame, Start], Start]) -> None:
        self.parts, self.detector, self.complete = parts, detector, complete
        self.candidates: list[_Candidate] = []
        self.frames: list[int] = []
        self.lacking: NotHereError | None = None

    def through(self, frames: Iterable[Frame], *, bound: int) -> list[_Candidate]:
        """The faces in `frames`, as soon as they are certain; none if there are fewer than `bound` frames."""
        for frame in frames:
            self.look(frame)
            if found := self.faces():
                return found
        return self.faces(ended=True) if len(self.frames) >= bound else []

    def look(self, frame: Frame) -> None:
        self.frames.append(frame.index)
        open_ = [one for one in self.candidates if len(self.frames) - self._place(one.last) <= MAX_GAP_FRAMES]
        for face in self.detector.find(frame):
            mine = max(open_, key=lambda one: overlap(one.boxes[-1][1], face.box), default=None)
            if mine is None or overlap(mine.boxes[-1][1], face.box) < MIN_OVERLAP:
                mine = _Candidate([])
                self.candidates.append(mine)
            else:
                open_.remove(mine)
            self._add(mine, frame, face)
        self.candidates = [one for one in self.candidates if one.boxes]

    def _place(self, frame: int) -> int:
        return self.frames.index(frame)

    def _add(self, candidate: _Candidate, frame: Frame, face: Found) -> None:
        points = place(frame.bgr, face.box, face.eyes, face.points)
        if not all(inside(points[part], frame.size) for part in self.parts):
            return
        x, y, w, h = (round(side) for side in face.box)
        grey = cv2.cvtColor(frame.bgr[max(y, 0) : y + h, max(x, 0) : x + w], cv2.COLOR_BGR2GRAY)
        candidate.boxes.append((frame.index, face.box))
        candidate.points.append(points)
        candidate.contrast.append(float(grey.std()))
        candidate.see(frame)
        candidate.features = candidate.features or face.sure or shows_features(frame.bgr, face.box)
        start = Start(frame.index, {"face": TargetStart(face.box, points)}, self.detector.name)
        try:
            candidate.begins[frame.index] = self.complete(frame, start)
        except NotHereError as e:
            self.lacking = self.lacking or e

    def faces(self, *, ended: bool = False) -> list[_Candidate]:
        """The candidates that are faces, the best first; none while it is too early to decide."""
        enough = min(MIN_FRAMES, 1 + len(self.frames) // 4) if ended else MIN_FRAMES
        able = [one for one in self.candidates if one.begins and one.features and len(one.boxes) >= enough]
        lit = [one for one in able if max(one.contrast) >= MIN_CONTRAST]
        able = lit or (able if ended else [])
        waited = max((len(self.frames) - self._place(one.first) for one in able), default=0)
        if not able or (waited < WAIT_FRAMES and not ended):
            return []
        return sorted(able, key=lambda one: (one.change < MIN_CHANGE, -one.worth, one.boxes[0][1]))

    def start(self, chosen: Sequence[_Candidate], rivals: Sequence[_Candidate]) -> Start:
        """The start of the chosen faces: the first frame in which the best face is well lit."""
        best = chosen[0]
        lit = {frame for (frame, _), value in zip(best.boxes, best.contrast, strict=True) if value >= MIN_CONTRAST}
        at = min(lit & set(best.begins) or set(best.begins))
        start, others = best.begins[at], [one for one in chosen[1:] if at in one.begins]
        targets = {}
        for name, target in start.targets.items():
            targets[name] = self._settled(best, at) if name == next(iter(start.targets)) else target
        for i, one in enumerate(others):
            targets[f"face_{i + 2}"] = self._settled(one, at)
        note = f"begins in frame {at} with a face {best.said()} by {self.detector.name}"
        passed = [one for one in self.candidates if one not in rivals]
        left = [one for one in rivals if one not in chosen]
        if others:
            note += f", and {len(others)} more"
        if left:
            note += f"; {len(left)} more face{'s were' * (len(left) > 1) or ' was'} found, --faces all follows each"
        if passed:
            shown = "; ".join(one.said() for one in sorted(passed, key=lambda one: -one.worth)[:3])
            note += f"; passed over: {shown}"
        return replace(start, targets=targets, note=note)

    def _settled(self, one: _Candidate, at: int) -> TargetStart:
        """The target in the frame `at`; its points are the means, in its box, of all frames that look alike."""
        boxes = np.array([box for _, box in one.boxes])
        now = [frame for frame, _ in one.boxes].index(at)
        # (T, K, 2); a recipe of boxes has no parts
        at_parts = np.array([[p[part] for part in self.parts] for p in one.points]).reshape(len(boxes), -1, 2)
        each = (at_parts - boxes[:, None, :2]) / boxes[:, None, 2:]
        weight = np.exp(-0.5 * np.sum((each - each[now]) ** 2, axis=2) / SAME_PLACE**2)
        mean = np.sum(weight[..., None] * each, axis=0) / weight.sum(axis=0)[:, None]
        # to 0.01 px, as in an init file: a run from that file begins in the same place
        placed = (boxes[now, :2] + mean * boxes[now, 2:]).round(2).tolist()
        points = {part: (x, y) for part, (x, y) in zip(self.parts, placed, strict=True)}
        return TargetStart(one.boxes[now][1], points)

    def nobody(self, clip: str, last: int) -> InputError:
        if not self.frames:
            return InputError(f"{clip}: no frame to look for a face in; ask for frames that the clip has")
        first = self.frames[0]
        if self.lacking is not None:
            return InputError(f"{self.lacking}{'' if last == first else f'; no frame to {last} shows more'}")
        searched = f"frame {first}" if first == last else f"frames {first} to {last}"
        remedy = "give its box with --box X,Y,W,H, an init file with --init FILE, or a later frame with --init-frame N"
        doubtful = max(self.candidates, key=lambda one: len(one.boxes), default=None)
        but = "" if doubtful is None else f" (something {doubtful.said()}, which is no face)"
        return InputError(f"{clip}: no face found in {searched}{but}; {remedy}")


def box_start(
    frame: Frame, box: Box, parts: Sequence[str] = PARTS, *, by: str | None = None, clip: str = "the clip"
) -> Start:
    """The start in a frame where the face's box (left, top, width, height; pixels) is known.

    The parts are placed in the face that a detector sees in the box, else in the box. `by`: as for `detector`.
    InputError for a wrong box.
    """
    check_parts(parts)
    size = f"the frame of {frame.size[0]}x{frame.size[1]} pixels"
    if not all(map(isfinite, box)) or min(box[2:]) <= 0:
        wrong = "has no area; give left, top, width and height in pixels"
    elif min(box[2:]) < 2:
        wrong = f"is smaller than 2 pixels; {_ALL_OF_IT}"
    elif max(box[2] / frame.size[0], box[3] / frame.size[1]) > 2:
        wrong = f"is far larger than {size}; {_ALL_OF_IT}"
    elif not inside(centre(box), frame.size):
        wrong = f"is not in {size}; give left, top, width and height in pixels of the frame"
    else:
        look = detector(by)
        points = look.place(frame.bgr, box)
        outside = [part for part in parts if not inside(points[part], frame.size)]
        if not outside:
            # to 0.01 px, as in an init file: a run from that file begins in the same place
            placed = {part: (round(points[part][0], 2), round(points[part][1], 2)) for part in parts}
            target = TargetStart(box=box, points=placed)
            return Start(frame.index, {"face": target}, "--box", detector=look.name, placed=True)
        wrong = f"would put {', '.join(outside)} outside the frame; {_ALL_OF_IT}, or give the points with --init FILE"
    raise InputError(f"{clip}: the box {','.join(f'{value:g}' for value in box)} {wrong}")
