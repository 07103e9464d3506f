"""The values that pass between the parts of the engine.

Axes, everywhere: N particles, K parts, D coordinates a part; x before y; pixels, pixel centres at whole numbers.
Images are (H, W, 3) uint8 in OpenCV's order, blue first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Image: TypeAlias = NDArray[np.uint8]
Status: TypeAlias = Literal["init", "tracked", "lost"]


@dataclass(slots=True)
class Frame:
    """One picture of the source: its 0-based index there, its time in seconds, and its pixels."""

    index: int
    time_s: float
    bgr: Image

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.bgr.shape[1], self.bgr.shape[0]


class Particles(NamedTuple):
    """A weighted sample of the posterior: x (N, K, D) in pixels, log_w (N,) with logsumexp 0."""

    x: Array
    log_w: Array


class Info(NamedTuple):
    """What a filter reports of one step: the effective sample size of each part, (K,), before any final resampling."""

    ess: Array


Box: TypeAlias = tuple[float, float, float, float]  # left, top, width, height
Point: TypeAlias = tuple[float, float]


@dataclass(frozen=True, slots=True)
class TargetStart:
    """Where one target is in the first frame: a box, named points, or both; `windows` override the recipe's (w, h)."""

    box: Box | None = None
    points: Mapping[str, Point] = field(default_factory=dict)
    windows: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Start:
    """Where a track begins: the source frame, each target, and what said so (a file's path, "haar", "--box")."""

    frame: int
    targets: Mapping[str, TargetStart]
    origin: str


@dataclass(frozen=True, slots=True)
class PartResult:
    """The estimate of one part in one frame. (x, y) is the centre of its window of w x h pixels.

    `cov` is the posterior's 2x2 covariance as (xx, xy, yy) in pixels squared.
    """

    name: str
    x: float
    y: float
    w: float
    h: float
    status: Status
    confidence: float
    cov: tuple[float, float, float]
    ess: float
    angle: float | None = None


@dataclass(frozen=True, slots=True)
class TargetResult:
    """The estimate of one target in one frame; `cloud` (n, K, 2) are the particles' centres, for drawing."""

    name: str
    parts: tuple[PartResult, ...]
    particles: int
    cloud: Array
    identity: str | None = None
    identity_prob: float | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """All that the tracker says of one frame."""

    frame: Frame
    targets: tuple[TargetResult, ...]
