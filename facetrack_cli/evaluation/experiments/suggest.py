"""Which recipe a clip asks for, without ground truth: recipes are tried on its first seconds and ranked.

A track that is right comes back where it began if the frames are tracked backwards from its end (forward-backward
error: Kalal, Mikolajczyk & Matas, "Forward-Backward Error: Automatic Detection of Tracking Failures", ICPR 2010; here
of whole tracks, as overlap of boxes). Beside it counts the share of frames in which the recipe calls its target lost.
The log evidence of a recipe is shown and does not count: its constant is the recipe's own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import BOX, Array, Frame, Mask, Start, TargetStart
from facetrack_cli.evaluation.sheet import NO_FIGURE, Sheet, rounded
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.start import Begin, completed, frames_of
from facetrack_cli.tracking.build.build import tracker_for
from facetrack_cli.tracking.loop import track
from facetrack_cli.trajectory.diagnostics import EVIDENCE
from facetrack_cli.trajectory.trajectory import SEEN, UNSEEN
from facetrack_cli.video.source import FOLDER_FPS

FACE: Final = ("face", "correlation_filter", "skin_ncc_robust")
ANY: Final = ("correlation_filter", "skin_ncc_robust")
MARGIN: Final = 0.05  # of the score, by which another recipe must be better than the default, the first
NO_SKIN: Final = "likelihood.skin=null"  # of skin_ncc_robust where a clip is grey
FRAMES: Final = 100
SIGNER: Final = "signer"
HANDS: Final = 0.65  # of `hands_seen`, from which on there are hands to follow
MAX_BYTES: Final = 512 << 20  # of the frames that are kept
MAX_GREY: Final = 3.0  # mean difference of colour channels, in grey levels, of a clip without colour


@dataclass(frozen=True)
class Trial:
    """What a recipe made of the piece. `agreement` is the mean overlap of the tracks forwards and backwards, 0..1."""

    recipe: str
    agreement: float
    lost: float
    confidence: float
    evidence: float
    ms: float

    @property
    def score(self) -> float:
        """Agreement times the share of frames in which the target is tracked."""
        return self.agreement * (1 - self.lost)


@dataclass(frozen=True)
class _Track:
    """The first target's box in each frame (T, 4), whether it is lost (T,), and what else a trial shows."""

    boxes: Array
    lost: Mask
    confidence: float
    evidence: float
    points: dict[str, tuple[float, float]]
    seconds: float


def piece(begin: Begin, start: Start, most: int = FRAMES) -> list[Frame]:
    """The first frames from a start on, as many as `MAX_BYTES` hold."""
    with begin.open(start.frame) as source:
        most = max(2, min(most, MAX_BYTES // (3 * source.size[0] * source.size[1])))
        frames = list(islice(frames_of(source, start.frame, start.origin), most))
    if len(frames) < 2:
        raise InputError(f"{begin.clip}: a single frame says nothing about recipes; give a longer clip")
    return frames


def is_grey(frame: Frame) -> bool:
    image = frame.bgr.astype(np.int16)
    return float(np.ptp(image, axis=2).mean()) < MAX_GREY


def suggest(
    recipes: Sequence[tuple[str, Recipe]],
    frames: Sequence[Frame],
    start: Start,
    clip: str,
    report: Callable[[str, int], None] = lambda recipe, done: None,
) -> list[Trial]:
    """The trials of `recipes`, of which the first is the default, the best one first.

    A recipe that cannot begin with this start is left out.
    """
    found: list[Trial] = []
    for name, recipe in recipes:
        report(name, len(found))
        try:
            own = completed(recipe, start, lambda: frames[0], clip)
            forwards = _tracked(recipe, own, frames)
        except InputError:
            continue
        found.append(_trial(name, recipe, own, frames, forwards))
    if not found:
        raise InputError(f"{clip}: no recipe can begin here; give --box X,Y,W,H around a face, a head or a thing")
    return sorted(found, key=lambda one: (-one.score - MARGIN * (one.recipe == recipes[0][0]), one.ms))


def hands_seen(frames: Sequence[Frame], start: Start, clip: str) -> float | None:
    """The share of both hands of `signer` that are seen over all frames; None where it cannot begin, as in grey."""
    recipe = load_recipe(SIGNER)
    try:
        own = completed(recipe, start, lambda: frames[0], clip)
        results = list(track(tracker_for(recipe, own, frames[0].size, FOLDER_FPS), iter(frames), recipe.seed))
    except InputError:
        return None
    status = [row for one in results for target in one.targets[1:] for row in target.rows.status.tolist()]
    return float(np.isin(status, SEEN).mean())


def _trial(name: str, recipe: Recipe, start: Start, frames: Sequence[Frame], forwards: _Track) -> Trial:
    there = np.flatnonzero(~forwards.lost & np.isfinite(forwards.boxes).all(axis=1))
    last = int(there[-1]) if there.size else 0
    agreement = 0.0
    if last:
        back = [Frame(i, i / 25, frames[last - i].pixels) for i in range(last + 1)]
        target, given = next(iter(start.targets.items()))
        x, y, w, h = forwards.boxes[last].tolist()
        begun = TargetStart((x, y, w, h), forwards.points if given.points else {})
        try:
            backwards = _tracked(recipe, Start(0, {target: begun}, start.origin), back).boxes[::-1]
            overlaps = np.nan_to_num(iou(forwards.boxes[: last + 1], backwards))
            agreement = float(overlaps.mean())
        except InputError:  # where it ended a track cannot begin
            agreement = 0.0
    ms = 1000 * forwards.seconds / (len(frames) - 1)
    return Trial(name, agreement, float(forwards.lost.mean()), forwards.confidence, forwards.evidence, ms)


def _tracked(recipe: Recipe, start: Start, frames: Sequence[Frame]) -> _Track:
    """Track the first target; its points in the last frame in which it was there are kept."""
    boxes, lost, sure, nats = [], [], [], 0.0
    points: dict[str, tuple[float, float]] = {}
    target = next(iter(start.targets))
    began, seconds = 0.0, 0.0
    tracker = tracker_for(recipe, start, frames[0].size, FOLDER_FPS)
    for result in track(tracker, iter(frames), recipe.seed):
        seconds = time.perf_counter() - began if began else 0.0
        began = began or time.perf_counter()  # what is compiled for the first frame does not count
        rows = next(one.rows for one in result.targets if one.rows.target == target)
        names = [rows.names[i][1] for i in rows.which.tolist()]
        k = names.index(BOX) if BOX in names else 0
        boxes.append(rows.boxes[k])
        lost.append(str(rows.status[k]) in UNSEEN)
        sure.append(rows.confidence[k])
        if target in rows.diagnostics:
            nats += float(np.nansum(rows.diagnostics[target].get(EVIDENCE.name)))
        if not lost[-1]:
            points = {name: (float(rows.x[i]), float(rows.y[i])) for i, name in enumerate(names) if i != k}
    known = np.array(sure, float)
    confidence = float(np.nanmean(known)) if np.isfinite(known).any() else float("nan")
    return _Track(np.array(boxes), np.array(lost), confidence, nats / len(frames), points, seconds)


def sheet_of(where: str, trials: Sequence[Trial]) -> Sheet:
    """A row for each recipe, the best first."""
    rows = []
    for one in trials:
        figures = f"{one.evidence:.2f}", f"{one.ms:.1f}"
        confidence = NO_FIGURE if np.isnan(one.confidence) else f"{one.confidence:.2f}"
        rows.append((one.recipe, f"{one.agreement:.2f}", f"{one.lost:.0%}", confidence, *figures))
    return Sheet(where, ("recipe", "agreement", "lost", "confidence", "evidence", "ms a frame"), tuple(rows))


def as_json(
    clip: str, frames: Sequence[Frame], trials: Sequence[Trial], command: str, hands: float | None
) -> dict[str, Any]:
    """What --json prints; figures to four decimals, null where there is none."""
    rows = [asdict(one) | {"score": one.score} for one in trials]
    plain = [{k: v if isinstance(v, str) else rounded(v, 4) for k, v in row.items()} for row in rows]
    seen = None if hands is None else rounded(hands, 4)
    found = {"clip": clip, "first": frames[0].index, "frames": len(frames), "trials": plain, "command": command}
    return found | {"hands_seen": seen}
