"""What the sections of a recipe are made from, the registry of their types, and those that several trackers share.

A section declares each setting once: default, bounds, unit and, in the docstring below it, meaning and place in the
paper. Its engine computes with it. No numerics are imported here: an engine is imported when it is built.
"""

from __future__ import annotations

import pkgutil
import re
import sys
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache, partial
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Literal, NamedTuple, TypeAlias, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    ModelWrapValidatorHandler,
    RootModel,
    Tag,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError, core_schema

from facetrack_cli.core.errors import RecipeError

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from typing_extensions import Self

    from facetrack_cli.recipe.model import ParticleFilterSettings

Steps: TypeAlias = tuple[str | int, ...]
T = TypeVar("T")
NUMBER = r"([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?"  # without a sign
MIN_LENGTH, MAX_LENGTH = 1e-6, 1e6  # lengths; no frame needs more, and squares would overflow
# the modules that hold sections, in the order in which types are listed
TRACKERS = ("points", "regions", "skin", "appearance", "box", "face")
FAMILIES = ("recipe.sections", *(f"trackers.{name}.settings" for name in TRACKERS))
GROUP = "facetrack.sections"  # the entry points by which other packages bring sections of their own


class Refusal(NamedTuple):
    """An error that a rule between several fields finds: its path from the model on, and whether it is at the key."""

    path: Steps
    message: str
    at_key: bool = False


def suggest(wrong: str, names: Sequence[str], otherwise: str) -> str:
    """`did you mean "x"?` where something known is near, else `otherwise` and all that is known."""
    near = get_close_matches(wrong, names, n=1)
    return f'did you mean "{near[0]}"?' if near else f"{otherwise}: {', '.join(names)}"


class Section(BaseModel):
    """A part of a recipe: frozen, without unknown keys, its fields described by the docstrings below them."""

    # built when the first recipe is read
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    def mistakes(self) -> Iterable[Refusal]:
        """What is wrong between the fields of this section; paths begin at it."""
        return ()

    @model_validator(mode="wrap")
    @classmethod
    def _keys(cls, values: Any, check: ModelWrapValidatorHandler[Self]) -> Self:
        """What an unknown key may have meant is said beside all other errors of the section."""
        try:
            return check(values)
        except ValidationError as wrong:
            listed = [cls._told(error) for error in wrong.errors(include_url=False)]
            raise ValidationError.from_exception_data(wrong.title, listed) from None

    @classmethod
    def _told(cls, error: ErrorDetails) -> InitErrorDetails:
        kind, more, at = error["type"], {**error.get("ctx", {}), "said": error["msg"]}, error["loc"]
        if kind == "extra_forbidden" and len(at) == 1:
            hint = suggest(str(at[0]), list(cls.model_fields), "the keys there are")
            refusal = Refusal(at, f'unknown key "{at[0]}"; {hint}', at_key=True)
            kind, more, at = "refused", {"said": refusal.message, "refusals": [refusal]}, ()
        return {"type": PydanticCustomError(kind, "{said}", more), "loc": at, "input": error["input"]}  # type: ignore[arg-type, unused-ignore]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if refusals := list(self.mistakes()):
            raise PydanticCustomError("refused", "{summary}", {"summary": refusals[0].message, "refusals": refusals})
        return self


class Component(Section):
    """A section from which a part of the tracker is built."""

    engine: ClassVar[str]
    """What builds it, as `module:name`: a callable that takes the section and a `engine.spaces.Context`."""
    goes_with: ClassVar[tuple[str, ...]] = ()
    """The types of target that it goes with."""

    def build(self, context: Any) -> Any:
        """The part of the tracker. A section outside of this package may override this in place of `engine`.

        Parameters
        ----------
        context : an `engine.spaces.Context`: the recipe, the start, the target's name, and where it is placed.

        Returns
        -------
        What `engine/protocols.py` says of this kind: a likelihood, a motion or a prior.
        """
        return pkgutil.resolve_name(self.engine)(self, context)

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        """What does not fit the other sections of its particle filter; paths begin at the particle filter."""
        return ()

    @property
    def files(self) -> Mapping[str, str]:
        """The files that it names, by key."""
        return {}


class Kind(Component):
    """A section that has several types. A recipe names a type by the Literal of the field `type`."""

    type: str

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """A kind, as in the field `filter: Filter`, is read as the type that it names: a recipe has few of them."""
        return core_schema.with_info_plain_validator_function(cls._named) if cls in KINDS else handler(source)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """That of a kind is the union of all its types."""
        if cls not in KINDS:
            return handler(schema)
        types = tuple(registered(cls).values())
        tagged: Any = Annotated[typing.Union[types], Field(discriminator="type")] if len(types) > 1 else types[0]  # noqa: UP007
        return handler(TypeAdapter(tagged).core_schema)

    @classmethod
    def _named(cls, given: Any, info: ValidationInfo) -> Any:
        name = given.get("type") if isinstance(given, dict) else None
        section = _find(cls, name) if isinstance(name, str) else type(given)
        if section is not None and issubclass(section, cls):
            return section.model_validate(given, context=info.context)
        wrong = "model_type" if not isinstance(given, dict) else "wrong_type" if "type" in given else "no_type"
        raise PydanticCustomError(wrong, "type is none of {known}", {"known": ", ".join(map(repr, registered(cls)))})


class TargetSettings(Kind):
    """What is tracked. Its engine takes the section, the start and the target's name, and says where it begins."""

    relearns: ClassVar[bool] = True
    """Whether it is learned again, by default, where its box is corrected."""

    @property
    def points(self) -> tuple[str, ...]:
        """The points that a start must place; none where it begins with a box."""
        return ()

    @property
    def best(self) -> bool:
        """Whether the estimate is the particle of the greatest weight, which is that of the greatest likelihood."""
        return False

    def place(self, start: Any, name: str) -> Any:
        """Where the target begins.

        Parameters
        ----------
        start : a `core.types.Start`, in pixels of its frame.
        name : that of the target in the start.

        Returns
        -------
        engine.spaces.Placed : the state space, the first state, windows and the unit of length.

        Raises
        ------
        InputError : for a start that lacks what the target needs.
        """
        return pkgutil.resolve_name(self.engine)(self, start, name)


class MotionSettings(Kind):
    """How a target moves from frame to frame: the transition density p(alpha_i | alpha^-)."""


class LikelihoodSettings(Kind):
    """How a part looks: the observation model p(y | alpha_i)."""

    @property
    def judges(self) -> bool:
        """Whether it can tell by itself how well a place matches, so that a part may be `lost`."""
        return True


class FilterSettings(Kind):
    """How particles are proposed, weighted and resampled. Its engine is a function, as in `engine/filters.py`."""

    particles: int

    def build(self, context: Any) -> Any:
        return partial(pkgutil.resolve_name(self.engine), self)


class PriorSettings(Kind):
    """Which shapes are likely: p(alpha)."""


KINDS: tuple[type[Kind], ...] = (TargetSettings, MotionSettings, LikelihoodSettings, FilterSettings, PriorSettings)
_types: dict[type[Kind], dict[str, type[Kind]]] = {}


@cache
def _brought() -> tuple[metadata.EntryPoint, ...]:
    """What other packages bring."""
    return tuple(metadata.entry_points(group=GROUP))


def registered(kind: type[Kind]) -> Mapping[str, type[Kind]]:
    """The types of a kind, as `FilterSettings`, by name. Raises RecipeError for an entry point that fails."""
    if _types:
        return _types[kind]
    _types.update({base: {} for base in KINDS})
    for family in FAMILIES:
        for section in vars(import_module(f"facetrack_cli.{family}")).values():
            if isinstance(section, type) and issubclass(section, Kind) and type_of(section):
                add(section)
    for point in _brought():
        try:
            add(point.load())
        except Exception as e:
            _types.clear()
            where = f"the entry point {point.name} = {point.value} of {point.dist.name if point.dist else '?'}"
            why = " ".join(str(e).split()) or type(e).__name__
            raise RecipeError(f"{where} brings no section: {why}; correct or uninstall that package") from e
    return _types[kind]


def _find(kind: type[Kind], name: str) -> type[Kind] | None:
    """The type of a kind by its name, without the families that nothing has imported yet, if it is in another."""
    if not _types and not _brought():
        for family in sorted(FAMILIES, key=lambda family: f"facetrack_cli.{family}" not in sys.modules):
            for section in vars(import_module(f"facetrack_cli.{family}")).values():
                if isinstance(section, type) and issubclass(section, kind) and type_of(section) == name:
                    return section
    return registered(kind).get(name)


def add(section: type[Kind]) -> None:
    """Put a section into the registry. TypeError if it is none or builds nothing, ValueError if its name is taken."""
    kind = next((base for base in KINDS if isinstance(section, type) and issubclass(section, base)), None)
    name = type_of(section) if kind is not None else ""
    if kind is None or not name:
        bases = ", ".join(base.__name__ for base in KINDS)
        raise TypeError(f'{section!r} is no section: derive it from one of {bases}, with type: Literal["its_name"]')
    if kind is not TargetSettings and not section.goes_with:
        raise TypeError(f'{section.__name__} goes with no type of target: add goes_with = ("points",), as it may be')
    if kind is not TargetSettings and not hasattr(section, "engine") and section.build is kind.build:
        raise TypeError(f"{section.__name__} builds nothing: give it a method build(self, context)")
    taken = registered(kind).get(name, section)
    if (taken.__module__, taken.__qualname__) != (section.__module__, section.__qualname__):
        noun = kind.__name__.removesuffix("Settings").lower()
        raise ValueError(f'the {noun} type "{name}" is taken by {taken.__module__}; choose another')
    _types[kind][name] = section


def type_of(section: type[BaseModel]) -> str:
    """The name of a type in recipes; empty for a section that has no types."""
    field = section.model_fields.get("type")
    return str(get_args(field.annotation)[0]) if field and typing.get_origin(field.annotation) is Literal else ""


@dataclass(frozen=True, slots=True)
class Length:
    """A length > 0: in units of the initial target size (of points: the largest distance between two), or in pixels."""

    value: float
    px: bool = False
    least: ClassVar[float] = MIN_LENGTH

    def pixels(self, size: float) -> float:
        """In pixels, for a target that was `size` pixels large at the start."""
        return self.value if self.px else self.value * size

    def written(self) -> float | str:
        """As in a recipe: the number, or `12px`."""
        return f"{self.value!r}px".replace(".0px", "px") if self.px else self.value

    @classmethod
    def read(cls, value: Any) -> Length:
        """From what stands in a recipe; raises PydanticCustomError (a ValueError)."""
        value = value.written() if isinstance(value, Length) else value
        px = isinstance(value, str) and re.fullmatch(NUMBER + " ?px", value) is not None
        length = float(value.removesuffix("px")) if px else value
        number = isinstance(length, int | float) and not isinstance(length, bool)
        if not number or not (MIN_LENGTH <= length <= MAX_LENGTH or length == cls.least):
            units = "a number in units of the target's size, or pixels as in 12px"
            bound = "a length above 0" if cls.least else "0 or a length"
            hint = f"must be {bound} (and no more than a million): {units}"
            raise PydanticCustomError("length", hint)  # type: ignore[arg-type, unused-ignore]
        return cls(float(length), px)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(
            cls.read, serialization=core_schema.plain_serializer_function_ser_schema(cls.written)
        )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        meaning = "In units of the target's size at the start."
        units = {"type": "number", "minimum": cls.least, "maximum": MAX_LENGTH, "description": meaning}
        pixels = {"type": "string", "pattern": f"^{NUMBER} ?px$", "description": "In pixels, as in 12px."}
        return {"title": cls.__name__, "anyOf": [units, pixels]}


class LengthOrNone(Length):
    """A length that may be 0."""

    least: ClassVar[float] = 0.0


Window: TypeAlias = Annotated[
    Annotated[Length, Tag("side")]
    | Annotated[tuple[Length, Length], Field(strict=False, description="[width, height]"), Tag("[w, h]")],
    Discriminator(lambda given: "[w, h]" if isinstance(given, list | tuple) else "side"),
]
"""The side of a square window, or its [width, height]."""


class PerPart(
    RootModel[
        Annotated[
            Annotated[T, Tag("for all")] | Annotated[dict[str, T], Tag("for each")],
            Discriminator(lambda given: "for each" if isinstance(given, dict) else "for all"),
        ]
    ],
    Generic[T],
):
    """One value for all parts, or a mapping from each part to its own, where `default` serves the parts not named."""

    model_config = ConfigDict(frozen=True, strict=True, defer_build=True)

    def of(self, part: str) -> T:
        """The value for a part; KeyError if it has none, which a recipe's own parts never lack."""
        if not isinstance(self.root, dict):
            return self.root
        return self.root[part] if part in self.root else self.root["default"]

    def refusals(self, path: Steps, parts: Sequence[str]) -> list[Refusal]:
        if not isinstance(self.root, dict):
            return []
        where, names, refusals = ".".join(map(str, path)), [*parts, "default"], []
        for name in self.root:
            if name not in names:
                message = f'"{name}" in {where} is no part of the target; {suggest(name, names, "there are")}'
                refusals.append(Refusal((*path, name), message, True))
        lacking = [] if "default" in self.root else [part for part in parts if part not in self.root]
        if lacking:
            refusals.append(Refusal(path, f'{where} has no value for {", ".join(lacking)}; add each, or a "default"'))
        return refusals


class LengthPerPart(PerPart[Length]):
    """One length for all parts, or `part: length` for each; `default` serves the parts not named."""


class WindowPerPart(PerPart[Window]):
    """One window for all parts, or `part: window` for each; `default` serves the parts not named."""


# --- sections that several trackers share: filters, the random walk, targets whose scale is bounded ------------------

# `engine/filters.py` has the filters side by side, `engine/spaces.py` the walk. Sections and equations are those of
# Patras & Pantic, "Particle Filtering with Factorized Likelihoods for Tracking Facial Features", FG 2004.
BOX = "box"  # the one part of a target that is followed as a box
Factor: TypeAlias = Annotated[float, Field(gt=0, le=100)]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
MAX_COMPARED_PARTICLES = 2_000  # particles that are compared with each other: memory grows with their square


class ResampledSettings(FilterSettings):
    """A filter that picks particles by their weights."""

    particles: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of particles, K in the paper; of `independent`: for each part."""


class SirSettings(ResampledSettings):
    """Sampling/importance resampling over the joint state (section 2); weights are p(y|s), or p(y|s) p(s)."""

    engine = "facetrack_cli.engine.filters:sir"
    goes_with = ("points", "region", "cloud", "affine")
    type: Literal["sir"]


class AuxiliarySettings(ResampledSettings):
    """Auxiliary particle filter over the joint state (Pitt & Shephard 1999); observes p(y|s), or p(y|s) p(s)."""

    engine = "facetrack_cli.engine.filters:auxiliary"
    goes_with = ("points", "region", "cloud", "affine")
    type: Literal["auxiliary"]


class LooksAheadSettings(ResampledSettings):
    """A filter that steps each part on its own."""

    look_ahead: Literal["draw", "none"] = "draw"
    """What a part is picked by: the likelihood at a draw of its transition, as published, or none."""


class FactorizedSettings(LooksAheadSettings):
    """Proposes from g(alpha) = prod_i p(alpha_i|Y), the product of the parts' posteriors; reweights (section 2.1)."""

    engine = "facetrack_cli.engine.filters:factorized"
    goes_with = ("points",)  # it resamples parts apart, and the other targets are one part
    type: Literal["factorized"]
    reweight: Literal["prior", "transition"] = "prior"
    """By the shape prior (eq. 11), or by the particles of the last frame (eq. 7)."""
    from_prior: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of a part's sub-particles that is proposed from the prior given the other parts; as published 0."""

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        by_prior = self.reweight == "prior"
        if not by_prior and self.particles > MAX_COMPARED_PARTICLES:
            most = f"give {MAX_COMPARED_PARTICLES:,} at most, not {self.particles:,}"
            yield Refusal(("filter", "particles"), f"reweight: transition compares every two particles; {most}")
        elif by_prior and whole.prior is None:
            what = "needs a prior; add a prior section, or write reweight: transition"
            yield Refusal(("filter", "reweight"), f"filter.reweight: prior {what}")
        elif self.from_prior > 0 and not by_prior:
            goes = "goes with reweight: prior; eq. 7 knows the motion model alone"
            yield Refusal(("filter", "from_prior"), f"filter.from_prior above 0 {goes}")


class IndependentSettings(LooksAheadSettings):
    """An auxiliary particle filter for each part on its own (section 4, the paper's baseline)."""

    engine = "facetrack_cli.engine.filters:factorized"
    goes_with = ("points",)
    reweight: ClassVar[str] = "none"
    from_prior: ClassVar[float] = 0.0
    type: Literal["independent"]

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        if whole.prior is not None:
            message = 'filter type "independent" makes no use of a prior; remove it, or write prior: null'
            yield Refusal(("prior",), message)


class RandomWalkSettings(MotionSettings):
    """Zero-order motion with Gaussian noise: p(alpha_i | alpha_i^-) = alpha_i^- + N(0, sigma) (section 3.3)."""

    engine = "facetrack_cli.engine.spaces:random_walk"
    goes_with = ("points", "region", "cloud")
    type: Literal["random_walk"]
    sigma: LengthPerPart
    """Standard deviation of a part's step from frame to frame, along x and along y."""
    scale: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Of a region: standard deviation of its scale's step, 1 being its size at the start; 0: its size stays."""

    def mismatches(self, whole: ParticleFilterSettings) -> Iterable[Refusal]:
        yield from self.sigma.refusals(("motion", "sigma"), whole.points or (BOX,))
        if self.scale and whole.target.type != "region":
            message = f"motion.scale is that of a region; a target of type {whole.target.type} has none: remove it"
            yield Refusal(("motion", "scale"), message)


class ScaledSettings(TargetSettings):
    """A target whose scale is bounded, [least, largest], in terms of the size at the start."""

    if TYPE_CHECKING:
        scale: tuple[float, float]

    def mistakes(self) -> Iterable[Refusal]:
        if not self.scale[0] < 1 < self.scale[1]:
            yield Refusal(("scale",), "target.scale is [least, largest], with 1, the size at the start, between them")
