"""How far an estimate can be trusted, from the frame alone.

The window at the estimate is compared with the template, and the distance d is placed between two levels of this clip:

    good_i    the running mean of d at the estimate over `memory` frames in which the part was not in doubt. It begins
              as the median of d over a ring of windows in the first frame that are off by 1/13 of the window's size
    bad_i     the quantile `beside` of d over a ring of windows off by the whole window's size in the first frame, or d
              of a blank window if that is less. A lower quantile is stricter
    confidence = clip((bad - d) / (bad - good), 0, 1), and 0 for a part that looks like all that is around it

A part is `lost` once its confidence has stayed under `lost_below` for `patience` frames, `tracked` once it is not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from facetrack_cli.core.types import Array, Frame, Mask, Whole
from facetrack_cli.recipe.model import ConfidenceSettings
from facetrack_cli.trajectory.trajectory import Status

if TYPE_CHECKING:
    from facetrack_cli.engine.protocols import Likelihood


@dataclass(frozen=True)
class Judgement:
    """What is known of each of K parts after a frame. `good`, `bad`, `confidence` (K,); `below`: frames in a row."""

    good: Array
    bad: Array
    confidence: Array
    below: Whole
    status: tuple[Status, ...]


def begin(
    settings: ConfidenceSettings, likelihood: Likelihood, learned: Any, frame: Frame, x0: Array, windows: Array
) -> Judgement:
    """The judgement of the first frame, whose parts are at x0 (K, D) and `windows` (K, 2) pixels large."""
    k = len(x0)
    angles = np.arange(16) * (2 * np.pi / 16)
    ring = np.zeros((16, *x0.shape))
    ring[..., :2] = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None] * windows
    near = np.median(likelihood.distances(learned, frame, x0 + ring / 13), axis=0)
    beside = np.quantile(likelihood.distances(learned, frame, x0 + ring), settings.beside, axis=0)
    blank = Frame(frame.index, frame.time_s, np.full_like(frame.bgr, 128))
    bad = np.minimum(beside, likelihood.distances(learned, blank, x0[None])[0])
    return Judgement(near, bad, np.ones(k), np.zeros(k, np.int64), tuple(["init"] * k))


def judge(settings: ConfidenceSettings, last: Judgement, distance: Array) -> Judgement:
    """The judgement of the next frame, whose windows at the estimates have `distance` (K,) from the templates."""
    good, span = last.good, last.bad - last.good
    share = np.minimum(np.maximum((last.bad - distance) / np.maximum(span, 1e-6), 0.0), 1.0)
    confidence = np.where(span > 1e-6, share, 0.0)
    if settings.memory is not None:
        good = np.where(confidence < settings.lost_below, good, good + (distance - good) / settings.memory)
    return decide(settings, replace(last, good=good), confidence)


def decide(settings: ConfidenceSettings, last: Judgement, confidence: Array) -> Judgement:
    """The judgement of the next frame, with this confidence (K,)."""
    below = np.where(confidence < settings.lost_below, last.below + 1, 0)
    status: tuple[Status, ...] = tuple(["lost" if n >= settings.patience else "tracked" for n in below.tolist()])
    return replace(last, confidence=confidence, below=below, status=status)


def resume(
    settings: ConfidenceSettings,
    first: Judgement,
    relearned: Mask,
    likelihood: Likelihood,
    learned: Any,
    frame: Frame,
    x0: Array,
    windows: Array,
) -> Judgement:
    """The judgement where a target begins again at x0 (K, D), with `windows` (K, 2), knowing what `learned` says.

    Parts `relearned` (K,) are judged from here on, others by the `first` frame; one in doubt is `lost` at once.
    """
    impatient = np.full(len(first.below), settings.patience - 1, np.int64)
    kept = judge(settings, replace(first, below=impatient), likelihood.distances(learned, frame, x0[None])[0])
    if not relearned.any():
        return kept
    new = begin(settings, likelihood, learned, frame, x0, windows)
    mixed = {key.name: np.where(relearned, getattr(new, key.name), getattr(kept, key.name)) for key in fields(kept)}
    return Judgement(**{**mixed, "status": tuple(mixed["status"].tolist())})
