"""Points for tools that label and estimate poses: COCO keypoints JSON, and DeepLabCut's CSV; see docs/export.md.

COCO (cocodataset.org/#format-data): a target of one part called `box` is a plain detection.

- `id` of an image is the frame + 1, since an id of 0 misleads COCO's own evaluation; `frame_id` is the 0-based frame.
- Visibility v of a keypoint: 2 tracked (or visible in truth), 1 lost (or hidden): the place is the tracker's estimate;
  0 not known, at 0, 0. A target without any known part has no annotation in that image.
- `score` is the confidence (the mean over the parts; 1 where not known), so that `loadRes(annotations)` reads them as
  results too; `keypoint_scores` are the parts' own; `track_id` counts the targets from 1.
- COCO's keypoints are indices of pixels: a pixel's centre is a whole number, as here (Detectron2 adds 0.5). COCO's
  boxes are measured from the image's corner: a box over the first ten columns is 0 to 10, left 0 and width 10, which
  are the same numbers as here. So nothing is shifted.

In DeepLabCut's CSV whole numbers are pixel centres too; a part `box` is the centre of a box, whose size has no room.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from facetrack_cli.core.face_points import LINES
from facetrack_cli.core.numbers import csv_text, dumps
from facetrack_cli.core.types import BOX
from facetrack_cli.trajectory.select import Around, enclose
from facetrack_cli.trajectory.trajectory import DECIMALS, SEEN, Trajectory, aligned

EDGES = (("nose", "lip_upper"), *(edge for line in LINES for edge in pairwise(line)))
"""How the points of a face hang together; other parts are drawn without lines."""


def write_coco(
    table: Trajectory, size: tuple[int, int], file_name: Callable[[int], str], *, around: Around = "windows"
) -> str:
    """The JSON text for images of `size` (width, height), named `file_name(frame)`. InputError as of `enclose`."""
    categories, annotations = [], []
    for ident, target in enumerate(table.targets, 1):
        parts = table.of_target(target)
        names = [one.part for one in parts if len(parts) > 1 or one.part != BOX]
        # COCO counts the ends of a skeleton's edges from 1
        skeleton = [[names.index(a) + 1, names.index(b) + 1] for a, b in EDGES if a in names and b in names]
        points = {"keypoints": names, "skeleton": skeleton} if names else {}
        categories.append({"id": ident, "name": target or "target", "supercategory": "", **points})
        annotations += _annotations(ident, enclose(parts, around), parts if names else ())
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
    """The text of the file; every target's parts in the table's order. `scorer` names what tracked."""
    frames, columns = aligned(table.parts, "x", "y", "confidence")
    known = np.isfinite(columns["x"] + columns["y"])
    cells = np.full((len(frames), 3 * len(table.parts)), "", dtype=object)
    for at, (name, values) in enumerate(columns.items()):
        written = np.char.mod(f"%.{DECIMALS[name]}f", values)
        cells[:, at::3] = np.where(known & np.isfinite(values), written, "")
    head = ["scorer", *[scorer] * cells.shape[1]]
    rows: list[list[Any]] = []
    if len(table.targets) > 1:
        rows.append(["individuals", *(one.target for one in table.parts for _ in range(3))])
    rows.append(["bodyparts", *(one.part for one in table.parts for _ in range(3))])
    rows.append(["coords", *["x", "y", "likelihood"] * len(table.parts)])
    rows += ([frame, *row] for frame, row in zip(frames.tolist(), cells.tolist(), strict=True))
    return csv_text(head, rows)
