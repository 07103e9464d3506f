"""The sections of a recipe that follows the points of a face inside of its head.

Ours, around the filter of Patras & Pantic (FG 2004): the published one is that of a head at rest. No numerics are
imported here.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe.correlation_filter import Box, CorrelationFilter, Guided, Rate, Share, VisibleWalk
from facetrack_cli.recipe.sections import LengthPerPart, Likelihood, Motion, Refusal, Section
from facetrack_cli.recipe.times import FRAMES

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import ParticleFilter


DetectorName: TypeAlias = Literal["haar", "yunet"]
DETECTORS: tuple[DetectorName, ...] = ("haar", "yunet")


class Detections(Section):
    """A detector of faces that measures the points every so many frames."""

    every: Annotated[int, Field(ge=1, le=1000), FRAMES] = 3
    """Frames from one look for the face to the next; while it is lost, the whole frame is searched as often."""
    by: DetectorName | Literal["auto"] = "auto"
    """OpenCV's Haar cascades or YuNet (of the extra `detect`); auto: what found the start, else the better one
    that is installed."""


class Head(Section):
    """The head that carries the points: a box, followed by a correlation filter."""

    target: Box = Box(type="box")
    """The box of the face."""
    motion: VisibleWalk
    """How it moves."""
    likelihood: CorrelationFilter
    """How it looks."""
    filter: Guided = Guided(type="guided", particles=100)
    """Its particle filter."""
    lost_below: Share = 0.5
    """The head is lost while its confidence is below this, and all points with it."""
    detections: Detections | None = Detections()
    """Detections as measurements of the points; null: none."""


class RestingWalk(Motion):
    """A random walk drawn back to rest, a_i = rest_i + keep (a_i^- - rest_i) + N(0, sigma), of first order (ours).

    At rest is the shape of the first frame, carried by the head.
    """

    engine = "facetrack_cli.tracking.models.motion:resting_walk"
    goes_with = ("points",)
    type: Literal["resting_walk"]
    """Each part stays where it was, up to noise, and is drawn back to the shape of the start."""
    sigma: LengthPerPart
    """Standard deviation of a part's step from frame to frame, along x and along y."""
    keep: Share = 0.98
    """Share of the distance from the place at rest that is left after a frame; 1: the published random walk."""

    def mismatches(self, whole: ParticleFilter) -> Iterable[Refusal]:
        yield from self.sigma.refusals(("motion", "sigma"), whole.points)


class BackgroundRatio(Likelihood):
    """Windows as in `colour_ratio`, whose scale follows from what windows beside the part score (ours)."""

    engine = "facetrack_cli.tracking.models.likelihoods.background_ratio:BackgroundRatio.build"
    goes_with = ("points",)
    type: Literal["background_ratio"]
    """Likelihood ratio of the part against windows beside it, of a part that may be hidden."""
    max_samples: Annotated[int, Field(ge=5)] | None = None
    """Samples along a side of a window at most: a larger one is read from a reduced frame; null: every pixel."""
    adapt: Rate = 0.05
    """Learning rate of the second template, which follows the part while it is visible; 0: only the first frame's."""
