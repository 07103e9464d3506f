"""The sections of a recipe that follows skin: faces by colour and pattern, heads and hands as clouds of pixels.

All equations are those of Gonzalez & Collet, "Face Tracking using a Combination of Colour and Pattern Matching Based on
Particle Filter". No numerics are imported here.
"""

from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe.sections import LikelihoodSettings, Refusal, Section, TargetSettings

MaxSize: TypeAlias = Annotated[int, Field(ge=16)]


class SkinSettings(Section):
    """Skin in a rectangle of two regions of equal area, the inner one the face (eq. 3 to 9)."""

    inner: Annotated[float, Field(ge=0.1, le=4)] = 1.0
    """R_int as a share of the box's sides; R_ext, around it, has the same area."""
    max_size: MaxSize | None = 64
    """Boxes with a longer side, in pixels, are read from a reduced frame; null: every pixel."""


class PatternSettings(Section):
    """Normalised cross-correlation with the first frame's grey template (eq. 10)."""

    mean: Literal["keep", "remove"] = "keep"
    """As printed the means are kept; removed, NCC is 0 where nothing is alike."""
    exponent: Annotated[float, Field(gt=0, le=100)] = 1.0
    """NCC to this power; the paper takes 1."""
    max_size: MaxSize | None = 64
    """As in skin.max_size."""


class SkinNccSettings(LikelihoodSettings):
    """A face by skin colour, by a template, or by both together (eq. 11)."""

    engine = "facetrack_cli.trackers.skin.likelihoods:SkinNcc"
    goes_with = ("region",)
    type: Literal["skin_ncc"]
    skin: SkinSettings | None = None
    """Skin in a rectangle of two regions (rho, eq. 9)."""
    ncc: PatternSettings | None = None
    """Normalised cross-correlation with a template (eq. 10)."""
    cost: Literal["shifted", "printed", "product"] = "shifted"
    """Eq. 11 compares k with rho / NCC as printed, with (1 + rho) / NCC, or, beyond the paper, with rho * NCC."""
    sigma: Annotated[float, Field(ge=1e-4, le=100)]
    """sigma of eq. 11, where rho goes from -1, a box of skin in a frame without, to 1."""

    def mistakes(self) -> Iterable[Refusal]:
        if self.skin is None and self.ncc is None:
            yield Refusal((), "likelihood has neither skin nor ncc; add one, as in skin: {}")


class SkinCloudSettings(LikelihoodSettings):
    """The probability that the colour of one pixel is skin; each particle is a pixel (Gianni et al. 2007)."""

    engine = "facetrack_cli.trackers.skin.likelihoods:SkinCloud"
    goes_with = ("cloud",)
    type: Literal["skin"]
    learn_from: str | None = None
    """The target whose box in the first frame teaches the colour of skin; null: the target itself."""
    floor: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Likelihood of a pixel that is no skin at all."""
    max_size: MaxSize | None = 32
    """Of a target larger than this in pixels, particles are pixels of a reduced frame; null: of the clip's own."""


class CloudSettings(TargetSettings):
    """A cloud of pixels, whose mean is the target's place and whose spread is its size (Gianni et al. 2007)."""

    engine = "facetrack_cli.trackers.skin.likelihoods:CloudSpace.place"
    relearns = False  # colours are learned in the first frame alone
    scale: ClassVar = (0.25, 4.0)  # of what a motion does to the size, which no pixel has
    type: Literal["cloud"]
