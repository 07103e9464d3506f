"""Lengths in a recipe, and values that may differ from part to part."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Generic, TypeAlias, TypeVar

from pydantic import ConfigDict, Discriminator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, RootModel, Tag
from pydantic_core import PydanticCustomError, core_schema

from facetrack_cli.recipe.sections import Refusal, Steps, suggest

T = TypeVar("T")
SHORTEST, LONGEST = 1e-6, 1e6  # no frame needs more, and squares would overflow
_NUMBER = r"([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?"


@dataclass(frozen=True, slots=True)
class Length:
    """A length > 0: in units of the initial target size (of points: the largest distance between two), or in pixels."""

    value: float
    px: bool = False
    least: ClassVar[float] = SHORTEST

    def pixels(self, size: float) -> float:
        """In pixels, for a target that was `size` pixels large at the start."""
        return self.value if self.px else self.value * size

    def written(self) -> float | str:
        """As in a recipe: the number, or `12px`."""
        return f"{self.value!r}px".replace(".0px", "px") if self.px else self.value

    @classmethod
    def read(cls, given: object) -> Length:
        """From what stands in a recipe; raises PydanticCustomError (a ValueError)."""
        if isinstance(given, Length):
            given = given.written()
        if cls.least == 0 and isinstance(given, int | float) and given == 0 and not isinstance(given, bool):
            return cls(0.0)
        length = cls(math.nan)
        if isinstance(given, str) and re.fullmatch(_NUMBER + " ?px", given):
            length = cls(float(given.removesuffix("px")), px=True)
        elif isinstance(given, int | float) and not isinstance(given, bool) and abs(given) < 1e300:
            length = cls(float(given))
        if not SHORTEST <= length.value <= LONGEST:  # also nan
            units = "a number in units of the target's size, or pixels as in 12px"
            bound = "a length above 0" if cls.least else "0 or a length"
            hint = f"must be {bound} (and no more than a million): {units}"
            raise PydanticCustomError("length", hint)  # type: ignore[arg-type, unused-ignore]
        return length

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(
            cls.read, serialization=core_schema.plain_serializer_function_ser_schema(cls.written)
        )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        said = "In units of the target's size at the start."
        units = {"type": "number", "minimum": cls.least, "maximum": LONGEST, "description": said}
        pixels = {"type": "string", "pattern": f"^{_NUMBER} ?px$", "description": "In pixels, as in 12px."}
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

    model_config = ConfigDict(frozen=True, strict=True)

    def of(self, part: str) -> T:
        """The value for a part; KeyError if it has none, which a recipe's own parts never lack."""
        if not isinstance(self.root, dict):
            return self.root
        return self.root[part] if part in self.root else self.root["default"]

    def refusals(self, path: Steps, parts: Sequence[str]) -> list[Refusal]:
        if not isinstance(self.root, dict):
            return []
        where, known, found = ".".join(map(str, path)), [*parts, "default"], []
        for name in self.root:
            if name not in known:
                message = f'"{name}" in {where} is no part of the target; {suggest(name, known, "there are")}'
                found.append(Refusal((*path, name), message, True))
        lacking = [] if "default" in self.root else [part for part in parts if part not in self.root]
        if lacking:
            found.append(Refusal(path, f'{where} has no value for {", ".join(lacking)}; add each, or a "default"'))
        return found


class LengthPerPart(PerPart[Length]):
    """One length for all parts, or `part: length` for each; `default` serves the parts not named."""


class WindowPerPart(PerPart[Window]):
    """One window for all parts, or `part: window` for each; `default` serves the parts not named."""
