"""YAML to checked settings: `load.py` reads a recipe, the others hold its sections. No numerics are imported here.

What a plug-in needs is imported from here when it is first used: settings of trackers are made of `sections`, and
recipes of these settings.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from facetrack_cli.recipe.load import check_recipe as check_recipe
    from facetrack_cli.recipe.load import load_recipe as load_recipe
    from facetrack_cli.recipe.model import Recipe as Recipe
    from facetrack_cli.recipe.model import register as register
    from facetrack_cli.recipe.sections import FilterSettings as FilterSettings
    from facetrack_cli.recipe.sections import Length as Length
    from facetrack_cli.recipe.sections import LengthPerPart as LengthPerPart
    from facetrack_cli.recipe.sections import LikelihoodSettings as LikelihoodSettings
    from facetrack_cli.recipe.sections import MotionSettings as MotionSettings
    from facetrack_cli.recipe.sections import PriorSettings as PriorSettings
    from facetrack_cli.recipe.sections import Refusal as Refusal
    from facetrack_cli.recipe.sections import Section as Section
    from facetrack_cli.recipe.sections import TargetSettings as TargetSettings

_PLACES = {"check_recipe": "load", "load_recipe": "load", "Recipe": "model", "register": "model"}


def __getattr__(name: str) -> Any:
    place = _PLACES.get(name, "sections" if name[0].isupper() else None)  # names in lower case are modules
    if place is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"facetrack_cli.recipe.{place}"), name)
