"""What is known of a face after a frame, what the next frame shows of it, and the rows that follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import BOX, Array, Frame, Info, Mask, Particles
from facetrack_cli.engine.confidence import Calibration
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
from facetrack_cli.trajectory.trajectory import SPREAD, TargetResult, of_frame
from facetrack_cli.video.shots import Passing

OFF: Final = 0.35  # distances between the eyes; a point that is farther away than this is off
_VALUES: Final = ("x", "y", *SPREAD[:3], "confidence", "w", "h", "ess", "angle", *SPREAD[3:], "particles")
_HOW: Final = np.array(["tracked", "hidden", "lost"])  # as `landmark_kernels.show` counts them
_LOST: Final = 2
_CORNERS: Final = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])  # of a box, clockwise


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
        x, y, scale = head[0, :3].tolist()
        middle = np.array([x, y]) + self.side * scale * pose[2:]
        return Similarity(middle, self.side * scale * math.exp(pose[1]) / FACE, float(pose[0]))

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
        filtered = columns = self._columns(state, info.ess, face)
        if self.calibration is not None:
            changed = self.calibration.changed(columns, self._boxes, self.features.size * self.side / FACE)
            columns = {**columns, **changed}
        rows = of_frame(self._names, frame, diagnostics, **columns)
        cloud = face.to_frame(state.features.particles.x)

        def beliefs() -> tuple[Belief, ...]:
            return self.beliefs(state, of_frame(self._names, frame, diagnostics, **filtered).unseen)

        return TargetResult(rows, cloud, notes, beliefs)

    def _columns(self, state: FaceState, head_ess: Array, face: Similarity) -> dict[str, Any]:
        """Columns of all parts.

        The confidence of a point with a window is that it is visible, shown with the head and near. That of a point
        without a window is of its place alone; where it is not seen it is hidden. Points at nan are lost. The head's
        box is where the face is in it, as large as that, and turned by its roll.
        """
        features, head, k, count = state.features, state.head, len(self.features.parts), len(self._names)
        points, box, judged = features.estimated, head.estimated, features.judgement
        assert judged is not None and head.judgement is not None
        at, cov, seen = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan), np.ones(count)
        hows, end = np.zeros(count, np.int64), k + 1
        at[:k], cov[:k], seen[:k] = points.state, points.cov, judged.confidence
        hows[:k] = [_LOST * (status == "lost") for status in judged.status]
        for names, landmarks in self._without_windows(state):
            those, end = slice(end, end + len(names)), end + len(names)
            if landmarks is not None:
                at[those], cov[those], seen[those] = landmarks.at, landmarks.cov, landmarks.visible
        values = np.full((len(_VALUES), count), np.nan)
        shown, near = state.facing.shown * head_confidence(head), OFF * EYES * face.scale
        place = face.matrix, face.centre, MIDDLE, near, self.settings.lost_below, values[:6], hows
        kernels.show(at, cov, seen, k, shown, box.cov[0], *place)
        values[6:8, :k], values[8, :k] = self.features.space.windows(points).T * face.scale, state.info.ess
        status = _HOW[hows]
        if not state.frames:
            status[:k][(hows[:k] < _LOST) & (np.array(judged.status) == "init")] = "init"
            values[5, :k] = judged.confidence
        if features.absent is not None:
            values[:, :k][:, features.absent], status[:k][features.absent] = np.nan, "absent"
        status[k], roll = head.judgement.status[0], math.remainder(face.angle, math.tau)
        sides = self.head.space.windows(box)[0]
        grown = face.scale * FACE / math.sqrt(sides[0] * sides[1])
        sides, spread = sides * grown, (math.nan, math.nan) if box.side_std is None else box.side_std * grown
        std = np.sqrt(np.maximum(np.diagonal(box.cov[0]), 0.0))
        sure = head_confidence(head), *sides, head_ess[0], math.degrees(roll)
        values[:-1, k] = *face.centre, *std, box.cov[0, 0, 1], *sure, *spread
        values[-1] = len(features.particles.x) + len(head.particles.x)  # of a target one number: both filters' together
        outlines = np.full((count, 4, 2), np.nan)
        # the border runs through the middle of the outermost pixels
        outlines[k] = Similarity(face.centre, 1.0, roll).to_frame(MIDDLE + _CORNERS * (sides - 1))
        return {**dict(zip(_VALUES, values, strict=True)), "status": status, "corners": outlines}

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
    def _names(self) -> tuple[tuple[str, str], ...]:
        return tuple((self.name, part) for part in self.parts)

    @cached_property
    def _boxes(self) -> Mask:
        return np.array([part == BOX for part in self.parts])
