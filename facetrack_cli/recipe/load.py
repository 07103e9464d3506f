"""From a name or a path to a checked recipe, or what is wrong with it; the people of `--gallery`; calibrations."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Any, Final

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from facetrack_cli.core.errors import InputError, RecipeError, UsageError, reading
from facetrack_cli.core.models import model_path, shipped_folder, shipped_recipes
from facetrack_cli.core.yaml_tree import Node, Problem, Source, Span, YamlProblems, assign, parse, read_source
from facetrack_cli.recipe.model import KINDS, ParticleRecipe, ParticlesRecipe, Recipe, above, completed, to_dict
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
OVERRIDES: Final = r",(?=[\w.]+=)"  # a comma before a key, which those in windows=[25,25] are not
TAKE: Final = tuple(names[0] for names in list(TASKS.values())[:4])


def default_recipe(*, box: bool) -> str:
    """The recipe that is taken where none is named; `box`: where a box says what is followed."""
    return "correlation_filter" if box else "face"


def find_recipe(name_or_path: str) -> Path:
    """The file of a recipe: a path that exists, else a shipped one by its name, with or without `.yaml`."""
    path = Path(name_or_path)
    with suppress(OSError, ValueError):  # a name that the file system does not take
        if name_or_path and path.exists() and not path.is_dir():
            return path
    shipped = {file.stem: file for file in shipped_recipes()}
    wanted = name_or_path.removesuffix(".yaml")
    if wanted in shipped:
        return shipped[wanted]
    hint = suggest(wanted, list(shipped), "the shipped recipes are")
    raise RecipeError(f'"{name_or_path}" is neither a file nor a shipped recipe; {hint}')


def read_recipe(path: Path) -> Source:
    """The text of a recipe's file, right or wrong; RecipeError if it is none."""
    with reading(path, "check the file's permissions", RecipeError):
        return read_source(path, str(path))


def resolve_file(recipe: Recipe, name: str, key: str) -> Path:
    """A file that the recipe names, at `key` as in `prior.file`: beside it, or shipped; RecipeError if nowhere."""
    # that of --set is the working directory
    folders = list(dict.fromkeys([recipe.span(key).source.folder, recipe.path.parent, shipped_folder()]))
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    sought = " and ".join(map(str, folders))
    raise recipe.error(key, f'there is no file "{name}" in {sought}; correct the name, or put it there')


def load_recipe(
    name_or_path: str, overrides: Sequence[str] | Mapping[str, Any] = (), *, installed: bool = True
) -> Recipe:
    """Read a recipe from a path, or by the name of a shipped one.

    Parameters
    ----------
    name_or_path
        A file that exists, else the name of a shipped recipe, with or without .yaml.
    overrides
        Values by key, as in `{"filter.particles": 200}`, or texts such as `filter.particles=200`.
    installed
        If False, `auto` takes no model that this machine has and others may lack.

    Raises
    ------
    RecipeError
        The first thing that is wrong, and how many more there are.
    """
    if isinstance(overrides, Mapping):
        overrides = [f"{key}={json.dumps(value)}" for key, value in overrides.items()]
    path = find_recipe(name_or_path)
    source = read_recipe(path)
    recipe, more = _made(path, source, tuple(overrides)), list[str]()
    for name, head in recipe.heads.items():
        network, key = head.landmarks.network, f"{above(name)}head.landmarks."
        if network == "auto":
            network = "mesh" if installed and model_path("mesh") else None
            more.append(f"{key}network={network or 'null'}")
        if head.landmarks.iris == "auto":
            more.append(f"{key}iris={'iris' if network and installed and model_path('iris') else 'null'}")
    return _made(path, source, (*overrides, *more)) if more else recipe  # what continues a run uses the same networks


def check_recipe(name_or_path: str, overrides: Sequence[str] = ()) -> list[Problem]:
    """Everything that is wrong with a recipe, and with the files that it names; nothing of one that can run.

    `name_or_path` and `overrides` are as of `load_recipe`. Raises RecipeError where there is no such recipe.
    """
    try:
        files_of(load_recipe(name_or_path, overrides))
    except YamlProblems as refused:
        return list(refused.problems)
    return []


def files_of(recipe: Recipe) -> list[Path]:
    """The files that a recipe names: priors, galleries, calibrations. YamlProblems for a missing one."""
    files: dict[str, str] = {}
    for name, settings in recipe.filters.items():
        for section, part in settings.components.items():
            files |= {f"{above(name)}{section}.{key}": file for key, file in part.files.items()}
        if settings.confidence.calibration is not None:
            files[f"{above(name)}confidence.calibration"] = settings.confidence.calibration
    return [resolve_file(recipe, file, key) for key, file in files.items()]


_parsed = lru_cache(8)(parse)  # a recipe is made twice where the machine decides something


@lru_cache(64)  # a run asks twice, once to see whether its calibration holds, a comparison of many recipes more often
def _made(path: Path, source: Source, overrides: tuple[str, ...]) -> Recipe:
    parsed = _parsed(source)
    if parsed is None or parsed.value is None:
        shipped = "start from a shipped recipe: facetrack recipes show factorized"
        raise YamlProblems(Problem(Span(source, 0, 0), f"the recipe is empty; {shipped}"))
    root = deepcopy(parsed)
    if not isinstance(root.value, dict):
        raise YamlProblems(Problem(root.span, "a recipe is a mapping of keys such as target: and filter:, not this"))
    for override in overrides:
        assign(root, "--set", override)
    several = "targets" in root.value and "target" not in root.value
    kind: type[Recipe] = ParticlesRecipe if several else ParticleRecipe
    if (given := root.value.get("type")) is not None:
        name = given.value if isinstance(given.value, str) else ""
        if name not in KINDS:
            hint = suggest(name, list(KINDS), "it is one of")
            raise YamlProblems(Problem(given.span, f'unknown type of recipe "{name}"; {hint}'))
        kind = KINDS[name]
    try:
        return kind.model_validate(root.plain(), context={"path": path, "root": root})
    except ValidationError as error:
        raise YamlProblems(*problems(error, root)) from None


# --- the people of `--gallery` ---------------------------------------------------------------------------------------

_MADE_BY = "as facetrack gallery fit writes it"


def with_gallery(recipes: Sequence[Recipe], file: str | None) -> list[Recipe]:
    """The recipes, those that recognise with the gallery's people; if none does, all of affine targets.

    A recipe recognises if it has a section `recognition`. Without a file each must have a gallery of its own. Raises
    UsageError where there is nobody to recognise, or nothing that recognises, and InputError for no such file.
    """
    if file is None:
        for recipe in filter(wants_gallery, recipes):
            remedy = f"give --gallery FILE, {_MADE_BY}, or name one in the recipe, in recognition.gallery"
            raise UsageError(f"--gallery is missing: {recipe.name} recognises the people of a gallery; {remedy}")
        return list(recipes)
    gallery_file(file)
    takes = _recognising if any(map(_recognising, recipes)) else _affine
    if not any(map(takes, recipes)):
        what = f"{recipes[0].name} follows no affine target, by which alone people are recognised"
        raise UsageError(f"--gallery: {what}; take adaptive_recognition, or leave --gallery out")
    return [put_gallery(recipe, file) if takes(recipe) else recipe for recipe in recipes]


def _recognising(recipe: Recipe) -> list[str]:
    return [name for name, settings in recipe.filters.items() if settings.recognition is not None]


def _affine(recipe: Recipe) -> list[str]:
    return [name for name, settings in recipe.filters.items() if settings.target.type == "affine"]


def wants_gallery(recipe: Recipe) -> bool:
    """Whether it recognises and does not say whom."""
    return any(settings.recognition and settings.recognition.gallery is None for settings in recipe.filters.values())


def gallery_file(file: str) -> Path:
    """The path of a file of --gallery. Raises InputError for what is no file."""
    if Path(file).is_file():
        return Path(file)
    raise InputError(f"--gallery {file}: no such file; name one {_MADE_BY}")


def put_gallery(recipe: Recipe, file: str) -> Recipe:
    """The recipe with this gallery in place of its own: where it recognises, else wherever it can."""
    assert recipe._root is not None
    root = deepcopy(recipe._root)
    for name in _recognising(recipe) or _affine(recipe):
        assign(root, "--gallery", f"{above(name)}recognition.gallery={json.dumps(file)}")
    return type(recipe).model_validate(root.plain(), context={"path": recipe.path, "root": root})


# --- calibrations ----------------------------------------------------------------------------------------------------

_FREE = frozenset(("name", "description", "seed"))  # what a calibration does not depend on


def calibrated(settings: Mapping[str, Any]) -> bool:
    """Whether all filters of a recipe with these settings name a calibration that was made for it.

    The calibration of a shipped recipe holds for that recipe, unchanged. Any other file is taken to fit.
    """
    files = _files(settings)
    return bool(files) and all(_shipped(file) in (None, _bare(completed(settings))) for file in files)


def fitted(settings: Mapping[str, Any]) -> bool:
    """Whether all filters name a calibration, be it made for other settings."""
    return bool(_files(settings))


def _files(settings: Mapping[str, Any]) -> list[str]:
    """The calibrations of all filters; none if one has none."""
    targets = settings.get("targets")
    filters = [target for target in targets.values() if target] if isinstance(targets, Mapping) else [settings]
    sections = [settings_of.get("confidence") for settings_of in filters if isinstance(settings_of, Mapping)]
    files = [section.get("calibration") if isinstance(section, Mapping) else None for section in sections]
    return [] if None in files else [str(file) for file in files]


@lru_cache
def _shipped(file: str) -> dict[str, Any] | None:
    """The settings of the shipped recipe whose calibration this is; None for a file of somebody else."""
    name = PurePath(file).stem
    if all(recipe.stem != name for recipe in shipped_recipes()):
        return None
    ours = _bare(to_dict(load_recipe(name, installed=False)))  # whatever networks this machine has
    return ours if file == (ours.get("confidence") or {}).get("calibration") else None


def _bare(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in settings.items() if key not in _FREE}


# --- what pydantic finds in a recipe, as problems with a place in the text -------------------------------------------


def problems(error: ValidationError, root: Node) -> list[Problem]:
    """Everything that the error lists, in the order of the text."""
    listed = [problem for details in error.errors(include_url=False) for problem in _problems(details, root)]
    return sorted(listed, key=lambda p: (not p.span.source.is_file, p.span.line, p.span.column))


def _problems(details: ErrorDetails, root: Node) -> Iterator[Problem]:
    kind, path = details["type"], details["loc"]
    if kind == "refused":
        for refusal in details["ctx"]["refusals"]:
            node, _ = root.at((*path, *refusal.path))
            yield Problem(node.key if refusal.at_key and node.key else _value_span(node), refusal.message)
        return
    node, keys = root.at(path)
    where = ".".join(keys).replace(".[", "[") or "the recipe"
    if kind in ("missing", "no_type"):
        key = "type" if kind != "missing" else path[-1] if isinstance(path[-1], str) else f"[{path[-1] + 1}]"
        yield Problem(node.key or node.span, f'{where} lacks "{key}"; add it')
    elif kind == "extra_forbidden":
        yield Problem(node.key or node.span, f'unknown key "{where}"; correct it, or remove it')
    elif kind == "wrong_type":
        chosen, _ = node.at(["type"])
        yield Problem(chosen.span, f"{where}.type is one of {details['ctx']['known']}, not {_shown(chosen)}")
    elif path[-1:] == ("[key]",):  # how pydantic calls the name itself in a mapping from any name
        rule = "a name has small letters, digits and _, and begins with a letter"
        yield Problem(node.key or node.span, f"{where}: {rule}")
    elif kind != "too_short" or len(node.plain()) < details["ctx"]["min_length"]:  # wrong items do not count there
        said = details["msg"].replace("Tuple", "List").replace("tuple", "list")
        said = "must be a mapping of keys" if kind in ("model_type", "dict_type") else said
        yield Problem(_value_span(node), f"{where}: {said}" + f", not {_shown(node)}" * (", not " not in said))


def _value_span(node: Node) -> Span:
    """The place of a wrong value; of a section, and of an empty value, the place of its key."""
    return node.key if node.key is not None and (node.value is None or isinstance(node.value, dict)) else node.span


def _shown(node: Node) -> str:
    text = json.dumps(node.plain(), ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:60]}..."
