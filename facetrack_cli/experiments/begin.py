"""Where the runs of a command begin and end, from its options to plans."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Literal, NamedTuple

from facetrack_cli.errors import UsageError
from facetrack_cli.experiments.runs import Plan, find_plan_start
from facetrack_cli.formats.table import Table
from facetrack_cli.job import HAAR
from facetrack_cli.recipe import Recipe
from facetrack_cli.stopping import Stop
from facetrack_cli.types import Box
from facetrack_cli.video.source import open_source


class Begin(NamedTuple):
    """A clip, what says where its tracks begin (see `find_plan_start`), and the frame to end before."""

    clip: Path
    init: Path | Literal["haar"] | None
    box: Box | None
    stop: int | None
    fps: Fraction | None
    start: int = 0

    @classmethod
    def of(
        cls, clip: Path, init: str | None, box: Box | None, stop: int | None, fps: Fraction | None, start: int = 0
    ) -> Begin:
        """From options; UsageError where they contradict each other."""
        if init is not None and box is not None:
            raise UsageError("--init and --box both say where the track starts; give one of them")
        if init == "":
            raise UsageError("--init is empty; name an init file, or haar to look for a face")
        if fps is not None and clip.is_file():
            raise UsageError("--fps is for image folders; a video brings its own rate")
        return cls(clip, None if init is None else HAAR if init == HAAR else Path(init), box, stop, fps, start)

    def plan(self, label: str, recipe: Recipe, seeds: int, truth: Table | None, stopped: Stop) -> Plan:
        """A recipe with seeds 0 to `seeds` - 1."""
        start = find_plan_start(
            self.clip,
            recipe,
            init=self.init,
            box=self.box,
            truth=truth,
            fps=self.fps,
            first=self.start,
            stop=self.stop,
            stopped=stopped,
        )
        return Plan(label, self.clip, recipe, start, tuple(range(seeds)), self.stop, self.fps)

    def picture_size(self) -> tuple[int, int]:
        """(width, height) of the clip's pictures."""
        with open_source(self.clip, fps=self.fps) as source:
            return source.size
