"""What is being chosen on the page: checked JSON in, plain JSON out.

A draft may be incomplete; that it is well formed is all that is asked of it here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

from facetrack_cli.core.types import Box, Point, TargetStart
from facetrack_cli.tracking.start.init_file import NAME
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS

MOST_TARGETS: Final = 20
MOST_POINTS: Final = 500
Json: TypeAlias = "dict[str, Any]"


class DraftError(ValueError):
    """JSON that is no draft, said in one line."""


@dataclass(frozen=True, slots=True)
class DraftTarget:
    """One target of a draft: box (left, top, width, height), points (x, y), and absent parts, True for all of them."""

    box: Box | None = None
    points: Mapping[str, Point] = field(default_factory=dict)
    absent: tuple[str, ...] | Literal[True] = ()

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

    frame: int
    targets: Mapping[str, DraftTarget] = field(default_factory=dict)

    @property
    def empty(self) -> bool:
        return all(target.empty for target in self.targets.values())

    def to_json(self) -> Json:
        return {
            "frame": self.frame,
            "targets": {
                name: {
                    "box": None if one.box is None else list(one.box),
                    "points": {part: list(at) for part, at in one.points.items()},
                    "absent": True if one.absent is True else list(one.absent),
                }
                for name, one in self.targets.items()
            },
        }


def draft_of(frame: int, targets: Mapping[str, TargetStart]) -> Draft:
    """The draft that a start, or a proposal, amounts to."""
    return Draft(frame, {name: DraftTarget(one.box, dict(one.points)) for name, one in targets.items()})


def read_draft(value: object) -> Draft:
    """The draft that JSON describes. Raises DraftError for anything else, numbers beyond any picture included."""
    given = _mapping(value, "the draft", ("frame", "targets"))
    frame = given.get("frame")
    if isinstance(frame, bool) or not isinstance(frame, int) or not 0 <= frame <= MAX_FRAME:
        raise DraftError("frame of the draft is no frame; give a whole number, from 0")
    targets = _mapping(given.get("targets"), "targets of the draft")
    if len(targets) > MOST_TARGETS:
        raise DraftError(f"the draft has {len(targets)} targets; no more than {MOST_TARGETS} are followed")
    return Draft(frame, {_name(name, "target"): _target(name, one) for name, one in targets.items()})


def _target(name: str, value: object) -> DraftTarget:
    given = _mapping(value, name, ("box", "points", "absent"))
    box: Box | None = None
    if given.get("box") is not None:
        left, top, width, height = _numbers(given["box"], f"the box of {name}", 4)
        if width <= 0 or height <= 0:
            raise DraftError(f"the box of {name} has no area; its width and height must be above 0")
        box = (left, top, width, height)
    points: dict[str, Point] = {}
    found = _mapping(given.get("points") or {}, f"points of {name}")
    if len(found) > MOST_POINTS:
        raise DraftError(f"{name} has {len(found)} points; no more than {MOST_POINTS} are followed")
    for part, at in found.items():
        x, y = _numbers(at, f"{_name(part, 'part')} of {name}", 2)
        points[part] = (x, y)
    return DraftTarget(box, points, _absent(name, given.get("absent")))


def _absent(name: str, value: object) -> tuple[str, ...] | Literal[True]:
    if value is True:
        return True
    if value is None or value is False:
        return ()
    if not isinstance(value, list) or len(value) > MOST_POINTS or not all(isinstance(part, str) for part in value):
        raise DraftError(f"absent of {name} is a list of parts, or true for all of them")
    return tuple(dict.fromkeys(_name(part, "part") for part in value))


def _mapping(value: object, what: str, keys: tuple[str, ...] | None = None) -> Json:
    if not isinstance(value, dict):
        raise DraftError(f"{what} is no JSON object")
    if keys is not None and (unknown := [key for key in value if key not in keys]):
        raise DraftError(f'{what} has the key "{unknown[0][:40]}"; there are {", ".join(keys)}')
    return value


def _name(name: str, what: str) -> str:
    if not NAME.fullmatch(name):
        raise DraftError(f'"{name[:40]}" cannot name a {what}; use letters, digits, _ and -')
    return name


def _numbers(value: object, what: str, count: int) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count:
        raise DraftError(f"{what} is a list of {count} numbers")
    for number in value:
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise DraftError(f"{what} is a list of {count} numbers")
        if not abs(number) <= MAX_PIXELS:  # nan neither
            raise DraftError(f"{what} is beyond any picture")
    return tuple(float(number) for number in value)
