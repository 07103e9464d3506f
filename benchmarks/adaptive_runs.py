"""Runs of trackers that adapt, with their diagnostics, for `adaptive.py` and `recognition.py`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame, Mask, Start
from facetrack_cli.engine.loop import track
from facetrack_cli.evaluation.boxes import SUCCESS_THRESHOLDS, BoxMeasures, measure_boxes, share_above
from facetrack_cli.evaluation.compare import TAIL_IOU, default_truth, tail_overlap
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import variant
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.trajectory import Collector, FrameResult, Trajectory
from facetrack_cli.video.source import open_source

SAMPLES = Path(__file__).parent.parent / "sample_videos"
MADE = ("zoom", "lamp")


@dataclass(frozen=True, eq=False)
class Run:
    """One run; T frames. `states` (T, 6), `corners` (T, 4, 2), `angle` in degrees; what is not known is nan."""

    frame: Array
    boxes: Array
    states: Array
    corners: Array
    angle: Array
    scale: Array
    particles: Array
    confidence: Array
    lost: Mask
    posterior: tuple[Mapping[str, float] | None, ...]
    truth: Array
    true_angle: Array

    @cached_property
    def measures(self) -> BoxMeasures:
        return measure_boxes(self.boxes, self.truth)

    @property
    def auc(self) -> float:
        """The success AUC."""
        return float(self.measures.success_auc or 0.0)

    @property
    def ends_lost(self) -> bool:
        tail = tail_overlap(self.measures.overlap)
        return tail is not None and tail < TAIL_IOU

    def polygon_auc(self) -> float:
        """Success AUC with the overlap of the parallelograms and the true boxes, turned where the ground truth is."""
        known = np.isfinite(self.truth).all(axis=1)
        overlap = np.array(
            [overlap_of(a, b) for a, b in zip(self.corners[known], self._true_corners[known], strict=True)]
        )
        overlap[0] = 1.0  # given
        return float(share_above(overlap, SUCCESS_THRESHOLDS).mean())

    @property
    def _true_corners(self) -> Array:
        turn = np.radians(np.nan_to_num(self.true_angle))
        c, s = np.cos(turn), np.sin(turn)
        return corners_of(self.truth, np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1))


def corners_of(boxes: Array, turn: Array) -> Array:
    """(T, 4, 2) of boxes (T, 4) under maps (T, 2, 2) around their centres."""
    half = boxes[:, None, 2:] / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners: Array = (boxes[:, :2] + (boxes[:, 2:] - 1) / 2)[:, None] + np.einsum("tij,tkj->tki", turn, half)
    return corners


def overlap_of(a: Array, b: Array) -> float:
    """Intersection over union of two convex polygons (n, 2)."""
    a, b = a.astype(np.float32), b.astype(np.float32)
    shared, _ = cv2.intersectConvexConvex(a, b)
    return float(shared / max(cv2.contourArea(a) + cv2.contourArea(b) - shared, 1e-9))


def clip_of(name: str, clips: Path | None) -> Path:
    if name in MADE:
        return SAMPLES / f"{name}.mp4"
    if clips is None:
        raise SystemExit(f"{name} is among the real clips; say where they are with --clips")
    videos = [path for path in sorted((clips / name).iterdir()) if path.is_file() and path.suffix != ".csv"]
    return videos[0] if videos else clips / name / "img"


def follow(clip: Path, config: str, seeds: int, start: Start | None = None, more: Sequence[str] = ()) -> list[Run]:
    """A recipe on a clip, one run a seed; a single one of what does not draw at random."""
    cv2.setNumThreads(1)
    name, overrides = variant(config)
    recipe = load_recipe(name, [*overrides, *more])
    truth: Trajectory | None = None
    try:
        truth = read_truth(default_truth(clip))
    except InputError:
        if start is None:
            raise
    begin = start or ClipRequest(clip).find(recipe, truth)
    true = {
        int(frame): (*box, angle)
        for one in (truth.parts if truth is not None else ())
        for frame, box, angle in zip(one.frame, one.boxes, one.angle, strict=True)
    }
    with open_source(clip, start=begin.frame) as source:
        frames = list(source)
    tracker = build_tracker(recipe, begin)
    found = []
    for seed in range(seeds if recipe.random else 1):
        # what is derived from an image is kept in its frame
        fresh = (Frame(frame.index, frame.time_s, frame.bgr) for frame in frames)
        found.append(run_of(track(tracker, fresh, seed, clip=str(clip)), true))
    return found


def run_of(results: Iterable[FrameResult], true: Mapping[int, Sequence[float]]) -> Run:
    """Of the one target of some results; `true` has left, top, width, height and angle of frames."""
    collected = Collector()
    for result in results:
        collected.add(result.rows)
    one = collected.trajectory()
    reported = one.diagnostics.get(one.target)
    affine = None if reported is None else reported.values.get("affine")
    deformed = np.tile([1.0, 0.0, 0.0, 1.0], (len(one), 1)) if affine is None else affine[:, :4]
    sizes = one.boxes[:, 2:] if affine is None else np.tile(one.boxes[0, 2:], (len(one), 1))
    centres = np.stack([one.x, one.y], axis=1)
    upright = np.concatenate([centres - (sizes - 1) / 2, sizes], axis=1)
    posterior: list[Mapping[str, float] | None] = [None] * len(one)
    if reported is not None and "posterior" in reported.values:
        names = reported.labels["posterior"]
        posterior = [dict(zip(names, row, strict=True)) for row in reported.values["posterior"].tolist()]
    known = np.array([true.get(frame, (np.nan,) * 5) for frame in one.frame.tolist()], np.float64)
    return Run(
        frame=one.frame.astype(np.float64),
        boxes=one.boxes,
        states=np.concatenate([centres, deformed], axis=1),
        corners=corners_of(upright, deformed.reshape(-1, 2, 2)),
        angle=np.nan_to_num(one.angle),
        scale=np.full(len(one), np.nan) if reported is None else reported.get("scale"),
        particles=one.particles,
        confidence=one.confidence,
        lost=one.status == "lost",
        posterior=tuple(posterior),
        truth=known[:, :4],
        true_angle=known[:, 4],
    )
