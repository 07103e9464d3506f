"""From a recipe and a start to a tracker: the one file that knows every part by name."""

from __future__ import annotations

from dataclasses import replace

from facetrack_cli import recipe
from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.types import Start
from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, ParticlesRecipe, Recipe
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.tracking.build.affine import affine_target
from facetrack_cli.tracking.build.corrections import corrected
from facetrack_cli.tracking.build.points import points_target
from facetrack_cli.tracking.build.regions import cloud_target, region_target
from facetrack_cli.tracking.exclusion import Exclusion
from facetrack_cli.tracking.loop import Tracker
from facetrack_cli.tracking.opencv import OpenCvTarget
from facetrack_cli.tracking.opencv import check as check_opencv
from facetrack_cli.tracking.start.checks import box_of, check_start, check_windows
from facetrack_cli.tracking.target import ParticleTarget


def build_tracker(recipe_: Recipe, start: Start) -> Tracker:
    """The tracker of a recipe for a clip that begins at `start`, whose every point lies in the picture.

    Targets that the start has corrections of are corrected along the clip. Raises InputError where the start, or one of
    its corrections, lacks what the recipe needs, RecipeError where parts do not fit each other.
    """
    return tuple(corrected(recipe_, start, target, _targets) for target in _targets(recipe_, start))


def _targets(recipe_: Recipe, start: Start) -> Tracker:
    if isinstance(recipe_, OpenCvRecipe):
        return _opencv(recipe_, start)
    if isinstance(recipe_, ParticlesRecipe):
        return _several(recipe_, start)
    assert isinstance(recipe_, ParticleRecipe)
    return tuple(_target(recipe_, recipe_, name, start) for name in start.targets)


def _target(given: ParticleFilter, recipe_: Recipe, name: str, start: Start) -> ParticleTarget:
    match given.target:
        case recipe.Region():
            return region_target(given, name, start)
        case recipe.Cloud():
            return cloud_target(given, name, start)
        case recipe.Affine():
            return affine_target(given, recipe_, name, start)
        case _:
            return points_target(given, recipe_, name, start)


def _several(recipe_: ParticlesRecipe, start: Start) -> Tracker:
    missing = [name for name in recipe_.filters if name not in start.targets]
    if missing:
        raise InputError(f"{start.origin}: has no {', '.join(missing)}, which the recipe follows; add a box of each")
    targets = [_target(given, recipe_, name, start) for name, given in recipe_.filters.items()]
    if (e := recipe_.exclusion) is None:
        return tuple(targets)
    exclusion = Exclusion(e.strength, e.reach)
    return tuple(one if one.name in e.first else replace(one, exclusion=exclusion) for one in targets)


def _opencv(recipe_: OpenCvRecipe, start: Start) -> Tracker:
    try:
        check_opencv(recipe_.tracker)
    except RecipeError as e:
        raise recipe_.error("tracker", str(e)) from None
    return tuple(OpenCvTarget(name, box_of(start, name), recipe_.tracker, start.origin) for name in start.targets)


def tracker_for(recipe_: Recipe, start: Start, size: tuple[int, int]) -> Tracker:
    """The tracker of a recipe for a clip of this (width, height) that begins at `start`.

    Raises InputError or RecipeError where the start does not fit the clip or lacks what the recipe needs, or a window
    is larger than the image.
    """
    check_start(start, size, recipe_.points)
    tracker = build_tracker(recipe_, start)
    check_windows(recipe_, tracker, size, start.origin)
    return tracker
