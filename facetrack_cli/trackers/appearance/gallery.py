"""Who is who: Zhou, Chellappa & Moghaddam (ICME 2003), sections 3.2 and 3.3.

Three probabilistic subspaces (Moghaddam, PAMI 24, 2002) over patches y of zero mean and unit variance:

    frontal   the patches of the gallery                                  p_f = most / (1 + exp(-a log Q_FFS(y) - b))
    intra     differences between images of one person, both signs        p_n = Q_IPS(y - I_n) / Q_EPS(y - I_n)
    extra     differences between images of different persons             eq. 16

Q is a Gaussian whose covariance has s principal directions e_i with variances lambda_i, and the variance rho in all
others (eq. 14):

    log Q(x) = -1/2 sum_i (q_i^2 / lambda_i + log 2 pi lambda_i) - err^2 / (2 rho) - (d - s) / 2 log 2 pi rho

with q_i = e_i' (x - mean) and err^2 = |x - mean|^2 - sum_i q_i^2. Two slips of the print: rho is the mean of the d - s
eigenvalues that are left (not of d - q), and err^2 is measured after the mean is removed, as q_i is.

What we take the paper to mean, and what is ours:

- Eq. 15 is a density and enters eq. 5 as a probability: a logistic function of log Q, fitted to frontal faces of
  persons that the subspace has not seen, and to patches cut off the mark. With `most` at 1/2 no frame decides alone.
- Eq. 16 is a ratio of densities: it enters normalised over the identities, for each patch.
- I_n is one image in the paper. Of several it is their mean, brought back to unit variance, and a difference is that
  of an image to the mean of the other images of its person, or to that of another person.
- "none of them" is one more identity, whose log ratio is a threshold: that at which as many images of the gallery
  would be taken for nobody, by spaces that have not seen their person, as strangers for somebody.

Where a gallery is learned from images (`fit_gallery`), persons are held out in folds: rho, p_f and the threshold are
learned from those whom the spaces have not seen. The eigenvalues that are left are less than what a new image leaves
over, by far where the images are frames of a few clips. So rho is what maximises the density of images held out: the
mean of err^2 / (d - s) of each, reconstructed from those of other people. Where nothing is held out, rho is as printed.

Rows are kept in the coordinates of a basis: of up to MAX_DIRECTIONS rows it spans all, of more the largest directions.
Of the other directions the lengths of the rows tell the variance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array, Mask, checked_name
from facetrack_cli.engine.resampling import logsumexp

Rows: TypeAlias = NDArray[np.float32]
Reals: TypeAlias = NDArray[np.floating[Any]]
Indices: TypeAlias = NDArray[np.intp]
Fitted: TypeAlias = "tuple[Subspace, list[Subspace]]"
NONE: Final = "none"  # what the posterior calls nobody of the gallery
MAX_FRONTAL: Final = 0.5
KIND: Final = Kind("facetrack-gallery", 1, "gallery", "facetrack gallery fit")
MAX_ERRORS = 0.25  # beyond them the user is warned; half is chance
MIN_RHO = 1e-3  # of the variance of a patch: noise of a camera, about one grey level
FOLDS = 10
ENERGY = 0.9  # share of the variance that a subspace keeps
MAX_DIRECTIONS = 256  # of a basis; of ten people's patches what is beyond holds about 1 % of the variance
MAX_ROWS = 1500  # from which a basis is found
MAX_PAIRS = 10_000  # patches and faces of others that are compared
_CHANGES = "how {} with light, expression and pose cannot be learned from it"
_TITLES: Final = {"frontal": "frontal faces", "intra": "intra-personal", "extra": "extra-personal"}
_SPACES = (*_TITLES,)
_FIELDS: Final = {"mean": "<f4", "vectors": "<f4", "values": "<f8", "rho": "<f8"}


@dataclass(frozen=True, eq=False)
class Subspace:
    """Mean (d,), orthonormal rows `vectors` (s, d) with variances `values` (s,), and `rho` in all other directions."""

    mean: Rows
    vectors: Rows
    values: Array
    rho: float

    @property
    def log_constant(self) -> float:
        """log Q(mean)."""
        rest = (len(self.mean) - len(self.values)) * math.log(2 * math.pi * self.rho)
        return -0.5 * float(np.log(2 * math.pi * self.values).sum() + rest)

    def log_density(self, y: Reals) -> Array:
        """(N,): log Q of y (N, d), eq. 14."""
        return self.log_densities(np.asarray(y, np.float64) - self.mean, -self.mean[None])[:, 0]

    @property
    def precision(self) -> tuple[Array, float, Array]:
        """Rows v (s, d), p and w (s,): the inverse of the covariance is p I + v' diag(w) v."""
        plain = 1.0 / self.rho if len(self.values) < len(self.mean) else 0.0
        return self.vectors.astype(np.float64), plain, 1.0 / self.values - plain

    def log_densities(self, y: Reals, faces: Reals) -> Array:
        """(N, P): log Q of the differences of y (N, d) to faces (P, d), which are not written out."""
        v, plain, weight = self.precision
        faces = faces + self.mean
        a, b = y @ v.T, faces @ v.T
        here, there = (plain * np.einsum("nd,nd->n", rows, rows) + (q**2) @ weight for rows, q in ((y, a), (faces, b)))
        square = here[:, None] + there - 2.0 * (plain * (y @ faces.T) + (a * weight) @ b.T)
        return np.asarray(self.log_constant - 0.5 * square)


@dataclass(frozen=True, eq=False)
class Gallery:
    """Who is known, and how faces differ. P persons, patches of d = rows * cols points, flattened by rows.

    `faces` (P, d) are the I_n. `calibration` is (a, b) of p_f and `most_frontal` its upper bound; `threshold` the log
    ratio of "none of them", and `errors` the equal error rate there. `counts` (P,) are the images of each person,
    `proportion` is the width of a face's box over its height, if known. Raises ValueError for what is no gallery.
    """

    names: tuple[str, ...]
    faces: Rows
    shape: tuple[int, int]
    frontal: Subspace
    intra: Subspace
    extra: Subspace
    calibration: tuple[float, float]
    threshold: float
    errors: float
    counts: tuple[int, ...]
    most_frontal: float = MAX_FRONTAL
    notes: tuple[str, ...] = ()
    proportion: float | None = None

    def __post_init__(self) -> None:
        p, spaces = len(self.names), (self.frontal, self.intra, self.extra)
        if p < 2 or len(set(self.names)) != p:
            raise ValueError("a gallery needs two persons or more, each named once")
        if problem := next(filter(None, map(name_problem, self.names)), None):
            raise ValueError(problem)
        d = math.prod(self.shape) if len(self.shape) == 2 and min(self.shape) > 0 else -1
        fit = (space.mean.shape == (d,) and space.vectors.shape == (len(space.values), d) for space in spaces)
        if self.faces.shape != (p, d) or not all(fit):
            raise ValueError(f"faces and spaces do not fit {p} persons and a template of {self.shape}")
        variances = np.concatenate([[self.proportion or 1.0], *([space.rho, *space.values] for space in spaces)])
        numbers = np.array([self.threshold, self.errors, *self.calibration, *variances])
        arrays = self.faces, numbers, *(array for space in spaces for array in (space.mean, space.vectors))
        if not all(np.isfinite(array).all() for array in arrays):
            raise ValueError("a number is not finite")
        if variances.min() <= 0 or self.proportion == 0 or len(self.counts) != p or not 0 <= self.most_frontal <= 1:
            raise ValueError("variances, counts, proportion or the bound of p_f are out of range")

    def log_scores(self, patches: Rows, *, sharpness: float = 1.0, none: bool = False) -> tuple[Array, Array]:
        """p_f (N,), 0 of a patch of zeros, and log p_n (N, P) of patches (N, d), with logsumexp 0 over the identities.

        With `none` a column more, of nobody. `sharpness` multiplies the log of eq. 16 (1 as published).
        """
        every, needed, constant, signs, isotropic, q_mean, mean_square = self._ratios
        y = np.asarray(patches, np.float32)
        seen = np.einsum("nd,nd->n", y, y).astype(np.float64)
        projected = (y @ (every if none else every[:, :needed])).astype(np.float64)
        space, p, s = self.frontal, len(self.names), len(self.frontal.values)
        q = projected[:, p + 1 : p + 1 + s] - q_mean
        error = np.maximum(seen - 2.0 * projected[:, p] + mean_square - (q**2).sum(1), 0.0)
        log_q = space.log_constant - 0.5 * ((q**2) @ (1.0 / space.values) + (s < y.shape[1]) * error / space.rho)
        frontal = self.most_frontal * logistic(log_q, *self.calibration)
        log_ratio = projected[:, :p] + constant
        if none:
            # what all identities have in common
            both = projected[:, p + 1 + s :] ** 2 @ signs + seen * isotropic
            log_ratio = np.concatenate([log_ratio, (self.threshold - both)[:, None]], axis=1)
        log_ratio *= sharpness
        return np.where(seen > 0.0, frontal, 0.0), log_ratio - logsumexp(log_ratio, axis=1)[:, None]

    @cached_property
    def _ratios(self) -> tuple[Rows, int, Array, Array, float, Array, float]:
        """Eq. 16 multiplied out, so that a patch takes part in one product of matrices only.

        log Q(y - I) is quadratic in y: the linear term is a column for each identity, the quadratic one the same for
        all. Columns are P of the identities, the mean of frontal faces, its s_f directions, and those of the other
        spaces, each times the root of its weight; then the number of columns without these, the constant of each
        identity, signs of the weights, the isotropic part, and projections and square of the frontal mean.
        """
        faces, mean = self.faces.astype(np.float64), self.frontal.mean.astype(np.float64)
        linear, constant = np.zeros_like(faces), np.zeros(len(faces))
        roots, signs, isotropic = [], [], 0.0
        for space, sign in ((self.intra, 1.0), (self.extra, -1.0)):
            v, plain, weight = space.precision
            centred = faces + space.mean
            pulled = plain * centred + (centred @ v.T * weight) @ v
            linear += sign * pulled
            constant += sign * (space.log_constant - 0.5 * (centred * pulled).sum(1))
            roots.append(v * np.sqrt(np.abs(weight))[:, None])
            signs.append(-0.5 * sign * np.sign(weight))
            isotropic -= 0.5 * sign * plain
        columns = np.concatenate([linear, mean[None], self.frontal.vectors, *roots])
        every, needed = np.ascontiguousarray(columns.T, np.float32), len(faces) + 1 + len(self.frontal.values)
        q_mean, square = self.frontal.vectors @ mean, float(mean @ mean)
        return every, needed, constant, np.concatenate(signs), isotropic, q_mean, square

    def save(self, path: Path) -> None:
        """Writes an .npz of plain arrays, whole or not at all; equal galleries give equal bytes. Raises OutputError."""
        arrays: dict[str, NDArray[Any]] = {"names": np.array(self.names)}
        arrays["faces"] = np.ascontiguousarray(self.faces, "<f4")
        for name in ("shape", "calibration", "threshold", "errors", "counts", "most_frontal"):
            arrays[name] = np.array(getattr(self, name), "<i8" if name in ("shape", "counts") else "<f8")
        arrays["notes"] = np.array(self.notes, f"<U{max(map(len, self.notes), default=1)}")
        if self.proportion is not None:
            arrays["proportion"] = np.array(self.proportion, "<f8")
        for name in _SPACES:
            for field, kind in _FIELDS.items():
                arrays[f"{name}_{field}"] = np.array(getattr(getattr(self, name), field), kind, order="C")
        KIND.write(path, arrays)

    def summary(self) -> list[str]:
        """Lines on how much each space keeps, on when a patch counts as a face, and on when a face is a stranger's."""
        lines = []
        for name in _SPACES:
            space: Subspace = getattr(self, name)
            kept, number = float(space.values.sum()), len(space.values)
            share = kept / (kept + space.rho * (space.mean.size - number))
            components = f"{number} component{'s' * (number != 1)}"
            lines.append(f"{_TITLES[name]}: {components}, {100 * share:.0f} % of the variance to be expected")
        (slope, offset), most = self.calibration, self.most_frontal
        half = f"half of its most, {most:g}, at a log density of {-offset / slope:.0f}" if slope else f"{most / 2:.2f}"
        strangers = f"below a log likelihood ratio of {self.threshold:.0f} (equal error rate {100 * self.errors:.0f} %)"
        notes = (f"note: {note}" for note in self.notes)
        return [*lines, f"p_f is {half}{'' if slope else ' for any patch'}", f"strangers: {strangers}", *notes]


def logistic(score: Array, slope: float, offset: float) -> Array:
    """1 / (1 + exp(-(slope score + offset))), without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * (slope * score + offset))))


def name_problem(name: str) -> str | None:
    """Why a person cannot be called this, or None."""
    try:
        checked_name(name)
    except ValueError as e:
        return str(e)
    if name.strip().casefold() == NONE:
        return f"{name!r} stands for nobody of the gallery, and is no name of a person"
    return None


def load_gallery(path: Path) -> Gallery:
    """The gallery in a file that `save` wrote. Raises InputError for anything else; nothing in it is executed."""
    return KIND.read(path, _from_arrays)


def _from_arrays(stored: Stored) -> Gallery:
    fields: dict[str, Any] = {name: stored.texts(name) for name in ("names", "notes")}
    fields |= {name: stored.whole(name) for name in ("shape", "counts")}
    numbers = ("threshold", "errors", "most_frontal", *(["proportion"] if "proportion" in stored else []))
    fields |= {name: stored.number(name) for name in numbers}
    for name in _SPACES:
        mean, vectors = stored.reals(f"{name}_mean", 1), stored.reals(f"{name}_vectors", 2)
        fields[name] = Subspace(mean, vectors, stored.reals(f"{name}_values", 1), stored.number(f"{name}_rho"))
    return Gallery(faces=stored.reals("faces", 2), calibration=tuple(stored.reals("calibration", 1).tolist()), **fields)


# --- learned from images


def fit_gallery(
    patches: Reals,
    persons: Sequence[str],
    shape: tuple[int, int],
    *,
    negatives: Reals,
    images: Sequence[int] | None = None,
    proportion: float | None = None,
) -> Gallery:
    """The gallery of patches (n, d), zero mean and unit variance, each of a person; persons in order of their names.

    `negatives` (m, d) are displaced, turned, scaled. `images` (n,): the image of each patch, first the image itself,
    then copies cut a little off; without it each patch is an image. `proportion`: the boxes' width over height. Raises
    InputError where there are no two patches of one person.
    """
    x = np.asarray(patches, np.float64)
    names, who = np.unique(np.array(persons, str), return_inverse=True)
    _, first, of = np.unique(np.arange(len(x)) if images is None else images, return_index=True, return_inverse=True)
    own, own_of = to_own(x, who, of)
    if not len(own):
        remedy = "add a second image of somebody, or copies that are cut a little off"
        raise InputError(f"there is one image of each person, and {_CHANGES.format('one face changes')}; {remedy}")
    # persons that are held out together; where that leaves nothing to learn from, images are, for rho alone
    folds, by_image = folds_by(who), folds_by(of)
    basis, faces = common_basis(x), np.stack([stand_in(x[first[who[first] == p]]) for p in range(len(names))])
    (z, squares), (face_z, face_squares) = (coordinates(rows, basis) for rows in (x, faces))
    frontal, frontals = fit_subspace(z, squares, folds, basis)
    able = any(mask[own_of].any() and not mask[own_of].all() for mask in folds)
    held = [mask[own_of] for mask in (folds if able else by_image)]
    intra, intras = fit_subspace(*coordinates(own, basis), held, basis, centred=True)
    # of what a fold holds out, neither patches nor faces are used; without one of two nobody is left to differ from
    apart = len(names) > 2
    patch, other = to_others(who)
    held = [mask[patch] | (apart & (np.bincount(who, mask) > 0)[other]) for mask in (folds if apart else by_image)]
    lengths = squares[patch] + face_squares[other] - 2.0 * (x @ faces.T)[patch, other]
    extra, extras = fit_subspace(z[patch] - face_z[other], lengths, held, basis, centred=True)
    right_q = np.concatenate([space.log_density(x[mask]) for space, mask in zip(frontals, folds, strict=True)])
    wrong_q = np.mean([space.log_density(negatives) for space in frontals], axis=0)
    genuine, best = np.empty(len(own)), np.empty(len(x))
    for k, mask in enumerate(folds):  # log ratios (eq. 16) by spaces that have not seen the person
        within, between = intras[k] if able else intra, extras[k] if apart else extra
        genuine[mask[own_of]] = within.log_density(own[mask[own_of]]) - between.log_density(own[mask[own_of]])
        ratios = within.log_densities(x[mask], faces) - between.log_densities(x[mask], faces)
        ratios[np.arange(len(ratios)), who[mask]] = -np.inf  # the largest is to another person
        best[mask] = ratios.max(axis=1)
    threshold, errors = equal_errors(genuine, best)
    counts = tuple(np.bincount(who[first]).tolist())
    return Gallery(
        tuple(map(str, names)), faces.astype(np.float32), (int(shape[0]), int(shape[1])),
        frontal, intra, extra, fit_logistic(right_q, wrong_q), threshold, errors, counts,
        notes=_notes(names.tolist(), counts, errors), proportion=proportion,
    )  # fmt: skip


def _notes(names: Sequence[str], counts: Sequence[int], errors: float) -> tuple[str, ...]:
    """What cannot be learned, for the user."""
    notes = []
    if single := [name for name, count in zip(names, counts, strict=True) if count == 1]:
        each, their = (" each", "their faces change") if len(single) > 1 else ("", "this face changes")
        notes.append(f"{', '.join(single)}: one image{each}: {_CHANGES.format(their)}; add further images")
    if errors > MAX_ERRORS:
        share = f"the equal error rate is {100 * errors:.0f} % for a person who is not in the gallery"
        remedy = "look whether each is in one folder alone, and add people and images"
        notes.append(f"by these images people are hardly told apart: {share}; {remedy}")
    return tuple(notes)


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


def to_own(x: Array, who: Indices, of: Indices) -> tuple[Array, Indices]:
    """Differences of patches x (n, d) to the mean of the other images of the person, or to the only one; their index.

    `who` (n,) are the persons and `of` (n,) the images, from 0; the first patch of an image is the image itself.
    """
    first, rows, index = np.unique(of, return_index=True)[1], [], []
    for k, image in enumerate(first.tolist()):
        copies, others = np.flatnonzero(of == k), first[(who[first] == who[image]) & (first != image)]
        stands = stand_in(x[others]) if others.size else x[image]
        copies = copies if others.size else copies[1:]
        rows.append(x[copies] - stands)
        index.append(copies)
    return np.concatenate(rows), np.concatenate(index)


def stand_in(images: Array) -> Array:
    """(d,): what stands for a person, the mean of the images (k, d), of unit variance again."""
    mean = images.mean(0)
    spread = float(mean.std())
    if len(images) == 1 or spread < 1e-6:
        return np.asarray(images[0])
    return np.asarray((mean - mean.mean()) / spread)


def common_basis(x: Array, most: int = MAX_DIRECTIONS) -> Array:
    """Orthonormal rows (r, d), r at most `most`: the largest directions of rows x (n, d), or all."""
    some = x[np.linspace(0, len(x) - 1, min(len(x), MAX_ROWS)).astype(int)]
    largest = np.linalg.eigh(some @ some.T)[1][:, : -most - 1 : -1]
    return np.asarray(np.linalg.qr(some.T @ largest)[0].T)


def to_others(who: Indices, most: int = MAX_PAIRS) -> tuple[Indices, Indices]:
    """Pairs of a patch, of the persons `who` (n,), and another person: all of them, or `most` of them.

    They are drawn, and the same each time: of evenly spaced ones some persons would never meet some others.
    """
    patch, other = np.nonzero(who[:, None] != np.arange(who.max() + 1))
    some = np.sort(np.random.default_rng(0).permutation(len(patch))[:most])
    return patch[some], other[some]


def coordinates(rows: Array, basis: Array) -> tuple[Array, Array]:
    """Of rows (n, d) those in a basis (n, r), and their squared lengths (n,), which include all other directions."""
    return rows @ basis.T, np.einsum("nd,nd->n", rows, rows)


def fit_subspace(z: Array, squares: Array, folds: Sequence[Mask], basis: Array, *, centred: bool = False) -> Fitted:
    """The subspace of rows, given as `coordinates`, and those that have not seen each fold (n,), in turn.

    A fold of no row or of all holds nothing out. A subspace has as many components as hold ENERGY of the variance, at
    most half of the rank. `centred`: the mean is 0 by construction. All subspaces have the same rho.
    """
    whole = _Components.of(z, squares, centred, basis.shape[1])
    parts = [
        _Components.of(z[~fold], squares[~fold], centred, basis.shape[1]) if 0 < fold.sum() < len(z) else whole
        for fold in folds
    ]
    both = [(part, fold) for part, fold in zip(parts, folds, strict=True) if part is not whole]
    rho = max(whole.remaining, MIN_RHO)
    if both:
        rho = max(rho, sum(part.errors(z[fold], squares[fold]) for part, fold in both) / np.sum([f for _, f in both]))
    return whole.subspace(rho, basis), [part.subspace(rho, basis) for part in parts]


def _about(z: Array, squares: Array, mean: Array) -> tuple[Array, float]:
    """Rows, given as `coordinates`, less a mean (r,), and the sum of their squared lengths then."""
    off = z - mean
    return off, float(np.sum(squares) - np.square(z).sum() + np.square(off).sum())


def folds_by(labels: Indices) -> list[Mask]:
    """Masks (n,) of the rows to hold out, a label together, FOLDS masks at most; none with fewer than two labels."""
    names, index = np.unique(labels, return_inverse=True)
    return [index % FOLDS == k for k in range(min(FOLDS, len(names)))] if len(names) > 1 else []


class _Components(NamedTuple):
    """Principal components in a basis; `remaining`: the sum of the eigenvalues that are left, over d - s, `others`."""

    mean: Array
    vectors: Array
    values: Array
    remaining: float
    others: int

    @staticmethod
    def of(z: Array, squares: Array, centred: bool, d: int) -> "_Components":
        """Of rows of d numbers, given as `coordinates`."""
        mean = np.zeros(z.shape[1]) if centred else z.mean(0)
        off, square = _about(z, squares, mean)
        freedom = len(z) if centred else max(len(z) - 1, 1)
        values, vectors = np.linalg.eigh(off.T @ off / freedom)
        values = np.maximum(values[::-1], 0.0)
        # the lengths of the rows include directions that are not in the basis
        total = max(square / freedom, float(values.sum()))
        rank = int((values > 1e-9 * max(total, 1e-12)).sum())
        enough = int(np.searchsorted(np.cumsum(values), ENERGY * total)) + 1
        s = min(enough, max(rank // 2, 1), rank)
        left, others = max(total - float(values[:s].sum()), 0.0), max(d - s, 1)
        return _Components(mean, vectors[:, ::-1][:, :s].T, values[:s], left / others, others)

    def errors(self, z: Array, squares: Array) -> float:
        """What rows, given as `coordinates`, leave over, the sum of err^2 / (d - s)."""
        off, square = _about(z, squares, self.mean)
        return max(square - float(np.square(off @ self.vectors.T).sum()), 0.0) / self.others

    def subspace(self, rho: float, basis: Array) -> Subspace:
        # a principal direction varies at least as much as the directions left out
        values, vectors = np.maximum(self.values, rho), self.vectors @ basis
        # the sign of an eigenvector is arbitrary: its largest entry is positive
        largest = np.abs(vectors).argmax(axis=1)
        vectors = vectors * np.sign(vectors[np.arange(len(vectors)), largest])[:, None]
        mean = (self.mean @ basis).astype(np.float32)
        return Subspace(mean, np.ascontiguousarray(vectors, np.float32), values, rho)
