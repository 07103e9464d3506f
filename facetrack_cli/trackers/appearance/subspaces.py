"""Probabilistic subspaces: Moghaddam, PAMI 24 (2002); Zhou, Chellappa & Moghaddam (ICME 2003), eq. 14.

A Gaussian whose covariance has s principal directions e_i with variances lambda_i, and the variance rho in all others:

    log Q(x) = -1/2 sum_i (q_i^2 / lambda_i + log 2 pi lambda_i) - err^2 / (2 rho) - (d - s) / 2 log 2 pi rho

with q_i = e_i' (x - mean) and err^2 = |x - mean|^2 - sum_i q_i^2. Two slips of the print: rho is the mean of the d - s
eigenvalues that are left (not of d - q), and err^2 is measured after the mean is removed, as q_i is.

The eigenvalues that are left are less than what a new image leaves over, by far where the images are frames of a few
clips. So rho is what maximises the density of images held out: the mean of err^2 / (d - s) of each, reconstructed from
those of other people. Where nothing is held out, rho is as printed.

Of many rows only their moments are kept, in the coordinates of a basis (`Moments`): of up to MAX_DIRECTIONS rows it
spans all, of more the largest directions. Of the other directions the lengths of the rows tell the variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Mask

Rows: TypeAlias = NDArray[np.float32]
Reals: TypeAlias = NDArray[np.floating[Any]]
MIN_RHO = 1e-3  # of the variance of a patch: noise of a camera, about one grey level
FOLDS = 10
ENERGY = 0.9  # share of the variance that a subspace keeps
MAX_DIRECTIONS = 256  # of a basis; of ten people's patches what is beyond holds about 1 % of the variance
MAX_ROWS = 1500  # from which a basis is found


@dataclass(frozen=True, eq=False)
class Subspace:
    """Mean (d,), orthonormal rows `vectors` (s, d) with variances `values` (s,), and `rho` in all other directions."""

    mean: Rows
    vectors: Rows
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
        rest = (self.d - len(self.values)) * math.log(2 * math.pi * self.rho)
        return -0.5 * float(np.log(2 * math.pi * self.values).sum() + rest)

    def log_density(self, y: Reals) -> Array:
        """(N,): log Q of y (N, d), eq. 14."""
        centred = np.asarray(y, np.float64) - self.mean
        q = centred @ self.vectors.T.astype(np.float64)
        error = np.maximum((centred**2).sum(1) - (q**2).sum(1), 0.0) if len(self.values) < self.d else 0.0
        return np.asarray(self.log_constant - 0.5 * ((q**2 / self.values).sum(1) + error / self.rho))

    @property
    def precision(self) -> tuple[Array, float, Array]:
        """Rows v (s, d), p and w (s,): the inverse of the covariance is p I + v' diag(w) v."""
        plain = 1.0 / self.rho if len(self.values) < self.d else 0.0
        return self.vectors.astype(np.float64), plain, 1.0 / self.values - plain

    def log_densities(self, y: Array, faces: Array) -> Array:
        """(N, P): log Q of the differences of y (N, d) to faces (P, d), which are not written out."""
        v, plain, weight = self.precision
        faces = faces + self.mean
        a, b = y @ v.T, faces @ v.T
        here, there = (plain * np.einsum("nd,nd->n", rows, rows) + (q**2) @ weight for rows, q in ((y, a), (faces, b)))
        square = here[:, None] + there - 2.0 * (plain * (y @ faces.T) + (a * weight) @ b.T)
        return np.asarray(self.log_constant - 0.5 * square)


@dataclass(frozen=True, eq=False)
class Fitted:
    """The subspace of all rows, and one subspace per fold: `without[k]` has not seen the rows of fold k."""

    whole: Subspace
    without: tuple[Subspace, ...]


@dataclass(frozen=True, eq=False)
class Moments:
    """Of `count` rows: sums of coordinates (r,) and of their products (r, r), and of squared lengths of whole rows."""

    count: int
    total: Array
    products: Array
    square: float

    @staticmethod
    def of(z: Array, square: Array) -> Moments:
        """Of coordinates z (n, r) and squared lengths (n,)."""
        return Moments(len(z), z.sum(0), z.T @ z, float(square.sum()))

    def __sub__(self, other: Moments) -> Moments:
        """Of these rows without the others, which are among them."""
        count, square = self.count - other.count, self.square - other.square
        return Moments(count, self.total - other.total, self.products - other.products, square)


def common_basis(x: Array, most: int = MAX_DIRECTIONS) -> Array | None:
    """Orthonormal rows (r, d), r at most `most`: the largest directions of rows x (n, d); None for all directions."""
    n, d = x.shape
    if d <= most:
        return None
    if n <= most:
        return np.asarray(np.linalg.svd(x, full_matrices=False)[2])
    if min(n, d) > MAX_ROWS:
        x = x[np.linspace(0, n - 1, MAX_ROWS).astype(int)]
    if d <= len(x):
        return np.ascontiguousarray(np.linalg.eigh(x.T @ x)[1][:, : -most - 1 : -1].T)
    largest = np.linalg.eigh(x @ x.T)[1][:, : -most - 1 : -1]
    return np.asarray(np.linalg.qr(x.T @ largest)[0].T)


def fit_subspace(
    x: Reals, folds: Sequence[Mask] = (), *, energy: float = ENERGY, centred: bool = False, basis: Array | None = None
) -> Fitted:
    """The subspace of rows x (n, d): as many components as hold `energy` of the variance, at most half of the rank.

    `folds[k]` (n,) is true for the rows that are held out together; a fold of no row or of all of them holds nothing
    out. `centred`: the mean is 0 by construction. All subspaces have the same rho. `basis` (r, d), orthonormal, of a
    space that the rows are nearly in, saves time. Raises ValueError without rows.
    """
    rows: Array = np.asarray(x, np.float64)
    z: Array = rows if basis is None else rows @ basis.T
    square = np.einsum("nd,nd->n", rows, rows)
    without = [Moments.of(z[~fold], square[~fold]) for fold in folds]
    return fit_moments(Moments.of(z, square), without, x.shape[1], energy=energy, centred=centred, basis=basis)


def fit_moments(
    all_rows: Moments, without: Sequence[Moments], d: int, *, energy: float = ENERGY, centred: bool, basis: Array | None
) -> Fitted:
    """As `fit_subspace`, from the moments of all rows of d numbers and of the rows `without` each fold."""
    whole = _Components.of(all_rows, energy, centred, d)
    parts = [_Components.of(m, energy, centred, d) if 0 < m.count < all_rows.count else whole for m in without]
    held = [(part, all_rows - moments) for part, moments in zip(parts, without, strict=True) if part is not whole]
    rho = whole.remaining
    if held:
        rho = max(rho, sum(part.errors(rows) for part, rows in held) / sum(rows.count for _, rows in held))
    rho = max(rho, MIN_RHO)
    return Fitted(whole.subspace(rho, basis), tuple(part.subspace(rho, basis) for part in parts))


def folds_by(labels: NDArray[np.intp]) -> list[Mask]:
    """Masks (n,) of the rows to hold out, a label together, FOLDS masks at most; none with fewer than two labels."""
    known, index = np.unique(labels, return_inverse=True)
    return [index % FOLDS == k for k in range(min(FOLDS, len(known)))] if len(known) > 1 else []


@dataclass(frozen=True, eq=False)
class _Components:
    mean: Array
    vectors: Array
    values: Array
    remaining: float  # sum of the eigenvalues that are left, over d - s
    d: int

    @staticmethod
    def of(rows: Moments, energy: float, centred: bool, d: int) -> _Components:
        """Of rows of d numbers."""
        n = rows.count
        if not n:
            raise ValueError("no rows to learn from")
        mean = np.zeros_like(rows.total) if centred else rows.total / n
        freedom = n if centred else max(n - 1, 1)
        values, vectors = np.linalg.eigh((rows.products - n * np.outer(mean, mean)) / freedom)
        values = np.maximum(values[::-1], 0.0)
        # the lengths of the rows include directions that are not in the basis
        total = max(float(rows.square - n * mean @ mean) / freedom, float(values.sum()))
        rank = int((values > 1e-9 * max(total, 1e-12)).sum())
        enough = int(np.searchsorted(np.cumsum(values), energy * total)) + 1
        s = min(enough, max(rank // 2, 1), rank)
        left = max(total - float(values[:s].sum()), 0.0)
        return _Components(mean, vectors[:, ::-1][:, :s].T, values[:s], left / max(d - s, 1), d)

    def errors(self, rows: Moments) -> float:
        """What rows leave over, the sum of err^2 / (d - s)."""
        along = self.vectors @ self.mean
        length = rows.square - 2.0 * self.mean @ rows.total + rows.count * self.mean @ self.mean
        kept = np.einsum("si,ij,sj->", self.vectors, rows.products, self.vectors, optimize=True)
        kept += -2.0 * along @ (self.vectors @ rows.total) + rows.count * along @ along
        return max(float(length - kept), 0.0) / max(self.d - len(self.values), 1)

    def subspace(self, rho: float, basis: Array | None) -> Subspace:
        # a principal direction varies at least as much as the directions left out
        values = np.maximum(self.values, rho)
        mean, vectors = (self.mean, self.vectors) if basis is None else (self.mean @ basis, self.vectors @ basis)
        # the sign of an eigenvector is arbitrary: its largest entry is positive
        largest = np.abs(vectors).argmax(axis=1)
        vectors = vectors * np.sign(vectors[np.arange(len(vectors)), largest])[:, None]
        return Subspace(mean.astype(np.float32), np.ascontiguousarray(vectors, np.float32), values, rho)
