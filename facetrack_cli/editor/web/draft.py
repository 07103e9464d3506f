"""The draft: what is being chosen in one frame on the page. It is well formed; it need not be complete."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import ConfigDict, Field
from pydantic_core import to_jsonable_python

from facetrack_cli.core.types import Box, TargetStart
from facetrack_cli.tracking.start.init_file import NAME
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS

MOST_TARGETS: Final = 20
MOST_POINTS: Final = 500
Json: TypeAlias = "dict[str, Any]"
Pixels: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_PIXELS, le=MAX_PIXELS, allow_inf_nan=False)]
Side: TypeAlias = Annotated[float, Field(strict=True, gt=0, le=MAX_PIXELS, allow_inf_nan=False)]
FrameNumber: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=MAX_FRAME)]
Name: TypeAlias = Annotated[str, Field(pattern=f"^(?:{NAME.pattern})$")]


@dataclass(frozen=True, slots=True)
class DraftTarget:
    """One target of a draft: box (left, top, width, height), points (x, y), and absent parts, True for all of them."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    box: tuple[Pixels, Pixels, Side, Side] | None = None
    points: Annotated[Mapping[Name, tuple[Pixels, Pixels]], Field(max_length=MOST_POINTS)] = field(default_factory=dict)
    absent: Annotated[tuple[Name, ...], Field(max_length=MOST_POINTS)] | Literal[True] = ()

    @property
    def empty(self) -> bool:
        return self.box is None and not self.points and not self.absent

    def rounded(self) -> TargetStart:
        """Its box and points to 0.01 px, as init files have them."""
        box: Box | None = None
        if self.box is not None:
            left, top, width, height = self.box
            box = round(left, 2), round(top, 2), round(width, 2), round(height, 2)
        return TargetStart(box, {part: (round(x, 2), round(y, 2)) for part, (x, y) in self.points.items()})


@dataclass(frozen=True, slots=True)
class Draft:
    """What is chosen in one frame, by target."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    frame: FrameNumber
    targets: Annotated[Mapping[Name, DraftTarget], Field(max_length=MOST_TARGETS)]

    @property
    def empty(self) -> bool:
        return all(target.empty for target in self.targets.values())

    def placed(self) -> dict[str, TargetStart]:
        """The targets that have a box or points, to 0.01 px."""
        return {name: one.rounded() for name, one in self.targets.items() if one.box is not None or one.points}

    def to_json(self) -> Json:
        found: Json = to_jsonable_python(self)
        return found


def draft_of(frame: int, targets: Mapping[str, TargetStart]) -> Draft:
    """The draft that a start, or a proposal, amounts to."""
    return Draft(frame, {name: DraftTarget(one.box, dict(one.points)) for name, one in targets.items()})
