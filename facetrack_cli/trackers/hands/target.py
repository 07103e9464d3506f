"""A hand of a person whose head is followed: its rows are those of one hand of the joint posterior (`joint.py`).

The first hand's target steps the posterior, and the other takes it over by its footprint, so that both are one state.
Once a hand is corrected by hand, each has its own: that of the corrected one begins there.

Confidence is the probability that the hand is where the row says, as MediaPipe Hands sees it: that of the particles
times a logistic regression on the speed, since a fast hand is blurred. That the hand is in the picture at all is
another number, `present`, blurred or not: a logistic regression on the particles that see it, the skin there, and
whether an arm may lead out of the picture (`tools/hands_present.py`). Both were fitted on clips of ten signs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import BOX, Array, Box, Frame, TargetStart
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Belief, Linear, Names
from facetrack_cli.trackers.hands import evidence, joint
from facetrack_cli.trackers.hands.evidence import Scene
from facetrack_cli.trackers.hands.settings import HandsSettings
from facetrack_cli.trajectory.diagnostics import NAMED, PRESENT, Diagnostics
from facetrack_cli.trajectory.trajectory import TargetResult, of_frame

CONFIDENCE: Final = (2.5, -8.9)  # of the regression: constant, by sizes of the face a frame
IN_PICTURE: Final = np.array([-3.6, 2.7, 7.2, 8.6])  # of the regression, by `cues`
HANGS, LOW = 4.0, 0.6  # sizes of the face below its middle where hands hang, and above the lower border of the picture
HOLDS: Final = 1.0  # s for which hands are followed while the head is lost
FORGETS: Final = 0.9  # share of p that is left after each later frame
GONE: Final = 1.0  # s after which a hand that is not seen counts as absent, and not as lost
BORDER: Final = 0.6  # sizes of the face, nearer than which to the border a hand that vanishes has left the picture


class HandState(NamedTuple):
    """The posterior of both hands after a frame. `began` is the frame in which it began, `now` this frame.

    `last` (2,) are the times when each hand was seen last, -inf if never; `inside` (2,), whether that was within the
    picture; `shown`, when the head was. `speed` (2,) is in sizes of the face a frame, `size` (2, 2) width and height of
    each hand in pixels, `present` (2,) the probability that it is in the picture. `named` (2,) are the probability that
    the hands have their own names, at least 0.5, and that these are others than in the frame before.
    """

    scene: Scene
    cloud: joint.Cloud
    belief: joint.Belief
    face: Footprint
    began: int
    now: int
    speed: Array
    size: Array
    present: Array
    last: Array
    inside: Array
    shown: float
    named: tuple[float, float]


@dataclass(frozen=True)
class HandTarget:
    """Hand 0 or 1 of a `person`, whose head begins in a box `head`; `start_boxes` are those of both hands."""

    name: str
    person: str
    hand: int
    settings: HandsSettings
    head: Box
    start_boxes: tuple[Box | None, Box | None]

    @property
    def parts(self) -> tuple[str, ...]:
        return (BOX,)

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        box = self.start_boxes[self.hand]
        return {} if box is None else {BOX: box[2:]}

    def begin(self, rng: Generator, frame: Frame) -> tuple[HandState, TargetResult]:
        face = Footprint(np.array(centre(self.head)), np.array(self.head[2:]) / 2)
        scene, seen = evidence.begin(frame, face, tuple(box for box in self.start_boxes if box is not None))
        state = self._initial(rng, frame, scene, face, self.start_boxes)
        if None in self.start_boxes:
            state = self._step(rng, state, frame, seen, first=True)
        return state, self._result(state, frame, placed=self.start_boxes[self.hand] is not None)

    def restart(
        self, rng: Generator, frame: Frame, first: HandState, start: TargetStart, absent: Names = (), fresh: Names = ()
    ) -> tuple[HandState, TargetResult]:
        """As `ParticleTarget.restart`; where the other hand is, is not known."""
        boxes = (start.box, None) if self.hand == 0 else (None, start.box)
        state = self._initial(rng, frame, first.scene, first.face, boxes)
        return state, self._result(state, frame, placed=True)

    def _initial(
        self, rng: Generator, frame: Frame, scene: Scene, face: Footprint, boxes: tuple[Box | None, Box | None]
    ) -> HandState:
        known = np.array([box is not None for box in boxes])
        middle = np.array([(math.nan, math.nan) if box is None else centre(box) for box in boxes])
        cloud = joint.begin(rng, self.settings, _face(scene, face), _in_sizes(scene, middle))
        at = cloud.x[..., :2].mean(axis=0)
        cov = np.stack([np.cov(cloud.x[:, hand, :2].T) for hand in (0, 1)])
        belief = joint.Belief(known * 1.0, at, cov, known * 1.0, float(len(cloud.x)), np.zeros(2), np.zeros((2, 3)))
        size = np.array([(math.nan, math.nan) if box is None else box[2:] for box in boxes])
        last = np.where(known, frame.time_s, -math.inf)
        at_first = np.zeros(2), size, known * 1.0, last, known, frame.time_s, (1.0 if known.any() else 0.5, 0.5)
        return HandState(scene, cloud, belief, face, frame.index, frame.index, *at_first)

    def advance(
        self, rng: Generator, state: HandState, frame: Frame, footprints: Sequence[Footprint] = ()
    ) -> tuple[HandState, TargetResult]:
        for footprint in footprints:
            if footprint.target == self.person:
                # hands before the face hide it: it is where it was
                state = state._replace(face=state.face._replace(lost=True) if footprint.lost else footprint)
            shared = footprint.state
            if isinstance(shared, HandState) and shared.began == state.began and shared.now == frame.index:
                return shared, self._result(shared, frame)
        if not state.face.lost:
            state = state._replace(shown=frame.time_s)
        if frame.time_s - state.shown > HOLDS:
            belief, present = state.belief._replace(seen=FORGETS * state.belief.seen), FORGETS * state.present
            state = state._replace(belief=belief, present=present, now=frame.index, named=(state.named[0], 0.0))
            return state, self._result(state, frame)
        there, unit = state.belief.at[state.belief.seen >= 0.5], state.scene.side
        scene, seen = evidence.look(state.scene, frame, state.face, there * unit, 2 * self.settings.radius * unit)
        state = self._step(rng, state._replace(scene=scene), frame, seen)
        return state, self._result(state, frame)

    def _step(
        self, rng: Generator, state: HandState, frame: Frame, seen: evidence.Seen, *, first: bool = False
    ) -> HandState:
        scene, face, before = state.scene, _face(state.scene, state.face), state.belief
        cloud, belief = joint.step(rng, self.settings, state.cloud, seen, scene.side, face, first=first)
        named, changed = joint.named(self.settings, belief, face, state.named[0])
        last, inside = state.last, state.inside
        if named < 0.5:
            named, changed, last, inside = 1 - named, 1 - changed, last[::-1], inside[::-1]
            cloud, belief, before = cloud.exchanged(), belief.exchanged(), before.exchanged()
        present = in_picture(cues(belief, face, len(seen.evidence) / scene.side))
        there = present >= 0.5
        known = there & (before.seen >= 0.5)
        speed = np.where(known, np.hypot(*(belief.at - before.at).T) / face.size, 0.0)
        places = belief.at * scene.side
        size = scene.factor * belief.form[:, :2]
        height, width = seen.evidence.shape
        away = np.minimum(places, np.array([width, height]) - 1 - places).min(axis=1) / (scene.side * face.size)
        return state._replace(
            cloud=cloud, belief=belief, now=frame.index, speed=speed, size=size, present=present,
            last=np.where(there, frame.time_s, last), inside=np.where(there, away > BORDER, inside),
            named=(named, changed),
        )  # fmt: skip

    def footprint(self, state: HandState, *, ahead: bool) -> Footprint | None:
        at = _in_pixels(state.scene, state.belief.at[self.hand])
        return Footprint(at, np.where(np.isnan(size := state.size[self.hand]), 1.0, size) / 2, state)

    def _result(self, state: HandState, frame: Frame, *, placed: bool = False) -> TargetResult:
        i, belief, unit, named = self.hand, state.belief, state.scene.side * state.scene.factor, state.named
        present = 1.0 if placed else float(state.present[i])
        p, (constant, by_speed) = present * float(belief.near[i]), CONFIDENCE
        sure = 1.0 if placed else p / (1 + math.exp(-constant - by_speed * min(float(state.speed[i]), 1.0)))
        status = "init" if placed else "tracked" if sure >= self.settings.lost_below else "lost"
        if present < 0.5 and not (state.inside[i] and frame.time_s - state.last[i] < GONE):
            status = "absent"
        columns: dict[str, Any] = {"status": [status], "particles": [float(len(state.cloud.x))]}
        at, cov = _in_pixels(state.scene, belief.at[i : i + 1]), belief.cov[i : i + 1] * unit**2
        if status != "absent":
            [(x, y)], [((xx, xy), (_, yy))], (w, h) = at.tolist(), cov.tolist(), state.size[i].tolist()
            columns |= {"x": [x], "y": [y], "w": [w], "h": [h], "std_x": [math.sqrt(xx)], "std_y": [math.sqrt(yy)]}
            columns |= {"cov_xy": [xy], "ess": [belief.ess], "confidence": [sure]}
        told = {PRESENT.name: np.array([present]), NAMED.name: np.array([named[0]])}
        reported = {self.name: Diagnostics((PRESENT, NAMED), np.array([frame.index]), told)}
        rows = of_frame(((self.name, BOX),), frame, reported, **columns)
        cloud = _in_pixels(state.scene, state.cloud.x[state.cloud.seen[:, i], i : i + 1, :2])
        if status == "absent":
            return TargetResult(rows, cloud)

        def beliefs() -> tuple[Belief]:
            steps = unit**2 * np.dot(self.settings.shares, np.square(self.settings.steps)) * np.eye(2)[None]
            motion = Linear(np.eye(2)[None], np.zeros((1, 2)), steps)
            return (Belief(at, cov, motion, np.array([status == "lost"]), np.array(named)),)

        return TargetResult(rows, cloud, beliefs=beliefs)


def cues(belief: joint.Belief, face: joint.Face, height: float) -> Array:
    """(2, 4): of each hand what tells whether it is in the picture, which is `height` sizes high.

    A bare arm that reaches the lower border above where hands hang leads to a hand below, and is thinner than a hand.
    """
    y, seen = belief.at[:, 1], belief.seen
    low = np.clip(1 - (height - y) / face.size / LOW, 0.0, 1.2) * ((y - face.at[1]) / face.size - HANGS)
    return np.column_stack([np.ones(2), seen, seen * low, seen * belief.skin])


def in_picture(cues: Array) -> Array:
    """(2,): the probability that each hand is in the picture."""
    return np.asarray(1 / (1 + np.exp(-np.clip(cues @ IN_PICTURE, -30, 30))))


def _face(scene: Scene, face: Footprint) -> joint.Face:
    return joint.Face(_in_sizes(scene, face.centre), evidence.side_of(face) / scene.factor / scene.side)


def _in_sizes(scene: Scene, at: Array) -> Array:
    return evidence.to_map(at, scene.factor) / scene.side


def _in_pixels(scene: Scene, at: Array) -> Array:
    return np.asarray((at * scene.side + 0.5) * scene.factor - 0.5)
