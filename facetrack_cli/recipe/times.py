"""Times in recipes: a setting that counts frames, or is a share a frame, may also be a time, as in `1 s` or `40 ms`.

What is declared as a number with FRAMES or SHARE holds a `Time` where a recipe says so. Only a recipe from
`load.in_frames`, in which all are numbers of frames at the clip's rate, is built.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel
from pydantic_core import PydanticCustomError, core_schema

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler

MIN_S, MAX_S = 1e-6, 1e6
UNITS = {"s": 1.0, "ms": 1e-3}
NUMBER = r"([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?"  # without a sign
FPS = "fps"  # of a validation's context: frames per second by which times become numbers


@dataclass(frozen=True, slots=True)
class Time:
    """A time > 0, as a recipe gives it."""

    value: float
    unit: str

    @property
    def seconds(self) -> float:
        return self.value * UNITS[self.unit]

    def written(self) -> str:
        """As in a recipe."""
        return f"{self.value!r}".removesuffix(".0") + self.unit

    @classmethod
    def read(cls, given: str) -> Time | None:
        """From what stands in a recipe; None for what is no time."""
        found = re.fullmatch(f"({NUMBER}) ?(s|ms)", given)
        time = cls(float(found[1]), found[5]) if found else None
        return time if time is not None and MIN_S <= time.seconds <= MAX_S else None


@dataclass(frozen=True, slots=True)
class OrTime:
    """Beside a number's type: a `Time` may stand there."""

    share: bool = False
    """Whether the number is a share of each frame, and not a count of frames."""

    def at(self, time: Time, fps: float) -> float:
        """What a time is at `fps` frames per second: frames, at least one, or the share with that time constant."""
        frames = time.seconds * fps
        return -math.expm1(-1 / frames) if self.share else max(round(frames), 1)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        def read(
            given: object, number: core_schema.ValidatorFunctionWrapHandler, info: core_schema.ValidationInfo
        ) -> Any:
            fps = (info.context or {}).get(FPS)
            time = Time.read(given) if isinstance(given, str) else given
            if isinstance(time, Time):
                return time if fps is None else number(self.at(time, fps))
            if isinstance(given, str):
                wanted = "a share from 0 to 1" if self.share else "a whole number of frames"
                hint = f"must be {wanted}, or a time (to a million seconds) as in 1s or 40ms"
                raise PydanticCustomError("time", hint)  # type: ignore[arg-type, unused-ignore]
            return number(given)

        return core_schema.with_info_wrap_validator_function(
            read,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda given: given.written() if isinstance(given, Time) else given
            ),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        said = "Time constant" if self.share else "Time"
        time = {
            "title": "Time",
            "type": "string",
            "pattern": f"^{NUMBER} ?(s|ms)$",
            "description": f"{said}, as in 1s.",
        }
        return {"anyOf": [handler(schema), time]}


FRAMES = OrTime()  # as in Annotated[int, Field(ge=1), FRAMES]: bounds come first
SHARE = OrTime(share=True)  # of a new frame in what is known; as a time, after which 1/e is left of what was known


def times(value: object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Time]]:
    """The times that a recipe or a section holds, with the keys that lead to each."""
    if isinstance(value, Time):
        yield path, value
    elif isinstance(value, BaseModel):
        yield from times(dict(value), path)
    elif isinstance(value, dict):
        for key, below in value.items():
            yield from times(below, (*path, str(key)))
