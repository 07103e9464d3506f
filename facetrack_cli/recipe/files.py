"""The files of recipes: the shipped ones, and those that a recipe names."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from facetrack_cli.core.errors import RecipeError, reading
from facetrack_cli.core.shipped import shipped_folder as shipped_folder
from facetrack_cli.core.shipped import shipped_recipes as shipped_recipes
from facetrack_cli.core.yaml_tree import Problem, Source, Span, YamlProblems, read_source
from facetrack_cli.recipe.messages import locate
from facetrack_cli.recipe.model import Recipe, error_of
from facetrack_cli.recipe.sections import suggest

TASKS: Final[Mapping[str, tuple[str, ...]]] = {
    "a face and its features": ("face", "factorized_robust"),
    "any box: a face, a head, a hand, a thing": ("correlation_filter", "skin_ncc_robust", "adaptive_robust"),
    "a head and two hands": ("signer",),
    "a face, and who of a gallery it is": ("adaptive_recognition",),
    "published: points of a face (Patras & Pantic 2004)": (
        "factorized", "factorized_transition", "auxiliary_prior", "independent", "sir",
    ),
    "published: a face by its appearance (Zhou et al. 2003)": (
        "adaptive", "adaptive_noise", "adaptive_velocity", "adaptive_appearance", "fixed_template",
    ),
    "published: a face by skin and template (Gonzalez & Collet)": ("skin_ncc", "skin", "ncc"),
    "published: a head and two hands (Gonzalez & Collet)": ("head_hands", "head_hands_cloud"),
    "published: contours and histograms (Odobez et al. 2003)": (
        "contour_histogram_correlation", "contour_histogram_correlation_robust", "contour_histogram",
        "contour_correlation", "contour", "histogram_correlation", "histogram",
    ),
    "OpenCV's own trackers": ("csrt", "kcf", "mil", "mosse"),
}  # fmt: skip
"""The shipped recipes by what is tracked; of the first four the first recipe is the one to take."""
TAKE: Final = tuple(names[0] for names in list(TASKS.values())[:4])


def default_recipe(*, box: bool) -> str:
    """The recipe that is taken where none is named; `box`: where a box says what is followed."""
    return "correlation_filter" if box else "face"


def find_recipe(name_or_path: str) -> Path:
    """The file of a recipe: a path that exists, else a shipped one by its name, with or without `.yaml`."""
    path, folder = Path(name_or_path), False
    try:
        folder = bool(name_or_path) and path.is_dir()
        if name_or_path and path.exists() and not folder:
            return path
    except (OSError, ValueError):  # a name that the file system does not take
        pass
    shipped = {file.stem: file for file in shipped_recipes()}
    wanted = name_or_path.removesuffix(".yaml")
    if wanted in shipped:
        return shipped[wanted]
    near = suggest(path.name.removesuffix(".yaml"), list(shipped), "")
    hint = f"{near} " if near.startswith("did") else "give a file or a name; "
    what = "a folder, not a recipe" if folder else "neither a file nor a shipped recipe"
    raise RecipeError(f'"{name_or_path}" is {what}; {hint}shipped are {", ".join(shipped)}')


def read_recipe(path: Path) -> str:
    """The text of a recipe's file, right or wrong; RecipeError if it is none."""
    try:
        return read_file(path).text
    except YamlProblems as refused:
        raise error_of(refused.problems) from None


def resolve_file(recipe: Recipe, name: str, key: str) -> Path:
    """A file that the recipe names, at `key` as in `prior.file`: beside it, or shipped; RecipeError if nowhere."""
    try:
        return find_file(recipe, name, key)
    except YamlProblems as refused:
        raise error_of(refused.problems) from None


def read_file(path: Path) -> Source:
    with reading(path, "check the file's permissions", RecipeError):
        return read_source(path, str(path))


def find_file(recipe: Recipe, name: str, key: str) -> Path:
    span = Span(Source(str(recipe.path), "", recipe.path.parent), 0, 0, 1)
    if recipe._root is not None:
        node, _, exact = locate(recipe._root, tuple(key.split(".")))
        span = node.span if exact else span
    # that of --set is the working directory
    folders = list(dict.fromkeys([span.source.folder, recipe.path.parent, shipped_folder()]))
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    sought = " and ".join(map(str, folders))
    raise YamlProblems([Problem(span, f'there is no file "{name}" in {sought}; correct the name, or put it there')])
