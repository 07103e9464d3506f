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
_BY_EMBEDDING: Final = (16.6, -35.0)  # log odds: a + b distance
_BY_LOOK: Final = (2.4, 12.6, -1.5, -0.03, -5.1)  # a + b correlation, skin, hair (both in Lab) and clothes
_MOST_SKIN, _MOST_HAIR = 20.0, 40.0  # distances in Lab; what is farther says no more
_SAME_PLACE: Final = 3.0  # log odds of a track that begins where another one of its shot has ended
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

    The first numbers are of the `known` people, in their order; others are counted by first appearance.
    """

    person: Whole
    p: Array
    doubts: tuple[Doubt, ...]


def cast_of(tracks: Sequence[Seen], known: Sequence[Looks] = ()) -> Cast:
    """Who each track is of, of `known` people and others."""
    if not tracks:
        return Cast(np.zeros(0, np.int64), np.zeros(0), ())
    k = len(known)
    odds = same_person([*known, *(one.looks for one in tracks)])
    apart, follows = (np.pad(one, (k, 0)) for one in (_apart(tracks), _follows(tracks)))
    odds = np.where(follows, np.minimum(odds + _SAME_PLACE, _BOUND), odds)
    apart[:k, :k] = ~np.eye(k, dtype=bool)
    found = _judged(_in_order(clusters(odds, apart)), odds, apart)
    doubts = tuple(replace(one, track=one.track - k) for one in found.doubts if one.track >= k)
    return Cast(found.person[k:], found.p[k:], doubts)


def same_person(looks: Sequence[Looks]) -> Array:
    """(T, T) log odds, bounded, that two tracks show one person, by what is seen in them."""
    full = np.array([np.resize(np.arange(len(one.face)), VIEWS) for one in looks])  # few views stand for more
    if all(one.embedding.shape[1] for one in looks):  # known people may have been saved without
        x = np.concatenate([one.embedding[rows] for one, rows in zip(looks, full, strict=True)])
        squared = np.sum(x**2, axis=1)
        a, b = _BY_EMBEDDING
        near = _of_nearest(x, lambda dot, rows: np.sqrt(np.maximum(squared[rows, None] + squared - 2 * dot, 0)))
        return np.clip(a + b * near, -_BOUND, _BOUND)
    x = np.concatenate([one.face[rows] for one, rows in zip(looks, full, strict=True)])
    skin, hair, worn = (np.array([np.median(getattr(one, key), axis=0) for one in looks]) for key in _COLOURS)
    a, face, of_skin, of_hair, of_worn = _BY_LOOK
    odds = a - face * _of_nearest(x, lambda dot, rows: -dot)
    odds += of_skin * np.minimum(_far(skin), _MOST_SKIN) + of_hair * np.minimum(_far(hair), _MOST_HAIR)
    for i, one in enumerate(worn):
        odds[i] += of_worn * 0.5 * np.sum((worn - one) ** 2 / (worn + one + 1e-9), axis=1)
    return np.clip(odds, -_BOUND, _BOUND)


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


def _follows(tracks: Sequence[Seen]) -> Mask:
    """(T, T) tracks of one shot of which one begins where the other has ended."""
    shot, first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("shot", "first", "stop"))
    begins, ends = (np.array([getattr(one, key) for one in tracks]) for key in ("begins", "ends"))
    far = np.hypot(*(ends[:, None, :2] - begins[:, :2]).transpose(2, 0, 1))
    near = far < 0.7 * np.maximum(ends[:, None, 2], begins[:, 2])
    found = near & (shot[:, None] == shot) & (stop[:, None] <= first)
    return np.asarray(found | found.T)


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
