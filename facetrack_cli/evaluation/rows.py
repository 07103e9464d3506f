"""A trajectory beside its ground truth: pairs of parts, the (R,) rows that are measured, lengths that normalise errors.

    pairs = match(read_trajectory(run), read_truth(file), partial=False, select=None)

Parts are paired by names and frames. Ground truth that is empty, shorter, counted from another frame or of another clip
gives an error that says so.

A measure is declared once, with the field of the dataclass that holds its value:

    @dataclass(frozen=True)
    class PointMeasures:
        mean_px: Annotated[Value, Measure("mean\\npx", PX, "less")]

From the declarations follow the names (`points.mean_px`), the columns of tables, and the order of recipes by a measure.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import iou, size_of_points
from facetrack_cli.core.types import BOX, Array, Mask, Whole
from facetrack_cli.trajectory.reader import frame_size_of
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.views import choose

Value: TypeAlias = float | int | None
"""A measured value; None where the measure is not defined, as the precision without any row called lost."""


@dataclass(frozen=True)
class Measure:
    """`title`: the head of its column, in two lines, without one it has none; `write`: a value as text; `better`: None
    where neither is. One that is `rare` has a column only where one of its values is not 0.
    """

    title: str
    write: Callable[[float], str]
    better: Literal["more", "less"] | None = None
    rare: bool = False


COUNT: Final = "{:,.0f}".format
PX: Final = "{:.2f}".format
UNIT: Final = "{:.3f}".format


def PERCENT(value: float) -> str:  # noqa: N802 -- a constant like the others
    """A share of 0 to 1 as a percentage."""
    return f"{100 * value:.1f}"


def mean(values: Array | Mask) -> Value:
    return float(np.mean(values)) if len(values) else None


def median(values: Array) -> Value:
    return float(np.median(values)) if len(values) else None


NOT_SEEN = ("hidden", "absent")
OF_TRUTH = ("visible", *NOT_SEEN)
OF_TRACK = ("init", "tracked", "lost")
NEAR = 1 / 6  # of the normalising length: a point is near if its error is less
RIGHT = 1 / 4  # of the size: a row is right, as calibration has it, if the error of its centre is less
NAMES = ("target", "part")
NEAR_IOU = 0.5  # a box is near if its overlap with the ground truth (intersection over union) is more


@dataclass(frozen=True, eq=False)
class Rows:
    """One part against its ground truth; every array is (R,) but `at`, `offset` and `std`, (R, 2), x before y.

    `cov_xy` is the covariance of the posterior in x and y, 0 where it is not known.

    `at` is our position, `offset` ours minus the ground truth in pixels, nan where either has no position; `unit` the
    length in pixels by which errors are normalised, nan where it is unknown. Each row is one of visible, hidden,
    absent; `placed` are the visible and hidden ones whose true position is known. `near` and `right` are defined where
    `judged`; an absent row is judged, and neither. A box is right by its centre, in sizes of the true one, sqrt(width *
    height). `lost` is defined where `stated`: the status is tracked or lost. `init` are the rows that the tracker was
    given, `later` those of them after the first, by corrections; `left_out` rows that a correction calls absent.
    """

    target: str
    part: str
    frame: Whole
    at: Array
    offset: Array
    unit: Array
    visible: Mask
    hidden: Mask
    absent: Mask
    placed: Mask
    near: Mask
    right: Mask
    judged: Mask
    stated: Mask
    lost: Mask
    init: Mask
    later: Mask
    left_out: Mask
    confidence: Array
    std: Array
    cov_xy: Array

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def error(self) -> Array:
        """(R,) pixels; nan where the true position is not known, infinite where ours alone is missing."""
        error = np.hypot(self.offset[:, 0], self.offset[:, 1])
        return np.where(self.placed, np.where(np.isnan(error), np.inf, error), np.nan)

    def take(self, rows: Mask) -> "Rows":
        """These rows alone."""
        arrays: dict[str, Any] = {key: column[rows] for key, column in vars(self).items() if key not in NAMES}
        return replace(self, **arrays)


def rows_of(pair: "Pair", unit: Array) -> Rows:
    """The rows of a pair, with `unit` (R,) in pixels. A row of ground truth without a status is visible."""
    ours, truth = pair.ours, pair.truth
    hidden, absent = truth.status == "hidden", truth.status == "absent"
    offset = np.stack([ours.x - truth.x, ours.y - truth.y], axis=1)
    error = np.hypot(offset[:, 0], offset[:, 1])
    placed = ~absent & np.isfinite(truth.x) & np.isfinite(truth.y)
    if pair.is_box:  # which is near without a unit too
        near, finite = iou(ours.boxes, truth.boxes) > NEAR_IOU, np.isfinite(truth.boxes).all(axis=1)
        size = np.sqrt(np.maximum(truth.w * truth.h, 0))
    else:
        near, finite, size = error < NEAR * unit, np.isfinite(unit), unit
    first = np.arange(len(ours)) == 0
    init = ours.status == "init" if np.any(ours.status != "") else first
    return Rows(
        target=ours.target,
        part=ours.part,
        frame=ours.frame,
        at=np.stack([ours.x, ours.y], axis=1),
        offset=offset,
        unit=unit,
        visible=~hidden & ~absent,
        hidden=hidden,
        absent=absent,
        placed=placed,
        near=near & placed & finite,
        right=(error < RIGHT * size) & placed & finite,
        judged=(placed & finite) | absent,
        stated=(ours.status == "tracked") | ours.unseen,
        lost=ours.unseen,
        init=init,
        later=init & ~first,
        left_out=(ours.status == "absent") & ~ours.vanished,
        confidence=ours.confidence,
        std=np.stack([ours.std_x, ours.std_y], axis=1),
        cov_xy=np.nan_to_num(ours.cov_xy),
    )


def column(parts: Iterable[Rows | Trajectory], name: str) -> Any:
    """One column of all parts, end to end."""
    return np.concatenate([getattr(part, name) for part in parts])


class Pair(NamedTuple):
    """One part and its ground truth, row by row: `ours.frame` and `truth.frame` are equal."""

    ours: Trajectory
    truth: Trajectory

    @property
    def declared_box(self) -> bool:
        """Whether ours or the truth is declared a box; a window of a point has a size too, and is none."""
        return "box" in (self.ours.part, self.truth.part) or self.truth.corners is not None

    @property
    def is_box(self) -> bool:
        """Whether the pair is measured as boxes: ours or the truth is declared a box, and both have a size in a row."""
        return self.declared_box and all(bool(np.any(np.isfinite(s.w) & np.isfinite(s.h))) for s in self)


def at(frames: Whole, known: Whole, values: Array) -> Array:
    """(R, ...) values (F, ...) of the increasing frames `known` (F,) at `frames` (R,); nan for frames not there."""
    result = np.full((len(frames), *values.shape[1:]), np.nan)
    there = np.isin(frames, known)
    result[there] = values[np.searchsorted(known, frames[there])]
    return result


def normalised_rows(
    pairs: Sequence[Pair], how: str, reference: Sequence[Trajectory]
) -> tuple[tuple[Rows, ...], dict[str, str]]:
    """The rows of each pair, and by target what the length is, as of `lengths_of`."""
    units, rows = dict[str, str](), dict[str, Rows]()
    for target in dict.fromkeys(pair.ours.target for pair in pairs):
        own = [pair for pair in pairs if pair.ours.target == target]
        lengths, units[target] = lengths_of(how, own, reference)
        rows |= {pair.ours.name: rows_of(pair, unit) for pair, unit in zip(own, lengths, strict=True)}
    return tuple(rows[pair.ours.name] for pair in pairs), units


def lengths_of(how: str, own: Sequence[Pair], reference: Sequence[Trajectory]) -> tuple[list[Array], str]:
    """The length in pixels by which the errors of a target are normalised: (R,) for each of its pairs, nan where it is
    not known; and what it is. It is taken from their ground truth, or from the parts in `reference`. `how`:

    size     the largest distance between two points of the target, in the first frame with all of them: the unit of
             recipes. Of a box sqrt(width * height), in each frame. The default.
    A:B      the distance between two parts, in each frame
    NUMBER   so many pixels

    Raises UsageError where the ground truth lacks a part.
    """
    truth = {pair.truth.part: pair.truth for pair in own}
    # the size is that of the tracked parts; other parts of the ground truth serve where a length needs them
    if len(truth) == 1 or how != "size":
        # a target may have another name in the ground truth than in the trajectory
        named = [part for part in reference if part.target == own[0].truth.target]
        alone = reference if len({part.target for part in reference}) == 1 else []
        truth = {**{part.part: part for part in named or alone}, **truth}
    frames = np.unique(column((pair.ours for pair in own), "frame"))
    box = own[0].truth
    if how == "size" and own[0].declared_box and np.any(box.w > 0):
        length, what = at(frames, box.frame, np.sqrt(np.maximum(box.w * box.h, 0))), "size, sqrt(width * height)"
    elif ":" in how:
        if missing := [part for part in how.split(":") if part not in truth]:
            names = ", ".join(list(truth)[:8]) + (", ..." if len(truth) > 8 else "")
            raise UsageError(f"--normalise {how}: the ground truth has no {' and '.join(missing)}; it has {names}")
        ends = (truth[part] for part in how.split(":"))
        a, b = (np.stack([at(frames, part.frame, part.x), at(frames, part.frame, part.y)]) for part in ends)
        length, what = np.hypot(*(a - b)), how.replace(":", " to ")
    else:
        size, what = _size([*truth.values()], frames) if how == "size" else (float(how), f"{float(how):g} px")
        return [np.full(len(pair.ours), size) for pair in own], what
    length = np.where(length > 0, length, np.nan)
    finite = length[np.isfinite(length)]
    typical = f"median {np.median(finite):.1f} px" if len(finite) else "not known in any"
    return [at(pair.ours.frame, frames, length) for pair in own], f"{what} in each frame, {typical}"


def _size(truth: Sequence[Trajectory], frames: Whole) -> tuple[float, str]:
    """The unit of recipes and what it is; nan if there is none."""
    centres = [np.where(part.status == "absent", np.nan, [part.x, part.y]).T for part in truth]
    points = np.stack([at(frames, part.frame, each) for part, each in zip(truth, centres, strict=True)])  # (K, F, 2)
    together = np.flatnonzero(np.isfinite(points).all(axis=(0, 2)))
    size = size_of_points(points[:, together[0]]) if together.size else 0
    if not size:
        return math.nan, "size: no frame of the ground truth has all points, two or more, apart from each other"
    return size, f"size, the largest distance between two points in frame {frames[together[0]]}, {size:.1f} px"


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
    for _, part in named:
        for row in np.flatnonzero(~np.isin(part.status, ("", *OF_TRUTH, *OF_TRACK)))[:1]:
            what = f"status {str(part.status[row])!r} is none of {', '.join(OF_TRUTH)}"
            raise InputError(f"{truth.path}: frame {part.frame[row]}, {part.name}: {what}; correct it")
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
    if truth.targets == ("",):  # boxes without names are those of the only part that has a size
        boxed = [part for part in ours.parts if np.any(np.isfinite(part.w) & np.isfinite(part.h))]
        if len(boxed) != 1:
            what = f"its boxes have no names, and {ours.path} has {_names(boxed) or 'no part with w and h'}"
            remedy = "choose one with --target NAME/PART, or give ground truth of its points"
            raise InputError(f"{truth.path}: {what}; {remedy}")
        if boxed[0].part != BOX:
            note(f"{truth.path}: its boxes are taken for {boxed[0].name}, the only part with a size")
        return [Pair(boxed[0], truth.parts[0])]
    theirs, common = truth.parts, {part for _, part in ours.names} & {part for _, part in truth.names}
    if common and len(ours.targets) == len(truth.targets) == 1 and ours.target != truth.target:
        theirs = tuple(part.renamed(ours.target, part.part) for part in theirs)
        if ours.target:
            note(f"{truth.target} of the ground truth is taken for {ours.target}: both have one target")
    named = {part.name: part for part in theirs}
    pairs = [Pair(part, named[part.name]) for part in ours.parts if part.name in named]
    if not pairs:
        both = f"no part in common with {ours.path}; it has {_names(theirs)}, the trajectory {_names(ours.parts)}"
        remedy = "name targets and parts alike, or let --people of eval find which target is whom"
        raise InputError(f"{truth.path}: {both}: {remedy}; points are not measured by boxes, nor boxes by points")
    paired = {pair.ours.name for pair in pairs}
    if select is None and (alone := [part for part in theirs if part.name not in paired]):
        note(f"{truth.path}: {_names(alone)} {'are' if len(alone) > 1 else 'is'} not in the trajectory, and left out")
    if unknown := [part for part in ours.parts if part.name not in paired]:
        note(f"{truth.path}: says nothing of {_names(unknown)}")
    return pairs


def _names(parts: Sequence[Trajectory]) -> str:
    names = [part.name if part.target else f"{part.part} without a name" for part in parts]
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _check_frames(trajectory: Trajectory, truth: Trajectory, named: Sequence[Pair], partial: bool) -> None:
    ours, theirs = (np.unique(column(parts, "frame")) for parts in zip(*named, strict=True))
    both = len(np.intersect1d(ours, theirs))
    first, last = int(theirs[0] - ours[0]), int(theirs[-1] - ours[-1])
    stride = int(np.median(np.diff(theirs))) if len(theirs) > 1 else 1
    rest = f"--partial measures the {both} that both have" if both else "name its own"
    if not both or not (partial or (0 <= first < stride and -stride < last <= 0)):
        spans = f"the ground truth has frames {_span(theirs)}, the trajectory {_span(ours)}"
        shift = "if it is moved, --shift N"
        if first == last != 0:  # the file may have been moved already
            shift = f"shifted by {abs(first)}? --shift {int(truth.header.get('shift', 0)) - first}"
        raise InputError(f"{truth.path}: {spans}: {shift}; if not, {rest}")
    for part, true in () if partial else named:
        if (missing := np.setdiff1d(true.frame, part.frame)).size:
            place = f"frame {missing[0]}" + (f" and {len(missing) - 1} more" if len(missing) > 1 else "")
            what = f"no row of {part.name} in {place}, where ground truth does"
            raise InputError(f"{trajectory.path}: {what}; was it cut? {rest}")


def _span(frames: Whole) -> str:
    return f"{frames[0]}..{frames[-1]}" if len(frames) > 1 else f"{frames[0]} alone"


def _check_places(trajectory: Trajectory, truth: Trajectory, named: Sequence[Pair]) -> None:
    """Visible ground truth lies in the frame; where most of it does not, it is of another clip or size."""
    size = frame_size_of(trajectory)
    if size is None:
        return
    x, y, status = (column((pair.truth for pair in named), name) for name in ("x", "y", "status"))
    outside = (x < -0.5) | (y < -0.5) | (x > size[0] - 0.5) | (y > size[1] - 0.5)
    where = outside[np.isfinite(x) & ~np.isin(status, NOT_SEEN)]
    if where.size and where.mean() > 0.5:
        image = f"the image of {size[0]}x{size[1]} pixels that {trajectory.path} was made from"
        what = f"{where.sum()} of its {where.size} places are outside of {image}"
        raise InputError(f"{truth.path}: {what}; it is of another clip or size: name the right one")
