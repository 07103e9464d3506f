"""The sections that several trackers share: filters, the random walk, targets whose scale is bounded.

`engine/filters.py` has the filters side by side, `engine/motion.py` the walk.

Sections and equations are those of Patras & Pantic, "Particle Filtering with Factorized Likelihoods for Tracking Facial
Features", FG 2004.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe.sections import FilterSettings, LengthPerPart, MotionSettings, Refusal, TargetSettings

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import ParticleFilterSettings

BOX = "box"  # the one part of a target that is followed as a box
Factor: TypeAlias = Annotated[float, Field(gt=0, le=100)]
MAX_COMPARED_PARTICLES = 2_000  # particles that are compared with each other: memory grows with their square


class ResampledSettings(FilterSettings):
    """A filter that picks particles by their weights."""

    particles: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of particles, K in the paper; of `independent`: for each part."""
    resampling: Literal["systematic", "residual", "multinomial", "stratified"] = "systematic"
    """How particles are picked by their weights."""


class SirSettings(ResampledSettings):
    """Sampling/importance resampling over the joint state (section 2); weights are p(y|s), or p(y|s) p(s)."""

    engine = "facetrack_cli.engine.filters:sir"
    goes_with = ("points", "region", "cloud", "affine")
    type: Literal["sir"]


class AuxiliarySettings(ResampledSettings):
    """Auxiliary particle filter over the joint state (Pitt & Shephard 1999); observes p(y|s), or p(y|s) p(s)."""

    engine = "facetrack_cli.engine.filters:auxiliary"
    goes_with = ("points", "region", "cloud", "affine")
    type: Literal["auxiliary"]
    look_ahead: Literal["draw", "mean"] = "draw"
    """What a particle is picked by: the likelihood at a draw of its transition, as published, or at its mean."""


class LooksAheadSettings(ResampledSettings):
    """A filter that steps each part on its own."""

    look_ahead: Literal["draw", "mean", "none"] = "draw"
    """What a part is picked by: the likelihood at a draw of its transition, as published, at its mean, or none."""


class FactorizedSettings(LooksAheadSettings):
    """Proposes from g(alpha) = prod_i p(alpha_i|Y), the product of the parts' posteriors; reweights (section 2.1)."""

    engine = "facetrack_cli.engine.filters:factorized"
    goes_with = ("points",)  # it resamples parts apart, and the other targets are one part
    type: Literal["factorized"]
    reweight: Literal["prior", "transition", "both"] = "prior"
    """By the shape prior (eq. 11), by the particles of the last frame (eq. 7), or, beyond the paper, by both."""
    from_prior: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of a part's sub-particles that is proposed from the prior given the other parts; as published 0."""

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        by_prior, add = self.reweight == "prior", "needs a prior; add a prior section, or write"
        if not by_prior and self.particles > MAX_COMPARED_PARTICLES:
            most = f"give {MAX_COMPARED_PARTICLES:,} at most, not {self.particles:,}"
            yield Refusal(("filter", "particles"), f"reweight: {self.reweight} compares every two particles; {most}")
        elif self.reweight != "transition" and whole.prior is None:
            yield Refusal(("filter", "reweight"), f"filter.reweight: {self.reweight} {add} reweight: transition")
        elif self.from_prior > 0 and whole.prior is None:
            yield Refusal(("filter", "from_prior"), f"filter.from_prior above 0 {add} 0")
        elif self.from_prior > 0 and not by_prior:
            goes = "goes with reweight: prior; eq. 7 knows the motion model alone"
            yield Refusal(("filter", "from_prior"), f"filter.from_prior above 0 {goes}")


class IndependentSettings(LooksAheadSettings):
    """An auxiliary particle filter for each part on its own (section 4, the paper's baseline)."""

    engine = "facetrack_cli.engine.filters:factorized"
    goes_with = ("points",)
    reweight: ClassVar[str] = "none"
    from_prior: ClassVar[float] = 0.0
    type: Literal["independent"]

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        if whole.prior is not None:
            message = 'filter type "independent" makes no use of a prior; remove it, or write prior: null'
            yield Refusal(("prior",), message)


class RandomWalkSettings(MotionSettings):
    """Zero-order motion with Gaussian noise: p(alpha_i | alpha_i^-) = alpha_i^- + N(0, sigma) (section 3.3)."""

    engine = "facetrack_cli.engine.motion:random_walk"
    goes_with = ("points", "region", "cloud")
    type: Literal["random_walk"]
    sigma: LengthPerPart
    """Standard deviation of a part's step from frame to frame, along x and along y."""
    scale: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Of a region: standard deviation of its scale's step, 1 being its size at the start; 0: its size stays."""

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        yield from self.sigma.refusals(("motion", "sigma"), whole.points or (BOX,))
        if self.scale and whole.target.type != "region":
            message = f"motion.scale is that of a region; a target of type {whole.target.type} has none: remove it"
            yield Refusal(("motion", "scale"), message)


class ScaledSettings(TargetSettings):
    """A target whose scale is bounded, [least, largest], in terms of the size at the start."""

    if TYPE_CHECKING:
        scale: tuple[float, float]

    def mistakes(self) -> Iterable[Refusal]:
        if not self.scale[0] < 1 < self.scale[1]:
            message = "target.scale is [least, largest], with 1, the size at the start, between them"
            yield Refusal(("scale",), message)
