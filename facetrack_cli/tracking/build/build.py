"""From a recipe and a start to a tracker. Each part is built from its settings, in the file where it is."""

from __future__ import annotations

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.types import BOX, Start
from facetrack_cli.recipe.affine import PatchLikelihood
from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, ParticlesRecipe, Recipe, filters
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.recipe.skin import Exclusion
from facetrack_cli.tracking.build.context import Context
from facetrack_cli.tracking.build.corrections import corrected
from facetrack_cli.tracking.loop import Tracker
from facetrack_cli.tracking.models.likelihoods.recognition import find_gallery
from facetrack_cli.tracking.opencv import OpenCvTarget
from facetrack_cli.tracking.opencv import check as check_opencv
from facetrack_cli.tracking.start.checks import box_of, check_start, check_windows
from facetrack_cli.tracking.target import ParticleTarget


def build_tracker(recipe: Recipe, start: Start) -> Tracker:
    """The tracker of a recipe for a clip that begins at `start`, whose every point lies in the frame.

    Targets that the start has corrections of are corrected along the clip. Raises InputError where the start, or one of
    its corrections, lacks what the recipe needs, RecipeError where parts do not fit each other.
    """
    return tuple(corrected(recipe, start, target, _targets) for target in _targets(recipe, start))


def check_gallery(recipe: Recipe) -> None:
    """Raises what `build_tracker` would, of the galleries of a recipe alone, before any clip is opened."""
    for above, given in filters(recipe):
        if given.recognition is not None and isinstance(given.likelihood, PatchLikelihood):
            columns, rows = given.likelihood.template
            find_gallery(given.recognition, (rows, columns), recipe, above)


def _targets(recipe: Recipe, start: Start) -> Tracker:
    if isinstance(recipe, OpenCvRecipe):
        return _opencv(recipe, start)
    if isinstance(recipe, ParticlesRecipe):
        return _several(recipe, start)
    assert isinstance(recipe, ParticleRecipe)
    return tuple(_target(recipe, recipe, "", name, start) for name in start.targets)


def _several(recipe: ParticlesRecipe, start: Start) -> Tracker:
    missing = [name for name in recipe.filters if name not in start.targets]
    if missing:
        raise InputError(f"{start.origin}: has no {', '.join(missing)}, which the recipe follows; add a box of each")
    first = recipe.exclusion.first if recipe.exclusion is not None else ()
    return tuple(
        _target(given, recipe, f"targets.{name}.", name, start, None if name in first else recipe.exclusion)
        for name, given in recipe.filters.items()
    )


def _target(
    given: ParticleFilter, recipe: Recipe, above: str, name: str, start: Start, exclusion: Exclusion | None = None
) -> ParticleTarget:
    placed = given.target.place(start, name)
    context = Context(recipe, above, given, start, name, placed)
    return ParticleTarget(
        name=name,
        parts=given.points or (BOX,),
        space=placed.space,
        x0=placed.x0,
        particles=given.particles,
        motion=given.motion.build(context),
        likelihood=(given.recognition or given.likelihood).build(context),
        prior=None if given.prior is None else given.prior.build(context),
        step=given.filter.build(context),
        confidence=given.confidence if given.judges else None,
        exclusion=exclusion,
        scatter=placed.scatter,
        best=given.target.best,
    )


def _opencv(recipe: OpenCvRecipe, start: Start) -> Tracker:
    try:
        check_opencv(recipe.tracker)
    except RecipeError as e:
        raise recipe.error("tracker", str(e)) from None
    return tuple(OpenCvTarget(name, box_of(start, name), recipe.tracker, start.origin) for name in start.targets)


def tracker_for(recipe: Recipe, start: Start, size: tuple[int, int]) -> Tracker:
    """The tracker of a recipe for a clip of this (width, height) that begins at `start`.

    Raises InputError or RecipeError where the start does not fit the clip or lacks what the recipe needs, or a window
    is larger than the image.
    """
    check_start(start, size, recipe.points)
    tracker = build_tracker(recipe, start)
    check_windows(recipe, tracker, size, start.origin)
    return tracker
