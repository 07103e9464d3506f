"""YAML to checked settings: `load.py` reads a recipe, the others hold its sections. No numerics are imported here.

What a plug-in needs is imported from here when it is first used: settings of trackers are made of `sections`, and
recipes of these settings.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from facetrack_cli.recipe.load import check_recipe, load_recipe
    from facetrack_cli.recipe.model import Recipe, register
    from facetrack_cli.recipe.sections import (
        FilterSettings,
        Length,
        LengthPerPart,
        LikelihoodSettings,
        MotionSettings,
        PriorSettings,
        Refusal,
        Section,
        TargetSettings,
    )

__all__ = [
    "FilterSettings",
    "Length",
    "LengthPerPart",
    "LikelihoodSettings",
    "MotionSettings",
    "PriorSettings",
    "Recipe",
    "Refusal",
    "Section",
    "TargetSettings",
    "check_recipe",
    "load_recipe",
    "register",
]

_PLACES = {"check_recipe": "load", "load_recipe": "load", "Recipe": "model", "register": "model"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"facetrack_cli.recipe.{_PLACES.get(name, 'sections')}"), name)
