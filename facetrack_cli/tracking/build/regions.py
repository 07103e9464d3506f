"""Targets that are a box or a cloud of pixels, from their recipe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facetrack_cli import recipe
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX, Array, Start
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.recipe.units import Length
from facetrack_cli.tracking.build.filter import filter_step
from facetrack_cli.tracking.confidence import Confidence
from facetrack_cli.tracking.models.likelihoods.contour import Contour
from facetrack_cli.tracking.models.likelihoods.correlation import Correlation
from facetrack_cli.tracking.models.likelihoods.histogram import Histogram
from facetrack_cli.tracking.models.likelihoods.ncc import Ncc
from facetrack_cli.tracking.models.likelihoods.product import Factor, ObjectFactor, Product
from facetrack_cli.tracking.models.likelihoods.skin_cloud import SkinCloud
from facetrack_cli.tracking.models.likelihoods.skin_ncc import Skin, SkinNcc
from facetrack_cli.tracking.models.motion import FirstOrder
from facetrack_cli.tracking.models.spaces import BoxSpace, CloudSpace, state_of_box
from facetrack_cli.tracking.start.checks import box_of, size_of_box, visible_box
from facetrack_cli.tracking.target import Likelihood, ParticleTarget


def region_target(given: ParticleFilter, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.target, recipe.Region)
    box = visible_box(start, name)
    unit = size_of_box(start, name)
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
        step=filter_step(given.filter),
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


def cloud_target(given: ParticleFilter, name: str, start: Start) -> ParticleTarget:
    assert isinstance(given.likelihood, recipe.SkinCloud)
    box = visible_box(start, name)
    unit = size_of_box(start, name)
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
            teacher=box_of(start, teacher),
            least_share=given.likelihood.least_share,
            floor=given.likelihood.floor,
            max_size=given.likelihood.max_size,
        ),
        prior=None,
        step=filter_step(given.filter),
        confidence=Confidence(**given.confidence.model_dump()),
        scatter=np.array([box[2:]]),
    )


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
