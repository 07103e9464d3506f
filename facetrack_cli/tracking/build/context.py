"""What the parts of a tracker are built from, beside their own settings."""

from __future__ import annotations

from dataclasses import dataclass

from facetrack_cli.core.errors import RecipeError
from facetrack_cli.core.types import Start
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.recipe.particle_filter import ParticleFilter
from facetrack_cli.tracking.models.spaces import Placed


@dataclass(frozen=True)
class Context:
    """One target of a recipe, and where it begins.

    `settings` are all of the target's; `above` is what stands before their keys in the recipe: nothing, or as in
    `targets.face.`.
    """

    recipe: Recipe
    above: str
    settings: ParticleFilter
    start: Start
    name: str
    placed: Placed

    def error(self, key: str, message: str) -> RecipeError:
        """An error that points at a key of the target's settings, as in `prior.file`."""
        return self.recipe.error(f"{self.above}{key}", message)
