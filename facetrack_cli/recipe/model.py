"""The kinds of recipe; their sections are in the files beside this one. No numerics are imported here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import Field, PrivateAttr, TypeAdapter, ValidationError

from facetrack_cli.core.errors import RecipeError
from facetrack_cli.core.yaml_tree import Node, Problem
from facetrack_cli.recipe.messages import locate
from facetrack_cli.recipe.particle_filter import MOST_HYPOTHESES, ParticleFilter
from facetrack_cli.recipe.sections import Kind, Refusal, Section, add
from facetrack_cli.recipe.skin import Exclusion, SkinCloud

S = TypeVar("S", bound=Kind)
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
        return error_of([Problem(node.span, message)])


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
    """Several targets, each followed by a particle filter of its own, with or without mutual exclusion."""

    type: Literal["particle_filters"]
    """Several particle filters, one for each target."""
    targets: Annotated[
        dict[TargetName, ParticleFilter | None],
        Field(min_length=1, max_length=20, json_schema_extra={"additionalProperties": False}),
    ]
    """A particle filter for each target, by its name in the init file; null for none."""
    exclusion: Exclusion | None = None
    """How targets exclude each other; null: each is followed independently."""

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

    def mistakes(self) -> Iterable[Refusal]:
        names = list(self.filters)
        if not names:
            yield Refusal(("targets",), "targets has none left; give one of them a particle filter")
            return
        known = f"there are {', '.join(names)}"
        for name, one in self.filters.items():
            if one.points:
                message = "several targets are regions, clouds or affine; follow points by a recipe of their own"
                yield Refusal(("targets", name, "target", "type"), message)
            if isinstance(one.likelihood, SkinCloud) and one.likelihood.learn_from not in (None, *names):
                message = f'there is no target "{one.likelihood.learn_from}" to learn from; {known}'
                yield Refusal(("targets", name, "likelihood", "learn_from"), message)
        for i, name in enumerate(self.exclusion.first if self.exclusion is not None else ()):
            if name not in names:
                yield Refusal(("exclusion", "first", i), f'there is no target "{name}"; {known}')
        hypotheses = sum(one.hypotheses for one in self.filters.values())
        if hypotheses > MOST_HYPOTHESES:
            message = f"the targets have {hypotheses:,} particles; no more than {MOST_HYPOTHESES:,} fit into memory"
            yield Refusal(("targets",), message)


KINDS: Mapping[str, type[Recipe]] = {
    "particle_filter": ParticleRecipe,
    "particle_filters": ParticlesRecipe,
    "opencv": OpenCvRecipe,
}


def register(section: type[S]) -> type[S]:
    """Make a section from outside of this package known, so that recipes can name it by its `type`; a decorator too.

    It is derived from `Likelihood`, `Motion`, `Filter`, `Prior` or `Target`. A package names its sections as entry
    points of the group `facetrack.sections` in place of this. Raises TypeError for what is no section, ValueError for a
    `type` that is taken.
    """
    add(section)
    rebuild()
    return section


def rebuild() -> None:
    """Let recipes take up what was put into the registry."""
    for model in (ParticleFilter, ParticleRecipe, ParticlesRecipe):
        model.model_rebuild(force=True)


def filters(recipe: Recipe) -> Sequence[tuple[str, ParticleFilter]]:
    """The particle filters of a recipe, each with what stands before its keys: nothing, or as in `targets.face.`."""
    if isinstance(recipe, ParticlesRecipe):
        return [(f"targets.{name}.", one) for name, one in recipe.filters.items()]
    return [("", recipe)] if isinstance(recipe, ParticleRecipe) else []


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


def error_of(found: Sequence[Problem]) -> RecipeError:
    first, others = found[0], len(found) - 1
    more = f" (and {others} more: facetrack recipes check lists all)" if others else ""
    return RecipeError(f"{first}{more}", first.span.excerpt())
