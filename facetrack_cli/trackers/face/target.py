"""A face: a head that carries points, and the points tracked inside of it (ours).

The head is a box with a particle filter of its own. Its place and scale, and the roll of the face, are a similarity T_t
that maps a stabilized image of the face to the frame (`stabilized.py`). The points' filter sees that image, in which
the face hardly moves. What is left to track is expression, and what the head turns out of the plane. For a head at rest
T is constant, and that filter is the published one (Patras & Pantic, FG 2004). The shape prior is that of the
stabilized image, so it is registered by the head: translation, scale and roll.

In each frame sensors place the points in the stabilized image: a regression (`cascaded_regression.py`), and a network
if its file is there (`mesh.py`). Windows are exact and may be lost. Sensors are less exact and have no memory. The
points' filter joins all (`landmark_filters.py`, `motion.py`). Eyes (`eyes.py`) and further points of the network have
no windows, and no say in where the face is.

A detector of faces measures the face's box every so many frames. While the head is lost, the detector looks as often
for faces anywhere in the frame. The head's filter compares them with what the first frames showed; so does
`evidence.py`, and where it recognises the target, tracking begins again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from statistics import mean
from typing import Any, Final, cast

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.geometry import centre, square
from facetrack_cli.core.types import Array, Frame, Info, Mask, TargetStart
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Motion, Names
from facetrack_cli.engine.target import ParticleState
from facetrack_cli.trackers.face import evidence, stabilized
from facetrack_cli.trackers.face import landmark_filters as filters
from facetrack_cli.trackers.face.detectors import Detection
from facetrack_cli.trackers.face.evidence import AGAIN, KNOWN, STAYS, Sighting
from facetrack_cli.trackers.face.landmark_filters import Facing, LandmarkFilter
from facetrack_cli.trackers.face.landmark_kernels import BY_NETWORK, relay
from facetrack_cli.trackers.face.motion import MeasuredWalk, SensorReading, modes
from facetrack_cli.trackers.face.stabilized import FACE, Similarity, mapped, shrunk
from facetrack_cli.trackers.face.state import FaceParts, FaceState, FaceView, head_confidence, moved
from facetrack_cli.trackers.face.window_ncc import WindowNcc, doubted
from facetrack_cli.trackers.people.descriptor import Picture
from facetrack_cli.trajectory.trajectory import TargetResult
from facetrack_cli.video.shots import Passing

COMPANY: Final = 2  # searches that saw several faces, from which the clip has shown somebody else
LOOK: Final = (3, 15)  # frames between two looks of the head's filter while it is new, and later, where points are seen
NEW_FILTER: Final = 20  # looks after which the head's filter knows its peaks; sooner it may return on what is no face
SETTLED: Final = 0.95  # probability by the head's filter, below which it looks in every frame
EASY: Final = 8.0  # log odds that the points are seen where they are
DOUBT: Final = 8.0  # log odds, below which the detector looks at once
STEADY: Final = 4.0  # pixels of the stabilized image, which a face is at most from where it is expected, in between
_FORGETS: Final = 0.95  # share of the log odds that is left after a frame in which the head is lost
_FACES: Final = 4  # that are compared with the one that is lost
_POSE_VAR: Final = np.array([math.radians(1.5), 0.012, 0.004, 0.004]) ** 2  # of the pose in a frame
# standard deviations of size and offset by a detected box; of size where the detector sees the eyes; of roll by parts
_BY_BOX, _BY_EYES, _BY_PAIRS = (0.15, 0.1, 0.1), 0.06, math.radians(3)
_MAX_POSE: Final = (0.7, 0.3, 0.3)  # of size and offset; a face may lie, and a head may turn over


@dataclass(frozen=True, eq=False)
class FaceTarget(FaceParts):
    """A face that is followed from frame to frame."""

    pose: Array  # (4,), how the face lies in the head's box at the start; see `FaceState`
    alone: bool = True  # whether any face that is seen while the target is lost may be the target

    # --- the start -----------------------------------------------------------------------------------------------

    def begin(self, rng: Generator, frame: Frame) -> tuple[FaceState, TargetResult]:
        head, result = self.head.begin(rng, frame)
        image = self.map_to_frame(head.estimated.state, self.pose).read(frame)
        features, _ = self.features.begin(rng, image)
        state, detection = self._begun(frame, image, head, features, self.pose)
        # where the detector does not see the face, its first view is laid out otherwise than later ones
        if self.sensors.searched or detection is not None or self.sensors.detector is None:
            first = evidence.View(evidence.look_of(image), _picture(frame, state.last_seen), sure=True)
            state = state._replace(views=(first,))
        else:
            state = state._replace(facing=state.facing.undetected())
        return state, self.result(state, self.head.begun, frame, result.notes)

    def restart(
        self, rng: Generator, frame: Frame, first: FaceState, start: TargetStart, absent: Names = (), fresh: Names = ()
    ) -> tuple[FaceState, TargetResult]:
        """As `ParticleTarget.restart`; the head lies about the points as in the first frame."""
        placed = {part: np.array(at) for part, at in start.points.items() if part not in absent}
        at = np.array([placed[part] for part in self.features.parts if part in placed])
        rest, scale, roll = self.features.x0[np.isin(self.features.parts, list(placed))], self.side / FACE, 0.0
        if len(at) > 1:
            scale, roll = stabilized.growth(at, rest), stabilized.change_between(at, rest)[0]
        if start.box is not None and not start.points:
            scale = math.sqrt(start.box[2] * start.box[3]) / FACE
        shape = Similarity(np.zeros(2), scale, roll)
        middle = at.mean(axis=0) - (rest.mean(axis=0) - stabilized.MIDDLE) @ shape.matrix.T
        head, _ = self.head.restart(rng, frame, first.head, TargetStart(square(middle, FACE * scale)))
        pose = np.array([roll, 0.0, 0.0, 0.0])
        similarity = self.map_to_frame(head.estimated.state, pose)
        points = {part: tuple(similarity.to_stabilized(place).tolist()) for part, place in placed.items()}
        image = similarity.read(frame)
        features, _ = self.features.restart(rng, image, first.features, TargetStart(points=points), absent, fresh)
        state = self._begun(frame, image, head, features, pose)[0]._replace(views=first.views)
        return state, self.result(state, self.head.begun, frame)

    def _begun(
        self, frame: Frame, image: Frame, head: ParticleState, features: ParticleState, pose: Array
    ) -> tuple[FaceState, Detection | None]:
        """A state without views, and the face that the detector sees."""
        detection, similarity = self.sensors.detected(image), self.map_to_frame(head.estimated.state, pose)
        biases, others, eyes = self.sensors.begin(frame, similarity, image, detection, features.estimated.state)
        known = head, features, self.features.begun, biases, Facing(), pose, np.zeros(4), others, eyes
        return FaceState(*known, (), self._laid_out(similarity, detection), Passing((shrunk(frame),))), detection

    # --- a frame -------------------------------------------------------------------------------------------------

    def advance(
        self, rng: Generator, state: FaceState, frame: Frame, footprints: Sequence[Footprint] = ()
    ) -> tuple[FaceState, TargetResult]:
        """The next frame, which may be of another shot.

        Without a detector, or where other targets are tracked beside this one, cuts are not looked for. After what may
        be a cut the target is tracked on where it was, for half a second. If it is then not seen there, or does not
        look like the target, the cut was one, and the face is searched for anywhere until it is recognised. So it is
        when somebody else has come before it.
        """
        frames = state.frames + 1
        if not self.alone or self.sensors.detector is None:
            return self._step(rng, state._replace(frames=frames), frame, footprints)
        shots, event = state.shots.after(shrunk(frame))
        cut_time = {"": state.cut_time, "none": None}.get(event, frame.time_s)
        state = state._replace(frames=frames, shots=shots, cut_time=cut_time)
        stranger = state.stranger_time is not None
        if cut_time is None and not stranger:
            return self._step(rng, state, frame, footprints)
        just_cut = cut_time is not None and frame.time_s - cut_time <= STAYS
        if just_cut and not stranger:
            after, result = self._step(rng, state, frame, footprints)
            stays = after.cut_time is None or self._stays(after, frame)
            if stays is not False:
                return after._replace(cut_time=None if stays else after.cut_time), result
        once = stranger and state.sighting is not None and state.sighting.latest > KNOWN  # and asked for a second look
        if just_cut or event or once or self._is_due(state):
            state = self._searched(state, frame)
            if (sighting := state.sighting) is not None and sighting.is_target(frame, 2 if stranger else 1):
                return self._returned(rng, state, sighting, frame)
        head, info = self.head.unseen(rng, state.head, frame, anywhere=not just_cut)
        return self._unseen(state._replace(head=head), info, frame)

    def _step(
        self, rng: Generator, state: FaceState, frame: Frame, footprints: Sequence[Footprint]
    ) -> tuple[FaceState, TargetResult]:
        """The next frame of the same shot.

        1. While the head's filter is sure and the sensors see the points where the head is expected, the points carry
           the head, and its filter looks in every few frames alone.
        2. While the head is lost, the detector searches the frame every so often; tracking begins again where it sees
           the target.
        3. Else the head's filter follows the box. If it loses the head, the points keep their last rows.
        4. Else the points are followed in the stabilized image of the head.
        """
        shown = head_confidence(state.head) >= self.settings.lost_below
        due = self._is_due(state)
        if self.sensors.detector is not None:
            due |= shown and state.log_odds <= DOUBT
        view: FaceView | None = None
        settled = head_confidence(state.head) >= SETTLED and state.log_odds >= EASY
        if settled and state.frames % LOOK[state.head.learned.frames > NEW_FILTER]:
            expected = self.head.motion.expect(state.head.estimated.state[None])[0]
            view = self._view(state, expected, frame, due=due)
            if view.landmarks.parts.log_odds >= EASY and math.hypot(*view.shift) < STEADY:
                return self._followed(rng, state, view, frame, None)
        if due and not shown and self.alone:
            state = self._searched(state, frame)
            if (sighting := state.sighting) is not None and sighting.is_target(frame):
                return self._returned(rng, state, sighting, frame)
        # of this frame, where it shows less than expected: else the head's filter learns what took the face's place
        seen = state.log_odds if view is None else min(state.log_odds, view.landmarks.parts.log_odds)
        log_odds = 0.0 if state.sighting is not None else state.facing.log_odds(seen)
        informed = state.head._replace(learned=state.head.learned._replace(external_log_odds=log_odds))
        head, info = self.head.advanced(rng, informed, frame, footprints)
        if head_confidence(head) < self.settings.lost_below:
            return self._unseen(state._replace(head=head, facing=state.facing.predicted()), info, frame)
        state = state._replace(head=head, sighting=None)
        if view is None or not view.similarity.is_near(self.map_to_frame(head.estimated.state, state.pose), STEADY):
            view = self._view(state, head.estimated.state, frame, due=due)
        return self._followed(rng, state, view, frame, info)

    def _unseen(self, state: FaceState, info: Info, frame: Frame) -> tuple[FaceState, TargetResult]:
        """After a frame in which the head's filter, which says `info`, does not see it: the points stay."""
        state = state._replace(log_odds=_FORGETS * state.log_odds, info=state.info._replace(evidence=0.0), again=())
        return state, self.result(state, info, frame)

    def _is_due(self, state: FaceState) -> bool:
        """Whether it is the detector's turn to look."""
        detections = self.settings.detections
        return detections is not None and state.frames % detections.every == 0

    def _stays(self, state: FaceState, frame: Frame) -> bool | None:
        """Whether what is followed after a possible cut looks like the face of before; None: its head is hidden.

        A head that is blurred or covered is seen without its points. Where sensors contradict each other, with log
        odds of 0, there is a face.
        """
        if head_confidence(state.head) < (self.settings.lost_below if state.log_odds > 0 else SETTLED):
            return False
        if state.log_odds < 0:
            return None
        similarity = self.map_to_frame(state.head.estimated.state, state.pose)
        detection = self.sensors.detected(similarity.read(frame))
        # as the detector lays it out: the pose is of the face before the cut
        picture = _picture(frame, similarity if detection is None else detection.similarity.within(similarity))
        return evidence.is_likely(evidence.own_views(state.views), picture, self._prior(state, frame))

    def _prior(self, state: FaceState, frame: Frame) -> float:
        since, company = state.stranger_time, state.crowded >= COMPANY
        stranger_s = None if since is None else frame.time_s - since
        return evidence.prior(cut=state.cut_time is not None, company=company, stranger_s=stranger_s)

    def _looked_again(self, state: FaceState, view: FaceView, frame: Frame) -> FaceState:
        """With a look at the face that is seen in the target's place, which is recognised, or looked at again."""
        if state.again and frame.time_s - state.again_time < evidence.APART:
            return state
        face = self._laid_out(view.similarity, view.detection)
        if not state.views or not evidence.weight_of(face.scale * FACE):
            return state._replace(again=None)
        own, [place] = evidence.own_views(state.views), evidence.by_place(state.last_seen, [face], covered=False)
        if place <= 0 or evidence.likeness(own, evidence.look_of(view.image)) >= evidence.ALIKE:
            return state._replace(again=None)
        odds = evidence.by_who(own, _picture(frame, face))
        again = (*(state.again or ()), odds)
        if odds > KNOWN or (len(again) == evidence.LOOKS_AGAIN and mean(again[-2:]) + AGAIN > 0):
            return state._replace(again=None)
        return state._replace(again=again, again_time=frame.time_s)

    def _view(self, state: FaceState, head: Array, frame: Frame, *, due: bool) -> FaceView:
        """The frame seen from a head at `head` (1, D); the detector looks as well if that is `due`."""
        similarity = self.map_to_frame(head, state.pose)
        image = similarity.read(frame)
        detection = self.sensors.detected(image) if due else None
        before = state.features.estimated.state
        detected = self.sensors.places({} if detection is None else detection.points)
        around = [np.add.reduce(before) / len(before)]
        if detection is not None and (measured := np.isfinite(detected).all(axis=1)).any():
            around.append(around[0] + (detected - before)[measured].mean(axis=0))
        landmarks = self.sensors.read(frame, similarity, image, around)
        places = np.array([landmarks.parts.at, detected, landmarks.network])
        visible = state.features.learned.visible
        readings, at, shift, apart = state.bias_filters.reading(places, visible, before)
        log_odds = 0.0 if apart else landmarks.parts.log_odds
        return FaceView(similarity, image, due, detection, landmarks, places, readings, at, shift, log_odds)

    def _followed(
        self, rng: Generator, state: FaceState, view: FaceView, frame: Frame, head_info: Info | None, notes: Names = ()
    ) -> tuple[FaceState, TargetResult]:
        """The points followed in a view of the frame, then what sensors, pose and landmarks learn from it.

        `head_info` is of the head's filter; None: it has not looked, and the points carry the head.
        """
        recognised = view.detection is not None and view.log_odds >= EASY and state.cut_time is None
        if recognised and state.again is not None and self.alone:
            state = self._looked_again(state, view, frame)
            if state.again is not None and mean(state.again[-2:]) + AGAIN < 0:
                head, head_info = self.head.unseen(rng, state.head, frame, anywhere=False)
                return self._unseen(state._replace(head=head, stranger_time=frame.time_s), head_info, frame)
        features, info = self._tracked(rng, state.features, view)
        at, cov, visible = features.estimated.state, features.estimated.cov, features.learned.visible
        judge = partial(self._judged, state.features.learned, view, at)
        biases, odds = state.bias_filters.updated(view.places, view.readings, at, cov, visible, judge)
        features = features._replace(learned=doubted(features.learned, odds))
        facing = state.facing if self.sensors.detector is None else state.facing.predicted()
        others, mesh, eyes = state.others, view.landmarks.others, state.eyes
        if mesh is None:
            others = others and others.after(None, filters.NO_FACE)
        elif others is None:
            others = LandmarkFilter.begin(mesh.at)
        else:
            others = others.after(mesh.at, biases.landmark_odds(mesh, view.places[BY_NETWORK]))
        if eyes is not None and view.landmarks.eyes is not None:
            eyes = eyes.after(*view.landmarks.eyes)
        head = state.head
        if head_info is None:
            # by all of what the points have moved, or it falls behind until the head's filter looks again
            step = filters.in_common(at - state.features.estimated.state, visible > 0.5)
            head, head_info = self.head.carried(rng, head, view.similarity.matrix @ step)
        state = state._replace(
            head=head, features=features, info=info, bias_filters=biases, facing=facing, others=others,
            eyes=eyes, log_odds=view.log_odds, again=() if view.log_odds <= 0 else state.again,
        )  # fmt: skip
        if recognised and not (state.again and self.alone):
            state = state._replace(last_seen=self._laid_out(view.similarity, view.detection))
            if evidence.likeness(state.views, look := evidence.look_of(view.image)) < evidence.NEW:
                seen = evidence.View(look, _picture(frame, state.last_seen), sure=not state.views)
                state = state._replace(views=evidence.kept(state.views, seen))
        state = self._restabilized(self._posed(state, view), view.similarity)
        return state, self.result(state, head_info, frame, tuple(notes))

    def _tracked(self, rng: Generator, features: ParticleState, view: FaceView) -> tuple[ParticleState, Info]:
        """The points' filter a frame later, in the stabilized image of the view.

        All points first move by the view's shift, then follow the sensors' readings.
        """
        walk, windows = self.features.motion, cast(WindowNcc, self.features.likelihood)
        before, sure = features.estimated.state + view.shift, (view.readings.sure > 0.5)[..., None]
        far = np.abs(view.readings.z - walk.expect(before[None])[0]).max(initial=0.0, where=sure)
        within = float(far + 3 * math.sqrt(np.diagonal(features.estimated.cov, 0, 1, 2).max()))
        learned = features.learned._replace(sensor_odds=view.landmarks.parts.odds, within=within)
        features = moved(features, partial(mapped, turned=1, shift=complex(*view.shift)), learned=learned)

        def measured(learned: Any) -> Motion:
            return MeasuredWalk(**vars(walk), measured=view.readings, windows=windows.scored(learned))

        return self.features.advanced(rng, features, view.image, (), measured)

    def _judged(self, learned: Any, view: FaceView, at: Array, readings: SensorReading, differ: Mask) -> Array:
        """As a `filters.Judge`, by the windows `learned` before this frame, of parts at `at` (K, 2)."""
        odds, index = np.full(readings.sure.shape, np.nan), readings.sure.any(axis=1)
        judged = readings._replace(z=readings.z[index], var=readings.var[index], sure=readings.sure[index])
        windows, places = self.features.likelihood, modes(judged)[0]
        by_windows = windows.score(windows.look(learned, view.image, at), view.image, places, at)
        by_regression = self.sensors.log_odds_at(view.landmarks.channels, places)
        odds[index] = np.where(differ, filters.who_is_right(judged, by_windows, by_regression), np.nan)
        return odds

    def _posed(self, state: FaceState, view: FaceView) -> FaceState:
        """With the pose by the detected box, and by the line of parts left and right, or else of the eyes."""
        pose, var, places = state.pose.tolist(), (state.pose_var + _POSE_VAR).tolist(), view.fused.tolist()
        lines = ((stabilized.slope((places[left], places[right])), at) for (left, right), at in self._pairs)
        turns = [slope - at for slope, at in lines if math.isfinite(slope)]
        # a box drawn by hand may differ from the detector's box
        detection = view.detection if self.sensors.searched else None
        if view.log_odds <= 0:  # the points are not seen
            eyes = None if detection is None else detection.eyes
            turns = [] if eyes is None else [stabilized.slope(eyes)]
        if turns:
            pose[0], var[0] = _updated(pose[0], var[0], sum(turns) / len(turns), _BY_PAIRS)
        facing = state.facing.updated(detected=view.detection is not None) if view.checked else state.facing
        if detection is not None:
            box = detection.box
            # how the detected face lies in the head's box, along the axes of the frame
            lies = Similarity(np.zeros(2), math.exp(pose[1]) / FACE, pose[0]).to_frame(np.array(centre(box)))
            size = _BY_BOX[0] if detection.eyes is None else _BY_EYES
            offsets = (math.log(box[2] / FACE), *lies.tolist())
            for i, (offset, std, most) in enumerate(zip(offsets, (size, *_BY_BOX[1:]), _MAX_POSE, strict=True), 1):
                pose[i], var[i] = _updated(pose[i], var[i], offset, std, most)
        return state._replace(pose=np.array(pose), pose_var=np.array(var), facing=facing)

    def _restabilized(self, state: FaceState, old: Similarity) -> FaceState:
        """With the points, which are in the stabilized image of the `old` map, in that of the state's own."""
        turned, shift = old.into(self.map_to_frame(state.head.estimated.state, state.pose))
        features, biases, estimated = state.features, state.bias_filters, state.features.estimated
        before = features.particles.x, estimated.state, biases.bias
        x, at, bias = (np.empty_like(values) for values in before)
        relay((turned.real, turned.imag, shift.real, shift.imag), *before, x, at, bias)
        particles, estimated = features.particles._replace(x=x), estimated._replace(state=at)
        others, eyes = (landmarks and landmarks.mapped(turned, shift) for landmarks in (state.others, state.eyes))
        features = features._replace(particles=particles, estimated=estimated)
        return state._replace(features=features, bias_filters=biases._replace(bias=bias), others=others, eyes=eyes)

    def _laid_out(self, similarity: Similarity, detection: Detection | None) -> Similarity:
        """The map of a face as the detector lays it out, so that views of any start look alike.

        Where a search began the track, the pose follows the detector already.
        """
        if detection is None or self.sensors.searched:
            return similarity
        return detection.similarity.within(similarity)

    @cached_property
    def _pairs(self) -> list[tuple[tuple[int, int], float]]:
        """Parts left and right of each other, whose line turns with the face and not with an expression.

        With the slope of each line when the face is upright.
        """
        parts, x0, level = self.features.parts, self.features.x0, self.sensors.searched
        names = [(part, part.replace("left", "right")) for part in parts if "left" in part]
        pairs = [(parts.index(left), parts.index(right)) for left, right in names if right in parts]
        return [(pair, 0.0 if level else stabilized.slope(x0[list(pair)])) for pair in pairs]

    # --- a face that is lost -------------------------------------------------------------------------------------

    def _searched(self, state: FaceState, frame: Frame) -> FaceState:
        """With the places where the detector sees faces in the frame, and the likeliest of them as the sighting."""
        faces = self.sensors.faces(frame, self.map_to_frame(state.head.estimated.state, state.pose))[:_FACES]
        places = tuple(
            np.array([*(np.array(centre(box)) - box[2] * state.pose[2:]), math.log(box[2] / self.side)])
            for box, *_ in faces
        )
        state, sighting = state._replace(crowded=state.crowded + (len(faces) > 1)), None
        if faces:
            maps = [face.similarity for face in faces]
            own, pictures = evidence.own_views(state.views), [_picture(frame, face) for face in maps]
            sightings = evidence.sighted(faces, pictures, own, state.sighting, frame)
            in_place = state.cut_time is None and state.stranger_time is None
            place = evidence.by_place(state.last_seen, maps, covered=self._is_covered(state.head)) * in_place
            mean_looks = np.array([sighting.by_looks for sighting in sightings])
            p = evidence.probabilities(mean_looks, place, self._prior(state, frame))
            best = int(p.argmax())
            sighting = sightings[best]._replace(p=float(p[best])) if p[best] > evidence.MAYBE else None
        facing = state.facing.updated(detected=False) if sighting is None else state.facing
        head = state.head._replace(learned=state.head.learned._replace(sighted=places))
        return state._replace(head=head, sighting=sighting, facing=facing)

    def _is_covered(self, head: ParticleState) -> bool:
        """Whether a head that is not seen is held to be where it was."""
        middle, half = head.estimated.state[0, :2], 0.5 * self.head.space.windows(head.estimated)[0]
        near = (np.abs(head.particles.x[:, 0, :2] - middle) < half).all(axis=1)
        return float(np.exp(head.particles.log_w) @ near) >= 0.5

    def _returned(
        self, rng: Generator, state: FaceState, sighting: Sighting, frame: Frame
    ) -> tuple[FaceState, TargetResult]:
        """The face, followed again from where it was sighted, with the points at rest."""
        side = sighting.face.box[2] * math.exp(-state.pose[1])
        middle = np.array(centre(sighting.face.box)) - side * state.pose[2:]
        head, _ = self.head.restart(rng, frame, state.head, TargetStart(square(middle, side)))
        doubt = f"(probability {1 - sighting.p:.2f})"
        note = f"from frame {frame.index} on the face may be another one than before {doubt}"
        pose, rest = np.array([sighting.face.roll, *state.pose[1:]]), self.features.x0
        features = moved(state.features, lambda x: x + (rest - state.features.estimated.state))
        state = state._replace(head=head, features=features, pose=pose, facing=Facing())
        state = state._replace(sighting=None, cut_time=None, again=None, stranger_time=None)
        view = self._view(state, head.estimated.state, frame, due=True)
        return self._followed(rng, state, view, frame, self.head.begun, [note] if sighting.p < evidence.SURE else ())


def _picture(frame: Frame, face: Similarity) -> Picture:
    return Picture.of(frame, face._replace(scale=face.scale * FACE))


def _updated(value: float, var: float, offset: float, std: float, most: float = math.inf) -> tuple[float, float]:
    """A value of a pose and its variance after a measurement `offset` from it, of standard deviation `std`."""
    gain = var / (var + std**2)
    return min(max(value + gain * offset, -most), most), (1 - gain) * var
