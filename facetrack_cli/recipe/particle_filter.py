"""A particle filter in a recipe: what is tracked, how it moves, how it looks, which filter; and what goes with what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import model_validator

from facetrack_cli.recipe.affine import Adaptive, AffineWalk, Appearance, Recognition
from facetrack_cli.recipe.messages import Refusal, Section, refuse
from facetrack_cli.recipe.points import (
    Confidence,
    Factorized,
    Filter,
    Independent,
    Likelihood,
    Motion,
    Points,
    Prior,
    RandomWalk,
    Target,
)
from facetrack_cli.recipe.regions import Product, Region

BOX = "box"  # the one part of a region or a cloud
MOST_HYPOTHESES = 5_000_000  # particles times parts: some gigabytes
MOST_POINTS = 100_000_000  # particles times points of a template: the same
MOST_COMPARED = 2_000  # particles that are compared with each other: memory grows with their square


class ParticleFilter(Section):
    """A particle filter for one target."""

    target: Target
    """What is tracked: the state alpha."""
    motion: Motion
    """How it moves from frame to frame: the transition density p(alpha_i | alpha^-)."""
    likelihood: Likelihood
    """How a part looks: the observation model p(y | alpha_i)."""
    filter: Filter
    """How the particles are proposed, weighted and resampled."""
    prior: Prior | None = None
    """Which shapes are likely: p(alpha); null for none."""
    recognition: Recognition | None = None
    """Who it is, of an affine target; null: nobody is recognised."""
    confidence: Confidence = Confidence()
    """When a part counts as lost, and when as found again."""

    @property
    def points(self) -> tuple[str, ...]:
        return self.target.parts

    @property
    def particles(self) -> int:
        return self.filter.particles

    @property
    def hypotheses(self) -> int:
        return self.filter.particles * max(len(self.target.parts), 1)

    @property
    def judges(self) -> bool:
        given = self.likelihood
        return not isinstance(given, Product) or given.contour is not None or given.histogram is not None

    @model_validator(mode="after")
    def _check(self) -> ParticleFilter:
        refuse(self._mismatched())
        found: list[Refusal] = []
        if isinstance(self.target, Points):
            found += self.target.windows.refusals(("target", "windows"), self.target.parts)
        if isinstance(self.motion, RandomWalk):
            found += self.motion.sigma.refusals(("motion", "sigma"), self.target.parts or (BOX,))
            if self.motion.scale and not isinstance(self.target, Region):
                message = f"motion.scale is that of a region; a target of type {self.target.type} has none: remove it"
                found.append(Refusal(("motion", "scale"), message))
        if self.hypotheses > MOST_HYPOTHESES:
            message = f"particles times parts is {self.hypotheses:,}; no more than {MOST_HYPOTHESES:,} fit into memory"
            found.append(Refusal(("filter", "particles"), message))
        match self.filter:
            case Factorized(reweight="transition", particles=n) if n > MOST_COMPARED:
                message = (
                    f"reweight: transition compares every two particles; give {MOST_COMPARED:,} at most, not {n:,}"
                )
                found.append(Refusal(("filter", "particles"), message))
            case Factorized(reweight="prior") if self.prior is None:
                remedy = "add a prior section, or write reweight: transition"
                found.append(Refusal(("filter", "reweight"), f"filter.reweight: prior needs a prior; {remedy}"))
            case Factorized(from_prior=share) if share > 0 and self.prior is None:
                message = "filter.from_prior above 0 needs a prior; add a prior section, or write 0"
                found.append(Refusal(("filter", "from_prior"), message))
            case Factorized(reweight="transition", from_prior=share) if share > 0:
                message = "filter.from_prior above 0 goes with reweight: prior; eq. 7 knows the motion model alone"
                found.append(Refusal(("filter", "from_prior"), message))
            case _ if isinstance(self.likelihood, Appearance) and isinstance(self.motion, AffineWalk):
                found += self._too_many(self.likelihood, self.motion)
            case _:
                pass
        match self.filter:
            case Adaptive(adapt=True) if isinstance(self.motion, AffineWalk) and self.motion.noise is None:
                message = "filter.adapt follows motion.noise, which is null; add noise: {}, or write adapt: false"
                found.append(Refusal(("filter", "adapt"), message))
            case Independent() if self.prior is not None:
                message = 'filter type "independent" makes no use of a prior; remove it, or write prior: null'
                found.append(Refusal(("prior",), message))
            case _:
                pass
        refuse(found)
        return self

    def _too_many(self, appearance: Appearance, motion: AffineWalk) -> list[Refusal]:
        """What an affine target would not find the memory for, at its largest number of particles."""
        n, (columns, rows) = self.filter.particles, appearance.template
        if isinstance(self.filter, Adaptive) and self.filter.adapt and motion.noise is not None:
            n = round(n * (motion.noise.most + self.filter.entropy))
        found, where = [], ("filter", "particles")
        if isinstance(self.filter, Adaptive) and self.filter.adapt and self.filter.least > n:
            n, where = self.filter.least, ("filter", "least")
        if n * columns * rows > MOST_POINTS:
            message = (
                f"{n:,} particles of {columns}x{rows} points each; no more than {MOST_POINTS:,} points fit into memory"
            )
            found.append(Refusal(where, message))
        if motion.velocity is not None and min(n, motion.velocity.samples or n) > MOST_COMPARED:
            message = (
                f"motion.velocity compares every two of up to {n:,} particles; give velocity.samples, as in samples: 32"
            )
            found.append(
                Refusal(where if motion.velocity.samples is None else ("motion", "velocity", "samples"), message)
            )
        return found

    def _mismatched(self) -> list[Refusal]:
        """What does not go with the type of the target."""
        name = self.target.type
        found = []
        for section, types in _GO_WITH[name].items():
            given = getattr(self, section)
            kind = None if given is None else given.type
            if kind not in types:
                remedy = " or ".join("null" if one is None else one for one in types)
                message = f'{section} type "{kind}" does not go with target type "{name}"; write {remedy}'
                found.append(Refusal((section, "type"), message))
        if self.recognition is not None and name != "affine":
            message = f'recognition does not go with target type "{name}"; remove it, or follow an affine target'
            found.append(Refusal(("recognition",), message))
        return found


_GO_WITH: Mapping[str, Mapping[str, Sequence[str | None]]] = {
    "points": {
        "motion": ["random_walk"],
        "likelihood": ["colour_ratio"],
        "filter": ["sir", "auxiliary", "factorized", "independent"],
    },
    "region": {
        "motion": ["first_order", "random_walk"],
        "likelihood": ["product", "skin_ncc"],
        "filter": ["sir", "auxiliary"],  # the others resample parts apart, and a region is one part
        "prior": [None],
    },
    "cloud": {
        "motion": ["random_walk", "first_order"],
        "likelihood": ["skin"],
        "filter": ["sir", "auxiliary"],
        "prior": [None],
    },
    "affine": {
        "motion": ["affine_walk"],
        "likelihood": ["appearance"],
        "filter": ["adaptive", "sir", "auxiliary"],
        "prior": [None],
    },
}
