"""Who is who: targets of a trajectory against people of the ground truth, whatever their names.

Similarities are from 0 to 1: of boxes their overlap; of points 1 - 3 e, where e is the mean error in units of the
largest distance between two true points of that frame, so that 0.5 is where a point is near. Measures are those of
TrackEval: HOTA (Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking", IJCV 2021), IDF1
(Ristani et al., "Performance Measures and a Data Set for Multi-Target, Multi-Camera Tracking", 2016), and the switches
and fragments of CLEAR MOT (Bernardin & Stiefelhagen, 2008).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import BOX, Array, Mask, Whole
from facetrack_cli.evaluation.rows import COUNT, NEAR, PERCENT, Measure, Value
from facetrack_cli.trajectory.trajectory import Trajectory

SAME: Final = 0.5  # similarity from which a target is on a person
ALPHAS: Final = np.arange(0.05, 0.99, 0.05)  # thresholds that HOTA is a mean over
_EPS: Final = float(np.finfo(float).eps)


@dataclass(frozen=True)
class PeopleMeasures:
    """Identities over the whole clip; shares are 0 to 1.

    people, targets  people of the ground truth that are visible, and targets that are not lost
    recall           of the visible people in a frame, those that a target is on; `precision`: of the targets, those on
                     a person
    idf1             F1 of the rows of the best assignment of targets to people; `idr`, `idp`: its recall, its precision
    hota             HOTA; `deta`, `assa`: its accuracy of detection and of association
    switches         how often a person is followed by another target than before
    fragments        how often a person is followed again after a gap
    """

    people: Annotated[int, Measure("people\n", COUNT)]
    targets: Annotated[int, Measure("targets\n", COUNT)]
    recall: Annotated[Value, Measure("recall\n%", PERCENT, "more")]
    precision: Annotated[Value, Measure("precision\n%", PERCENT, "more")]
    idf1: Annotated[Value, Measure("IDF1\n%", PERCENT, "more")]
    idr: Annotated[Value, Measure("IDR\n%", PERCENT, "more")]
    idp: Annotated[Value, Measure("IDP\n%", PERCENT, "more")]
    hota: Annotated[Value, Measure("HOTA\n%", PERCENT, "more")]
    deta: Annotated[Value, Measure("DetA\n%", PERCENT, "more")]
    assa: Annotated[Value, Measure("AssA\n%", PERCENT, "more")]
    switches: Annotated[int, Measure("switches\n", COUNT, "less")]
    fragments: Annotated[int, Measure("fragments\n", COUNT, "less")]


class Seen(NamedTuple):
    """Of a frame: the numbers of the people (P,) and targets (Q,) in it, and their similarities (P, Q)."""

    people: Whole
    targets: Whole
    similar: Array


def identified(ours: Trajectory, truth: Trajectory) -> tuple[Trajectory, PeopleMeasures, list[str]]:
    """The trajectory, whose targets have the names of the people that they are; the measures; lines on these names.

    Raises InputError where the tables have neither boxes nor two points in common.
    """
    frames = seen_in(ours, truth)
    together = np.zeros((len(truth.targets), len(ours.targets)))
    for frame in frames:
        together[np.ix_(frame.people, frame.targets)] += frame.similar >= SAME
    names = {ours.targets[j]: truth.targets[i] for i, j in assigned(together)}
    notes = [f"{name} is {theirs} of the ground truth" for name, theirs in names.items()]
    free = {name: f"{name} (nobody)" if name in names.values() else name for name in ours.targets}
    renamed = replace(ours, names=tuple(({**free, **names}[target], part) for target, part in ours.names))
    return renamed, measure_people(frames), notes


def seen_in(ours: Trajectory, truth: Trajectory) -> list[Seen]:
    """The frames of the ground truth; where it has most frames, those without a person as well.

    Targets on a person whom the ground truth calls hidden do not count.
    """
    both = {rows.part for rows in ours.parts if np.isfinite(rows.x).any()} & {rows.part for rows in truth.parts}
    parts = [BOX] if BOX in both else sorted(both)
    if parts != [BOX] and len(parts) < 2:
        what = f"has neither boxes nor two points in common with {ours.path}"
        raise InputError(f"{truth.path}: {what}; people are told by these")
    frames = truth.frames
    if len(frames) > 1 and np.median(np.diff(frames)) == 1:
        frames = np.arange(frames[0], frames[-1] + 1)
    mine, _ = _places(ours, parts, frames)
    true, hidden = _places(truth, parts, frames)
    seen = []
    for t in range(len(frames)):
        people, targets = (np.flatnonzero(np.isfinite(places[t]).any(axis=(1, 2))) for places in (true, mine))
        similar = _similarity(true[t, people], mine[t, targets], boxes=parts == [BOX])
        shown = ~hidden[t, people]
        counted = (similar[shown] >= SAME).any(axis=0) | ~(similar[~shown] >= SAME).any(axis=0)
        seen.append(Seen(people[shown], targets[counted], similar[np.ix_(shown, counted)]))
    return seen


def _places(table: Trajectory, parts: Sequence[str], frames: Whole) -> tuple[Array, Mask]:
    """The parts of each target (T, N, K, 2 or 4), nan where they are not seen; targets (T, N) that are hidden."""
    columns = 4 if parts == [BOX] else 2
    places = np.full((len(frames), len(table.targets), len(parts), columns), np.nan)
    hidden = np.zeros(places.shape[:2], np.bool_)
    for n, target in enumerate(table.targets):
        for k, part in enumerate(parts):
            if (rows := table.find(target, part)) is not None:
                rows = rows.take(np.isin(rows.frame, frames) & ~np.isin(rows.status, ("lost", "absent")))
                at = np.searchsorted(frames, rows.frame)
                places[at, n, k] = rows.boxes if columns == 4 else np.stack([rows.x, rows.y], axis=1)
                hidden[at, n] |= rows.status == "hidden"
    return places, hidden


def _similarity(true: Array, mine: Array, *, boxes: bool) -> Array:
    """(P, Q) of places (P, K, C) and (Q, K, C)."""
    shape = len(true), len(mine)
    if not all(shape):
        return np.zeros(shape)
    if boxes:
        a, b = (np.broadcast_to(x, (*shape, 4)).reshape(-1, 4) for x in (true, mine[None, :, 0]))
        return np.nan_to_num(iou(a, b)).reshape(shape)
    apart = np.hypot(*np.moveaxis(true[:, :, None] - true[:, None], -1, 0))
    unit = np.nanmax(np.where(np.isfinite(apart), apart, 0), axis=(1, 2))
    off = np.hypot(*np.moveaxis(true[:, None] - mine, -1, 0))
    finite = np.isfinite(off)
    error = np.where(finite, off, 0).sum(axis=2) / np.maximum(finite.sum(axis=2), 1)
    able = finite.any(axis=2) & (unit[:, None] > 0)
    return np.where(able, np.clip(1 - error * SAME / (NEAR * np.maximum(unit, 1e-9)[:, None]), 0, 1), 0.0)


def measure_people(frames: Sequence[Seen]) -> PeopleMeasures:
    """The measures, as TrackEval has them."""
    numbers = [frame.people for frame in frames], [frame.targets for frame in frames]
    counts = [1 + max((int(each.max()) for each in column if each.size), default=-1) for column in numbers]
    there, named = (np.zeros(n) for n in counts)
    close, together = np.zeros(counts), np.zeros(counts)
    for people, targets, similar in frames:
        there[people] += 1
        named[targets] += 1
        at = np.ix_(people, targets)
        rest = similar.sum(axis=0) + similar.sum(axis=1, keepdims=True) - similar
        close[at] += np.where(rest > _EPS, similar / np.maximum(rest, _EPS), 0)
        together[at] += similar >= SAME
    least = there[:, None] + named
    close = close / np.maximum(least - close, 1)
    same = sum(together[i, j] for i, j in assigned(together))
    hits = np.zeros((len(ALPHAS), *counts))
    on = switches = 0
    last, now = (np.full(counts[0], -1) for _ in range(2))
    begun = np.zeros(counts[0])
    for people, targets, similar in frames:
        at = np.ix_(people, targets)
        for i, j in assigned(close[at] * similar):
            hits[:, people[i], targets[j]] += similar[i, j] >= ALPHAS - _EPS
        if not similar.size:
            continue
        goes_on = targets == now[people][:, None]
        pairs = assigned(np.where(similar >= SAME - _EPS, 1000.0 * goes_on + similar, 0))
        before, now = now, np.full(counts[0], -1)
        for i, j in pairs:
            who, target = people[i], targets[j]
            switches += last[who] not in (-1, target)
            last[who] = now[who] = target
        begun += (before < 0) & (now >= 0)
        on += len(pairs)
    tp = hits.sum(axis=(1, 2))
    deta = tp / np.maximum(there.sum() + named.sum() - tp, 1)
    assa = (hits * hits / np.maximum(least - hits, 1)).sum(axis=(1, 2)) / np.maximum(tp, 1)
    true, mine = float(there.sum()), float(named.sum())
    return PeopleMeasures(
        people=int((there > 0).sum()), targets=int((named > 0).sum()), recall=_share(on, true),
        precision=_share(on, mine), idf1=_share(2 * same, true + mine), idr=_share(same, true), idp=_share(same, mine),
        hota=float(np.sqrt(deta * assa).mean()), deta=float(deta.mean()), assa=float(assa.mean()),
        switches=int(switches), fragments=int(np.maximum(begun - 1, 0).sum()),
    )  # fmt: skip


def _share(part: float, whole: float) -> Value:
    return float(part) / whole if whole else None


def assigned(score: Array) -> list[tuple[int, int]]:
    """The assignment of rows to columns whose sum of scores (P, Q), not below 0, is largest; pairs of 0 are left out.

    By shortest augmenting paths (Jonker & Volgenant, 1987).
    """
    if score.size and max((score > 0).sum(axis=0).max(), (score > 0).sum(axis=1).max()) <= 1:  # nothing to choose
        return [(int(i), int(j)) for i, j in np.argwhere(score > 0)]
    if score.shape[0] > score.shape[1]:
        return sorted((i, j) for j, i in assigned(score.T))
    rows, columns = score.shape
    u, v, owner = np.zeros(rows), np.zeros(columns + 1), np.full(columns + 1, -1)
    for row in range(rows):
        owner[columns], at = row, columns  # the path begins in a column of its own
        shortest, via, done = np.full(columns, np.inf), np.full(columns, columns), np.zeros(columns + 1, np.bool_)
        while owner[at] >= 0:
            done[at] = True
            reach = -score[owner[at]] - u[owner[at]] - v[:-1]
            nearer = ~done[:-1] & (reach < shortest)
            shortest[nearer], via[nearer] = reach[nearer], at
            at = int(np.argmin(np.where(done[:-1], np.inf, shortest)))
            step = shortest[at]
            u[owner[done]] += step
            v[done] -= step
            shortest -= step
        while at != columns:
            owner[at], at = owner[via[at]], int(via[at])
    return sorted((i, j) for j, i in enumerate(owner[:-1].tolist()) if i >= 0 and score[i, j] > 0)
