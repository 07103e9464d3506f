"""The sections of a recipe that follows a face under affine maps, adapts to it, and may name it.

All equations are those of Zhou, Chellappa & Moghaddam, "Adaptive Visual Tracking and Recognition using Particle
Filters", ICME 2003. No numerics are imported here.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from facetrack_cli.recipe import sections

Points: TypeAlias = Annotated[int, Field(ge=6, le=128)]
Deviation: TypeAlias = Annotated[float, Field(ge=1e-3, le=100)]


class AffineSettings(sections.ScaledSettings):
    """A face under affine maps: place, and what became of the box of the first frame (section 4)."""

    engine = "facetrack_cli.trackers.appearance.appearance:AffineSpace.place"
    type: Literal["affine"]
    estimate: Literal["map", "mean"] = "map"
    """The particle of the greatest weight, thus likelihood, which the paper calls MAP, or the mean of them all."""
    scale: Annotated[tuple[sections.Factor, sections.Factor], Field(strict=False)] = (0.2, 5.0)
    """The least and the largest scale, as factors of the size at the start."""

    @property
    def best(self) -> bool:
        return self.estimate == "map"


class VelocitySettings(sections.Section):
    """Adaptive velocity: the shift that the change of the image predicts (eq. 12)."""

    components: Annotated[int, Field(ge=1, le=500)] = 20
    """q, how many of the largest singular values are kept."""
    iterations: Annotated[int, Field(ge=1, le=100)] = 10
    """How often the shift is corrected at most."""
    settle: Annotated[float, Field(ge=0, lt=1)] = 0.02
    """It ends when the error falls by less than this share."""
    samples: Annotated[int, Field(ge=2)] | None = None
    """From how many of the particles, evenly chosen, it is learned what a shift does to the patch; null: from all."""
    towards: Literal["last", "appearance"] = "last"
    """What the image should match again: the patch of the last frame, as published, or what the model expects."""
    search: Annotated[float, Field(ge=0, le=3)] = 0.0
    """Beyond the paper: first look for the face so far around, in units of its box; 0: do not."""


class NoiseSettings(sections.Section):
    """Adaptive noise: r_t / r_0 = a + (b - a) tanh(eps_t / c), eps_t the error of the prediction (eq. 13)."""

    least: Annotated[float, Field(gt=0, le=100)] = 0.5
    """a, r_t / r_0 after a perfect prediction."""
    most: Annotated[float, Field(gt=0, le=100)] = 2.0
    """b, r_t / r_0 after a very bad one."""
    rate: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    """c; the error is 1 where the patch differs from the appearance as much as that expects."""


class AffineWalkSettings(sections.MotionSettings):
    """Gaussian noise on the six parameters, around the predicted place: theta_t = theta_{t-1} + nu_t + u_t (eq. 1)."""

    engine = "facetrack_cli.trackers.appearance.appearance:affine_walk"
    goes_with = ("affine",)
    type: Literal["affine_walk"]
    sigma: sections.Length
    """r_0 u_0 of the place: standard deviation along x and y."""
    deform: Annotated[float, Field(ge=0, le=1)]
    """r_0 u_0 of the deformation [[a1, a2], [a3, a4]], the identity at the start: of its scale."""
    turn: Annotated[float, Field(ge=0, le=1)] | None = None
    """... of its turn; null: the same; 0: the box stays upright."""
    shear: Annotated[float, Field(ge=0, le=1)] | None = None
    """... and of its stretch along one side and its shear; null: the same; 0: the box keeps its shape."""
    velocity: VelocitySettings | None = None
    """nu_t; null: none, the target is expected where it was."""
    noise: NoiseSettings | None = None
    """r_t; null: fixed, r_0."""


class ComponentsSettings(sections.Section):
    """One number for each component of the appearance."""

    w: Annotated[float, Field(ge=0, le=100)]
    """Of W, the last frame."""
    s: Annotated[float, Field(ge=0, le=100)]
    """Of S, what is stable."""
    f: Annotated[float, Field(ge=0, le=100)]
    """Of F, the first frame."""

    @property
    def each(self) -> tuple[float, float, float]:
        return self.w, self.s, self.f


class AppearanceSettings(sections.LikelihoodSettings):
    """The adaptive appearance model: a mixture of W, S and F in each pixel of a patch (eq. 6 to 11)."""

    engine = "facetrack_cli.trackers.appearance.appearance:Appearance.build"
    goes_with = ("affine",)
    type: Literal["appearance"]
    template: Annotated[tuple[Points, Points], Field(strict=False)] = (26, 30)
    """[columns, rows] of the patch; its grey levels have zero mean and unit variance."""
    mixing: ComponentsSettings
    """m_i in the first frame, in proportion; 0 leaves a component out, and f alone is a fixed template."""
    sigma: ComponentsSettings
    """sigma_i in the first frame, in standard deviations of the patch."""
    alpha: Annotated[float, Field(ge=0, lt=1)]
    """The updating factor: the share of a new frame in what is known."""
    least_sigma: Deviation = 0.1
    """Floor of sigma_s, which a pixel that never changes would drive to zero."""
    least_mixing: Annotated[float, Field(gt=0, lt=0.3)] = 0.01
    """Floor of m_i."""
    density: Literal["gaussian", "laplace"] = "gaussian"
    """N of eq. 6, or the Laplacian of the earlier tracker that the paper improves on."""
    outlier: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Beyond the paper: share of a fourth component, uniform, for pixels that are covered; null: none."""
    pixels: Annotated[float, Field(gt=0, le=16384)] | None = None
    """Beyond the paper: how many pixels of the patch count as independent; null: all."""

    def mistakes(self) -> Iterable[sections.Refusal]:
        if sum(self.mixing.each) <= 0:
            yield sections.Refusal(("mixing",), "likelihood.mixing is all 0; give w, s or f a share")
        for name, share, sigma in zip("wsf", self.mixing.each, self.sigma.each, strict=True):
            if share > 0 and sigma < 1e-3:
                yield sections.Refusal(("sigma", name), f"likelihood.sigma.{name} must be at least 0.001")


class AdaptiveSettings(sections.FilterSettings):
    """All particles around the predicted place, as many as the prediction is worth (figure 1, eq. 17)."""

    engine = "facetrack_cli.engine.filters:adaptive"
    goes_with = ("affine",)
    type: Literal["adaptive"]
    particles: Annotated[int, Field(ge=1)]
    """J_0."""
    adapt: bool = True
    """J_t follows eq. 17 with the noise of the motion; false: always J_0."""
    entropy: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """d of eq. 17, by which there are more or fewer as the identity becomes less or more certain."""
    least: Annotated[int, Field(ge=1)] = 10
    """Never fewer particles than this."""
    centre: bool = False
    """Beyond the paper: the first particle is the predicted place itself."""
