"""Where the runs of a command begin and end, from its options to plans."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Box, Start, TargetStart
from facetrack_cli.recipe.gallery_option import with_gallery
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.job import HAAR, Job
from facetrack_cli.runs.seeds import Plan
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import find_start, place_start
from facetrack_cli.tracking.build.build import check_gallery
from facetrack_cli.tracking.start import find_init
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.source import open_source

OVERRIDES = r",(?=[\w.]+=)"  # a comma before a key, which those in windows=[25,25] are not


def variant(given: str) -> tuple[str, tuple[str, ...]]:
    """A recipe and its overrides, from `name`, a file, or `name:key=value,key=value`."""
    name, colon, rest = given.partition(":")
    if not colon or "=" not in rest or Path(given).exists():
        return given, ()
    return name, tuple(re.split(OVERRIDES, rest))


def labels(given: Sequence[str]) -> list[str]:
    """A label for each --config that differs from all others: the recipe's name, else its path, and its overrides.

    Raises UsageError for one that is given twice.
    """
    parsed = [variant(text) for text in given]
    stems = [(Path(name).stem if Path(name).suffix else name, overrides) for name, overrides in parsed]
    short = [f"{stem}:{','.join(overrides)}" if overrides else stem for stem, overrides in stems]
    found = [s if short.count(s) == 1 else text for s, text in zip(short, given, strict=True)]
    twice = next((text for text in found if found.count(text) > 1), None)
    if twice is not None:
        raise UsageError(f"--config {twice} is given twice; a recipe is compared with others")
    return found


def load_recipes(asked: Sequence[tuple[str, Sequence[str]]], gallery: str | None) -> list[Recipe]:
    """The recipes of names or files and their overrides, with the people of a gallery (see `with_gallery`).

    The gallery is read where it must be good: where it is given for all, or a single recipe names one.
    """
    recipes = with_gallery([load_recipe(name, overrides) for name, overrides in asked], gallery)
    for recipe in recipes if gallery is not None or len(recipes) == 1 else ():
        check_gallery(recipe)
    return recipes


def refuse_seed(overrides: Sequence[str]) -> None:
    """UsageError for an override that would have no effect: a recipe's own seed gives way to those of --seeds."""
    if any(one.partition("=")[0].strip() == "seed" for one in overrides):
        raise UsageError("the recipe's seed has no effect here: every recipe runs with the seeds 0 to --seeds - 1")


class Begin(NamedTuple):
    """A clip, what says where its tracks begin, the first of its frames (with a box its frame), the one to stop before.

    `init` is an init file, or "haar" to look for a face whatever lies beside the clip.
    """

    clip: Path
    init: Path | Literal["haar"] | None = None
    box: Box | None = None
    start: int = 0
    stop: int | None = None
    fps: Fraction | None = None

    def find(self, recipe: Recipe, truth: Trajectory | None = None, stopped: Stop | None = None) -> Start:
        """Where a recipe begins: the box or init file given, the init file beside the clip, else the ground truth.

        The start of ground truth is its first frame in which all that the recipe follows is visible. Without any a face
        is looked for. Raises InputError where there is no such place in these frames.
        """
        beside = self.init is None and self.box is None and find_init(self.clip) is None
        searched = self.init == HAAR or (beside and truth is None)
        first = self.start if searched or self.box else 0
        last = self.stop if searched else None
        job = Job(self.clip, recipe, None, init=self.init, box=self.box, start=first, stop=last, fps=self.fps)
        if beside and truth is not None:
            start: Start | None = place_start(job, truth_start(truth, recipe.points))
        else:
            start = find_start(job, stopped or Stop())
        if start is None:
            raise InputError(f"{self.clip}: stopped before a start was found")
        begins = f"{self.clip}: {start.origin} begins at frame {start.frame}"
        if start.frame < self.start:
            remedy = "leave --start out, or begin elsewhere with --init or --box"
            raise InputError(f"{begins}, before --start {self.start}; {remedy}")
        if self.stop is not None and start.frame >= self.stop:
            remedy = "give a larger one, or begin elsewhere"
            raise InputError(f"{begins}, of which --stop {self.stop} leaves nothing; {remedy}")
        return start

    def plan(self, label: str, recipe: Recipe, seeds: int, truth: Trajectory | None, stopped: Stop) -> Plan:
        """A recipe with seeds 0 to `seeds` - 1."""
        start = self.find(recipe, truth, stopped)
        return Plan(label, self.clip, recipe, start, tuple(range(seeds)), self.stop, self.fps)

    def frame_size(self) -> tuple[int, int]:
        """(width, height) of the clip's frames."""
        with open_source(self.clip, fps=self.fps) as source:
            return source.size


def truth_start(truth: Trajectory, points: Sequence[str]) -> Start:
    """The first frame of the truth in which its targets' boxes, or all these points of them, are visible."""
    for frame in truth.frames.tolist():
        targets: dict[str, TargetStart] = {}
        for target in truth.targets:
            box: Box | None = None
            found: dict[str, tuple[float, float]] = {}
            for one in truth.parts:
                at = int(np.searchsorted(one.frame, frame))
                if one.target != target or at == len(one) or one.frame[at] != frame or one.status[at] not in _SEEN:
                    continue
                if np.isfinite(one.boxes[at]).all():
                    left, top, w, h = one.boxes[at].tolist()
                    box = (left, top, w, h)
                elif np.isfinite([one.x[at], one.y[at]]).all():
                    found[one.part] = (float(one.x[at]), float(one.y[at]))
            wanted = {part: found[part] for part in points if part in found}
            if box is not None or (points and len(wanted) == len(points)):
                targets[target or "face"] = TargetStart(box=box, points=wanted if len(wanted) == len(points) else {})
        if len(targets) == len(truth.targets):
            return Start(frame, targets, str(truth.path))
    what = ", ".join(points) if points else "a box"
    other = "" if points else ", or take a recipe of points, as factorized"
    raise InputError(
        f"{truth.path}: no frame shows {what} of every target to begin with; give --init FILE or --box{other}"
    )


def far_from_truth(start: Start, truth: Trajectory) -> str | None:
    """A line if a start's box lies elsewhere than the truth's in its frame: then every figure measures that."""
    if start.origin == str(truth.path):
        return None
    for name, target in start.targets.items():
        known = [one for one in truth.parts if one.target in (name, "") and start.frame in one.frame]
        for one in known if target.box is not None else []:
            true = one.boxes[one.frame == start.frame]
            overlap = float(iou(np.array([target.box]), true)[0]) if np.isfinite(true).all() else 1.0
            if overlap < FAR:
                return (
                    f"{start.origin} puts the box of {name} in frame {start.frame} where it overlaps the truth's "
                    f"by {overlap:.2f} alone; all figures measure that too: begin with --box, or with another --init"
                )
    return None


FAR = 0.5  # overlap of the boxes, as a region is held to be found
_SEEN = ("", "visible", "init", "tracked")
