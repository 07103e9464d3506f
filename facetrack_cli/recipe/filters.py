"""The filters that a recipe may name; `tracking/filters.py` has them side by side.

Sections and equations are those of Patras & Pantic, "Particle Filtering with Factorized Likelihoods for Tracking Facial
Features", FG 2004; of `adaptive`, those of Zhou, Chellappa & Moghaddam, ICME 2003.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from facetrack_cli.recipe.affine import MAX_COMPARED_PARTICLES, AffineWalk
from facetrack_cli.recipe.sections import Filter, Refusal, Steps

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import ParticleFilter


class Resampled(Filter):
    """A filter that picks particles by their weights."""

    particles: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of particles, K in the paper; of `independent`: for each part."""
    resampling: Literal["systematic", "residual", "multinomial", "stratified"] = "systematic"
    """How particles are picked by their weights."""


class Sir(Resampled):
    """Sampling/importance resampling over the joint state (section 2); weights are p(y|s), or p(y|s) p(s)."""

    engine = "facetrack_cli.tracking.filters:sir"
    goes_with = ("points", "region", "cloud", "affine")
    type: Literal["sir"]


class Auxiliary(Resampled):
    """Auxiliary particle filter over the joint state (Pitt & Shephard 1999); observes p(y|s), or p(y|s) p(s)."""

    engine = "facetrack_cli.tracking.filters:auxiliary"
    goes_with = ("points", "region", "cloud", "affine")
    type: Literal["auxiliary"]
    look_ahead: Literal["draw", "mean"] = "draw"
    """What a particle is picked by: the likelihood at a draw of its transition, as published, or at its mean."""


class LooksAhead(Resampled):
    """A filter that steps each part on its own."""

    look_ahead: Literal["draw", "mean", "none"] = "draw"
    """What a part is picked by: the likelihood at a draw of its transition, as published, at its mean, or none."""


class Factorized(LooksAhead):
    """Proposes from g(alpha) = prod_i p(alpha_i|Y), the product of the parts' posteriors; reweights (section 2.1)."""

    engine = "facetrack_cli.tracking.filters:factorized"
    goes_with = ("points",)  # it resamples parts apart, and the other targets are one part
    type: Literal["factorized"]
    reweight: Literal["prior", "transition", "both"] = "prior"
    """By the shape prior (eq. 11), by the particles of the last frame (eq. 7), or, beyond the paper, by both."""
    from_prior: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of a part's sub-particles that is proposed from the prior given the other parts; as published 0."""

    def mismatches(self, whole: ParticleFilter) -> Iterable[Refusal]:
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


class Independent(LooksAhead):
    """An auxiliary particle filter for each part on its own (section 4, the paper's baseline)."""

    engine = "facetrack_cli.tracking.filters:factorized"
    goes_with = ("points",)
    reweight: ClassVar[str] = "none"
    from_prior: ClassVar[float] = 0.0
    type: Literal["independent"]

    def mismatches(self, whole: ParticleFilter) -> Iterable[Refusal]:
        if whole.prior is not None:
            message = 'filter type "independent" makes no use of a prior; remove it, or write prior: null'
            yield Refusal(("prior",), message)


class Adaptive(Filter):
    """All particles around the predicted place, as many as the prediction is worth (figure 1, eq. 17)."""

    engine = "facetrack_cli.tracking.filters:adaptive"
    goes_with = ("affine",)
    type: Literal["adaptive"]
    particles: Annotated[int, Field(ge=1)]
    """J_0."""
    adapt: bool = True
    """J_t follows eq. 17; false: always J_0."""
    entropy: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """d of eq. 17, by which there are more or fewer as the identity becomes less or more certain."""
    least: Annotated[int, Field(ge=1)] = 10
    """Never fewer particles than this."""
    centre: bool = False
    """Beyond the paper: the first particle is the predicted place itself."""

    def mismatches(self, whole: ParticleFilter) -> Iterable[Refusal]:
        if self.adapt and isinstance(whole.motion, AffineWalk) and whole.motion.noise is None:
            message = "filter.adapt follows motion.noise, which is null; add noise: {}, or write adapt: false"
            yield Refusal(("filter", "adapt"), message)

    def most(self, whole: ParticleFilter) -> tuple[int, Steps]:
        n, where = super().most(whole)
        if not self.adapt:
            return n, where
        if isinstance(whole.motion, AffineWalk) and whole.motion.noise is not None:
            n = round(n * (whole.motion.noise.most + self.entropy))
        return (self.least, ("filter", "least")) if self.least > n else (n, where)
