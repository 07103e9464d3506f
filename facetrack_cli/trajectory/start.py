"""A start and its corrections as files hold them: init files, the header of a trajectory, goldens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS

Pixels: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_PIXELS, le=MAX_PIXELS, allow_inf_nan=False)]
Side: TypeAlias = Annotated[float, Field(strict=True, gt=0, le=MAX_PIXELS, allow_inf_nan=False)]
FrameNumber: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=MAX_FRAME)]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    box: tuple[Pixels, Pixels, Side, Side] | None = None  # left, top, width, height
    points: dict[str, tuple[Pixels, Pixels]] = {}  # x, y


class TargetRecord(_Record):
    """Where one target is at the start."""

    windows: dict[str, tuple[Side, Side]] = {}  # width, height

    def target(self) -> TargetStart:
        return TargetStart(self.box, self.points, self.windows)


class CorrectedTarget(_Record):
    """What is corrected of one target in one frame; the members are those of `core.types.Correction`."""

    kept: dict[str, tuple[Pixels, Pixels]] = {}
    absent: Annotated[
        Annotated[Literal[True], Tag("all")] | Annotated[tuple[str, ...], Tag("parts")],
        Discriminator(lambda given: "all" if given is True else "parts"),
    ] = ()
    learn: Annotated[bool, Field(strict=True)] | None = None

    def correction(self, frame: int, target: str) -> Correction:
        return Correction(frame, target, TargetStart(self.box, self.points), self.kept, self.absent, self.learn)


class CorrectionRecord(CorrectedTarget):
    """The same with its frame and its target: a member of a list of corrections."""

    frame: FrameNumber
    target: str


class StartRecord(BaseModel):
    """A start: its frame, its targets by name, and the corrections after it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    frame: FrameNumber
    targets: dict[str, TargetRecord]
    corrections: tuple[CorrectionRecord, ...] = ()

    def start_from(self, origin: str) -> Start:
        """The start; `origin` is what said so."""
        corrections = tuple(one.correction(one.frame, one.target) for one in self.corrections)
        return Start(self.frame, {name: one.target() for name, one in self.targets.items()}, origin, corrections)


def to_record(start: Start) -> dict[str, Any]:
    """What `StartRecord` reads, for JSON; members without a value are left out."""
    targets = {
        name: _members(box=one.box, points=dict(one.points), windows=dict(one.windows))
        for name, one in start.targets.items()
    }
    return {"frame": start.frame, "targets": targets, **corrections_record(start.corrections)}


def corrections_record(corrections: Sequence[Correction]) -> dict[str, Any]:
    """The member `corrections` of a start's record; no member without any."""
    return _members(corrections=[{"frame": one.frame, "target": one.target, **corrected(one)} for one in corrections])


def corrected(correction: Correction) -> dict[str, Any]:
    """What `CorrectedTarget` reads, for JSON: whole numbers without a fraction, and only members with a value."""
    given, absent = correction.given, correction.absent
    return _members(
        box=given.box and [whole(value) for value in given.box],
        points=_whole_points(given.points),
        kept=_whole_points(correction.kept),
        absent=absent is True or list(absent),
    ) | ({} if correction.learn is None else {"learn": correction.learn})


def whole(value: float) -> float | int:
    """A number without a fraction as an integer."""
    return int(value) if value == int(value) else float(value)


def _whole_points(points: Mapping[str, tuple[float, float]]) -> dict[str, list[float]]:
    return {part: [whole(value) for value in point] for part, point in points.items()}


def _members(**members: Any) -> dict[str, Any]:
    return {key: value for key, value in members.items() if value}
