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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array, checked_name
from facetrack_cli.engine.resampling import logsumexp

Rows: TypeAlias = NDArray[np.float32]
Reals: TypeAlias = NDArray[np.floating[Any]]
NONE: Final = "none"  # what the posterior calls nobody of the gallery
MAX_FRONTAL: Final = 0.5
KIND: Final = Kind("facetrack-gallery", 1, "gallery", "facetrack gallery fit")
_SPACES = ("frontal", "intra", "extra")
_FIELDS: Final = {"mean": "<f4", "vectors": "<f4", "values": "<f8", "rho": "<f8"}


@dataclass(frozen=True, eq=False)
class Subspace:
    """Mean (d,), orthonormal rows `vectors` (s, d) with variances `values` (s,), and `rho` in all other directions."""

    mean: Rows
    vectors: Rows
    values: Array
    rho: float

    def __post_init__(self) -> None:
        s, d = len(self.values), len(self.mean)
        if self.vectors.shape != (s, d) or s > d or not d:
            raise ValueError(f"directions of {self.vectors.shape} do not fit {s} variances of {d} points")
        if not all(np.isfinite(a).all() for a in (self.mean, self.vectors, self.values, self.rho)):
            raise ValueError("a number is not finite")
        if not (self.rho > 0.0 and (self.values > 0.0).all()):
            raise ValueError("a variance is not above 0")

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
        p, d, spaces = len(self.names), self.faces.shape[-1], (self.frontal, self.intra, self.extra)
        if p < 2 or len(set(self.names)) != p:
            raise ValueError("a gallery needs two persons or more, each named once")
        if problem := next(filter(None, map(name_problem, self.names)), None):
            raise ValueError(problem)
        fits = len(self.shape) == 2 and self.faces.shape == (p, math.prod(self.shape)) and min(self.shape) > 0
        if not fits or any(len(space.mean) != d for space in spaces):
            raise ValueError(f"faces of {self.faces.shape} do not fit {p} persons and a template of {self.shape}")
        numbers = (*self.calibration, self.most_frontal, self.threshold, self.errors)
        if not (np.isfinite(self.faces).all() and np.isfinite(numbers).all()):
            raise ValueError("a number is not finite")
        ranged = len(self.counts) == p and min(self.counts) >= 1 and len(self.calibration) == 2
        ranged = ranged and (self.proportion is None or 0.0 < self.proportion < math.inf)
        if not ranged or self.calibration[0] < 0.0 or not 0.0 <= self.most_frontal <= 1.0:
            raise ValueError("counts, proportion or the calibration of p_f are out of range")

    def log_scores(self, patches: Rows, *, sharpness: float = 1.0, none: bool = False) -> tuple[Array, Array]:
        """p_f (N,), 0 of a patch of zeros, and log p_n (N, P) of patches (N, d), with logsumexp 0 over the identities.

        With `none` a column more, of nobody. `sharpness` multiplies the log of eq. 16 (1 as published).
        """
        ratios = self._ratios
        y = np.asarray(patches, np.float32)
        seen = np.einsum("nd,nd->n", y, y).astype(np.float64)
        projected = (y @ (ratios.all if none else ratios.all[:, : ratios.needed])).astype(np.float64)
        space, p, s = self.frontal, len(self.names), len(self.frontal.values)
        q = projected[:, p + 1 : p + 1 + s] - ratios.q_mean
        error = np.maximum(seen - 2.0 * projected[:, p] + ratios.mean_square - (q**2).sum(1), 0.0)
        log_q = space.log_constant - 0.5 * ((q**2) @ (1.0 / space.values) + (s < y.shape[1]) * error / space.rho)
        frontal = self.most_frontal * logistic(log_q, *self.calibration)
        log_ratio = projected[:, :p] + ratios.constant
        if none:
            # what all identities have in common
            both = projected[:, p + 1 + s :] ** 2 @ ratios.signs + seen * ratios.isotropic
            log_ratio = np.concatenate([log_ratio, (self.threshold - both)[:, None]], axis=1)
        log_ratio *= sharpness
        return np.where(seen > 0.0, frontal, 0.0), log_ratio - logsumexp(log_ratio, axis=1)[:, None]

    @cached_property
    def _ratios(self) -> _Ratios:
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
        return _Ratios(every, needed, constant, np.concatenate(signs), isotropic, q_mean, square)

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


class _Ratios(NamedTuple):
    """Eq. 16 multiplied out, so that a patch takes part in one product of matrices only.

    log Q(y - I) is quadratic in y: the linear term is a column for each identity, the quadratic one the same for all.
    Columns of `all`: P of the identities, the mean of frontal faces, its s_f directions, and those of the other spaces,
    each times the root of its weight; `needed` is the number of columns without these.
    """

    all: Rows
    needed: int
    constant: Array
    signs: Array
    isotropic: float
    q_mean: Array
    mean_square: float


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
