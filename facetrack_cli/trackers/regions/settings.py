"""The sections of a recipe that follows a region, which is a box that moves and changes its size.

All equations are those of Odobez, Ba & Gatica-Perez, "An Implicit Motion Likelihood for Tracking with Particle
Filters", IDIAP-RR 03-15, 2003. No numerics are imported here.
"""

from collections.abc import Iterable
from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe import sections

Count: TypeAlias = Annotated[int, Field(ge=1, le=64)]
Entry: TypeAlias = Annotated[float, Field(ge=-1e6, le=1e6)]  # or powers of A overflow, stable or not
Pair: TypeAlias = Annotated[tuple[Entry, Entry], Field(strict=False)]
Noise: TypeAlias = Annotated[tuple[sections.LengthOrNone, ...], Field(strict=False, min_length=1, max_length=2)]


class RegionSettings(sections.ScaledSettings):
    """A region of the frame: an upright box that moves and changes its size (section 3.2)."""

    engine = "facetrack_cli.engine.spaces:BoxSpace.place"
    type: Literal["region"]
    scale: Annotated[tuple[sections.Factor, sections.Factor], Field(strict=False)] = (0.25, 4.0)
    """The least and the largest size of the box, as factors of its size at the start."""


class DynamicsSettings(sections.Section):
    """c = A c + B w for a value and its speed: of x, likewise of y, or of the scale, which is 1 at the start."""

    A: Annotated[tuple[Pair, Pair], Field(strict=False)]
    """What value and speed become: [[value from value, from speed], [speed from value, from speed]]."""
    B: Annotated[tuple[Noise, Noise], Field(strict=False)]
    """How the noise enters value and speed: a row each, with a standard deviation for each of one or two sources; of
    the scale, which has no unit, they are numbers."""

    def mistakes(self) -> Iterable[sections.Refusal]:
        if len(self.B[0]) != len(self.B[1]):
            yield sections.Refusal(("B",), "both rows of B need the same number of sources of noise")


class FirstOrderSettings(sections.MotionSettings):
    """First-order dynamics of place, scale and their speeds: c_k = A c_{k-1} + B w_k (section 3.2)."""

    engine = "facetrack_cli.engine.spaces:first_order"
    goes_with = ("region", "cloud")
    type: Literal["first_order"]
    position: DynamicsSettings
    """Of x and of y."""
    scale: DynamicsSettings
    """Of the size of the box."""


class ContourSettings(sections.Component):
    """Edges along the normals of the ellipse in the box (eq. 11)."""

    engine = "facetrack_cli.trackers.regions.likelihoods:Contour.build"
    normals: Annotated[int, Field(ge=4, le=360)] = 32
    """L, the number of normals along which edges are looked for."""
    sigma: sections.Length
    """Standard deviation of the distance of an edge from the ellipse."""
    search: sections.Length
    """How far along a normal, inwards and outwards, edges are looked for."""
    threshold: Annotated[float, Field(gt=0, le=255)]
    """Contrast from which on there is an edge, in grey levels."""
    outlier: Annotated[float, Field(gt=0, le=1)]
    """K, the least likelihood of a normal: where no edge is found, or one too far off."""
    max_size: Annotated[int, Field(ge=16)] | None = 64
    """Boxes with a longer side, in pixels, are read from a reduced frame; null: every pixel."""
    independent: Literal["all", "estimated"] = "all"
    """Beyond the paper: how many normals count as independent is estimated from their autocorrelation, or all do."""


class HistogramSettings(sections.Component):
    """Histograms of hue and saturation in sub-regions of the box (section 3.3)."""

    engine = "facetrack_cli.trackers.regions.likelihoods:Histogram"
    hue_bins: Annotated[int, Field(ge=1, le=64)]
    """N_h."""
    saturation_bins: Annotated[int, Field(ge=1, le=64)]
    """N_s."""
    regions: Annotated[tuple[Count, Count], Field(strict=False)]
    """[columns, rows] of the sub-regions of the box, N_r of them in all."""
    lambda_h: Annotated[float, Field(gt=0, le=1e6)]
    """lambda in p(y | c) = exp(-lambda D^2), D the Bhattacharyya distance from the first frame's histograms."""
    value_bins: Annotated[int, Field(ge=0, le=64)] = 1
    """Bins, by brightness, of pixels too pale or too dark to have a hue; 0 as printed: they are binned by hue."""
    least_saturation: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Below this saturation, 0..1, a pixel counts as pale."""
    least_value: Annotated[float, Field(ge=0, lt=1)] = 0.2
    """Below this value (of HSV), 0..1, a pixel counts as dark."""
    max_size: Annotated[int, Field(ge=16)] | None = 128
    """As in contour.max_size."""


class CorrelationSettings(sections.Component):
    """Grey values of the box against those of its parent in the previous frame (eq. 12 and 13)."""

    engine = "facetrack_cli.trackers.regions.likelihoods:Correlation.build"
    grid: Annotated[tuple[Count, Count], Field(strict=False)] = (16, 16)
    """[columns, rows] of the reference grid on which both are sampled."""
    region: Annotated[float, Field(gt=0, le=1)] = 1.0
    """R of eq. 6 as a share of the box's sides: less leaves out what is not the target at the borders of its box."""
    sigma: Annotated[float, Field(ge=1e-3, le=1e6)]
    """sigma_c in grey levels: lambda_c is 1 / (2 sigma_c^2), or 1 / sigma_c with a saturation."""
    saturation: Annotated[float, Field(gt=0, le=255)] | None = None
    """d_c of eq. 12 is L1 that stops to grow there, in grey levels; null: L2, which the paper takes."""
    independent: Literal["all", "estimated"] = "all"
    """Beyond the paper: how many points count as independent is estimated from their autocorrelation, or all do."""


class ProductSettings(sections.LikelihoodSettings):
    """The product of the likelihoods that are given, each of them usable alone (eq. 10)."""

    engine = "facetrack_cli.trackers.regions.likelihoods:Product.build"
    goes_with = ("region",)
    type: Literal["product"]
    contour: ContourSettings | None = None
    """Edges along the normals of the ellipse in the box (eq. 11)."""
    histogram: HistogramSettings | None = None
    """Histograms of hue and saturation in sub-regions of the box."""
    correlation: CorrelationSettings | None = None
    """Grey values against those of the parent in the previous frame (eq. 12 and 13)."""

    @property
    def factors(self) -> tuple[sections.Component, ...]:
        """Those that are given, in the order of the fields."""
        return tuple(factor for factor in (self.contour, self.histogram, self.correlation) if factor is not None)

    @property
    def judges(self) -> bool:
        return self.contour is not None or self.histogram is not None  # correlation cannot tell what it follows

    def mistakes(self) -> Iterable[sections.Refusal]:
        if not self.factors:
            yield sections.Refusal((), "likelihood has no factor; add contour, histogram or correlation")
