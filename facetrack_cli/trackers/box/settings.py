"""The sections of a recipe that follows a box, which may be hidden, by a correlation filter.

Each setting names the paper that it is taken from; the whole is ours. No numerics are imported here.
"""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe import sections

Rate: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Probability: TypeAlias = Annotated[float, Field(gt=0, lt=1)]


class BoxSettings(sections.ScaledSettings):
    """A box that moves, changes its size, and may be hidden: place, scale, velocity, and whether it is visible."""

    engine = "facetrack_cli.trackers.box.hidden_box:VisibleBoxSpace.place"
    type: Literal["box"]
    scale: Annotated[tuple[sections.Factor, sections.Factor], Field(strict=False)] = (0.15, 6.0)
    """The least and the largest size of the box, as factors of its size at the start."""


class VisibleWalkSettings(sections.MotionSettings):
    """A walk of place and log scale with velocity, of a target that may be hidden (a chain of two states)."""

    engine = "facetrack_cli.trackers.box.hidden_box:visible_walk"
    goes_with = ("box",)
    type: Literal["visible_walk"]
    sigma: sections.Length
    """Standard deviation of a step along x and along y, beside the velocity."""
    hidden: sections.Length = sections.Length(0.1)
    """The same of a target that is hidden."""
    scale: Annotated[float, Field(gt=0, le=1)]
    """Standard deviation of the change of the logarithm of the scale."""
    velocity: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Share of the velocity that is left after a frame."""
    acceleration: Annotated[float, Field(ge=0, le=1)] = 0.3
    """Share of a step, as of its standard deviation, that changes the velocity."""
    hide: Probability = 0.02
    """P(hidden | visible in the frame before)."""
    show: Probability = 0.2
    """P(visible | hidden in the frame before)."""
    elsewhere: sections.Share = 0.1
    """How much of `show` is a return at a place that re-detection proposes, and not near the last one."""


class ScalesSettings(sections.Section):
    """The filter of scale (Danelljan et al. 2014, DSST)."""

    count: Annotated[int, Field(ge=3, le=65)] = 25
    """S, how many scales are looked at, an odd number: one of them is the last one."""
    step: Annotated[float, Field(gt=1, le=1.2)] = 1.025
    """a, the ratio of one scale to the next."""
    rate: Rate = 0.025
    """Learning rate."""
    sharpness: Annotated[float, Field(gt=0, le=100)] = 8.0
    """log p(y | s) is this times the logarithm of the response."""


class CorrelationFilterSettings(sections.LikelihoodSettings):
    """A correlation filter's response, calibrated (ours, of ECO, SRDCF, DSST, Staple and LMCF)."""

    engine = "facetrack_cli.trackers.box.correlation_filter:CorrelationFilter"
    goes_with = ("box",)
    type: Literal["correlation_filter"]
    window: Annotated[float, Field(ge=2, le=10)] = 5.0
    """Side of the square window that is looked at, in mean sides of the box (BACF takes 5)."""
    cells: Annotated[int, Field(ge=16, le=80, multiple_of=2)] = 40
    """The window has so many cells along a side, of 4 resampled pixels each."""
    components: Annotated[int, Field(ge=2, le=34)] = 12
    """C, how many principal components of the channels are kept (ECO-HC takes 13)."""
    peak: Annotated[float, Field(gt=0, le=1)] = 0.1
    """sigma_y: standard deviation of the response that is wanted, in mean sides of the box."""
    rate: Rate = 0.02
    """Learning rate of the memory, at P(visible) = 1."""
    every: Annotated[int, Field(ge=1, le=10)] = 3
    """The appearance is learned in every so many frames, as much more at a time (ECO: every 6th)."""
    hidden_rate: sections.Share = 0.05
    """How much is learned while the target is hidden, in terms of what is learned while it is visible."""
    scales: ScalesSettings = ScalesSettings()
    """How the scale is found."""
    colour: sections.Share = 0.3
    """Share of the per-pixel colours in the response, where they tell the target from its surroundings (Staple)."""
    sharpness: Annotated[float, Field(gt=0, le=100)] = 5.0
    """log p(y | x) is this times the logarithm of the response."""
    evidence: Annotated[float, Field(ge=0, le=20)] = 4.0
    """Bound of log p(y | visible) - log p(y | hidden), whatever the height of the response."""
    modes: Annotated[int, Field(ge=1, le=10)] = 3
    """How many peaks of the response are proposed at most."""
    detect: Annotated[int, Field(ge=0, le=50)] = 3
    """While the target is hidden, so many windows elsewhere are looked at in a frame."""


class GuidedSettings(sections.FilterSettings):
    """Proposes from the likelihood's modes, the transition, and re-detection; weights are exact (Zhang et al. 2017)."""

    engine = "facetrack_cli.trackers.box.hidden_box:guided"
    goes_with = ("box",)
    type: Literal["guided"]
    particles: Annotated[int, Field(ge=4, le=2_000)]
    """Number of particles."""
    guided: Annotated[float, Field(ge=0, lt=1)] = 0.7
    """Share of the particles that is drawn around the modes."""
