"""Points for other tools: COCO keypoints JSON, DeepLabCut's CSV and HDF5, OpenFace 2's CSV; see docs/export.md.

COCO (cocodataset.org/#format-data): a target of one part called `box` is a plain detection.

- `id` of an image is the frame + 1, since an id of 0 misleads COCO's own evaluation; `frame_id` is the 0-based frame.
- Visibility v of a keypoint: 2 tracked (or visible in truth), 1 lost (or hidden): the place is the tracker's estimate;
  0 not known, at 0, 0. A target without any known part has no annotation in that image.
- `score` is the confidence (the mean over the parts; 1 where not known), so that `loadRes(annotations)` reads them as
  results too; `keypoint_scores` are the parts' own; `track_id` counts the targets from 1.
- COCO's keypoints are indices of pixels: a pixel's centre is a whole number, as here (Detectron2 adds 0.5). COCO's
  boxes are measured from the image's corner: a box over the first ten columns is 0 to 10, left 0 and width 10, which
  are the same numbers as here. So nothing is shifted.

In DeepLabCut's CSV and HDF5 whole numbers are pixel centres too; a part `box` is the centre of a box, whose size has no
room. Rows are those of `every_frame`.

OpenFace 2's FeatureExtraction (Baltrusaitis et al., FG 2018; its wiki page "Output Format"), as docs/export.md says:

- `timestamp` in seconds; `success` is 1 where all landmarks of the face are seen. All places are written, as OpenFace
  does; `confidence` is the mean over the parts. Nothing is interpolated.
- `pose_R` in radians: pitch, yaw, roll of R = R_x R_y R_z in the camera's axes. `pose_T` in millimetres: the middle
  between the eyes of a generic head (63 mm apart), which OpenFace has near the middle of the face, by OpenFace's own
  guess of a camera: a focal length of the mean of 500 width / 640 and 500 height / 480, through the image's centre.
"""

import math
from collections.abc import Callable
from itertools import pairwise, product
from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import InputError, needed
from facetrack_cli.core.face_points import LINES, MESH
from facetrack_cli.core.numbers import csv_text, dumps
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.formats.tables import places, texts
from facetrack_cli.trajectory.head import HeadPose, euler, head_pose, rotation_of
from facetrack_cli.trajectory.trajectory import DECIMALS, SEEN, Trajectory, aligned, joined
from facetrack_cli.trajectory.views import Around, enclose, every_frame, mean

EDGES = (("nose", "lip_upper"), *(edge for line in LINES for edge in pairwise(line)))
"""How the points of a face hang together; other parts are drawn without lines."""
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


def write_coco(
    table: Trajectory, size: tuple[int, int], file_name: Callable[[int], str], around: Around = "windows"
) -> str:
    """The JSON text for images of `size` (width, height), named `file_name(frame)`. InputError as of `enclose`."""
    categories, annotations = [], []
    for ident, target in enumerate(table.targets, 1):
        parts = table.of_target(target)
        points = tuple(part for part in parts if part.part != BOX)
        names = [part.part for part in points]
        # COCO counts the ends of a skeleton's edges from 1
        skeleton = [[names.index(a) + 1, names.index(b) + 1] for a, b in EDGES if a in names and b in names]
        about = {"keypoints": names, "skeleton": skeleton} if names else {}
        categories.append({"id": ident, "name": target or "target", "supercategory": "", **about})
        annotations += _annotations(ident, enclose(parts, around), points)
    annotations.sort(key=lambda annotation: (annotation["image_id"], annotation["category_id"]))
    for ident, one in enumerate(annotations, 1):
        one["id"] = ident
    sides, frames = {"width": size[0], "height": size[1]}, table.frames.tolist()
    images = [{"id": n + 1, "file_name": file_name(n), **sides, "frame_id": n} for n in frames]
    groups = {"images": images, "annotations": annotations, "categories": categories}
    info = {"description": f"Tracked by facetrack: {table.path.name}", "version": "1.0"}
    # a line for each image and annotation: large files stay readable, and can be compared
    lists = ",\n".join(f"{dumps(name)}: [\n" + ",\n".join(map(dumps, rows)) + "\n]" for name, rows in groups.items())
    return f'{{\n"info": {dumps(info)},\n"licenses": [],\n{lists}\n}}\n'


def _annotations(ident: int, box: Trajectory, points: tuple[Trajectory, ...]) -> list[dict[str, Any]]:
    rows: dict[int, dict[str, Any]] = {}
    zeros = [0] * len(points)
    for frame, ltwh, confidence in zip(box.frame.tolist(), box.boxes.tolist(), box.confidence.tolist(), strict=True):
        if math.isfinite(sum(ltwh)):
            about = {"id": 0, "image_id": frame + 1, "category_id": ident, "track_id": ident}
            place = {"bbox": [round(value, 3) for value in ltwh], "area": round(ltwh[2] * ltwh[3], 3), "iscrowd": 0}
            rows[frame] = {**about, **place, "score": confidence if math.isfinite(confidence) else 1.0}
            if points:
                rows[frame] |= {"num_keypoints": 0, "keypoints": zeros * 3, "keypoint_scores": list(zeros)}
    for k, part in enumerate(points):
        flags = np.where(np.isin(part.status, SEEN), 2, 1).tolist()
        columns = (part.frame.tolist(), part.x.tolist(), part.y.tolist(), flags, part.confidence.tolist())
        for frame, x, y, flag, confidence in zip(*columns, strict=True):
            if frame in rows and math.isfinite(x) and math.isfinite(y):
                row = rows[frame]
                row["keypoints"][3 * k : 3 * k + 3] = [round(x, 3), round(y, 3), flag]
                row["keypoint_scores"][k] = confidence if math.isfinite(confidence) else 1.0
                row["num_keypoints"] += 1
    return list(rows.values())


def write_dlc(table: Trajectory, scorer: str = "facetrack") -> str:
    """The text of the CSV. `scorer` names what tracked."""
    names, columns, frames, values = _dlc(table, scorer)
    cells = np.stack([texts(values[..., i], DECIMALS[name]) for i, name in enumerate(("x", "y", "confidence"))], axis=2)
    if not np.isfinite(values[0]).any():
        cells[0] = "nan"  # pandas takes an empty first row for the name of the index, and every frame moves by one
    rows = zip(frames.tolist(), cells.reshape(len(frames), -1).tolist(), strict=True)
    heads = [[name, *level] for name, level in zip(names, zip(*columns, strict=True), strict=True)]
    return csv_text(heads[0], [*heads[1:], *([frame, *row] for frame, row in rows)])


def write_dlc_h5(table: Trajectory, scorer: str = "facetrack") -> bytes:
    """The HDF5 file: the same as a data frame, under DeepLabCut's key, without the time of writing.

    UsageError without pandas and PyTables, InputError for more columns than such a table has room for.
    """
    with needed("DeepLabCut's HDF5 files", "pandas", "pandas"):
        import pandas
        from tables.exceptions import HDF5ExtError
    names, columns, frames, values = _dlc(table, scorer)
    head = pandas.MultiIndex.from_tuples(columns, names=names)
    frame = pandas.DataFrame(values.reshape(len(frames), -1), index=frames, columns=head)
    in_memory: dict[str, Any] = {"driver": "H5FD_CORE", "driver_core_backing_store": 0}
    with pandas.HDFStore("track.h5", mode="w", **in_memory) as store:
        try:
            store.put("df_with_missing", frame, format="table", index=False, track_times=False)
        except HDF5ExtError:
            why = f"HDF5 has no room for the names of {len(columns)} columns"
            raise InputError(f"{why}; choose a target with --target, or export to dlc") from None
        # readers before pandas 3, as DeepLabCut has, find no values without what pandas 3.1 no longer writes
        store.get_storer("df_with_missing").attrs.pandas_version = "0.15.2"
        store.flush()
        image: bytes = store._handle.get_file_image()
    return image


def _dlc(table: Trajectory, scorer: str) -> tuple[list[str], list[tuple[str, ...]], Whole, Array]:
    """The names of the header's levels, its columns, T frames, and (T, K, 3) values: x, y, likelihood.

    Readers take the columns for individuals x body parts: each individual has all parts, empty where it has none.
    """
    several, (frames, _) = len(table.targets) > 1, every_frame(table)
    parts, values = places(table, frames)
    values[~np.isfinite(values[..., :2]).all(axis=3)] = np.nan
    names = ["scorer", *(["individuals"] if several else []), "bodyparts", "coords"]
    individuals = [(scorer, target) if several else (scorer,) for target in table.targets]
    columns = [(*one, part, coord) for one, part, coord in product(individuals, parts, ("x", "y", "likelihood"))]
    return names, columns, frames, values.reshape(len(frames), -1, 3)


def write_openface(table: Trajectory, size: tuple[int, int] | None) -> str:
    """The text for images of `size` (width, height), None if that is not known. InputError without any landmark."""
    rows: list[tuple[int, int, list[Any]]] = []
    shown = size and (size[0] * table.pixel_aspect, size[1])
    faces = [[part for part in table.of_target(name) if part.part in LANDMARKS] for name in table.targets]
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
        rows += [(row[0], ident, row) for row in cells.tolist()]
    if not rows:
        names = ", ".join(name for name in MESH if name in LANDMARKS)
        raise InputError(f"no part is one of OpenFace's landmarks, which are {names}, and point_01 to point_68")
    return csv_text(COLUMNS, [row for *_, row in sorted(rows, key=lambda row: row[:2])])


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
