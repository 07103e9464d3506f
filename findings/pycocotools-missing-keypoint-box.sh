#!/usr/bin/env bash
# A keypoint that is not there makes a small face large.
#
# Found: results of keypoints need no box in COCO's format: pycocotools 2.0.11 (COCO.loadRes) makes one of the points. It
# takes the smallest and largest x and y of ALL points, also of those that are written 0, 0, 0 because they are not known.
# A face of 40 x 40 pixels at 300, 300 that lacks one of its points gets the box 0, 0, 340, 340, an area of 115,600 for
# 1,600. COCOeval goes by that area: of a tracker that is right in one face and invents such a second one, the false one
# is outside of the size "medium" and is ignored, so that AP of medium faces is 1; with all points known, or with the box
# and its area in the result, it counts, and AP is .667.
# Packages: pycocotools 2.0.11 with numpy 2.4.6.
# Data: two made-up pictures with one face of four points each, written here.
# Output seen:
#   one point of the false face is missing, no box: box [0, 0, 340, 340], area 115600, AP medium 1.0
#   all points known, no box: box [300, 300, 40, 40], area 1600, AP medium 0.667
#   one point is missing, with the box: box [300, 300, 40, 40], area 1600, AP medium 0.667
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pycocotools==2.0.11 numpy==2.4.6
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

true = [100, 100, 2, 140, 100, 2, 140, 140, 2, 100, 140, 2]
truth = COCO()
face = {"category_id": 1, "keypoints": true, "num_keypoints": 4, "bbox": [100, 100, 40, 40], "area": 1600, "iscrowd": 0}
truth.dataset = {
    "images": [{"id": n, "width": 640, "height": 480} for n in (1, 2)],
    "annotations": [{"id": n, "image_id": n, **face} for n in (1, 2)],
    "categories": [{"id": 1, "name": "face", "keypoints": ["a", "b", "c", "d"]}],
    "info": {},
}


def measured(points, **box):
    """The box that the false face gets, its area, and AP of medium faces; the true faces are found exactly."""
    right = {"category_id": 1, "keypoints": true, "bbox": [100, 100, 40, 40], "area": 1600} if box else {
        "category_id": 1, "keypoints": true}
    false = {"image_id": 1, "category_id": 1, "keypoints": points, "score": 0.95, **box}
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        results = truth.loadRes([false, *({"image_id": n, "score": 0.9, **right} for n in (1, 2))])
        judge = COCOeval(truth, results, "keypoints")
        judge.params.kpt_oks_sigmas = np.full(4, 0.05)
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    return [int(v) for v in results.anns[1]["bbox"]], int(results.anns[1]["area"]), round(float(judge.stats[3]), 3)


whole = [300, 300, 2, 340, 300, 2, 340, 340, 2, 300, 340, 2]
part = [*whole[:9], 0, 0, 0]
found = {
    "one point of the false face is missing, no box": measured(part),
    "all points known, no box": measured(whole),
    "one point is missing, with the box": measured(part, bbox=[300, 300, 40, 40], area=1600),
}
for what, (box, area, ap) in found.items():
    print(f"{what}: box {box}, area {area}, AP medium {ap}")
one, two, three = found.values()
small = ([300, 300, 40, 40], 1600)
sys.exit(one != ([0, 0, 340, 340], 115600, 1.0) or two[:2] != small or three[:2] != small or not two[2] == three[2] < 0.8)
PYTHON
