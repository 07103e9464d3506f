#!/usr/bin/env bash
# The angle at the nose is that at the chin, if the table has the chin between the others.
#
# Found: compute_joint_angles of dlc2kinematics 0.0.7 is given three points for each angle, by its documentation as
# ["R_shoulder", "Right_elbow", "Right_wrist"], and measures the turn at the second. It picks their columns by whether their name
# is in the list, so that they stand in the order of the table: the angle is that at the point which the table happens to have
# between the other two, and all six orders of the list are one angle. Only a table in which the vertex is between the
# others, as shoulder, elbow and wrist mostly are, is right. Nothing is said: each number is an angle of the same triangle.
# The next clip then has the angles of this one: they are saved as joint_angles_SCORER.h5 in the folder of work, and where that
# exists, it is read instead (one line on the screen says that it is "already present").
# Order the columns by the list first, and give save=False. With pandas 2 it needs pcutoff=0; else it raises.
# Packages: dlc2kinematics 0.0.7, pandas 2.3.3, numpy 1.24.4, scipy 1.15.3, scikit-learn 1.2.1, umap-learn 0.5.7, tables 3.11.1.
# Data: two clips with four points of a face, in the order brow, nose, chin, ear, made here. "turn" is 180 less the angle.
# Output seen:
#   brow nose chin: 36.9, turn at nose 36.9
#   nose brow chin: 36.9, turn at brow 159.4
#   brow chin nose: 36.9, turn at chin 163.7
#   ear brow nose: 101.3, turn at brow 121.0
#   ear brow nose in the order of the list: 121.0
#   another clip, turn at nose 90.0: first asked 36.9, in another folder 90.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check numpy==1.24.4 scipy==1.15.3 scikit-learn==1.2.1 umap-learn==0.5.7
env/bin/pip install --quiet --disable-pip-version-check dlc2kinematics==0.0.7 pandas==2.3.3 tables==3.11.1
env/bin/python - <<'PYTHON'
import contextlib
import io
import os
import sys
import warnings
from unittest.mock import MagicMock

warnings.simplefilter("ignore")
sys.modules["umap"] = MagicMock()  # compiled for minutes, and not used here
import dlc2kinematics
import numpy as np
import pandas as pd

FACE = {"brow": (0, 0), "nose": (0, 40), "chin": (30, 80), "ear": (50, 30)}


def table(face):
    names = pd.MultiIndex.from_product([["tracker"], face, ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"])
    row = [float(number) for place in face.values() for number in (*place, 1)]
    return pd.DataFrame([row] * 10, columns=names)


def turn(face, *points):
    first, vertex, last = (np.array(face[point], float) for point in points)
    there, on = vertex - first, last - vertex
    return round(float(np.degrees(np.arccos(there @ on / np.linalg.norm(there) / np.linalg.norm(on)))), 1)


def angle(clip, points, **options):
    with contextlib.redirect_stdout(io.StringIO()):
        angles = dlc2kinematics.compute_joint_angles(clip, {"angle": list(points)}, pcutoff=0, **options)
    return round(float(angles["angle"].iloc[0]), 1)


clip = table(FACE)
seen = []
for points in (("brow", "nose", "chin"), ("nose", "brow", "chin"), ("brow", "chin", "nose"), ("ear", "brow", "nose")):
    seen.append((angle(clip, points, save=False), turn(FACE, *points)))
    print(f"{' '.join(points)}: {seen[-1][0]}, turn at {points[1]} {seen[-1][1]}")
ordered = angle(table({point: FACE[point] for point in points}), points, save=False)
print(f"{' '.join(points)} in the order of the list: {ordered}")
points = ("brow", "nose", "chin")
angle(clip, points)
another = {**FACE, "chin": (30, 40)}
os.mkdir("another")
clips = angle(table(another), points), angle(table(another), points, destfolder="another")
print(f"another clip, turn at nose {turn(another, *points)}: first asked {clips[0]}, in another folder {clips[1]}")
expected = [(36.9, 36.9), (36.9, 159.4), (36.9, 163.7), (101.3, 121)]
sys.exit(seen != expected or ordered != 121 or clips != (36.9, 90))
PYTHON
