#!/usr/bin/env bash
# A marker 10 cm left of the middle is 6.5 m right of it.
#
# Found: many C3D files hold places of markers as whole numbers of 16 bits and a scale. The numbers have signs: the format is of -32,768
# to 32,767. pupyC3D 0.1.3 ("full C3D support") reads them without signs, and a place below 0 becomes 65,536 steps more: with
# steps of .1 mm, -100 mm are 6453.6. A marker that swings through 0 jumps by 6.5 m, and its mean and its speed are nonsense. A
# lost marker's residual of -1 is 6553.5 for the same reason, so that nobody who looks for negative residuals sees that it is
# lost. Files of floats are right, and c3d 0.6.0 and ezc3d 1.7.2 read both. Nothing is said. Subtract 65536 times the scale.
# Packages: pupyC3D 0.1.3, c3d 0.6.0, ezc3d 1.7.2, numpy 2.4.6.
# Data: a marker at -100, 0 and 100 mm that is lost in the fourth frame, whose place does not count, written here by c3d.
# Output seen:
#   floats.c3d by_c3d: x [-100.0, 0.0, 100.0], residuals [0.0, 0.0, 0.0, -1.0]
#   floats.c3d by_ezc3d: x [-100.0, 0.0, 100.0], residuals [0.0, 0.0, 0.0, -1.0]
#   floats.c3d by_pupy: x [-100.0, 0.0, 100.0], residuals [0.0, 0.0, 0.0, -1.0]
#   integers.c3d by_c3d: x [-100.0, 0.0, 100.0], residuals [0.0, 0.0, 0.0, -1.0]
#   integers.c3d by_ezc3d: x [-100.0, 0.0, 100.0], residuals [0.0, 0.0, 0.0, -1.0]
#   integers.c3d by_pupy: x [6453.6, 0.0, 100.0], residuals [0.0, 0.0, 0.0, 6553.5]
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pupyC3D==0.1.3 c3d==0.6.0 ezc3d==1.7.2 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import c3d
import ezc3d
import numpy as np
from pupyC3D import C3DFile


def by_c3d(path):
    with open(path, "rb") as file:
        return np.array([points[0, :4] for _, points, _ in c3d.Reader(file).read_frames()])


def by_ezc3d(path):
    data = ezc3d.c3d(path)["data"]
    return np.column_stack([data["points"][:3, 0].T, data["meta_points"]["residuals"][0, 0]])


def by_pupy(path):
    return C3DFile(path).get_point_data("lip")


seen = {}
for path, scale in (("floats.c3d", -1.0), ("integers.c3d", 0.1)):
    writer = c3d.Writer(point_rate=25.0, analog_rate=25.0, point_scale=scale)
    for x in (-100, 0, 100, np.nan):
        points = np.zeros((1, 5), np.float32)
        points[0, 0], points[0, 3] = (0, -1) if np.isnan(x) else (x, 0)
        writer.add_frames([(points, np.zeros((0, 1)))])
    writer.set_point_labels(["lip"])
    with open(path, "wb") as file:
        writer.write(file)
    for read in (by_c3d, by_ezc3d, by_pupy):
        rows = np.asarray(read(path))
        x = [round(float(v), 1) for v in rows[:3, 0]]
        residual = [round(float(v), 1) for v in rows[:, 3]]
        seen[path, read.__name__] = x, residual
        print(f"{path} {read.__name__}: x {x}, residuals {residual}")
right, wrong = ([-100, 0, 100], [0, 0, 0, -1]), ([6453.6, 0, 100], [0, 0, 0, 6553.5])
sys.exit(any(found != (wrong if key == ("integers.c3d", "by_pupy") else right) for key, found in seen.items()))
PYTHON
