"""Probabilistic subspaces: Moghaddam, PAMI 24 (2002); Zhou, Chellappa & Moghaddam (ICME 2003), eq. 14.

A Gaussian whose covariance has s principal directions e_i with variances lambda_i, and the variance rho in all others:

    log Q(x) = -1/2 sum_i (q_i^2 / lambda_i + log 2 pi lambda_i) - err^2 / (2 rho) - (d - s) / 2 log 2 pi rho

with q_i = e_i' (x - mean) and err^2 = |x - mean|^2 - sum_i q_i^2. Two slips of the print: rho is the mean of the d - s
eigenvalues that are left (not of d - q), and err^2 is measured after the mean is removed, as q_i is.

The eigenvalues that are left, of n pictures, fall short of what a new picture leaves over: by (n - 1 - s) / (n - 1)
where all are independent, and by far more where they are frames of a few clips. So rho is, unless `printed` is asked
for, what maximises the density of pictures held out: the mean of err^2 / (d - s) of each, reconstructed from those of
other people. With many people both are the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.types import Array

Patches: TypeAlias = NDArray[np.float32]
Residual: TypeAlias = Literal["held_out", "printed"]

LEAST_RHO = 1e-3  # of the variance of a patch: noise of a camera, about one grey level
FOLDS = 10


@dataclass(frozen=True, eq=False)
class Subspace:
    """Mean (d,), orthonormal rows `vectors` (s, d) with variances `values` (s,), and `rho` in all other directions.

    Raises ValueError for what is no such density.
    """

    mean: Patches
    vectors: Patches
    values: Array
    rho: float

    def __post_init__(self) -> None:
        s, d = len(self.values), len(self.mean)
        if self.mean.ndim != 1 or self.values.ndim != 1 or self.vectors.shape != (s, d) or s > d or not d:
            raise ValueError(f"{self.vectors.shape} directions, {self.values.shape} variances, mean {self.mean.shape}")
        if not all(np.isfinite(a).all() for a in (self.mean, self.vectors, self.values)):
            raise ValueError("a number is not finite")
        if not (0.0 < self.rho < math.inf and (self.values > 0.0).all()):
            raise ValueError("a variance is not above 0")
        if s and np.abs(self.vectors.astype(np.float64) @ self.vectors.T - np.eye(s)).max() > 1e-3:
            raise ValueError("the directions are not orthonormal")

    @property
    def d(self) -> int:
        return len(self.mean)

    @property
    def log_constant(self) -> float:
        """log Q(mean)."""
        s = len(self.values)
        return -0.5 * float(np.log(2 * math.pi * self.values).sum() + (self.d - s) * math.log(2 * math.pi * self.rho))

    def log_density(self, y: NDArray[np.floating[Any]]) -> Array:
        """(N,): log Q of y (N, d), eq. 14."""
        centred = np.asarray(y, np.float64) - self.mean
        q = centred @ self.vectors.T.astype(np.float64)
        error = np.maximum((centred**2).sum(1) - (q**2).sum(1), 0.0) if len(self.values) < self.d else 0.0
        return np.asarray(self.log_constant - 0.5 * ((q**2 / self.values).sum(1) + error / self.rho))


@dataclass(frozen=True, eq=False)
class Fitted:
    """A subspace of all rows, and those of all rows but a fold: `without[k]` has not seen the rows of fold k."""

    whole: Subspace
    without: tuple[Subspace, ...]


def fit_subspace(
    x: NDArray[np.floating[Any]],
    folds: Sequence[NDArray[np.bool_]] = (),
    *,
    energy: float = 0.9,
    centred: bool = False,
    residual: Residual = "held_out",
    basis: Array | None = None,
) -> Fitted:
    """The subspace of rows x (n, d): as many components as hold `energy` of the variance, at most half of the rank.

    `folds[k]` (n,) is true for the rows that are held out together; a fold of no row or of all of them holds nothing
    out, and where all are such, rho is as printed. `centred`: the mean is 0 by construction, and is not estimated. All
    subspaces have the one rho. `basis` (r, d), orthonormal, of a space that all rows are in, saves time where r is far
    below d. Raises ValueError without rows.
    """
    d = x.shape[1]
    if basis is not None:
        x = x @ basis.T
    whole = _components(x, energy, centred, d)
    parts = [_components(x[~fold], energy, centred, d) if fold.any() and not fold.all() else whole for fold in folds]
    rho = whole.remaining
    errors = [part.errors(x[fold]) for part, fold in zip(parts, folds, strict=True) if part is not whole]
    if residual == "held_out" and errors:
        rho = max(rho, float(np.concatenate(errors).mean()))
    rho = max(rho, LEAST_RHO)
    return Fitted(whole.subspace(rho, basis), tuple(part.subspace(rho, basis) for part in parts))


def folds_by(labels: NDArray[np.intp], most: int = FOLDS) -> list[NDArray[np.bool_]]:
    """Masks (n,) of the rows to hold out, a label together, `most` masks at most; none with fewer than two labels."""
    known, index = np.unique(labels, return_inverse=True)
    if len(known) < 2:
        return []
    return [index % most == k for k in range(min(most, len(known)))]


@dataclass(frozen=True, eq=False)
class _Components:
    mean: Array
    vectors: Array
    values: Array
    remaining: float  # sum of the eigenvalues that are left, over d - s
    d: int

    def errors(self, x: NDArray[np.floating[Any]]) -> Array:
        """(n,): what a row leaves over, err^2 / (d - s)."""
        centred = x - self.mean
        left = (centred**2).sum(1) - ((centred @ self.vectors.T) ** 2).sum(1)
        return np.asarray(left / max(self.d - len(self.values), 1))

    def subspace(self, rho: float, basis: Array | None) -> Subspace:
        # a principal direction varies no less than those that were left out
        values = np.maximum(self.values, rho)
        mean, vectors = (self.mean, self.vectors) if basis is None else (self.mean @ basis, self.vectors @ basis)
        # the sign of an eigenvector is arbitrary: its largest entry is positive
        largest = np.abs(vectors).argmax(axis=1)
        vectors = vectors * np.sign(vectors[np.arange(len(vectors)), largest])[:, None]
        return Subspace(mean.astype(np.float32), vectors.astype(np.float32), values, rho)


def _components(x: NDArray[np.floating[Any]], energy: float, centred: bool, d: int) -> _Components:
    """Of rows x (n, r), which stand for rows of d numbers."""
    n, r = x.shape
    if not n:
        raise ValueError("no rows to learn from")
    mean = np.zeros(r) if centred else x.mean(0, dtype=np.float64)
    rows = x - mean
    freedom = n if centred else max(n - 1, 1)
    # of the smaller of the two products, which have the same eigenvalues
    values, vectors = np.linalg.eigh((rows @ rows.T if n < r else rows.T @ rows) / freedom)
    values = np.maximum(values[::-1], 0.0)
    total = values.sum()
    rank = int((values > 1e-9 * max(total, 1e-12)).sum())
    enough = int(np.searchsorted(np.cumsum(values), energy * total)) + 1
    s = min(enough, max(rank // 2, 1), rank)
    vectors = vectors[:, ::-1][:, :s]
    if n < r:
        vectors = rows.T @ vectors / np.sqrt(values[:s] * freedom)
    return _Components(mean, vectors.T, values[:s], float(values[s:].sum()) / max(d - s, 1), d)
