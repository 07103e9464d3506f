"""The kinds of recipe and their JSON Schema; sections are in the files beside this. No numerics are imported here."""

import ast
import inspect
import textwrap
from collections.abc import Iterable, Mapping
from functools import cache
from itertools import pairwise
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar

from pydantic import BaseModel, Field, PrivateAttr, TypeAdapter, ValidationError
from pydantic.json_schema import GenerateJsonSchema

from facetrack_cli.core.errors import RecipeError
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.yaml_tree import Node, Problem, Source, Span, YamlProblems
from facetrack_cli.recipe import sections
from facetrack_cli.recipe.sections import Refusal, Section, type_of
from facetrack_cli.trackers.face.settings import HeadSettings
from facetrack_cli.trackers.hands.settings import HandsSettings

MAX_SEED: Final = 2**63 - 1
S = TypeVar("S", bound=sections.Kind)
TargetName: TypeAlias = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=60)]


LIKELY: Final = 0.5
"""With a calibration a part is lost where the probability that its place is right is below this."""


class ConfidenceSettings(Section):
    """When a part counts as lost."""

    lost_below: Annotated[float, Field(ge=0, le=1)] = 0.3
    """A part is lost while its confidence stays below this, 0..1."""
    patience: Annotated[int, Field(ge=1)] = 3
    """For so many frames in a row it must be below, for the part to be lost."""
    memory: Annotated[int, Field(ge=1)] | None = 50
    """Frames over which it is learned how well a part matches when it is there; null: the first frame says so."""
    beside: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Quantile of the windows beside the part in the first frame that counts as no match; the lower, the stricter."""
    calibration: Annotated[str, Field(min_length=1)] | None = None
    """File of a calibration: `confidence` is a probability, lost below 1/2, and the spread covers."""


# these two stand here, and not beside their trackers, whose settings would be imported with every recipe
class RecognitionSettings(sections.Component):
    """Who it is: the joint posterior of motion and identity (Zhou et al., ICME 2003, eq. 5, 14 to 16)."""

    engine = "facetrack_cli.trackers.appearance.appearance:Recognition.of"
    goes_with = ("affine",)
    gallery: str | None = None
    """The people, as `facetrack gallery fit` writes them; `--gallery FILE`. Sought beside the recipe."""
    none: bool = False
    """Beyond the paper: whether it may also be none of them."""
    switch: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Probability that the identity changes from frame to frame (section 2.2)."""
    sharpness: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Beyond the paper: below 1 a patch says less of who it is: the log of eq. 16 times this."""

    @property
    def files(self) -> Mapping[str, str]:
        return {} if self.gallery is None else {"gallery": self.gallery}


class ExclusionSettings(Section):
    """Mutual exclusion of targets: a likelihood counts for less where another target is (Gonzalez & Collet)."""

    strength: Annotated[float, Field(ge=0, le=1)]
    """What is lost of a particle's likelihood in the middle of another target; 0: nothing."""
    reach: Annotated[float, Field(gt=0, le=10)] = 1.0
    """How far another target goes, in halves of its box."""
    first: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Targets that no other one excludes; the others are excluded where these are."""


class ParticleFilterSettings(Section):
    """A particle filter for one target."""

    target: sections.TargetSettings
    """What is tracked: the state alpha."""
    motion: sections.MotionSettings
    """How it moves from frame to frame: the transition density p(alpha_i | alpha^-)."""
    likelihood: sections.LikelihoodSettings
    """How a part looks: the observation model p(y | alpha_i)."""
    filter: sections.FilterSettings
    """How the particles are proposed, weighted and resampled."""
    prior: sections.PriorSettings | None = None
    """Which shapes are likely: p(alpha); null for none."""
    head: HeadSettings | None = None
    """The head that carries the points of a face; null, as published: a head at rest."""
    recognition: RecognitionSettings | None = None
    """Who it is, of an affine target; null: there is no recognition."""
    confidence: ConfidenceSettings = ConfidenceSettings()
    """When a part counts as lost, and when as found again."""

    @property
    def points(self) -> tuple[str, ...]:
        return self.target.points

    @property
    def components(self) -> dict[str, sections.Component]:
        """What the tracker is built from, by key, but for what is not given."""
        return {key: section for key in ("target", *_KINDS) if (section := getattr(self, key)) is not None}

    def mistakes(self) -> Iterable[Refusal]:
        parts = self.components
        strangers = [key for key in _KINDS if key in parts and self.target.type not in parts[key].goes_with]
        why = f'does not go with target type "{self.target.type}"'
        for key in strangers:
            section = parts[key]
            if isinstance(section, sections.Kind):
                known = sections.registered(_KINDS[key]).items()
                fits = " or ".join(name for name, kind in known if self.target.type in kind.goes_with)
                yield Refusal((key, "type"), f'{key} type "{section.type}" {why}; write {fits or "null"}')
            else:
                yield Refusal((key,), f"{key} {why}; remove it, or follow an affine target")
        if strangers:
            return
        for part in parts.values():
            yield from part.mismatches(self)
        if self.confidence.calibration is not None and not self.likelihood.judges:
            message = f'likelihood type "{self.likelihood.type}" gives no confidence; remove the calibration'
            yield Refusal(("confidence", "calibration"), message)
        if self.head is not None and (self.motion.type, self.likelihood.type) != ("jumping_walk", "window_ncc"):
            yield Refusal(("head",), "head carries points that move by jumping_walk and look by window_ncc; remove it")


_KINDS: Mapping[str, type[Any]] = {
    "likelihood": sections.LikelihoodSettings,
    "motion": sections.MotionSettings,
    "filter": sections.FilterSettings,
    "prior": sections.PriorSettings,
    "recognition": RecognitionSettings,
}


class Recipe(Section):
    """What every recipe has; `type` says which kind of tracker it is."""

    type: str
    description: Annotated[str, Field(min_length=1, max_length=300)]
    """One line for `facetrack recipes`."""
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] = 0
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
    def filters(self) -> Mapping[str, ParticleFilterSettings]:
        """The particle filters by target, in order; a filter for any target has an empty name."""
        return {}

    @property
    def heads(self) -> Mapping[str, HeadSettings]:
        """The heads inside of which points are tracked, by target."""
        return {name: settings.head for name, settings in self.filters.items() if settings.head is not None}

    @property
    def points(self) -> tuple[str, ...]:
        """The points that a start must place in every target; none for a tracker that begins with a box."""
        return ()

    @property
    def followed(self) -> tuple[str, ...]:
        """The names of the targets, first the target whose face is searched for; none for a tracker of any target."""
        return tuple(filter(None, self.filters))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of targets that the recipe sets to null: a start may have them, and no tracker follows them."""
        return ()

    @property
    def later(self) -> tuple[str, ...]:
        """Those of `followed` that a start need not have: they are absent until they appear."""
        return ()

    @property
    def particles(self) -> int | None:
        """Number of particles, None for a tracker without."""
        own = sum(settings.filter.particles for settings in self.filters.values())
        return own + sum(head.filter.particles for head in self.heads.values()) or None

    @property
    def networks(self) -> tuple[str, ...]:
        """The networks that place points: `mesh` and `iris`."""
        landmarks = [head.landmarks for head in self.heads.values() if head.landmarks.network]
        return tuple(name for marks in landmarks for name in (marks.network, marks.iris) if name is not None)

    @property
    def random(self) -> bool:
        """Whether another seed may give another track."""
        return True

    @property
    def judges(self) -> bool:
        """Whether it may call a part lost."""
        return not self.filters or any(settings.likelihood.judges for settings in self.filters.values())

    def lost_below(self, target: str) -> float:
        """A part of this target is lost while its confidence stays below this."""
        settings = self.filters.get(target) or next(iter(self.filters.values()), None)
        confidence = ConfidenceSettings() if settings is None else settings.confidence
        return confidence.lost_below if confidence.calibration is None else LIKELY

    def span(self, key: str) -> Span:
        """The place of a key of this recipe, as of `prior.file`, or of the nearest above it."""
        nowhere = Span(Source(str(self._path), "", self._path.parent), 0, 0)
        return nowhere if self._root is None else self._root.at(key.split("."))[0].span

    def error(self, key: str, message: str) -> RecipeError:
        """An error that points at a key of this recipe; for rules that only building can check."""
        return YamlProblems(Problem(self.span(key), message))


class OpenCvRecipe(Recipe):
    """One of OpenCV's own trackers of a box, to compare with."""

    type: Literal["opencv"]
    tracker: Literal["mil", "csrt", "kcf", "mosse"]
    """Which one; all but `mil` need opencv-contrib-python-headless in place of opencv-python-headless."""

    @property
    def random(self) -> bool:
        return self.tracker == "mil"  # its features are drawn


class ParticleRecipe(ParticleFilterSettings, Recipe):
    """A particle filter: what is tracked, how it moves, how it looks, and which filter."""

    type: Literal["particle_filter"] = "particle_filter"
    exclusion: ExclusionSettings | None = None
    """How targets exclude each other where there are several; null: each is followed independently."""

    @property
    def filters(self) -> Mapping[str, ParticleFilterSettings]:
        return {"": self}


class ParticlesRecipe(Recipe):
    """Several targets, each followed by a particle filter of its own, with or without mutual exclusion."""

    type: Literal["particle_filters"]
    targets: Annotated[
        dict[TargetName, ParticleFilterSettings | None],
        Field(min_length=1, max_length=20, json_schema_extra={"additionalProperties": False}),
    ]
    """A particle filter for each target, by its name in the init file; null for none."""
    exclusion: ExclusionSettings | None = None
    """How targets exclude each other; null: each is followed independently."""
    hands: HandsSettings | None = None
    """Two hands of the first target, which is a head: `left_hand` and `right_hand`, absent until they appear."""

    @property
    def left_out(self) -> tuple[str, ...]:
        return tuple(name for name, settings in self.targets.items() if settings is None)

    @property
    def followed(self) -> tuple[str, ...]:
        return (*super().followed, *self.later)

    @property
    def later(self) -> tuple[str, ...]:
        return () if self.hands is None else HANDS

    def lost_below(self, target: str) -> float:
        return self.hands.lost_below if self.hands is not None and target in HANDS else super().lost_below(target)

    @property
    def particles(self) -> int | None:
        return (super().particles or 0) + (0 if self.hands is None else self.hands.particles)

    @property
    def filters(self) -> Mapping[str, ParticleFilterSettings]:
        return {name: settings for name, settings in self.targets.items() if settings is not None}

    def mistakes(self) -> Iterable[Refusal]:
        names = list(self.filters)
        if not names:
            yield Refusal(("targets",), "targets has none left; give one of them a particle filter")
            return
        choice = f"there are {', '.join(names)}"
        for name, settings in self.filters.items():
            if settings.points:
                message = "several targets are regions, clouds or affine; follow points by a recipe of their own"
                yield Refusal(("targets", name, "target", "type"), message)
            learn_from = getattr(settings.likelihood, "learn_from", None)
            if learn_from is not None and learn_from not in names:
                message = f'there is no target "{learn_from}" to learn from; {choice}'
                yield Refusal(("targets", name, "likelihood", "learn_from"), message)
        for i, name in enumerate(self.exclusion.first if self.exclusion is not None else ()):
            if name not in names:
                yield Refusal(("exclusion", "first", i), f'there is no target "{name}"; {choice}')
        if self.hands is not None and (taken := [name for name in HANDS if name in self.targets]):
            yield Refusal(("targets", taken[0]), f"{taken[0]} is one of hands; remove it, or hands")


KINDS: Mapping[str, type[Recipe]] = {type_of(kind): kind for kind in (ParticleRecipe, ParticlesRecipe, OpenCvRecipe)}


def seeded(recipe: Recipe, seed: Any) -> Recipe:
    """The recipe with another seed, None for its own. RecipeError for what is no seed."""
    if seed is None:
        return recipe
    whole = isinstance(seed, Integral) and not isinstance(seed, bool)
    if not whole or not 0 <= int(seed) <= MAX_SEED:
        raise RecipeError(f"seed {seed!r} is no whole number from 0 to {MAX_SEED}")
    return recipe.model_copy(update={"seed": int(seed)})


def register(section: type[S]) -> type[S]:
    """Make a section from outside of this package known, so that recipes can name it by its `type`.

    A package names its sections as entry points of the group `facetrack.sections` in place of this.

    Parameters
    ----------
    section
        A class derived from `LikelihoodSettings`, `MotionSettings`, `FilterSettings`, `PriorSettings` or
        `TargetSettings`, whose field `type` has a Literal of its name.

    Returns
    -------
    type
        The section, so that this is a decorator as well.

    Raises
    ------
    TypeError
        For what is no such class.
    ValueError
        For a `type` that is taken.
    """
    sections.add(section)
    return section


def above(name: str) -> str:
    """What stands before the keys of the particle filter of this name: nothing, or as in `targets.face.`."""
    return f"targets.{name}." if name else ""


def to_dict(recipe: Recipe) -> dict[str, Any]:
    """All settings, ready for JSON; written as a file it is the same recipe again."""
    return recipe.model_dump(mode="json")


def completed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that an earlier version wrote by `to_dict`, with later defaults; as they are if no recipe any more."""
    kind = KINDS.get(settings.get("type", "particle_filter"), ParticleRecipe)
    try:
        return to_dict(kind.model_validate(dict(settings)))
    except ValidationError:
        return dict(settings)


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a recipe, whose fields are described by the docstrings below them.

    They are read from the source when a command asks for the schema: pydantic's `use_attribute_docstrings` reads them
    whenever the models are imported, at the start of every command.
    """
    schema = TypeAdapter(ParticleRecipe | ParticlesRecipe | OpenCvRecipe).json_schema(schema_generator=_Described)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Recipe", **schema}


class _Described(GenerateJsonSchema):
    """Fields get the docstrings below them, `type` by default that of its class; lengths are written as in recipes."""

    def encode_default(self, dft: Any) -> Any:
        return super().encode_default(dft.written() if isinstance(dft, sections.Length) else dft)

    def model_schema(self, schema: Any) -> dict[str, Any]:
        described = super().model_schema(schema)
        cls = schema["cls"]
        texts = {name: text for base in reversed(cls.__mro__) for name, text in _docstrings(base).items()}
        if type_of(cls):
            texts.setdefault("type", (inspect.getdoc(cls) or "").partition("\n\n")[0])
        for name, field in described.get("properties", {}).items():
            if name in texts:
                field.setdefault("description", texts[name])
        return described


@cache
def _docstrings(model: type) -> dict[str, str]:
    """The attributes of a model's own body and the docstrings below them; none without its source."""
    if not issubclass(model, BaseModel) or model is BaseModel:
        return {}
    try:
        source = inspect.getsource(model)
    except (OSError, TypeError):
        return {}
    body = ast.parse(textwrap.dedent(source)).body[0]
    assert isinstance(body, ast.ClassDef)
    texts = {}
    for field, below in pairwise(body.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                texts[name] = inspect.cleandoc(text)
    return texts
