"""The default start of a track: a face that a detector finds in several frames in nearly the same place.

A single detection may be of anything. Detections of successive frames that overlap are a candidate. A candidate is a
face if it is found often enough, and shows eyes or a mouth. Of several faces the search takes the face with the largest
area, summed over the frames. It takes a face that does not change, as in a photograph, only if no other face moves
within some time, and a dark face only if no better lit face follows. What changes is what is left when the face, which
a hand may shake, is laid on its first picture. Where nobody is certain the frame is looked at more closely
(`trackers/face/detectors.py`). The points of a face are means over its frames, in its box, of the places that are near
those of the first frame: noise averages out, and a mouth that moves keeps its first shape. Nothing here is random.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from math import degrees
from typing import Final, Literal, NamedTuple, TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre, inside, overlap, warp_affine
from facetrack_cli.core.types import Box, Frame, Image, Point, Start, TargetStart
from facetrack_cli.engine.spaces import check_size
from facetrack_cli.start.init_file import check_start
from facetrack_cli.trackers.face.detectors import (
    MIN_CONTRAST,
    PARTS,
    Detection,
    Detector,
    Haar,
    NotHereError,
    check_parts,
    detector,
    everywhere,
    named,
    near,
    righted,
    shows_eye,
)
from facetrack_cli.trackers.face.stabilized import Similarity

SEARCHED_FRAMES: Final = 250  # frames that are searched, of images that are all kept
SEARCHED_S: Final = 10.0  # seconds in which all frames are searched; of later ones some, in steps of
STEP, MAX_STEP_S = 0.02, 2.0  # this share of the time gone by, and at most so many seconds
LOOK_S: Final = 0.03  # seconds from one look to the next, at least: a camera may be fast
MIN_LOOKS: Final = 5  # in which a face is found, at least
WAIT_S: Final = 0.35  # seconds for rivals from the first look that finds a candidate
ALONE_S, STILL_S = 1.0, 3.0  # if it keeps still: alone, or beside a smaller one that moves; all of them
WAITING_S: Final = 0.2  # seconds from one look to the next in that time
CLOSER_S, CLOSER_STEP = 1.0, 0.1  # from one closer look for anybody to the next; or this share of the time gone by
MAX_GAP: Final = 4  # looks in which a candidate may be missed
MIN_CHANGE: Final = 2.5  # grey levels; a face that changes by less from frame to frame may be a picture
MIN_DEFORMED: Final = 2.0  # so is one whose change is less when it is laid on its first picture: 0.7 to 1.6, faces 2.2
PATCH_PX: Final = 24  # pixels of a side of the patch in which that is seen
VIEW_PX, MARGIN_PX = 48, 6  # sides and margins of the picture that is laid on the first
TURNED_LOOKS: Final = 3  # that ask how a face lies in which neither nose nor mouth is seen
BESIDE: Final = 0.1  # overlap below which an upright face is another one than a turned one
SAME_PLACE: Final = 0.02  # sizes of the box; a part that is farther off has moved, nearer it is noise
MIN_OVERLAP: Final = 0.3  # overlap with where it was last found
Faces: TypeAlias = Literal["one", "all"]


class _Look(NamedTuple):
    """A frame that shows a candidate; `clear`: whether the regression has seen nose and mouth."""

    frame: int
    box: Box
    points: dict[str, Point]
    contrast: float
    clear: bool


@dataclass(eq=False)
class _Candidate:
    """A candidate for a face: looks at it, and where a track can begin.

    `change`: the largest change of the image in its first box since then, in grey levels; `deformed`: that of the first
    `compared` of its `views`, each laid on the first one. `face`: as it was found first.
    """

    face: Detection
    looks: list[_Look] = field(default_factory=list)
    begins: dict[int, Start] = field(default_factory=dict)
    features: bool = False
    patch: Image | None = None
    change: float = 0.0
    views: list[Image] = field(default_factory=list)
    compared: int = 1
    deformed: float = 0.0

    @property
    def box(self) -> Box:
        """Where it was found last."""
        return self.looks[-1].box

    @property
    def certain(self) -> bool:
        return any(look.clear for look in self.looks)

    @property
    def lit(self) -> bool:
        return max(look.contrast for look in self.looks) >= MIN_CONTRAST

    @property
    def worth(self) -> float:
        return float(sum(look.box[2] * look.box[3] for look in self.looks))

    @property
    def lives(self) -> bool:
        """Whether it changes as no picture does that is moved."""
        if self.change >= MIN_CHANGE:
            for view in self.views[self.compared :] if self.deformed < MIN_DEFORMED else ():
                self.deformed = max(self.deformed, _deformation(self.views[0], view))
            self.compared = len(self.views)
        return self.deformed >= MIN_DEFORMED

    def see(self, frame: Frame, *, alone: bool) -> None:
        """Add a frame that shows it, `alone` or with others, of which it may be the one that lives."""
        x, y, w, h = (round(side) for side in self.looks[0].box)
        seen = cv2.cvtColor(frame.bgr[max(y, 0) : y + h, max(x, 0) : x + w], cv2.COLOR_BGR2GRAY)
        patch = np.asarray(cv2.resize(seen, (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_AREA), np.uint8)
        if self.patch is None:
            self.patch = patch
        self.change = max(self.change, _change(patch, self.patch))
        if alone:
            return
        face = Similarity(np.array(centre(self.box)), self.box[2] / VIEW_PX)
        view = cv2.cvtColor(face.read(frame, VIEW_PX + 2 * MARGIN_PX).bgr, cv2.COLOR_BGR2GRAY)
        self.views.append(np.asarray(cv2.GaussianBlur(view, (0, 0), 1.0), np.uint8))

    def said(self) -> str:
        wide, count = np.mean([look.box[2] for look in self.looks]), len(self.looks)
        return f"{wide:.0f} pixels wide, found in {count} frame{'s' * (count > 1)}"


def _change(now: Image, before: Image) -> float:
    """The mean change of two grey pictures, less by what all has changed, as light does."""
    off = np.sort(now.astype(np.float64) - before, axis=None)
    # np.median would import numpy.ma, which takes a hundredth of a short run
    return float(np.abs(off - off[(off.size - 1) // 2 : off.size // 2 + 1].mean()).mean())


def _deformation(first: Image, view: Image) -> float:
    """The change of a face since the first view of it that no affine map explains."""
    core = np.ascontiguousarray(first[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX])
    _, _, _, (x, y) = cv2.minMaxLoc(cv2.matchTemplate(view, core, cv2.TM_CCOEFF_NORMED))
    warp, whole = np.array([[1, 0, x], [0, 1, y]], np.float32), np.full(view.shape, 255, np.uint8)
    ends = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3
    with suppress(cv2.error):  # where it does not converge, what is left by the shift counts
        warp = np.asarray(cv2.findTransformECC(core, view, warp, cv2.MOTION_AFFINE, ends, whole, 1)[1], np.float32)
    return _change(np.asarray(warp_affine(view, warp, core.shape[::-1], inverse=True), np.uint8), core)


def search_start(
    frames: Iterable[Frame],
    parts: Sequence[str] = PARTS,
    *,
    detector: Detector | None = None,
    faces: Faces = "one",
    clip: str = "the clip",
    complete: Callable[[Frame, Start], Start] = lambda frame, start: start,
) -> Start:
    """The start at the first face that stays: its box, and the parts placed in it (pixels, to 0.01).

    The frames of the first `SEARCHED_S` are searched. If they show nobody, the search goes on in steps that grow to
    `MAX_STEP_S`. Where a detector finds a face there, each of the next frames is searched again.

    Parameters
    ----------
    faces
        With "all", faces that are there at the same time are targets `face`, `face_2`, and so on, by their size.
    complete
        Adds what else the frame must show, or raises NotHereError.

    Raises
    ------
    InputError
        No frame of the `clip` shows all that.
    """
    finder, coming = detector or Haar(), iter(frames)
    search = first = Search(parts, finder, complete, 0.0)
    rivals = search.through(coming, SEARCHED_S)
    last, looked = (first.frames[-1], first.times[-1]) if first.frames else (0, 0.0)
    for frame in () if rivals else coming:
        last = frame.index
        if frame.time_s - looked < min(max(STEP * frame.time_s, LOOK_S), MAX_STEP_S):
            continue
        search = Search(parts, finder, complete, search.closer_from)
        rivals = search.through(chain([frame], coming), WAIT_S + STILL_S, least=WAIT_S)
        first.lacking, last, looked = first.lacking or search.lacking, search.frames[-1], search.times[-1]
        if rivals:
            break
    if not rivals:
        raise first.nobody(clip, last)
    return search.start(rivals if faces == "all" else rivals[:1], rivals)


class Search:
    """The search for a face in frames, one after another."""

    def __init__(
        self, parts: Sequence[str], detector: Detector, complete: Callable[[Frame, Start], Start], closer_from: float
    ) -> None:
        check_parts(parts)
        self.parts, self.detector, self.complete, self.closer_from = parts, detector, complete, closer_from
        self.candidates: list[_Candidate] = []
        self.frames: list[int] = []
        self.times: list[float] = []
        self.ready: int | None = None  # the frame from which on it waits only for somebody to move
        self.lacking: NotHereError | None = None

    def among(self, kept: Sequence[Frame], clip: str, *, ended: bool) -> Start | None:
        """The start after the last of the frames that are `kept` so far, or at their end; None: the next are to tell.

        InputError as `search_start`, of `SEARCHED_FRAMES` frames at the latest.
        """
        rivals = None if ended else self.take(kept[-1], SEARCHED_S)
        if rivals is None and not ended and len(kept) < SEARCHED_FRAMES:
            return None
        if not (rivals := rivals or self.ended()):
            raise self.nobody(clip, self.frames[-1] if self.frames else 0)
        return self.start(rivals[:1], rivals)

    def through(self, frames: Iterable[Frame], most: float, *, least: float = 0.0) -> list[_Candidate]:
        """The faces in `most` seconds of the frames, as soon as they are certain; as `take`."""
        taken = (self.take(frame, most, least=least) for frame in frames)
        found = next((faces for faces in taken if faces is not None), None)
        return self.ended(least) if found is None else found

    def take(self, frame: Frame, most: float, *, least: float = 0.0) -> list[_Candidate] | None:
        """The faces after one frame more; None: the next frames are to tell, up to `most` seconds.

        No faces if the looks are of less than `least` seconds; those end where nobody is left.
        """
        since = frame.time_s - self.times[-1] if self.times else 0.0
        if 0 < since < (LOOK_S if self.ready is None and not self._dark() else WAITING_S):
            return None
        self.look(frame)
        if faces := self.faces():
            return faces
        at_end = (least and not self._open()) or self.times[-1] - self.times[0] >= most - LOOK_S
        return self.ended(least) if at_end else None

    def ended(self, least: float = 0.0) -> list[_Candidate]:
        """The faces where no frame is to follow."""
        return self.faces(ended=True) if self.times and self.times[-1] - self.times[0] >= least else []

    def _open(self) -> list[_Candidate]:
        first = self.frames[-MAX_GAP:][0] if self.frames else 0
        return [candidate for candidate in self.candidates if candidate.looks[-1].frame >= first]

    def _dark(self) -> bool:
        """Whether there are only faces to wait for until light falls on them."""
        able = [each.certain and len(each.looks) >= MIN_LOOKS and not each.lit for each in self._open()]
        return bool(able) and all(able)

    def look(self, frame: Frame) -> None:
        self.frames.append(frame.index)
        self.times.append(frame.time_s)
        open_, faces = self._open(), self.detector.find(frame)
        for candidate in open_:
            if candidate.face.closer:
                faces = [face for face in faces if overlap(face.box, candidate.box) < BESIDE]
                again = near(self.detector, frame, candidate.box, candidate.face.turn)
                faces += [] if again is None else [again]
        for face in faces:
            mine = max(open_, key=lambda candidate: overlap(candidate.box, face.box), default=None)
            if mine is None or overlap(mine.box, face.box) < MIN_OVERLAP:
                mine = None
            else:
                open_.remove(mine)
            if mine is None or not (mine.certain or mine.face.closer or len(mine.looks) >= TURNED_LOOKS):
                face = righted(self.detector, frame, face)
                if mine is not None and face.turn:
                    self.candidates.remove(mine)
                mine = _Candidate(face) if mine is None or face.turn else mine
            self._add(mine, frame, face)
        if frame.time_s >= self.closer_from and not any(candidate.certain for candidate in self._open()):
            self.closer_from = frame.time_s + max(CLOSER_S, CLOSER_STEP * frame.time_s)
            for face in everywhere(self.detector, frame):
                for candidate in self._open():
                    if not candidate.certain and overlap(candidate.box, face.box) > BESIDE:
                        self.candidates.remove(candidate)
                self._add(_Candidate(face), frame, face)

    def _add(self, candidate: _Candidate, frame: Frame, face: Detection) -> None:
        placed = face.placed(frame)
        points = named(placed)
        if not all(inside(points[part], frame.size) for part in self.parts):
            return
        if not candidate.looks:
            self.candidates.append(candidate)
        x, y, w, h = (round(side) for side in face.box)
        grey = cv2.cvtColor(frame.bgr[max(y, 0) : y + h, max(x, 0) : x + w], cv2.COLOR_BGR2GRAY)
        candidate.looks.append(_Look(frame.index, face.box, points, float(grey.std()), placed.log_odds > 0))
        candidate.see(frame, alone=len(self.candidates) < 2)
        candidate.features = candidate.features or face.sure or candidate.certain or shows_eye(frame.bgr, face.box)
        start = Start(frame.index, {"face": TargetStart(face.box, points)}, self.detector.name)
        try:
            candidate.begins[frame.index] = self.complete(frame, start)
        except NotHereError as e:
            self.lacking = self.lacking or e

    def faces(self, *, ended: bool = False) -> list[_Candidate]:
        """The candidates that are faces, the best first; none while it is too early to decide."""
        enough = min(MIN_LOOKS, 1 + len(self.frames) // 4) if ended else MIN_LOOKS
        able = [rival for rival in self.candidates if rival.begins and rival.features and len(rival.looks) >= enough]
        able = [candidate for candidate in able if candidate.lit] or (able if ended else [])
        seen = [self.times[self.frames.index(candidate.looks[0].frame)] for candidate in able]
        waited = self.times[-1] - min(seen, default=self.times[-1])
        if not able or (waited < WAIT_S and not ended):
            return []
        self.ready = self.frames[-1] if self.ready is None else self.ready
        if not ended and waited < self._wait(able):
            return []
        moving = [candidate.lives for candidate in able]
        if not any(moving):  # one that changes ten times as much as another is the living one
            moving = [candidate.change >= max(other.change for other in able) / 10 for candidate in able]
        both = zip(moving, able, strict=True)
        order = sorted(both, key=lambda pair: (not pair[0], -pair[1].worth, pair[1].looks[0][:2]))
        return [candidate for _, candidate in order]

    def _wait(self, able: Sequence[_Candidate]) -> float:
        """For how long to wait for one of them to move, in s: the largest is taken if it does."""
        if len(able) == 1:
            return WAIT_S if able[0].change >= MIN_CHANGE else ALONE_S
        if max(able, key=lambda candidate: candidate.worth).lives:
            return WAIT_S
        return ALONE_S if any(candidate.lives for candidate in able) else STILL_S

    def start(self, chosen: Sequence[_Candidate], rivals: Sequence[_Candidate]) -> Start:
        """The start of the chosen faces: the first frame in which the best face is well lit and, if it ever is, clear:
        a box around a face that something covers may be off.
        """
        best = chosen[0]
        lack = {look.frame: (look.contrast < MIN_CONTRAST, not look.clear, look.frame) for look in best.looks}
        at = min(best.begins, key=lack.__getitem__)
        start, others = best.begins[at], [candidate for candidate in chosen[1:] if at in candidate.begins]
        targets = {**start.targets, next(iter(start.targets)): self._settled(best, at)}
        for i, candidate in enumerate(others):
            targets[f"face_{i + 2}"] = self._settled(candidate, at)
        note = f"begins in frame {at} with a face {best.said()} by {self.detector.name}"
        note += f", turned by {round(degrees(best.face.roll)) % 360} degrees clockwise" if best.face.turn else ""
        note += "" if best.certain else ", which shows neither nose nor mouth clearly: see whether it is upright"
        left = [candidate for candidate in rivals if candidate not in chosen]
        if others:
            note += f", and {len(others)} more"
        if left:
            note += f"; {len(left)} more face{'s were' * (len(left) > 1) or ' was'} found, --faces all follows each"
        if left and not best.lives:
            note += "; none of them moves: if another one is meant, name it by --box X,Y,W,H"
        return replace(start, targets=targets, note=note)

    def _settled(self, candidate: _Candidate, at: int) -> TargetStart:
        """The target in the frame `at`; its points are the means, in its box, of all frames that look alike."""
        until = max(at, at if self.ready is None else self.ready)
        looks = [look for look in candidate.looks if look.frame <= until]
        now, boxes = [look.frame for look in looks].index(at), np.array([look.box for look in looks])
        # (T, K, 2); a recipe of boxes has no parts
        at_parts = np.array([[look.points[part] for part in self.parts] for look in looks]).reshape(len(looks), -1, 2)
        each = (at_parts - boxes[:, None, :2]) / boxes[:, None, 2:]
        weight = np.exp(-0.5 * np.sum((each - each[now]) ** 2, axis=2) / SAME_PLACE**2)
        mean = np.sum(weight[..., None] * each, axis=0) / weight.sum(axis=0)[:, None]
        # to 0.01 px, as in an init file: a run from that file begins in the same place
        placed = (boxes[now, :2] + mean * boxes[now, 2:]).round(2).tolist()
        return TargetStart(looks[now].box, {part: (x, y) for part, (x, y) in zip(self.parts, placed, strict=True)})

    def nobody(self, clip: str, last: int) -> InputError:
        if not self.frames:
            return InputError(f"{clip}: no frame to look for a face in; ask for frames that the clip has")
        first = self.frames[0]
        if self.lacking is not None:
            return InputError(f"{self.lacking}{'' if last == first else f'; no frame to {last} shows more'}")
        searched = f"frame {first}" if first == last else f"frames {first} to {last}"
        remedy = "give its box with --box X,Y,W,H, an init file with --init FILE, or a later frame with --init-frame N"
        doubtful = max(self.candidates, key=lambda candidate: len(candidate.looks), default=None)
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
    check_size(clip, "the face", box)
    check_start(Start(frame.index, {"face": TargetStart(box)}, clip), frame.size, ())
    look = detector(by)
    face = righted(look, frame, Detection(box))
    points = named(face.placed(frame)) if face.turn else look.place(frame.bgr, box)
    if outside := ", ".join(part for part in parts if not inside(points[part], frame.size)):
        wrong = f"the box {','.join(f'{value:g}' for value in box)} would put {outside} outside the frame"
        raise InputError(f"{clip}: {wrong}; draw it from the brows to the chin, or give the points with --init FILE")
    # to 0.01 px, as in an init file: a run from that file begins in the same place
    placed = {part: (round(points[part][0], 2), round(points[part][1], 2)) for part in parts}
    return Start(frame.index, {"face": TargetStart(box, placed)}, "--box", detector=look.name, placed=True)
