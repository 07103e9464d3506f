"""What a recipe wants to begin with, as a list to work through, and whether a draft has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.editor.web.draft import Draft, Json
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe, ParticlesRecipe, Recipe
from facetrack_cli.recipe.skin import SkinCloud
from facetrack_cli.tracking.start import PARTS, check_size, check_start, name_targets, read_init, write_init
from facetrack_cli.tracking.start.init_file import KEYS, OF_CORRECTIONS, TARGET
from facetrack_cli.tracking.start.init_writer import WHAT_PARTS_ARE

ORIGIN: Final = "the page"
DEFAULT: Final = "factorized"  # the recipe of `facetrack run` without --config
_TAKEN: Final = ("frame", "corrections", *KEYS, *OF_CORRECTIONS)
_ABOUT_BOXES: Final = (
    ("hand", "the whole hand, from the wrist to the finger tips"),
    ("head", "the face of this head, from the brows to the chin"),
    ("face", "from the brows to the chin, as wide as the face"),
)


class LackingError(Exception):
    """What keeps a draft from being a start, in one line."""


def wants(recipe: Recipe | None) -> list[Json]:
    """What each target begins with; a single entry stands for every target of a recipe that follows whatever there is.

    Each is {"target", "box": "needed", "optional" or "no", "points": [...], "about": {part or "box": words}}. Without a
    recipe it is a face and the five points that can be placed.
    """
    if recipe is None:
        return [_want(TARGET, PARTS, boxed=False)]
    if not isinstance(recipe, ParticlesRecipe):
        return [_want(TARGET, recipe.points, boxed=False)]
    first, *_ = recipe.filters
    # the face of the first is where the others are looked for, and a cloud learns its colours from a box
    likelihoods = [(name, one.likelihood) for name, one in recipe.filters.items()]
    teachers = {one.learn_from or name for name, one in likelihoods if isinstance(one, SkinCloud)}
    return [_want(name, one.points, boxed=name in teachers | {first}) for name, one in recipe.filters.items()]


def _want(target: str, points: Sequence[str], *, boxed: bool) -> Json:
    about = {part: WHAT_PARTS_ARE[part] for part in points if part in WHAT_PARTS_ARE}
    about["box"] = about_box(target)
    # lengths are measured by the box where there is no second point
    return {
        "target": target,
        "box": "needed" if boxed or len(points) < 2 else "optional",
        "points": list(points),
        "about": about,
    }


def about_box(target: str) -> str:
    """What a target's box should hold."""
    return next((words for name, words in _ABOUT_BOXES if name in target.lower()), "all of it, and little else")


def start_of(
    draft: Draft,
    wanted: Sequence[Json],
    size: tuple[int, int],
    frames: int | None,
    recipe: Recipe | None,
    begun: Start | None,
) -> Start:
    """The start that a draft amounts to, in pixels to 0.01, which a run accepts and `read_init` reads back.

    Windows and corrections of the start `begun`, which was there before, stay where they still fit. `size` is (width,
    height), `frames` their number where it is known for certain. Raises LackingError.
    """
    chosen = {name: one.rounded() for name, one in draft.targets.items() if one.box is not None or one.points}
    if recipe is not None:
        chosen = {name: one for name, one in chosen.items() if name not in recipe.left_out}
    _check_complete(chosen, wanted, free=recipe is None or not recipe.followed)
    odd = [name for name in chosen if get_close_matches(name, _TAKEN, n=1, cutoff=0.7)]
    if odd:
        raise LackingError(f"a target cannot be called {odd[0]}, too like a key of init files; rename it")
    start = carried(Start(draft.frame, chosen, ORIGIN), begun)
    try:
        if recipe is not None:
            start = name_targets(start, recipe.followed, None, left_out=recipe.left_out)
        check_start(start, size, recipe.points if recipe is not None else PARTS, frames)
        for name, target in start.targets.items():
            if target.box is not None:
                check_size(ORIGIN, name, target.box)
        _check_build(start, size, recipe if recipe is not None else load_recipe(DEFAULT))
        _check_written(start)
    except FacetrackError as e:
        raise LackingError(" ".join(str(e).splitlines()).removeprefix(f"{ORIGIN}: ")) from None
    return start


def fitted(start: Start, recipe: Recipe | None) -> Start:
    """The start with those targets that the recipe follows; a single one by another name is the first of them."""
    if recipe is None or not recipe.followed:
        return start
    followed, names = recipe.followed, list(start.targets)
    unknown = len(names) == 1 and names[0] not in followed
    called = {names[0]: followed[0]} if unknown else {name: name for name in names if name in followed}
    return replace(
        start,
        targets={called[name]: target for name, target in start.targets.items() if name in called},
        corrections=tuple(replace(one, target=called[one.target]) for one in start.corrections if one.target in called),
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


def _check_complete(chosen: Mapping[str, TargetStart], wanted: Sequence[Json], *, free: bool) -> None:
    """LackingError that names all that is missing, by target."""
    if not chosen:
        raise LackingError(f"nothing is chosen yet; choose {_listed(_missing(TargetStart(), wanted[0]))}")
    if free:
        pairs = [(name, target, wanted[0]) for name, target in chosen.items()]
    else:
        known = [want["target"] for want in wanted]
        strangers = [name for name in chosen if name not in known]
        if strangers:
            raise LackingError(f"the recipe follows {', '.join(known)}, and no {', '.join(strangers)}; remove it")
        pairs = [(want["target"], chosen.get(want["target"], TargetStart()), want) for want in wanted]
    lacking = [(name, missing) for name, target, want in pairs if (missing := _missing(target, want))]
    if lacking:
        said = "; ".join(f"{_listed(missing)} of {name}" for name, missing in lacking)
        raise LackingError(f"still to choose: {said}")


def _missing(target: TargetStart, want: Json) -> list[str]:
    missing = [part for part in want["points"] if part not in target.points]
    return ["the box", *missing] if want["box"] == "needed" and target.box is None else missing


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _check_build(start: Start, size: tuple[int, int], recipe: Recipe) -> None:
    """Raises what the run would: build_tracker, and check_windows."""
    from facetrack_cli.tracking.build.build import build_tracker
    from facetrack_cli.tracking.start.checks import check_windows

    recipe = _without_gallery(recipe)
    check_windows(recipe, build_tracker(recipe, start), size, start.origin)


def _without_gallery(recipe: Recipe) -> Recipe:
    """Who is recognised is for the run to say, and nothing of where it begins."""
    if isinstance(recipe, ParticleRecipe):
        return recipe.model_copy(update={"recognition": None})
    if isinstance(recipe, ParticlesRecipe):
        nobody = {"recognition": None}
        targets = {name: one and one.model_copy(update=nobody) for name, one in recipe.targets.items()}
        return recipe.model_copy(update={"targets": targets})
    return recipe


def _check_written(start: Start) -> None:
    """InputError if a file of this start would not be read back as it is."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "start.yaml"
        write_init(path, start)
        try:
            again = read_init(path)
        except InputError as e:
            _, _, why = str(e).partition(": ")
            raise InputError(why) from None
    if replace(again, origin=start.origin) != start:
        raise AssertionError(f"{start} would be read as {again}")
