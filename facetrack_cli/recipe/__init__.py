"""YAML to checked settings: `load.py` reads a recipe, the others hold its sections. No numerics are imported here."""

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
    "Refusal",
    "Section",
    "TargetSettings",
]
__all__ += ["Recipe", "check_recipe", "load_recipe", "register"]
