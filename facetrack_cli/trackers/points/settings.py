"""The sections of a recipe that follows named points of a face.

Sections and equations are those of Patras & Pantic, "Particle Filtering with Factorized Likelihoods for Tracking Facial
Features", FG 2004.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe import sections

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import ParticleFilterSettings

PartName: TypeAlias = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]


class PointsSettings(sections.TargetSettings):
    """Named points of a face, each the centre of a window (section 3.1: alpha = <alpha_1 ... alpha_N>)."""

    engine = "facetrack_cli.trackers.points.colour_ratio:place_points"
    type: Literal["points"]
    parts: Annotated[tuple[PartName, ...], Field(strict=False, min_length=1, max_length=100)]
    """The names of the points, in the order of the state; left and right as seen in the frame."""
    windows: sections.WindowPerPart
    """The window around each part: the side of a square, or [width, height]."""

    def mistakes(self) -> Iterable[sections.Refusal]:
        for part in sorted({part for part in self.parts if self.parts.count(part) > 1}):
            yield sections.Refusal(("parts",), f'the part "{part}" is named twice; remove one')
        if "default" in self.parts:
            yield sections.Refusal(("parts",), 'a part cannot be called "default"; give it another name')

    @property
    def points(self) -> tuple[str, ...]:
        return self.parts

    def window(self, part: str) -> tuple[sections.Length, sections.Length]:
        """(width, height) of a part's window."""
        window = self.windows.of(part)
        return window if isinstance(window, tuple) else (window, window)

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[sections.Refusal]:
        return self.windows.refusals(("target", "windows"), self.parts)


class ColourRatioSettings(sections.LikelihoodSettings):
    """Colours of a window, each divided by the window's mean, against the first frame's (section 3.2, eq. 8-10)."""

    engine = "facetrack_cli.trackers.points.colour_ratio:ColourRatio"
    goes_with = ("points",)
    type: Literal["colour_ratio"]
    sigma: Annotated[float, Field(gt=0)] = 1.5
    """sigma_i of eq. 10 is this / E{o_i}, with intensities in 0..255; the 1.5 of the paper, by its d, is 0.5 here."""
    floor: Annotated[float, Field(lt=0)] | None = None
    """Log-likelihood of a part that matches nothing: log(exp(-d / sigma_i) + exp(floor)); null as published, none."""
    max_samples: Annotated[int, Field(ge=5)] | None = None
    """Samples along a side of a window at most: a larger one is read from a reduced frame; null: every pixel."""


class ParzenSettings(sections.PriorSettings):
    """Shape prior: a sum of Gaussian kernels over registered training shapes (section 3.3, eq. 11)."""

    engine = "facetrack_cli.trackers.points.shape_prior:build"
    goes_with = ("points",)
    type: Literal["parzen"]
    file: Annotated[str, Field(min_length=1)]
    """The training shapes, as `facetrack prior fit` writes them; sought beside the recipe, then among the shipped."""
    sigma: Annotated[float, Field(ge=0.005)]  # of narrower kernels, float32 exponents are wrong by 0.001 and more
    """sigma_p, the standard deviation of the kernel, in the prior's own unit."""

    @property
    def files(self) -> Mapping[str, str]:
        return {"file": self.file}
