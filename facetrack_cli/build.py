"""From a recipe and a start to a tracker: the one file that knows every part by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from facetrack_cli import filters, recipe
from facetrack_cli.build_corrections import corrected
from facetrack_cli.confidence import Confidence
from facetrack_cli.errors import InputError, RecipeError
from facetrack_cli.exclusion import Exclusion
from facetrack_cli.gallery import load_gallery
from facetrack_cli.guide import Guide, Noise, Velocity
from facetrack_cli.lengths import Length
from facetrack_cli.likelihoods.appearance import Appearance
from facetrack_cli.likelihoods.colour_ratio import ColourRatio
from facetrack_cli.likelihoods.contour import Contour
from facetrack_cli.likelihoods.correlation import Correlation
from facetrack_cli.likelihoods.histogram import Histogram
from facetrack_cli.likelihoods.product import Factor, ObjectFactor, Product
from facetrack_cli.likelihoods.recognition import Recognition, TemplateError
from facetrack_cli.likelihoods.skin_cloud import SkinCloud
from facetrack_cli.likelihoods.skin_ncc import Ncc, Skin, SkinNcc
from facetrack_cli.motion import AffineWalk, FirstOrder, RandomWalk
from facetrack_cli.opencv import OpenCvTarget
from facetrack_cli.opencv import check as check_opencv
from facetrack_cli.particle_target import Likelihood, ParticleTarget
from facetrack_cli.patches import Patches
from facetrack_cli.priors import BoundPrior, bind, load_prior
from facetrack_cli.recipe import OpenCvRecipe, ParticleFilter, ParticleRecipe, ParticlesRecipe, Recipe
from facetrack_cli.resampling import SCHEMES
from facetrack_cli.spaces import (
    AffineSpace,
    BoxSpace,
    CloudSpace,
    PointSpace,
    affine_state_of_box,
    size_of_points,
    state_of_box,
)
from facetrack_cli.start.files import check_size
from facetrack_cli.track import Tracker
from facetrack_cli.types import BOX, Array, Box, Start


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


def check_gallery(recipe_: Recipe) -> None:
    """Raises what `build_tracker` would, of the galleries of a recipe alone, before any clip is opened."""
    for above, given in recipe.filters(recipe_):
        if given.recognition is not None and isinstance(given.likelihood, recipe.Appearance):
            columns, rows = given.likelihood.template
            _appearance(given, recipe_, above, Patches((columns, rows), (rows, columns)))


def _target(given: ParticleFilter, recipe_: Recipe, name: str, start: Start) -> ParticleTarget:
    match given.target:
        case recipe.Region():
            return _region_target(given, name, start)
        case recipe.Cloud():
            return _cloud_target(given, name, start)
        case recipe.Affine():
            return _affine_target(given, recipe_, name, start)
        case _:
            return _points_target(given, recipe_, name, start)


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
    return tuple(OpenCvTarget(name, _box(start, name), recipe_.tracker, start.origin) for name in start.targets)


def _box(start: Start, name: str) -> Box:
    box = start.targets[name].box
    if box is None:
        points = ", or follow its points, by a recipe such as factorized" if start.targets[name].points else ""
        raise InputError(
            f"{start.origin}: {name} has no box, which the recipe follows; add one, as in box: [x, y, w, h]{points}"
        )
    return box


def _region_target(given: ParticleFilter, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.target, recipe.Region)
    box = _seen_box(start, name)
    unit = _size_of_box(start, name)
    size = (box[2], box[3])
    if isinstance(given.likelihood, recipe.SkinNcc):
        likelihood: Likelihood = _skin_ncc(given.likelihood, size)
    else:
        assert isinstance(given.likelihood, recipe.Product)
        likelihood = _product(given.likelihood, size, unit)
    return ParticleTarget(
        name=name,
        parts=(BOX,),
        space=BoxSpace(size),
        x0=state_of_box(*box),
        particles=given.particles,
        motion=_region_motion(given.motion, given.target.scale, unit),
        likelihood=likelihood,
        prior=None,
        step=_step(given.filter),
        # correlation alone cannot tell what it follows
        confidence=Confidence(**given.confidence.model_dump()) if given.judges else None,
    )


def _region_motion(motion: recipe.Motion, bounds: tuple[float, float], unit: float) -> FirstOrder:
    least, most = bounds
    if isinstance(motion, recipe.FirstOrder):
        position = np.array(motion.position.A), _pixels(motion.position.B, unit)
        return FirstOrder(position, (np.array(motion.scale.A), np.array(motion.scale.B)), least, most)
    assert isinstance(motion, recipe.RandomWalk)
    stay, step = np.array([[1.0, 0.0], [0.0, 0.0]]), motion.sigma.of(BOX).pixels(unit)
    return FirstOrder((stay, np.array([[step], [0.0]])), (stay, np.array([[motion.scale], [0.0]])), least, most)


def _cloud_target(given: ParticleFilter, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.likelihood, recipe.SkinCloud)
    box = _seen_box(start, name)
    unit = _size_of_box(start, name)
    teacher = name if given.likelihood.learn_from is None else given.likelihood.learn_from
    if teacher not in start.targets:
        raise InputError(f"{start.origin}: has no {teacher}, whose colours {name} learns from; add its box")
    return ParticleTarget(
        name=name,
        parts=(BOX,),
        space=CloudSpace(),
        x0=state_of_box(*box),
        particles=given.particles,
        motion=_region_motion(given.motion, (0.25, 4.0), unit),
        likelihood=SkinCloud(
            (box[2], box[3]),
            teacher=_box(start, teacher),
            least_share=given.likelihood.least_share,
            floor=given.likelihood.floor,
            max_size=given.likelihood.max_size,
        ),
        prior=None,
        step=_step(given.filter),
        confidence=Confidence(**given.confidence.model_dump()),
        scatter=np.array([box[2:]]),
    )


def _affine_target(given: ParticleFilter, recipe_: Recipe, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.target, recipe.Affine)
    assert isinstance(given.motion, recipe.AffineWalk)
    assert isinstance(given.likelihood, recipe.Appearance)
    box = _seen_box(start, name)
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
            motion.sigma.pixels(_size_of_box(start, name)),
            motion.deform,
            motion.deform if motion.shear is None else motion.shear,
            *given.target.scale,
            motion.turn,
        ),
        likelihood=_appearance(given, recipe_, above, patches),
        prior=None,
        step=_step(given.filter),
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


def _seen_box(start: Start, name: str) -> Box:
    """The target's box; InputError if it is too small to see anything in it."""
    box = _box(start, name)
    check_size(start.origin, name, box)
    return box


def _skin_ncc(given: recipe.SkinNcc, size: tuple[float, float]) -> SkinNcc:
    skin = None if given.skin is None else Skin(**given.skin.model_dump())
    ncc = None if given.ncc is None else Ncc(**given.ncc.model_dump())
    return SkinNcc(size, skin, ncc, given.cost, given.k, given.sigma)


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


def _points_target(given: ParticleFilter, recipe_: Recipe, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.target, recipe.Points)
    assert isinstance(given.motion, recipe.RandomWalk)
    assert isinstance(given.likelihood, recipe.ColourRatio)
    parts = tuple(given.target.parts)
    placed = start.targets[name]
    missing = [part for part in parts if part not in placed.points]
    if missing:
        raise InputError(f"{start.origin}: {name} has no point for {', '.join(missing)}; the recipe wants them")
    x0 = np.array([placed.points[part] for part in parts], dtype=float)
    size = size_of_points(x0) if len(parts) > 1 else _size_of_box(start, name)
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
        step=_step(given.filter),
        confidence=Confidence(**given.confidence.model_dump()),
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


def _step(given: recipe.Filter) -> filters.Step:
    if isinstance(given, recipe.Adaptive):
        return filters.Adaptive(given.particles, given.adapt, given.entropy, given.least, given.centre)
    resample = SCHEMES[given.resampling]
    if isinstance(given, recipe.Sir):
        return filters.Sir(resample)
    if isinstance(given, recipe.Auxiliary):
        return filters.Auxiliary(resample)
    if isinstance(given, recipe.Independent):
        return filters.Factorized("none", resample=resample)
    return filters.Factorized(given.reweight, given.from_prior, resample)
