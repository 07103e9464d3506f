"""Points and their windows (section 3.1), and a colour template that ignores the strength of the light (eq. 8-10).

Patras & Pantic, FG 2004, section 3.2:

    c(o, q) = o / E{o} - q / E{q}          each window divided by its own mean, over pixels and channels    (eq. 8)
    d(o, q) = E_j{ rho(c_j) }              mean over the window of a robust function, here L1              (eq. 9)
    p(y|a)  = exp(-d / sigma_i)            sigma_i = sigma / E{o_i}, sigma = 1.5 for intensities in 0..255  (eq. 10)

rho is the L1 norm of the colour difference at pixel j, and E_j a mean over pixels, of the sum of rho over three
channels. Our reading, which bears occlusion better, is a mean over channels too: a third of that, as if sigma were
three times as large.

Templates are learned in the first frame and then stay, except where a correction places a part.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Array, Frame, Mask, Start, Whole, factor_for
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context, Placed, PointSpace, size_of_box
from facetrack_cli.trackers.points import point_kernels as windows
from facetrack_cli.trackers.points.settings import ColourRatioSettings, PointsSettings

CHANNELS = 3
MIN_MEAN = 1.0  # dividing by the mean of a darker window would only blow up its noise


def place_points(settings: PointsSettings, start: Start, name: str) -> Placed:
    """Points where the start has them; the unit is the largest distance of two, or the box's size around one."""
    target, parts = start.targets[name], settings.parts
    if missing := ", ".join(part for part in parts if part not in target.points):
        raise InputError(f"{start.origin}: {name} has no point for {missing}; the recipe wants them")
    x0 = np.array([target.points[part] for part in parts], dtype=float)
    unit = size_of_points(x0) if len(parts) > 1 else size_of_box(start, name)
    if not unit:
        raise InputError(f"{start.origin}: all points of {name} are in one place; move them apart")
    sides = [target.windows.get(part) or [side.pixels(unit) for side in settings.window(part)] for part in parts]
    return Placed(PointSpace(np.array(sides)), x0, np.array(sides), unit)


class Templates(NamedTuple):
    """What K parts looked like in the first frame: `ratios`, o / E{o} of each after another; `sigma` (K,) of eq. 10."""

    ratios: NDArray[np.float32]
    sigma: Array


@dataclass(frozen=True, eq=False)
class ColourRatio(Likelihood):
    """Windows of points against those of the first frame."""

    settings: ColourRatioSettings
    context: Context

    @cached_property
    def _groups(self) -> tuple[tuple[int, Whole, Whole, Whole], ...]:
        """By what the frame is reduced, indices (G,) of the parts read so, sides (G, 2) = (w, h), odd, reduced pixels.

        Last offsets (G + 1,): template g is `ratios[offsets[g] : offsets[g + 1]]`.
        """
        windows, most, end = self.context.placed.windows, self.settings.max_samples, 0
        factors = np.array([factor_for(side, most) for side in windows.max(axis=1).tolist()])
        groups = []
        for factor in np.unique(factors).tolist():
            parts = np.flatnonzero(factors == factor)
            # odd, and at least 3, so that a window has a pixel at its centre
            odd = [[max(3, 2 * round((side / factor - 1) / 2) + 1) for side in windows[k]] for k in parts]
            offsets = np.cumsum([end, *(CHANNELS * (w + 1) * h for w, h in odd)])
            groups.append((factor, parts, np.array(odd, np.int64), offsets))
            end = int(offsets[-1])
        return tuple(groups)

    @cached_property
    def _reach(self) -> float:
        """How far any window reaches, in whole pixels of reduced frames."""
        return float(self.context.placed.windows.max()) / 2 + 3 * self._groups[-1][0]

    def init(self, frame: Frame, x0: Array) -> Templates:
        """The templates of K parts at x0 (K, 2)."""
        extent, means, ratios = windows.extent(x0[None], self._reach), np.empty(len(x0)), []
        for factor, parts, sides, _ in self._groups:
            image, left, top = frame.reduced(factor, extent)
            flat, places = windows.flat(image), (x0 - (left, top) - (factor - 1) / 2) / factor
            for k, (w, h) in zip(parts.tolist(), sides.tolist(), strict=True):
                x, y = places[k].tolist()
                o = windows.read_window(flat, x, y, w, h)
                means[k] = max(float(o[:, :w].mean()), MIN_MEAN)
                ratios.append(o.ravel() / np.float32(means[k]))
        return Templates(np.concatenate(ratios), self.settings.sigma / means)

    def score(self, learned: Templates, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p(y | x) of each part, x (N, K, 2) -> (N, K), with the floor if there is one; parents do not matter."""
        log_p = self.distances(learned, frame, x) / -learned.sigma
        floor = self.settings.floor
        return log_p if floor is None else np.asarray(np.logaddexp(log_p, floor))

    def distances(self, learned: Templates, frame: Frame, x: Array) -> Array:
        """d(o_i, q_i) of eq. 9 for windows at x (N, K, 2) -> (N, K)."""
        out, extent = np.empty(x.shape[:2]), windows.extent(x, self._reach)
        # a picture much reduced is made from one reduced less, at least as large
        for factor, parts, sides, offsets in reversed(self._groups):
            image, left, top = frame.reduced(factor, extent)
            template, at = (learned.ratios, offsets, sides, parts), (x, left, top, factor)
            windows.colour_ratio_distances(windows.flat(image), *template, *at, MIN_MEAN, out)
        return out

    def relearn(self, learned: Templates, frame: Frame, x0: Array, parts: Mask) -> Templates:
        """With the templates of `parts` (K,) as they look in `frame` at x0 (K, 2)."""
        seen = self.init(frame, x0)
        fresh = np.concatenate([np.repeat(parts[of], np.diff(offsets)) for _, of, _, offsets in self._groups])
        ratios = np.where(fresh, seen.ratios, learned.ratios)
        return Templates(ratios, learned.sigma + parts * (seen.sigma - learned.sigma))
