#!/usr/bin/env bash
# A face that has left the picture is there again, and frame 30 becomes frame 1.
#
# Found: CVAT's XML for video has a box for each frame of a track; outside="1" says that the object is not in the picture
# there, and the box is where it was last. datumaro 1.13.12 keeps the word as an attribute, and writes these boxes into
# MOT with visibility 1 and into COCO like any other: a face that leaves for 5 of 25 frames has 25 boxes, and a tracker
# that rightly has none there misses five. Points have visibility 2, seen, in COCO, also those that are outside or
# occluded. Frames without any box are no items for it, and MOT's frame numbers are counted over the items: of a clip
# whose first face comes in frame 30, and which has nobody in frames 40 to 49, frames 30, 39 and 50 become 1, 10 and 11,
# and boxes are compared with those of other pictures. The true frame is in item.attributes["frame"]. Nothing is said.
# Drop what is outside, and write MOT by that number, or let a program read the XML that knows it.
# Packages: datumaro 1.13.12.
# Data: XML of one made-up face, and of a nose, written here.
# Output seen:
#   in the XML: frames 30 to 39 and 50 to 64, outside in 35 to 39
#   in MOT: 25 boxes in frames 1 to 25, visibility 1.0; the boxes of frames 30, 39, 50 are in frames 1, 10, 11
#   in COCO: 25 boxes, of them outside 5
#   points seen, occluded, outside: visibility in COCO 2, 2, 2
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check datumaro==1.13.12
env/bin/python - <<'PYTHON'
import json
import logging
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
from datumaro import Dataset

FRAMES = [*range(30, 40), *range(50, 65)]
OUTSIDE = range(35, 40)
HEAD = """<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version><meta><task><id>1</id><name>clip</name><size>80</size><mode>interpolation</mode>
<start_frame>0</start_frame><stop_frame>79</stop_frame>
<labels><label><name>face</name><attributes></attributes></label></labels>
<original_size><width>640</width><height>480</height></original_size></task></meta><track id="0" label="face">"""
boxes = "".join(
    f'<box frame="{k}" xtl="{100 + min(k, 35 if k < 40 else k)}" ytl="50" xbr="{140 + min(k, 35 if k < 40 else k)}" '
    f'ybr="100" outside="{int(k in OUTSIDE)}" occluded="0" keyframe="{int(k in (30, 35, 50))}"></box>'
    for k in FRAMES
)
Path("cvat").mkdir()
Path("cvat/annotations.xml").write_text(HEAD + boxes + "</track></annotations>")
print("in the XML: frames 30 to 39 and 50 to 64, outside in 35 to 39")
read = Dataset.import_from("cvat", "cvat")
read.export("mot", "mot_seq_gt")
(path,) = Path("mot").rglob("gt.txt")
rows = [[float(cell) for cell in line.split(",")] for line in path.read_text().splitlines()]
numbers, visible = [int(row[0]) for row in rows], {row[8] for row in rows}
# the order of the rows is that of the frames; the place says so where the face moves
order = [row[2] for row in rows] == [100 + min(k, 35 if k < 40 else k) for k in FRAMES]
where = [numbers[FRAMES.index(k)] for k in (30, 39, 50)] if order else None
print(f"in MOT: {len(rows)} boxes in frames {numbers[0]} to {numbers[-1]}, visibility {min(visible)};", end=" ")
print(f"the boxes of frames 30, 39, 50 are in frames {', '.join(map(str, where or []))}")
read.export("coco", "coco_instances")
(path,) = Path("coco").rglob("*.json")
coco = json.loads(path.read_text())
frames = {image["id"]: int(Path(image["file_name"]).stem.split("_")[-1]) for image in coco["images"]}
outside = sum(frames[box["image_id"]] in OUTSIDE for box in coco["annotations"])
print(f"in COCO: {len(coco['annotations'])} boxes, of them outside {outside}")
nose = "".join(
    f'<points frame="{k}" keyframe="1" outside="{int(k == 2)}" occluded="{int(k == 1)}" points="{10 + k},20"></points>'
    for k in range(3)
)
Path("nose").mkdir()
Path("nose/annotations.xml").write_text(HEAD.replace("face", "nose") + nose + "</track></annotations>")
Dataset.import_from("nose", "cvat").export("points", "coco_person_keypoints")
(path,) = Path("points").rglob("*.json")
points = [one["keypoints"][2] for one in json.loads(path.read_text())["annotations"]]
print(f"points seen, occluded, outside: visibility in COCO {', '.join(map(str, points))}")
sys.exit((len(rows), visible, where, len(coco["annotations"]), outside, points) != (25, {1.0}, [1, 10, 11], 25, 5, [2, 2, 2]))
PYTHON
