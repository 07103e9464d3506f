"""What is asked of one clip, and what became of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.start import Begin
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.trajectory.writers import Format

Report: TypeAlias = Callable[[int, "int | None"], None]  # frames done, frames in all if that is known


@dataclass(frozen=True)
class Job(Begin):
    """What is asked of one clip. `out` None streams the one format to standard output."""

    recipe: Recipe
    out: Path | None
    _: KW_ONLY
    formats: tuple[Format, ...] = ("csv", "json")
    video: bool = True
    overwrite: bool = False
    threads: int = 2


@dataclass
class Outcome:
    """What became of one clip. `lost` counts the lost frames of each part; `lost_at_end` are those lost in the last.

    `error` ended the run early; what was tracked until then is kept.
    """

    clip: Path
    files: Sequence[Path] = ()
    frames: int = 0
    frames_per_s: float = 0.0
    lost: dict[str, int] = field(default_factory=dict)
    lost_at_end: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    complete: bool = True
    stopped: str | None = None
    error: Exception | None = None
    streamed: bool = False

    def count(self, result: FrameResult) -> None:
        """Take in one more frame."""
        rows = result.rows
        self.frames += 1
        self.lost_at_end = tuple("/".join(rows.names[i]) for i in rows.which[rows.status == "lost"].tolist())
        for part in self.lost_at_end:
            self.lost[part] = self.lost.get(part, 0) + 1

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.clip}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames", f"{self.frames_per_s:.1f} frames/s"] if self.frames > 1 else ["1 frame"]
        if self.lost:
            parts.append("lost: " + ", ".join(f"{part} in {n}" for part, n in self.lost.items()))
        if self.stopped or not self.complete:
            parts.append(self.stopped or "incomplete")
        where = "standard output" if self.streamed else "nothing"
        if self.files:
            where = f"{self.files[0].parent}{os.sep} ({', '.join(file.name for file in self.files)})"
        return f"{self.clip} -> {where}: {'; '.join(parts)}"
