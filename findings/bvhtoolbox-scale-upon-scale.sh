#!/usr/bin/env bash
# In metres the head is at the hips, and no longer moves.
#
# Found: bvh2csv of bvhtoolbox 0.1.3 writes the places of joints from a BVH file, the skeletons of motion capture. Its option
# --scale is "in case you have to switch from centimeters to meters": with .01 every number should be a hundredth of that
# without it. It is for the root alone. A joint's place is made from that of its parent, which is scaled already, and scaled
# once more: the hips' part is multiplied by .01 for the hips, by .0001 for the chest, by a hundred-millionth for the head.
# A head at 1, 1.65 m is at 0, .15 m, which is its distance from the neck, and its way of 10 cm is .0000 m. The columns look
# like metres, and nothing is said. Take the places in centimetres and divide them.
# Packages: bvhtoolbox 0.1.3, numpy 2.4.6, transforms3d 0.4.2.
# Data: a skeleton of four joints that goes 10 cm to the right in two frames, written here.
# Output seen:
#   cm, frame 0: Hips 100, 90; Chest 100, 130; Neck 100, 150; Head 100, 165
#   cm, frame 1: Hips 110, 90; Chest 110, 130; Neck 110, 150; Head 110, 165
#   --scale .01, frame 0: Hips 1, 0.9; Chest 0.01, 0.409; Neck 0.0001, 0.20409; Head 0, 0.15204
#   --scale .01, frame 1: Hips 1.1, 0.9; Chest 0.011, 0.409; Neck 0.00011, 0.20409; Head 0, 0.15204
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check bvhtoolbox==0.1.3 numpy==2.4.6 transforms3d==0.4.2
env/bin/python - <<'PYTHON'
import csv
import subprocess
import sys
from pathlib import Path

JOINTS = {"Hips": 0, "Chest": 40, "Neck": 20, "Head": 15}
lines = ["HIERARCHY"]
for k, (name, above) in enumerate(JOINTS.items()):
    turns = "Zrotation Xrotation Yrotation"
    lines += [f"{'JOINT' if k else 'ROOT'} {name}", "{", f"OFFSET 0 {above} 0"]
    lines.append(f"CHANNELS 3 {turns}" if k else f"CHANNELS 6 Xposition Yposition Zposition {turns}")
lines += ["End Site", "{", "OFFSET 0 20 0", "}", *"}}}}", "MOTION", "Frames: 2", "Frame Time: 0.04"]
lines += [" ".join(map(str, [x, 90, *[0] * 13])) for x in (100, 110)]
Path("walk.bvh").write_text("\n".join(lines) + "\n")

seen = {}
for title, options in (("cm", []), ("--scale .01", ["--scale", ".01"])):
    command = [str(Path(sys.executable).with_name("bvh2csv")), "--position", *options, "walk.bvh"]
    subprocess.run(command, capture_output=True)  # it returns 1 when it was successful
    with open("walk_pos.csv") as file:
        rows = list(csv.DictReader(file))
    for number, row in enumerate(rows):
        places = {name: (float(row[f"{name}.x"]), float(row[f"{name}.y"])) for name in JOINTS}
        seen[title, number] = list(places.values())
        print(f"{title}, frame {number}: " + "; ".join(f"{name} {x:g}, {y:g}" for name, (x, y) in places.items()))
    Path("walk_pos.csv").unlink()
sys.exit(
    seen
    != {
        ("cm", 0): [(100, 90), (100, 130), (100, 150), (100, 165)],
        ("cm", 1): [(110, 90), (110, 130), (110, 150), (110, 165)],
        ("--scale .01", 0): [(1, 0.9), (0.01, 0.409), (0.0001, 0.20409), (0, 0.15204)],
        ("--scale .01", 1): [(1.1, 0.9), (0.011, 0.409), (0.00011, 0.20409), (0, 0.15204)],
    }
)
PYTHON
