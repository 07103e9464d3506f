"""COCO keypoints JSON (cocodataset.org/#format-data): what pycocotools, Detectron2, MMPose and labelling tools read.

- A category for each target, with its parts as keypoints; a target of one part called `box` is a plain detection.
- An image for each frame: `id` is the frame + 1, since an id of 0 misleads COCO's own evaluation; `frame_id` is the
  0-based frame. `file_name` is the image's own where the source was a folder; frames of a video are called
  `<clip>/000000.png` by their 0-based number, as `ffmpeg -i clip.mp4 -start_number 0 <clip>/%06d.png` names them.
- Visibility v of a keypoint: 2 tracked (or visible in truth), 1 lost (or hidden): the place is the tracker's estimate;
  0 not known, at 0, 0. A target without any known part has no annotation in that image.
- `score` is the confidence (the mean over the parts; 1 where not known), so that `loadRes(annotations)` reads them as
  results too; `keypoint_scores` are the parts' own; `track_id` counts the targets from 1.

COCO's keypoints are indices of pixels: a pixel's centre is a whole number, as here (Detectron2 adds 0.5 to them to get
to coordinates from the picture's corner). COCO's boxes are measured from that corner: a box over the first ten columns
is 0 to 10, left 0 and width 10, which are the same numbers as here. So nothing is shifted.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from facetrack_cli.trajectory.select import Around, enclose
from facetrack_cli.trajectory.trajectory import Trajectory

EDGES = (
    ("nose", "lip_upper"),
    ("lip_upper", "mouth_left"),
    ("lip_upper", "mouth_right"),
    ("mouth_left", "lip_lower"),
    ("mouth_right", "lip_lower"),
)
"""How the parts of the shipped recipes hang together; other parts are drawn without lines."""
SEEN = ("", "init", "tracked", "visible")


def write_coco(
    table: Trajectory, size: tuple[int, int], file_name: Callable[[int], str], *, around: Around = "windows"
) -> str:
    """The JSON text. `size` is the picture's (width, height); `file_name` gives the image of a 0-based frame.

    `bbox` is the target's box as `enclose` says. Raises InputError for windows of parts that have none.
    """
    categories, annotations = [], []
    for ident, target in enumerate(table.targets, 1):
        parts = table.of_target(target)
        points = [] if [one.part for one in parts] == ["box"] else list(parts)
        categories.append(_category(ident, target, points))
        annotations += _annotations(ident, enclose(parts, around), points)
    annotations.sort(key=lambda one: (one["image_id"], one["category_id"]))
    for ident, one in enumerate(annotations, 1):
        one["id"] = ident
    images = [
        {"id": frame + 1, "file_name": file_name(frame), "width": size[0], "height": size[1], "frame_id": frame}
        for frame in table.frames.tolist()
    ]
    groups = {"images": images, "annotations": annotations, "categories": categories}
    info = {"description": f"Tracked by facetrack: {table.path.name}", "version": "1.0"}
    # a line for each image and annotation: large files stay readable, and can be compared
    lists = ",\n".join(f"{_json(name)}: [\n" + ",\n".join(map(_json, rows)) + "\n]" for name, rows in groups.items())
    return f'{{\n"info": {_json(info)},\n"licenses": [],\n{lists}\n}}\n'


def _category(ident: int, target: str, points: list[Trajectory]) -> dict[str, Any]:
    name = target or "target"
    if not points:
        return {"id": ident, "name": name, "supercategory": ""}
    names = [one.part for one in points]
    # COCO counts the ends of a skeleton's edges from 1
    skeleton = [[names.index(a) + 1, names.index(b) + 1] for a, b in EDGES if a in names and b in names]
    return {"id": ident, "name": name, "supercategory": "", "keypoints": names, "skeleton": skeleton}


def _annotations(ident: int, box: Trajectory, points: list[Trajectory]) -> list[dict[str, Any]]:
    rows: dict[int, dict[str, Any]] = {}
    for frame, ltwh, confidence in zip(box.frame.tolist(), box.boxes.tolist(), box.confidence.tolist(), strict=True):
        if not math.isfinite(sum(ltwh)):
            continue
        rows[frame] = {
            "id": 0,
            "image_id": frame + 1,
            "category_id": ident,
            "track_id": ident,
            "bbox": [round(value, 3) for value in ltwh],
            "area": round(ltwh[2] * ltwh[3], 3),
            "iscrowd": 0,
            "score": confidence if math.isfinite(confidence) else 1.0,
        }
        if points:
            zeros = [0] * len(points)
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


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
