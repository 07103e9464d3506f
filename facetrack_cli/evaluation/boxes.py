"""How well boxes follow the truth: the measures of OTB, GOT-10k and VOT, and the good tracking rate.

    measures = measure_boxes(ours, truth, valid=visible, size=(1280, 720))
    measures.auc, measures.ao, measures.vot_accuracy

Boxes are (T, 4): left, top, width, height in pixels, one row a frame; the centre is left + (width - 1) / 2. What is not
known is nan. Three rules hold for every measure:

- A row counts when its truth is there: `valid`, and no nan in its box. The others are left out.
- A row that counts and has no box of ours is a miss: overlap 0, infinite error of the centre.
- The toolkits' arithmetic is followed to the last bit, since a comparison with a threshold hangs on it.

Where the toolkits differ from that: got10k 0.1.3 counts a row without truth as a failure in its OTB experiment (in its
GOT-10k experiment, and in the LaSOT experiment of its later sources, such rows are left out), and its AO is nan as soon
as one prediction is nan. vot-toolkit leaves out rows without truth, but rows without a prediction too, unless told
`ignore_unknown: False`, as VOTS tells it; `vot_skip_missing` is the other way. Both are tested (`test_peers.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.raster import vot_overlaps

SUCCESS_THRESHOLDS: Array = np.linspace(0.0, 1.0, 21)  # overlap; OTB


PRECISION_THRESHOLDS: Array = np.arange(51.0)  # pixels


NORMALISED_THRESHOLDS: Array = np.linspace(0.0, 0.5, 51)  # error of the centre in sizes of the true box


GOT10K_THRESHOLDS: Array = np.linspace(0.0, 1.0, 101)  # overlap


@dataclass(frozen=True, eq=False)
class BoxMeasures:
    """All measures of one target. Shares and overlaps are 0..1; nan where no row counts.

    Curves belong to SUCCESS_THRESHOLDS, PRECISION_THRESHOLDS, NORMALISED_THRESHOLDS and GOT10K_THRESHOLDS.
    """

    frames: int  # rows with truth, as OTB, precision and the good tracking rate count them
    missing: int  # of these, rows without a box of ours
    overlap: Array  # (T,) IoU as OTB has it; nan without truth
    centre_error: Array  # (T,) pixels; inf without a box of ours, nan without truth
    success: Array  # (21,)
    auc: float
    precision: Array  # (51,)
    precision_20: float  # at 20 px
    normalised_precision: Array  # (51,)
    normalised_auc: float
    normalised_20: float  # at 0.2 of the box
    got10k_frames: int
    ao: float
    sr50: float
    sr75: float
    got10k_success: Array  # (101,)
    vot_frames: int
    vot_accuracy: float
    good_rate: float
    strict_rate: float


def centre_errors(ours: Array, truth: Array) -> Array:
    """(T,) distance of the centres in pixels (OTB; got10k's `center_error`)."""
    return _length(_centres(ours) - _centres(truth))


def normalised_errors(ours: Array, truth: Array) -> Array:
    """(T,) distance of the centres, each axis in widths and heights of the true box.

    The normalised precision of TrackingNet (Müller et al. 2018) and LaSOT (Fan et al. 2019). Sides below
    one pixel count as one, as in got10k's `normalized_center_error` of its later sources; 0.1.3 on PyPI is without it.
    """
    return _length((_centres(ours) - _centres(truth)) / np.maximum(1.0, truth[:, 2:]))


def within(ours: Array, truth: Array, share: float = 0.5) -> Mask:
    """(T,) whether our centre is within `share` of the true width and height from the true centre, on both axes.

    0.5 is the true box itself, border included: these rows are what we take the good tracking rate of Gonzalez and
    Collet to count (table 1, which does not define it). 0.25 is our strict form. False where one of them has nan.
    """
    inside: Mask = np.all(np.abs(_centres(ours) - _centres(truth)) <= truth[:, 2:] * share, axis=1)
    return inside


def share_above(values: Array, thresholds: Array) -> Array:
    """(K,) share of values (T,) strictly above each threshold (K,): a success curve. nan when there are no values."""
    return _shares(len(values) - np.searchsorted(np.sort(values), thresholds, side="right"), len(values))


def share_up_to(values: Array, thresholds: Array) -> Array:
    """(K,) share of values (T,) at or below each threshold (K,): a precision curve. nan when there are no values."""
    return _shares(np.searchsorted(np.sort(values), thresholds, side="right"), len(values))


def measure_boxes(
    ours: Array,
    truth: Array,
    *,
    valid: Mask | None = None,
    our_corners: Array | None = None,
    true_corners: Array | None = None,
    size: tuple[int, int] | None = None,
    first_is_init: bool = True,
    vot_burn_in: int = 1,
    vot_skip_missing: bool = False,
) -> BoxMeasures:
    """All measures of boxes `ours` against `truth`, (T, 4) each, row by row of the same frames.

    valid: (T,) where the target is to be seen; without it, wherever truth has a box.
    our_corners, true_corners: (T, 4, 2) polygons, which VOT takes in place of the boxes where they are not nan.
    size: (width, height) of the picture, for GOT-10k and VOT, which both clip to it; without it nothing is clipped.
    first_is_init: the first row was given to the tracker, so that it says nothing about it. OTB's experiment puts the
    truth there (overlap 1, error 0), and so does the good tracking rate here; GOT-10k leaves the row out; VOT leaves
    out `vot_burn_in` rows from it on: 1 in the unsupervised experiments of VOT-ST2020 to 2022 and in vot-toolkit's
    OTB stacks, 10 where a stack does not say. Without first_is_init every row counts in all of them.

    The measures: success, the share of rows with IoU strictly above each of 21 thresholds, and `auc`, its mean;
    precision, the share with centres at most 0..50 px apart (Wu, Lim and Yang 2013; got10k's ExperimentOTB);
    normalised precision, the share with `normalised_errors` at most 0..0.5, and `normalised_auc`, its mean over the 51
    thresholds, which is what LaSOT's table and got10k report; `normalised_20` is the single value at 0.2.
    AO, the mean IoU, SR50 and SR75, the shares strictly above 0.5 and 0.75 (Huang, Zhao and Huang 2019; got10k's
    ExperimentGOT10k). VOT's accuracy, the mean overlap of rasterised regions (`raster.vot_overlaps`; vot-toolkit's
    SequenceAccuracy; Kristan et al. 2016). `good_rate` and `strict_rate`: see `within`.

    Raises ValueError when shapes do not fit.
    """
    ours, truth = _checked(ours, truth)
    counts = _known(truth)
    if valid is not None:
        counts &= valid
    missing = ~_known(ours)
    # nan all over, so that no half of a box is compared with anything
    ours = np.where(missing[:, None], np.nan, ours)
    later = counts.copy()
    otb = ours
    if first_is_init and len(ours):
        later[0] = False
        otb = np.concatenate([truth[:1], ours[1:]])

    overlap = np.where(counts, np.nan_to_num(iou(otb, truth)), np.nan)
    distance = centre_errors(otb, truth)
    distance = np.where(counts, np.where(np.isnan(distance), np.inf, distance), np.nan)
    success = share_above(overlap[counts], SUCCESS_THRESHOLDS)
    precision = share_up_to(distance[counts], PRECISION_THRESHOLDS)
    normalised = normalised_errors(otb, truth)[counts]
    normalised = share_up_to(np.where(np.isnan(normalised), np.inf, normalised), NORMALISED_THRESHOLDS)

    clipped = np.nan_to_num(iou(ours[later], truth[later], size))

    vot = counts.copy()
    if first_is_init:
        vot[:vot_burn_in] = False
    if vot_skip_missing:
        vot &= ~missing
    regions = vot_overlaps(ours[vot], truth[vot], _rows(our_corners, vot), _rows(true_corners, vot), size)

    return BoxMeasures(
        frames=int(counts.sum()),
        missing=int((counts & np.isnan(otb[:, 0])).sum()),
        overlap=overlap,
        centre_error=distance,
        success=success,
        auc=float(np.mean(success)),
        precision=precision,
        precision_20=float(precision[20]),
        normalised_precision=normalised,
        normalised_auc=float(np.mean(normalised)),
        normalised_20=float(normalised[20]),
        got10k_frames=int(later.sum()),
        ao=_mean(clipped),
        sr50=_mean(clipped > 0.5),
        sr75=_mean(clipped > 0.75),
        got10k_success=share_above(clipped, GOT10K_THRESHOLDS),
        vot_frames=int(vot.sum()),
        vot_accuracy=_mean(regions),
        good_rate=_mean(within(otb, truth)[counts]),
        strict_rate=_mean(within(otb, truth, 0.25)[counts]),
    )


def _checked(ours: Array, truth: Array) -> tuple[Array, Array]:
    ours, truth = np.asarray(ours, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if ours.shape != truth.shape or ours.ndim != 2 or ours.shape[1] != 4:
        raise ValueError(f"boxes are (T, 4) and as many as those of the truth, not {ours.shape} and {truth.shape}")
    return ours, truth


def _known(boxes: Array) -> Mask:
    return np.asarray(np.isfinite(boxes).all(axis=1))


def _centres(boxes: Array) -> Array:
    centres: Array = boxes[:, :2] + (boxes[:, 2:] - 1.0) / 2.0
    return centres


def _length(offsets: Array) -> Array:
    length: Array = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return length


def _rows(corners: Array | None, rows: Mask) -> Array | None:
    return None if corners is None else corners[rows]


def _shares(counts: Whole, of: int) -> Array:
    shares: Array = counts / of if of else np.full(len(counts), np.nan)
    return shares


def _mean(values: Array | Mask) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
