"""From a recipe and a start to a tracker, and the targets that a recipe names: a head, and hands.

Each part is built from its settings, in the file where it is. The first target of the recipe is the head, and its box
is needed: a face that was found, `--box`, an init file. Others that are not given begin as the largest regions of the
head's skin colour beside the face, named from left to right. Nothing here is random.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import common_area
from facetrack_cli.core.types import BOX, Array, Box, Correction, Frame, Start, TargetStart, factor_for
from facetrack_cli.engine.corrected import CorrectedTarget, correctable_parts, is_complete
from facetrack_cli.engine.loop import Target, Tracker
from facetrack_cli.engine.spaces import MIN_BOX_PX, box_of, check_size
from facetrack_cli.engine.target import ParticleTarget, particle_target
from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, ParticlesRecipe, Recipe, above
from facetrack_cli.start.init_file import TARGET, check_start
from facetrack_cli.start.search import box_start
from facetrack_cli.trackers.face.assembly import box_with, face_target
from facetrack_cli.trackers.face.detectors import PARTS, NotHereError

if TYPE_CHECKING:
    from facetrack_cli.trackers.skin.likelihoods import SkinModel

MIN_WINDOW_PX: Final = 3.0  # pixels; windows are not made smaller
MAX_SEARCHED_PX: Final = 400  # pixels of the longer side, at most, of the image that is searched for hands
MIN_SKIN: Final = 0.2  # of a region's pixels, smoothed over a tenth of the face
# no hand is sought there: the face's box, widened to ears, hair and chin, and the neck; in sizes of the box
FACE: Final = (-0.3, -0.6, 1.3, 1.25)  # left, top, right, bottom
NECK: Final = (0.0, 1.25, 1.0, 1.6)
MIN_HAND, MAX_HAND = 0.12, 5.0  # skin of a hand, with its arm, over that of the face
SHARED: Final = 0.3  # of the smaller box's area: a region that shares as much with a known target is that target
MAX_REACH: Final = 5.0  # sizes of the face's box: hands are no farther from the face's middle


def build_tracker(recipe: Recipe, start: Start) -> Tracker:
    """The tracker of a recipe for a clip that begins at `start`, whose every point lies in the frame.

    Raises
    ------
    InputError
        The start or a correction lacks what the recipe needs.
    RecipeError
        Parts of the recipe disagree.
    """
    if isinstance(recipe, OpenCvRecipe):
        from facetrack_cli.trackers import opencv

        opencv.check(recipe)
    if missing := ", ".join(name for name in recipe.followed if name not in (*start.targets, *recipe.later)):
        raise InputError(f"{start.origin}: has no {missing}, which the recipe follows; add a box of each")
    names = recipe.followed or tuple(start.targets)
    for correction in start.corrections:
        if correction.target not in names:
            hint = f"it follows {', '.join(names)}; remove that correction"
            raise InputError(f"{start.origin}: corrects {correction.target}, which the recipe does not follow: {hint}")
    targets = [_target(recipe, start, name) for name in names]
    return tuple(_corrected(recipe, start, target) for target in targets)


def check_gallery(recipe: Recipe) -> None:
    """Raises what `build_tracker` would, of the galleries of a recipe alone, before any clip is opened."""
    for name, settings in recipe.filters.items():
        template = getattr(settings.likelihood, "template", None)
        if settings.recognition is not None and template is not None:
            from facetrack_cli.trackers.appearance.appearance import find_gallery

            find_gallery(settings.recognition, template[::-1], recipe, above(name))


def _target(recipe: Recipe, start: Start, name: str) -> Target:
    """One target, without its corrections."""
    if isinstance(recipe, OpenCvRecipe):
        from facetrack_cli.trackers.opencv import OpenCvTarget

        return OpenCvTarget(name, box_of(start, name), recipe.tracker, start.origin)
    if isinstance(recipe, ParticlesRecipe) and recipe.hands is not None and name in recipe.later:
        from facetrack_cli.trackers.hands.target import HandTarget

        first = recipe.followed[0]
        left, right = (start.targets.get(hand, TargetStart()).box for hand in recipe.later)
        return HandTarget(name, first, recipe.later.index(name), recipe.hands, box_of(start, first), (left, right))
    key = name if name in recipe.filters else ""
    filter_settings = recipe.filters[key]
    if filter_settings.head is not None:
        return face_target(recipe, key, filter_settings, filter_settings.head, start, name)
    settings = recipe.exclusion if isinstance(recipe, ParticleRecipe | ParticlesRecipe) else None
    exclusion = None
    if settings is not None and name not in settings.first:
        from facetrack_cli.trackers.skin.likelihoods import log_weights

        exclusion = partial(log_weights, settings)
    return particle_target(recipe, key, filter_settings, start, name, ParticleTarget, exclusion)


def tracker_for(recipe: Recipe, start: Start, size: tuple[int, int]) -> Tracker:
    """As `build_tracker`, for a clip of this (width, height); raises also where start or windows do not fit it."""
    check_start(start, size, recipe.points)
    tracker = build_tracker(recipe, start)
    for target in tracker:  # windows and boxes larger than the frame would take memory without bound
        for part, (w, h) in target.windows.items():
            if recipe.points and part == BOX:
                continue  # a face may fill the frame
            if max(w / size[0], h / size[1]) > 1 and max(w, h) > MIN_WINDOW_PX:
                larger = f"larger than the frame of {size[0]}x{size[1]}; make it smaller"
                if not recipe.points:
                    raise InputError(f"{start.origin}: the box of {target.name}, {w:g}x{h:g} pixels, is {larger}")
                raise recipe.error("target.windows", f"the window of {part} would be {w:.0f}x{h:.0f} pixels, {larger}")
    return tracker


def _corrected(recipe: Recipe, start: Start, target: Target) -> Target:
    """The target with the corrections that the start has of it, if any; InputError for one that it cannot follow."""
    corrections = [fix for fix in start.corrections if fix.target == target.name]
    if not corrections:
        return target
    settings = recipe.filters.get(target.name, recipe.filters.get(""))
    kind = None if settings is None else settings.target  # None of OpenCV's trackers
    points = kind is not None and bool(kind.points)
    hand = target.name in recipe.later
    learns = not points and not hand and (kind is None or kind.relearns)
    absent: set[str] = set()
    for correction in corrections:
        origin = f"{start.origin}: the correction of {correction.target} at frame {correction.frame}"
        _check(correction, target, start, origin, points=points)
        if correction.confirmed:
            continue
        # what a correction leaves open stays absent
        still = () if is_complete(correction, target.parts) else absent - {*correction.points, *correction.kept}
        absent = {*correction.hidden(target.parts), *still}
        if absent >= set(correctable_parts(target.parts)):
            continue
        asked = correction.learn
        if (asked and (absent if points else not learns)) or (asked is False and kind is None and not hand):
            raise InputError(f"{origin}: what it looks like cannot be learned, or kept, there; leave learn out")

    def place(frame: Frame, correction: Correction) -> TargetStart:
        assert correction.box is not None
        said_in = f"{start.origin}: the correction of {correction.target} at frame {frame.index}"
        seen = [part for part in correctable_parts(target.parts) if part not in correction.hidden(target.parts)]
        return box_start(frame, correction.box, seen, by=start.measured_by, clip=said_in).targets[TARGET]

    def build(frame: Frame, target_start: TargetStart) -> Target:
        if points and target_start.box is None:
            target_start = replace(target_start, box=box_with(target_start, start.targets[target.name]))
        renewed = replace(start, frame=frame.index, targets={**start.targets, target.name: target_start})
        return _target(recipe, renewed, target.name)

    return CorrectedTarget(target, {fix.frame: fix for fix in corrections}, points, learns, place, build)


def _check(correction: Correction, target: Target, start: Start, origin: str, *, points: bool) -> None:
    """InputError if it speaks of parts that nobody knows, or lacks the box of what is followed as a box."""
    lists = (names for names in (correction.absent, correction.confirmed) if names is not True)
    named = [*correction.points, *correction.kept, *chain(*lists)]
    parts = {*correctable_parts(target.parts), *start.targets.get(correction.target, TargetStart()).points}
    if unknown := ", ".join(part for part in named if part not in parts):
        raise InputError(f"{origin}: has {unknown}; what is followed is {', '.join(correctable_parts(target.parts))}")
    hidden = correction.hidden(target.parts)
    if correction.confirmed:
        return
    if not points and not hidden and correction.box is None:
        raise InputError(f"{origin}: has no box, which the recipe follows; add one, as in box: [x, y, w, h]")
    strange = [part for part in correctable_parts(target.parts) if part not in PARTS and part not in hidden]
    if points and correction.box is not None and not correction.points and strange:
        raise InputError(f"{origin}: no cascade can place {', '.join(strange)} in its box; give points: in place of it")
    if not points and correction.box is not None:
        check_size(start.origin, f"{correction.target} at frame {correction.frame}", correction.box)


def name_targets(
    start: Start,
    names: Sequence[str],
    frame: Frame | None,
    *,
    left_out: Sequence[str] = (),
    later: Sequence[str] = (),
    clip: str = "the clip",
) -> Start:
    """The start with all targets `names`, in their order; without names, as it is.

    A single target, or one called `face`, takes the first name if the recipe does not know its own, with its
    corrections. Targets in `left_out` are dropped, those `later` need not be given.
    `frame` is the start's, and may be None if no target is missing.
    Raises InputError for unknown targets, no first one, or a grey frame; NotHereError for too few regions of skin.
    """
    if not names:
        return start
    targets = {name: target for name, target in start.targets.items() if name not in left_out}
    corrections = [fix for fix in start.corrections if fix.target not in left_out]
    first, followed = names[0], ", ".join(names)
    head_as = next(iter(targets)) if len(targets) == 1 and not set(targets) & set(names) else TARGET
    if first not in targets and head_as in targets:
        targets[first] = targets.pop(head_as)
        corrections = [replace(fix, target=first) if fix.target == head_as else fix for fix in corrections]
    if strangers := ", ".join(name for name in targets if name not in names):
        remedy = f"it follows {followed}: rename them in the init file, or in the recipe"
        raise InputError(f"{start.origin}: has {strangers}, which the recipe does not know; {remedy}")
    head = targets[first].box if first in targets else None
    if head is None:
        remedy = f"add one, as in {first}: {{box: [x, y, w, h]}}, or look for a face with --init haar"
        what = f"has no box of {first}, which the recipe begins with; it follows {followed}"
        raise InputError(f"{start.origin}: {what}: {remedy}")
    check_size(start.origin, first, head)
    if missing := [name for name in names if name not in (*targets, *later)]:
        from facetrack_cli.trackers.skin.likelihoods import learn_skin

        assert frame is not None
        taken = [other.box for name, other in targets.items() if name != first and other.box is not None]
        try:
            regions = hand_regions(frame, head, learn_skin(frame, head), len(missing), taken, MIN_BOX_PX)
        except InputError as e:
            raise InputError(f"{clip}: {first}, {e}") from None
        if len(regions) < len(missing):
            number = {0: "no region", 1: "one region"}.get(len(regions), f"{len(regions)} regions")
            shown = f"{number} of skin beside the {first}, to begin {' and '.join(missing)} with"
            remedy = f"begin elsewhere with --init-frame, or follow fewer, as by --set targets.{missing[-1]}=null"
            message = f"frame {start.frame} shows {shown}; give their boxes in an init file, {remedy}"
            raise NotHereError(f"{clip}: {message}")
        targets |= {name: TargetStart(box=box) for name, box in zip(missing, regions, strict=True)}
    ordered = {name: targets[name] for name in names if name in targets}
    return replace(start, targets=ordered, corrections=tuple(corrections))


def hand_regions(
    frame: Frame, face: Box, model: "SkinModel", count: int, taken: Sequence[Box] = (), least: float = 0.0
) -> list[Box]:
    """The `count` largest connected regions of skin colour beside the face and its neck, from left to right.

    Boxes are (left, top, width, height) in pixels, within the frame, each side at most about the face's; in a larger
    region, such as a bare arm, the box is where most skin is. Regions out of an arm's reach, of another size than a
    hand's, over a box of `taken`, or with a side of less than `least` pixels do not count: there may be fewer.
    """
    from facetrack_cli.trackers.skin.likelihoods import skin_map

    factor = factor_for(max(frame.size), MAX_SEARCHED_PX)
    image, _, _ = frame.reduced(factor, (0.0, 0.0, frame.size[0] - 1.0, frame.size[1] - 1.0))
    height, width = image.shape[:2]
    w, h = face[2] / factor, face[3] / factor
    left, top = (face[0] + 0.5) / factor - 0.5, (face[1] + 0.5) / factor - 0.5
    p = skin_map(image, model.table) / 255.0
    across, down = (2 * math.floor(max(side / 10, 1.0) / 2) + 1 for side in (w, h))  # odd
    p = np.asarray(cv2.blur(p, (across, down), borderType=cv2.BORDER_REPLICATE), np.float64)
    its_skin = float(_cut(p, left, top, left + w, top + h).sum())
    for x0, y0, x1, y1 in (FACE, NECK):
        _cut(p, left + x0 * w, top + y0 * h, left + x1 * w, top + y1 * h)[...] = 0
    _, labels, stats, _ = cv2.connectedComponentsWithStats((p >= MIN_SKIN).astype(np.uint8), connectivity=4)
    most = min(max(round(w), 2), width), min(max(round(h), 2), height)
    regions = []
    for k in range(1, len(stats)):
        x, y, across, down = stats[k, :4].tolist()
        part = np.s_[y : y + down, x : x + across]
        region = np.where(labels[part] == k, p[part], 0.0)
        if MIN_HAND * its_skin <= region.sum() <= MAX_HAND * its_skin:
            skin, (dx, dy, across, down) = _most_skin(region, most)
            middle = x + dx + across / 2, y + dy + down / 2
            if math.dist(middle, (left + w / 2, top + h / 2)) <= MAX_REACH * max(w, h):
                regions.append((-skin, (x + dx, y + dy, across, down)))
    free: list[Box] = []
    # by the skin in the box, or a large ceiling of nearly skin colour would come before the hands
    for _, (x, y, w, h) in sorted(regions):
        box = float(x * factor), float(y * factor), float(w * factor), float(h * factor)
        shared = (common_area(box, other) / min(box[2] * box[3], other[2] * other[3]) for other in taken)
        if min(box[2:]) >= least and all(share < SHARED for share in shared):
            free.append(box)
    return sorted(free[:count])


def _most_skin(region: Array, most: tuple[int, int]) -> tuple[float, tuple[int, int, int, int]]:
    """The part of a region no larger than `most` that holds most skin: how much, and left, top, width, height."""
    across, down = min(region.shape[1], most[0]), min(region.shape[0], most[1])
    sums = cv2.integral(region)
    held = sums[down:, across:] - sums[:-down, across:] - sums[down:, :-across] + sums[:-down, :-across]
    row, column = divmod(int(held.argmax()), held.shape[1])
    return float(held[row, column]), (column, row, across, down)


def _cut(p: Array, x0: float, y0: float, x1: float, y1: float) -> Array:
    """The pixels of a map whose centres are in a box, as a view; edges in pixels, none beyond its border."""
    left, right = (math.ceil(min(max(edge - 0.5, 0.0), float(p.shape[1]))) for edge in (x0, x1))
    top, bottom = (math.ceil(min(max(edge - 0.5, 0.0), float(p.shape[0]))) for edge in (y0, y1))
    return p[top:bottom, left:right]
