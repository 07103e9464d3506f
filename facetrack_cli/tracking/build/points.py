"""Named points of a face, from their recipe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facetrack_cli import recipe
from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Array, Start
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.tracking.build.filter import filter_step
from facetrack_cli.tracking.confidence import Confidence
from facetrack_cli.tracking.models.likelihoods.colour_ratio import ColourRatio
from facetrack_cli.tracking.models.motion import RandomWalk
from facetrack_cli.tracking.models.shape_prior import BoundPrior, bind, load_prior
from facetrack_cli.tracking.models.spaces import PointSpace
from facetrack_cli.tracking.start.checks import size_of_box
from facetrack_cli.tracking.target import ParticleTarget


def points_target(given: ParticleFilter, recipe_: Recipe, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.target, recipe.Points)
    assert isinstance(given.motion, recipe.RandomWalk)
    assert isinstance(given.likelihood, recipe.ColourRatio)
    parts = tuple(given.target.parts)
    placed = start.targets[name]
    missing = [part for part in parts if part not in placed.points]
    if missing:
        raise InputError(f"{start.origin}: {name} has no point for {', '.join(missing)}; the recipe wants them")
    x0 = np.array([placed.points[part] for part in parts], dtype=float)
    size = size_of_points(x0) if len(parts) > 1 else size_of_box(start, name)
    if not size:
        raise InputError(f"{start.origin}: all points of {name} are in one place; move them apart")
    windows = np.array([[side.pixels(size) for side in given.target.window(part)] for part in parts])
    for part, side in placed.windows.items():
        if part in parts:
            windows[parts.index(part)] = side
    return ParticleTarget(
        name=name,
        parts=parts,
        space=PointSpace(windows),
        x0=x0,
        particles=given.filter.particles,
        motion=RandomWalk(np.array([given.motion.sigma.of(part).pixels(size) for part in parts])),
        likelihood=_likelihood(given.likelihood, windows),
        prior=_prior(given.prior, recipe_, parts, x0, start.origin),
        step=filter_step(given.filter),
        confidence=Confidence(**given.confidence.model_dump()),
    )


def _likelihood(given: recipe.ColourRatio, windows: Array) -> ColourRatio:
    return ColourRatio(
        windows,
        sigma=given.sigma,
        robust=given.robust,
        scale=given.scale or 1.0,
        floor=given.floor,
        max_samples=given.max_samples,
    )


def _prior(
    given: recipe.Parzen | None, recipe_: Recipe, parts: Sequence[str], x0: Array, origin: str
) -> BoundPrior | None:
    if given is None:
        return None
    prior = load_prior(recipe.resolve_file(recipe_, given.file))
    try:
        return bind(prior, parts, x0, given.sigma)
    except RecipeError as e:
        raise recipe_.error("prior.file", str(e)) from None
    except InputError as e:
        raise InputError(f"{origin}: {e}") from None
