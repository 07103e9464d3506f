"""Each particle is a pixel, weighed by the probability that its colour is skin (Gianni, Collet & Dalle, GW 2007).

As Gonzalez & Collet describe that tracker (section 3), a head or a hand is a cloud of pixels:

    p(y | x) = max(p(c(x) | skin), floor)

with the skin colour of eq. 4, learned from one box in the first frame, such as the face's for head and hands alike.
Beyond the paper: with the floor, a cloud without any skin spreads out and finds some; `max_size` reduces the frame.

Targets of one recipe may exclude each other (`log_weights`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Frame, Particles, Start, factor_for
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context, Estimate, Placed, Space, box_of, check_size, estimate, size_of_box
from facetrack_cli.trackers.points.window_kernels import extent
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.colour import SkinModel, learn_skin
from facetrack_cli.trackers.skin.settings import CloudSettings, ExclusionSettings, SkinCloudSettings

MIDDLE = 0.7  # of the box's sides: what is looked at to tell whether a place is skin
GRID = 9  # points along each side of it


@dataclass(frozen=True)
class CloudSpace(Space):
    """Each particle is a pixel (Gianni et al. 2007): state (1, 2) = (x, y); its box has four deviations a side."""

    smooths = False

    @classmethod
    def place(cls, settings: CloudSettings, start: Start, name: str) -> Placed:
        """All over the target's box, whose mean side is the unit of length."""
        box = check_size(start.origin, name, box_of(start, name))
        windows = np.array([box[2:]])
        return Placed(cls(), cls().at(box), windows, size_of_box(start, name), (0.25, 4.0), windows)

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The covariance of the pixels themselves: they are the target, not hypotheses of its place."""
        return estimate(particles, np.full_like(ess, np.inf), best=best)

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))

    def at(self, box: Box) -> Array:
        return np.array([[*centre(box), 1.0, 0.0, 0.0, 0.0]])


def log_weights(settings: ExclusionSettings, x: Array, footprints: Sequence[Footprint]) -> Array:
    """(N, K): what mutual exclusion adds to log p(y | x) of x (N, K, D) (Gianni, Collet & Dalle 2007).

    Particles are penalised when the objects are close, so that two filters do not track the same skin (Gonzalez &
    Collet, section 3). The papers print no formula. Chosen is, with the other targets j, each an ellipse:

        p(y | x) <- p(y | x) * prod_j (1 - strength * exp(-(d_j(x) / reach)^4 / 2))

    with d_j the distance from the centre of j in half axes of its ellipse, 1 on its outline. By the fourth power the
    whole ellipse is penalised and little outside of it. Where all particles are penalised alike, none is.
    """
    total = np.zeros(x.shape[:2])
    for footprint in footprints:
        half = np.maximum(footprint.half, 1.0)  # of a cloud that has shrunk to a point, a pixel is left
        squared = np.sum(((x[..., :2] - footprint.centre) / (half * settings.reach)) ** 2, axis=2)
        total += np.log1p(-min(settings.strength, 1 - 1e-12) * np.exp(-0.5 * np.minimum(squared, 1e6) ** 2))
    return total


@dataclass(frozen=True)
class SkinCloud(Likelihood):
    """`size`: width and height in pixels at the start; `teacher`: the box that teaches the colour, in pixels."""

    settings: SkinCloudSettings
    size: tuple[float, float]
    teacher: Box

    @classmethod
    def build(cls, settings: SkinCloudSettings, context: Context) -> SkinCloud:
        start, teacher = context.start, settings.learn_from or context.name
        if teacher not in start.targets:
            raise InputError(f"{start.origin}: has no {teacher}, whose colours {context.name} learns from; add its box")
        return cls(settings, context.placed.size, box_of(start, teacher))

    def init(self, frame: Frame, x0: Array) -> SkinModel:
        """The colour of skin in the teacher's box. Raises InputError if nothing of it is in the frame."""
        return learn_skin(frame, self.teacher, least_share=self.settings.least_share)

    def score(self, learned: SkinModel, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, 1): log p(y | x) of x (N, 1, D), x and y first."""
        return np.log(np.maximum(self._skin(learned, frame, x[:, 0, :2]), self.settings.floor))[:, None]

    def learn(self, learned: SkinModel, frame: Frame, state: Array, particles: Particles) -> SkinModel:
        return learned

    def distances(self, learned: SkinModel, frame: Frame, x: Array) -> Array:
        """(N, 1): 1 less the mean probability of skin about each place."""
        steps = np.linspace(-0.5, 0.5, GRID) * MIDDLE
        grid = np.stack(np.meshgrid(steps * self.size[0], steps * self.size[1]), axis=-1).reshape(-1, 2)
        skin = self._skin(learned, frame, (x[:, 0, None, :2] + grid).reshape(-1, 2))
        return np.asarray(1.0 - skin.reshape(len(x), -1).mean(axis=1)[:, None])

    def _skin(self, learned: SkinModel, frame: Frame, xy: Array) -> Array:
        """(N,): p of the pixel at each place xy (N, 2); 0 beyond the frame."""
        factor = factor_for(max(self.size), self.settings.max_size)
        image, left, top = frame.reduced(factor, extent(np.ascontiguousarray(xy)[:, None], 0.0))
        there = (xy - (left, top) - (factor - 1) / 2) / factor
        return np.asarray(kernel.at_points(image, learned.table, there))
