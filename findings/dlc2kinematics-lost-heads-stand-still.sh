#!/usr/bin/env bash
# A head that nobody sees for a second stands still in that second, and is slower on the whole.
#
# Found: compute_speed of dlc2kinematics 0.0.7 sums the squares of the velocities in x and y over the cells that have a number. In
# DeepLabCut's tables a point that is not seen has empty cells; a frame without any has the sum 0, so the speed of a lost head is
# 0, as that of a head at rest, and not unknown. The smoothing takes one frame on each side, too, where the head is seen and
# moves. compute_velocity, of the same table, has nan in all of them. A mean, a share of rest or a threshold for
# stillness counts losses as rest: here 5 pixels a frame are 3 on average, and 40 of 100 frames are still.
# Nothing is said of it. Take the root of the squares of compute_velocity yourself.
# Packages: dlc2kinematics 0.0.7, pandas 2.3.3, numpy 1.24.4, scipy 1.15.3, scikit-learn 1.2.1, umap-learn 0.5.7, tables 3.11.1.
# Data: a nose that moves by 3 and 4 pixels a frame, lost in frames 20 to 39 and 60 to 75, written here as DeepLabCut's HDF5.
# Output seen:
#   lost 36 frames: velocity unknown 40, speed unknown 0, speed 0 in 40
#   frames 17 to 22: speed [5.0, 5.0, 0.0, 0.0, 0.0, 0.0], by velocity [5.0, 5.0, nan, nan, nan, nan]
#   mean speed 3.0, by velocity 5.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check numpy==1.24.4 scipy==1.15.3 scikit-learn==1.2.1 umap-learn==0.5.7
env/bin/pip install --quiet --disable-pip-version-check dlc2kinematics==0.0.7 pandas==2.3.3 tables==3.11.1
env/bin/python - <<'PYTHON'
import sys
import warnings
from unittest.mock import MagicMock

warnings.simplefilter("ignore")
sys.modules["umap"] = MagicMock()  # compiled for minutes, and not used here
import dlc2kinematics
import numpy as np
import pandas as pd

frames = np.arange(100)
table = np.column_stack([3.0 * frames, 4.0 * frames, np.ones(100)])
lost = ((frames >= 20) & (frames < 40)) | ((frames >= 60) & (frames < 76))
table[lost] = np.nan
names = pd.MultiIndex.from_product([["tracker"], ["nose"], ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"])
pd.DataFrame(table, columns=names).to_hdf("clip.h5", key="df_with_missing", mode="w")
clip, parts, scorer = dlc2kinematics.load_data("clip.h5")
velocity = dlc2kinematics.compute_velocity(clip, ["all"])[scorer, "nose"]
speed = dlc2kinematics.compute_speed(clip, ["all"])[scorer, "nose", "speed"].to_numpy().round(6)
right = np.hypot(velocity["x"], velocity["y"]).to_numpy().round(6)
counts = int(np.isnan(right).sum()), int(np.isnan(speed).sum()), int((speed == 0).sum())
print(f"lost {lost.sum()} frames: velocity unknown {counts[0]}, speed unknown {counts[1]}, speed 0 in {counts[2]}")
print(f"frames 17 to 22: speed {speed[17:23].tolist()}, by velocity {right[17:23].tolist()}")
means = round(float(speed.mean()), 1), round(float(np.nanmean(right)), 1)
print(f"mean speed {means[0]}, by velocity {means[1]}")
sys.exit(counts != (40, 0, 40) or not np.array_equal(speed, np.nan_to_num(right)) or means != (3, 5))
PYTHON
