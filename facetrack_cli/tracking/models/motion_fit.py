"""The dynamics of motion models learned from annotated tracks: A and B of c_k = A c_{k-1} + B w_k, and sigma of a walk.

Odobez et al. 2003, section 3.2, leaves A and B open ("learned"). Here, for c = (value, speed),

    v_k = d v_{k-1} + e_k,    x_k = x_{k-1} + v_k + u_k,    e ~ N(0, w s^2), u ~ N(0, (1 - w) s^2)

so that A = [[1, d], [0, d]] and B B^T = s^2 [[1, w], [w, w]]. The value has no place that it prefers, hence the 1, an
eigenvalue on the unit circle; the other one is d, within [0, MAX_SPEED]. u is what steps have beside a steady speed.
Without it, as of an AR(2) model of x, both numbers would have one source of noise, and a density on a line alone. With
0 < w < 1, B is lower triangular and of full rank.

What is annotated is y_k = x_k + n_k, n ~ N(0, r s^2): annotators place boxes anew in each frame, and their jitter is no
motion. d, w and r have the greatest likelihood of all y given those before, by a Kalman filter, in which s has a closed
form; they are looked for on a grid that is narrowed again and again. A frame without an annotation is predicted, and
nothing more. Lengths are in units of the mean side of the target's first box, as in recipes; time is in frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import BOX, Array
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory

MAX_SPEED: Final = 0.99  # d; nearer to 1 speeds would add up for seconds
MIN_SIGMA: Final = 1e-3  # of s and of a walk's sigma: a tracker whose noise is 0 follows nothing
MIN_STEPS: Final = 10
MAX_GAP_FRAMES: Final = 25  # frames without an annotation, after which a track begins anew
MAX_PIECE_FRAMES: Final = 500  # frames of a piece of a track, since all pieces are filtered side by side
# d, log(w / (1 - w)) and log10 r, and how they are searched
_BOUNDS: Final = np.array([(0.0, MAX_SPEED), (-4.6, 4.6), (-4.0, 1.0)])  # w from 0.01 to 0.99
_GRID, _ZOOMS, _NARROW = 9, 9, 0.45


class Dynamics(NamedTuple):
    """`speed` d, `share` w, `step` s, and `jitter`, the standard deviation of annotations; in units of the size."""

    speed: float
    share: float
    step: float
    jitter: float

    @property
    def A(self) -> Array:  # noqa: N802 -- as in the paper
        return np.array([[1.0, self.speed], [0.0, self.speed]])

    @property
    def B(self) -> Array:  # noqa: N802
        """(2, 2), lower triangular."""
        return self.step * np.array([[1.0, 0.0], [self.share, np.sqrt(self.share * (1 - self.share))]])

    @property
    def clipped(self) -> bool:
        """Whether the data ask for a speed that hardly fades."""
        return self.speed > MAX_SPEED - 1e-3


class BoxMotion(NamedTuple):
    """What boxes do: `first_order` of `position` and `scale`, and `random_walk` of [sigma, scale]."""

    targets: int
    steps: int
    position: Dynamics
    scale: Dynamics
    walk: tuple[float, float]


class PointMotion(NamedTuple):
    """What points do: sigma of `random_walk` by part, in units of the largest distance between two parts."""

    targets: int
    steps: int
    walk: dict[str, float]


def fit_motion(paths: Sequence[Path], select: str | None = None) -> BoxMotion | PointMotion:
    """The motion in ground truth or checked trajectories; `select` takes one target or part.

    Rows that are hidden, absent, lost or without a place are left out. Raises InputError for too few others, and for
    boxes and points together.
    """
    tables = [choose(read_truth(path), select) for path in paths]
    kinds = {_is_box(one) for table in tables for one in table.parts}
    if len(kinds) > 1:
        raise InputError(f"{paths[0]}: there are boxes and points; choose one of them with --target NAME/PART")
    named = ", ".join(map(str, paths))
    return _of_boxes(tables, named) if True in kinds else _of_points(tables, named)


def fit_dynamics(pieces: Sequence[Array]) -> Dynamics:
    """The dynamics of greatest likelihood of tracks (T,) of a value, nan where it is not known."""
    y = np.full((max(map(len, pieces)), len(pieces)), np.nan)
    for i, piece in enumerate(pieces):
        y[: len(piece), i] = piece - piece[0]
    if not np.nansum(np.diff(y, axis=0) ** 2) > 0:
        return Dynamics(0.0, 0.5, MIN_SIGMA, 0.0)
    low, high = _BOUNDS.T
    for _ in range(_ZOOMS):
        axes = np.linspace(low, high, _GRID, axis=1)
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        likelihood, scale = log_likelihood(y, *_natural(grid))
        at = int(likelihood.argmax())
        reach = _NARROW * (high - low) / 2
        centre = np.clip(grid[at], _BOUNDS[:, 0] + reach, _BOUNDS[:, 1] - reach)
        low, high = centre - reach, centre + reach
    speed, share, ratio = (float(one[0]) for one in _natural(grid[at : at + 1]))
    step = float(np.sqrt(scale[at]))
    return Dynamics(speed, share, max(step, MIN_SIGMA), step * float(np.sqrt(ratio)))


def _natural(grid: Array) -> tuple[Array, Array, Array]:
    """d, w and r (G,) of points of the grid."""
    return grid[:, 0], 1 / (1 + np.exp(-grid[:, 1])), 10 ** grid[:, 2]


def log_likelihood(y: Array, speed: Array, share: Array, ratio: Array) -> tuple[Array, Array]:
    """(G,) log-likelihoods of y (T, S), S tracks that begin at 0 and may have nan, and the s^2 (G,) that each has then.

    The Kalman filter of each candidate and track; at its beginning a track has the speeds that d and w lead to.
    """
    d, w, r = (one[:, None] for one in (speed, share, ratio))
    shape = (len(speed), y.shape[1])
    x, v = np.zeros(shape), np.zeros(shape)
    xx, xv, vv = np.broadcast_to(r, shape), np.zeros(shape), np.broadcast_to(w / (1 - d**2), shape)
    squares, logs, known = np.zeros(len(speed)), np.zeros(len(speed)), 0
    for row in y[1:]:
        v, mixed = d * v, d * (xv + d * vv) + w
        x, xx, xv, vv = x + v, xx + 2 * d * xv + d**2 * vv + 1.0, mixed, d**2 * vv + w
        seen = np.isfinite(row)
        total, off = xx + r, np.where(seen, row - x, 0.0)
        squares += (off**2 / total).sum(axis=1)
        logs += np.log(total[:, seen]).sum(axis=1)
        known += int(seen.sum())
        gain_x, gain_v = (np.where(seen, one / total, 0.0) for one in (xx, xv))
        x, v = x + gain_x * off, v + gain_v * off
        vv, xv, xx = vv - gain_v * xv, xv - gain_v * xx, xx - gain_x * xx
    scale = np.maximum(squares / max(known, 1), 1e-18)
    return -0.5 * (logs + known * (np.log(2 * np.pi * scale) + 1)), scale


def walk_sigma(pieces: Sequence[Array]) -> float:
    """The standard deviation of steps from frame to frame, that of a random walk.

    Jitter n of annotations makes neighbouring steps opposite, with a covariance of -var(n), and adds 2 var(n) to their
    variance; so a negative covariance is added twice.
    """
    steps = [np.diff(piece) for piece in pieces]
    pairs = np.concatenate([one[1:] * one[:-1] for one in steps])
    every, pairs = (one[np.isfinite(one)] for one in (np.concatenate(steps), pairs))
    jitter = min(float(pairs.mean()), 0.0) if len(pairs) else 0.0
    return float(np.sqrt(max(float((every**2).mean()) + 2 * jitter, MIN_SIGMA**2)))


def _is_box(part: Trajectory) -> bool:
    return part.part in ("", BOX)


def _seen(part: Trajectory, *columns: Array) -> Array:
    """(n, 1 + C): frame and columns of the rows in which they are all known, and nothing speaks against them."""
    rows = np.stack([part.frame.astype(np.float64), *columns], axis=1)
    return np.asarray(rows[np.isin(part.status, SEEN) & np.isfinite(rows).all(axis=1)])


def _pieces(rows: Array) -> list[Array]:
    """(n, 1 + C) rows as pieces (T, C), a row a frame, nan where there is none; cut at gaps and at MAX_PIECE_FRAMES."""
    found = []
    frame = rows[:, 0].astype(np.int64)
    begins = np.flatnonzero(np.diff(frame, prepend=-MAX_GAP_FRAMES - 2) > MAX_GAP_FRAMES)
    for these in np.split(rows, begins[1:]):
        at = (these[:, 0] - these[0, 0]).astype(np.int64)
        for first in range(0, int(at[-1]) + 1, MAX_PIECE_FRAMES):
            mine = (at >= first) & (at < first + MAX_PIECE_FRAMES)
            if mine.sum() > 1:
                whole = np.full((int(at[mine][-1] - at[mine][0]) + 1, rows.shape[1] - 1), np.nan)
                whole[at[mine] - at[mine][0]] = these[mine, 1:]
                found.append(whole)
    return found


def _of_boxes(tables: Sequence[Trajectory], named: str) -> BoxMotion:
    pieces, targets = list[Array](), 0
    for one in (part for table in tables for part in table.parts):
        rows = _seen(one, one.x, one.y, np.sqrt(np.maximum(one.w * one.h, 0.0)))
        rows = rows[rows[:, 3] > 0]
        if len(rows):
            pieces += _pieces(np.column_stack([rows[:, 0], rows[:, 1:] / rows[0, 3]]))
            targets += 1
    steps = _enough(pieces, named)
    places = [piece[:, i] for piece in pieces for i in (0, 1)]
    scales = [piece[:, 2] for piece in pieces]
    walk = walk_sigma(places), walk_sigma(scales)
    return BoxMotion(targets, steps, fit_dynamics(places), fit_dynamics(scales), walk)


def _of_points(tables: Sequence[Trajectory], named: str) -> PointMotion:
    pieces: dict[str, list[Array]] = {}
    targets = 0
    for table in tables:
        for target in table.targets:
            seen = {one.part: rows for one in table.of_target(target) if len(rows := _seen(one, one.x, one.y))}
            # the size is that of the first frame that shows them all, as where a recipe begins
            shared = [frame for frame in next(iter(seen.values()), np.empty((0, 3)))[:, 0] if _all_have(seen, frame)]
            if len(seen) < 2 or not shared:
                continue
            size = size_of_points(np.array([rows[rows[:, 0] == shared[0]][0, 1:] for rows in seen.values()]))
            if not size > 0:
                raise InputError(f"{table.path}: frame {shared[0]:.0f}: all parts are at one place; correct them")
            targets += 1
            for part, rows in seen.items():
                pieces.setdefault(part, []).extend(_pieces(np.column_stack([rows[:, 0], rows[:, 1:] / size])))
    steps = _enough([one for each in pieces.values() for one in each], named)
    walk = {part: walk_sigma([one[:, i] for one in each for i in (0, 1)]) for part, each in pieces.items() if each}
    return PointMotion(targets, steps, walk)


def _all_have(seen: dict[str, Array], frame: float) -> bool:
    return all(bool((rows[:, 0] == frame).any()) for rows in seen.values())


def _enough(pieces: Sequence[Array], named: str) -> int:
    """The number of steps from a frame to the next one; InputError if they are too few to learn from."""
    steps = sum(int(np.isfinite(np.diff(piece[:, 0])).sum()) for piece in pieces)
    if steps < MIN_STEPS:
        raise InputError(
            f"{named}: there are {steps} steps between successive visible frames; annotate at least {MIN_STEPS}"
        )
    return steps


def as_yaml(found: BoxMotion | PointMotion) -> str:
    """The section `motion` of a recipe, and what to know of it as comments."""
    targets = f"{found.targets} target{'s' * (found.targets != 1)}"
    head = (
        f"# Learned by facetrack motion fit from {found.steps:,} steps of {targets}; lengths in units of the target's\n"
        "# size at the start, times in frames: for clips of the same frame rate.\n"
    )
    if isinstance(found, PointMotion):
        parts = ", ".join(f"{part}: {sigma:.3g}" for part, sigma in found.walk.items())
        return f"{head}motion:\n  type: random_walk\n  sigma: {{{parts}}}\n"
    both = {"position": found.position, "scale": found.scale}
    lines = [f"  {name}: {{A: {_matrix(one.A)}, B: {_matrix(one.B)}}}\n" for name, one in both.items()]
    notes = [
        f"# As a random walk: {{type: random_walk, sigma: {found.walk[0]:.3g}, scale: {min(found.walk[1], 1):.3g}}}\n",
        f"# Jitter of the annotations, which counts as no motion: {found.position.jitter:.2g} of the size, "
        f"{found.scale.jitter:.2g} of the scale.\n",
    ]
    for name, one in both.items():
        if one.clipped:
            notes.append(f"# The speed of the {name} hardly fades; the eigenvalue of A is clipped to {MAX_SPEED}.\n")
        if one.step <= MIN_SIGMA:
            notes.append(f"# The {name} moves less than the least noise, {MIN_SIGMA}, which is taken.\n")
    return "".join([head, "motion:\n  type: first_order\n", *lines, *notes])


def _matrix(values: Array) -> str:
    return f"[{', '.join(f'[{a:.3g}, {b:.3g}]' for a, b in values.tolist())}]"
