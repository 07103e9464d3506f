"""Who is who: the tracks of a whole film, each given to a person, or to somebody new (ours).

Two tracks are of one person with log odds that are the sum of what three senses say: the face in grey, dlib's embedding
of it where that is there, and the colours of skin, hair and clothes. Each is a logistic regression on pairs of tracks,
and says no more than it is right about people left out. Tracks that are seen at the same time are of two people. Where
one begins in the place where another has ended, in one shot or over a cut, that speaks for one person.

Clusters of tracks are joined while the mean log odds between them favour it, the likeliest first, whatever the order of
time. Then each track has a posterior over the people of the film and "somebody new", and what is not clear is a doubt.
This is recognition of an open set, without a gallery: Zhou et al. (2003) recognise one of a gallery while they track.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Box, Mask, Whole
from facetrack_cli.trackers.people.descriptor import AS_GOOD, VIEWS, FaceDescriptor

SURE: Final = 0.9  # probability of a person below which a track is a doubt
_BOUND: Final = 8.0  # of the log odds that one pair of tracks gives
_NEAREST: Final = VIEWS * VIEWS // 8  # of the distances between the views of two tracks


# by tools/same_person.py: weights of what `distances` gives, the most that it says against one person, and for one
SENSES: Final = {
    "face": ((14.84, -1.12, -14.23), 3.1, 3.9),
    "embedding": ((37.09, -6.67, -59.58), 4.2, 4.4),
    "colour": ((-1.06, 19.55, -6.99, 2.56, 2.89), 2.6, 3.2),
}
_NEAR: Final = (3.0, 10.0, 10.0, 0.3)  # scales: of skin, twice, and hair, all in Lab, and of clothes
_SAME_PLACE: Final = 3.0  # log odds of a track that begins where another one of its shot has ended
_GOES_ON: Final = 1.0  # the same over a cut
_IN_PLACE, _AS_LARGE = 0.25, 0.2  # sides of the box by which it has moved then, and its growth, at most
AT_ONCE_S: Final = 0.5
LEAST: Final = 0.15  # worth of a track below which its face cannot be told again
UNKNOWN: Final = -1
_NEW: Final = 0.0  # log odds of somebody new, of which nothing is known


class TrackSummary(NamedTuple):
    """A track: its name, the frames [first, stop) in which it is, its first and its last box, its shot, its looks."""

    name: str
    first: int
    stop: int
    begins: Box
    ends: Box
    shot: int
    looks: FaceDescriptor


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


def cast_of(tracks: Sequence[TrackSummary], known: Sequence[FaceDescriptor] = (), fps: float = 25.0) -> Cast:
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
    nobody = np.array([i >= k and worth_of(one) < LEAST for i, one in enumerate(every)])
    nothing = (nobody[:, None] | nobody) & ~(follows | goes_on)
    label = np.unique(clusters(odds, apart | nothing), return_inverse=True)[1]  # counted as they come
    own, other, p_other = _judged(label, odds, apart)
    shown = np.bincount(label, ~nobody) > 0
    person = np.where(shown, np.cumsum(shown) - 1, UNKNOWN)  # of each cluster, where a face of it can be told again
    names = [None if number == UNKNOWN else number for number in person.tolist()] + [None]
    doubts = [Doubt(i - k, names[other[i]], float(p_other[i])) for i in np.flatnonzero(own < SURE).tolist() if i >= k]
    return Cast(person[label[k:]], own[k:], tuple(doubts))


def same_person(looks: Sequence[FaceDescriptor], senses: Collection[str] = SENSES) -> Array:
    """(T, T) log odds, bounded, that two tracks show one person, by what some of the SENSES see in them."""
    return np.asarray(_senses(looks, senses).sum(axis=0))


def _best(looks: FaceDescriptor) -> Whole:
    """The views (VIEWS,) that are worth most; few stand for more."""
    worth = looks.worth[:, 0]
    return np.resize(np.flatnonzero(worth >= AS_GOOD * worth.max()), VIEWS)


def worth_of(looks: FaceDescriptor) -> float:
    """How much of a face the best views of a track show, 0..1."""
    return float(np.mean(looks.worth[_best(looks)]))


def _senses(looks: Sequence[FaceDescriptor], senses: Collection[str] = SENSES) -> Array:
    """(S, T, T) the log odds by each sense."""
    each = [(*SENSES[name], far) for name, far in distances(looks).items() if name in senses]
    return np.array([np.clip(np.tensordot(by, far, 1), -against, most) for by, against, most, far in each])


def distances(looks: Sequence[FaceDescriptor]) -> dict[str, Array]:
    """(D, T, T) what SENSES weigh of each pair of tracks: its worth, and that times its worth and its distance.

    A face that is blurred, small, covered or turned away says less, whatever it looks like; its colours say as much.
    Colours that are far apart say little: the light may be another one, and so may the clothes.
    """
    best, found = [_best(one) for one in looks], dict[str, Array]()
    worth = np.array([worth_of(one) for one in looks])
    worth = np.minimum(worth[:, None], worth)
    for key in ("face", "embedding"):  # known people may have been saved without
        if all(getattr(one, key).shape[1] for one in looks):
            x = np.concatenate([getattr(one, key)[rows] for one, rows in zip(looks, best, strict=True)])
            found[key] = worth * np.array([np.ones_like(worth), worth, _nearest(x)])
    skin, hair, worn = (
        np.array([np.median(getattr(one, key)[rows], axis=0) for one, rows in zip(looks, best, strict=True)])
        for key in ("skin", "hair", "worn")
    )
    clothes = [0.5 * np.sum((worn - one) ** 2 / (worn + one + 1e-9), axis=1) for one in worn]
    far = np.array([_far(skin), _far(skin), _far(hair), clothes]) / np.reshape(_NEAR, (4, 1, 1))
    return found | {"colour": np.array([np.ones_like(worth), *np.exp(-far)])}


_LAB: Final = np.array([0.4, 1.0, 1.0])  # brightness changes with the light


def _far(colours: Array) -> Array:
    """(T, T) distances of colours (T, 3) in Lab."""
    return np.asarray(np.linalg.norm((colours[:, None] - colours) * _LAB, axis=2))


def _nearest(x: Array) -> Array:
    """(T, T): the mean of the smallest eighth of the distances between views x (T * VIEWS, D) of two tracks."""
    t, squared = len(x) // VIEWS, np.sum(x**2, axis=1)
    found = np.empty((t, t))
    for i in range(t):
        rows = slice(i * VIEWS, (i + 1) * VIEWS)
        each = np.sqrt(np.maximum(squared[rows, None] + squared - 2 * x[rows] @ x.T, 0))
        each = each.reshape(VIEWS, t, VIEWS).transpose(1, 0, 2).reshape(t, -1)
        found[i] = np.partition(each, _NEAREST - 1, axis=1)[:, :_NEAREST].mean(axis=1)
    return 0.5 * (found + found.T)


def _apart(tracks: Sequence[TrackSummary]) -> Mask:
    """(T, T) tracks that are seen in the same frames."""
    first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("first", "stop"))
    both = (first[:, None] < stop) & (first < stop[:, None])
    np.fill_diagonal(both, False)
    return np.asarray(both)


def places(tracks: Sequence[TrackSummary], fps: float) -> tuple[Mask, Mask]:
    """(T, T) pairs of tracks of which one begins in the place where the other has ended: in one shot, or over a cut.

    Over a cut it begins within half a second, as large as it was.
    """
    shot, first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("shot", "first", "stop"))
    begins, ends = (np.array([getattr(one, key) for one in tracks]).reshape(-1, 4) for key in ("begins", "ends"))
    side, other = ends[:, None, 2], begins[:, 2]
    off = np.hypot(*(ends[:, None, :2] - begins[:, :2]).transpose(2, 0, 1)) / np.maximum(side, other)
    wait, alike = first - stop[:, None], np.abs(np.log(side / other)) < _AS_LARGE
    within = (off < 0.7) & (wait >= 0) & (shot[:, None] == shot)
    over = (off < _IN_PLACE) & alike & (wait >= 0) & (wait <= AT_ONCE_S * fps) & (shot[:, None] != shot)
    return np.asarray(within | within.T), np.asarray(over | over.T)


def clusters(odds: Array, apart: Mask) -> Whole:
    """(T,) the first track of each track's cluster: average linkage of log odds (T, T), joined while they are above 0.

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


def _judged(person: Whole, odds: Array, apart: Mask) -> tuple[Array, Whole, Array]:
    """By the posterior of each track over the people of the film and somebody new, the last one.

    The probability (T,) of its person, the likeliest other one, and the probability of that.
    """
    every, t = np.arange(len(person)), len(person)
    member = person[:, None] == np.arange(int(person.max()) + 1)
    others = member[None] & ~np.eye(t, dtype=bool)[:, :, None]  # (T, T, P), of a track without itself
    many = others.sum(axis=1)
    mean = np.einsum("ij,ijp->ip", odds, others) / np.maximum(many, 1)
    able = (many > 0) & ~np.einsum("ij,ijp->ip", apart, others).astype(bool)
    logs = np.column_stack([np.where(able, mean, -np.inf), np.full(t, _NEW)])
    p = np.exp(logs - logs.max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    own = np.where(many[every, person] == 0, member.shape[1], person)  # who is alone is the new one
    rest = p.copy()
    rest[every, own] = -1
    other = rest.argmax(axis=1)
    return p[every, own], other, p[every, other]
