#!/usr/bin/env bash
# A marker that goes too far comes back from the other side, and each copy of a file is a little nearer to 0.
#
# Found: many C3D files hold places of markers as whole numbers of 16 bits and a scale, the step in millimetres. c3d 0.6.0 writes such
# files where point_scale is positive, as it is in a Writer.from_reader of such a file. It cuts off what is behind the point
# instead of rounding it, so that a place is up to a step nearer to 0, on both sides. A file that is read and written again with
# nothing changed should stay: with steps of .07 nearly 4 of 100 places are others after five copies, all nearer to 0, by up to
# .35, and with other scales others, since k * .07 / .07 is at times a bit less than k. Beyond 32,767 steps a place has the
# other sign, and a lost marker, nan, is at 0, 0, 0 and valid (residual 0), where a file of floats has it as lost (residual -1).
# Nothing is said. Write floats, the default of a Writer of your own.
# Packages: c3d 0.6.0, numpy 2.4.6.
# Data: markers written here.
# Output seen:
#   9.96 and -9.96 in steps of .1: [9.9, -9.9]
#   five copies in steps of .07: 3.8 % of places are others, by 0.07 to 0.35 nearer to 0
#   300, 327.6, 330 and 400 in steps of .01: [300.0, 327.6, -325.36, -255.36]
#   a lost marker in steps of .1: [0.0, 0.0, 0.0], residual 0
#   a lost marker in floats: [0.0, 0.0, 0.0], residual -1
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check c3d==0.6.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import c3d
import numpy as np


def write(places, scale):
    writer = c3d.Writer(point_rate=25.0, analog_rate=25.0, point_scale=scale)
    for x in places:
        points = np.zeros((1, 5), np.float32)
        points[0, :3] = x
        writer.add_frames([(points, np.zeros((0, 1)))])
    writer.set_point_labels(["lip"])
    with open("lip.c3d", "wb") as file:
        writer.write(file)


def read():
    with open("lip.c3d", "rb") as file:
        return np.array([points[0] for _, points, _ in c3d.Reader(file).read_frames()])


def copy():
    with open("lip.c3d", "rb") as file:
        writer = c3d.Writer.from_reader(c3d.Reader(file), "copy")
    with open("lip.c3d", "wb") as file:
        writer.write(file)


def across():
    return [round(float(x), 2) for x in read()[:, 0]]


write([9.96, -9.96], 0.1)
cut = across()
print(f"9.96 and -9.96 in steps of .1: {cut}")
write(np.arange(1000) * 0.07 + 0.035, 0.07)
first = read()[:, 0]
for _ in range(5):
    copy()
off = first - read()[:, 0]
other = off[abs(off) > 0.01]
copies = [round(float(v), 2) for v in (len(other) / 10, other.min(), other.max())]
print(f"five copies in steps of .07: {copies[0]} % of places are others, by {copies[1]} to {copies[2]} nearer to 0")
write([300, 327.6, 330, 400], 0.01)
far = across()
print(f"300, 327.6, 330 and 400 in steps of .01: {far}")
lost = []
for title, scale in (("steps of .1", 0.1), ("floats", -1.0)):
    write([10, np.nan], scale)
    lost.append(read()[1, :4].tolist())
    print(f"a lost marker in {title}: {lost[-1][:3]}, residual {lost[-1][3]:.0f}")
there = far[:2] == [300, 327.6] and min(330 - far[2], 400 - far[3]) > 1
sys.exit(cut != [9.9, -9.9] or copies != [3.8, 0.07, 0.35] or not there or lost != [[0, 0, 0, 0], [0, 0, 0, -1]])
PYTHON
