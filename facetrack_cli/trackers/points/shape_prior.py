"""The shape prior of Patras & Pantic, section 3.3: a Parzen density over the relative positions of the parts (eq. 11).

A hypothesis s is registered to the training shapes by

    q(s)_i = ((s_i - s_n) - (s0_i - s0_n)) / L0

with n the stable part (the nose), s0 the first frame, L0 the distance of two parts in it (the mouth's width): the
displacement of every part since the first frame, seen from the nose, in mouth widths. A training shape h_j is the same
of an annotated frame. With M shapes of K parts, d_j = |q(s) - h_j| and the kernel's standard deviation sigma,

    log_density(s) = log (1/M) sum_j exp(-d_j^2 / (2 sigma^2)),

without the constant -(K - 1) log(2 pi (sigma L0)^2) of a density in pixels of the other parts given the stable one. The
printed eq. 11 writes d(q(s_k)), h_j; taken is d(q(s_k), h_j) of the text below it.

A prior is fitted to annotated clips: ground truth, or trajectories that somebody has checked. In every file, each
target's first frame in which all parts are seen is its neutral one; every such frame gives one training shape. Of many,
those are kept that are far from each other, so that a clip which smiles for a second keeps the smile.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError, RecipeError, UsageError
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array
from facetrack_cli.engine.protocols import Prior
from facetrack_cli.engine.spaces import Context
from facetrack_cli.recipe.load import resolve_file
from facetrack_cli.trackers.points.point_kernels import LANES, PADDING, parzen
from facetrack_cli.trackers.points.settings import ParzenSettings
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned

KIND = Kind("facetrack-shape-prior", 1, "shape prior", "facetrack prior fit")
DEFAULT = "mouth_prior.npz"
MIN_DISTANCE = 0.01  # mouth widths; a shape nearer than this to one that is kept adds nothing
MIN_SIGMA = 0.05  # mouth widths; a narrower kernel would punish a tracker's own noise


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """Training shapes h_j, (M, K, 2): displacements since the first frame, relative to the part `stable`.

    Their unit is the distance of the two parts named by `scale` in the first frame. Raises ValueError for what is none.
    """

    parts: tuple[str, ...]
    shapes: Array
    stable: str
    scale: tuple[str, ...]

    def __post_init__(self) -> None:
        if problem := _names_problem(self.parts, self.stable, self.scale):
            raise ValueError(problem)
        if self.shapes.ndim != 3 or self.shapes.shape[1:] != (len(self.parts), 2) or not len(self.shapes):
            raise ValueError(f"shapes of {self.shapes.shape} where (M, {len(self.parts)}, 2) belongs")
        if not (np.abs(self.shapes) <= 100.0).all():
            raise ValueError("a shape is not finite, or a part moves more than 100 mouth widths: they are no pixels")

    def save(self, path: Path) -> None:
        """Writes an .npz of plain arrays, whole or not at all; equal priors give equal bytes. Raises OutputError."""
        names = {name: np.array(getattr(self, name)) for name in ("parts", "stable", "scale")}
        KIND.write(path, {**names, "shapes": np.ascontiguousarray(self.shapes, "<f8")})


def _names_problem(parts: Sequence[str], stable: str, scale: Sequence[str]) -> str | None:
    """Why parts of these names make no prior, or None."""
    if len(parts) >= 2 and len(set(parts)) == len(parts) and len(set(scale)) == 2 and {stable, *scale} <= set(parts):
        return None
    rule = "each part is named once, with the stable one and the two of the scale among them"
    return f"{rule}; here are {', '.join(parts)}, with {stable} and {', '.join(scale)}"


def default_prior_path() -> Path:
    """The prior that is shipped: beside the recipes in the wheel, or in the source tree's configs/."""
    return shipped_folder() / DEFAULT


def load_prior(path: Path) -> ShapePrior:
    """The prior in a file that `save` wrote. Raises InputError for anything else; nothing in the file is executed."""
    return KIND.read(path, _from_arrays)


def _from_arrays(stored: Stored) -> ShapePrior:
    shapes = np.asarray(stored.reals("shapes", 3), np.float64)
    return ShapePrior(stored.texts("parts"), shapes, stored.text("stable"), stored.texts("scale"))


def build(settings: ParzenSettings, context: Context) -> "BoundPrior":
    """The prior of a recipe, for its target's parts and where they begin."""
    prior = load_prior(resolve_file(context.recipe, settings.file, f"{context.above}prior.file"))
    try:
        return BoundPrior(prior, context.settings.points, context.placed.x0, settings.sigma)
    except RecipeError as e:
        raise context.error("prior.file", str(e)) from None
    except InputError as e:
        raise InputError(f"{context.start.origin}: {e}") from None


class BoundPrior(Prior):
    """A prior for `parts` in the tracker's order, at `first` (K, 2) pixels in the first frame; `sigma`: mouth widths.

    x is (N, K, 2) in pixels; lengths are pixels throughout. Raises RecipeError if the parts are not the prior's,
    InputError if the first frame gives no scale.

    Given the other parts, the Parzen density of one part is a mixture with one component for each shape j:

    - a part i that is not the stable one: mean x_n + (s0_i - s0_n) + L0 h_ji, standard deviation sigma L0, weight
      exp(-|q(x) - h_j|^2 / (2 sigma^2)) over the other parts alone;
    - the stable part n: each other part k says where it would be, r_jk = x_k - (s0_k - s0_n) - L0 h_jk. The exponent
      sum_k |r_jk - x_n|^2 splits into (K - 1) |x_n - mean_k r_jk|^2 + sum_k |r_jk - mean_k r_jk|^2: mean of the r_jk,
      standard deviation sigma L0 / sqrt(K - 1), and a weight from the second sum, which is the squared distance between
      x and h_j after the means over the other parts are taken off both.
    """

    def __init__(self, prior: ShapePrior, parts: Sequence[str], first: Array, sigma: float) -> None:
        parts = list(parts)
        if sorted(parts) != sorted(prior.parts):
            parted = f"the shape prior is of {', '.join(prior.parts)}, and the recipe tracks {', '.join(parts)}"
            raise RecipeError(f"{parted}; fit a prior with `facetrack prior fit --parts` or change the parts")
        left, right = (first[parts.index(name)] for name in prior.scale)
        self.first, self.length, self.sigma = np.array(first, np.float64), float(np.hypot(*(right - left))), sigma
        if not self.length > 0.0:
            remedy = "so the shape prior has no scale; move them apart in the init file"
            raise InputError(f"{' and '.join(prior.scale)} are at the same place in the first frame, {remedy}")
        self.shapes = prior.shapes[:, [prior.parts.index(name) for name in parts]]
        self.stable, self._width = parts.index(prior.stable), sigma * self.length
        self.moving = [k for k in range(len(parts)) if k != self.stable]

    @cached_property  # the prior of a face has no use for tables
    def _all(self) -> tuple[Any, ...]:
        return self._table(self.moving, self.stable)

    @cached_property
    def _without(self) -> list[tuple[Any, ...]]:
        others = ([k for k in self.moving if k != part] for part in range(len(self.first)))
        return [self._table(rest, -1 if k == self.stable else self.stable) for k, rest in enumerate(others)]

    def _table(self, parts: list[int], stable: int) -> tuple[Any, ...]:
        """What the kernels need to compare hypotheses with all shapes over some of the parts."""
        h = self.shapes[:, parts] / self.sigma
        if stable < 0:
            h = h - h.mean(1, keepdims=True)
        flat = h.reshape(len(h), -1).T.astype(np.float32)
        bias = np.full(-(-len(h) // LANES) * LANES, PADDING)
        bias[: len(h)] = -0.5 * (flat**2).sum(0)
        # in rows: along columns the kernels would not vectorise
        padded = np.ascontiguousarray(np.pad(flat, ((0, 0), (0, len(bias) - len(h)))))
        return np.array(parts, np.int64), self.first, stable, self._width, padded, bias

    def log_density(self, x: Array) -> Array:
        """(N,): eq. 11 in logs, divided by the number of shapes; at most 0, right to 1e-5, or 1e-6 of large ones."""
        sums, _ = parzen(np.ascontiguousarray(x, np.float64), *self._all, np.empty(0))
        return np.asarray(sums - math.log(len(self.shapes)))

    def propose(self, rng: np.random.Generator, x: Array, part: int) -> Array:
        """(N, 2): part `part` drawn from the prior given the other parts of each particle; x[:, part] is not read."""
        x = np.ascontiguousarray(x, np.float64)
        u, noise, spread = rng.random(len(x)), rng.standard_normal((len(x), 2)), self._width
        chosen = parzen(x, *self._without[part], u)[1]
        if part == self.stable:
            centre = (x - self.first - self.length * self.shapes[chosen])[:, self.moving].mean(1)
            spread /= math.sqrt(len(self.moving))
        else:
            centre = x[:, self.stable] - self.first[self.stable] + self.length * self.shapes[chosen, part]
        return np.asarray(self.first[part] + centre + spread * noise, np.float64)


def fit_prior(
    paths: Sequence[Path],
    parts: Sequence[str] | None = None,
    stable: str = "nose",
    scale: tuple[str, str] = ("mouth_left", "mouth_right"),
    max_shapes: int = 500,
) -> tuple[ShapePrior, tuple[tuple[Path, int, int], ...]]:
    """A prior of `parts` (all that the first file has, if None) from ground truth or trajectory files.

    With it each file, the number of its frames, and of those in which every part is seen: rows that are hidden, absent,
    lost or without a position do not count. Raises UsageError or InputError.
    """
    tables = [read_trajectory(path) for path in paths]
    names = tuple(dict.fromkeys(part for _, part in tables[0].names) if parts is None else parts)
    if problem := _names_problem(names, stable, scale):
        raise UsageError(f"{problem}; name others with --parts, --stable or --scale")
    read = [_shapes_of(path, table, names, stable, scale) for path, table in zip(paths, tables, strict=True)]
    every = np.concatenate([shapes for _, shapes in read])
    prior = ShapePrior(names, every[_spread_out(every.reshape(len(every), -1), max_shapes)], stable, scale)
    return prior, tuple((path, frames, len(shapes)) for path, (frames, shapes) in zip(paths, read, strict=True))


def suggested_sigma(prior: ShapePrior) -> float:
    """A kernel's standard deviation, in mouth widths: the mean distance of a shape to its nearest neighbour."""
    flat = prior.shapes.reshape(len(prior.shapes), -1)
    nearest = [np.partition(((flat - shape) ** 2).sum(1), 1)[1] for shape in flat if len(flat) > 1]
    return max(float(np.sqrt(nearest).mean()), MIN_SIGMA) if nearest else MIN_SIGMA


def _shapes_of(
    path: Path, trajectory: Trajectory, names: tuple[str, ...], stable: str, scale: tuple[str, str]
) -> tuple[int, Array]:
    """The frames of a file, and its shapes (M, K, 2)."""
    if missing := ", ".join(name for name in names if name not in {part for _, part in trajectory.names}):
        raise InputError(f"{path}: there is no part {missing}; annotate it, or name the parts to learn with --parts")
    every, total = [np.empty((0, len(names), 2))], 0
    left, right = (names.index(name) for name in scale)
    for target in trajectory.targets:
        parts = {part.part: part for part in trajectory.of_target(target)}
        if not {*names} <= {*parts}:
            continue
        frames, columns = aligned([parts[name] for name in names], "x", "y", "status")
        total += len(frames)
        points = np.stack([columns["x"], columns["y"]], axis=2)
        seen = np.isfinite(points).all(axis=(1, 2)) & np.isin(columns["status"], SEEN).all(axis=1)
        moved = points[seen] - points[seen][:1]
        moved -= moved[:, [names.index(stable)]]
        length = math.dist(*points[seen][0, [left, right]]) if len(moved) else 1.0
        far = np.abs(moved).max(axis=(1, 2))
        if length < 1.0 or (far > 10.0 * length).any():
            much = f"{far.max():.0f} pixels away, where {scale[0]} and {scale[1]} are {length:.2f} apart"
            where = f"{path}: frame {frames[seen][far.argmax()]}: a part of {target} moves {much}"
            raise InputError(f"{where}; correct it, or name another --scale")
        every.append(moved / length)
    if not any(map(len, every)):
        remedy = "annotate one, or name the parts to learn with --parts"
        raise InputError(f"{path}: none of its {total} frames shows all of {', '.join(names)}; {remedy}")
    return total, np.concatenate(every)


def _spread_out(flat: Array, most: int) -> list[int]:
    """Indices, in order, of at most `most` rows: the first, then again and again the row farthest from all chosen."""
    chosen = [0]
    nearest = ((flat - flat[0]) ** 2).sum(1)
    while len(chosen) < most:
        index = int(nearest.argmax())
        if nearest[index] < MIN_DISTANCE**2:
            break
        chosen.append(index)
        nearest = np.minimum(nearest, ((flat - flat[index]) ** 2).sum(1))
    return sorted(chosen)
