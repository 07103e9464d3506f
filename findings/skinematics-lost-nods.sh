#!/usr/bin/env bash
# A nod of one sign has no Euler angles, and a head that looks back looks ahead.
#
# Found: scikit-kinematics 0.10.4 takes a rotation apart into angles in two places, which are said to give the same.
# rotmat.sequence(R, "Euler") asks whether the signed angle of the nod is small, not its size, so that each nod of one sign is
# taken for none: Rz(30) Rx(-20) Rz(10) gives 0, 0, 39.3 degrees, while Rz(30) Rx(20) Rz(10) gives 30, 20, 10. From quaternions
# quat.quat2seq gives 150, 20, 10 for the second: put together again that is 120 degrees off. Its default,
# yaw, pitch and roll, takes an arcsine: yaw 150, pitch 20, roll 10 comes back as 30, 20, 10, where rotmat.sequence has 150.
# Of Helmholtz' angles, rotmat.sequence gives the second first. Nothing is said. scipy's Rotation has all of them right.
# Packages: scikit-kinematics 0.10.4, numpy 2.4.6, scipy 1.17.1, sympy 1.14.0, pandas 3.1.1, matplotlib 3.11.2.
# Data: rotations whose angles are known, made here.
# Output seen:
#   Euler (30, 20, 10) matrix [30.0, 20.0, 10.0] off by 0.0
#   Euler (30, 20, 10) quaternion [150.0, 20.0, 10.0] off by 120.0
#   Euler (30, 20, 10) scipy [30.0, 20.0, 10.0] off by 0.0
#   Euler (30, -20, 10) matrix [0.0, 0.0, 39.3] off by 20.0
#   Euler (30, -20, 10) quaternion [-30.0, 20.0, -170.0] off by 120.0
#   Euler (30, -20, 10) scipy [-150.0, 20.0, -170.0] off by 0.0
#   Fick (30, 20, 10) matrix [30.0, 20.0, 10.0] off by 0.0
#   Fick (30, 20, 10) quaternion [30.0, 20.0, 10.0] off by 0.0
#   Fick (30, 20, 10) scipy [30.0, 20.0, 10.0] off by 0.0
#   Fick (150, 20, 10) matrix [150.0, 20.0, 10.0] off by 0.0
#   Fick (150, 20, 10) quaternion [30.0, 20.0, 10.0] off by 120.0
#   Fick (150, 20, 10) scipy [150.0, 20.0, 10.0] off by 0.0
#   Helmholtz (20, 30, 10) matrix [30.0, 20.0, 10.0] off by 14.1
#   Helmholtz (20, 30, 10) quaternion [20.0, 30.0, 10.0] off by 0.0
#   Helmholtz (20, 30, 10) scipy [20.0, 30.0, 10.0] off by 0.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check scikit-kinematics==0.10.4 numpy==2.4.6 scipy==1.17.1 sympy==1.14.0 pandas==3.1.1 matplotlib==3.11.2
env/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from scipy.spatial.transform import Rotation
    from skinematics import quat, rotmat

seen = []
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for name, axes, angles in (
        ("Euler", "zxz", (30, 20, 10)),
        ("Euler", "zxz", (30, -20, 10)),
        ("Fick", "zyx", (30, 20, 10)),
        ("Fick", "zyx", (150, 20, 10)),
        ("Helmholtz", "yzx", (20, 30, 10)),
    ):
        matrix = np.linalg.multi_dot([rotmat.R(axis, angle) for axis, angle in zip(axes, angles)])
        ways = {
            "matrix": np.degrees(rotmat.sequence(matrix, name)),
            "quaternion": quat.quat2seq(rotmat.convert(matrix, "quat"), name)[0],
            "scipy": Rotation.from_matrix(matrix).as_euler(axes.upper(), degrees=True),
        }
        for way, found in ways.items():
            off = np.degrees((Rotation.from_matrix(matrix).inv() * Rotation.from_euler(axes.upper(), found, degrees=True)).magnitude())
            row = [round(float(angle), 1) + 0.0 for angle in (*found, off)]
            seen.append(row)
            print(name, angles, way, row[:3], "off by", row[3])
expected = [
    [30.0, 20.0, 10.0, 0.0],
    [150.0, 20.0, 10.0, 120.0],
    [30.0, 20.0, 10.0, 0.0],
    [0.0, 0.0, 39.3, 20.0],
    [-30.0, 20.0, -170.0, 120.0],
    [-150.0, 20.0, -170.0, 0.0],
    [30.0, 20.0, 10.0, 0.0],
    [30.0, 20.0, 10.0, 0.0],
    [30.0, 20.0, 10.0, 0.0],
    [150.0, 20.0, 10.0, 0.0],
    [30.0, 20.0, 10.0, 120.0],
    [150.0, 20.0, 10.0, 0.0],
    [30.0, 20.0, 10.0, 14.1],
    [20.0, 30.0, 10.0, 0.0],
    [20.0, 30.0, 10.0, 0.0],
]
sys.exit(seen != expected or bool(said))
PYTHON
