"""The filter that a recipe names."""

from __future__ import annotations

from facetrack_cli import recipe
from facetrack_cli.tracking import filters
from facetrack_cli.tracking.resampling import SCHEMES


def filter_step(given: recipe.Filter) -> filters.Step:
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
