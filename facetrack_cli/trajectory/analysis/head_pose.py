"""Roll, yaw and pitch of a head from points of its face, and their spread: a generic shape under weak perspective.

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
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, one_part

# mm: x to the right of the image, y down, z away from the camera; the origin is midway between the eyes
SHAPE: Final[Mapping[str, tuple[float, float, float]]] = {
    "eye_left": (-31.5, 0.0, 0.0),
    "eye_right": (31.5, 0.0, 0.0),
    "nose": (0.0, 33.5, -33.5),
    "mouth_left": (-26.5, 66.0, 0.0),
    "mouth_right": (26.5, 66.0, 0.0),
    "lip_upper": (0.0, 58.5, -21.0),
    "lip_lower": (0.0, 80.0, -14.5),
}
SPREAD: Final[Mapping[str, tuple[float, float, float]]] = {
    "eye_left": (1.8, 1.6, 2.4),
    "eye_right": (1.8, 1.6, 2.4),
    "nose": (1.2, 2.2, 4.2),
    "mouth_left": (2.9, 2.6, 3.6),
    "mouth_right": (2.9, 2.6, 3.6),
    "lip_upper": (0.5, 2.3, 2.2),
    "lip_lower": (0.6, 3.5, 2.1),
}
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

    The spread holds both the tracker's uncertainty and that of the person's own proportions. The latter is the same in
    all frames of a person: differences between frames are more exact than it says.
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


def fit_pose(
    xy: Array, cov: Array, seen: Mask, shape: Array, spread: Array
) -> tuple[Array, Array, Array, Array, Mask, Array]:
    """All of HeadPose but the frames, for points xy (T, K, 2) with cov (T, K, 2, 2).

    `seen` (T, K) are the points to use; `shape` (K, 3) is the face and `spread` (K, 3) its standard deviations, in mm.
    """
    frames = len(xy)
    angles, scale, origin = np.full((frames, 3), np.nan), np.full(frames, np.nan), np.full((frames, 2), np.nan)
    covariance, ambiguous = np.full((frames, 2, 3, 3), np.nan), np.zeros(frames, bool)
    rows = np.flatnonzero(_deep(shape, seen))
    if rows.size:
        points = np.where(seen[rows, :, None], xy[rows], 0.0), cov[rows], seen[rows], shape, spread
        rotation = _begin(*points)
        mirrored = _completed(rotation[:, :2] * np.array([1, 1, -1]))  # the depth of all points reversed
        first, other = _refined(rotation, *points), _refined(mirrored, *points)
        better = other.cost < first.cost
        best = _Fit(
            *(np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in zip(first, other, strict=True))
        )
        cosine = (np.einsum("tij,tij->t", first.rotation, other.rotation) - 1) / 2
        turned = np.arccos(np.clip(cosine, -1, 1))
        ambiguous[rows] = (np.abs(first.cost - other.cost) < HARDLY) & (turned > np.radians(5))
        radians = euler(best.rotation)
        inverse = np.linalg.inv(_spins(radians))[:, None]
        spread_ = np.degrees(np.degrees(inverse @ best.cov[..., :3, :3] @ inverse.swapaxes(2, 3)))
        clear = np.diagonal(spread_[:, 0], axis1=1, axis2=2).max(axis=1) < MAX_SPREAD_DEG**2
        ambiguous[rows] &= clear
        rows, best = rows[clear], _Fit(*(values[clear] for values in best))
        angles[rows], covariance[rows] = np.degrees(radians[clear]), spread_[clear]
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
    """Of T frames; `cov` (T, 2, 6, 6), all and of points alone, of a rotation about the camera's axes, log s and t."""

    rotation: Array
    scale: Array
    origin: Array
    cov: Array
    cost: Array


def _refined(rotation: Array, xy: Array, cov: Array, seen: Mask, shape: Array, spread: Array) -> _Fit:
    """The least squares near a rotation (T, 3, 3); the weights are those of the rotation that is reached."""
    weight = seen[..., None, None]
    flat = rotation @ shape.T
    scale, origin = _placed(flat[:, :2].swapaxes(1, 2), xy, seen)
    for _ in range(STEPS):
        turned = np.einsum("tij,kj->tki", rotation, shape)
        axes = rotation[:, None, :2] * spread[None, :, None]  # (T, K, 2, 3)
        precision = weight * np.linalg.inv(cov + (scale**2)[:, None, None, None] * (axes @ axes.swapaxes(2, 3)))
        residual = xy - scale[:, None, None] * turned[..., :2] - origin[:, None]
        jacobian = _jacobian(turned, scale)
        weighed = precision @ jacobian
        normal = np.einsum("tkia,tkib->tab", jacobian, weighed)
        slope = np.einsum("tkia,tki->ta", weighed, residual)
        cost = np.einsum("tki,tkij,tkj->t", residual, precision, residual)
        # a step of half a radian at most
        normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)  # points that are one point
        step = np.linalg.solve(normal, slope[..., None])[..., 0]
        step *= np.minimum(1, 0.5 / np.maximum(np.linalg.norm(step[:, :4], axis=1), 1e-9))[:, None]
        rotation = _turn(step[:, :3]) @ rotation
        scale, origin = scale * np.exp(step[:, 3]), origin + step[:, 4:]
        if np.abs(step[:, :4]).max() < 1e-7:
            break
    # of weights that depend on the pose, a wide one makes a small cost: the density counts its width too
    cost = cost - np.where(seen, np.log(np.where(seen, np.linalg.det(precision), 1.0)), 0.0).sum(axis=1)
    inverse = np.linalg.inv(normal)
    own = inverse @ np.einsum("tkia,tkib->tab", weighed, cov @ weighed) @ inverse
    return _Fit(rotation, scale, origin, np.stack([inverse, own], axis=1), cost)


def _jacobian(turned: Array, scale: Array) -> Array:
    """(T, K, 2, 6): how the points move with a rotation about the camera's axes, with log s and with t."""
    x, y, z = np.moveaxis(turned, -1, 0) * scale[:, None]
    zero, one = np.zeros_like(x), np.ones_like(x)
    return np.stack([np.stack([zero, z, -y, x, one, zero], -1), np.stack([-z, zero, x, y, zero, one], -1)], axis=-2)


def _begin(xy: Array, cov: Array, seen: Mask, shape: Array, spread: Array) -> Array:
    """(T, 3, 3) the rotation nearest to the affine map of least squares; without a look at the shape's spread."""
    weight = seen[..., None].astype(np.float64)
    count = weight.sum(axis=1)
    centred = weight * (shape - (weight * shape).sum(axis=1, keepdims=True) / count[:, None])
    moved = weight * (xy - (weight * xy).sum(axis=1, keepdims=True) / count[:, None])
    affine = moved.swapaxes(1, 2) @ np.linalg.pinv(centred.swapaxes(1, 2))
    u, _, v = np.linalg.svd(affine, full_matrices=False)
    return _completed(u @ v)


def _placed(flat: Array, xy: Array, seen: Mask) -> tuple[Array, Array]:
    """The scale (T,) and origin (T, 2) of points xy (T, K, 2) that are at `flat` (T, K, 2) in the face, turned."""
    weight = seen[..., None] / seen.sum(axis=1)[:, None, None]
    middle, place = (weight * flat).sum(axis=1), (weight * xy).sum(axis=1)
    apart = flat - middle[:, None]
    scale = (weight * apart * (xy - place[:, None])).sum(axis=(1, 2)) / (weight * apart**2).sum(axis=(1, 2))
    scale = np.maximum(scale, 1e-3)
    return scale, place - scale[:, None] * middle


def _completed(rows: Array) -> Array:
    """The rotation (T, 3, 3) with these first two rows (T, 2, 3)."""
    return np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)


def _turn(by: Array) -> Array:
    """(T, 3, 3) rotations by vectors (T, 3) (Rodrigues)."""
    angle = np.linalg.norm(by, axis=1)[:, None, None]
    x, y, z = by.T
    zero = np.zeros_like(x)
    cross = np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], axis=1)
    whole, half = np.sinc(angle / np.pi), np.sinc(angle / 2 / np.pi)
    return np.asarray(np.eye(3) + whole * cross + 0.5 * half**2 * (cross @ cross))


def _spins(angles: Array) -> Array:
    """(T, 3, 3): the rotation about the camera's axes that a change of pitch, yaw and roll makes, for each a column."""
    (pitch, yaw, _), zero = angles.T, np.zeros(len(angles))
    about_y = np.stack([zero, np.cos(pitch), np.sin(pitch)], -1)
    about_z = np.stack([np.sin(yaw), -np.sin(pitch) * np.cos(yaw), np.cos(pitch) * np.cos(yaw)], -1)
    return np.stack([np.stack([zero + 1, zero, zero], -1), about_y, about_z], axis=-1)


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
