"""Parts of trackers from their settings: what a test does not give has a default, and bounds are not checked."""

from dataclasses import replace
from functools import partial

import numpy as np

from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.engine import filters as steps
from facetrack_cli.engine.spaces import Context, Placed
from facetrack_cli.recipe.model import RecognitionSettings
from facetrack_cli.recipe.sections import AuxiliarySettings, FactorizedSettings, SirSettings, type_of
from facetrack_cli.trackers.appearance.appearance import AffineWalk, Appearance, PredictedWalk, Recognition
from facetrack_cli.trackers.appearance.settings import (
    AdaptiveSettings,
    AffineWalkSettings,
    AppearanceSettings,
    ComponentsSettings,
)
from facetrack_cli.trackers.box import hidden_box
from facetrack_cli.trackers.box.settings import GuidedSettings, VisibleWalkSettings
from facetrack_cli.trackers.points.colour_ratio import ColourRatio
from facetrack_cli.trackers.points.settings import ColourRatioSettings
from facetrack_cli.trackers.regions.likelihoods import Contour, Correlation, Histogram
from facetrack_cli.trackers.regions.settings import ContourSettings, CorrelationSettings, HistogramSettings
from facetrack_cli.trackers.skin.likelihoods import SkinCloud, SkinNcc
from facetrack_cli.trackers.skin.settings import PatternSettings, SkinCloudSettings, SkinNccSettings, SkinSettings


def section(kind, **settings):
    name = type_of(kind)
    return kind.model_construct(**({"type": name} if name else {}), **settings)


def changed(part, **settings):
    """A part with other settings."""
    return replace(part, settings=part.settings.model_copy(update=settings))


def placed(windows):
    """The context of a target with such windows."""
    windows = np.array(windows, float)
    return Context(None, "", None, None, "face", Placed(None, np.zeros((len(windows), 2)), windows, 1.0))


def colour_ratio(windows, **settings):
    return ColourRatio(section(ColourRatioSettings, **settings), placed(windows))


def contour(size, sigma, search, **settings):
    """Sigma and search in pixels."""
    return Contour(section(ContourSettings, **{"max_size": None, **settings}), size, sigma, search)


def histogram(size, **settings):
    plain = {"hue_bins": 8, "saturation_bins": 4, "regions": (3, 3), "lambda_h": 20.0, "max_size": None}
    return Histogram(section(HistogramSettings, **{**plain, **settings}), placed([size]))


def correlation(size, **settings):
    return Correlation(section(CorrelationSettings, **{"sigma": 100.0, **settings}), size)


def skin_cue(**settings):
    return section(SkinSettings, **{"max_size": None, **settings})


def pattern(mean="keep", **settings):
    return section(PatternSettings, mean=mean, **{"max_size": None, **settings})


def skin_ncc(size, **settings):
    plain = {"skin": skin_cue(), "ncc": pattern(), "sigma": 0.1}
    return SkinNcc(section(SkinNccSettings, **{**plain, **settings}), placed([size]))


def skin_cloud(size, teacher, **settings):
    start = Start(0, {"face": TargetStart(box=teacher)}, "x")
    return SkinCloud(section(SkinCloudSettings, **settings), placed([size])._replace(start=start))


def components(w, s, f):
    return section(ComponentsSettings, w=w, s=s, f=f)


def appearance(patches, alpha=0.03, **settings):
    plain = {"mixing": components(0.3, 0.4, 0.3), "sigma": components(0.3, 0.5, 0.5)}
    return Appearance(section(AppearanceSettings, alpha=alpha, **{**plain, **settings}), patches)


def recognition(gallery, model, **settings):
    return Recognition(model.settings, model.patches, section(RecognitionSettings, **settings), gallery)


def affine_walk(sigma, deform, shear=None, scale=(0.2, 5.0), turn=None):
    """The noise of the place in pixels."""
    return AffineWalk(section(AffineWalkSettings, deform=deform, shear=shear, turn=turn), sigma, scale)


def predicted(walk, patches, velocity=None, noise=None):
    """The walk around a predicted place."""
    settings = walk.settings.model_copy(update={"velocity": velocity, "noise": noise})
    return PredictedWalk(settings, walk.sigma, walk.scale, patches, 100)


def visible_walk(sigma, hidden, unit=20.0, limits=(0.1, 10.0), **settings):
    """Sigma and hidden in pixels."""
    return hidden_box.VisibleWalk(section(VisibleWalkSettings, **settings), unit, (sigma, hidden), limits)


def sir(**settings):
    return partial(steps.sir, section(SirSettings, **settings))


def auxiliary(**settings):
    return partial(steps.auxiliary, section(AuxiliarySettings, **settings))


def factorized(reweight="prior", **settings):
    """`none` is what the filter `independent` does."""
    return partial(steps.factorized, section(FactorizedSettings, reweight=reweight, **settings))


def adaptive(particles, **settings):
    return section(AdaptiveSettings, particles=particles, **settings)


def guided(particles, share):
    return partial(hidden_box.guided, section(GuidedSettings, particles=particles, guided=share))
