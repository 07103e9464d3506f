"""A recipe: everything a tracker is made of, as a checked, frozen value read from YAML.

The kinds of recipe below and their sections (`recipe_sections.py`) are the format. No numerics are imported here.

    recipe = load_recipe("factorized", ["filter.particles=200"])
    recipe.filter.particles         # 200
    recipe.motion.sigma.of("nose")  # Length(value=0.1, px=False)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import (
    Field,
    PrivateAttr,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from facetrack_cli.errors import RecipeError
from facetrack_cli.lengths import Length, PerPart, Window
from facetrack_cli.recipe_adaptive import Adaptive, Affine, AffineWalk, Appearance, Recognition
from facetrack_cli.recipe_base import Section
from facetrack_cli.recipe_filter import MOST_HYPOTHESES, ParticleFilter
from facetrack_cli.recipe_messages import Refusal, locate, problems, refuse, suggest
from facetrack_cli.recipe_regions import Contour, Correlation, FirstOrder, Histogram, Product, Region
from facetrack_cli.recipe_sections import (
    Auxiliary,
    ColourRatio,
    Confidence,
    Factorized,
    Filter,
    Independent,
    Motion,
    Parzen,
    Points,
    RandomWalk,
    Sir,
)
from facetrack_cli.recipe_skin import Cloud, Exclusion, Pattern, Skin, SkinCloud, SkinNcc
from facetrack_cli.yaml_text import Node, Problem, Source, Span, YamlProblems, assign, parse, read_source

__all__ = [
    "Adaptive",
    "Affine",
    "AffineWalk",
    "Appearance",
    "Auxiliary",
    "Cloud",
    "ColourRatio",
    "Confidence",
    "Contour",
    "Correlation",
    "Exclusion",
    "Factorized",
    "Filter",
    "FirstOrder",
    "Histogram",
    "Independent",
    "Length",
    "Motion",
    "OpenCvRecipe",
    "ParticleFilter",
    "ParticleRecipe",
    "ParticlesRecipe",
    "Parzen",
    "Pattern",
    "PerPart",
    "Points",
    "Product",
    "RandomWalk",
    "Recipe",
    "Recognition",
    "Region",
    "Sir",
    "Skin",
    "SkinCloud",
    "SkinNcc",
    "Window",
    "check_recipe",
    "completed",
    "filters",
    "find_recipe",
    "json_schema",
    "load_recipe",
    "read_recipe",
    "resolve_file",
    "shipped_folder",
    "shipped_recipes",
    "to_dict",
]


TargetName: TypeAlias = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=60)]


class Recipe(Section):
    """What every recipe has; `type` says which kind of tracker it is."""

    type: str
    description: Annotated[str, Field(min_length=1, max_length=300)]
    """One line for `facetrack recipes`."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the random numbers: the same seed gives the same track."""

    _path: Path = PrivateAttr(default=Path("recipe.yaml"))
    _root: Node | None = PrivateAttr(default=None)

    def model_post_init(self, context: Any) -> None:
        if context is not None:
            self._path, self._root = context["path"], context["root"]

    @property
    def path(self) -> Path:
        """The file that it was read from."""
        return self._path

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self._path.stem

    @property
    def points(self) -> tuple[str, ...]:
        """The points that a start must place in every target; none for a tracker that begins with a box."""
        return ()

    @property
    def followed(self) -> tuple[str, ...]:
        """The names of its targets, the one whose face is looked for first; none for a tracker of whatever there is."""
        return ()

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of targets that it knows and does not follow: where a start has them, they are passed over."""
        return ()

    @property
    def particles(self) -> int | None:
        """Number of particles, None for a tracker without."""
        return None

    @property
    def random(self) -> bool:
        """Whether another seed may give another track."""
        return True

    @property
    def judges(self) -> bool:
        """Whether it may call a part lost."""
        return True

    def error(self, key: str, message: str) -> RecipeError:
        """An error that points at a key of this recipe, as in `prior.file`; for rules that only building can check."""
        if self._root is None:
            return RecipeError(f"{self._path}: {message}")
        node, _, _ = locate(self._root, tuple(key.split(".")))
        return _error([Problem(node.span, message)])


class OpenCvRecipe(Recipe):
    """One of OpenCV's own trackers of a box, to compare with."""

    type: Literal["opencv"]
    """One of OpenCV's own trackers, which follows a box."""
    tracker: Literal["mil", "csrt", "kcf", "mosse"]
    """Which one; all but `mil` need opencv-contrib-python-headless in place of opencv-python-headless."""

    @property
    def random(self) -> bool:
        return self.tracker == "mil"  # its features are drawn


class ParticleRecipe(ParticleFilter, Recipe):
    """A particle filter: what is tracked, how it moves, how it looks, and which filter."""

    type: Literal["particle_filter"] = "particle_filter"
    """A particle filter; may be left out."""


class ParticlesRecipe(Recipe):
    """Several targets, each followed by a particle filter of its own; they may keep off each other."""

    type: Literal["particle_filters"]
    """Several particle filters, one for each target."""
    targets: Annotated[
        dict[TargetName, ParticleFilter | None],
        Field(min_length=1, max_length=20, json_schema_extra={"additionalProperties": False}),
    ]
    """A particle filter for each target, by its name in the init file; null for none."""
    exclusion: Exclusion | None = None
    """How targets keep off each other; null: each is followed for itself."""

    @property
    def followed(self) -> tuple[str, ...]:
        return tuple(self.filters)

    @property
    def left_out(self) -> tuple[str, ...]:
        return tuple(name for name, one in self.targets.items() if one is None)

    @property
    def filters(self) -> Mapping[str, ParticleFilter]:
        """Those that are there, in their order; the first is the one whose face is looked for."""
        return {name: one for name, one in self.targets.items() if one is not None}

    @property
    def particles(self) -> int:
        return sum(one.particles for one in self.filters.values())

    @property
    def judges(self) -> bool:
        return any(one.judges for one in self.filters.values())

    @model_validator(mode="after")
    def _check(self) -> ParticlesRecipe:
        names = list(self.filters)
        if not names:
            refuse([Refusal(("targets",), "targets has none left; give one of them a particle filter")])
        known = f"there are {', '.join(names)}"
        found = []
        for name, one in self.filters.items():
            if isinstance(one.target, Points):
                message = "several targets are regions, clouds or affine; follow points by a recipe of their own"
                found.append(Refusal(("targets", name, "target", "type"), message))
            if isinstance(one.likelihood, SkinCloud) and one.likelihood.learn_from not in (None, *names):
                message = f'there is no target "{one.likelihood.learn_from}" to learn from; {known}'
                found.append(Refusal(("targets", name, "likelihood", "learn_from"), message))
        for i, name in enumerate(self.exclusion.first if self.exclusion is not None else ()):
            if name not in names:
                found.append(Refusal(("exclusion", "first", i), f'there is no target "{name}"; {known}'))
        hypotheses = sum(one.hypotheses for one in self.filters.values())
        if hypotheses > MOST_HYPOTHESES:
            message = f"the targets have {hypotheses:,} particles; no more than {MOST_HYPOTHESES:,} fit into memory"
            found.append(Refusal(("targets",), message))
        refuse(found)
        return self


KINDS: Mapping[str, type[Recipe]] = {
    "particle_filter": ParticleRecipe,
    "particle_filters": ParticlesRecipe,
    "opencv": OpenCvRecipe,
}


def load_recipe(name_or_path: str, overrides: Sequence[str] = ()) -> Recipe:
    """Read a recipe from a path, or by the name of a shipped one; `overrides` are `a.b=VALUE` of the command line.

    Raises RecipeError for the first thing that is wrong, and says how many more there are.
    """
    try:
        return _load(find_recipe(name_or_path), overrides)
    except YamlProblems as refused:
        raise _error(refused.problems) from None


def check_recipe(name_or_path: str, overrides: Sequence[str] = ()) -> list[Problem]:
    """Everything that is wrong with a recipe; also that the files it names are there."""
    try:
        recipe = _load(find_recipe(name_or_path), overrides)
        for above, one in filters(recipe):
            if one.prior is not None:
                _find_file(recipe, one.prior.file, f"{above}prior.file")
            if one.recognition is not None and one.recognition.gallery is not None:
                _find_file(recipe, one.recognition.gallery, f"{above}recognition.gallery")
    except YamlProblems as refused:
        return list(refused.problems)
    return []


def filters(recipe: Recipe) -> Sequence[tuple[str, ParticleFilter]]:
    """The particle filters of a recipe, each with what stands before its keys: nothing, or as in `targets.face.`."""
    if isinstance(recipe, ParticlesRecipe):
        return [(f"targets.{name}.", one) for name, one in recipe.filters.items()]
    return [("", recipe)] if isinstance(recipe, ParticleRecipe) else []


def shipped_folder() -> Path:
    """Where the shipped recipes are: in the installed package, or beside it in a working copy."""
    package = Path(__file__).resolve().parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def shipped_recipes() -> list[Path]:
    """The files of the shipped recipes, by name."""
    return sorted(shipped_folder().glob("*.yaml"))


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
    hint = f"{near} " if near.startswith("did") else ""
    what = "a folder, not a recipe" if folder else "neither a file nor a shipped recipe"
    names = ", ".join(shipped)
    raise RecipeError(f'"{name_or_path}" is {what}; {hint or "give a file or a name; "}shipped are {names}')


def read_recipe(path: Path) -> str:
    """The text of a recipe's file, right or wrong; RecipeError if it is none."""
    try:
        return _read(path).text
    except YamlProblems as refused:
        raise _error(refused.problems) from None


def resolve_file(recipe: Recipe, name: str, key: str = "") -> Path:
    """A file that the recipe names: beside the recipe, then among the shipped ones. RecipeError if it is nowhere.

    `key` is where the recipe names it, as in `prior.file`; without it the first key of that value is taken.
    """
    try:
        return _find_file(recipe, name, key)
    except YamlProblems as refused:
        raise _error(refused.problems) from None


def to_dict(recipe: Recipe) -> dict[str, Any]:
    """All settings, ready for JSON; written as a file it is the same recipe again."""
    return recipe.model_dump(mode="json")


def completed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that an earlier version wrote by `to_dict`, with the default of every key that has come since.

    What is no recipe any more is returned as it is.
    """
    kind = KINDS.get(settings.get("type", "particle_filter"), ParticleRecipe)
    try:
        return to_dict(kind.model_validate(dict(settings)))
    except ValidationError:
        return dict(settings)


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a recipe."""
    schema = TypeAdapter(ParticleRecipe | ParticlesRecipe | OpenCvRecipe).json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Recipe", **schema}


def _read(path: Path) -> Source:
    try:
        return read_source(path, str(path))
    except OSError as error:
        raise RecipeError(f"{path}: cannot be read: {error.strerror}; check the file's permissions") from None


def _load(path: Path, overrides: Sequence[str]) -> Recipe:
    source = _read(path)
    root = parse(source)
    start = Span(source, 0, 0, 1)
    if root is None or root.value is None:
        shipped = "start from a shipped recipe: facetrack recipes show factorized"
        raise YamlProblems([Problem(start, f"the recipe is empty; {shipped}")])
    if not isinstance(root.value, dict):
        raise YamlProblems([Problem(root.span, "a recipe is a mapping of keys such as target: and filter:, not this")])
    for override in overrides:
        assign(root, "--set", override)
    kind = _kind(root)
    try:
        return kind.model_validate(root.plain(), context={"path": path, "root": root})
    except ValidationError as error:
        raise YamlProblems(problems(error, kind, root)) from None


def _kind(root: Node) -> type[Recipe]:
    """The model of a recipe by its `type`: a particle filter where none is given."""
    keys = root.value if isinstance(root.value, dict) else {}
    given = keys.get("type")
    if "targets" in keys and "target" not in keys and (given is None or given.value == "particle_filter"):
        node = keys["targets"] if given is None else given
        message = '"targets" is a key of several particle filters; write type: particle_filters'
        raise YamlProblems([Problem((node.key or node.span) if given is None else node.span, message)])
    if given is None:
        return ParticleRecipe
    name = given.value if isinstance(given.value, str) else ""
    if name not in KINDS:
        hint = suggest(name, list(KINDS), "it is one of")
        raise YamlProblems([Problem(given.span, f'unknown type of recipe "{name}"; {hint}')])
    return KINDS[name]


def _find_file(recipe: Recipe, name: str, key: str = "") -> Path:
    node = None
    if recipe._root is not None and key:
        node, _, exact = locate(recipe._root, tuple(key.split(".")))
        node = node if exact else None
    elif recipe._root is not None:
        node = next((n for _, n in recipe._root.walk() if n.value == name), None)
    said_in = [] if node is None else [node.span.source.folder]  # of --set: the working directory
    folders = [*said_in, recipe.path.parent, shipped_folder()]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    sought = " and ".join(str(folder) for folder in dict.fromkeys(folders))
    span = node.span if node is not None else Span(Source(str(recipe.path), "", recipe.path.parent), 0, 0, 1)
    raise YamlProblems([Problem(span, f'there is no file "{name}" in {sought}; correct the name, or put it there')])


def _error(found: Sequence[Problem]) -> RecipeError:
    first, others = found[0], len(found) - 1
    more = f" (and {others} more: facetrack recipes check lists all)" if others else ""
    return RecipeError(f"{first}{more}", first.span.excerpt())
