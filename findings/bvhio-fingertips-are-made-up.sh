#!/usr/bin/env bash
# A thumb and a finger that touch are apart once the file has been read and written.
#
# Found: in a BVH file the last joint of a finger, or of a head, has an "End Site": where the tip, or the top, is. In the hierarchy
# that bvhio 1.5.4 reads to be changed (readAsHierarchy) no joint holds it, and what writeHierarchy writes in its place is made up:
# 0.3 times the length from the joint before, in the direction of that. A tip 22 mm after its joint is 7.5 mm after it, and
# the tip of a thumb, 62 mm to the side, goes straight on by 18: a thumb and a finger that touch are 42.5 mm apart, and a head is as
# tall as .3 of a neck. Joints are where they were, so that nothing else shows it. bvh-converter measures it in all files.
# readAsBvh and writeBvh of the same package keep it. Nothing is said. Give each tip a joint of its own, or use the latter.
# Packages: bvhio 1.5.4, bvh-converter 1.0.2, numpy 2.4.6, transforms3d 0.4.2.
# Data: a made-up hand of a thumb and a finger, in mm, written here as .bvh.
# Output seen:
#   as it is: finger joint 145.0, tip 167.0, thumb joint 120.0, tip 167.0 mm high, tips apart by 0.0
#   readAsBvh: finger joint 145.0, tip 167.0, thumb joint 120.0, tip 167.0 mm high, tips apart by 0.0
#   readAsHierarchy: finger joint 145.0, tip 152.5, thumb joint 120.0, tip 138.0 mm high, tips apart by 42.5
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check bvhio==1.5.4 bvh-converter==1.0.2 numpy==2.4.6 transforms3d==0.4.2
cat > hand.bvh <<'BVH'
HIERARCHY
ROOT Wrist
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Finger1
  {
    OFFSET 0 80 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Finger2
    {
      OFFSET 0 40 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      JOINT Finger3
      {
        OFFSET 0 25 0
        CHANNELS 3 Zrotation Xrotation Yrotation
        End Site
        {
          OFFSET 0 22 0
        }
      }
    }
  }
  JOINT Thumb1
  {
    OFFSET 40 60 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Thumb2
    {
      OFFSET 0 60 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET -40 47 0
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
9 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
BVH
env/bin/python - <<'PYTHON'
import csv
import math
import subprocess
import sys

import bvhio

bvhio.writeBvh("bvh.bvh", bvhio.readAsBvh("hand.bvh"))
bvhio.writeHierarchy("hierarchy.bvh", bvhio.readAsHierarchy("hand.bvh"), 1 / 30)
seen = []
for way, name in (("as it is", "hand"), ("readAsBvh", "bvh"), ("readAsHierarchy", "hierarchy")):
    subprocess.run(["env/bin/bvh-converter", f"{name}.bvh"], check=True, stdout=subprocess.DEVNULL)
    with open(f"{name}_worldpos.csv", newline="") as file:
        row = next(csv.DictReader(file))
    places = {part: [float(row[f"{part}.{axis}"]) for axis in "XYZ"] for part in ("Finger3", "Finger3End", "Thumb2", "Thumb2End")}
    apart = round(math.dist(places["Finger3End"], places["Thumb2End"]), 1)
    finger, tip, thumb, thumb_tip = (round(place[1], 1) for place in places.values())
    seen.append((finger, tip, thumb, thumb_tip, apart))
    print(f"{way}: finger joint {finger}, tip {tip}, thumb joint {thumb}, tip {thumb_tip} mm high, tips apart by {apart}")
right = (145.0, 167.0, 120.0, 167.0, 0.0)
sys.exit(seen != [right, right, (145.0, 152.5, 120.0, 138.0, 42.5)])
PYTHON
