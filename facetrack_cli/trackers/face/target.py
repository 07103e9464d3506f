"""A face: a head that carries points, and the points tracked inside of it (ours).

The head is a box with a particle filter of its own. Its place and scale, and the roll of the face, are a similarity T_t
that maps a stabilized image of the face to the frame (`stabilized.py`). The points' filter sees that image, in which
the face hardly moves. What is left to track is expression, and what the head turns out of the plane. For a head at rest
T is constant, and that filter is the published one (Patras & Pantic, FG 2004). The shape prior is that of the
stabilized image, so it is registered by the head: translation, scale and roll.

In each frame sensors place the points in the stabilized image: a regression (`descent.py`), and a network if its file
is there (`mesh.py`). Windows are exact and may be lost. Sensors are less exact and have no memory. The points' filter
joins all (`sensors.py`, `motion.py`). Eyes (`eyes.py`) and further points of the network have no windows
(`mesh_points.py`), and no say in where the face is.

A detector of faces measures the face's box every so many frames. Of a head that is lost, it is asked as often where in
the frame faces are; the head's filter compares them with what the first frames showed, and what it recognises is where
it is proposed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.geometry import centre, corners, square
from facetrack_cli.core.types import BOX, Array, Frame, Mask, TargetStart
from facetrack_cli.engine.calibration import Calibration
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Motion, Names
from facetrack_cli.engine.smoothing import Belief
from facetrack_cli.engine.spaces import Estimate
from facetrack_cli.engine.target import ParticleState, ParticleTarget, Rows
from facetrack_cli.trackers.box.hidden_box import BoxTarget
from facetrack_cli.trackers.face import stabilized, window_ncc
from facetrack_cli.trackers.face.evidence import (
    MAYBE,
    NEW,
    STAYS,
    SURE,
    Sighting,
    by_looks,
    by_place,
    kept,
    likeness,
    look_of,
    probabilities,
)
from facetrack_cli.trackers.face.mesh_points import NO_FACE, MeshPoints
from facetrack_cli.trackers.face.motion import JumpingWalk, MeasuredWalk, SensorReading, modes
from facetrack_cli.trackers.face.senses import Senses
from facetrack_cli.trackers.face.sensors import (
    AREA,
    WINDOWS,
    Facing,
    apart,
    common_shift,
    in_common,
    joined,
    who_is_right,
)
from facetrack_cli.trackers.face.settings import HeadSettings
from facetrack_cli.trackers.face.stabilized import EYES, FACE, Similarity
from facetrack_cli.trackers.face.state import FaceState, View, shifted, sure_of, updated
from facetrack_cli.trackers.people.descriptor import Picture
from facetrack_cli.trajectory.diagnostics import EVIDENCE, NETWORK, ROLL, SCALE, Diagnostics
from facetrack_cli.trajectory.trajectory import TargetResult, of_frame
from facetrack_cli.video.shots import Passing, small

OFF: Final = 0.35  # distances between the eyes; a point that is farther away than this is off
COMPANY: Final = 2  # looks at several faces, from which the clip has shown somebody else
LOOK: Final = (3, 9)  # frames between two looks of the head's filter while it is new, and later, where points are seen
NEW_FILTER: Final = 20  # looks until it knows how high its peaks are, and takes no other thing for the head
SETTLED: Final = 0.95  # probability by the head's filter, below which it looks in every frame
EASY: Final = 8.0  # log odds that the points are seen where they are
DOUBT: Final = 8.0  # log odds, below which the detector looks at once
STEADY: Final = 2.5  # pixels of the stabilized image, which a face is at most from where it is expected, in between
_FORGETS: Final = 0.95  # share of `sure` that is left after a frame in which the head is lost
_FACES: Final = 4  # that are compared with the one that is lost
# standard deviations of the pose in a frame, of that by a detected box, and of that by parts left and right
_POSE: Final = np.array([math.radians(1.5), 0.012, 0.004, 0.004])
_BY_BOX: Final = np.array([np.inf, 0.15, 0.1, 0.1])
_BY_EYES: Final = 0.06  # of its size, where the detector sees the eyes
_BY_PAIRS: Final = np.array([math.radians(3), np.inf, np.inf, np.inf])


@dataclass(frozen=True)
class FaceTarget:
    """A face whose box has sides of `side` pixels at the start, and lies in it as `pose` (4,) says.

    Rows are those of the points, of the box, of the eyes, and of the `others`. `alone`: while it is lost, any face that
    is seen may be this one.
    """

    name: str
    head: BoxTarget
    features: ParticleTarget
    settings: HeadSettings
    senses: Senses
    side: float
    pose: Array
    calibration: Calibration | None = None
    alone: bool = True

    @property
    def parts(self) -> tuple[str, ...]:
        return (*self.features.parts, BOX, *self.senses.eyes, *self.senses.others)

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        scale = self.side / FACE
        points = {part: (w * scale, h * scale) for part, (w, h) in self.features.windows.items()}
        return {**points, **self.head.windows}

    def begin(self, rng: Generator, frame: Frame) -> tuple[FaceState, TargetResult]:
        head, begun = self.head.begin(rng, frame)
        similarity = self._map(head.estimated.state, self.pose)
        seen = similarity.read(frame)
        features, _ = self.features.begin(rng, seen)
        facing, found = Facing(), self.senses.detected(seen)
        sensors, others, eyes = self.senses.begin(frame, similarity, seen, found, self.features.x0)
        if self.senses.detector is not None and not self.senses.searched and found is None:
            facing = facing.unseen()
        points = self.features.rows(features, seen, otherwise="init")
        state = FaceState(
            head, features, points, sensors, facing, self.pose, np.zeros(4), others, eyes,
            (look_of(seen),), (self._picture(frame, similarity),), similarity, Passing((small(frame),)),
        )  # fmt: skip
        box = self.head.rows(head, frame, otherwise="init")._replace(notes=begun.notes)
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
            roll = stabilized.change_between(at, rest)[0]
        if given.box is not None and not given.points:
            scale = math.sqrt(given.box[2] * given.box[3]) / FACE
        shape = Similarity(np.zeros(2), scale, roll)
        middle = at.mean(axis=0) - (rest.mean(axis=0) - stabilized.MIDDLE) @ shape.matrix.T
        side = FACE * scale
        head, _ = self.head.restart(rng, frame, first.head, TargetStart(square(middle, side)))
        pose = np.array([roll, 0.0, 0.0, 0.0])
        similarity = self._map(head.estimated.state, pose)
        moved = {part: tuple(similarity.to_stabilized(place).tolist()) for part, place in placed.items()}
        seen, there = similarity.read(frame), TargetStart(points=moved)
        features, _ = self.features.restart(rng, seen, first.features, there, absent, anew)
        found, at = self.senses.detected(seen), features.estimated.state
        sensors, others, eyes = self.senses.begin(frame, similarity, seen, found, at)
        points = self.features.rows(features, seen)
        state = FaceState(
            head, features, points, sensors, Facing(), pose, np.zeros(4), others, eyes, first.looks,
            first.pictures, similarity, Passing((small(frame),)),
        )  # fmt: skip
        return state, self._result(state, self.head.rows(head, frame), frame)

    def advance(
        self, rng: Generator, state: FaceState, frame: Frame, footprints: Sequence[Footprint] = ()
    ) -> tuple[FaceState, TargetResult]:
        state = state._replace(frames=state.frames + 1)
        if not self._searches:
            return self._step(rng, state, frame, footprints)
        passing, event = state.passing.after(frame)
        cut = {"": state.cut, "none": None}.get(event, frame.time_s)
        state = state._replace(passing=passing, cut=cut)
        if cut is None or frame.time_s - cut <= STAYS:
            after, result = self._step(rng, state, frame, footprints)
            if cut is None or after.cut is None or self._stays(after, frame):
                return after._replace(cut=None), result
        just = frame.time_s - cut <= STAYS  # then every frame counts
        if just or event or self._is_due(state):
            state = self._sighted(state, frame)
            if (seen := state.sighting) is not None and seen.is_target(frame):
                return self._returned(rng, state, seen, frame)
        head, info = self.head.unseen(rng, state.head, frame, anywhere=not just)
        state = state._replace(head=head, sure=_FORGETS * state.sure)
        return state, self._result(state, self.head.rows(head, frame, info), frame)

    @cached_property
    def _searches(self) -> bool:
        """Whether a detector looks for the face anywhere in the frame while it is lost."""
        return self.alone and self.senses.detector is not None and self.settings.detections is not None

    def _is_due(self, state: FaceState) -> bool:
        detections = self.settings.detections
        return self.senses.detector is not None and detections is not None and state.frames % detections.every == 0

    def _step(
        self, rng: Generator, state: FaceState, frame: Frame, footprints: Sequence[Footprint]
    ) -> tuple[FaceState, TargetResult]:
        """A frame later, in the same scene."""
        shown = sure_of(state.head) >= self.settings.lost_below
        due = self._is_due(state)
        if self.senses.detector is not None and self.settings.detections is not None:
            due |= shown and state.sure <= DOUBT
        view: View | None = None
        if sure_of(state.head) >= SETTLED and state.sure >= EASY and state.frames % self._every(state):
            view = self._view(state, self.head.motion.expect(state.head.estimated.state[None])[0], frame, due=due)
            if view.parts.sure >= EASY and math.hypot(*view.shift) < STEADY:
                return self._followed(rng, state, view, frame, None)
        if due and not shown and self.alone:
            state = self._sighted(state, frame)
            if (seen := state.sighting) is not None and seen.is_target(frame):
                return self._returned(rng, state, seen, frame)
        told = 0.0 if state.sighting is not None else state.facing.odds(state.sure)
        before = replace(state.head, learned=state.head.learned._replace(told=told))
        head, info = self.head.advanced(rng, before, frame, footprints)
        box = self.head.rows(head, frame, info)
        if sure_of(head) < self.settings.lost_below:
            state = state._replace(head=head, facing=state.facing.predicted(), sure=_FORGETS * state.sure)
            return state, self._result(state, box, frame)
        state = state._replace(head=head, sighting=None)
        if view is None or not view.similarity.is_near(self._map(head.estimated.state, state.pose), STEADY):
            view = self._view(state, head.estimated.state, frame, due=due)
        return self._followed(rng, state, view, frame, box)

    def _every(self, state: FaceState) -> int:
        """Frames between two looks of the head's filter, where the points are seen in between."""
        return LOOK[state.head.learned.frames > NEW_FILTER]

    def _stays(self, state: FaceState, frame: Frame) -> bool:
        """Whether what is followed, after what may be a cut, is the face of before."""
        if sure_of(state.head) < self.settings.lost_below or state.sure <= 0:
            return False
        looks = by_looks(state.pictures, [self._map(state.head.estimated.state, state.pose)], frame)
        [p] = probabilities(looks, np.zeros(1), cut=True, company=state.several >= COMPANY)
        return bool(p > 0.5)

    def _picture(self, frame: Frame, face: Similarity) -> Picture:
        return Picture.of(frame, face._replace(scale=face.scale * FACE))

    def _view(self, state: FaceState, head: Array, frame: Frame, *, due: bool) -> View:
        """What is seen of the points where the head is at `head` (1, D); by the detector, too, where that is `due`."""
        similarity = self._map(head, state.pose)
        seen = similarity.read(frame)
        found = self.senses.detected(seen) if due else None
        before, z2 = state.features.estimated.state, self.senses.named({} if found is None else found.points)
        around, told = [before.mean(axis=0)], np.isfinite(z2).all(axis=1)
        if told.any():
            around.append((before + (z2 - before)[told].mean(axis=0)).mean(axis=0))
        channels, parts, network, others, eyes = self.senses.sensed(frame, similarity, seen, around)
        visible = self._visible(state.features)
        places = parts.at, z2, network
        measured = tuple(one.measured(z, visible) for one, z in zip(state.sensors, places, strict=True))
        first, second = joined(measured[0], measured[2]), measured[1]
        upright = np.where(first.sure[:, None] > 0, first.z, np.nan)
        shift, sure = common_shift(joined(first, second), before), 0.0 if apart(first, second).any() else parts.sure
        return View(similarity, seen, channels, due, found, parts, others, eyes, places, measured, upright, shift, sure)

    def _followed(
        self, rng: Generator, state: FaceState, view: View, frame: Frame, box: Rows | None
    ) -> tuple[FaceState, TargetResult]:
        """The points in a frame of which there is a `view`; a head without a `box` goes with them."""
        odds, features, shift = view.parts.odds, state.features, view.shift
        features = shifted(features, lambda x: x + shift)
        if isinstance(features.learned, window_ncc.WindowState):
            within = self._within(features.estimated, view.measured)
            features = replace(features, learned=features.learned._replace(told=odds, within=within))
        walk, likelihood = self.features.motion, self.features.likelihood

        def measured(learned: Any) -> Motion:
            """Other motions than this walk have the shift alone."""
            if not isinstance(walk, JumpingWalk):
                return walk
            windows = likelihood.scored(learned) if isinstance(likelihood, window_ncc.WindowNcc) else None
            return MeasuredWalk(walk, view.measured, windows)

        features, info = self.features.advanced(rng, features, view.seen, (), measured)
        estimated, visible = features.estimated, self._visible(features)
        told, own = self._judged(state.features, view, estimated)
        regression, _, network = view.measured
        cross: Array | float = 0.0
        if network.sure.any():
            off = np.sum((network.z - regression.z) ** 2, axis=1)
            cross = np.where((network.sure > 0) & ~apart(network, regression), 0.25 * off, 0.0)
        each = zip(state.sensors, view.places, told, (cross, 0.0, cross), strict=True)
        sensors = tuple(one.learned(z, estimated.state, estimated.cov, visible, *more) for one, z, *more in each)
        if isinstance(features.learned, window_ncc.WindowState):
            features = replace(features, learned=window_ncc.doubted(features.learned, own))
        points = self.features.rows(features, frame, info)
        facing = state.facing if self.senses.detector is None else state.facing.predicted()
        others, far, similarity, head = state.others, view.others, view.similarity, state.head
        if others is not None:
            others = (
                others.after(None, NO_FACE)
                if far is None
                else others.after(far.at, sensors[2].near(far, view.places[2]))
            )
        elif far is not None:
            others = MeshPoints.begin(far.at)
        eyes = state.eyes
        if eyes is not None and view.eyes is not None:
            eyes = eyes.after(*view.eyes)
        if box is None:
            # by all of what the points have moved, or it falls behind until the head's filter looks again
            moved = in_common(estimated.state - state.features.estimated.state, visible > 0.5)
            head, info = self.head.carried(rng, head, similarity.matrix @ moved)
            box = self.head.rows(head, frame, info)
        state = state._replace(
            head=head, features=features, points=points, sensors=sensors, facing=facing, others=others,
            eyes=eyes, sure=view.sure,
        )  # fmt: skip
        if view.found is not None and view.sure >= EASY and state.cut is None:
            state = state._replace(seen=similarity)
            if likeness(state.looks, look := look_of(view.seen)) < NEW:
                picture = self._picture(frame, similarity)
                state = state._replace(looks=kept(state.looks, look), pictures=kept(state.pictures, picture))
        state = self._moved(self._posed(state, view), similarity)
        return state, self._result(state, box, frame)

    def _visible(self, features: ParticleState) -> Array:
        """(K,) how visible the parts are, where their likelihood says so."""
        known = isinstance(features.learned, window_ncc.WindowState)
        return np.asarray(features.learned.visible if known else np.ones(len(self.features.parts)))

    def _within(self, before: Estimate, measured: Sequence[SensorReading]) -> float:
        """How far parts are from where they are expected, in pixels, by their spread and by what is `measured`."""
        expected, far = self.features.motion.expect(before.state[None])[0], 0.0
        for one in (each for each in measured if each.sure.any()):
            far = max(far, np.abs(np.where(one.sure[:, None] > 0.5, one.z - expected, 0.0)).max())
        return float(far + 3 * math.sqrt(before.cov[:, [0, 1], [0, 1]].max()))

    def _judged(self, features: ParticleState, view: View, found: Estimate) -> tuple[Array, Array]:
        """By how much it is said that sensors see parts (S, K), and that windows do (K,), in log odds.

        nan of parts of which all are where the estimate is.
        """
        likelihood, own, measured = self.features.likelihood, found.state, view.measured
        odds = np.full((len(measured) + 1, len(own)), np.nan)
        visible = self._visible(features)
        windows = SensorReading(own, 0.5 * (found.cov[:, 0, 0] + found.cov[:, 1, 1]), WINDOWS * visible, AREA)
        said = [i for i, one in enumerate((*measured, windows)) if one.sure.any()]
        each = [one._replace(z=one.z - in_common(one.z - own, one.sure > 0)) for one in measured]
        each.append(windows)
        differ = np.any([apart(one, other) for one, other in combinations([each[i] for i in said], 2)], axis=0)
        if isinstance(likelihood, window_ncc.WindowNcc) and differ.any():
            learned, readings = likelihood.look(features.learned, view.seen, own), [each[i] for i in said]
            places = modes(readings, len(own))[0]
            scores = likelihood.score(learned, view.seen, places, own), self.senses.odds_at(view.channels, places)
            odds[said] = np.where(differ, who_is_right(readings, *scores), np.nan)
        return odds[:-1], odds[-1]

    def _map(self, head: Array, pose: Array) -> Similarity:
        """Of the face that lies so in a head at `head` (1, D)."""
        x, y, scale = head[0, :3].tolist()
        middle = np.array([x, y]) + self.side * scale * pose[2:]
        return Similarity(middle, self.side * scale * math.exp(pose[1]) / FACE, float(pose[0]))

    def _sighted(self, state: FaceState, frame: Frame) -> FaceState:
        """The state of a face that is lost, with the places where a detector sees faces, and the likeliest of them."""
        here, pose = self._map(state.head.estimated.state, state.pose), state.pose
        faces = self.senses.faces(frame, here)[:_FACES]
        places = tuple(
            np.array([*(np.array(centre(one.box)) - one.box[2] * pose[2:]), math.log(one.box[2] / self.side)])
            for one in faces
        )
        state = state._replace(several=state.several + (len(faces) > 1))
        seen = [Sighting.of(one, frame) for one in faces]
        if seen:
            lie = [one.similarity for one in seen]
            cut, looks = state.cut is not None, by_looks(state.pictures, lie, frame).tolist()
            seen = [
                one._replace(by_looks=odds, latest=odds).after(state.sighting)
                for one, odds in zip(seen, looks, strict=True)
            ]
            place = by_place(state.seen, lie, covered=self._is_covered(state.head)) * (not cut)
            p = probabilities(
                np.array([one.by_looks for one in seen]), place, cut=cut, company=state.several >= COMPANY
            )
            best = int(p.argmax())
            found = seen[best]._replace(p=float(p[best]))
        sighting = found if seen and found.p > MAYBE else None
        facing = state.facing.looked(found=False) if sighting is None else state.facing
        head = replace(state.head, learned=state.head.learned._replace(sighted=places))
        return state._replace(head=head, sighting=sighting, facing=facing)

    def _is_covered(self, head: ParticleState) -> bool:
        """Whether a head that is not seen is held to be where it was."""
        middle, half = head.estimated.state[0, :2], 0.5 * self.head.space.windows(head.estimated)[0]
        near = (np.abs(head.particles.x[:, 0, :2] - middle) < half).all(axis=1)
        return float(np.exp(head.particles.log_w) @ near) >= 0.5

    def _returned(
        self, rng: Generator, state: FaceState, seen: Sighting, frame: Frame
    ) -> tuple[FaceState, TargetResult]:
        """The face where it is seen again."""
        side = seen.box[2] * math.exp(-state.pose[1])
        middle = np.array(centre(seen.box)) - side * state.pose[2:]
        head, _ = self.head.restart(rng, frame, state.head, TargetStart(square(middle, side)))
        boxed = self.head.rows(head, frame)
        pose, rest = np.array([seen.roll, *state.pose[1:]]), self.features.x0
        if seen.p < SURE:
            doubt = (
                f"from frame {frame.index} on the face may be another one than before (probability {1 - seen.p:.2f})"
            )
            boxed = boxed._replace(notes=(*boxed.notes, doubt))
        features = shifted(state.features, lambda x: x + (rest - state.features.estimated.state))
        state = state._replace(head=head, features=features, pose=pose, facing=Facing(), sighting=None, cut=None)
        return self._followed(rng, state, self._view(state, head.estimated.state, frame, due=True), frame, boxed)

    def _posed(self, state: FaceState, view: View) -> FaceState:
        """With what the detector says of the face's box, and parts left and right, or else the eyes, of its roll."""
        z = view.upright
        pose, var, known = state.pose, state.pose_var + _POSE**2, np.asarray(np.isfinite(z).all(axis=1))
        turns = [stabilized.slope(z[pair]) - self._slope(pair) for pair in self._pairs if known[pair].all()]
        if view.sure <= 0:  # the points are not seen
            eyes = None if view.found is None or not self.senses.searched else view.found.eyes
            turns = [] if eyes is None else [stabilized.slope(np.array(eyes))]
        if turns:
            pose, var = updated(pose, var, np.array([np.mean(turns), 0, 0, 0]), _BY_PAIRS)
        if view.due:
            state = state._replace(facing=state.facing.looked(found=view.found is not None))
        # a box drawn by hand may differ from the detector's box
        if view.found is not None and self.senses.searched:
            box = view.found.box
            # how the detected face lies in the head's box, along the axes of the frame
            lies = Similarity(np.zeros(2), math.exp(pose[1]) / FACE, float(pose[0])).to_frame(np.array(centre(box)))
            std = _BY_BOX if view.found.eyes is None else np.array([np.inf, _BY_EYES, *_BY_BOX[2:]])
            pose, var = updated(pose, var, np.array([0.0, math.log(box[2] / FACE), *lies]), std)
        return state._replace(pose=pose, pose_var=var)

    def _moved(self, state: FaceState, old: Similarity) -> FaceState:
        """With the points, which are in the stabilized image of the `old` map, in that of the state's own."""
        turned, shift = old.into(self._map(state.head.estimated.state, state.pose))

        def moved(x: Array) -> Array:
            return np.asarray((x.reshape(-1, 2) @ turned + shift).reshape(x.shape))

        sensors = tuple(one._replace(bias=one.bias @ turned) for one in state.sensors)
        others, eyes = (one and one.mapped(moved) for one in (state.others, state.eyes))
        features = shifted(state.features, moved)
        return state._replace(features=features, sensors=sensors, others=others, eyes=eyes)

    def footprint(self, state: FaceState, *, ahead: bool) -> Footprint | None:
        return self.head.footprint(state.head, ahead=ahead)

    @property
    def diagnostics(self) -> tuple[Any, ...]:
        return (SCALE, ROLL, EVIDENCE) if self.senses.mesh is None else (SCALE, ROLL, EVIDENCE, NETWORK)

    def _result(self, state: FaceState, box: Rows, frame: Frame) -> TargetResult:
        """Rows of the points, as last seen in the stabilized image, of the box, and of points without windows."""
        similarity, rows = self._map(state.head.estimated.state, state.pose), state.points.columns
        estimated, status, k = state.features.estimated, rows["status"], len(self.features.parts)
        confidence = rows.get("confidence", np.full(k, np.nan))
        visible = np.where(np.isnan(confidence), 1.0, confidence)
        places = [(estimated.state, estimated.cov, visible, status == "lost")]
        for names, one in self._without_windows(state):
            if one is None:
                nothing = np.full((len(names), 2, 2), np.nan)
                places.append((nothing[:, 0], nothing, nothing[:, 0, 0], np.ones(len(names), np.bool_)))
            else:
                places.append((one.at, one.cov, one.visible, one.visible < self.settings.lost_below))
        points = self._rows(state, similarity, *map(np.concatenate, zip(*places, strict=True)))
        nan = np.full(len(points["x"]) - k, np.nan)
        points |= {name: np.append(values, nan) for name, values in (
            ("w", rows["w"] * similarity.scale), ("h", rows["h"] * similarity.scale), ("ess", rows["ess"]),
        )}  # fmt: skip
        if not state.frames:
            begun = (points["status"][:k] != "lost") & (status == "init")
            points["status"][:k][begun], points["confidence"][:k] = "init", confidence
        if (gone := status == "absent").any():
            for name, values in points.items():
                values[:k][gone] = "absent" if name == "status" else np.nan
        face = {name: box.columns[name] for name in points} | self._face(box.columns, similarity)
        columns = {}
        for name, of_box in face.items():
            others = points[name] if name in points else np.full((k + len(nan), *of_box.shape[1:]), np.nan)
            columns[name] = np.concatenate([others[:k], of_box, others[k:]])
        # of a target one number: both filters' together
        columns["particles"] = np.full(len(self.parts), float(rows["particles"].max() + box.columns["particles"][0]))
        values = {SCALE.name: similarity.scale * FACE / self.side, ROLL.name: math.degrees(state.pose[0])}
        # both likelihoods are ratios, which are 1 where the head is lost and nothing is compared
        values[EVIDENCE.name] = sum(one.evidence for one in (box, state.points) if one.frame == frame.index)
        values[NETWORK.name] = float(state.sensors[2].right.mean())
        found = {self.name: Diagnostics.of(self.diagnostics, [frame.index], [values])}
        faces = of_frame(self._names, frame, found, **columns)
        unseen = faces.unseen
        if self.calibration is not None:
            faces = self.calibration.applied(faces, self.features.size * self.side / FACE)
        cloud = similarity.to_frame(state.features.particles.x)
        return TargetResult(faces, cloud, (), box.notes, lambda: self.beliefs(state, unseen))

    def _rows(
        self, state: FaceState, similarity: Similarity, at: Array, cov: Array, visible: Array, unseen: Mask
    ) -> dict[str, Any]:
        """Columns of points of the stabilized image: places (K, 2), covariances (K, 2, 2), visibility, seen or not.

        The confidence of points without windows is that of the place alone, and where they are not seen they are
        hidden. Points at nan are lost.
        """
        shown = state.facing.shown * sure_of(state.head)
        known, windows = visible * shown, np.arange(len(at)) < len(self.features.parts)
        cov = similarity.matrix @ cov @ similarity.matrix.T
        cov = cov + (1 - known)[:, None, None] * state.head.estimated.cov[0]  # of what is hidden, the head alone says
        var = cov.reshape(-1, 4)[:, ::3]
        near = 1 - np.exp(-((OFF * EYES * similarity.scale) ** 2) / np.maximum(var.sum(axis=1), 1e-9))
        x, y = similarity.to_frame(at).T
        std_x, std_y = np.sqrt(var).T
        status = np.where(unseen, np.where(windows, "lost", "hidden"), "tracked")
        status[~(shown * near >= self.settings.lost_below)] = "lost"
        return {
            "x": x, "y": y, "std_x": std_x, "std_y": std_y, "cov_xy": cov[:, 0, 1],
            "confidence": np.where(windows, known, shown) * near, "status": status,
        }  # fmt: skip

    def beliefs(self, state: FaceState, unseen: Mask) -> tuple[Belief, ...]:
        """What is known of the points in the stabilized image, of the head, and of points without windows.

        Which of them are `unseen` (K,) is in doubt.
        """
        found = [*self.features.beliefs(state.features), *self.head.beliefs(state.head)]
        if self.calibration is not None:
            found = list(map(self.calibration.believed, (self.features.parts, self.head.parts), found))
        for names, one in self._without_windows(state):
            nobody = MeshPoints.begin(np.full((len(names), 2), stabilized.MIDDLE))
            nobody = nobody._replace(visible=np.zeros(len(names)))
            found.append((one or nobody).belief())
        ends = np.cumsum([len(one.mean) for one in found])[:-1]
        each = zip(found, np.split(unseen, ends), strict=True)
        return tuple(one._replace(doubt=one.doubt | gone) for one, gone in each)

    def _without_windows(self, state: FaceState) -> list[tuple[tuple[str, ...], MeshPoints | None]]:
        """The names of points without windows, in the order of rows, and what is known of them."""
        each = (self.senses.eyes, state.eyes), (self.senses.others, state.others)
        return [(names, one) for names, one in each if names]

    def _slope(self, pair: list[int]) -> float:
        """Of the line between two parts when the face is upright."""
        return 0.0 if self.senses.searched else stabilized.slope(self.features.x0[pair])

    @cached_property
    def _pairs(self) -> list[list[int]]:
        """Parts left and right of each other, whose line turns with the face and not with an expression."""
        parts = self.features.parts
        pairs = [(part, part.replace("left", "right")) for part in parts if "left" in part]
        return [[parts.index(left), parts.index(right)] for left, right in pairs if right in parts]

    @cached_property
    def _names(self) -> tuple[tuple[str, str], ...]:
        return tuple((self.name, part) for part in self.parts)

    def _face(self, row: Mapping[str, Any], face: Similarity) -> dict[str, Array]:
        """Columns of the head's box: it is where the face is in it, as large as that, and turned by its roll."""
        roll, grown = math.remainder(face.angle, math.tau), face.scale * FACE / np.sqrt(row["w"] * row["h"])
        found = {name: row.get(name, np.nan) * grown for name in ("w", "h", "std_w", "std_h")}
        found |= {"x": face.centre[:1], "y": face.centre[1:], "angle": np.array([math.degrees(roll)])}
        way = np.array([[math.cos(roll), -math.sin(roll), math.sin(roll), math.cos(roll)]])
        # the border runs through the middle of the outermost pixels
        size = np.stack([found["w"] - 1, found["h"] - 1], axis=1)
        return {**found, "corners": corners(way, face.centre[None], size)}
