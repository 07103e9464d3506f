"""A particle filter in a recipe: what is tracked, how it moves, how it looks, and which filter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import Field

from facetrack_cli.recipe.affine import Recognition
from facetrack_cli.recipe.sections import (
    Component,
    Filter,
    Kind,
    Likelihood,
    Motion,
    Prior,
    Refusal,
    Section,
    Target,
    registered,
)

MOST_HYPOTHESES = 5_000_000  # particles times parts: some gigabytes


class Confidence(Section):
    """When a part counts as lost."""

    lost_below: Annotated[float, Field(ge=0, le=1)] = 0.3
    """A part is lost while its confidence stays below this, 0..1."""
    patience: Annotated[int, Field(ge=1)] = 3
    """For so many frames in a row it must be below, for the part to be lost."""
    memory: Annotated[int, Field(ge=1)] | None = 50
    """Frames over which it is learned how well a part matches when it is there; null: the first frame says so."""
    beside: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Quantile of the windows beside the part in the first frame that counts as no match; the lower, the stricter."""


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
    """Who it is, of an affine target; null: there is no recognition."""
    confidence: Confidence = Confidence()
    """When a part counts as lost, and when as found again."""

    @property
    def points(self) -> tuple[str, ...]:
        return self.target.points

    @property
    def particles(self) -> int:
        return self.filter.particles

    @property
    def hypotheses(self) -> int:
        return self.filter.particles * max(len(self.points), 1)

    @property
    def judges(self) -> bool:
        return self.likelihood.judges

    @property
    def components(self) -> dict[str, Component]:
        """What the tracker is built from, by key, but for what is not given."""
        found = {key: getattr(self, key) for key in ("target", *_KINDS)}
        return {key: one for key, one in found.items() if one is not None}

    def mistakes(self) -> Iterable[Refusal]:
        given = self.components
        strangers = [key for key in _KINDS if key in given and not self._fits(given[key])]
        if strangers:
            yield from (self._mismatch(key, given[key]) for key in strangers)
            return
        for one in given.values():
            yield from one.mismatches(self)
        if self.hypotheses > MOST_HYPOTHESES:
            message = f"particles times parts is {self.hypotheses:,}; no more than {MOST_HYPOTHESES:,} fit into memory"
            yield Refusal(("filter", "particles"), message)

    def _fits(self, given: Component | type[Component]) -> bool:
        return self.target.type in given.goes_with

    def _mismatch(self, key: str, given: Component) -> Refusal:
        """What is said of a section that does not go with the type of the target."""
        said = f'does not go with target type "{self.target.type}"'
        if not isinstance(given, Kind):
            return Refusal((key,), f"{key} {said}; remove it, or follow an affine target")
        fitting = [name for name, one in registered(_KINDS[key]).items() if self._fits(one)]
        message = f'{key} type "{given.type}" {said}; write {" or ".join(fitting) or "null"}'
        return Refusal((key, "type"), message)


_KINDS: Mapping[str, type[Any]] = {
    "likelihood": Likelihood,
    "motion": Motion,
    "filter": Filter,
    "prior": Prior,
    "recognition": Recognition,
}
