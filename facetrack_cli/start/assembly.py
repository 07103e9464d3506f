"""From a recipe and a start to a tracker. Each part is built from its settings, in the file where it is."""

from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import chain

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Frame, Start, TargetStart
from facetrack_cli.engine.assembly import particle_target
from facetrack_cli.engine.checks import box_of, check_size, check_start, check_windows
from facetrack_cli.engine.corrected import CorrectedTarget, RestartPolicy, correctable_parts, is_complete
from facetrack_cli.engine.loop import Target, Tracker
from facetrack_cli.engine.target import ParticleTarget
from facetrack_cli.recipe.load import in_frames
from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, ParticlesRecipe, Recipe, above
from facetrack_cli.start.init_file import TARGET as FACE
from facetrack_cli.start.search import box_start
from facetrack_cli.trackers import opencv
from facetrack_cli.trackers.appearance.recognition import find_gallery
from facetrack_cli.trackers.appearance.settings import PatchLikelihoodSettings
from facetrack_cli.trackers.face.assembly import box_with, face_target
from facetrack_cli.trackers.face.detectors import PARTS
from facetrack_cli.trackers.hands.target import HandTarget
from facetrack_cli.trackers.skin.cloud import log_weights


def build_tracker(recipe: Recipe, start: Start, fps: float | Fraction = 25) -> Tracker:
    """The tracker of a recipe for a clip that begins at `start`, whose every point lies in the frame.

    By `fps`, the frames per second of the clip, the recipe's times become frames.
    Raises InputError where the start or a correction lacks what the recipe needs, RecipeError for parts that disagree.
    """
    recipe = in_frames(recipe, fps)
    if isinstance(recipe, OpenCvRecipe):
        opencv.check(recipe)
    if missing := ", ".join(name for name in recipe.followed if name not in (*start.targets, *recipe.later)):
        raise InputError(f"{start.origin}: has no {missing}, which the recipe follows; add a box of each")
    names = recipe.followed or tuple(start.targets)
    for one in start.corrections:
        if one.target not in names:
            known = f"it follows {', '.join(names)}; remove that correction"
            raise InputError(f"{start.origin}: corrects {one.target}, which the recipe does not follow: {known}")
    targets = [_target(recipe, start, name) for name in names]
    return tuple(_corrected(recipe, start, target) for target in targets)


def check_gallery(recipe: Recipe) -> None:
    """Raises what `build_tracker` would, of the galleries of a recipe alone, before any clip is opened."""
    for name, given in recipe.filters.items():
        if given.recognition is not None and isinstance(given.likelihood, PatchLikelihoodSettings):
            columns, rows = given.likelihood.template
            find_gallery(given.recognition, (rows, columns), recipe, above(name))


def _target(recipe: Recipe, start: Start, name: str) -> Target:
    """One target, without its corrections."""
    if isinstance(recipe, OpenCvRecipe):
        return opencv.OpenCvTarget(name, box_of(start, name), recipe.tracker, start.origin)
    if isinstance(recipe, ParticlesRecipe) and recipe.hands is not None and name in recipe.later:
        first = recipe.followed[0]
        boxes = [None if (one := start.targets.get(hand)) is None else one.box for hand in recipe.later]
        return HandTarget(
            name, first, recipe.later.index(name), recipe.hands, box_of(start, first), (boxes[0], boxes[1])
        )
    key = name if name in recipe.filters else ""
    given = recipe.filters[key]
    if given.head is not None:
        return face_target(recipe, key, given, given.head, start, name)
    settings = recipe.exclusion if isinstance(recipe, ParticleRecipe | ParticlesRecipe) else None
    exclusion = None if settings is None or name in settings.first else partial(log_weights, settings)
    return particle_target(recipe, key, given, start, name, ParticleTarget, exclusion)


def tracker_for(recipe: Recipe, start: Start, size: tuple[int, int], fps: float | Fraction) -> Tracker:
    """As `build_tracker`, for a clip of this (width, height); raises also where start or windows do not fit it."""
    check_start(start, size, recipe.points)
    tracker = build_tracker(recipe, start, fps)
    check_windows(recipe, tracker, size, start.origin)
    return tracker


def _corrected(recipe: Recipe, start: Start, target: Target) -> Target:
    """The target with the corrections that the start has of it, if any; InputError for one that it cannot follow."""
    corrections = [one for one in start.corrections if one.target == target.name]
    if not corrections:
        return target
    given = recipe.filters.get(target.name, recipe.filters.get(""))
    kind = None if given is None else given.target  # None of OpenCV's trackers
    points = kind is not None and bool(kind.points)
    hand = target.name in recipe.later
    learns = not points and not hand and (kind is None or kind.relearns)
    absent: set[str] = set()
    for one in corrections:
        origin = f"{start.origin}: the correction of {one.target} at frame {one.frame}"
        if one.confirmed:
            _check(one, target, start, origin, points=points)
            continue
        # what a correction leaves open stays absent
        still = () if is_complete(one, target.parts) else absent - {*one.given.points, *one.kept}
        absent = {*one.hidden(target.parts), *still}
        _check(one, target, start, origin, points=points)
        if absent >= set(correctable_parts(target.parts)):
            continue
        if one.learn and points and absent:
            raise InputError(f"{origin}: {', '.join(sorted(absent))} cannot be learned while absent; leave learn out")
        if one.learn is False and kind is None and not hand:
            raise InputError(f"{origin}: OpenCV's trackers begin again in any case; leave learn out")
        if one.learn and not learns and not points:
            raise InputError(f"{origin}: colours are learned in the first frame alone; leave learn out")

    def place(frame: Frame, one: Correction) -> TargetStart:
        assert one.given.box is not None
        said_in = f"{start.origin}: the correction of {one.target} at frame {frame.index}"
        seen = [part for part in correctable_parts(target.parts) if part not in one.hidden(target.parts)]
        return box_start(frame, one.given.box, seen, by=start.measured_by, clip=said_in).targets[FACE]

    def build(frame: Frame, given: TargetStart) -> Target:
        if points and given.box is None:
            given = replace(given, box=box_with(given, start.targets[target.name]))
        known = replace(start, frame=frame.index, targets={**start.targets, target.name: given})
        return _target(recipe, known, target.name)

    return CorrectedTarget(target, {one.frame: one for one in corrections}, RestartPolicy(points, learns, place, build))


def _check(one: Correction, target: Target, start: Start, origin: str, *, points: bool) -> None:
    """InputError if it speaks of parts that nobody knows, or lacks the box of what is followed as a box."""
    lists = (those for those in (one.absent, one.confirmed) if those is not True)
    named = [*one.given.points, *one.kept, *chain(*lists)]
    known = {*correctable_parts(target.parts), *start.targets.get(one.target, TargetStart()).points}
    if unknown := ", ".join(part for part in named if part not in known):
        these = f"these are {', '.join(correctable_parts(target.parts))}: correct the name"
        raise InputError(f"{origin}: has {unknown}, which is no part that is followed; {these}")
    hidden = one.hidden(target.parts)
    if one.confirmed:
        return
    if not points and not hidden and one.given.box is None:
        raise InputError(f"{origin}: has no box, which the recipe follows; add one, as in box: [x, y, w, h]")
    strange = [part for part in correctable_parts(target.parts) if part not in PARTS and part not in hidden]
    if points and one.given.box is not None and not one.given.points and strange:
        raise InputError(f"{origin}: no cascade can place {', '.join(strange)} in its box; give points: in place of it")
    if not points and one.given.box is not None:
        check_size(start.origin, f"{one.target} at frame {one.frame}", one.given.box)
