"""From a recipe and a start to a tracker: the one file that knows every part by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facetrack_cli import filters, recipe
from facetrack_cli.confidence import Confidence
from facetrack_cli.errors import InputError, RecipeError
from facetrack_cli.lengths import Length
from facetrack_cli.likelihoods.colour_ratio import ColourRatio
from facetrack_cli.likelihoods.contour import Contour
from facetrack_cli.likelihoods.correlation import Correlation
from facetrack_cli.likelihoods.histogram import Histogram
from facetrack_cli.likelihoods.product import Factor, ObjectFactor, Product
from facetrack_cli.motion import FirstOrder, RandomWalk
from facetrack_cli.opencv import OpenCvTarget
from facetrack_cli.opencv import check as check_opencv
from facetrack_cli.priors import BoundPrior, bind, load_prior
from facetrack_cli.recipe import OpenCvRecipe, ParticleRecipe, Recipe
from facetrack_cli.resampling import SCHEMES
from facetrack_cli.spaces import BoxSpace, PointSpace, size_of_points, state_of_box
from facetrack_cli.track import ParticleTarget, Tracker
from facetrack_cli.types import BOX, Array, Box, Start

LEAST_BOX = 6  # pixels of a side; in less there is nothing to see


def build_tracker(recipe_: Recipe, start: Start) -> Tracker:
    """The tracker of a recipe for a clip that begins at `start`, whose every point lies in the picture.

    Raises InputError where the start lacks what the recipe needs, RecipeError where parts do not fit each other.
    """
    if isinstance(recipe_, OpenCvRecipe):
        return _opencv(recipe_, start)
    assert isinstance(recipe_, ParticleRecipe)
    make = _region_target if isinstance(recipe_.target, recipe.Region) else _points_target
    return tuple(make(recipe_, name, start) for name in start.targets)


def _opencv(recipe_: OpenCvRecipe, start: Start) -> Tracker:
    try:
        check_opencv(recipe_.tracker)
    except RecipeError as e:
        raise recipe_.error("tracker", str(e)) from None
    return tuple(OpenCvTarget(name, _box(start, name), recipe_.tracker, start.origin) for name in start.targets)


def _box(start: Start, name: str) -> Box:
    box = start.targets[name].box
    if box is None:
        points = ", or follow its points, by a recipe such as factorized" if start.targets[name].points else ""
        raise InputError(
            f"{start.origin}: {name} has no box, which the recipe follows; add one, as in box: [x, y, w, h]{points}"
        )
    return box


def _region_target(recipe_: ParticleRecipe, name: str, start: Start) -> ParticleTarget:
    target, motion, likelihood = recipe_.target, recipe_.motion, recipe_.likelihood
    assert isinstance(target, recipe.Region)
    assert isinstance(motion, recipe.FirstOrder)
    assert isinstance(likelihood, recipe.Product)
    box = _box(start, name)
    if min(box[2:]) < LEAST_BOX:
        least = f"{LEAST_BOX}x{LEAST_BOX} pixels"
        raise InputError(f"{start.origin}: the box of {name} is smaller than {least}; give a larger one")
    unit = _size_of_box(start, name)
    product = _product(likelihood, (box[2], box[3]), unit)
    return ParticleTarget(
        name=name,
        parts=(BOX,),
        space=BoxSpace((box[2], box[3])),
        x0=state_of_box(*box),
        particles=recipe_.particles,
        motion=FirstOrder(
            position=(np.array(motion.position.A), _pixels(motion.position.B, unit)),
            scale=(np.array(motion.scale.A), np.array(motion.scale.B)),
            least=target.scale[0],
            most=target.scale[1],
        ),
        likelihood=product,
        prior=None,
        step=_step(recipe_.filter),
        # correlation alone cannot tell what it follows
        confidence=Confidence(**recipe_.confidence.model_dump()) if product.objects else None,
    )


def _pixels(rows: Sequence[Sequence[Length]], unit: float) -> Array:
    return np.array([[length.pixels(unit) for length in row] for row in rows])


def _product(given: recipe.Product, size: tuple[float, float], unit: float) -> Product:
    objects: list[ObjectFactor] = []
    if (c := given.contour) is not None:
        objects.append(
            Contour(
                size,
                normals=c.normals,
                sigma=c.sigma.pixels(unit),
                search=c.search.pixels(unit),
                threshold=c.threshold,
                outlier=c.outlier,
                max_size=c.max_size,
            )
        )
    if (h := given.histogram) is not None:
        objects.append(
            Histogram(
                size,
                hue_bins=h.hue_bins,
                saturation_bins=h.saturation_bins,
                regions=h.regions,
                lambda_=h.lambda_h,
                value_bins=h.value_bins,
                least_saturation=h.least_saturation,
                least_value=h.least_value,
                max_size=h.max_size,
            )
        )
    motions: list[Factor] = []
    if (k := given.correlation) is not None:
        middle = (size[0] * k.region, size[1] * k.region)
        motions.append(
            Correlation(middle, grid=k.grid, distance=k.distance, sigma=k.sigma, saturation=k.saturation or 0.0)
        )
    return Product(tuple(objects), tuple(motions))


def _points_target(recipe_: ParticleRecipe, name: str, start: Start) -> ParticleTarget:
    assert isinstance(recipe_.target, recipe.Points)
    assert isinstance(recipe_.motion, recipe.RandomWalk)
    assert isinstance(recipe_.likelihood, recipe.ColourRatio)
    parts = tuple(recipe_.target.parts)
    given = start.targets[name]
    missing = [part for part in parts if part not in given.points]
    if missing:
        raise InputError(f"{start.origin}: {name} has no point for {', '.join(missing)}; the recipe wants them")
    x0 = np.array([given.points[part] for part in parts], dtype=float)
    size = size_of_points(x0) if len(parts) > 1 else _size_of_box(start, name)
    windows = np.array([[side.pixels(size) for side in recipe_.target.window(part)] for part in parts])
    for part, side in given.windows.items():
        if part in parts:
            windows[parts.index(part)] = side
    return ParticleTarget(
        name=name,
        parts=parts,
        space=PointSpace(windows),
        x0=x0,
        particles=recipe_.filter.particles,
        motion=RandomWalk(np.array([recipe_.motion.sigma.of(part).pixels(size) for part in parts])),
        likelihood=_likelihood(recipe_.likelihood, windows),
        prior=_prior(recipe_, parts, x0, start.origin),
        step=_step(recipe_.filter),
        confidence=Confidence(**recipe_.confidence.model_dump()),
    )


def _size_of_box(start: Start, name: str) -> float:
    """The unit of length of a region or a single point: the mean side of its box, in pixels."""
    box = start.targets[name].box
    if box is None:
        raise InputError(f"{start.origin}: {name} has a single point and no box to measure lengths by; add a box")
    return float(np.sqrt(box[2] * box[3]))


def _likelihood(given: recipe.ColourRatio, windows: Array) -> ColourRatio:
    return ColourRatio(
        windows,
        sigma=given.sigma,
        robust=given.robust,
        scale=given.scale or 1.0,
        floor=given.floor,
        max_samples=given.max_samples,
    )


def _prior(recipe_: ParticleRecipe, parts: Sequence[str], x0: Array, origin: str) -> BoundPrior | None:
    if recipe_.prior is None:
        return None
    prior = load_prior(recipe.resolve_file(recipe_, recipe_.prior.file))
    try:
        return bind(prior, parts, x0, recipe_.prior.sigma)
    except RecipeError as e:
        raise recipe_.error("prior.file", str(e)) from None
    except InputError as e:
        raise InputError(f"{origin}: {e}") from None


def _step(given: recipe.Sir | recipe.Auxiliary | recipe.Factorized | recipe.Independent) -> filters.Step:
    resample = SCHEMES[given.resampling]
    if isinstance(given, recipe.Sir):
        return filters.Sir(resample)
    if isinstance(given, recipe.Auxiliary):
        return filters.Auxiliary(resample)
    if isinstance(given, recipe.Independent):
        return filters.Factorized("none", resample=resample)
    return filters.Factorized(given.reweight, given.from_prior, resample)
