"""One row of a trajectory or ground-truth file, and what stands around the rows in JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from facetrack_cli.core.types import Result


SCHEMA = "facetrack-trajectory"


VERSION = 1


Format: TypeAlias = Literal["csv", "json", "jsonl"]


FORMATS: tuple[Format, ...] = ("csv", "json", "jsonl")


class Row(NamedTuple):
    """One line of a trajectory or of a truth file.

    `frame` is the 0-based source frame; (x, y) the centre and (w, h) the window in pixels; `angle` in degrees;
    `confidence` 0..1; `std_x`, `std_y` the posterior's spread in pixels. What is not known is None, or "" for text.
    `by_hand`, which the CSV does not have, is whether a correction said so at this very frame.
    """

    frame: int
    time_s: float | None
    target: str
    part: str
    x: float | None
    y: float | None
    w: float | None = None
    h: float | None = None
    angle: float | None = None
    confidence: float | None = None
    status: str = ""
    std_x: float | None = None
    std_y: float | None = None
    particles: int | None = None
    ess: float | None = None
    identity: str = ""
    identity_prob: float | None = None
    by_hand: bool = False


COLUMNS = Row._fields[:-1]  # of the CSV


REQUIRED = ("frame", "target", "part", "x", "y")


# the bytes of a file are a function of the values: every column has its number of decimals
DECIMALS = {
    "time_s": 4,
    "x": 3,
    "y": 3,
    "w": 3,
    "h": 3,
    "angle": 2,
    "confidence": 4,
    "std_x": 3,
    "std_y": 3,
    "ess": 1,
    "identity_prob": 4,
}


WHOLE = ("frame", "particles")


def rows(result: Result) -> Iterator[Row]:
    """The rows of one frame: targets in the tracker's order, parts in the recipe's."""
    for target in result.targets:
        for part in target.parts:
            yield Row(
                frame=result.frame.index,
                time_s=result.frame.time_s,
                target=target.name,
                part=part.name,
                x=_place(part.x),
                y=_place(part.y),
                w=_place(part.w),
                h=_place(part.h),
                angle=part.angle,
                confidence=part.confidence,
                status=part.status,
                std_x=None if part.cov is None else math.sqrt(max(part.cov[0], 0.0)),
                std_y=None if part.cov is None else math.sqrt(max(part.cov[2], 0.0)),
                particles=target.particles,
                ess=part.ess,
                identity=target.identity or "",
                identity_prob=target.identity_prob,
                by_hand=part.by_hand,
            )


def _place(value: float) -> float | None:
    """nan, which an absent part has, is not known."""
    return value if value == value else None


Header: TypeAlias = Mapping[str, Any]  # JSON-ready: source, recipe, seed, init


class Footer(NamedTuple):
    """How a run ended. `complete` is False when frames that were asked for are missing; `stopped` says why.

    `lost_frames` counts, for each "target/part", the frames in which it was lost. Only at its end is it known whether
    a clip keeps a constant rate.
    """

    complete: bool = True
    stopped: str | None = None
    warnings: tuple[str, ...] = ()
    lost_frames: Mapping[str, int] = {}
    variable_fps: bool | None = None
