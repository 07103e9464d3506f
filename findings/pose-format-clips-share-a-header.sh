#!/usr/bin/env bash
# A clip of 1920x1080 pixels is read as one of 60x80, since another clip was cropped before.
#
# Found: pose-format 0.15.0 (.pose, sign language) keeps the header of the last file that it read, and gives the same object to
# every file whose header has the same bytes, as those of the clips of one recording have. focus(), which moves the points to 0
# and makes the frame as large as they need, changes the object: the clips read before have that size from then on, and each
# clip read later, whose points are where they were. What is divided by width and height is wrong, and write() puts the
# wrong size into the file for good. copy() does not help, it shares the header, too. After a file with another header all is
# right again, so that it depends on the order of the files. Nothing is said.
# Read, then copy.deepcopy, then focus; or call PoseHeaderCache.clear_cache() before each read.
# Packages: pose-format 0.15.0, numpy 2.4.6, scipy 1.17.1.
# Data: two clips of a face with two points, made here.
# Output seen:
#   first clip: 1920x1080, nose at 0.50 0.50
#   after the second was focused: first clip 60x80, nose at 16.00 6.75
#   first clip read again: 60x80, points as before True; written and read: 60x80
#   second clip copied, copy focused: second clip 60x80
#   after clear_cache: first clip 1920x1080
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pose-format==0.15.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from pose_format import Pose
from pose_format.numpy import NumPyPoseBody
from pose_format.pose_header import PoseHeader, PoseHeaderCache, PoseHeaderComponent, PoseHeaderDimensions


def save(pose, name):
    with open(name, "wb") as file:
        pose.write(file)


def made(nose, chin):
    face = PoseHeaderComponent("FACE", ["nose", "chin"], [(0, 1)], [(255, 0, 0)], "XYC")
    places = np.ma.masked_array(np.tile(np.array([nose, chin], np.float32), (25, 1, 1, 1)), mask=False)
    header = PoseHeader(0.2, PoseHeaderDimensions(1920, 1080), [face])
    return Pose(header, NumPyPoseBody(25, places, np.ones((25, 1, 2), np.float32)))


def read(name):
    return Pose.read(Path(name).read_bytes())


def size(pose):
    return f"{pose.header.dimensions.width}x{pose.header.dimensions.height}"


def nose(pose):
    x, y = pose.body.data[0, 0, 0].tolist()
    return f"{x / pose.header.dimensions.width:.2f} {y / pose.header.dimensions.height:.2f}"


save(made((960, 540), (980, 600)), "first.pose")
save(made((400, 300), (460, 380)), "second.pose")
first = read("first.pose")
before = size(first), nose(first)
print(f"first clip: {before[0]}, nose at {before[1]}")
second = read("second.pose")
second.focus()
after = size(first), nose(first)
print(f"after the second was focused: first clip {after[0]}, nose at {after[1]}")
again = read("first.pose")
same = np.array_equal(again.body.data, first.body.data)
save(again, "again.pose")
PoseHeaderCache.clear_cache()
sizes = size(again), size(read("again.pose"))
print(f"first clip read again: {sizes[0]}, points as before {same}; written and read: {sizes[1]}")
PoseHeaderCache.clear_cache()
second = read("second.pose")
second.copy().focus()
copied = size(second)
print(f"second clip copied, copy focused: second clip {copied}")
PoseHeaderCache.clear_cache()
cleared = size(read("first.pose"))
print(f"after clear_cache: first clip {cleared}")
wrong = after == ("60x80", "16.00 6.75") and same and sizes == ("60x80", "60x80") and copied == "60x80"
sys.exit(before != ("1920x1080", "0.50 0.50") or not wrong or cleared != "1920x1080")
PYTHON
