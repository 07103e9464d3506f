"""Which rows of a trajectory are measured against which rows of the ground truth: by names and by frames.

    pairs = match(read_trajectory(run), read_truth(file), partial=False, select=None)

Ground truth that is empty, shorter, counted from another frame or of another clip gives an error that says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX, Whole
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.trajectory.header import frame_size_of
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory

NOT_SEEN = ("hidden", "absent")
OF_TRUTH = ("visible", *NOT_SEEN)
OF_TRACK = ("init", "tracked", "lost")


def match(
    trajectory: Trajectory,
    truth: Trajectory,
    *,
    partial: bool,
    select: str | None,
    note: Callable[[str], None] = lambda _: None,
) -> list[Pair]:
    """Pair the parts that both tables have, on the frames that both have, in the order of the trajectory.

    `select` (`face` or `face/nose`) takes a target or part of the trajectory alone. Truth without names goes to the
    only part there with a size; ground truth of one target, to the one target there, whatever its name. `note` is given
    lines about pairs under other names, and about what has no counterpart. Without `partial` both must begin and end
    together, as far as the ground truth is dense enough to tell, and no frame of the ground truth may be missing.

    Raises InputError for tables that do not belong together, with the remedy: no name or frame in common, a status that
    ground truth cannot have, frames that one lacks, truth outside of the frame; UsageError if `select` names none.
    """
    named = _pair_names(choose(trajectory, select), truth, select, note)
    _check_status(trajectory, truth, named)
    _check_frames(trajectory, truth, named, partial)
    _check_places(trajectory, truth, named)
    pairs = []
    for ours, theirs in named:
        _, mine, true = np.intersect1d(ours.frame, theirs.frame, assume_unique=True, return_indices=True)
        if mine.size:
            pairs.append(Pair(ours.take(mine), theirs.take(true)))
        else:
            note(f"{ours.name}: no frame in common, and left out")
    return pairs


def _pair_names(ours: Trajectory, truth: Trajectory, select: str | None, note: Callable[[str], None]) -> list[Pair]:
    theirs = truth.parts
    if truth.targets == ("",):
        return [_nameless(ours, truth, note)]
    found = [Pair(one, other) for one in ours.parts if (other := truth.find(one.target, one.part))]
    if not found and len(ours.targets) == len(truth.targets) == 1:
        renamed = {one.part: one.renamed(ours.target, one.part) for one in theirs}
        found = [Pair(one, renamed[one.part]) for one in ours.parts if one.part in renamed]
        if found and ours.target:
            note(f"{truth.target} of the ground truth is taken for {ours.target}: both have one target")
            theirs = tuple(renamed.values())
    if not found:
        raise InputError(
            f"{truth.path}: no part in common with {ours.path}; it has {_names(theirs)}, the trajectory "
            f"{_names(ours.parts)}: {_remedy(theirs, ours.parts)}"
        )
    paired = {one.ours.name for one in found}
    alone = [one for one in theirs if one.name not in paired]
    if alone and select is None:
        note(f"{truth.path}: {_names(alone)} {'are' if len(alone) > 1 else 'is'} not in the trajectory, and left out")
    unknown = [one for one in ours.parts if one.name not in paired]
    if unknown:
        note(f"{truth.path}: says nothing of {_names(unknown)}")
    return found


def _remedy(theirs: Sequence[Trajectory], ours: Sequence[Trajectory]) -> str:
    """How two tables come to have parts in common."""
    true, tracked = ({one.part == BOX for one in those} for those in (theirs, ours))
    if (true, tracked) == ({False}, {True}):
        return "boxes are not measured by points; give ground truth of boxes, or track with a recipe of points"
    if (true, tracked) == ({True}, {False}):
        remedy = "give ground truth of points, or track by a recipe of regions, as contour_histogram"
        return f"points are not measured by boxes; {remedy}"
    if {one.part for one in theirs} & {one.part for one in ours}:
        return "name targets alike, or let --people find which target is whom"
    return "name targets and parts alike"


def _nameless(ours: Trajectory, truth: Trajectory, note: Callable[[str], None]) -> Pair:
    """The boxes of ground truth without names, paired with the only part that has a size."""
    boxed = [one for one in ours.parts if np.any(np.isfinite(one.w) & np.isfinite(one.h))]
    if not boxed:
        raise InputError(
            f"{truth.path}: holds boxes, no part of {ours.path} has w and h; give ground truth of its points"
        )
    if len(boxed) > 1 and len({one.target for one in boxed}) == 1:
        raise InputError(
            f"{truth.path}: holds boxes, and {ours.path} points, {_names(boxed)}; give ground truth of these points "
            "(--target NAME/PART would measure the window around one of them)"
        )
    if len(boxed) > 1:
        raise InputError(
            f"{truth.path}: its boxes have no names, and {ours.path} has {_names(boxed)}; "
            "choose the one that they belong to with --target NAME/PART"
        )
    if boxed[0].part != BOX:
        note(f"{truth.path}: its boxes are taken for {boxed[0].name}, the only part with a size")
    return Pair(boxed[0], truth.parts[0])


def _names(those: Sequence[Trajectory]) -> str:
    names = [one.name if one.target else f"{one.part} without a name" for one in those]
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _check_status(trajectory: Trajectory, truth: Trajectory, named: Sequence[Pair]) -> None:
    for one in (pair.truth for pair in named):
        strange = np.flatnonzero(~np.isin(one.status, ("", *OF_TRUTH, *OF_TRACK)))
        if strange.size:
            row = int(strange[0])
            raise InputError(
                f"{truth.path}: frame {one.frame[row]}, {one.name}: status {str(one.status[row])!r} is none of "
                f"{', '.join(OF_TRUTH)}; correct it"
            )
    ours, theirs = (np.unique(np.concatenate([one.status for one in those])) for those in zip(*named, strict=True))
    # absent rows of ours are those of corrections, unless nothing was tracked
    if np.isin(theirs, OF_TRACK).any() and np.isin(ours, OF_TRUTH).any() and not np.isin(ours, OF_TRACK).any():
        raise InputError(
            f"{truth.path}: is a trajectory, and {trajectory.path} is ground truth, as their status says: "
            "name them the other way round"
        )
    if set(theirs.tolist()) <= {"lost"}:
        raise InputError(f"{truth.path}: calls every row lost, so nothing can be measured; name a ground truth file")


def _check_frames(trajectory: Trajectory, truth: Trajectory, named: Sequence[Pair], partial: bool) -> None:
    ours, theirs = (np.unique(np.concatenate([one.frame for one in those])) for those in zip(*named, strict=True))
    both = len(np.intersect1d(ours, theirs))
    first, last = int(theirs[0] - ours[0]), int(theirs[-1] - ours[-1])
    spans = f"the ground truth has frames {_span(theirs)}, the trajectory {_span(ours)}"
    moved = f"--shift {_shift(truth, -first)}" if first == last != 0 else ""
    if not both:
        remedy = (
            f"if it counts from another frame, {moved}" if moved else "move ground truth by --shift N, or name its own"
        )
        raise InputError(f"{truth.path}: {spans}: no frame in common; {remedy}")
    if partial:
        return
    rest = f"--partial measures the {both} that both have"
    stride = int(np.median(np.diff(theirs))) if len(theirs) > 1 else 1
    if moved and abs(first) >= (stride if first > 0 else 1):
        by = "one" if abs(first) == 1 else str(abs(first))
        raise InputError(f"{truth.path}: {spans}: shifted by {by}? {moved}; if not, {rest}")
    if not 0 <= first < stride or not -stride < last <= 0:
        uneven = f"begins at frame {theirs[0]}, the trajectory at {ours[0]}"
        if 0 <= first < stride:
            uneven = f"ends at frame {theirs[-1]}, the trajectory {'goes on to' if last < 0 else 'ends at'} {ours[-1]}"
        raise InputError(f"{truth.path}: {uneven}: {rest}, --shift N moves the truth")
    for one in named:
        missing = np.setdiff1d(one.truth.frame, one.ours.frame)
        if missing.size:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise InputError(
                f"{trajectory.path}: no row of {one.ours.name} in frame {missing[0]}{more}, where ground truth does; "
                f"was it cut? {rest}"
            )


def _shift(truth: Trajectory, more: int) -> int:
    """The --shift that moves the ground truth by `more` frames than it was moved already."""
    return int(truth.header.get("shift", 0)) + more


def _span(frames: Whole) -> str:
    return f"{frames[0]}..{frames[-1]}" if len(frames) > 1 else f"{frames[0]} alone"


def _check_places(trajectory: Trajectory, truth: Trajectory, named: Sequence[Pair]) -> None:
    """Visible ground truth lies in the frame; where most of it does not, it is of another clip or size."""
    size = frame_size_of(trajectory)
    if size is None:
        return
    x, y, status = (np.concatenate([getattr(one.truth, name) for one in named]) for name in ("x", "y", "status"))
    outside = (x < -0.5) | (y < -0.5) | (x > size[0] - 0.5) | (y > size[1] - 0.5)
    where = outside[np.isfinite(x) & ~np.isin(status, NOT_SEEN)]
    if where.size and where.mean() > 0.5:
        raise InputError(
            f"{truth.path}: {where.sum()} of its {where.size} places are outside of the image of {size[0]}x{size[1]} "
            f"pixels that {trajectory.path} was made from; it is of another clip or size: name the right one"
        )
