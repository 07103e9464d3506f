"""The sections of a recipe: one model for each thing that a tracker can be made of. No numerics are imported here.

A later tracker adds a member to one of the unions `Target`, `Motion`, `Likelihood`, `Filter`, `Prior`; build.py turns
each into the part that computes. Sections and equations without another paper are those of Patras & Pantic, "Particle
Filtering with Factorized Likelihoods for Tracking Facial Features", FG 2004.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from facetrack_cli.recipe.affine import Adaptive, Affine, AffineWalk, Appearance
from facetrack_cli.recipe.messages import Refusal, Section, refuse
from facetrack_cli.recipe.regions import FirstOrder, Product, Region
from facetrack_cli.recipe.skin import Cloud, SkinCloud, SkinNcc
from facetrack_cli.recipe.units import Length, LengthPerPart, WindowPerPart

PartName: TypeAlias = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]


class Points(Section):
    """Named points of a face, each the centre of a window (section 3.1: alpha = <alpha_1 ... alpha_N>)."""

    type: Literal["points"]
    """Points, tracked by the picture around each."""
    parts: Annotated[tuple[PartName, ...], Field(strict=False, min_length=1, max_length=100)]
    """The names of the points, in the order of the state; left and right as seen in the picture."""
    windows: WindowPerPart
    """The window around each part: the side of a square, or [width, height]."""

    @model_validator(mode="after")
    def _check(self) -> Points:
        twice = {part for part in self.parts if self.parts.count(part) > 1}
        found = [Refusal(("parts",), f'the part "{part}" is named twice; remove one') for part in sorted(twice)]
        if "default" in self.parts:
            found.append(Refusal(("parts",), 'a part cannot be called "default"; give it another name'))
        refuse(found)
        return self

    def window(self, part: str) -> tuple[Length, Length]:
        """(width, height) of a part's window."""
        window = self.windows.of(part)
        return window if isinstance(window, tuple) else (window, window)


class RandomWalk(Section):
    """Zero-order motion with Gaussian noise: p(alpha_i | alpha_i^-) = alpha_i^- + N(0, sigma) (section 3.3)."""

    type: Literal["random_walk"]
    """Each part stays where it was, give or take."""
    sigma: LengthPerPart
    """Standard deviation of a part's step from frame to frame, along x and along y."""
    scale: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Of a region: standard deviation of its scale's step, 1 being its size at the start; 0: its size stays."""


class ColourRatio(Section):
    """Colours of a window, each divided by the window's mean, against the first frame's (section 3.2, eq. 8-10)."""

    type: Literal["colour_ratio"]
    """Difference of colours that does not change with the intensity of the light."""
    robust: Literal["l1", "huber", "tukey", "geman_mcclure"] = "l1"
    """rho of eq. 9, the robust function of a colour difference; the paper takes l1."""
    scale: Annotated[float, Field(gt=0)] | None = None
    """Where rho begins to forgive, in colour differences (window mean = 1); for all robust functions but l1."""
    sigma: Annotated[float, Field(gt=0)] = 1.5
    """sigma_i of eq. 10 is this number / E{o_i}, with intensities in 0..255; the paper takes 1.5."""
    floor: Annotated[float, Field(lt=0)] | None = None
    """Log-likelihood of a part that matches nothing: log(exp(-d / sigma_i) + exp(floor)); null as published, none."""
    max_samples: Annotated[int, Field(ge=5)] | None = None
    """Samples along a side of a window at most: a larger one is read from a reduced picture; null: every pixel."""

    @model_validator(mode="after")
    def _check(self) -> ColourRatio:
        if self.robust == "l1" and self.scale is not None:
            refuse([Refusal(("scale",), "likelihood.scale has no meaning for robust: l1; remove it")])
        if self.robust != "l1" and self.scale is None:
            refuse([Refusal(("robust",), f"robust: {self.robust} needs likelihood.scale; add it, as in scale: 0.2")])
        return self


class _Filter(Section):
    type: str
    particles: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of particles, K in the paper; of `independent`: for each part."""
    resampling: Literal["systematic", "residual", "multinomial", "stratified"] = "systematic"
    """How particles are picked by their weights."""


class Sir(_Filter):
    """Sampling/importance resampling over the joint state (section 2); weights are p(y|s), or p(y|s) p(s)."""

    type: Literal["sir"]
    """Sampling/importance resampling over the joint state."""


class Auxiliary(_Filter):
    """Auxiliary particle filter over the joint state (Pitt & Shephard 1999); observes p(y|s), or p(y|s) p(s)."""

    type: Literal["auxiliary"]
    """Auxiliary particle filter over the joint state."""


class Factorized(_Filter):
    """Proposes from g(alpha) = prod_i p(alpha_i|Y), the product of the parts' posteriors; reweights (section 2.1)."""

    type: Literal["factorized"]
    """The product of the parts' posteriors as proposal, then reweighted."""
    reweight: Literal["prior", "transition"] = "prior"
    """By the shape prior (eq. 11), or by the particles of the last frame (eq. 7)."""
    from_prior: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of a part's sub-particles that is proposed from the prior given the other parts; as published 0."""


class Independent(_Filter):
    """An auxiliary particle filter for each part on its own (section 4, the paper's baseline)."""

    type: Literal["independent"]
    """An auxiliary particle filter for each part on its own."""


class Parzen(Section):
    """Shape prior: a sum of Gaussian kernels over registered training shapes (section 3.3, eq. 11)."""

    type: Literal["parzen"]
    """Parzen density over training shapes."""
    file: Annotated[str, Field(min_length=1)]
    """The training shapes, as `facetrack prior fit` writes them; sought beside the recipe, then among the shipped."""
    sigma: Annotated[float, Field(ge=0.005)]
    """sigma_p, the standard deviation of the kernel, in the prior's own unit."""


class Confidence(Section):
    """When a part counts as lost."""

    lost_below: Annotated[float, Field(ge=0, le=1)] = 0.3
    """A part is lost while its confidence stays below this, 0..1."""
    patience: Annotated[int, Field(ge=1)] = 3
    """... once it did so for this many frames."""
    memory: Annotated[int, Field(ge=1)] | None = 50
    """Frames over which it is learned how well a part matches when it is there; null: the first frame says so."""
    beside: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Quantile of the windows beside the part in the first frame that counts as no match; the lower, the stricter."""


# where later trackers join: another member of a union, told apart by its `type`
Target: TypeAlias = Annotated[Points | Region | Cloud | Affine, Field(discriminator="type")]
Motion: TypeAlias = Annotated[RandomWalk | FirstOrder | AffineWalk, Field(discriminator="type")]
Likelihood: TypeAlias = Annotated[ColourRatio | Product | SkinNcc | SkinCloud | Appearance, Field(discriminator="type")]
Filter: TypeAlias = Annotated[Sir | Auxiliary | Factorized | Independent | Adaptive, Field(discriminator="type")]
Prior: TypeAlias = Parzen
