"""The sections of a recipe that follows a face under affine maps, adapts to it, and may name it.

All equations are those of Zhou, Chellappa & Moghaddam, "Adaptive Visual Tracking and Recognition using Particle
Filters", ICME 2003. No numerics are imported here.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from facetrack_cli.recipe.messages import Refusal, Section, refuse
from facetrack_cli.recipe.units import Length

Factor: TypeAlias = Annotated[float, Field(gt=0, le=100)]
Points: TypeAlias = Annotated[int, Field(ge=6, le=128)]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Deviation: TypeAlias = Annotated[float, Field(ge=1e-3, le=100)]


class Affine(Section):
    """A face under affine maps: place, and what became of the box of the first frame (section 4)."""

    type: Literal["affine"]
    """A box that moves, turns, stretches and shears."""
    estimate: Literal["map", "mean"] = "map"
    """The particle of the greatest weight, as published, or the mean of them all."""
    scale: Annotated[tuple[Factor, Factor], Field(strict=False)] = (0.2, 5.0)
    """The least and the largest scale, as factors of the size at the start."""

    @property
    def parts(self) -> tuple[str, ...]:
        """A start need not place any point."""
        return ()

    @model_validator(mode="after")
    def _check(self) -> Affine:
        if not self.scale[0] < 1 < self.scale[1]:
            message = "target.scale is [least, largest], with 1, the size at the start, between them"
            refuse([Refusal(("scale",), message)])
        return self


class Velocity(Section):
    """Adaptive velocity: the shift that the change of the picture predicts (eq. 12)."""

    components: Annotated[int, Field(ge=1, le=500)] = 20
    """q, how many of the largest singular values are kept."""
    iterations: Annotated[int, Field(ge=1, le=100)] = 10
    """How often the shift is corrected at most."""
    settle: Annotated[float, Field(ge=0, lt=1)] = 0.02
    """It ends when the error falls by less than this share."""
    samples: Annotated[int, Field(ge=2)] | None = None
    """From how many of the particles, evenly chosen, it is learned what a shift does to the patch; null: from all."""
    towards: Literal["last", "appearance"] = "last"
    """What the picture should become again: the patch of the last frame, as published, or what the model expects."""
    search: Annotated[float, Field(ge=0, le=3)] = 0.0
    """Beyond the paper: first look for the face so far around, in units of its box; 0: do not."""


class Noise(Section):
    """Adaptive noise: r_t / r_0 = a + (b - a) tanh(eps_t / c), eps_t the error of the prediction (eq. 13)."""

    least: Annotated[float, Field(gt=0, le=100)] = 0.5
    """a, r_t / r_0 after a perfect prediction."""
    most: Annotated[float, Field(gt=0, le=100)] = 2.0
    """b, r_t / r_0 after a hopeless one."""
    rate: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    """c; the error is 1 where the patch differs from the appearance as much as that expects."""

    @model_validator(mode="after")
    def _check(self) -> Noise:
        if self.most < self.least:
            refuse([Refusal(("most",), "motion.noise.most is below least; give it a value at least as large")])
        return self


class AffineWalk(Section):
    """Gaussian noise on the six parameters, around the predicted place: theta_t = theta_{t-1} + nu_t + u_t (eq. 1)."""

    type: Literal["affine_walk"]
    """Noise on the parameters of an affine map, around a predicted place."""
    sigma: Length
    """r_0 u_0 of the place: standard deviation along x and y."""
    deform: Annotated[float, Field(ge=0, le=1)]
    """r_0 u_0 of the deformation [[a1, a2], [a3, a4]], the identity at the start: of its scale."""
    turn: Annotated[float, Field(ge=0, le=1)] | None = None
    """... of its turn; null: the same; 0: the box stays upright."""
    shear: Annotated[float, Field(ge=0, le=1)] | None = None
    """... and of its stretch along one side and its shear; null: the same; 0: the box keeps its shape."""
    velocity: Velocity | None = None
    """nu_t; null: none, the target is expected where it was."""
    noise: Noise | None = None
    """r_t; null: fixed, r_0."""


class Components(Section):
    """One number for each component of the appearance."""

    w: Annotated[float, Field(ge=0, le=100)]
    """Of W, the last frame."""
    s: Annotated[float, Field(ge=0, le=100)]
    """Of S, what is stable."""
    f: Annotated[float, Field(ge=0, le=100)]
    """Of F, the first frame."""


class Appearance(Section):
    """The adaptive appearance model: a mixture of W, S and F in each pixel of a patch (eq. 6 to 11)."""

    type: Literal["appearance"]
    """What the face looked like in the last frame, all along, and at the start."""
    template: Annotated[tuple[Points, Points], Field(strict=False)] = (26, 30)
    """[columns, rows] of the patch; its grey levels have zero mean and unit variance."""
    mixing: Components
    """m_i in the first frame, in proportion; 0 leaves a component out, and f alone is a fixed template."""
    sigma: Components
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

    @model_validator(mode="after")
    def _check(self) -> Appearance:
        found = []
        if self.mixing.w + self.mixing.s + self.mixing.f <= 0:
            found.append(Refusal(("mixing",), "likelihood.mixing is all 0; give w, s or f a share"))
        for name in ("w", "s", "f"):
            if getattr(self.mixing, name) > 0 and getattr(self.sigma, name) < 1e-3:
                found.append(Refusal(("sigma", name), f"likelihood.sigma.{name} must be at least 0.001"))
        refuse(found)
        return self


class Adaptive(Section):
    """All particles around the predicted place, as many as the prediction is worth (figure 1, eq. 17)."""

    type: Literal["adaptive"]
    """Particles around the one place that is predicted."""
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


class Recognition(Section):
    """Who it is: the joint posterior of motion and identity (eq. 5, 14 to 16)."""

    gallery: str | None = None
    """The people, as `facetrack gallery fit` writes them; `--gallery FILE`. Sought beside the recipe."""
    none: bool = False
    """Beyond the paper: whether it may also be none of them."""
    switch: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Probability that the identity changes from frame to frame (section 2.2)."""
    sharpness: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Beyond the paper: below 1 a patch says less of who it is: the log of eq. 16 times this."""
