"""Two hands in one posterior, by a particle filter on the skin that a frame shows (ours).

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
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.engine.resampling import normalise, systematic
from facetrack_cli.trackers.hands.evidence import Map, Seen
from facetrack_cli.trackers.hands.hand_kernels import REST, fit_skin, gather, move, weigh
from facetrack_cli.trackers.hands.settings import HandsSettings

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


class Cloud(NamedTuple):
    """Equally weighted particles: `x` (N, 2, 4) places and velocities in sizes of the face's box, from the corner of
    the frame, `seen` (N, 2), and `parted` (N,), whether two hands that are seen have been apart since.
    """

    x: Array
    seen: Mask
    parted: Mask

    def exchanged(self) -> Cloud:
        return Cloud(self.x[:, ::-1], self.seen[:, ::-1], self.parted)


class Belief(NamedTuple):
    """Of each hand: p that it is `seen`, the place `at` (2, 2) and `cov` (2, 2, 2) of the particles about it, in sizes;
    `near` (2,), the share of those that see it which are there; `ess` of the filter's step; `skin` (2,), the share of
    skin in a hand there; `form` (2, 3), of that skin width, height, twice the radius each of a disc, and l sin 2a.
    """

    seen: Array
    at: Array
    cov: Array
    near: Array
    ess: float
    skin: Array
    form: Array

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
    rng: Generator,
    settings: HandsSettings,
    cloud: Cloud,
    looked: Seen,
    scale: float,
    face: Face,
    *,
    first: bool = False,
) -> tuple[Cloud, Belief]:
    """One frame, of which is `looked`, in pixels of which `scale` are a size. No hand appears before the face."""
    n, evidence = len(cloud.x), looked.evidence
    radius = settings.radius * face.size * scale
    share = disc_means(evidence, radius)
    fit, peaks, often = fitted(settings, share, scale, face)
    luck, noise = rng.random((2, 4, n)), rng.standard_normal((2, n, 2))
    x, seen, parted, weight = cloud.x.copy(), cloud.seen.copy(), cloud.parted.copy(), np.empty(n)
    chances = np.array([0.5 if first else settings.appears, settings.vanishes, settings.proposed])
    motion = np.array(settings.steps), np.array(settings.shares), chances, settings.evidence
    seen_in = evidence, looked.face, face.at, face.size, scale
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


def named(settings: HandsSettings, belief: Belief, face: Face, before: float) -> tuple[float, float]:
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
