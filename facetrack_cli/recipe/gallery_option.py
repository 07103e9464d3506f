"""People to recognise, given beside recipes: what `--gallery FILE` does."""

import json
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.yaml_tree import YamlProblems, assign, printable
from facetrack_cli.recipe.model import Recipe, above, error_of
from facetrack_cli.trackers.appearance.settings import AffineSettings

MADE_BY = "as facetrack gallery fit writes it"


def with_gallery(recipes: Sequence[Recipe], file: str | None) -> list[Recipe]:
    """The recipes, those that recognise with the gallery's people; if none does, all of affine targets.

    A recipe recognises if it has a section `recognition`. Without a file each must have a gallery of its own. Raises
    UsageError where there is nobody to recognise, or nothing that recognises, and InputError for no such file.
    """
    if file is None:
        for recipe in recipes:
            if wants_gallery(recipe):
                remedy = f"give --gallery FILE, {MADE_BY}, or name one in the recipe, in recognition.gallery"
                who = f"{recipe.name} says who somebody is, of the people of a gallery"
                raise UsageError(f"--gallery is missing: {who}; {remedy}")
        return list(recipes)
    check_file(file)
    recognising = any(_recognising(one) for one in recipes)
    if not recognising and not any(_affine(one) for one in recipes):
        types = sorted({given.target.type for given in recipes[0].filters.values()})
        follows = " and ".join(one if one == "points" else f"a {one}" for one in types)
        what = f"{recipes[0].name} follows {follows}" if types else f"{recipes[0].name} is one of OpenCV's own trackers"
        remedy = "take adaptive_recognition, or leave --gallery out"
        raise UsageError(f"--gallery: {what}, and people are recognised by affine targets alone; {remedy}")
    return [put(one, file) if (_recognising if recognising else _affine)(one) else one for one in recipes]


def _recognising(recipe: Recipe) -> list[str]:
    return [name for name, given in recipe.filters.items() if given.recognition is not None]


def _affine(recipe: Recipe) -> list[str]:
    return [name for name, given in recipe.filters.items() if isinstance(given.target, AffineSettings)]


def wants_gallery(recipe: Recipe) -> bool:
    """Whether it recognises and does not say whom."""
    return any(given.recognition and given.recognition.gallery is None for given in recipe.filters.values())


def check_file(file: str) -> None:
    """Raises UsageError or InputError for what is no file."""
    if not file:
        raise UsageError(f"--gallery is empty; name a gallery, {MADE_BY}")
    path, shown = Path(file), f"--gallery {printable(file)}"
    try:
        there, folder = path.is_file(), path.is_dir()
    except (OSError, ValueError):  # a name that the file system does not take
        there = folder = False
    if folder:
        remedy = f"name a file in it, {MADE_BY}; facetrack gallery fit {printable(file)} makes one of people's folders"
        raise InputError(f"{shown}: is a folder; {remedy}")
    if not there:
        raise InputError(f"{shown}: no such file; correct the name, or make one with facetrack gallery fit")


def put(recipe: Recipe, file: str) -> Recipe:
    """The recipe with this gallery in place of its own: where it recognises, else wherever it can."""
    assert recipe._root is not None
    root = deepcopy(recipe._root)
    try:
        for name in _recognising(recipe) or _affine(recipe):
            assign(root, "--gallery", f"{above(name)}recognition.gallery={json.dumps(file)}")
    except YamlProblems as refused:  # a name that is not UTF-8
        raise error_of(refused.problems) from None
    return type(recipe).model_validate(root.plain(), context={"path": recipe.path, "root": root})
