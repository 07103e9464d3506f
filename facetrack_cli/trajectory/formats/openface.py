"""The CSV of OpenFace 2's FeatureExtraction (Baltrusaitis et al., FG 2018; its wiki page "Output Format").

- `frame` counts from 1, `face_id` from 0 in the order of the targets; `timestamp` in seconds. `success` is 1 where all
  landmarks of the face are seen. All places are written, as OpenFace does; `confidence` is the mean over the parts.
- `x_i`, `y_i` are the 68 landmarks of iBUG, from 0, in pixels: readers choose them by this number. A part that is one
  of them (`LANDMARKS`) fills its own; all others are empty, as is what is not known. Nothing is interpolated: iBUG has
  two points on each lid, and a face of 28 points has another, between these two.
- `pose_R` in radians: pitch, yaw, roll of R = R_x R_y R_z in the camera's axes. `pose_T` in millimetres: the middle
  between the eyes of a generic head (63 mm apart), which OpenFace has near the middle of the face, by OpenFace's own
  guess of a camera: a focal length of the mean of 500 width / 640 and 500 height / 480, through the image's centre.
  Without the size of the image there is no `pose_T`, and `pose_R` is relative to the line of sight.
- Gaze, eye landmarks, 3-D landmarks, shape parameters and action units are not there.
"""

from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import MESH
from facetrack_cli.core.numbers import csv_text
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.analysis.head_pose import HeadPose, euler, head_pose, rotation_of
from facetrack_cli.trajectory.formats.tables import texts
from facetrack_cli.trajectory.select import mean
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, joined

IN_MESH: Final = (
    127, 234, 93, 132, 172, 136, 150, 176, 152, 400, 379, 365, 397, 361, 323, 454, 356,  # jaw
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,  # brows
    168, 197, 5, 1, 98, 97, 2, 326, 327,  # nose
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  # eyes
    61, 39, 37, 0, 267, 269, 291, 321, 314, 17, 84, 91,  # lips, outer border
    78, 82, 13, 312, 308, 317, 14, 87,  # inner border
)  # fmt: skip
"""The point of MediaPipe's mesh for each of the 68, from iBUG's mean face beside MediaPipe's canonical face; much as in
github.com/PeizhiYan/Mediapipe_2_Dlib_Landmarks, which takes the mean of two points for some of the 68."""
COUNT: Final = len(IN_MESH)
_NAMES: Final = {number: name for name, number in MESH.items()}
LANDMARKS: Final = {_NAMES.get(number, f"mesh_{number}"): i for i, number in enumerate(IN_MESH)} | {
    f"point_{i + 1:02d}": i for i in range(COUNT)
}
"""The number of each part: a point of the face, another point of the mesh, or a point as .pts files are read."""
POSE: Final = ("pose_Tx", "pose_Ty", "pose_Tz", "pose_Rx", "pose_Ry", "pose_Rz")
COLUMNS: Final = (
    "frame", "face_id", "timestamp", "confidence", "success", *POSE,
    *(f"x_{i}" for i in range(COUNT)), *(f"y_{i}" for i in range(COUNT)),
)  # fmt: skip


def write_openface(table: Trajectory, size: tuple[int, int] | None) -> str:
    """The text for images of `size` (width, height), None if that is not known. InputError without any landmark."""
    found: list[tuple[int, int, list[Any]]] = []
    shown = size and (size[0] * table.pixel_aspect, size[1])
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
            cells[at[there], 5:8], cells[at[there], 8:11] = (texts(v[there], n) for v, n in _in_camera(pose, shown))
        for k, part in enumerate(parts):
            for first, name in ((11, "x"), (11 + COUNT, "y")):
                cells[:, first + LANDMARKS[part.part]] = texts(columns[name][:, k], 3)
        cells[:, 0], cells[:, 1] = frames + 1, ident
        found += [(row[0], ident, row) for row in cells.tolist()]
    if not found:
        known = ", ".join(name for name in MESH if name in LANDMARKS)
        raise InputError(f"no part is one of OpenFace's landmarks, which are {known}, and point_01 to point_68")
    return csv_text(COLUMNS, [row for *_, row in sorted(found, key=lambda one: one[:2])])


def _in_camera(pose: HeadPose, size: tuple[float, float] | None) -> list[tuple[Array, int]]:
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
