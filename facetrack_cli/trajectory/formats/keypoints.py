"""Points for tools that label and estimate poses: COCO keypoints JSON, DeepLabCut's CSV and HDF5; see docs/export.md.

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
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError, needed
from facetrack_cli.core.face_points import LINES
from facetrack_cli.core.numbers import csv_text, dumps
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.formats.tables import texts
from facetrack_cli.trajectory.select import Around, enclose
from facetrack_cli.trajectory.trajectory import DECIMALS, SEEN, Trajectory, aligned, every_frame

EDGES = (("nose", "lip_upper"), *(edge for line in LINES for edge in pairwise(line)))
"""How the points of a face hang together; other parts are drawn without lines."""


def write_coco(
    table: Trajectory, size: tuple[int, int], file_name: Callable[[int], str], *, around: Around = "windows"
) -> str:
    """The JSON text for images of `size` (width, height), named `file_name(frame)`. InputError as of `enclose`."""
    categories, annotations = [], []
    for ident, target in enumerate(table.targets, 1):
        parts = table.of_target(target)
        points = tuple(one for one in parts if one.part != BOX)
        names = [one.part for one in points]
        # COCO counts the ends of a skeleton's edges from 1
        skeleton = [[names.index(a) + 1, names.index(b) + 1] for a, b in EDGES if a in names and b in names]
        about = {"keypoints": names, "skeleton": skeleton} if names else {}
        categories.append({"id": ident, "name": target or "target", "supercategory": "", **about})
        annotations += _annotations(ident, enclose(parts, around), points)
    annotations.sort(key=lambda one: (one["image_id"], one["category_id"]))
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
    for k, one in enumerate(points):
        flags = np.where(np.isin(one.status, SEEN), 2, 1).tolist()
        columns = (one.frame.tolist(), one.x.tolist(), one.y.tolist(), flags, one.confidence.tolist())
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
    with needed("DeepLabCut's HDF5", "pandas", "pandas"):
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
        store.flush()
        image: bytes = store._handle.get_file_image()
    return image


def _dlc(table: Trajectory, scorer: str) -> tuple[list[str], list[tuple[str, ...]], Whole, Array]:
    """The names of the header's levels, its columns, T frames, and (T, K, 3) values: x, y, likelihood.

    Readers take the columns for individuals x body parts: each individual has all parts, empty where it has none.
    """
    several = len(table.targets) > 1
    pairs = [(t, part) for t in table.targets for part in dict.fromkeys(part for _, part in table.names)]
    frames, _ = every_frame(table)
    _, known = aligned(table.parts, "x", "y", "confidence", frame=frames)
    found = np.full((len(frames), len(pairs), 3), np.nan)
    found[:, [pairs.index(pair) for pair in table.names]] = np.stack([*known.values()], axis=2)
    found[~np.isfinite(found[..., :2]).all(axis=2)] = np.nan
    names = ["scorer", *(["individuals"] if several else []), "bodyparts", "coords"]
    columns = [
        (scorer, *((target,) if several else ()), part, coord)
        for target, part in pairs
        for coord in ("x", "y", "likelihood")
    ]
    return names, columns, frames, found
