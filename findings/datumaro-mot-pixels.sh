#!/usr/bin/env bash
# One MOT file, two places: one reader counts pixels from 1, the other from 0.
#
# Found: MOTChallenge counts pixels from 1, so that a box at the corner of the picture has left 1 and top 1. motmetrics
# 1.4.0 subtracts 1 when it reads a file. datumaro 1.13.0, which annotation tools use for their import and export of MOT,
# takes the numbers as they are: the same box is at 1, 1 after import, at 1, 1 in the COCO file that it makes of it, where
# pixels count from 0, and what it has at 0, 0 it writes as 0, 0 into MOT. So a box that goes from COCO to MOT by datumaro
# and is read by motmetrics is at -1, -1: each box is off by a pixel on both axes, which is an IoU of .82 for a face of
# 20 x 20 pixels.
# Packages: datumaro 1.13.0, motmetrics 1.4.0.
# Data: a box in the corner of a picture, written here.
# Output seen:
#   the file: left 1, top 1; motmetrics: [0, 0]; datumaro: [1.0, 1.0]; datumaro's COCO: [1.0, 1.0]
#   a box at 0, 0 in datumaro: in its MOT file [0.0, 0.0]; motmetrics reads [-1.0, -1.0]
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check datumaro==1.13.0 motmetrics==1.4.0
env/bin/python - <<'PYTHON'
import json
import logging
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
import motmetrics
from datumaro import AnnotationType, Bbox, Dataset, DatasetItem, LabelCategories


def by_motmetrics(path):
    return motmetrics.io.loadtxt(str(path), fmt="mot16").iloc[0][["X", "Y"]].tolist()


path = Path("mot/gt/gt.txt")
path.parent.mkdir(parents=True)
path.write_text("1,1,1,1,20,20,1,1,1\n")
read = Dataset.import_from("mot", "mot_seq")
datumaro = next(iter(read)).annotations[0].get_bbox()[:2]
read.export("coco", "coco_instances")
coco = json.loads(Path("coco/annotations/instances_default.json").read_text())["annotations"][0]["bbox"][:2]
print(f"the file: left 1, top 1; motmetrics: {by_motmetrics(path)}; datumaro: {datumaro}; datumaro's COCO: {coco}")
labels = {AnnotationType.label: LabelCategories.from_iterable(["face"])}
box = Bbox(0, 0, 20, 20, label=0, attributes={"track_id": 1})
made = Dataset.from_iterable([DatasetItem(id="1", annotations=[box])], categories=labels)
made.export("back", "mot_seq_gt")
(back,) = Path("back").rglob("gt.txt")
written = [float(cell) for cell in back.read_text().split(",")[2:4]]
print(f"a box at 0, 0 in datumaro: in its MOT file {written}; motmetrics reads {by_motmetrics(back)}")
seen = [by_motmetrics(path), list(datumaro), coco, written, by_motmetrics(back)]
sys.exit(seen != [[0, 0], [1, 1], [1, 1], [0, 0], [-1, -1]])
PYTHON
