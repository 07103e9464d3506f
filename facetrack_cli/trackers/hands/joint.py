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
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.engine.resampling import effective_sample_size, normalise, systematic
from facetrack_cli.trackers.hands.evidence import Map, Seen
from facetrack_cli.trackers.hands.settings import HandsSettings

START: Final = 0.075  # sizes, standard deviation of a hand that is given
HIDES: Final = 0.5  # of `skin`, which two hands that overlap need once: between two discs apart, 0, and a union, 1
NEWS: Final = 0.4  # share of the last step in the velocity
REST: Final = np.array([[-1.4, 4.6], [1.4, 4.6]])  # where hands hang, about the face's middle, in its sizes
REACH: Final = (0.0, 1.6, 3.2, 3.6)  # ellipse of an arm's reach about the face's middle, in its sizes: x, y, half axes
ANYWHERE: Final = 0.1  # share of the hands that appear anywhere within reach, and not about where they were
BEYOND: Final = 12.0  # what a place beyond 0.8 of that ellipse loses of log p
PEAKS: Final = 8  # places of most skin, at most
LEAST: Final = -1.5  # of log p(y | x) at such a place
SHOULDERS: Final = np.array([[-0.9, 1.1], [0.9, 1.1]])  # about the face's middle, in its sizes
BEYOND_HAND: Final = np.array([1.6, 2.2])  # radii from a hand's middle to where no skin is, seen from the shoulder
FAR_END: Final = 0.15  # what skin there takes away, of what it would give within the hand
MIDDLE: Final = 0.2  # what skin on two opposite sides takes away
ARM: Final = (0.8, 0.4, 3.0)  # sizes from one hand to another place of its arm: from, to surely, to at most
_ALONG: Final = np.array([0.2, 0.35, 0.5, 0.65, 0.8])
_AROUND: Final = np.array([[math.cos(turn), math.sin(turn)] for turn in np.arange(6) * math.pi / 6])
_OPPOSITE: Final = np.stack([2 * _AROUND, -2 * _AROUND])  # (2, 6, 2), radii

_SPREAD: Final = 0.6  # pixels of the reduced frame, about a place of most skin
_TINY: Final = 1e-12

SIGNS: Final = (1.0, -1.0)  # of each hand, of the way to the other hand's side
WEIGHTS: Final = np.array([0.4, -1.3, -7.0])  # of u, u v, and l sin 2a
TEMPER: Final = 0.4
ANY, MEET, MEETS = 0.002, 0.2, 0.8  # probabilities, and the sizes between two hands from which on they overlap
APART: Final = (1.2, 2.2)  # radii between two hands, at which each begins to tell its name, and does
WINDOW: Final = 0.8  # radii, standard deviation of the window in which the axis is measured


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
    skin in a hand there.
    """

    seen: Array
    at: Array
    cov: Array
    near: Array
    ess: float
    skin: Array

    def exchanged(self) -> Belief:
        return Belief(self.seen[::-1], self.at[::-1], self.cov[::-1], self.near[::-1], self.ess, self.skin[::-1])


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
    share = disc_means(evidence, settings.radius * face.size * scale)
    fit = settings.evidence * (share - settings.skin) + _reach(evidence.shape, scale, face)
    peaks = _peaks(fit)
    x, seen, weight = cloud.x.copy(), cloud.seen.copy(), np.zeros(n)
    for hand in (0, 1):
        before, was = cloud.x[:, hand], cloud.seen[:, hand]
        luck = rng.random(n)
        now = np.where(was, luck >= settings.vanishes, luck < (0.5 if first else settings.appears))
        now &= was | (len(peaks[0]) > 0)
        ahead = before[:, :2] + before[:, 2:]
        wide = np.array(settings.steps)[rng.choice(3, n, p=np.array(settings.shares) / sum(settings.shares))]
        at = ahead + wide[:, None] * rng.standard_normal((n, 2))
        if len(peaks[0]):
            drawn = peaks[0][rng.choice(len(peaks[0]), n, p=peaks[1])] + _SPREAD * rng.standard_normal((n, 2))
            born = now & ~was
            at = np.where((born | (now & (rng.random(n) < settings.proposed)))[:, None], drawn / scale, at)
            q = _mixture(at, peaks[0] / scale, peaks[1], _SPREAD / scale)
            moved = _transition(settings, at - ahead)
            stays = np.log(moved + _TINY) - np.log((1 - settings.proposed) * moved + settings.proposed * q + _TINY)
            # one that appears is about where it was, or anywhere within reach
            near = np.exp(-0.5 * np.sum((at - before[:, :2]) ** 2, axis=1)) / (2 * math.pi)
            comes = np.log((1 - ANYWHERE) * near + ANYWHERE / (math.pi * REACH[2] * REACH[3])) - np.log(q + _TINY)
            comes -= BEYOND * np.maximum(_at(looked.face, at * scale), 0.0)
            weight += np.where(born, comes, np.where(now, stays, 0.0))
        # nor does one leap along its own bare arm, to the elbow
        far = np.flatnonzero(now & (np.hypot(*(at - before[:, :2]).T) > ARM[0] * face.size))
        weight[far] -= settings.evidence * _arm(evidence, before[far, :2], at[far], scale, face)
        drift = before[:, :2] + 0.5 * before[:, 2:] + 0.03 * (face.at + face.size * REST[hand] - before[:, :2])
        hidden = drift + 0.15 * rng.standard_normal((n, 2))
        x[:, hand, :2] = np.where(now[:, None], at, hidden)
        speed = np.where(was[:, None], NEWS * (at - before[:, :2]) + (1 - NEWS) * before[:, 2:], 0.0)
        x[:, hand, 2:] = np.where(now[:, None], speed, 0.5 * before[:, 2:])
        seen[:, hand] = now
    parted = cloud.parted & seen.all(axis=1)
    met = np.flatnonzero(seen.all(axis=1) & ~parted)
    parted[met] = _joined(evidence, x[met, 0, :2], x[met, 1, :2], scale) <= 0
    weight += log_likelihood(settings, x, seen, parted, (fit, share, evidence), scale, face)
    log_w = normalise(weight)
    belief = _belief(x, seen, np.exp(log_w), float(effective_sample_size(log_w)))
    belief = belief._replace(skin=np.clip(_at(share, belief.at * scale), 0, 1))
    kept = systematic(rng, log_w, n)
    x, seen, parted = x[kept], seen[kept], parted[kept]
    # all particles have the order of the belief: which hand is which is not theirs to say
    off = [np.sum((x[..., :2] - at) ** 2, axis=(1, 2)) for at in (belief.at, belief.at[::-1])]
    other = seen.all(axis=1) & (off[1] < off[0])
    x[other] = x[other][:, ::-1]
    return Cloud(x, seen, parted), belief


def disc_means(evidence: Map, radius: float) -> Map:
    """Means of the evidence in a disc about each pixel, within the frame; a third of the disc must be there."""
    n = math.ceil(radius + 0.5)
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    disc = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1).astype(np.float32)
    disc /= disc.sum()
    mean, inside = (
        cv2.filter2D(one, -1, disc, borderType=cv2.BORDER_CONSTANT) for one in (evidence, np.ones_like(evidence))
    )
    return np.asarray(mean / np.maximum(inside, 0.35), np.float32)


def log_likelihood(
    settings: HandsSettings, x: Array, seen: Mask, parted: Mask, maps: tuple[Map, Map, Map], scale: float, face: Face
) -> Array:
    """(N,): log p(y, x) of both hands, but for the motion; `maps` are log p(y | x) of one hand, its share of skin, and
    the evidence.
    """
    fit, share, evidence = maps
    at, both = x[..., :2] * scale, seen.all(axis=1)
    each = _at(fit, at)
    radius = settings.radius * face.size

    def skin_at(off: Array) -> Array:
        """Of skin at places (N, 2, ..., 2) off from each hand, what is not the other hand's."""
        extra = tuple(range(2, off.ndim - 1))
        at, other = np.expand_dims(x[..., :2], extra) + off, np.expand_dims(x[:, ::-1, :2], extra)
        near = np.hypot(*np.moveaxis(at - other, -1, 0)) < 1.2 * settings.radius * face.size
        hides = near & np.expand_dims(seen[:, ::-1], extra)
        return np.where(hides, 0.0, np.maximum(_at(evidence, at * scale), 0.0))

    # a hand is the far end of a bare arm: beyond it, seen from the shoulder, is no skin but the other hand's
    way = x[..., :2] - (face.at + face.size * SHOULDERS)
    way = way / np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-6)[..., None]
    beyond = skin_at((radius * BEYOND_HAND)[:, None] * way[..., None, :])
    each = each - settings.evidence * FAR_END * beyond.mean(axis=2)
    # nor is it the middle of one, with skin on two opposite sides
    sides = skin_at((radius * _OPPOSITE)[None, None])
    each = each - settings.evidence * MIDDLE * sides.min(axis=2).max(axis=2)
    total = np.sum(np.where(seen, each, 0.0), axis=1)
    if both.any():
        apart = np.hypot(*(x[:, 0, :2] - x[:, 1, :2]).T) / face.size
        shared = np.minimum(1.3 * np.maximum(1 - apart / (2 * settings.radius), 0.0), 1.0)
        arm = _arm(evidence, x[:, 0, :2], x[:, 1, :2], scale, face, nearest=np.where(parted, ARM[0], -ARM[1]))
        least = _at(share, at).min(axis=1)
        twice = shared * np.maximum(least - HIDES * settings.skin, 0.0) + arm * np.maximum(least, 0.0)
        total -= np.where(both, settings.evidence * twice, 0.0)
    return np.asarray(total)


def _arm(evidence: Map, a: Array, b: Array, scale: float, face: Face, nearest: Array | float = ARM[0]) -> Array:
    """(N,): how surely places (N, 2) are of one bare arm: skin all along the line, `nearest` sizes apart at least."""
    apart = np.hypot(*(a - b).T) / face.size
    within = np.clip((apart - nearest) / ARM[1], 0, 1) * np.clip((ARM[2] - apart) / 0.5, 0, 1)
    return np.asarray(_joined(evidence, a, b, scale) * within)


def _joined(evidence: Map, a: Array, b: Array, scale: float) -> Array:
    """(N,): whether there is skin all along the lines between places (N, 2), 0 to 1."""
    line = scale * (a[:, None] + _ALONG[:, None] * (b - a)[:, None])
    return np.asarray(np.clip((np.maximum(_at(evidence, line), 0.0).min(axis=1) - 0.2) / 0.4, 0, 1))


def crop(evidence: Map, at: Array, far: float) -> tuple[Map, tuple[int, int]]:
    """The evidence within `far` pixels of a place along x and y, and its left and top."""
    (x, y), shape = at, evidence.shape
    left, right = (min(max(round(x + side), 0), shape[1]) for side in (-far, far + 1))
    top, bottom = (min(max(round(y + side), 0), shape[0]) for side in (-far, far + 1))
    return evidence[top:bottom, left:right], (left, top)


def extent(evidence: Map, at: Array, radius: float) -> Array:
    """(2,) width and height in pixels of the skin within 1.5 `radius` of a place `at`: of a disc its diameter."""
    near, _ = crop(evidence, at, 1.5 * radius)
    of = cv2.moments(near)
    if of["m00"] < 1e-3:
        return np.full(2, 2 * radius)
    var = np.maximum([of["mu20"], of["mu02"]], 0.0) / of["m00"]
    return np.asarray(np.clip(4 * np.sqrt(var), radius, 3 * radius))


def _at(values: Map, at: Array) -> Array:
    """The values at places (..., 2) in pixels; -9 beyond the border."""
    height, width = values.shape
    column, row = np.rint(at[..., 0]).astype(np.int64), np.rint(at[..., 1]).astype(np.int64)
    out = (column < -1) | (column > width) | (row < -1) | (row > height)
    return np.where(out, -9.0, values[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])


def _reach(shape: tuple[int, ...], scale: float, face: Face) -> Map:
    """(H, W): what is lost of log p beyond the reach of an arm."""
    x, y, a, b = REACH
    u = ((np.arange(shape[1]) / scale - face.at[0]) / face.size - x) / a
    v = ((np.arange(shape[0]) / scale - face.at[1]) / face.size - y) / b
    far = np.sqrt(u[None] ** 2 + v[:, None] ** 2)
    return np.asarray(-BEYOND * np.maximum(far - 0.8, 0.0), np.float32)


def _peaks(fit: Map) -> tuple[Array, Array]:
    """The places (P, 2) of most skin in pixels, and how often each is proposed (P,)."""
    top = (fit >= cv2.dilate(fit, np.ones((5, 5)))) & (fit > LEAST)
    row, column = np.nonzero(top)
    best = np.argsort(-fit[row, column], kind="stable")[:PEAKS]
    at = np.stack([column[best], row[best]], axis=1).astype(float)
    weight = np.exp(0.5 * (fit[row[best], column[best]].astype(float) - fit.max()))
    return at, weight / max(weight.sum(), _TINY)


def _mixture(at: Array, peaks: Array, weights: Array, sigma: float) -> Array:
    """(N,): the density of proposals about the peaks."""
    squared = np.sum((at[:, None] - peaks) ** 2, axis=2)
    return np.asarray((np.exp(-0.5 * squared / sigma**2) @ weights) / (2 * math.pi * sigma**2))


def _transition(settings: HandsSettings, off: Array) -> Array:
    """(N,): the density of steps `off` (N, 2)."""
    squared = np.sum(off**2, axis=1)
    var = np.array(settings.steps) ** 2
    return np.asarray(np.exp(-0.5 * squared[:, None] / var) @ (settings.shares / (2 * math.pi * var)))


def _belief(x: Array, seen: Mask, w: Array, ess: float) -> Belief:
    """Each hand where most of the particles that see it are; all of them where none does."""
    p, at, cov, near = np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2, 2)), np.zeros(2)
    for hand in (0, 1):
        p[hand] = w @ seen[:, hand]
        share = w * seen[:, hand] if p[hand] > 1e-6 else w
        share, places = share / share.sum(), x[:, hand, :2]
        middle = share @ places
        for _ in range(5):  # mean shift, from the mean
            close = share * np.exp(-0.5 * np.sum((places - middle) ** 2, axis=1) / 0.25)
            if close.sum() < 1e-9:
                middle = places[share.argmax()]
                continue
            middle = close @ places / close.sum()
        off = places - middle
        there = share * (np.hypot(*off.T) < 0.5)
        near[hand], at[hand] = there.sum() if p[hand] > 1e-6 else 0.0, middle
        cov[hand] = (off.T * there) @ off / max(there.sum(), 1e-9)
    return Belief(p, at, cov, near, ess, np.zeros(2))


def exchanged(belief: Belief, face: Face) -> float:
    """The probability that the filter has exchanged the hands since the frame before."""
    apart = math.dist(*belief.at) / face.size
    return ANY + MEET * min(max(2 * (1 - apart / MEETS), 0.0), 1.0)


def name_log_odds(settings: HandsSettings, evidence: Map, belief: Belief, scale: float, face: Face) -> float:
    """log p(frame | named as they are) - log p(frame | exchanged); a size is `scale` pixels of the evidence."""
    apart, both = math.dist(*belief.at) / face.size / settings.radius, bool((belief.seen >= 0.5).all())
    clear = min(max((apart - APART[0]) / (APART[1] - APART[0]), 0.0), 1.0) if both else 1.0
    total = 0.0
    for at, seen, sign in zip(belief.at, belief.seen, SIGNS, strict=True):
        if seen >= 0.5:
            u, v = (at - face.at) / face.size
            lean = _lean(evidence, at * scale, settings.radius * face.size * scale)
            total += sign * float(WEIGHTS @ (u, u * v, lean))
    return TEMPER * clear * total


def update_names(p: float, exchanged: float, log_odds: float) -> float:
    """The probability that hands are named as they are after a frame, from that after the frame before."""
    p = p * (1 - exchanged) + (1 - p) * exchanged
    return p / (p + (1 - p) * math.exp(-log_odds))


def _lean(evidence: Map, at: Array, radius: float) -> float:
    """l sin 2a of the long axis of the skin about a place, y down."""
    near, (left, top) = crop(evidence, at, math.ceil(2 * radius))
    if not near.size:
        return 0.0
    x, y = np.arange(left, left + near.shape[1]) - at[0], np.arange(top, top + near.shape[0]) - at[1]
    of = cv2.moments(near * np.exp(-0.5 * (x**2 + y[:, None] ** 2) / (WINDOW * radius) ** 2))
    return float(2 * of["mu11"] / (of["mu20"] + of["mu02"] + 1e-6))
