"""What a recipe requires to begin with, as a list to work through, and whether a draft has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Final, Literal

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.editor.web.draft import Draft, Json
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe, ParticlesRecipe, Recipe
from facetrack_cli.recipe.skin import SkinCloud
from facetrack_cli.tracking.start import PARTS, check_size, check_start, name_targets
from facetrack_cli.tracking.start.init_file import KEYS, OF_CORRECTIONS, TARGET, WHAT_PARTS_ARE

ORIGIN: Final = "the page"
DEFAULT: Final = "factorized"  # the recipe of `facetrack run` without --config
_RESERVED: Final = ("frame", "corrections", *KEYS, *OF_CORRECTIONS)
_ABOUT_BOXES: Final = {
    "hand": "the whole hand, from the wrist to the finger tips",
    "head": "the face of this head, from the brows to the chin",
    "face": "from the brows to the chin, as wide as the face",
}


class MissingError(Exception):
    """What is missing or wrong in a draft that is to be a start, in one line."""


def requirement(target: str, points: Sequence[str], box: Literal["needed", "optional", "no"]) -> Json:
    """What the page asks for of one target; "about" says in words what each point, and the box, should be."""
    about = {part: WHAT_PARTS_ARE[part] for part in points if part in WHAT_PARTS_ARE}
    about["box"] = next((text for name, text in _ABOUT_BOXES.items() if name in target.lower()), "all of it, no more")
    return {"target": target, "box": box, "points": list(points), "about": about}


def requirements(recipe: Recipe | None) -> list[Json]:
    """The `requirement` of each target; a single one stands for every target of a recipe without named targets.

    Without a recipe it is a face and the five points that can be placed.
    """
    if not isinstance(recipe, ParticlesRecipe):
        points = PARTS if recipe is None else recipe.points
        return [requirement(TARGET, points, _box_for(points))]
    first, *_ = recipe.filters
    # the first target's face is where the others are looked for, and a cloud learns its colours from a box
    clouds = {name: one.likelihood for name, one in recipe.filters.items() if isinstance(one.likelihood, SkinCloud)}
    boxed = {first, *(one.learn_from or name for name, one in clouds.items())}
    filters = recipe.filters.items()
    return [requirement(name, one.points, "needed" if name in boxed else _box_for(one.points)) for name, one in filters]


def _box_for(points: Sequence[str]) -> Literal["needed", "optional"]:
    """The box is the unit of length where there is no second point."""
    return "needed" if len(points) < 2 else "optional"


def start_of(
    draft: Draft,
    required: Sequence[Json],
    size: tuple[int, int],
    frames: int | None,
    recipe: Recipe | None,
    begun: Start | None,
) -> Start:
    """The start that a draft amounts to, in pixels to 0.01, which a run accepts and `read_init` reads back.

    Windows and corrections of the start `begun`, which was there before, stay where they still fit. `size` is (width,
    height), `frames` their number where it is known for certain. Raises MissingError.
    """
    chosen = draft.placed()
    if recipe is not None:
        chosen = {name: one for name, one in chosen.items() if name not in recipe.left_out}
    _check_complete(chosen, required, free=recipe is None or not recipe.followed)
    reserved = [name for name in chosen if get_close_matches(name, _RESERVED, n=1, cutoff=0.7)]
    if reserved:
        raise MissingError(f"a target cannot be called {reserved[0]}, too like a key of init files; rename it")
    start = carried(Start(draft.frame, chosen, ORIGIN), begun)
    try:
        if recipe is not None:
            start = name_targets(start, recipe.followed, None, left_out=recipe.left_out)
        check_start(start, size, recipe.points if recipe is not None else PARTS, frames)
        for name, target in start.targets.items():
            if target.box is not None:
                check_size(ORIGIN, name, target.box)
        _check_build(start, size, recipe if recipe is not None else load_recipe(DEFAULT))
    except FacetrackError as e:
        raise MissingError(" ".join(str(e).splitlines()).removeprefix(f"{ORIGIN}: ")) from None
    return start


def fitted(start: Start, recipe: Recipe | None) -> Start:
    """The start with those targets that the recipe follows; a single one by another name is the first of them."""
    if recipe is None or not recipe.followed:
        return start
    names = {name: name for name in start.targets if name in recipe.followed}
    if len(start.targets) == 1 and not names:
        names = dict.fromkeys(start.targets, recipe.followed[0])
    return replace(
        start,
        targets={names[name]: target for name, target in start.targets.items() if name in names},
        corrections=tuple(replace(one, target=names[one.target]) for one in start.corrections if one.target in names),
    )


def carried(start: Start, begun: Start | None) -> Start:
    """The start with the windows and corrections of `begun` that still have their target and come after it."""
    if begun is None:
        return start
    targets = {}
    for name, target in start.targets.items():
        before = begun.targets.get(name, TargetStart())
        targets[name] = replace(target, windows={p: w for p, w in before.windows.items() if p in target.points})
    kept = tuple(one for one in begun.corrections if one.target in targets and one.frame > start.frame)
    return replace(start, targets=targets, corrections=kept)


def _check_complete(chosen: Mapping[str, TargetStart], required: Sequence[Json], *, free: bool) -> None:
    """MissingError that names everything that is missing, by target."""
    if not chosen:
        raise MissingError(f"nothing is chosen yet; choose {_listed(_missing(TargetStart(), required[0]))}")
    by_name = dict.fromkeys(chosen, required[0]) if free else {one["target"]: one for one in required}
    unknown = [name for name in chosen if name not in by_name]
    if unknown:
        raise MissingError(f"the recipe follows {', '.join(by_name)}, and no {', '.join(unknown)}; remove it")
    missing = {name: _missing(chosen.get(name, TargetStart()), one) for name, one in by_name.items()}
    if any(missing.values()):
        listed = "; ".join(f"{_listed(parts)} of {name}" for name, parts in missing.items() if parts)
        raise MissingError(f"still to choose: {listed}")


def _missing(target: TargetStart, required: Json) -> list[str]:
    box = ["the box"] if required["box"] == "needed" and target.box is None else []
    return [*box, *(part for part in required["points"] if part not in target.points)]


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _check_build(start: Start, size: tuple[int, int], recipe: Recipe) -> None:
    """Raises what the run would: build_tracker, and check_windows. Recognition is left out: it needs a gallery."""
    from facetrack_cli.tracking.build.build import build_tracker
    from facetrack_cli.tracking.start.checks import check_windows

    nobody = {"recognition": None}
    if isinstance(recipe, ParticleRecipe):
        recipe = recipe.model_copy(update=nobody)
    elif isinstance(recipe, ParticlesRecipe):
        targets = {name: one and one.model_copy(update=nobody) for name, one in recipe.targets.items()}
        recipe = recipe.model_copy(update={"targets": targets})
    check_windows(recipe, build_tracker(recipe, start), size, start.origin)
