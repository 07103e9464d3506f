"""From the settings of a target and its start to a particle filter. Each part is built where it is."""

from typing import TypeVar

from facetrack_cli.core.types import BOX, Start
from facetrack_cli.engine.calibration import Calibration, load_calibration
from facetrack_cli.engine.spaces import Context
from facetrack_cli.engine.target import Exclusion, ParticleTarget
from facetrack_cli.recipe.load import resolve_file
from facetrack_cli.recipe.model import ParticleFilterSettings, Recipe, above

T = TypeVar("T", bound=ParticleTarget)


def particle_target(
    recipe: Recipe,
    key: str,
    given: ParticleFilterSettings,
    start: Start,
    name: str,
    kind: type[T],
    exclusion: Exclusion | None = None,
) -> T:
    """The target `name` of a start, by the settings `given` below `key` of the recipe."""
    placed = given.target.place(start, name)
    context = Context(recipe, above(key), given, start, name, placed)
    return kind(
        name=name,
        parts=given.points or (BOX,),
        space=placed.space,
        x0=placed.x0,
        particles=given.filter.particles,
        motion=given.motion.build(context),
        likelihood=(given.recognition or given.likelihood).build(context),
        prior=None if given.prior is None else given.prior.build(context),
        step=given.filter.build(context),
        confidence=given.confidence if given.likelihood.judges else None,
        exclusion=exclusion,
        scatter=placed.scatter,
        best=given.target.best,
        calibration=calibration_of(recipe, key, given),
    )


def calibration_of(recipe: Recipe, key: str, given: ParticleFilterSettings) -> Calibration | None:
    """The calibration that settings name, if any."""
    name = given.confidence.calibration
    if name is None:
        return None
    return load_calibration(resolve_file(recipe, name, f"{above(key)}confidence.calibration"))
