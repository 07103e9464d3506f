#!/usr/bin/env bash
# The angles of a rotation matrix are those of the opposite turn.
#
# Found: ahrs 0.4.0 has quaternions and matrices. Quaternion(rpy=...) with roll 10, pitch 20 and yaw 30 degrees gives by
# to_DCM() the matrix Rz(30) Ry(20) Rx(10), and Quaternion(dcm=matrix).to_angles() finds 10, 20, 30 in it. The matrix
# class of the same package, DCM(matrix).to_rpy(), as to_angles(), says 1.1, -22.2, -28.5: it is the transposed matrix's.
# A head that only turns by 30 degrees is turned by -30; with one axis alone only the sign is wrong, with several the size,
# too. DCM(rpy=...) takes the first angle about z and the last about x, so that the class does not give back what it
# was made from: 10, 20, 30 becomes -28.5, -22.2, 1.1. Head pose comes as a matrix from solvePnP or MediaPipe, and left
# becomes right. Nothing is said. Go by way of Quaternion(dcm=matrix).to_angles().
# Packages: ahrs 0.4.0, numpy 2.4.6.
# Data: made-up angles.
# Output seen:
#   roll 10, pitch 20, yaw 30: quaternion [10.0, 20.0, 30.0], matrix [1.1, -22.2, -28.5]; it is Rz Ry Rx True
#   roll 30, pitch 0, yaw 0: quaternion [30.0, 0.0, 0.0], matrix [-30.0, 0.0, 0.0]; it is Rz Ry Rx True
#   roll 0, pitch 30, yaw 0: quaternion [0.0, 30.0, 0.0], matrix [0.0, -30.0, 0.0]; it is Rz Ry Rx True
#   roll 0, pitch 0, yaw 30: quaternion [0.0, 0.0, 30.0], matrix [0.0, 0.0, -30.0]; it is Rz Ry Rx True
#   DCM(rpy=10, 20, 30): [-28.5, -22.2, 1.1]; it is Rz(10) Ry(20) Rx(30) True
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check ahrs==0.4.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys

import numpy as np
from ahrs import DCM, Quaternion


def turns(roll, pitch, yaw):
    (a, b, c), (d, e, f) = np.cos(np.radians([roll, pitch, yaw])), np.sin(np.radians([roll, pitch, yaw]))
    x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    return x, y, np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])


def degrees(angles):
    return [round(float(v), 1) + 0.0 for v in np.degrees(angles)]


seen = []
for angles in ([10, 20, 30], [30, 0, 0], [0, 30, 0], [0, 0, 30]):
    x, y, z = turns(*angles)
    matrix = Quaternion(rpy=np.radians(angles)).to_DCM()
    same = bool(np.allclose(matrix, z @ y @ x))
    found = [degrees(Quaternion(dcm=matrix).to_angles()), degrees(DCM(matrix).to_rpy())]
    seen.append((found[0] == angles, found[1], same))
    said = "quaternion {}, matrix {}".format(*found)
    print("roll {}, pitch {}, yaw {}: {}; it is Rz Ry Rx {}".format(*angles, said, same))
x, y, z = turns(30, 20, 10)
made = DCM(rpy=np.radians([10, 20, 30]))
back, order = degrees(made.to_rpy()), bool(np.allclose(made, z @ y @ x))
print(f"DCM(rpy=10, 20, 30): {back}; it is Rz(10) Ry(20) Rx(30) {order}")
sys.exit(
    seen
    != [
        (True, [1.1, -22.2, -28.5], True),
        (True, [-30, 0, 0], True),
        (True, [0, -30, 0], True),
        (True, [0, 0, -30], True),
    ]
    or (back, order) != ([-28.5, -22.2, 1.1], True)
)
PYTHON
