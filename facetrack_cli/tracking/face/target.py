"""A face: a head that carries points, and the points tracked inside of it (ours).

The head is a box with a particle filter of its own. Its place and scale, and the roll of the face, are a similarity T_t
that maps a still face to the frame (`still.py`), and the points' filter sees the frame through it: a face that hardly
moves. What is left to track is expression, and what the head turns out of the plane. For a head at rest T is constant,
and that filter is the published one (Patras & Pantic, FG 2004). The shape prior is that of the still face, so it is
registered by the head: translation, scale and roll.

In each frame a sensor places the points in the still face: a regression (`descent.py`), or a network where its file is
there (`mesh.py`). Windows are exact and may be lost; the sensor is less exact and has no memory. The points' filter
joins both (`sensors.py`, `models/motion.py`). Further points of the network have no windows (`mesh_points.py`).

A detector of faces measures the face's box every so many frames. Of a head that is lost, it is asked as often where in
the frame faces are; the head's filter compares them with what the first frames showed, and what it recognises is where
it is proposed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.geometry import centre, corners
from facetrack_cli.core.types import BOX, Array, Frame, Mask, TargetStart
from facetrack_cli.recipe.face import Head
from facetrack_cli.tracking.calibration import Calibration
from facetrack_cli.tracking.face import still
from facetrack_cli.tracking.face.mesh_points import UNSEEN, MeshPoints
from facetrack_cli.tracking.face.senses import Senses
from facetrack_cli.tracking.face.sensors import Facing, Sensor, common_shift, joined
from facetrack_cli.tracking.face.still import EYES, FACE, Similarity
from facetrack_cli.tracking.loop import Cover
from facetrack_cli.tracking.models.likelihoods import window_ncc
from facetrack_cli.tracking.models.motion import JumpingWalk
from facetrack_cli.tracking.roles import Names
from facetrack_cli.tracking.smoothing import Belief
from facetrack_cli.tracking.start.detectors import TILT, Found
from facetrack_cli.tracking.target import ParticleTarget, State
from facetrack_cli.trajectory.diagnostics import EVIDENCE, ROLL, SCALE, Diagnostics
from facetrack_cli.trajectory.trajectory import TargetResult, Trajectory, of_frame

OFF: Final = 0.35  # distances between the eyes; a point that is farther away than this is off
_SIZES: Final = 0.15  # standard deviation of the log size of a detection
_FACES: Final = 4  # that are compared with the one that is lost
_PLACES: Final = 0.1  # and of its middle, in sizes of the box
_POSE: Final = np.array([math.radians(0.5), 0.004, 0.004, 0.004])  # standard deviations of the pose in a frame
_TILTED: Final = 2  # looks from one at the roll to the next
_TILT: Final = math.radians(5)  # standard deviation of a roll that is measured so
_FINE: Final = 256, (16.0, 16.0, 224.0, 224.0)  # pixels of the face in which it is measured, and the face's box there
_MOST: Final = np.array([math.radians(60), 0.7, 0.3, 0.3])


@dataclass(frozen=True)
class FaceState:
    """The states of head and points, the last `points` as rows of the still face; what is known of their sensor.

    `second` is that of the detector; `others` are the points of the network, None before it has seen the face.

    `pose` (4,) is that of the face in its head: roll in radians, the logarithm of its size, and its middle in sizes of
    the head's box; `pose_var` (4,) are their variances. `frames` counts those since the start. `marks` (M, 2) are the
    detector's, of the start, where the roll is 0; None if it saw none there.
    """

    head: State
    features: State
    points: TargetResult
    sensor: Sensor
    second: Sensor
    facing: Facing
    pose: Array
    pose_var: Array
    marks: Array | None
    others: MeshPoints | None
    frames: int = 0


@dataclass(frozen=True)
class FaceTarget:
    """`side`: of the box at the start, in pixels; rows are those of the points, of the box, and of the `others`."""

    name: str
    head: ParticleTarget
    features: ParticleTarget
    settings: Head
    senses: Senses
    side: float
    calibration: Calibration | None = None

    @property
    def parts(self) -> tuple[str, ...]:
        return (*self.features.parts, BOX, *self.senses.others)

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        scale = self.side / FACE
        points = {part: (w * scale, h * scale) for part, (w, h) in self.features.windows.items()}
        return {**points, **self.head.windows}

    def begin(self, rng: Generator, frame: Frame) -> tuple[FaceState, TargetResult]:
        head, box = self.head.begin(rng, frame)
        similarity = self._map(head, np.zeros(4))
        seen = similarity.read(frame)
        features, points = self.features.begin(rng, seen)
        facing, found = Facing(), self.senses.detected(seen)
        sensor, second, others = self.senses.begin(frame, similarity, seen, found, self.features.x0)
        if self.senses.detector is not None and not self.senses.searched and found is None:
            facing = facing.unseen()
        marks, rest = self._marks(head, np.zeros(4), frame), np.zeros(4)
        state = FaceState(
            head, features, points._replace(beliefs=None), sensor, second, facing, rest, rest, marks, others
        )
        return state, self._result(state, box, frame)

    def restart(
        self, rng: Generator, frame: Frame, first: FaceState, given: TargetStart, absent: Names = (), anew: Names = ()
    ) -> tuple[FaceState, TargetResult]:
        """As `ParticleTarget.restart`; the head is where the points are as in the first frame."""
        placed = {part: np.array(at) for part, at in given.points.items() if part not in absent}
        known = np.isin(self.features.parts, list(placed))
        at = np.array([placed[part] for part in self.features.parts if part in placed])
        rest, scale, roll = self.features.x0[known], self.side / FACE, 0.0
        if len(at) > 1:
            spread = np.sum((rest - rest.mean(axis=0)) ** 2)
            scale = math.sqrt(float(np.sum((at - at.mean(axis=0)) ** 2)) / max(float(spread), 1e-9))
            roll = still.turn_between(at, rest)
        if given.box is not None and not given.points:
            scale = math.sqrt(given.box[2] * given.box[3]) / FACE
        shape = Similarity(np.zeros(2), scale, roll)
        middle = at.mean(axis=0) - (rest.mean(axis=0) - still.MIDDLE) @ shape.matrix.T
        side = FACE * scale
        box = (float(middle[0]) - (side - 1) / 2, float(middle[1]) - (side - 1) / 2, side, side)
        head, boxed = self.head.restart(rng, frame, first.head, TargetStart(box))
        pose = np.array([roll, 0.0, 0.0, 0.0])
        similarity = self._map(head, pose)
        moved = {part: tuple(similarity.to_still(place).tolist()) for part, place in placed.items()}
        seen, there = similarity.read(frame), TargetStart(points=moved)
        features, rows = self.features.restart(rng, seen, first.features, there, absent, anew)
        found, at = self.senses.detected(seen), features.estimated.state
        sensor, second, others = self.senses.begin(frame, similarity, seen, found, at)
        points = rows._replace(beliefs=None)
        state = FaceState(head, features, points, sensor, second, Facing(), pose, np.zeros(4), first.marks, others)
        return state, self._result(state, boxed, frame)

    def advance(
        self, rng: Generator, state: FaceState, frame: Frame, covers: Sequence[Cover] = ()
    ) -> tuple[FaceState, TargetResult]:
        detections, frames = self.settings.detections, state.frames + 1
        due = self.senses.detector is not None and detections is not None and frames % detections.every == 0
        before = state.head
        if due and _sure(before) < self.settings.lost_below:
            before = self._sighted(before, state.pose, frame)
        head, box = self.head.advance(rng, before, frame, covers)
        if _sure(head) < self.settings.lost_below:
            state = replace(state, head=head, frames=frames)
            return state, self._result(state, box, frame)
        similarity = self._map(head, state.pose)
        seen = similarity.read(frame)
        found, visible = self.senses.detected(seen) if due else None, self._visible(state.features)
        before_at, z2 = state.features.estimated.state, self.senses.named({} if found is None else found.points)
        around, told = [before_at.mean(axis=0)], np.isfinite(z2).all(axis=1)
        if told.any():
            around.append((before_at + (z2 - before_at)[told].mean(axis=0)).mean(axis=0))
        ((z, odds), far) = self.senses.sensed(frame, similarity, seen, around)
        features, measured = state.features, state.sensor.measured(z, visible)
        if isinstance(features.learned, window_ncc.Learned):
            features = replace(features, learned=features.learned._replace(told=odds))
        if found is not None:
            measured = joined(measured, state.second.measured(z2, visible))
        shift = common_shift(measured, before_at)
        features = _shifted(features, lambda x: x + shift)
        given = measured if isinstance(self.features.motion, JumpingWalk) else None  # others have the shift alone
        features, points = self.features.advance(rng, features, seen, (), given)
        estimated, visible = features.estimated, self._visible(features)
        sensor = state.sensor.learned(z, estimated.state, estimated.cov, visible)
        second = state.second.learned(z2, estimated.state, estimated.cov, visible)
        points = points._replace(beliefs=None)  # those are of the state
        facing = state.facing if self.senses.detector is None else state.facing.predicted()
        pose_var, others = state.pose_var + _POSE**2, state.others
        if others is not None:
            others = others.after(None, UNSEEN) if far is None else others.after(*far)
        elif far is not None:
            others = MeshPoints.begin(far.at)
        kept = state.pose, pose_var, state.marks, others, frames
        state = FaceState(head, features, points, sensor, second, facing, *kept)
        if not due:
            return state, self._result(state, box, frame)
        after = self._measured(state, found, frame)
        # of this frame the points are in the still face as it was
        result = self._result(replace(after, pose=state.pose), box, frame)
        return self._moved(after, state.pose), result

    def _visible(self, features: State) -> Array:
        """(K,) how visible the parts are, where their likelihood says so."""
        known = isinstance(features.learned, window_ncc.Learned)
        return np.asarray(features.learned.visible if known else np.ones(len(self.features.parts)))

    def _map(self, head: State, pose: Array) -> Similarity:
        x, y, scale = head.estimated.state[0, :3].tolist()
        middle = np.array([x, y]) + self.side * scale * pose[2:]
        return Similarity(middle, self.side * scale * math.exp(pose[1]) / FACE, float(pose[0]))

    def _sighted(self, head: State, pose: Array, frame: Frame) -> State:
        """The state of a head that is lost, with the places where a detector sees faces."""
        assert self.senses.detector is not None
        boxes = [found.box for found in self.senses.detector.find(frame)[:_FACES]]
        places = tuple(
            np.array([*(np.array(centre(box)) - box[2] * pose[2:]), math.log(box[2] / self.side)]) for box in boxes
        )
        return replace(head, learned=head.learned._replace(sighted=places))

    def _measured(self, state: FaceState, found: Found | None, frame: Frame) -> FaceState:
        """With what the detector says of the face's box."""
        state = replace(state, facing=state.facing.looked(found=found is not None))
        if found is None:
            return state
        # how the detected face lies in the head's box, along the axes of the frame
        lies = Similarity(np.zeros(2), math.exp(state.pose[1]) / FACE, float(state.pose[0])).to_frame(
            np.array(centre(found.box))
        )
        off = np.array([0.0, math.log(found.box[2] / FACE), *lies])
        # a box drawn by hand may be another one than the detector's
        noise = np.array([np.inf, _SIZES**2, _PLACES**2, _PLACES**2]) if self.senses.searched else np.full(4, np.inf)
        assert self.settings.detections is not None
        if state.marks is not None and state.frames // self.settings.detections.every % _TILTED == 0:
            marks = self._marks(state.head, state.pose, frame)
            if marks is not None:
                off[0], noise[0] = still.turn_between(marks, state.marks) / TILT, _TILT**2
        gain = state.pose_var / (state.pose_var + noise)
        pose = np.clip(state.pose + gain * off, -_MOST, _MOST)
        return replace(state, pose=pose, pose_var=(1 - gain) * state.pose_var)

    def _marks(self, head: State, pose: Array, frame: Frame) -> Array | None:
        """Where the detector sees the marks of the face, larger than the still one, so that they show how it rolls."""
        if self.senses.detector is None:
            return None
        side, box = _FINE
        similarity = self._map(head, pose)
        fine = similarity._replace(scale=similarity.scale * FACE / box[2])
        return self.senses.detector.marks(fine.read(frame, side).bgr, box)

    def _moved(self, state: FaceState, before: Array) -> FaceState:
        """With the points, which are in the still face of the pose `before`, in that of the state's own."""
        old, new = (self._map(state.head, pose) for pose in (before, state.pose))

        def moved(x: Array) -> Array:
            return new.to_still(old.to_frame(x))

        origin = moved(np.zeros(2))
        sensor, second = (one._replace(bias=moved(one.bias) - origin) for one in (state.sensor, state.second))
        others = state.others and state.others.mapped(moved)
        return replace(state, features=_shifted(state.features, moved), sensor=sensor, second=second, others=others)

    def cover(self, state: FaceState, *, ahead: bool) -> Cover | None:
        return self.head.cover(state.head, ahead=ahead)

    @property
    def diagnostics(self) -> tuple[Any, ...]:
        return SCALE, ROLL, EVIDENCE

    def _result(self, state: FaceState, box: TargetResult, frame: Frame) -> TargetResult:
        """Rows of the points, as last seen in the still face, of the box, and of the network's points."""
        similarity, rows = self._map(state.head, state.pose), state.points.rows
        scale = similarity.scale
        cov = np.array([[rows.std_x**2, rows.cov_xy], [rows.cov_xy, rows.std_y**2]]).transpose(2, 0, 1)
        visible = np.where(np.isnan(rows.confidence), 1.0, rows.confidence)
        points = self._rows(state, np.stack([rows.x, rows.y], axis=1), cov, visible, rows.status == "lost")
        since = np.where(rows.status == "init", "init" if not state.frames else "tracked", rows.status)
        points["status"] = np.where(points["status"] == "lost", "lost", since)
        points["confidence"] = points["confidence"] if state.frames else rows.confidence
        points |= {"w": rows.w * scale, "h": rows.h * scale, "ess": rows.ess}
        if (gone := rows.status == "absent").any():
            nothing = {name: "absent" if name == "status" else np.nan for name in points}
            points = {name: np.where(gone, nothing[name], values) for name, values in points.items()}
        face = {name: getattr(box.rows, name) for name in points} | self._face(box.rows, similarity)
        blank = {name: np.full((1, *one.shape[1:]), np.nan) for name, one in face.items() if name != "status"}
        sections = [points, face]
        if self.senses.others and (mesh := state.others) is not None:
            sections.append(self._rows(state, mesh.at, mesh.cov, mesh.visible, mesh.visible < self.settings.lost_below))
        elif self.senses.others:
            sections.append({"status": np.full(len(self.senses.others), "lost")})
        counts = len(rows), 1, len(self.senses.others)
        columns = {
            name: np.concatenate(
                [
                    section[name] if name in section else np.repeat(blank[name], n, axis=0)
                    for section, n in zip(sections, counts, strict=False)
                ]
            )
            for name in face
        }
        # of a target one number: both filters' together
        columns["particles"] = np.full(len(self.parts), float(rows.particles.max() + box.rows.particles[0]))
        values = {SCALE.name: scale * FACE / self.side, ROLL.name: math.degrees(state.pose[0])}
        # both likelihoods are ratios, which are 1 where the head is lost and nothing is compared
        seen = [one for one in (box.rows, rows) if one.frame[0] == frame.index]
        values[EVIDENCE.name] = sum(float(one.diagnostics[self.name].get(EVIDENCE.name)[0]) for one in seen)
        found = {self.name: Diagnostics.of(self.diagnostics, [frame.index], [values])}
        faces = of_frame(self._names, frame, found, **columns)
        if self.calibration is not None:
            faces = self.calibration.applied(faces, self.features.size * self.side / FACE)
        cloud = similarity.to_frame(state.points.cloud)
        return TargetResult(faces, cloud, (), box.notes, lambda: self.beliefs(state))

    def _rows(self, state: FaceState, at: Array, cov: Array, visible: Array, lost: Mask) -> dict[str, Any]:
        """Columns of points in the still face: places (K, 2) and covariances (K, 2, 2) there, how visible, and lost."""
        similarity = self._map(state.head, state.pose)
        shown = state.facing.shown * _sure(state.head)
        known = visible * shown
        cov = similarity.matrix @ cov @ similarity.matrix.T
        cov = cov + (1 - known)[:, None, None] * state.head.estimated.cov[0]  # of what is hidden, the head alone says
        var = cov.reshape(-1, 4)[:, ::3]
        near = 1 - np.exp(-((OFF * EYES * similarity.scale) ** 2) / np.maximum(var.sum(axis=1), 1e-9))
        x, y = similarity.to_frame(at).T
        std_x, std_y = np.sqrt(var).T
        lost = lost | (shown * near < self.settings.lost_below)
        return {
            "x": x, "y": y, "std_x": std_x, "std_y": std_y, "cov_xy": cov[:, 0, 1], "confidence": known * near,
            "status": np.where(lost, "lost", "tracked"),
        }  # fmt: skip

    def beliefs(self, state: FaceState) -> tuple[Belief, ...]:
        """What is known of the points in the still face, of the head, and of the network's points."""
        found, names = [*self.features.beliefs(state.features), *self.head.beliefs(state.head)], self.senses.others
        if self.calibration is not None:
            found = list(map(self.calibration.believed, (self.features.parts, self.head.parts), found))
        if names:
            unseen = MeshPoints.begin(np.full((len(names), 2), still.MIDDLE))._replace(visible=np.zeros(len(names)))
            others = (state.others or unseen).belief()
            # what returns to rest is never less known than its motion says
            found.append(others if self.calibration is None else self.calibration.believed(names, others, moves=True))
        return tuple(found)

    @cached_property
    def _names(self) -> tuple[tuple[str, str], ...]:
        return tuple((self.name, part) for part in self.parts)

    def _face(self, row: Trajectory, face: Similarity) -> dict[str, Array]:
        """Columns of the head's box: it is where the face is in it, as large as that, and turned by its roll."""
        roll, grown = face.angle, face.scale * FACE / np.sqrt(row.w * row.h)
        found = {name: getattr(row, name) * grown for name in ("w", "h", "std_w", "std_h")}
        found |= {"x": face.centre[:1], "y": face.centre[1:], "angle": np.array([math.degrees(roll)])}
        way = np.array([[math.cos(roll), -math.sin(roll), math.sin(roll), math.cos(roll)]])
        # the border runs through the middle of the outermost pixels
        size = np.stack([found["w"] - 1, found["h"] - 1], axis=1)
        return {**found, "corners": corners(way, face.centre[None], size)}


def _shifted(features: State, to: Callable[[Array], Array]) -> State:
    """The points' state at other places."""
    particles = features.particles._replace(x=to(features.particles.x))
    return replace(
        features, particles=particles, estimated=features.estimated._replace(state=to(features.estimated.state))
    )


def _sure(head: State) -> float:
    assert head.judgement is not None
    return float(head.judgement.confidence[0])
