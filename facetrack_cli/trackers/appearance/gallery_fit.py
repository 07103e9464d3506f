"""A gallery learned from images (see `gallery.py`).

Persons are held out in folds: rho, p_f and the threshold are learned from those whom the spaces have not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Array, Mask
from facetrack_cli.trackers.appearance import subspaces
from facetrack_cli.trackers.appearance.gallery import Gallery, logistic, name_problem
from facetrack_cli.trackers.appearance.subspaces import (
    Fitted,
    Moments,
    Reals,
    fit_moments,
    fit_subspace,
    folds_by,
)

Indices: TypeAlias = NDArray[np.intp]
# of a patch: right, down (shares of its sides), degrees, size
_OFF = ((0.3, 0, 0, 1), (-0.3, 0, 0, 1), (0, 0.3, 0, 1), (0, -0.3, 0, 1), (0, 0, 40, 1), (0, 0, -40, 1), (0, 0, 0, 0.6))
MAX_ERRORS = 0.25  # beyond them the user is warned; half is chance
_CHANGES = "how {} with light, expression and pose cannot be learned from it"


def fit_gallery(
    patches: Reals,
    persons: Sequence[str],
    shape: tuple[int, int],
    *,
    images: Sequence[int] | None = None,
    negatives: Reals | None = None,
    proportion: float | None = None,
) -> Gallery:
    """The gallery of patches (n, d), zero mean and unit variance, each of a person; persons in order of their names.

    `images` (n,): the image of each patch, first the image itself, then copies cut a little off; without it each patch
    is an image. `negatives` (m, d) are displaced, turned, scaled; without them they are made of the patches.
    `proportion`: the boxes' width over height. InputError for one person, or no two patches of one.
    """
    x = np.asarray(patches, np.float64)
    if x.ndim != 2 or x.shape[1] != shape[0] * shape[1] or len(x) != len(persons):
        raise ValueError(f"patches of {x.shape} of {len(persons)} persons, and a template of {shape}")
    for name in sorted(set(persons)):
        if problem := name_problem(name):
            raise InputError(f"{problem}; give the folder another name")
    names, who = np.unique(np.array(persons, str), return_inverse=True)
    if len(names) < 2:
        people = f"{len(names)} person{'' if len(names) == 1 else 's'}"
        remedy = "how people differ is learned from two or more; add another person"
        raise InputError(f"a gallery of {people} tells nobody apart: {remedy}")
    of = np.unique(np.arange(len(x)) if images is None else np.asarray(images), return_inverse=True)[1]
    basis = subspaces.common_basis(x)
    samples = Samples(x, who, of, basis)
    own, own_of = samples.to_own()
    if not len(own):
        remedy = "add a second image of somebody, or copies that are cut a little off"
        raise InputError(f"there is one image of each person, and {_CHANGES.format('one face changes')}; {remedy}")
    # persons that are held out together; where that leaves nothing to learn from, images are
    folds = folds_by(who)
    fold = np.argmax(folds, axis=0)
    frontal = fit_subspace(x, folds, basis=basis)
    own_folds = [mask[own_of] for mask in folds]
    able = any(mask.any() and not mask.all() for mask in own_folds)
    intra = fit_subspace(own, own_folds if able else folds_by(of[own_of]), centred=True, basis=basis)
    if not able:
        intra = Fitted(intra.whole, (intra.whole,) * len(folds))
    extra = _fit_others(samples, folds)
    wrong = off_the_mark(x[samples.first], shape) if negatives is None else np.asarray(negatives, np.float64)
    right_q = np.concatenate([space.log_density(x[mask]) for space, mask in zip(frontal.without, folds, strict=True)])
    wrong_q = np.mean([space.log_density(wrong) for space in frontal.without], axis=0)
    threshold, errors = equal_errors(*_genuine_and_strangers(intra, extra, samples, own, fold, own_of))
    counts = tuple(np.bincount(who[samples.first]).tolist())
    return Gallery(
        tuple(map(str, names)), samples.faces.astype(np.float32), (int(shape[0]), int(shape[1])),
        frontal.whole, intra.whole, extra.whole, fit_logistic(right_q, wrong_q), threshold, errors, counts,
        notes=_notes(names.tolist(), counts, errors), proportion=proportion,
    )  # fmt: skip


def _fit_others(samples: Samples, folds: Sequence[Mask]) -> Fitted:
    """The space of differences to others; of what a fold (n,) holds out, neither patches nor faces are used."""
    everybody, anyone = np.ones(len(samples.x), bool), np.ones(len(samples.faces), bool)
    able = len(anyone) > 2  # without one of two nobody is left to differ from
    held = [(mask, np.bincount(samples.who, mask) == 0) for mask in folds]
    if not able:
        held = [(mask, anyone) for mask in folds_by(samples.of)]
    without = [samples.to_others(~mask, others) for mask, others in held]
    whole = samples.to_others(everybody, anyone)
    fitted = fit_moments(whole, without, samples.x.shape[1], centred=True, basis=samples.basis)
    return fitted if able else Fitted(fitted.whole, (fitted.whole,) * len(folds))


def _genuine_and_strangers(
    intra: Fitted, extra: Fitted, samples: Samples, own: Array, fold: Indices, own_of: Indices
) -> tuple[Array, Array]:
    """Log ratios (eq. 16) by spaces that have not seen the person: to it (m,), and the largest to another (n,)."""
    genuine, best, faces = np.empty(len(own)), np.empty(len(samples.x)), samples.faces
    for k, (within, between) in enumerate(zip(intra.without, extra.without, strict=True)):
        mine = fold[own_of] == k
        genuine[mine] = within.log_density(own[mine]) - between.log_density(own[mine])
        mine = fold == k
        x, who = samples.x[mine], samples.who[mine]
        ratios = within.log_densities(x, faces) - between.log_densities(x, faces)
        ratios[np.arange(len(x)), who] = -np.inf
        best[mine] = ratios.max(axis=1)
    return genuine, best


def _notes(names: Sequence[str], counts: Sequence[int], errors: float) -> tuple[str, ...]:
    """What cannot be learned, for the user."""
    found = []
    single = [name for name, count in zip(names, counts, strict=True) if count == 1]
    if single:
        each, their = (" each", "their faces change") if len(single) > 1 else ("", "this face changes")
        found.append(f"{', '.join(single)}: one image{each}: {_CHANGES.format(their)}; add further images")
    if errors > MAX_ERRORS:
        share = f"the equal error rate is {100 * errors:.0f} % for a person who is not in the gallery"
        remedy = "look whether each is in one folder alone, and add people and images"
        found.append(f"by these images people are hardly told apart: {share}; {remedy}")
    return tuple(found)


def fit_logistic(positive: Array, negative: Array) -> tuple[float, float]:
    """Slope (never below 0) and offset of the probability of being positive, both classes equally frequent.

    Platt (1999) with his targets, (n + 1) / (n + 2) and 1 / (n + 2), by Newton's method with steps halved where they do
    not help (Lin, Lin & Weng 2007). A score that says nothing has slope 0 and probability 1/2.
    """
    score = np.concatenate([positive, negative])
    # in units of the middle of both classes, since densities of negatives have no lower bound
    centre = 0.5 * (np.median(positive) + np.median(negative))
    unit = max(0.5 * abs(float(np.median(positive) - np.median(negative))), 1e-9)
    z = np.clip((score - centre) / unit, -50.0, 50.0)
    p, n = len(positive), len(negative)
    target = np.repeat([(p + 1) / (p + 2), 1 / (n + 2)], [p, n])
    weight = np.repeat([0.5 / p, 0.5 / n], [p, n])
    design = np.stack([z, np.ones_like(z)], axis=1)

    def loss(a: Array) -> float:
        t = design @ a
        return float((weight * (np.logaddexp(0.0, t) - target * t)).sum() + 1e-6 * (a @ a))

    a = np.zeros(2)
    for _ in range(100):
        probability = logistic(design @ a, 1.0, 0.0)
        gradient = design.T @ (weight * (probability - target)) + 2e-6 * a
        curvature = (design.T * (weight * probability * (1 - probability))) @ design + 2e-6 * np.eye(2)
        step = np.linalg.solve(curvature, gradient)
        size = 1.0
        while size > 1e-6 and loss(a - size * step) > loss(a):
            size /= 2
        a = a - size * step
        if np.abs(size * step).max() < 1e-9:
            break
    slope = float(a[0] / unit)
    return (slope, float(a[1] - slope * centre)) if a[0] > 0.0 else (0.0, 0.0)


def equal_errors(genuine: Array, impostor: Array) -> tuple[float, float]:
    """The threshold at which as large a share of the genuine is below it as of the impostors above, and that share."""
    at = np.unique(np.concatenate([genuine, impostor]))
    at = np.concatenate([at[:1] - 1.0, (at[1:] + at[:-1]) / 2, at[-1:] + 1.0])
    missed = np.searchsorted(np.sort(genuine), at) / len(genuine)
    passed = 1.0 - np.searchsorted(np.sort(impostor), at) / len(impostor)
    gap = np.abs(missed - passed)
    # the middle of all thresholds that serve as well
    best = np.flatnonzero(gap <= gap.min() + 1e-12)
    k = best[len(best) // 2]
    return float((at[best[0]] + at[best[-1]]) / 2), float((missed[k] + passed[k]) / 2)


@dataclass(frozen=True, eq=False)
class Samples:
    """Patches `x` (n, d), the person `who` (n,) and the image `of` (n,) of each, counted from 0.

    The first patch of an image is the image itself, others are copies cut a little off. `basis`: as in `Moments`.
    """

    x: Array
    who: Indices
    of: Indices
    basis: Array | None = None

    @cached_property
    def first(self) -> Mask:
        """(n,): the images themselves."""
        mask = np.zeros(len(self.x), bool)
        mask[np.unique(self.of, return_index=True)[1]] = True
        return mask

    @cached_property
    def faces(self) -> Array:
        """(P, d): what stands for each person."""
        first = self.first
        return np.stack([stand_in(self.x[first & (self.who == p)]) for p in range(self.who.max() + 1)])

    def to_own(self) -> tuple[Array, Indices]:
        """Differences of patches to the mean of the other images of the person, or to the only one; their index."""
        rows, index, first = [], [], self.first
        for k in range(self.of.max() + 1):
            mine = np.flatnonzero(self.of == k)
            others = first & (self.who == self.who[mine[0]]) & (self.of != k)
            stands = stand_in(self.x[others]) if others.any() else self.x[mine[0]]
            mine = mine if others.any() else mine[1:]
            rows.append(self.x[mine] - stands)
            index.append(mine)
        return np.concatenate(rows), np.concatenate(index)

    def to_others(self, patches: Mask, persons: Mask) -> Moments:
        """Moments, from sums, of the differences of these patches (n,) to the faces of others of these persons (P,)."""
        coordinates, squares, face_coordinates, face_squares, products_of_both = self._sums
        z, who, faces = coordinates[patches], self.who[patches], face_coordinates[persons]
        known = persons[who][:, None]
        apart = np.where(known, face_coordinates[who], 0.0)  # a patch is not compared with its own person
        number = persons.sum() - known[:, 0]
        asked = len(z) - np.bincount(who, minlength=len(persons))[persons]
        cross = z.T @ (faces.sum(0) - apart)
        products = (z.T * number) @ z - cross - cross.T + (faces.T * asked) @ faces
        along = products_of_both[patches]
        between = (along @ persons).sum() - along[np.arange(len(z)), who][known[:, 0]].sum()
        square = number @ squares[patches] - 2.0 * between + asked @ face_squares[persons]
        return Moments(int(number.sum()), number @ z - asked @ faces, products, max(float(square), 0.0))

    @cached_property
    def _sums(self) -> tuple[Array, ...]:
        """Coordinates (n, r) and squared lengths (n,) of patches, the same of faces, and their products (n, P)."""
        of_each = []
        for rows in (self.x, self.faces):
            of_each += [rows if self.basis is None else rows @ self.basis.T, np.einsum("nd,nd->n", rows, rows)]
        return (*of_each, self.x @ self.faces.T)


def stand_in(images: Array) -> Array:
    """(d,): what stands for a person, the mean of the images (k, d), of unit variance again."""
    mean = images.mean(0)
    spread = float(mean.std())
    if len(images) == 1 or spread < 1e-6:
        return np.asarray(images[0])
    return np.asarray((mean - mean.mean()) / spread)


def off_the_mark(x: Array, shape: tuple[int, int]) -> Array:
    """Patches (m, d): each of x (n, d) displaced, turned and made smaller, where the border is repeated."""
    (rows, cols), out = shape, []
    for patch in x.astype(np.float32).reshape(-1, rows, cols):
        for dx, dy, angle, size in _OFF:
            m = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle, size)
            m[:, 2] += np.array([dx * cols, dy * rows])
            moved = warp_affine(patch, m, (cols, rows), cv2.BORDER_REPLICATE).astype(np.float64)
            spread = float(moved.std())
            out.append(((moved - moved.mean()) / spread if spread > 1e-6 else 0.0 * moved).ravel())
    return np.array(out)
