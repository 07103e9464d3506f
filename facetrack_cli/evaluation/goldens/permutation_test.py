"""A permutation test of many statistics at once: do K runs belong with S others?

If nothing changed, all S + K runs are exchangeable, whatever their distribution. So what is computed of the K tested
against the rest is computed of thousands of random picks of K among all of them too, and a rank among these under
`ALPHA` fails. A false alarm has probability `ALPHA` at most, for any number of statistics and any tails; what it takes
is that the runs are placed (centre, scale, covariance) by all of them together, as everything here is.
"""

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array

ALPHA: Final = 3e-4
SPLITS: Final = 10_000  # picks of K runs; the first of them is the tested one
BEND: Final = 3.0  # in robust standard deviations: runs beyond it count by the logarithm
FAR: Final = 8.0  # where a run without a value stands
SHRUNK: Final = 0.1  # towards no correlation
Picks: TypeAlias = NDArray[np.float32]


class Placed(NamedTuple):
    """F statistics of N runs in robust standard deviations: z (N, F) = (values - median) / scale."""

    z: Array
    median: Array
    scale: Array


class Largest(NamedTuple):
    """The test of the largest |z|. `far` (F,): |z| in units of the critical one, above 1 outside the band; `mean` of
    the tested runs as placed, `centre` and `half` width of the bands (F,) of the others.
    """

    far: Array
    p: float
    mean: Array
    centre: Array
    half: Array


class Joint(NamedTuple):
    """The test of the distance. `far` in units of the critical one; `shares` (F,): what each statistic adds, of 1."""

    far: float
    p: float
    shares: Array


def picks_of(k: int, s: int) -> Picks:
    """(SPLITS, K + S): which runs are picked, 1 or 0. The tested runs come first, and the first row picks them."""
    rng = np.random.default_rng(0)
    out = np.zeros((SPLITS, k + s), np.float32)
    out[0, :k] = 1
    chosen = np.argsort(rng.random((SPLITS - 1, k + s)), axis=1)[:, :k]
    np.put_along_axis(out[1:], chosen, np.float32(1), axis=1)
    return out


def place(values: Array, least: Array) -> Placed:
    """values (N, F) by median and MAD, the scale at least `least` (F,); a run without a value (nan) stands far out."""
    with np.errstate(all="ignore"):
        centre = np.nan_to_num(median_of_runs(values))
        scale = np.maximum(np.nan_to_num(1.4826 * median_of_runs(np.abs(values - centre))), least)
    return Placed(np.nan_to_num((values - centre) / scale, nan=FAR), centre, scale)


def bend(z: Array) -> Array:
    """Pull in what is beyond BEND, so that one run that is lost for good does not speak for all; monotone."""
    away = np.abs(z)
    return np.asarray(np.where(away < BEND, z, np.sign(z) * (BEND + 0.5 * np.log(np.maximum(away, BEND) / BEND))))


def unbend(v: float) -> float:
    """The inverse of `bend`."""
    return v if abs(v) < BEND else math.copysign(BEND * math.exp(min(2 * (abs(v) - BEND), 20.0)), v)


def largest(values: Array, which: Picks) -> Largest:
    """Test the largest |z| over statistics, values (N, F): means of K against means of the others."""
    v = values.astype(np.float32)
    k = int(which[0].sum())
    n = len(v) - k
    sums, squares = which @ v, which @ v**2
    mean, centre = sums / k, (v.sum(axis=0) - sums) / n
    variance = ((v**2).sum(axis=0) - squares) / n - centre**2
    # not less than the robust one, which is 1: a few runs that happen to be alike are no measure
    error = np.sqrt(np.maximum(variance * n / (n - 1), 1.0) * (1 / k + 1 / n))
    z = (mean - centre) / error
    critical, p = _rank(np.abs(z).max(axis=1))
    tested, mean, centre, error = (np.asarray(row[0], dtype=float) for row in (z, mean, centre, error))
    return Largest(np.abs(tested) / critical, p, mean, centre, critical * error)


def joint(values: Array, which: Picks) -> Joint:
    """Test the Mahalanobis distance of means, values (N, F): what single statistics hide that go together otherwise."""
    centred = values - values.mean(axis=0)
    covariance = centred.T @ centred / (len(values) - 1)
    variance = np.maximum(np.diag(covariance), 1.0)
    covariance = (1 - SHRUNK) * covariance
    np.fill_diagonal(covariance, variance)
    k = int(which[0].sum())
    sums = which @ centred
    away = sums / k - (centred.sum(axis=0) - sums) / (len(values) - k)
    solved = np.linalg.solve(covariance, away.T).T
    distance = np.sqrt(np.maximum((away * solved).sum(axis=1), 0.0))
    critical, p = _rank(distance)
    shares = away[0] * solved[0]
    return Joint(float(distance[0]) / critical, p, shares / max(float(shares.sum()), 1e-12))


def _rank(found: NDArray[np.floating]) -> tuple[float, float]:
    """What the tested pick, the first, must exceed to be among the first ALPHA * SPLITS; and its probability."""
    critical = float(np.sort(found[1:])[-round(ALPHA * SPLITS)])
    return max(critical, 1e-9), float(np.mean(found >= found[0]))


def median_of_runs(values: Array) -> Array:
    """(F,) over the runs (N, F) that have a value; nan where none has."""
    known = np.isfinite(values).any(axis=0)
    out = np.full(values.shape[1], np.nan)
    out[known] = np.nanmedian(values[:, known], axis=0)
    return out
