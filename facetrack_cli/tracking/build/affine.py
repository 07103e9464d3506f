"""A face under affine maps, from its recipe."""

from __future__ import annotations

from facetrack_cli import recipe
from facetrack_cli.core.types import BOX, Start
from facetrack_cli.recipe.model import ParticlesRecipe, Recipe
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.tracking.build.filter import filter_step
from facetrack_cli.tracking.confidence import Confidence
from facetrack_cli.tracking.identity.gallery import load_gallery
from facetrack_cli.tracking.models.likelihoods.appearance import Appearance
from facetrack_cli.tracking.models.likelihoods.recognition import Recognition, TemplateError
from facetrack_cli.tracking.models.motion import AffineWalk
from facetrack_cli.tracking.models.patches import Patches
from facetrack_cli.tracking.models.spaces import AffineSpace, affine_state_of_box
from facetrack_cli.tracking.models.velocity import Guide, Noise, Velocity
from facetrack_cli.tracking.start.checks import size_of_box, visible_box
from facetrack_cli.tracking.target import Likelihood, ParticleTarget


def check_gallery(recipe_: Recipe) -> None:
    """Raises what `build_tracker` would, of the galleries of a recipe alone, before any clip is opened."""
    for above, given in recipe.filters(recipe_):
        if given.recognition is not None and isinstance(given.likelihood, recipe.Appearance):
            columns, rows = given.likelihood.template
            _appearance(given, recipe_, above, Patches((columns, rows), (rows, columns)))


def affine_target(given: ParticleFilter, recipe_: Recipe, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.target, recipe.Affine)
    assert isinstance(given.motion, recipe.AffineWalk)
    assert isinstance(given.likelihood, recipe.Appearance)
    box = visible_box(start, name)
    above = f"targets.{name}." if isinstance(recipe_, ParticlesRecipe) else ""
    columns, rows = given.likelihood.template
    patches = Patches((box[2], box[3]), (rows, columns))
    motion, velocity, noise = given.motion, given.motion.velocity, given.motion.noise
    guide = None
    if velocity is not None or noise is not None:
        guide = Guide(
            patches,
            None if velocity is None else Velocity(**velocity.model_dump()),
            None if noise is None else Noise(**noise.model_dump()),
            given.filter.particles,
        )
    return ParticleTarget(
        name=name,
        parts=(BOX,),
        space=AffineSpace((box[2], box[3])),
        x0=affine_state_of_box(*box),
        particles=given.particles,
        motion=AffineWalk(
            motion.sigma.pixels(size_of_box(start, name)),
            motion.deform,
            motion.deform if motion.shear is None else motion.shear,
            *given.target.scale,
            motion.turn,
        ),
        likelihood=_appearance(given, recipe_, above, patches),
        prior=None,
        step=filter_step(given.filter),
        confidence=Confidence(**given.confidence.model_dump()),
        guide=guide,
        best=given.target.estimate == "map",
    )


def _appearance(given: ParticleFilter, recipe_: Recipe, above: str, patches: Patches) -> Likelihood:
    a = given.likelihood
    assert isinstance(a, recipe.Appearance)
    appearance = Appearance(
        patches,
        alpha=a.alpha,
        mixing=(a.mixing.w, a.mixing.s, a.mixing.f),
        sigma=(a.sigma.w, a.sigma.s, a.sigma.f),
        least_sigma=a.least_sigma,
        least_mixing=a.least_mixing,
        density=a.density,
        outlier=a.outlier,
        pixels=a.pixels,
    )
    if given.recognition is None:
        return appearance
    return _recognition(given, appearance, recipe_, f"{above}recognition.gallery")


def _recognition(given: ParticleFilter, appearance: Appearance, recipe_: Recipe, key: str) -> Recognition:
    r = given.recognition
    assert r is not None
    if r.gallery is None:
        message = (
            "nobody is known to recognise; give --gallery FILE, as facetrack gallery fit writes it, or name it here"
        )
        raise recipe_.error(key, message)
    path = recipe.resolve_file(recipe_, r.gallery, key)
    try:
        return Recognition(appearance, load_gallery(path), none=r.none, switch=r.switch, sharpness=r.sharpness)
    except TemplateError as e:
        raise recipe_.error(key, f"{path}: {e}") from None
