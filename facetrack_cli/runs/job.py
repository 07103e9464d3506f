"""What is asked of one clip, and what became of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from facetrack_cli.trajectory.writers import Format

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box, Start
    from facetrack_cli.recipe.model import Recipe


HAAR: Final = "haar"


Report: TypeAlias = Callable[[int, "int | None"], None]  # frames done, frames in all if that is known


@dataclass(frozen=True)
class Job:
    """What is asked of one clip. `out` None streams the one format to standard output.

    `init` is an init file, "haar" to look for a face whatever lies beside the clip, a start, or None for the usual
    order.
    """

    clip: Path
    recipe: Recipe
    out: Path | None
    formats: tuple[Format, ...] = ("csv", "json")
    video: bool = True
    init: Path | Literal["haar"] | Start | None = None
    box: Box | None = None
    init_frame: int | None = None
    start: int = 0
    stop: int | None = None
    fps: Fraction | None = None
    overwrite: bool = False
    threads: int = 2


@dataclass(frozen=True)
class Outcome:
    """What became of one clip. `lost` counts the lost frames of each part; `lost_at_end` are those lost in the last.

    `error` ended the run early; what was tracked until then is kept.
    """

    clip: Path
    files: tuple[Path, ...] = ()
    frames: int = 0
    frames_per_s: float = 0.0
    lost: dict[str, int] = field(default_factory=dict)
    lost_at_end: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    complete: bool = True
    stopped: str | None = None
    error: Exception | None = None
    streamed: bool = False

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.clip}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames", f"{self.frames_per_s:.1f} frames/s"] if self.frames > 1 else ["1 frame"]
        if self.lost:
            parts.append("lost: " + ", ".join(f"{part} in {n}" for part, n in self.lost.items()))
        if self.stopped:
            parts.append(self.stopped)
        elif not self.complete:
            parts.append("incomplete")
        return f"{self.clip} -> {_where(self.files, self.streamed)}: {'; '.join(parts)}"


def _where(files: tuple[Path, ...], streamed: bool) -> str:
    if not files:
        return "standard output" if streamed else "nothing"
    return f"{files[0].parent}{os.sep} ({', '.join(f.name for f in files)})"
