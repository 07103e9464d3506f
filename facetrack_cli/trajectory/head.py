"""A head's pose, and its motion as spans of frames.

Roll, yaw and pitch are fitted to points of the face, with their spread: a generic shape under weak perspective.

A point i of the face is seen at y_i = s P R X_i + t: X_i are its coordinates in a generic face (mm), R is the head's
rotation, P drops the depth, s is the scale (pixels per mm) and t a place in the image. R, s and t are those of least
squares, sum_i r_i' S_i^-1 r_i, by Gauss-Newton, where S_i is the covariance of the point as the tracker reports it
and, times s^2, that of X_i over people and expressions. Axes are the camera's, as in OpenFace: x to the right, y down,
z away from the camera; R = R_x(pitch) R_y(yaw) R_z(roll). So a positive pitch looks down, a positive yaw looks to the
left of the image, a positive roll tilts clockwise in the image.

The same points with depth mirrored (yaw and pitch of the other sign) fit nearly as well where the points are nearly in
a plane. Both are tried; the better one is taken, and `ambiguous` marks frames in which the other is hardly worse.

The shape is the factorization (Tomasi & Kanade, "Shape and Motion from Image Streams under Orthography", IJCV 1992)
of the mean landmarks of 751 faces in each of the five cameras of the MUCT database (Milborrow, Morkel & Nicolls 2010),
made symmetric, with 63 mm between the eyes. `SPREAD` are standard deviations of its people about it, neutral or
smiling, measured on half of them; mouths that speak open wider.

Motion is told in the image plane (docs/export.md, ELAN), by three signals of a target's parts that are not lost: its
place (the median of its points), its angle and the logarithm of its size (medians over the pairs of points); of a box
its centre, its angle if known, and the root of its area. A part that gets lost or is found again makes no step in them.
A span begins where a rate (`RATES`) is exceeded and lasts while a lower one is. Where a track is so noisy that noise
alone would pass a threshold, the threshold is raised to 4 standard deviations of the noise, which is measured on second
differences. Nods and shakes are told by the pose (measures.py).
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.trajectory.trajectory import SEEN, UNSEEN, Trajectory, aligned, joined, one_part

# place and standard deviation in mm: x to the right of the image, y down, z away from the camera; the origin is midway
# between the eyes
_GENERIC: Final = {
    "eye_left": ((-31.5, 0.0, 0.0), (1.8, 1.6, 2.4)),
    "eye_right": ((31.5, 0.0, 0.0), (1.8, 1.6, 2.4)),
    "nose": ((0.0, 33.5, -33.5), (1.2, 2.2, 4.2)),
    "mouth_left": ((-26.5, 66.0, 0.0), (2.9, 2.6, 3.6)),
    "mouth_right": ((26.5, 66.0, 0.0), (2.9, 2.6, 3.6)),
    "lip_upper": ((0.0, 58.5, -21.0), (0.5, 2.3, 2.2)),
    "lip_lower": ((0.0, 80.0, -14.5), (0.6, 3.5, 2.1)),
}
SHAPE, SPREAD = ({name: both[i] for name, both in _GENERIC.items()} for i in (0, 1))
MIN_POINTS: Final = 4  # points; three have two poses that fit exactly
FLAT: Final = 0.1  # least depth of the points that are seen, as a share of their extent
STEPS: Final = 30
HARDLY: Final = 2.0  # difference in cost below which the mirrored pose is as good: a factor of e in likelihood
MAX_SPREAD_DEG: Final = 60.0  # degrees: of a pose with a larger spread nothing is said
PIXEL: Final = 0.5  # standard deviation of a point that has none, and the least of any


class HeadPose(NamedTuple):
    """The pose in each of T frames; nan, and False, where too few points are seen, or they tell nothing.

    `angles` (T, 3): pitch, yaw, roll in degrees; `cov` (T, 3, 3) their covariance in square degrees; `scale` (T,)
    pixels per mm; `origin` (T, 2) where the middle between the eyes is, in pixels; `ambiguous` (T,); `of_points`
    (T, 3, 3) what of the covariance the tracker's points make, without that of people. Pixels are square, as the
    picture is shown.
    """

    frame: Whole
    angles: Array
    cov: Array
    scale: Array
    origin: Array
    ambiguous: Mask
    of_points: Array

    @property
    def std(self) -> Array:
        """(T, 3) standard deviations of pitch, yaw and roll, in degrees."""
        return np.sqrt(np.diagonal(self.cov, axis1=1, axis2=2))


def head_pose(parts: Sequence[Trajectory]) -> HeadPose | None:
    """The pose of one target from its parts that are called as in SHAPE; None if those are too few in any case.

    The spread holds also that of the person's own proportions, which is the same in all frames.
    """
    points = [part for part in with_eyes([part.squared for part in parts]) if part.part in SHAPE]
    if not _deep(_of(SHAPE, points), np.ones((1, len(points)), bool))[0]:
        return None
    frame, columns = aligned(points, "x", "y", "std_x", "std_y", "cov_xy", "status")
    xy = np.stack([columns["x"], columns["y"]], axis=2)
    seen = np.isfinite(xy).all(axis=2) & np.isin(columns["status"], SEEN)
    cov = np.zeros((*xy.shape, 2))
    for i, name in enumerate(("std_x", "std_y")):
        cov[..., i, i] = np.fmax(columns[name], PIXEL) ** 2
    cov[..., 0, 1] = cov[..., 1, 0] = np.nan_to_num(columns["cov_xy"])
    return HeadPose(frame, *fit_pose(xy, cov, seen, _of(SHAPE, points), _of(SPREAD, points)))


def with_eyes(parts: Sequence[Trajectory]) -> list[Trajectory]:
    """The parts, and the centre of each eye whose corners are among them: `eye_left`, `eye_right`."""
    by_name = {part.part: part for part in parts}
    for eye in ("eye_left", "eye_right"):
        if eye not in by_name and {f"{eye}_outer", f"{eye}_inner"} <= by_name.keys():
            corners = [by_name[f"{eye}_{end}"] for end in ("outer", "inner")]
            frame, columns = aligned(corners, "x", "y", "std_x", "std_y", "cov_xy", "status")
            seen = np.isin(columns.pop("status"), SEEN).all(axis=1)
            half = {name: np.hypot(*v.T) / 2 if "std" in name else v.mean(axis=1) for name, v in columns.items()}
            half |= {"cov_xy": half["cov_xy"] / 2, "status": np.where(seen, "tracked", "lost")}
            by_name[eye] = one_part(corners[0].target, eye, frame, **half)
    return list(by_name.values())


def fit_pose(xy: Array, cov: Array, seen: Mask, shape: Array, spread: Array) -> tuple[Any, ...]:
    """All of HeadPose but the frames, for points xy (T, K, 2) with cov (T, K, 2, 2).

    `seen` (T, K) are the points to use; `shape` (K, 3) is the face and `spread` (K, 3) its standard deviations, in mm.
    """
    frames = len(xy)
    angles, scale, origin = np.full((frames, 3), np.nan), np.full(frames, np.nan), np.full((frames, 2), np.nan)
    covariance, ambiguous = np.full((frames, 2, 3, 3), np.nan), np.zeros(frames, bool)
    rows = np.flatnonzero(_deep(shape, seen))
    if rows.size:
        points = np.where(seen[rows, :, None], xy[rows], 0.0), cov[rows], seen[rows], shape, spread
        # begun at the rotation nearest to the affine map of least squares, and at that with the depth reversed
        weight = seen[rows, :, None].astype(np.float64)
        count = weight.sum(axis=1)
        centred = weight * (shape - (weight * shape).sum(axis=1, keepdims=True) / count[:, None])
        moved = weight * (points[0] - (weight * points[0]).sum(axis=1, keepdims=True) / count[:, None])
        affine = moved.swapaxes(1, 2) @ np.linalg.pinv(centred.swapaxes(1, 2))
        u, scales, v = np.linalg.svd(affine, full_matrices=False)
        both = [(u @ v) * (1, 1, sign) for sign in (1, -1)]  # the first two rows of a rotation
        begins = [euler(np.concatenate([two, np.cross(two[:, :1], two[:, 1:])], axis=1)) for two in both]
        size = np.maximum(scales.mean(axis=1), 1e-3)
        first, other = (_refined(begin, size, *points) for begin in begins)
        better = other.cost < first.cost
        chosen = better.astype(int), np.arange(len(rows))
        best = _Fit(*(np.stack(both)[chosen] for both in zip(first, other, strict=True)))
        cosine = (np.einsum("tij,tij->t", rotation_of(first.angles), rotation_of(other.angles)) - 1) / 2
        turned = np.arccos(np.clip(cosine, -1, 1))
        ambiguous[rows] = (np.abs(first.cost - other.cost) < HARDLY) & (turned > np.radians(5))
        spreads = np.degrees(np.degrees(best.cov[..., :3, :3]))
        clear = np.diagonal(spreads[:, 0], axis1=1, axis2=2).max(axis=1) < MAX_SPREAD_DEG**2
        ambiguous[rows] &= clear
        rows, best = rows[clear], _Fit(*(values[clear] for values in best))
        angles[rows], covariance[rows] = np.degrees(euler(rotation_of(best.angles))), spreads[clear]
        scale[rows], origin[rows] = best.scale, best.origin
    return angles, covariance[:, 0], scale, origin, ambiguous, covariance[:, 1]


def rotation_of(angles: Array) -> Array:
    """(..., 3, 3) R_x(pitch) R_y(yaw) R_z(roll), from angles (..., 3) in radians in this order."""
    (s1, s2, s3), (c1, c2, c3) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    rows = [
        [c2 * c3, -c2 * s3, s2],
        [c1 * s3 + c3 * s1 * s2, c1 * c3 - s1 * s2 * s3, -c2 * s1],
        [s1 * s3 - c1 * c3 * s2, c3 * s1 + c1 * s2 * s3, c1 * c2],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler(rotation: Array) -> Array:
    """(..., 3) pitch, yaw and roll in radians: the inverse of `rotation_of`."""
    pitch = np.arctan2(-rotation[..., 1, 2], rotation[..., 2, 2])
    yaw = np.arcsin(np.clip(rotation[..., 0, 2], -1, 1))
    return np.stack([pitch, yaw, np.arctan2(-rotation[..., 0, 1], rotation[..., 0, 0])], axis=-1)


class _Fit(NamedTuple):
    """Of T frames; `cov` (T, 2, 6, 6), all and of points alone, of pitch, yaw and roll (radians), log s and t."""

    angles: Array
    scale: Array
    origin: Array
    cov: Array
    cost: Array


def _refined(angles: Array, scale: Array, xy: Array, cov: Array, seen: Mask, shape: Array, spread: Array) -> _Fit:
    """The least squares near angles (T, 3) in radians and a scale (T,); the weights are those of what is reached."""
    weight = seen[..., None, None]
    apart = xy - scale[:, None, None] * (rotation_of(angles) @ shape.T)[:, :2].swapaxes(1, 2)
    origin = (seen[..., None] * apart).sum(axis=1) / seen.sum(axis=1)[:, None]
    for _ in range(STEPS):
        rotation = rotation_of(angles)
        turned = np.einsum("tij,kj->tki", rotation, shape)
        axes = rotation[:, None, :2] * spread[None, :, None]  # (T, K, 2, 3)
        precision = weight * np.linalg.inv(cov + (scale**2)[:, None, None, None] * (axes @ axes.swapaxes(2, 3)))
        residual = xy - scale[:, None, None] * turned[..., :2] - origin[:, None]
        # (T, 3, 3): for each of pitch, yaw and roll the axis, in the camera's, about which its change turns the head
        about = np.stack([rotation_of(angles * before)[..., i] for i, before in enumerate(np.tri(3, k=-1))], axis=1)
        # (T, K, 2, 6): how the points move with pitch, yaw and roll, with log s and with t
        ways = np.concatenate([np.cross(about[:, None], turned[:, :, None]), turned[:, :, None]], axis=2)
        steps = scale[:, None, None, None] * ways[..., :2].swapaxes(2, 3)
        jacobian = np.concatenate([steps, np.broadcast_to(np.eye(2), cov.shape)], axis=3)
        weighed = precision @ jacobian
        normal = np.einsum("tkia,tkib->tab", jacobian, weighed)
        slope = np.einsum("tkia,tki->ta", weighed, residual)
        cost = np.einsum("tki,tkij,tkj->t", residual, precision, residual)
        # a step of half a radian at most
        normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)  # points that are one point
        step = np.linalg.solve(normal, slope[..., None])[..., 0]
        step *= np.minimum(1, 0.5 / np.maximum(np.linalg.norm(step[:, :4], axis=1), 1e-9))[:, None]
        angles = angles + step[:, :3]
        scale, origin = scale * np.exp(step[:, 3]), origin + step[:, 4:]
        if np.abs(step[:, :4]).max() < 1e-7:
            break
    # of weights that depend on the pose, a wide one makes a small cost: the density counts its width too
    cost = cost - np.where(seen, np.log(np.where(seen, np.linalg.det(precision), 1.0)), 0.0).sum(axis=1)
    inverse = np.linalg.inv(normal)
    own = inverse @ np.einsum("tkia,tkib->tab", weighed, cov @ weighed) @ inverse
    return _Fit(angles, scale, origin, np.stack([inverse, own], axis=1), cost)


def _deep(shape: Array, seen: Mask) -> Mask:
    """(T,) whether enough points are seen, and not all of them in a plane."""
    if shape.shape[0] < MIN_POINTS:
        return np.zeros(len(seen), bool)
    weight = seen[..., None].astype(np.float64)
    middle = (weight * shape).sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    extents = np.linalg.svd(weight * (shape - middle[:, None]), compute_uv=False)
    return np.asarray((seen.sum(axis=1) >= MIN_POINTS) & (extents[:, 2] > FLAT * extents[:, 0]))


def _of(table: Mapping[str, tuple[float, float, float]], parts: Sequence[Trajectory]) -> Array:
    return np.array([table[part.part] for part in parts], dtype=np.float64).reshape(-1, 3)


GAP_S = 0.25  # a pause between rows that ends a stretch
NORMAL: Final = 0.6745  # median absolute deviation of a standard normal number
NOISE, KEPT = 4.0, 0.5  # deviations of noise that a threshold stands above; what of it stays from frame to frame
STILL_S, MIN_SPAN_S = 1.0, 0.2
POINTS_TO_FACE = 2.0
"""The size of a target of points, in largest distances between two: nose and mouth, or eyes and mouth, span about half
a face, so that the thresholds mean about the same for points and for a face's box."""
# kind: labels of a falling and a rising signal (y points down, angles turn clockwise in the image)
LABELS = {"horizontal": ("left", "right"), "vertical": ("up", "down")}
LABELS |= {"tilt": ("counterclockwise", "clockwise"), "size": ("recede", "approach")}
KINDS = (*LABELS, "still")


class Rate(NamedTuple):
    """When a signal moves: rates a second, smoothed over a deviation of `smooth_s`, and the least change of a span."""

    begin: float
    last: float
    change: float
    smooth_s: float


# sizes, sizes, degrees, logarithms of sizes
RATES = dict.fromkeys(("horizontal", "vertical"), Rate(0.15, 0.07, 0.05, 0.12))
RATES |= {"tilt": Rate(12.0, 5.0, 5.0, 0.2), "size": Rate(0.15, 0.07, 0.15, 0.3)}


@np.errstate(invalid="ignore", divide="ignore")
def head_motion(parts: Sequence[Trajectory]) -> dict[str, list[tuple[int, int, str]]]:
    """Of each kind that these parts of a target can tell its spans in the order of time: first frame, last, label.

    A single point has neither angle nor size. `time_s` must be known and increase. Only differences of a signal's
    values mean something, and none across rows that begin again.
    """
    frame, columns = aligned([part.squared for part in parts], "x", "y", "w", "h", "angle", "status")
    seen = ~np.isin(columns.pop("status"), UNSEEN)
    x, y, w, h, angle = (np.where(seen, values, np.nan) for values in columns.values())
    if len(parts) == 1:
        size, turn = np.where((w > 0) & (h > 0), 0.5 * np.log(w * h), np.nan), np.exp(1j * np.radians(angle))
        unit = float(np.exp(nanmedian(size)))
    else:  # (T, M) of pairs of points; of many points, those across from one another in the list
        k = len(parts)
        one, other = np.triu_indices(k, 1) if k <= 12 else (np.arange(k), (np.arange(k) + k // 2) % k)
        off = np.stack([x[:, other] - x[:, one], y[:, other] - y[:, one]], axis=2)
        length = np.hypot(off[..., 0], off[..., 1])
        typical = nanmedian(length, axis=0)
        largest = float(np.nanmax(typical)) if np.isfinite(typical).any() else np.nan
        far = typical >= 0.5 * largest  # directions between points close together are mostly noise
        off, length = np.nan_to_num(off[:, far]), np.where(length[:, far] > 0, length[:, far], np.nan)
        turn = np.where(np.isfinite(length), np.exp(1j * np.arctan2(off[..., 1], off[..., 0])), np.nan)
        size, unit = np.log(length), POINTS_TO_FACE * largest
    placed = np.isfinite(x) & np.isfinite(y)
    unit = unit if unit > 0 else np.nan  # nothing tells how large it is
    ways = {"horizontal": x, "vertical": y}
    signals = {kind: _follow(np.where(placed, way, np.nan)) / unit for kind, way in ways.items()}
    if np.isfinite(turn).any():  # unit complex numbers, to degrees from the usual direction
        usual = np.nansum(turn, axis=0)
        signals["tilt"] = _follow(np.degrees(np.angle(turn / np.where(np.abs(usual) > 0, usual, 1.0))))
    if (sizes := size[np.isfinite(size)]).size and np.ptp(sizes):
        signals["size"] = _follow(size)
    apart = ~(placed[1:] & placed[:-1]).any(axis=1)
    time_s = joined(parts).times
    motions: dict[str, list[tuple[int, int, str]]] = {kind: [] for kind in KINDS if kind in signals or kind == "still"}
    there = np.isfinite(signals["horizontal"] + signals["vertical"] + time_s)
    for a, b in spans(there, (np.diff(time_s) > GAP_S) | apart):  # rows without a break, and not lost
        if b - a > 2 and time_s[b - 1] - time_s[a] >= MIN_SPAN_S:
            own = {kind: signal[a:b] for kind, signal in signals.items()}
            for kind, first, last, label in _spans(time_s[a:b], own):
                motions[kind].append((int(frame[a + first]), int(frame[a + last]), label))
    return {kind: sorted(found) for kind, found in motions.items()}


def _follow(values: Array) -> Array:
    """One signal (T,) for columns (T, M) that move together: the median of their departures from their usual values.

    Where other columns are finite than in the row before, the step is that of the columns finite in both, so that a
    column that comes or goes makes none.
    """
    good, steps = np.isfinite(values), np.diff(values, axis=0)
    level = nanmedian(values - nanmedian(values, axis=0), axis=1)
    step, both = np.diff(level, prepend=np.nan), good[1:] & good[:-1]
    changed = 1 + np.flatnonzero((good[1:] != good[:-1]).any(axis=1) & both.any(axis=1))
    step[changed] = nanmedian(steps[changed - 1], axis=1)
    step[:1] = 0.0
    step[1:][~both.any(axis=1)] = 0.0  # each stretch is relative to its first row
    return np.where(good.any(axis=1), np.cumsum(np.nan_to_num(step)), np.nan)


def nanmedian(values: Array, axis: int | None = None) -> Any:
    """The median of what is finite; nan, without a warning, where nothing is."""
    finite = np.isfinite(values)
    empty = ~finite.any(axis=axis)
    filled = np.where(finite, values, np.where(finite.any(axis=axis, keepdims=True), np.nan, 0.0))
    return np.where(empty, np.nan, np.nanmedian(filled, axis=axis)) if filled.size else np.full(empty.shape, np.nan)


def _spans(time_s: Array, signals: Mapping[str, Array]) -> Iterator[tuple[str, int, int, str]]:
    """Kind, first row, last, and label of the spans in rows without a break, on a grid of equal steps in time."""
    dt = float(np.median(np.diff(time_s)))
    grid = np.arange(time_s[0], time_s[-1] + dt / 2, dt)
    busy, moved = np.zeros(len(grid), dtype=bool), list[tuple[str, int, int, str]]()
    for kind, signal in signals.items():
        finite, rate = np.isfinite(signal), RATES[kind]  # of angle and size, pairs may be missing where points are not
        even = np.interp(grid, time_s[finite], signal[finite]) if finite.any() else np.zeros(len(grid))
        smooth, slope = gauss(even, rate.smooth_s / dt), np.gradient(_kernel(rate.smooth_s / dt), dt)
        speed = np.gradient(smooth, dt)
        # the deviation that noise of unit deviation, of which KEPT stays from frame to frame, has after this filter
        lags = np.abs(np.arange(1 - len(slope), len(slope)))
        left = float(np.sqrt(np.sum(np.correlate(slope, slope, "full") * KEPT**lags)))
        least = max(rate.begin, NOISE * noise_of(even) * left)
        for sign, label in zip((-1, 1), LABELS[kind], strict=True):
            for begin, end in spans(sign * speed > rate.last):
                fast = np.max(sign * speed[begin:end]) > least and (end - begin) * dt >= MIN_SPAN_S
                if fast and abs(smooth[end - 1] - smooth[begin]) >= rate.change:
                    busy[begin:end] = True
                    moved.append((kind, begin, end, label))
    still = (("still", begin, end, "still") for begin, end in spans(~busy) if (end - begin) * dt >= STILL_S)
    for kind, begin, end, label in (*moved, *still):
        # grid times are rounding errors away from the rows'; where rows are far apart, a span may hold none
        first, after = np.searchsorted(time_s, grid[begin] + np.array([-0.25, end - begin - 0.25]) * dt).tolist()
        if after > first:
            yield kind, first, after - 1, label


def _kernel(sigma: float) -> Array:
    reach = int(np.ceil(4 * sigma))
    weights: Array = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return weights / np.sum(weights)


def gauss(signal: Array, sigma: float) -> Array:
    """Smoothed by a Gaussian of `sigma` samples; beyond its ends the signal is mirrored."""
    kernel = _kernel(sigma)
    return np.asarray(np.convolve(np.pad(signal, len(kernel) // 2, mode="symmetric"), kernel, mode="valid"))


def noise_of(signal: Array, kept: float = KEPT) -> float:
    """The standard deviation of noise on a signal, from the median of its second differences.

    Of the noise of particles about half stays from one frame to the next. Where a share `kept` stays, of unit variance,
    second differences have the variance 6 - 8 kept + 2 kept^2.
    """
    second = np.abs(np.diff(signal, n=2))
    return float(np.median(second) / NORMAL / np.sqrt(6 - 8 * kept + 2 * kept**2)) if second.size else 0.0
