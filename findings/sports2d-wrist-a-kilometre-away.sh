#!/usr/bin/env bash
# The right hand of everybody who is seen from behind is a kilometre away.
#
# Found: Sports2D 0.8.34 measures people in a video in metres. How near each joint is to the camera it takes from a table, by
# which side of a person is seen. For the right wrist, seen from behind, the table says -1076.0002 m, where the left one has
# -0.1076. So z of that wrist is -1,076 m in the TRC, and since x and y are corrected for the distance, it is 61 m to the side
# and 25 m up where it should be .3 and 1.4 m. All other joints and sides are right, and so are pixels. Nothing is said. Put
# -0.1076 into marker_Z_positions, or say visible_side = "none" of people who are seen from behind.
# Packages: Sports2D 0.8.34 without what finds people, pandas 2.3.3, numpy 2.4.6.
# Data: wrists of somebody of 1.7 m and 600 pixels, 5 m from a camera of 1920x1080, made here.
# Output seen:
#   front: right wrist x 0.28, y 1.41, z 0.11; left wrist x 0.28, y 1.41, z 0.11
#   back: right wrist x 61.26, y 25.81, z -1076.00; left wrist x 0.29, y 1.42, z -0.11
#   right: right wrist x 0.28, y 1.41, z 0.12; left wrist x 0.29, y 1.42, z -0.12
#   none: right wrist x 0.28, y 1.42, z 0.00; left wrist x 0.28, y 1.42, z 0.00
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pandas==2.3.3 numpy==2.4.6
env/bin/pip install --quiet --disable-pip-version-check --no-deps sports2d==0.8.34
env/bin/python -W ignore - <<'PYTHON'
import sys
from unittest.mock import MagicMock

ABSENT = """cv2 av tqdm anytree matplotlib matplotlib.widgets matplotlib.pyplot rtmlib rtmlib.tools rtmlib.tools.object_detection
rtmlib.tools.object_detection.post_processings Pose2Sim Pose2Sim.common Pose2Sim.skeletons Pose2Sim.calibration Pose2Sim.poseEstimation
Pose2Sim.triangulation Pose2Sim.personAssociation Pose2Sim.filtering"""
for name in ABSENT.split():
    sys.modules[name] = MagicMock()  # networks that find people, and windows, which are not used here
sys.modules["Pose2Sim.common"].thickness = 1
import numpy as np
import pandas as pd
from Sports2D.process import convert_px_to_meters

seen = []
for side in ("front", "back", "right", "none"):
    told = []
    for name in ("RWrist", "LWrist"):
        pixels = pd.DataFrame([[1060.0, 500.0, 0.0]], columns=[name] * 3)
        metres = convert_px_to_meters(pixels, 1.7, 600, 5.0, 1920, 1080, 960, 1000, 0.0, visible_side=side)
        told.append(tuple(round(float(number), 2) for number in metres.to_numpy()[0]))
    seen.append(told)
    right, left = ("x {:.2f}, y {:.2f}, z {:.2f}".format(*place) for place in told)
    print(f"{side}: right wrist {right}; left wrist {left}")
near, far = (0.28, 1.41), (0.29, 1.42)
expected = [
    [(*near, 0.11), (*near, 0.11)], [(61.26, 25.81, -1076), (*far, -0.11)], [(*near, 0.12), (*far, -0.12)], [(0.28, 1.42, 0), (0.28, 1.42, 0)],
]
sys.exit(seen != expected)
PYTHON
