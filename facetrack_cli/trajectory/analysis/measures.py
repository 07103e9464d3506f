"""What a face does, as numbers: how far its mouth opens, its smile, its brows, its lids, how its head stands.

Lengths are in distances between the eyes. Where both eyes are seen that is the distance of their centres over `share`,
so that it does not shrink when the head turns; else it is .363 of the width of the face's box. Widths of mouth and eyes
are over `share`, too: it is how long the head's own horizontal is in the image, by its pose; 1 from the front, or where
the pose is not known, and at least .5. Heights are across the line of the eyes, without eyes across that horizontal.
Nothing corrects heights for pitch.

The spread is of first order: derivatives, by central differences, times the covariance of each point in its row. It
takes points as independent and the pose as known. That of an angle is what the points alone make of it: what a person's
proportions add (head_pose.py) is the same in all frames.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.face_points import EYE_DISTANCE, IRISES
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.analysis.head_pose import SHAPE, head_pose, rotation_of, with_eyes
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, joined

LENGTH, DEGREES = "eye distances", "degrees"
EYES, BROWS = ("eye_left", "eye_right"), ("brow_left_middle", "brow_right_middle")
LIPS, INNER = ("lip_upper", "lip_lower"), ("inner_lip_upper", "inner_lip_lower")
CORNERS = ("mouth_left", "mouth_right")
LIDS = tuple(f"{eye}_{place}" for eye in EYES for place in ("upper", "lower", "outer", "inner"))
ENDS = ("eye_left_outer", "eye_left_inner"), ("eye_right_inner", "eye_right_outer")  # of an eye, from the left
GAZE = (*IRISES, *ENDS[0], *ENDS[1])
STEP: Final = 1e-3  # pixels, of the differences


class Face(NamedTuple):
    """Where each part is in T frames, as x + iy (T,), and how large the box, as w + ih; `share` and `lean` (T,) are the
    length and the direction, e^(i angle), of the head's own horizontal in the image.
    """

    at: Mapping[str, Any]
    share: Array
    lean: Any

    @property
    def across(self) -> Any:
        """(T,) from the left eye to the right one as they are apart from the front, as x + iy."""
        box = EYE_DISTANCE * self.at[BOX].real * self.lean if BOX in self.at else np.nan
        if not self.at.keys() >= {*EYES}:
            return box
        apart = (self.at["eye_right"] - self.at["eye_left"]) / self.share
        return np.where(np.isfinite(apart), apart, box)  # an eye may be hidden

    @property
    def gaze(self) -> Any:
        """(T,) the irises in the frames of their eyes, whose corners are at -1/2 and 1/2; mean of both, as x + iy."""
        each = [(self.at[i] - self.at[a]) / (self.at[b] - self.at[a]) for i, (a, b) in zip(IRISES, ENDS, strict=True)]
        return sum(each) / 2 - 0.5

    def apart(self, one: str, other: str) -> Array:
        return np.asarray(np.abs(self.at[one] - self.at[other]))

    def height(self, one: str, other: str, *below: str) -> Array:
        """(T,) how far the middle of two points is above that of two others, in distances between the eyes."""
        apart = sum(self.at[name] for name in below) - self.at[one] - self.at[other]
        return np.asarray((apart / (2j * self.across)).real)


class Measure(NamedTuple):
    """What is measured, and of which parts; `of` is None of an angle of the head's pose."""

    name: str
    unit: str
    formula: str
    needs: tuple[str, ...] = ()
    of: Callable[[Face], Array] | None = None


MEASURES: Final = (
    Measure("mouth_opening", LENGTH, "distance of the outer lips", LIPS, lambda f: f.apart(*LIPS) / abs(f.across)),
    Measure("lips_apart", LENGTH, "distance of the inner lips", INNER, lambda f: f.apart(*INNER) / abs(f.across)),
    Measure("mouth_width", LENGTH, "distance of the corners of the mouth", CORNERS,
            lambda f: f.apart(*CORNERS) / abs(f.across) / f.share),
    Measure("smile", LENGTH, "height of the middle of the corners of the mouth above that of the outer lips",
            CORNERS + LIPS, lambda f: f.height(*CORNERS, *LIPS)),
    Measure("brow_raise", LENGTH, "height of the middles of the brows above the centres of the eyes, mean of both",
            BROWS + EYES, lambda f: f.height(*BROWS, *EYES)),
    Measure("eye_opening", "eye widths", "distance of an eye's lids over its width, mean of both", LIDS,
            lambda f: sum(f.apart(*LIDS[i : i + 2]) / f.apart(*LIDS[i + 2 : i + 4]) for i in (0, 4)) * f.share / 2),
    Measure("gaze_x", "eye widths", "how far the irises are right of the middle of the eyes' corners, mean of both",
            GAZE, lambda f: f.gaze.real),
    Measure("gaze_y", "eye widths", "how far the irises are above the line of the eyes' corners, mean of both",
            GAZE, lambda f: -f.gaze.imag),
    Measure("roll", DEGREES, "roll of the head's pose; where it is not known, the angle of the face's box"),
    Measure("yaw", DEGREES, "yaw of the head's pose"),
    Measure("pitch", DEGREES, "pitch of the head's pose"),
)  # fmt: skip
"""All measures, in the order of columns."""
USED: Final = {BOX, *SHAPE, *(name for one in MEASURES for name in one.needs)}


class Measured(NamedTuple):
    """One measure of one target in T frames; nan where a point that it needs is lost or absent."""

    name: str
    unit: str
    frame: Whole
    time_s: Array
    value: Array
    std: Array


@np.errstate(all="ignore")
def measures_of(parts: Sequence[Trajectory]) -> dict[str, Measured]:
    """The measures of one target by name, in the order of MEASURES: those whose points are among its parts."""
    parts = [part.squared for part in parts]
    pose, parts = head_pose(parts), [part for part in with_eyes(parts) if part.part in USED]
    if len(parts) < 2:
        return {}
    names, time_s = [part.part for part in parts], joined(parts).times
    sized = [replace(p, x=p.w, y=p.h, std_x=p.std_w, std_y=p.std_h) if p.part == BOX else p for p in parts]
    frame, columns = aligned(sized, "status", "x", "y", "angle", "std_x", "std_y", "cov_xy")
    seen = np.isin(columns.pop("status"), SEEN)
    x, y, angle, *spreads = (np.where(seen, values, np.nan).T for values in columns.values())
    spread = dict(zip(names, np.stack(spreads, axis=1), strict=True))  # (3, T) each
    known = {name: np.full((2, len(frame)), np.nan) for name in ("pitch", "yaw", "roll")}  # values and spreads
    if pose is not None:
        std = np.sqrt(np.diagonal(pose.of_points, axis1=1, axis2=2))
        for i, one in enumerate(known.values()):
            one[:, np.searchsorted(frame, pose.frame)] = pose.angles[:, i], std[:, i]
    for name in {*EYES} & {*names}:
        spread[name] = np.nan_to_num(spread[name])  # where they are hidden they are not the unit
    if BOX in names:
        spread[BOX] = np.nan_to_num(spread[BOX])  # of trackers that do not say it
        known["roll"][0] = np.where(np.isfinite(known["roll"][0]), known["roll"][0], angle[names.index(BOX)])
    turned = rotation_of(np.radians(np.nan_to_num([one[0] for one in known.values()])).T)
    axis = turned[:, 0, 0] + 1j * turned[:, 1, 0]
    face = Face(dict(zip(names, x + 1j * y, strict=True)), np.maximum(abs(axis), 0.5), axis / abs(axis))
    found = {}
    for name, unit, _, needs, of in MEASURES:
        needs += () if unit != LENGTH else EYES if face.at.keys() >= {*EYES} else (BOX,)
        if of is not None and face.at.keys() >= {*needs}:
            both = np.stack([of(face), _spread(of, face, {part: spread[part] for part in needs})])
            known[name] = np.where(np.abs(both) < 1e6, both, np.nan)  # the face may have no size
        if name in known and (of or np.isfinite(known[name]).any()):
            found[name] = Measured(name, unit, frame, time_s, *known[name])
    return found


def _spread(of: Callable[[Face], Array], face: Face, spread: Mapping[str, Array]) -> Array:
    """(T,) the standard deviation of a measure, from std_x, std_y and cov_xy of each part that it needs."""
    variance = np.zeros(len(face.lean))
    for name, (std_x, std_y, cov_xy) in spread.items():
        moved = [of(face._replace(at={**face.at, name: face.at[name] + STEP * step})) for step in (1, -1, 1j, -1j)]
        along_x, along_y = (moved[0] - moved[1]) / (2 * STEP), (moved[2] - moved[3]) / (2 * STEP)
        variance += (along_x * std_x) ** 2 + (along_y * std_y) ** 2 + 2 * along_x * along_y * np.nan_to_num(cov_xy)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
