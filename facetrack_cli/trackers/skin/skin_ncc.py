"""Face by skin colour and pattern (Gonzalez & Collet, "Face Tracking using a Combination of Colour and Pattern Matching
Based on Particle Filter", section 4).

    rho = sum over R_ext of p(skin)  -  sum over R_int of p(skin)                      (eq. 5, 6, 9; by eq. 7 and 8)
    NCC = correlation of the box with the template of the start                       (eq. 10, see ncc.py)
    p   ~ exp( -(k - rho / NCC)^2 / (2 sigma^2) )                                                           (eq. 11)

R_int is the box times `inner`, R_ext a frame around it of equal area: together a box with sides sqrt(2) as long. rho is
divided by the area of R_int, so that it lies in -1..1 at any scale. Beyond the frame nothing is skin.

rho is most negative where the face is, -1 at best, so that rho / NCC prefers the worse match. Hence `cost`:

    printed   v = rho / NCC              as in eq. 11, for k = v at the start: a target value, not an extreme
    shifted   v = (1 + rho) / NCC        positive and least at the face, so that k = 0 makes its least value the best
    product   v = rho max(NCC, 0)        beyond the paper: most negative where there is skin and the match is good

NCC^`exponent` stands for NCC. Of skin alone v = rho (shifted: 1 + rho), of NCC alone v = NCC^`exponent`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Particles, factor_for
from facetrack_cli.engine.kernels.affine import boxes_extent
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.skin import ncc as matching
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.colour import learn_skin, note
from facetrack_cli.trackers.skin.settings import SkinNccSettings

MIN_NCC = 0.01  # what divides is at least this: a match of zero or below is as bad as can be, not of the other sign
MIN_RHO = 0.05  # a start with hardly more skin within than around cannot scale a distance
MAX_EXACT_PIXELS = 2**23  # pixels whose sum, each up to 255, an int32 holds


@dataclass(frozen=True, eq=False)
class SkinPattern:
    """`table` (256, 256) uint8, 255 p at [Cb, Cr]; `rho` of the start; `k`, what v is compared with; notes on it."""

    table: NDArray[np.uint8] | None
    template: matching.Template | None
    rho: float
    k: float
    notes: tuple[str, ...]


@dataclass(frozen=True)
class SkinNcc(Likelihood):
    """`size`: width and height of the box at scale 1, in pixels."""

    settings: SkinNccSettings
    size: tuple[float, float]

    @classmethod
    def build(cls, settings: SkinNccSettings, context: Context) -> SkinNcc:
        return cls(settings, context.placed.size)

    def init(self, frame: Frame, x0: Array) -> SkinPattern:
        """The skin's colour and the template of the box at x0 (1, 6). InputError if nothing of it is in the frame."""
        notes, table, template = [], None, None
        skin, ncc, k = self.settings.skin, self.settings.ncc, self.settings.k
        if skin is not None:
            cx, cy, s = x0[0, :3].tolist()
            w, h = (side * s for side in self.size)
            model = learn_skin(frame, (cx - 0.5 * (w - 1), cy - 0.5 * (h - 1), w, h), least_share=skin.least_share)
            table = model.table
            notes.append(note(model))
        if ncc is not None:
            template = matching.learn_template(frame, self.size, x0, ncc.max_size)
            if template.first.var() < matching.MIN_VARIANCE:
                notes.append("the face's box is of one grey level throughout, so that no pattern can be matched")
        learned = SkinPattern(table, template, 0.0, 0.0, tuple(one for one in notes if one))
        rho = 0.0 if skin is None else float(self.rho(learned, frame, x0[None])[0])
        k = float(self._values(learned, frame, x0[None])[0]) if k is None else k
        return replace(learned, rho=rho, k=k)

    def score(self, learned: SkinPattern, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """-(k - v)^2 / (2 sigma^2) of boxes x (N, 1, 6) -> (N, 1) (eq. 11); parents do not matter."""
        off = learned.k - self._values(learned, frame, x)
        return np.asarray((off * off / (-2.0 * self.settings.sigma**2))[:, None])

    def distances(self, learned: SkinPattern, frame: Frame, x: Array) -> Array:
        """(N, 1), 0..1, of boxes x (N, 1, 6): the mean over the cues.

        Skin: 0 where rho is that of the start or less, 1 where it is 0 or more. Template: 1 less the zero-mean NCC.
        """
        found = []
        if self.settings.skin is not None:
            found.append(1.0 - np.clip(-self.rho(learned, frame, x) / max(-learned.rho, MIN_RHO), 0.0, 1.0))
        if learned.template is not None:
            found.append(1.0 - np.maximum(matching.correlate(learned.template, frame, x)[1], 0.0))
        return np.asarray(np.mean(found, axis=0)[:, None])

    def learn(self, learned: SkinPattern, frame: Frame, state: Array, particles: Particles) -> SkinPattern:
        if self.settings.ncc is None or learned.template is None:
            return learned
        return replace(learned, template=matching.adapted(learned.template, self.settings.ncc, frame, state))

    def rho(self, learned: SkinPattern, frame: Frame, x: Array) -> Array:
        """(R_ext - R_int) / area of R_int, eq. 9, of boxes x (N, 1, 6) -> (N,), -1..1; 0 of what is no box."""
        skin = self.settings.skin
        assert skin is not None and learned.table is not None
        factor = factor_for(max(self.size), skin.max_size)
        w, h = (skin.inner * side for side in self.size)
        reach = math.sqrt(2.0) * w, math.sqrt(2.0) * h
        extent = boxes_extent(np.ascontiguousarray(x[:, 0, :3]), *reach, *frame.size)
        image, left, top = frame.reduced(factor, extent)
        # the frame may return a larger part: no more of it than the boxes cover
        height, width = image.shape[:2]
        x0, y0 = min(int(extent[0] - left) // factor, width - 1), min(int(extent[1] - top) // factor, height - 1)
        x1, y1 = int(extent[2] - left) // factor + 2, int(extent[3] - top) // factor + 2
        shown = kernel.skin_map(image[y0:y1, x0:x1], learned.table)
        integral = cv2.integral(shown, sdepth=cv2.CV_32S if shown.size <= MAX_EXACT_PIXELS else cv2.CV_64F)
        inner, outer, area = kernel.nested(x, w, h, factor, left + x0 * factor, top + y0 * factor)
        sums = kernel.differences(integral, inner, outer)
        rho = (sums[:, 1] - 2.0 * sums[:, 0]) / np.where(area > 0.0, 255.0 * area, 1.0)
        return np.asarray(np.clip(rho, -1.0, 1.0))

    def _values(self, learned: SkinPattern, frame: Frame, x: Array) -> Array:
        """v of boxes x (N, 1, 6) -> (N,)."""
        ncc, cost = self.settings.ncc, self.settings.cost
        rho: Any = 1.0 if self.settings.skin is None else self.rho(learned, frame, x)
        shifted = 1.0 + rho if cost == "shifted" else rho
        if ncc is None or learned.template is None:
            return np.asarray(shifted)
        match = matching.correlate(learned.template, frame, x)[0 if ncc.mean == "keep" else 1]
        if self.settings.skin is None or cost == "product":
            return np.asarray(rho * np.maximum(match, 0.0) ** ncc.exponent)
        return np.asarray(shifted / np.maximum(match, MIN_NCC) ** ncc.exponent)
