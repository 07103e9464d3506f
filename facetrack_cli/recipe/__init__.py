"""YAML to checked settings: `load.py` reads a recipe, the others hold its sections. No numerics are imported here."""

from facetrack_cli.recipe.load import check_recipe, load_recipe
from facetrack_cli.recipe.model import Recipe, register
from facetrack_cli.recipe.sections import (
    Filter,
    Length,
    LengthPerPart,
    Likelihood,
    Motion,
    Prior,
    Refusal,
    Section,
    Target,
)

__all__ = ["Filter", "Length", "LengthPerPart", "Likelihood", "Motion", "Prior", "Refusal", "Section", "Target"]
__all__ += ["Recipe", "check_recipe", "load_recipe", "register"]
