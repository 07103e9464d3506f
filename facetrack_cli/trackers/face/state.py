"""What is known of a face after a frame, what the next frame shows of it, and the rows that follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.geometry import shown_angle
from facetrack_cli.core.types import BOX, Array, Frame, Info, Mask, Particles, Whole
from facetrack_cli.engine.confidence import CALIBRATED, Calibration
from facetrack_cli.engine.kernels.compiled import ABSENT, HIDDEN, INIT, LOST
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Belief
from facetrack_cli.engine.spaces import Estimate
from facetrack_cli.engine.target import ParticleState, ParticleTarget
from facetrack_cli.trackers.box.hidden_box import BoxTarget
from facetrack_cli.trackers.face import landmark_kernels as kernels
from facetrack_cli.trackers.face.detectors import Detection
from facetrack_cli.trackers.face.evidence import Sighting, View
from facetrack_cli.trackers.face.landmark_filters import BiasFilter, Facing, LandmarkFilter
from facetrack_cli.trackers.face.landmark_sensors import LandmarkReadings, LandmarkSensors
from facetrack_cli.trackers.face.motion import SensorReading
from facetrack_cli.trackers.face.settings import HeadSettings
from facetrack_cli.trackers.face.stabilized import EYES, FACE, MIDDLE, Similarity
from facetrack_cli.trajectory.diagnostics import EVIDENCE, NETWORK, ROLL, SCALE, Diagnostics
from facetrack_cli.trajectory.trajectory import PLACE, TargetResult, Trajectory, unknown_columns
from facetrack_cli.video.shots import Passing

OFF: Final = 0.35  # distances between the eyes; a point that is farther away than this is off
_VALUES: Final = ("x", "y", "angle", "time_s", *CALIBRATED)  # the rows of `landmark_kernels.show`
_ANGLE, _CONFIDENCE = 2, 4
_STATUSES: Final = ("tracked", "hidden", "lost", "init", "absent")  # by how a part is seen
_TEXTS: Final = np.array(_STATUSES)


class FaceState(NamedTuple):
    """A face after a frame."""

    head: ParticleState  # of the head's filter
    features: ParticleState  # of the points' filter, which lives in the stabilized image
    info: Info  # of the last step of the points' filter
    bias_filters: BiasFilter  # of the regression, the detector and the network, in this order
    facing: Facing  # whether the face is turned to the camera
    pose: Array  # (4,), how the face lies in the head's box: roll in radians, log of its size, offset in sizes of it
    pose_var: Array  # (4,), the variances of `pose`
    others: LandmarkFilter | None  # the network's further points; None before it has seen the face
    eyes: LandmarkFilter | None  # the points of the eyes; None where they have no rows
    views: tuple[View, ...]  # of the face so far, by which it is recognised
    last_seen: Similarity  # where a detector last saw the face for sure
    shots: Passing  # the tests for cuts
    frames: int = 0  # since the start
    log_odds: float = 0.0  # that the sensors see the face where it is tracked
    sighting: Sighting | None = None  # the likeliest face of a frame while the target is lost
    cut_time: float | None = None  # in s, of a (possible) cut after which the face was not seen yet
    crowded: int = 0  # in how many searches several faces were seen
    # log odds by its looks since the face is seen again; None while it was seen in all frames, or is recognised
    again: tuple[float, ...] | None = None
    again_time: float = 0.0  # in s, of the latest of these looks
    stranger_time: float | None = None  # in s, since which somebody else is seen in its place


class FaceView(NamedTuple):
    """A frame as seen from the head, and what the sensors say of the points there."""

    similarity: Similarity  # where the stabilized image lies in the frame
    image: Frame
    checked: bool  # whether the detector has looked
    detection: Detection | None  # the face that it saw, in the stabilized image
    landmarks: LandmarkReadings  # what regression and network say
    places: Array  # (S, K, 2) by the sensors, in pixels of the stabilized image, nan where they say nothing
    readings: SensorReading  # the same without the sensors' biases
    fused: Array  # (K, 2), regression and network together, without biases
    shift: Array  # (2,) pixels, how far the face is from where the head was expected
    log_odds: float  # that the face is there


def moved(features: ParticleState, to: Callable[[Array], Array], **others: Any) -> ParticleState:
    """The points' state, with every place x replaced by to(x), and `others` of its values."""
    (x, log_w), (state, cov, side_std) = features.particles, features.estimated
    particles, estimated = Particles(to(x), log_w), Estimate(to(state), cov, side_std)
    return features._replace(particles=particles, estimated=estimated, **others)


def head_confidence(head: ParticleState) -> float:
    assert head.judgement is not None
    return float(head.judgement.confidence[0])


def _without_window(names: tuple[str, ...], landmarks: LandmarkFilter | None) -> tuple[Array, ...]:
    """What `landmark_kernels.show` takes of points without windows; nan where nothing is known of them."""
    if landmarks is None:
        return *np.full((2, len(names), 2), np.nan), *np.full((3, len(names)), np.nan)
    return landmarks.carried, landmarks.offset, landmarks.var, landmarks.bias_std, landmarks.visible


@dataclass(frozen=True, eq=False)
class FaceParts:
    """The parts of a face, and the rows that they have in a state.

    Rows are those of the points, of the head's box, of the eyes, and of the network's further points.
    """

    name: str
    head: BoxTarget  # the filter of the head's box, in pixels of the frame
    features: ParticleTarget  # the filter of the points with windows, in pixels of the stabilized image
    settings: HeadSettings  # the recipe's section `head`
    sensors: LandmarkSensors
    side: float  # in pixels, of the head's box at the start, the square root of its area
    calibration: Calibration | None  # what turns confidences into probabilities

    @property
    def parts(self) -> tuple[str, ...]:
        return (*self.features.parts, BOX, *self.sensors.eyes, *self.sensors.others)

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        scale = self.side / FACE
        points = {part: (w * scale, h * scale) for part, (w, h) in self.features.windows.items()}
        return {**points, **self.head.windows}

    def map_to_frame(self, head: Array, pose: Array) -> Similarity:
        """The stabilized image of a face that lies by `pose` (4,) in a head at `head` (1, D)."""
        (x, y, scale), (roll, size, across, down) = head[0, :3].tolist(), pose.tolist()
        side = self.side * scale
        return Similarity(np.array([x + side * across, y + side * down]), side * math.exp(size) / FACE, roll)

    def footprint(self, state: FaceState, *, ahead: bool) -> Footprint | None:
        return self.head.footprint(state.head, ahead=ahead)

    @property
    def diagnostics(self) -> tuple[Any, ...]:
        return (SCALE, ROLL, EVIDENCE) if self.sensors.mesh is None else (SCALE, ROLL, EVIDENCE, NETWORK)

    def result(self, state: FaceState, info: Info, frame: Frame, notes: tuple[str, ...] = ()) -> TargetResult:
        """The rows of all parts, with the particles of the points, in the frame; `info` is of the head's filter."""
        face = self.map_to_frame(state.head.estimated.state, state.pose)
        values = {
            SCALE.name: np.array([face.scale * FACE / self.side]),
            ROLL.name: np.array([math.degrees(state.pose[0])]),
            # both likelihoods are ratios, which are 1 where the head is lost and nothing is compared
            EVIDENCE.name: np.array([info.evidence + state.info.evidence]),
        }
        if self.sensors.mesh is not None:
            values[NETWORK.name] = state.bias_filters.reliability[kernels.BY_NETWORK].mean(keepdims=True)
        diagnostics = {self.name: Diagnostics(self.diagnostics, np.array([frame.index]), values)}
        numbers, how, corners = self._rows(state, info.ess, face, frame)
        filtered = how.copy()
        if self.calibration is not None:
            self.calibration.changes(numbers[_CONFIDENCE:], how, self._boxes, self.features.size * self.side / FACE)
        if frame.aspect != 1:
            numbers[_ANGLE] = shown_angle(numbers[_ANGLE], frame.aspect)
        rows = object.__new__(Trajectory)  # whose constructor has a call for each column
        vars(rows).update(self._same, status=_TEXTS[how], corners=corners, diagnostics=diagnostics)
        vars(rows).update(zip(_VALUES, numbers, strict=True), frame=np.full(len(how), frame.index))
        cloud = face.to_frame(state.features.particles.x)

        def beliefs() -> tuple[Belief, ...]:
            return self.beliefs(state, (filtered == HIDDEN) | (filtered == LOST))

        return TargetResult(rows, cloud, notes, beliefs)

    def _rows(self, state: FaceState, head_ess: Array, face: Similarity, frame: Frame) -> tuple[Array, Whole, Array]:
        """The columns `_VALUES` of all parts, how they are seen, and corners, without calibration.

        The confidence of a point with a window is that it is visible, shown with the head and near. That of a point
        without a window is of its place alone; where it is not seen it is hidden. Points at nan are lost. The head's
        box is where the face is in it, as large as that, and turned by its roll.
        """
        features, head, k, count = state.features, state.head, len(self.features.parts), len(self._boxes)
        points, box, judged = features.estimated, head.estimated, features.judgement
        assert judged is not None and head.judgement is not None and self.features.confidence is not None
        sure, roll, turn = head_confidence(head), math.remainder(face.angle, math.tau), face.turn
        w, h = self.head.space.windows(box)[0].tolist()
        grown = face.scale * FACE / math.sqrt(w * h)
        std_w, std_h = (math.nan, math.nan) if box.side_std is None else box.side_std.tolist()
        known = (
            turn.real, turn.imag, *face.centre, MIDDLE, face.scale, OFF * EYES * face.scale, state.facing.shown * sure,
            self.settings.lost_below, self.features.confidence.patience, frame.size[0] - 1, frame.size[1] - 1,
            frame.time_s, len(features.particles.x) + len(head.particles.x),  # one number: both filters' together
            sure, w * grown, h * grown, head_ess[0], math.degrees(roll), math.cos(roll), math.sin(roll),
            std_w * grown, std_h * grown, _STATUSES.index(head.judgement.status[0]),
        )  # fmt: skip
        values, how, corners = np.empty((len(_VALUES), count)), np.empty(count, np.int64), np.empty((count, 4, 2))
        windows = points.state, points.cov, judged.confidence, judged.below, state.info.ess
        sides = self.features.space.windows(points)
        others = [_without_window(*each) for each in self._without_windows(state)] or [_without_window((), None)]
        more = others[0] if len(others) == 1 else map(np.concatenate, zip(*others, strict=True))
        kernels.show(*windows, sides, *more, box.cov[0], np.array(known, np.float64), values, how, corners)
        if not state.frames:
            how[:k][(how[:k] != LOST) & (np.array(judged.status) == "init")] = INIT
            values[_CONFIDENCE, :k] = judged.confidence
        if features.absent is not None:
            how[:k][features.absent] = ABSENT
            for name, column in zip(_VALUES, values, strict=True):
                column[:k][features.absent & (name in PLACE)] = np.nan
        return values, how, corners

    def beliefs(self, state: FaceState, unseen: Mask) -> tuple[Belief, ...]:
        """For the smoother: of the points in the stabilized image, of the head, and of the points without windows.

        `unseen` (K,) marks the parts that are in doubt.
        """
        beliefs = [*self.features.beliefs(state.features), *self.head.beliefs(state.head)]
        if self.calibration is not None:
            beliefs = list(map(self.calibration.believed, (self.features.parts, self.head.parts), beliefs))
        for names, landmarks in self._without_windows(state):
            if landmarks is None:
                nowhere = LandmarkFilter.begin(np.full((len(names), 2), MIDDLE))
                landmarks = nowhere._replace(visible=np.zeros(len(names)))
            beliefs.append(landmarks.belief())
        ends = np.cumsum([len(belief.mean) for belief in beliefs])[:-1]
        each = zip(beliefs, np.split(unseen, ends), strict=True)
        return tuple(belief._replace(doubt=belief.doubt | lost) for belief, lost in each)

    def _without_windows(self, state: FaceState) -> list[tuple[tuple[str, ...], LandmarkFilter | None]]:
        """The names of points without windows, in the order of rows, with their filters."""
        groups = (self.sensors.eyes, state.eyes), (self.sensors.others, state.others)
        return [(names, landmarks) for names, landmarks in groups if names]

    @cached_property
    def _same(self) -> Mapping[str, Any]:
        """The columns that are the same in each frame."""
        names = tuple((self.name, part) for part in self.parts)
        return {**unknown_columns(len(names)), "names": names, "which": np.arange(len(names)), "header": {}}

    @cached_property
    def _boxes(self) -> Mask:
        return np.array([part == BOX for part in self.parts])
