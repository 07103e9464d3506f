"""From a recipe and the corrections of a start to targets that begin anew along the clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Frame, Start, TargetStart
from facetrack_cli.recipe.model import ParticleRecipe, ParticlesRecipe, Recipe
from facetrack_cli.recipe.sections import Target as Kind
from facetrack_cli.tracking.corrected import Anew, CorrectedTarget, is_complete
from facetrack_cli.tracking.loop import Target, Tracker
from facetrack_cli.tracking.start.checks import check_size
from facetrack_cli.tracking.start.haar import PARTS, box_start
from facetrack_cli.tracking.start.init_file import TARGET as FACE


def corrected(recipe: Recipe, start: Start, target: Target, targets: Callable[[Recipe, Start], Tracker]) -> Target:
    """The target with the corrections that the start has of it, if any; `targets` builds those of another start.

    Raises InputError for a correction that the target cannot follow.
    """
    corrections = [one for one in start.corrections if one.target == target.name]
    if not corrections:
        return target
    kind = _kind_of(recipe, target.name)
    points = kind is not None and bool(kind.points)
    learns = not points and (kind is None or kind.relearns)
    absent: set[str] = set()
    for one in corrections:
        origin = f"{start.origin}: the correction of {one.target} at frame {one.frame}"
        # what a correction leaves open stays absent
        still = () if is_complete(one, target.parts) else absent - {*one.given.points, *one.kept}
        absent = {*one.hidden(target.parts), *still}
        _check(one, target, start, origin, points=points)
        if len(absent) == len(target.parts):
            continue
        if one.learn and points and absent:
            raise InputError(f"{origin}: {', '.join(sorted(absent))} cannot be learned while absent; leave learn out")
        if one.learn is False and kind is None:
            raise InputError(f"{origin}: OpenCV's trackers begin anew in any case; leave learn out")
        if one.learn and not learns and not points:
            raise InputError(f"{origin}: colours are learned in the first frame alone; leave learn out")

    def place(frame: Frame, one: Correction) -> TargetStart:
        assert one.given.box is not None
        said_in = f"{start.origin}: the correction of {one.target} at frame {frame.index}"
        seen = [part for part in target.parts if part not in one.hidden(target.parts)]
        return box_start(frame, one.given.box, seen, clip=said_in).targets[FACE]

    def build(frame: Frame, given: TargetStart) -> Target:
        # a single point is measured by the box of the start
        box = start.targets[target.name].box if points and given.box is None else given.box
        given = replace(given, box=box)
        known = replace(start, frame=frame.index, targets={**start.targets, target.name: given})
        [anew] = [one for one in targets(recipe, known) if one.name == target.name]
        return anew

    return CorrectedTarget(target, {one.frame: one for one in corrections}, Anew(points, learns, place, build))


def _kind_of(recipe: Recipe, name: str) -> Kind | None:
    """What a target of the recipe is, None of OpenCV's trackers."""
    if isinstance(recipe, ParticlesRecipe):
        return recipe.filters[name].target
    return recipe.target if isinstance(recipe, ParticleRecipe) else None


def _check(one: Correction, target: Target, start: Start, origin: str, *, points: bool) -> None:
    """InputError if it speaks of parts that nobody knows, or lacks the box of what is followed as a box."""
    spoken = [*one.given.points, *one.kept, *(() if one.absent is True else one.absent)]
    known = {*target.parts, *start.targets[one.target].points}
    unknown = [part for part in spoken if part not in known]
    if unknown:
        raise InputError(
            f"{origin}: has {', '.join(unknown)}, which is no part that is followed; "
            f"these are {', '.join(target.parts)}: correct the name"
        )
    hidden = one.hidden(target.parts)
    if not points and not hidden and one.given.box is None:
        raise InputError(f"{origin}: has no box, which the recipe follows; add one, as in box: [x, y, w, h]")
    strange = [part for part in target.parts if part not in PARTS and part not in hidden]
    if points and one.given.box is not None and not one.given.points and strange:
        raise InputError(f"{origin}: no cascade can place {', '.join(strange)} in its box; give points: in place of it")
    if not points and one.given.box is not None:
        check_size(start.origin, f"{one.target} at frame {one.frame}", one.given.box)
