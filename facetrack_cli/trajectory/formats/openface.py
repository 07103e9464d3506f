"""The CSV of OpenFace 2's FeatureExtraction (Baltrusaitis et al., FG 2018; its wiki page "Output Format").

- `frame` counts from 1, `face_id` from 0 in the order of the targets; `timestamp` in seconds. `success` is 1 where all
  landmarks of the face are seen. All places are written, as OpenFace does; `confidence` is the mean over the parts.
- `x_i`, `y_i` are the 68 landmarks of iBUG, from 0, in pixels: readers choose them by this number. A part that is one
  of them (`LANDMARKS`, and `point_01` to `point_68`) fills its own; all others are empty, as is what is not known.
- `pose_R` in radians: pitch, yaw, roll of R = R_x R_y R_z in the camera's axes. `pose_T` in millimetres: the middle
  between the eyes of a generic head (63 mm apart), which OpenFace has near the middle of the face, by OpenFace's own
  guess of a camera: a focal length of the mean of 500 width / 640 and 500 height / 480, through the image's centre.
  Without the size of the image there is no `pose_T`, and `pose_R` is relative to the line of sight.
- Gaze, eye landmarks, 3-D landmarks, shape parameters and action units are not there.
"""

from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.formats.pts import NAMED
from facetrack_cli.trajectory.formats.tables import csv_text, texts
from facetrack_cli.trajectory.head_pose import HeadPose, euler, head_pose, rotation_of
from facetrack_cli.trajectory.select import mean
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, joined

COUNT: Final = 68
LANDMARKS: Final = {name: number - 1 for name, number in NAMED.items()} | {
    f"point_{i + 1:02d}": i for i in range(COUNT)
}
"""Parts, by the shipped recipes' names and as .pts files are read, and their numbers; left and right of the image."""
POSE: Final = ("pose_Tx", "pose_Ty", "pose_Tz", "pose_Rx", "pose_Ry", "pose_Rz")
COLUMNS: Final = (
    "frame", "face_id", "timestamp", "confidence", "success", *POSE,
    *(f"x_{i}" for i in range(COUNT)), *(f"y_{i}" for i in range(COUNT)),
)  # fmt: skip


def write_openface(table: Trajectory, size: tuple[int, int] | None) -> str:
    """The text for images of `size` (width, height), None if that is not known. InputError without any landmark."""
    found: list[tuple[int, int, list[Any]]] = []
    faces = [[one for one in table.of_target(name) if one.part in LANDMARKS] for name in table.targets]
    for ident, parts in enumerate(filter(None, faces)):
        frames, columns = aligned(parts, "x", "y", "confidence", "status")
        cells = np.full((len(frames), len(COLUMNS)), "", dtype=object)
        seen = np.isin(columns["status"], SEEN) & np.isfinite(columns["x"] + columns["y"])
        cells[:, 2] = texts(joined(parts).times, 3)
        cells[:, 3] = texts(mean(columns["confidence"]), 4)
        cells[:, 4] = seen.all(axis=1).astype(int)
        if (pose := head_pose(table.of_target(parts[0].target))) is not None:
            at = np.searchsorted(frames, pose.frame)
            there = np.isin(pose.frame, frames)
            cells[at[there], 5:8], cells[at[there], 8:11] = (texts(v[there], n) for v, n in _in_camera(pose, size))
        for k, part in enumerate(parts):
            for first, name in ((11, "x"), (11 + COUNT, "y")):
                cells[:, first + LANDMARKS[part.part]] = texts(columns[name][:, k], 3)
        cells[:, 0], cells[:, 1] = frames + 1, ident
        found += [(row[0], ident, row) for row in cells.tolist()]
    if not found:
        known = ", ".join(NAMED)
        raise InputError(f"no part is one of OpenFace's landmarks, which are {known}, and point_01 to point_68")
    return csv_text(COLUMNS, [row for *_, row in sorted(found, key=lambda one: one[:2])])


def _in_camera(pose: HeadPose, size: tuple[int, int] | None) -> list[tuple[Array, int]]:
    """`pose_T` and `pose_R`, (T, 3) each, and their decimals."""
    rotation = np.radians(pose.angles)
    if size is None:
        return [(np.full_like(pose.angles, np.nan), 1), (rotation, 4)]
    width, height = size
    focal = (500 * width / 640 + 500 * height / 480) / 2
    off = (pose.origin - (np.array([width, height]) - 1) / 2) / focal
    place = np.concatenate([off, np.ones((len(off), 1))], axis=1) * (focal / pose.scale)[:, None]
    # from the line of sight, along which weak perspective looks, to the camera's axis
    pitch, yaw = np.arctan2(-off[:, 1], 1), np.arctan2(off[:, 0], np.hypot(1, off[:, 1]))
    towards = rotation_of(np.stack([pitch, yaw, np.zeros_like(yaw)], axis=1))
    return [(place, 1), (euler(towards @ rotation_of(rotation)), 4)]
