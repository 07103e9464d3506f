"""Two hands of a person whose head is followed, in one posterior, by a particle filter on skin (ours); and their rows.

A particle is both hands: place, velocity, and whether each is seen. Given the evidence e (`evidence.py`), A(x) is the
mean of e in a disc about x, and a hand that is seen has

    log p(y | x) = evidence * (A(x) - skin)

one that is not seen has 0. Skin counts once: discs that overlap share it, and two places of one bare arm, with skin all
along the line between them, are one hand (Gonzalez & Collet's mutual exclusion, section 3, for a joint state). Near to
each other they may be two hands that touch, if they have been seen apart. A hand that is seen moves by a velocity, with
steps of three normal densities, and does not leap along its arm, to the elbow; it is within the reach of an arm. One
that is not seen drifts to where an arm hangs.

Particles are proposed by the motion, and where there is most skin; their weights are p(y | x) p(x | x') / q(x).

Which hand is which is a hidden Markov model of two states, named as they are or exchanged. A hand at (u, v) from the
face's middle, in its sizes, whose skin has a long axis of angle a and of length l, 0 for a disc and 1 for a line, is
the left one of the picture by

    log p(left) - log p(right) = 0.4 u - 1.3 u v - 7.0 l sin 2a

A hand is the end of a forearm, which leans to where it comes from; and a hand is on its own side, but not beside the
face. The weights are a logistic regression on ten real clips of signs and nine rendered ones, and are the same to 0.05
(0.3 of the last one) without any of the real clips. Frames are not independent: their log odds count for `TEMPER`.
Names may be exchanged where hands meet: p(exchanged | before) = ANY + MEET * overlap.

The first hand's target steps the posterior, and the other takes it over by its footprint, so that both are one state.
Once a hand is corrected by hand, each has its own: that of the corrected one begins there.

Confidence is the probability that the hand is where the row says, as MediaPipe Hands sees it: that of the particles
times a logistic regression on the speed, since a fast hand is blurred. That the hand is in the picture at all is
another number, `present`, blurred or not: a logistic regression on the particles that see it, the skin there, and
whether an arm may lead out of the picture (`tools/hands_present.py`). Both were fitted on clips of ten signs.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final, NamedTuple

import cv2
import numpy as np
from numpy.random import Generator

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import BOX, Array, Box, Frame, Mask, TargetStart
from facetrack_cli.engine import protocols
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Names
from facetrack_cli.engine.resampling import normalise, systematic
from facetrack_cli.trackers.hands import evidence
from facetrack_cli.trackers.hands.evidence import Map, Scene, Seen
from facetrack_cli.trackers.hands.hand_kernels import REST, fit_skin, gather, move, weigh
from facetrack_cli.trackers.hands.settings import HandsSettings
from facetrack_cli.trajectory.diagnostics import NAMED, PRESENT, Diagnostics
from facetrack_cli.trajectory.trajectory import TargetResult, of_frame

START: Final = 0.075  # sizes, standard deviation of a hand that is given
LARGE: Final = 5.0  # pixels, radius of a disc for which OpenCV takes a Fourier transform, ten times as long
PEAKS: Final = 8  # places of most skin, at most
LEAST: Final = -1.5  # of log p(y | x) at such a place
_TINY: Final = 1e-12

SIGNS: Final = (1.0, -1.0)  # of each hand, of the way to the other hand's side
WEIGHTS: Final = (0.4, -1.3, -7.0)  # of u, u v, and l sin 2a
TEMPER: Final = 0.4
ANY, MEET, MEETS = 0.002, 0.2, 0.8  # probabilities, and the sizes between two hands from which on they overlap
APART: Final = (1.2, 2.2)  # radii between two hands, at which each begins to tell its name, and does

CONFIDENCE: Final = (2.5, -8.9)  # of the regression: constant, by sizes of the face a frame
IN_PICTURE: Final = (-3.6, 2.7, 7.2, 8.6)  # of the regression, by `cues`
HANGS, LOW = 4.0, 0.6  # sizes of the face below its middle where hands hang, and above the lower border of the picture
HOLDS: Final = 1.0  # s for which hands are followed while the head is lost
FORGETS: Final = 0.9  # share of p that is left after each later frame
GONE: Final = 1.0  # s after which a hand that is not seen counts as absent, and not as lost
BORDER: Final = 0.6  # sizes of the face, nearer than which to the border a hand that vanishes has left the picture


class Cloud(NamedTuple):
    """Equally weighted particles."""

    x: Array  # (N, 2, 4), places and velocities in sizes of the face's box, from the corner of the frame
    seen: Mask  # (N, 2)
    parted: Mask  # (N,), whether two hands that are seen have been apart since

    def exchanged(self) -> Cloud:
        return Cloud(self.x[:, ::-1], self.seen[:, ::-1], self.parted)


class Belief(NamedTuple):
    """What the particles say of each hand."""

    seen: Array  # (2,), p that it is seen
    at: Array  # (2, 2), its place, in sizes
    cov: Array  # (2, 2, 2), of the particles about it
    near: Array  # (2,), the share of those that see it which are there
    ess: float  # of the filter's step
    skin: Array  # (2,), the share of skin in a hand there
    form: Array  # (2, 3), of that skin width, height, twice the radius each of a disc, and l sin 2a

    def exchanged(self) -> Belief:
        return Belief._make(value if isinstance(value, float) else value[::-1] for value in self)


class Face(NamedTuple):
    """The face's middle `at` (2,) in sizes of the first frame, and its size, 1 in the first frame."""

    at: Array
    size: float


def begin(rng: Generator, settings: HandsSettings, face: Face, given: Array) -> Cloud:
    """Hands that nobody sees, where they hang; or where they are `given` (2, 2), if that is not nan."""
    known = np.isfinite(given[:, :1])
    x = np.zeros((settings.particles, 2, 4))
    x[..., :2] = np.where(known, given, face.at + face.size * REST)
    x[..., :2] += np.where(known, START, 0.0) * rng.standard_normal(x[..., :2].shape)
    return Cloud(x, np.repeat(known.T, settings.particles, axis=0), np.repeat(known.all(), settings.particles))


def step(
    rng: Generator, settings: HandsSettings, cloud: Cloud, look: Seen, scale: float, face: Face, *, first: bool = False
) -> tuple[Cloud, Belief]:
    """One frame, of which is the `look`, in pixels of which `scale` are a size. No hand appears before the face."""
    n, evidence, radius = len(cloud.x), look.evidence, settings.radius * face.size * scale
    share = disc_means(evidence, radius)
    fit, peaks, often = fitted(settings, share, scale, face)
    luck, noise = rng.random((2, 4, n)), rng.standard_normal((2, n, 2))
    x, seen, parted, weight = cloud.x.copy(), cloud.seen.copy(), cloud.parted.copy(), np.empty(n)
    chances = np.array([0.5 if first else settings.appears, settings.vanishes, settings.proposed])
    motion = np.array(settings.steps), np.array(settings.shares), chances, settings.evidence
    seen_in = evidence, look.face, face.at, face.size, scale
    move(x, seen, parted, luck, noise, peaks, often, *motion, *seen_in, weight)
    of = settings.radius, settings.evidence, settings.skin
    weigh(x, seen, parted, fit, share, evidence, face.at, face.size, scale, *of, weight)
    w = np.exp(log_w := normalise(weight))
    (p, near, skin), at, cov, form = np.empty((3, 2)), np.empty((2, 2)), np.empty((2, 2, 2)), np.empty((2, 3))
    gather(x, seen, w, share, scale, evidence, radius, p, at, cov, near, skin, form)
    kept, (dx, dy) = systematic(rng, log_w, n), (at[0] - at[1]).tolist()
    x, seen = x.take(kept, axis=0), seen.take(kept, axis=0)
    # all have the order of the belief's places: which hand is which is not theirs to say
    off = x[:, 0] - x[:, 1]
    other = seen[:, 0] & seen[:, 1] & (off[:, 0] * dx + off[:, 1] * dy < 0)
    x = np.where(other[:, None, None], x[:, ::-1], x)
    return Cloud(x, seen, parted.take(kept)), Belief(p, at, cov, near, 1 / float(np.add.reduce(w * w)), skin, form)


def disc_means(evidence: Map, radius: float) -> Map:
    """Means of the evidence in a disc about each pixel, within the frame; a third of the disc must be there.

    Those of a large disc are read off the evidence at half its size. The radius is rounded to an eighth of a pixel, so
    that most frames have the disc of the one before.
    """
    disc, per, by = _disc(round(8 * radius) / 8, evidence.shape)
    return np.asarray(per * _summed(evidence, disc, by), np.float32)


def _summed(evidence: Map, disc: Map, by: int) -> Map:
    size = evidence.shape[1], evidence.shape[0]
    less = -(-size[0] // by), -(-size[1] // by)
    small = evidence if by == 1 else cv2.resize(evidence, less, interpolation=cv2.INTER_AREA)
    sums = cv2.filter2D(small, -1, disc, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums if by == 1 else cv2.resize(sums, size), np.float32)


@lru_cache(8)
def _disc(radius: float, shape: tuple[int, int]) -> tuple[Map, Map, int]:
    """A disc, of each pixel the factor for what is cut off there, and by how much the evidence is reduced before."""
    by = 2 if radius >= LARGE else 1
    n = math.ceil(radius / by + 0.5)
    off = np.arange(-n, n + 1.0)
    disc = np.clip(radius / by + 0.5 - np.hypot(off[:, None], off), 0, 1).astype(np.float32)
    disc /= disc.sum()
    inside = _summed(np.ones(shape, np.float32), disc, by)
    return np.asarray(disc, np.float32), np.asarray(1 / np.maximum(inside, 0.35), np.float32), by


def fitted(settings: HandsSettings, share: Map, scale: float, face: Face) -> tuple[Map, Array, Array]:
    """log p(y | x) of a hand at each pixel (H, W), the places (P, 2) of most skin in pixels, and how often each is
    proposed (P,).
    """
    fit, at, heights = np.empty_like(share), np.empty((PEAKS, 2)), np.empty(PEAKS)
    count = fit_skin(share, settings.evidence, settings.skin, face.at, face.size, scale, LEAST, fit, at, heights)
    weight = np.exp(0.5 * (heights[:count] - heights[:1]))
    return fit, at[:count], weight / max(weight.sum(), _TINY)


def names_after(settings: HandsSettings, belief: Belief, face: Face, before: float) -> tuple[float, float]:
    """The probability that hands are named as they are, and that the filter has exchanged them since the frame before.

    `before` is the first of these after the frame before.
    """
    seen, places, (x, y) = belief.seen.tolist(), belief.at.tolist(), face.at.tolist()
    apart = math.dist(*places) / face.size
    exchanged = ANY + MEET * min(max(2 * (1 - apart / MEETS), 0.0), 1.0)
    clear = (apart / settings.radius - APART[0]) / (APART[1] - APART[0]) if min(seen) >= 0.5 else 1.0
    total = 0.0
    for p, place, (_, _, lean), sign in zip(seen, places, belief.form.tolist(), SIGNS, strict=True):
        u, v = (place[0] - x) / face.size, (place[1] - y) / face.size
        if p >= 0.5:
            total += sign * (WEIGHTS[0] * u + WEIGHTS[1] * u * v + WEIGHTS[2] * lean)
    p = before * (1 - exchanged) + (1 - before) * exchanged
    return p / (p + (1 - p) * math.exp(-TEMPER * min(max(clear, 0.0), 1.0) * total)), exchanged


# --- the rows of a hand -----------------------------------------------------------------------------------------------


class HandState(NamedTuple):
    """The posterior of both hands after a frame."""

    scene: Scene
    cloud: Cloud
    belief: Belief
    face: Footprint
    began: int  # the frame in which it began
    now: int  # this frame
    speed: list[float]  # of each hand, in sizes of the face a frame
    size: Array  # (2, 2), width and height of each hand in pixels
    present: list[float]  # the probability that it is in the picture
    last: list[float]  # when each hand was seen last, -inf if never
    inside: list[bool]  # whether that was within the picture
    shown: float  # when the head was seen last
    # probabilities that the hands have their own names, at least 0.5, and that these are others than a frame before
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
    parts: ClassVar = (BOX,)

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
        cloud = begin(rng, self.settings, _face(scene, face), _in_sizes(scene, middle))
        at = cloud.x[..., :2].mean(axis=0)
        cov = np.stack([np.cov(cloud.x[:, hand, :2].T) for hand in (0, 1)])
        belief = Belief(known * 1.0, at, cov, known * 1.0, float(len(cloud.x)), np.zeros(2), np.zeros((2, 3)))
        size = np.array([(math.nan, math.nan) if box is None else box[2:] for box in boxes])
        there = known.tolist()
        last, named = [frame.time_s if each else -math.inf for each in there], (1.0 if any(there) else 0.5, 0.5)
        at_first = [0.0, 0.0], size, [float(each) for each in there], last, there, frame.time_s, named
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
            belief = state.belief._replace(seen=FORGETS * state.belief.seen)
            present = [FORGETS * p for p in state.present]
            state = state._replace(belief=belief, present=present, now=frame.index, named=(state.named[0], 0.0))
            return state, self._result(state, frame)
        there, unit = state.belief.at[state.belief.seen >= 0.5], state.scene.side
        scene, seen = evidence.look(state.scene, frame, state.face, there * unit, 2 * self.settings.radius * unit)
        state = self._step(rng, state._replace(scene=scene), frame, seen)
        return state, self._result(state, frame)

    def _step(self, rng: Generator, state: HandState, frame: Frame, seen: Seen, *, first: bool = False) -> HandState:
        scene, face, before = state.scene, _face(state.scene, state.face), state.belief
        cloud, belief = step(rng, self.settings, state.cloud, seen, scene.side, face, first=first)
        named, changed = names_after(self.settings, belief, face, state.named[0])
        last, inside = state.last, state.inside
        if named < 0.5:
            named, changed, last, inside = 1 - named, 1 - changed, last[::-1], inside[::-1]
            cloud, belief, before = cloud.exchanged(), belief.exchanged(), before.exchanged()
        present = in_picture(cues(belief, face, len(seen.evidence) / scene.side))
        speed, last, inside, unit = [0.0, 0.0], list(last), list(inside), scene.side
        lower, right = (side - 1 for side in seen.evidence.shape)
        each = zip(present, belief.at.tolist(), before.at.tolist(), before.seen.tolist(), strict=True)
        for i, (p, at, was, p_before) in enumerate(each):
            if p >= 0.5:
                x, y = at[0] * unit, at[1] * unit
                speed[i] = math.dist(at, was) / face.size if p_before >= 0.5 else 0.0
                last[i], inside[i] = frame.time_s, min(x, y, right - x, lower - y) > BORDER * unit * face.size
        size = scene.factor * belief.form[:, :2]
        return state._replace(
            cloud=cloud, belief=belief, now=frame.index, speed=speed, size=size, present=present, last=last,
            inside=inside, named=(named, changed),
        )  # fmt: skip

    def footprint(self, state: HandState, *, ahead: bool) -> Footprint | None:
        at = _in_pixels(state.scene, state.belief.at[self.hand])
        return Footprint(at, np.where(np.isnan(size := state.size[self.hand]), 1.0, size) / 2, state)

    def _result(self, state: HandState, frame: Frame, *, placed: bool = False) -> TargetResult:
        i, belief, unit, named = self.hand, state.belief, state.scene.side * state.scene.factor, state.named
        present = 1.0 if placed else state.present[i]
        p, (constant, by_speed) = present * float(belief.near[i]), CONFIDENCE
        sure = 1.0 if placed else p / (1 + math.exp(-constant - by_speed * min(state.speed[i], 1.0)))
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

        def beliefs() -> tuple[protocols.Belief]:
            steps = unit**2 * np.dot(self.settings.shares, np.square(self.settings.steps)) * np.eye(2)[None]
            motion = protocols.Linear(np.eye(2)[None], np.zeros((1, 2)), steps)
            return (protocols.Belief(at, cov, motion, np.array([status == "lost"]), np.array(named)),)

        return TargetResult(rows, cloud, beliefs=beliefs)


def cues(belief: Belief, face: Face, height: float) -> list[Sequence[float]]:
    """Of each hand (4,) what tells whether it is in the picture, which is `height` sizes high.

    A bare arm that reaches the lower border above where hands hang leads to a hand below, and is thinner than a hand.
    """
    found, middle = list[Sequence[float]](), float(face.at[1])
    for (_, y), p, skin in zip(belief.at.tolist(), belief.seen.tolist(), belief.skin.tolist(), strict=True):
        low = min(max(1 - (height - y) / face.size / LOW, 0.0), 1.2) * ((y - middle) / face.size - HANGS)
        found.append((1.0, p, p * low, p * skin))
    return found


def in_picture(cues: Sequence[Sequence[float]]) -> list[float]:
    """The probability that each hand is in the picture."""
    log_odds = (sum(map(operator.mul, each, IN_PICTURE)) for each in cues)
    return [1 / (1 + math.exp(-min(max(each, -30.0), 30.0))) for each in log_odds]


def _face(scene: Scene, face: Footprint) -> Face:
    return Face(_in_sizes(scene, face.centre), evidence.side_of(face) / scene.factor / scene.side)


def _in_sizes(scene: Scene, at: Array) -> Array:
    return evidence.to_map(at, scene.factor) / scene.side


def _in_pixels(scene: Scene, at: Array) -> Array:
    return np.asarray((at * scene.side + 0.5) * scene.factor - 0.5)
