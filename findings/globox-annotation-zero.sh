#!/usr/bin/env bash
# A tracker that is exactly right has an AP of 0, .25 or .56.
#
# Found: globox 2.9.0 converts boxes between the formats of annotation tools. save_coco numbers the annotations from
# 0. pycocotools 2.0.11 (COCOeval) keeps the number of the ground truth that a result matches, and takes 0 for none:
# the first box of the file is found and counts as a false alarm, and as missed. With the same boxes as results AP
# is 0 for one box, .252 for two, .564 for four, .98 for a hundred. With 1 added to each id it is 1, and so says
# globox's own evaluator of one box. Nothing is said by either.
# Packages: globox 2.9.0, pycocotools 2.0.11, numpy 2.4.6.
# Data: pictures with one made-up face in each, written here.
# Output seen:
#   1 faces, ids from 0: AP 0.0, from 1: AP 1.0
#   2 faces, ids from 0: AP 0.252, from 1: AP 1.0
#   4 faces, ids from 0: AP 0.564, from 1: AP 1.0
#   100 faces, ids from 0: AP 0.98, from 1: AP 1.0
#   globox's own AP of one face: 1.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check globox==2.9.0 pycocotools==2.0.11 numpy==2.4.6
env/bin/python - <<'PYTHON'
import contextlib
import io
import json
import sys
from pathlib import Path

import globox
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval


def faces(count, **confidence):
    return globox.AnnotationSet(
        globox.Annotation(
            image_id=f"{k:03d}.png",
            image_size=(640, 480),
            boxes=[globox.BoundingBox(label="face", xmin=100, ymin=50, xmax=140, ymax=110, **confidence)],
        )
        for k in range(count)
    )


def measured(annotations, path):
    Path(path).write_text(json.dumps(annotations))
    keys = ("image_id", "category_id", "bbox")
    results = [{key: one[key] for key in keys} | {"score": 0.9} for one in annotations["annotations"]]
    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO(path)
        judge = COCOeval(truth, truth.loadRes(results), "bbox")
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    return round(float(judge.stats[0]), 3)


found = []
for count in (1, 2, 4, 100):
    faces(count).save_coco("theirs.json", auto_ids=True)
    theirs = json.loads(Path("theirs.json").read_text())
    first = min(one["id"] for one in theirs["annotations"])
    moved = theirs | {"annotations": [one | {"id": one["id"] + 1} for one in theirs["annotations"]]}
    found.append((first, measured(theirs, "zero.json"), measured(moved, "one.json")))
    print(f"{count} faces, ids from {first}: AP {found[-1][1]}, from {first + 1}: AP {found[-1][2]}")
own = float(globox.COCOEvaluator(ground_truths=faces(1), predictions=faces(1, confidence=0.9)).ap())
print(f"globox's own AP of one face: {own}")
sys.exit(found != [(0, 0.0, 1.0), (0, 0.252, 1.0), (0, 0.564, 1.0), (0, 0.98, 1.0)] or own != 1)
PYTHON
