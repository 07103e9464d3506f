"""Who is who: the tracks of a whole film, each given to a person, or to somebody new (ours).

Two tracks are of one person with log odds that come from what is seen in both: with dlib's embeddings from the mean of
the smallest eighth of the distances between their views, else from the face in grey, skin, hair and clothes. Both are
logistic regressions on pairs of tracks of edited clips. Tracks that are seen at the same time are of two people. Where
one ends and another begins in the same place of the same shot, that speaks for one person.

Clusters of tracks are joined while the mean log odds between them favour it, the likeliest first, whatever the order of
time. Then each track has a posterior over the people of the film and "somebody new", and what is not clear is a doubt.
This is recognition of an open set, without a gallery: Zhou et al. (2003) recognise one of a gallery while they track.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Box, Mask, Whole
from facetrack_cli.tracking.people.looks import VIEWS, Looks

SURE: Final = 0.9  # probability of a person below which a track is a doubt
_BOUND: Final = 8.0  # of the log odds that one pair of tracks gives
_NEAREST: Final = VIEWS * VIEWS // 8  # of the distances between the views of two tracks
_AS_GOOD: Final = 0.5  # of the best view's worth, what another view that is looked at has at least


class _Sense(NamedTuple):
    """Log odds `at + by @ distances`, bounded by how often they are wrong about people left out: both ways."""

    at: float
    by: tuple[float, ...]
    against: float
    speaks_for: float


SENSES: Final = {  # by tools/same_person.py
    "grey": _Sense(-6.15, (-1.53, -14.53), 3.0, 4.0),
    "embedding": _Sense(38.12, (-7.16, -61.17), 3.5, 4.5),
    "colour": _Sense(-0.98, (20.36, -8.14, 2.79, 3.04), 3.1, 3.2),  # skin, closely and at all, hair, clothes
}
_NEAR: Final = (
    3.0,
    10.0,
    10.0,
    0.3,
)  # of skin, closely and at all, hair (both in Lab), and clothes: what is this far off is near by 1 / e
_SAME_PLACE: Final = 3.0  # log odds of a track that begins where another one of its shot has ended
_GOES_ON: Final = 1.0  # the same over a cut
_IN_PLACE, _AS_LARGE = (
    0.25,
    0.2,
)  # sides of the box, and of the logarithm of its side, within which it is the same place
AT_ONCE_S: Final = 0.5
LEAST: Final = 0.15  # worth of a track below which its face cannot be told again
UNKNOWN: Final = -1
_NEW: Final = 0.0  # log odds of somebody new, of which nothing is known


class Seen(NamedTuple):
    """A track: its name, the frames [first, stop) in which it is, its first and its last box, its shot, its looks."""

    name: str
    first: int
    stop: int
    begins: Box
    ends: Box
    shot: int
    looks: Looks


@dataclass(frozen=True)
class Doubt:
    """A track that may be of another person (None: of somebody new) with probability `p`."""

    track: int
    other: int | None
    p: float


@dataclass(frozen=True)
class Cast:
    """The person (T,) of each track with its probability `p` (T,); what is in doubt.

    The first numbers are of the `known` people, in their order; others are counted by first appearance. A track that
    shows no face that could be told again is UNKNOWN.
    """

    person: Whole
    p: Array
    doubts: tuple[Doubt, ...]


def cast_of(tracks: Sequence[Seen], known: Sequence[Looks] = (), fps: float = 25.0) -> Cast:
    """Who each track is of, of `known` people and others; of a film of `fps` frames per second.

    A track of which no face can be told again is of the person in whose place it goes on, or of nobody (UNKNOWN).
    """
    if not tracks:
        return Cast(np.zeros(0, np.int64), np.zeros(0), ())
    k, every = len(known), [*known, *(one.looks for one in tracks)]
    senses = _senses(every)
    follows, goes_on = (np.pad(one, (k, 0)) for one in places(tracks, fps))
    odds = senses.sum(axis=0)
    rest = odds - np.minimum(senses.min(axis=0), 0)  # without the sense that speaks against it most
    if len(senses) > 2:  # one of three alone does not part what is in one place
        odds = np.where((follows | goes_on) & (rest > 0), rest, odds)
    odds = np.clip(odds + _SAME_PLACE * follows + _GOES_ON * goes_on, -_BOUND, _BOUND)
    apart = np.pad(_apart(tracks), (k, 0))
    apart[:k, :k] = ~np.eye(k, dtype=bool)
    nobody = np.array([worth_of(one) < LEAST for one in every])
    nobody[:k] = False
    nothing = (nobody[:, None] | nobody) & ~(follows | goes_on)
    label = _in_order(clusters(odds, apart | nothing))
    shown = np.bincount(label, ~nobody) > 0  # people of whom a face can be told again
    found = _judged(label, odds, apart)
    person = np.where(shown, np.cumsum(shown) - 1, UNKNOWN)  # of each cluster
    doubts = [replace(one, track=one.track - k) for one in found.doubts if one.track >= k]
    others = [None if one.other is None or not shown[one.other] else int(person[one.other]) for one in doubts]
    told = tuple(replace(one, other=other) for one, other in zip(doubts, others, strict=True))
    return Cast(person[found.person[k:]], found.p[k:], told)


def same_person(looks: Sequence[Looks]) -> Array:
    """(T, T) log odds, bounded, that two tracks show one person, by what is seen in them."""
    return np.asarray(_senses(looks).sum(axis=0))


def worth_of(looks: Looks) -> float:
    """How much of a face the best views of a track show, 0..1."""
    return float(np.mean(looks.worth[_best(looks)]))


def _best(looks: Looks) -> Whole:
    """The views (VIEWS,) that are worth most; few stand for more."""
    worth = looks.worth[:, 0]
    return np.resize(np.flatnonzero(worth >= _AS_GOOD * worth.max()), VIEWS)


def _senses(looks: Sequence[Looks]) -> Array:
    """(S, T, T) the log odds by each sense."""
    found = []
    for name, far in distances(looks).items():
        at, by, against, speaks_for = SENSES[name]
        odds = np.tensordot((at, *by), far, 1)
        found.append(np.clip(odds, -against, speaks_for))
    return np.array(found)


def distances(looks: Sequence[Looks]) -> dict[str, Array]:
    """(1 + D, T, T) what SENSES weigh of each pair of tracks: its worth, and that times its worth and its distance.

    A face that is blurred, small, covered or turned away says less, whatever it looks like; its colours say as much.
    """
    full = [_best(one) for one in looks]
    worth = np.array([worth_of(one) for one in looks])
    worth = np.minimum(worth[:, None], worth)
    x = np.concatenate([one.face[rows] for one, rows in zip(looks, full, strict=True)])
    found = {"grey": worth * np.array([np.ones_like(worth), worth, _of_nearest(x, lambda dot, rows: -dot)])}
    if all(one.embedding.shape[1] for one in looks):  # known people may have been saved without
        y = np.concatenate([one.embedding[rows] for one, rows in zip(looks, full, strict=True)])
        squared = np.sum(y**2, axis=1)
        near = _of_nearest(y, lambda dot, rows: np.sqrt(np.maximum(squared[rows, None] + squared - 2 * dot, 0)))
        found["embedding"] = worth * np.array([np.ones_like(worth), worth, near])
    skin, hair, worn = (
        np.array([np.median(getattr(one, key)[rows], axis=0) for one, rows in zip(looks, full, strict=True)])
        for key in _COLOURS
    )
    clothes = 0.5 * np.array([np.sum((worn - one) ** 2 / (worn + one + 1e-9), axis=1) for one in worn])
    # colours that differ say little: the light may be another one, and so may the clothes
    far = (_far(skin), _far(skin), _far(hair), clothes)
    near = [np.exp(-one / scale) for one, scale in zip(far, _NEAR, strict=True)]
    return found | {"colour": np.array([np.ones_like(worth), *near])}


_COLOURS: Final = ("skin", "hair", "worn")
_LAB: Final = np.array([0.4, 1.0, 1.0])  # brightness changes with the light


def _far(colours: Array) -> Array:
    """(T, T) distances of colours (T, 3) in Lab."""
    return np.asarray(np.linalg.norm((colours[:, None] - colours) * _LAB, axis=2))


def _of_nearest(x: Array, distance: Callable[[Array, slice], Array]) -> Array:
    """(T, T): the mean of the smallest eighth of the distances between views of two tracks.

    `x` (T * VIEWS, D) are all views; `distance` makes the distances of some rows from their products with all.
    """
    t = len(x) // VIEWS
    found = np.empty((t, t))
    for i in range(t):
        rows = slice(i * VIEWS, (i + 1) * VIEWS)
        each = distance(x[rows] @ x.T, rows).reshape(VIEWS, t, VIEWS).transpose(1, 0, 2).reshape(t, -1)
        found[i] = np.partition(each, _NEAREST - 1, axis=1)[:, :_NEAREST].mean(axis=1)
    return 0.5 * (found + found.T)


def _apart(tracks: Sequence[Seen]) -> Mask:
    """(T, T) tracks that are seen in the same frames."""
    first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("first", "stop"))
    both = (first[:, None] < stop) & (first < stop[:, None])
    np.fill_diagonal(both, False)
    return np.asarray(both)


def places(tracks: Sequence[Seen], fps: float) -> tuple[Mask, Mask]:
    """(T, T) pairs of tracks of which one begins in the place where the other has ended: in one shot, or over a cut.

    Over a cut it begins within half a second, as large as it was.
    """
    shot, first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("shot", "first", "stop"))
    begins, ends = (np.array([getattr(one, key) for one in tracks]) for key in ("begins", "ends"))
    side, other = ends[:, None, 2], begins[:, 2]
    off = np.hypot(*(ends[:, None, :2] - begins[:, :2]).transpose(2, 0, 1)) / np.maximum(side, other)
    wait, alike = first - stop[:, None], np.abs(np.log(side / other)) < _AS_LARGE
    within = (off < 0.7) & (wait >= 0) & (shot[:, None] == shot)
    over = (off < _IN_PLACE) & alike & (wait >= 0) & (wait <= AT_ONCE_S * fps) & (shot[:, None] != shot)
    return np.asarray(within | within.T), np.asarray(over | over.T)


def clusters(odds: Array, apart: Mask) -> Whole:
    """(T,) the cluster of each track: average linkage of log odds (T, T), joined while they are above 0.

    Clusters that hold two tracks that are `apart` (T, T) are never joined.
    """
    mean = np.where(apart, -np.inf, odds)
    np.fill_diagonal(mean, -np.inf)
    label, size = np.arange(len(odds)), np.ones(len(odds))
    while len(odds) > 1:
        i, j = np.unravel_index(int(np.argmax(mean)), mean.shape)
        if not mean[i, j] > 0:
            break
        joined = (size[i] * mean[i] + size[j] * mean[j]) / (size[i] + size[j])
        joined[[i, j]] = -np.inf
        mean[i], mean[:, i], size[i] = joined, joined, size[i] + size[j]
        mean[j] = mean[:, j] = -np.inf
        label[label == j] = i
    return label


def _in_order(label: Whole) -> Whole:
    """Clusters, counted as they come."""
    order = {one: k for k, one in enumerate(dict.fromkeys(label.tolist()))}
    return np.array([order[one] for one in label.tolist()])


def _judged(person: Whole, odds: Array, apart: Mask) -> Cast:
    """The posterior of each track over the people of the film and somebody new."""
    count, t = int(person.max()) + 1, len(person)
    member = person[:, None] == np.arange(count)
    others = member[None] & ~np.eye(t, dtype=bool)[:, :, None]  # (T, T, P), of a track without itself
    many = others.sum(axis=1)
    mean = np.einsum("ij,ijp->ip", odds, others) / np.maximum(many, 1)
    able = (many > 0) & ~np.einsum("ij,ijp->ip", apart, others).astype(bool)
    logs = np.column_stack([np.where(able, mean, -np.inf), np.full(t, _NEW)])
    p = np.exp(logs - logs.max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    alone = many[np.arange(t), person] == 0  # whose person is the new one
    own = np.where(alone, p[:, -1], p[np.arange(t), person])
    doubts = []
    for i in np.flatnonzero(own < SURE).tolist():
        rest = p[i].copy()
        rest[count if alone[i] else person[i]] = -1
        other = int(np.argmax(rest))
        doubts.append(Doubt(i, None if other == count else other, float(rest[other])))
    return Cast(person, own, tuple(doubts))
