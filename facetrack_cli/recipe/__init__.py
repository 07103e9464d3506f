"""YAML to checked settings. `load.py` reads a recipe; the other files hold its sections, by the kind of target.

No numerics are imported here.
"""

from facetrack_cli.recipe.affine import Adaptive, Affine, AffineWalk, Appearance, Recognition
from facetrack_cli.recipe.files import find_recipe, read_recipe, resolve_file, shipped_folder, shipped_recipes
from facetrack_cli.recipe.load import check_recipe, load_recipe
from facetrack_cli.recipe.model import (
    OpenCvRecipe,
    ParticleRecipe,
    ParticlesRecipe,
    Recipe,
    completed,
    filters,
    json_schema,
    to_dict,
)
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.recipe.points import (
    Auxiliary,
    ColourRatio,
    Confidence,
    Factorized,
    Filter,
    Independent,
    Motion,
    Parzen,
    Points,
    RandomWalk,
    Sir,
)
from facetrack_cli.recipe.regions import Contour, Correlation, FirstOrder, Histogram, Product, Region
from facetrack_cli.recipe.skin import Cloud, Exclusion, Pattern, Skin, SkinCloud, SkinNcc
from facetrack_cli.recipe.units import Length, PerPart, Window

__all__ = [
    "Adaptive",
    "Affine",
    "AffineWalk",
    "Appearance",
    "Auxiliary",
    "Cloud",
    "ColourRatio",
    "Confidence",
    "Contour",
    "Correlation",
    "Exclusion",
    "Factorized",
    "Filter",
    "FirstOrder",
    "Histogram",
    "Independent",
    "Length",
    "Motion",
    "OpenCvRecipe",
    "ParticleFilter",
    "ParticleRecipe",
    "ParticlesRecipe",
    "Parzen",
    "Pattern",
    "PerPart",
    "Points",
    "Product",
    "RandomWalk",
    "Recipe",
    "Recognition",
    "Region",
    "Sir",
    "Skin",
    "SkinCloud",
    "SkinNcc",
    "Window",
    "check_recipe",
    "completed",
    "filters",
    "find_recipe",
    "json_schema",
    "load_recipe",
    "read_recipe",
    "resolve_file",
    "shipped_folder",
    "shipped_recipes",
    "to_dict",
]
