"""What a run comes to: where it began, whether a detector bears it out, and which frames somebody should look at.

A detector of faces looks, a few times a second, at the place where a face that was searched for is said to be. It takes
no part in the tracking, so that a track of something else is told from one of a face even if the tracker is sure of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from facetrack_cli.core.face_points import DETECTORS, HANDS
from facetrack_cli.core.geometry import centre, square
from facetrack_cli.core.npz import STORED
from facetrack_cli.core.numbers import clock, places
from facetrack_cli.core.types import BOX, Box, Point, Start
from facetrack_cli.recipe.load import calibrated, fitted
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.runs.plan import Outcome
from facetrack_cli.runs.record import ClipFacts, Sink
from facetrack_cli.trackers.face.detectors import Detector, detector
from facetrack_cli.trackers.face.stabilized import BOX as STILL
from facetrack_cli.trackers.face.stabilized import FACE, Similarity, slope
from facetrack_cli.trajectory.diagnostics import DOUBTFUL, NAMED
from facetrack_cli.trajectory.trajectory import SEEN, FrameResult, Trajectory, mean_confidence
from facetrack_cli.trajectory.writers import Header

EVERY_FRAMES: Final = 15  # between two looks
LOW: Final = 0.9  # the frame of the lowest mean confidence is named if that is less
SURE_OF_NAMES: Final = 0.8  # probability, below which the names of hands are in doubt
MIN_LOOKS: Final = 3  # fewer looks than this say nothing
_MAX_SPANS: Final = 3  # the longest ones, which are named
Spans: TypeAlias = list[tuple[int, int]]  # first and last frames


@dataclass
class RunMonitor(Sink):
    """Counts in bounded memory what the verdict on one run rests on; `detector` None: nobody looks."""

    start: Start = field(metadata={STORED: False})
    calibrated: bool  # whether confidence is a probability
    fitted: bool  # or one with other settings, which counts where it is low
    detector: Detector | None = field(metadata={STORED: False})
    frames: int = 0
    first: tuple[int, float] = (0, 0.0)
    looks: int = 0
    seen: int = 0
    several: bool = False  # parts
    judged: int = 0  # frames with a confidence
    sure: float = 0.0  # the sum of their means
    least: tuple[float, int] = (np.inf, 0)
    lost_frames: int = 0
    hidden_frames: int = 0
    lost: Spans = field(default_factory=list)  # where a part is lost
    hands: int = -1  # frames in which a hand is seen; -1 where none is followed
    unnamed: Spans = field(default_factory=list)  # where names of hands are in doubt

    @classmethod
    def of(cls, recipe: Recipe, start: Start) -> RunMonitor:
        name = next((name for name in DETECTORS if name == start.origin), None)
        settings = to_dict(recipe)
        return cls(start, calibrated(settings), fitted(settings), None if name is None else detector(name))

    def begin(self, clip: ClipFacts, header: Header, mark: RunMonitor | None) -> None:
        """Go on from what was counted of the frames before."""
        if mark is not None:
            self.__dict__ |= {**vars(mark), "start": self.start, "detector": self.detector}

    def mark(self) -> RunMonitor:
        return self

    def end(self, done: Outcome) -> None:
        done.verdict, done.doubts, done.look = self.line(), self.doubts(), self.look
        if unseen := self.unseen():
            done.warnings += (unseen,)

    def write(self, result: FrameResult) -> None:
        """Take in one more frame, and look at every few."""
        rows = result.rows
        if not len(rows):  # nobody is there
            return
        index, gone = int(rows.frame[0]), rows.status == "lost"
        if not self.frames:
            self.first = index, float(rows.time_s[0])
        self.frames += 1
        self.several |= len(rows) > 1
        if self.detector is not None and self.frames % EVERY_FRAMES == 0 and not gone.all():
            self._look(result, self.detector)
        if gone.any():
            self.lost_frames += 1
            self.lost = _grown(self.lost, index)
        self.hidden_frames += bool((rows.status == "hidden").any())
        confidence = rows.confidence[np.isfinite(rows.confidence) & (rows.status != "init")]
        if confidence.size:
            mean = mean_confidence(confidence)
            self.judged, self.sure = self.judged + 1, self.sure + mean
            if not gone.any():
                self.least = min(self.least, (mean, index))
        hands = np.array([target in HANDS for target, _ in rows.names])[rows.which]
        if not hands.any():
            return
        seen = bool((hands & np.isin(rows.status, SEEN)).any())
        self.hands = max(self.hands, 0) + seen
        named = [reported.get(NAMED.name)[0] for target, reported in rows.diagnostics.items() if target in HANDS]
        if seen and named and min(named) < SURE_OF_NAMES:
            self.unnamed = _grown(self.unnamed, index)

    def line(self) -> str:
        """The verdict in one line."""
        why, by = self.doubts(), self.detector and self.detector.name
        who, lost = "some part " if self.several else "", "never called lost"
        if self.lost_frames:
            lost = f"{who}called lost in {self.lost_frames} of {self.frames} frame{'s' * (self.frames > 1)}"
        hidden = f", {who}hidden in {self.hidden_frames}" if self.hidden_frames else ""
        index, time_s = self.first
        skipped = f", {index} frame{'s' * (index > 1)} of the clip are before it" if index else ""
        begins = f"begins in frame {index} ({clock(time_s)}), by {self.start.origin}{skipped}"
        parts = [f"doubtful: {why}" if why else lost + hidden, begins]
        if self.looks and not why:
            parts.append(f"while it is followed, {by} sees a face there in {self.seen} of {self.looks} looks")
        look = [f"{places(sorted(_longest(self.lost)))} (lost)"] if self.lost else []
        if self.least[0] < LOW:
            raw = "" if self.calibrated else ", not calibrated"
            look.append(f"{self.least[1]} (lowest confidence, {self.least[0]:.2f}{raw})")
        if self.unnamed:
            parts.append(f"which hand is which is in doubt in frames {places(sorted(_longest(self.unnamed)))}")
        if look:
            parts.append(f"look at frames {', '.join(look)}")
        return "; ".join(parts)

    @property
    def look(self) -> tuple[tuple[int, int], ...]:
        """First and last frames to look at first: the longest in which a part is lost, else the least sure one."""
        return tuple(_longest(self.lost)) or ((self.least[1],) * 2,) * (self.least[0] < LOW)

    def doubts(self) -> str:
        """What speaks against the track; "" if nothing does."""
        if why := self.unseen():
            return why
        if not self.hands:
            return f"no hand appears in its {self.frames} frames; if another face signs, begin with its --box X,Y,W,H"
        if self.fitted and self.sure < DOUBTFUL * self.judged:
            return f"its confidence expects {self.sure / self.judged:.0%} of its rows to be right"
        return ""

    def unseen(self) -> str:
        """What the detector's looks speak against the track; "" if nothing."""
        if self.detector is None or self.looks < MIN_LOOKS or self.seen >= DOUBTFUL * self.looks:
            return ""
        looks = f"in {self.seen} of {self.looks} looks alone"
        return f"{self.detector.name} sees a face there {looks}; it may be something else, begin with --box X,Y,W,H"

    def _look(self, result: FrameResult, detector: Detector) -> None:
        name, target = next(iter(self.start.targets.items()))  # the first is that of the face that was searched for
        rows = next((target.rows for target in result.targets if target.rows.target == name), None)
        box = None if rows is None or target.box is None else _face(rows, target.box, target.points)
        if rows is not None and box is not None:
            ends = [target.points[part] for part in ("mouth_left", "mouth_right") if part in target.points]
            at_start = slope(np.array(ends)) if len(ends) == 2 else 0.0
            roll = next(iter(np.radians(rows.angle[np.isfinite(rows.angle)])), at_start)
            quarter = np.pi / 2 * round(2 * roll / np.pi)  # a detector sees faces that are less turned
            upright = Similarity(np.array(centre(box)), box[2] / FACE, quarter).read(result.frame)
            self.looks += 1
            self.seen += detector.measure(upright.bgr, STILL) is not None


def _longest(spans: Spans) -> Spans:
    return sorted(spans, key=lambda span: span[0] - span[1])[:_MAX_SPANS]


def _grown(spans: Spans, index: int) -> Spans:
    """The longest spans, and that which goes on to this frame, however short it is."""
    first = next((a for a, b in spans if b == index - 1), index)
    return [*_longest([span for span in spans if span[0] != first]), (first, index)]


def _face(rows: Trajectory, began: Box, points: Mapping[str, Point]) -> Box | None:
    """The face's box by the rows of a target: its own, or that of the start moved as its points have; None if lost."""
    parts = [rows.names[i][1] for i in rows.which.tolist()]
    there = np.isfinite(rows.x + rows.y) & (rows.status != "lost")
    for k in np.flatnonzero(there).tolist():
        if parts[k] not in points:
            side = max(float(np.sqrt(rows.w[k] * rows.h[k])), 2.0)
            return square(np.array([rows.x[k], rows.y[k]]), side)
    moved = [
        (rows.x[k] - points[p][0], rows.y[k] - points[p][1]) for k, p in enumerate(parts) if there[k] and p in points
    ]
    if not moved or BOX in parts:
        return None
    x, y = np.mean(moved, axis=0).tolist()
    return began[0] + x, began[1] + y, began[2], began[3]
