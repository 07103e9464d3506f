#!/usr/bin/env bash
# Of a recording of 39 minutes the last two and a half are gone.
#
# Found: C3D, the file of motion capture, counts its last frame with 16 bits; longer files say it elsewhere too (the
# groups POINT and TRIAL). ezc3d 1.7.2 writes 70,000 frames, 38.9 minutes at 30 frames/s, without a word; all of
# them are in the file, and read back it has 65,535. py-c3d 0.6.0 finds no frame at all in that file (with a
# warning). The other way round, of 70,000 frames that py-c3d wrote and reads back, ezc3d makes 70,016: the file's
# last block is filled up with zeros, which become 16 frames in which each marker is at 0, 0, 0. Up to 65,534 frames
# both are right.
# Packages: ezc3d 1.7.2, c3d 0.6.0, numpy 2.4.6.
# Data: a marker whose x is the number of its frame, made here.
# Output seen:
#   65534 frames, all in the file True; frames and last x by ezc3d and by c3d: of ezc3d's file (65534, 65533.0) and
#       (65534, 65533.0), of c3d's file (65534, 65533.0) and (65534, 65533.0)
#   70000 frames, all in the file True; frames and last x by ezc3d and by c3d: of ezc3d's file (65535, 65534.0) and
#       (0, None), of c3d's file (70016, 0.0) and (70000, 69999.0)
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check ezc3d==1.7.2 c3d==0.6.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
import c3d
import ezc3d
import numpy as np


def by_ezc3d(path):
    x = ezc3d.c3d(path)["data"]["points"][0, 0]
    return x.size, float(x[-1])


def by_c3d(path):
    with open(path, "rb") as file:
        x = [float(points[0, 0]) for _, points, _ in c3d.Reader(file).read_frames()]
    return len(x), x[-1] if x else None


def seen(count):
    ours = ezc3d.c3d()
    ours["parameters"]["POINT"]["RATE"]["value"] = [30.0]
    ours["parameters"]["POINT"]["LABELS"]["value"] = ["nose"]
    points = np.ones((4, 1, count))
    points[0, 0] = np.arange(count)
    ours["data"]["points"] = points
    ours.write("one.c3d")
    other = c3d.Writer(point_rate=30.0)
    other.set_point_labels(["nose"])
    none = np.zeros((0, 0))
    other.add_frames([(np.array([[k, 1, 1, 0, 1]], np.float32), none) for k in range(count)])
    with open("other.c3d", "wb") as file:
        other.write(file)
    found = [read(path) for path in ("one.c3d", "other.c3d") for read in (by_ezc3d, by_c3d)]
    whole = Path("one.c3d").stat().st_size >= 16 * count  # bytes: x, y, z and the residual of each frame
    print(f"{count} frames, all in the file {whole}; frames and last x by ezc3d and by c3d: of ezc3d's file", end=" ")
    print(f"{found[0]} and {found[1]}, of c3d's file {found[2]} and {found[3]}")
    return found if whole else None


few, many = seen(65_534), seen(70_000)
sys.exit(few != [(65_534, 65_533)] * 4 or many != [(65_535, 65_534), (0, None), (70_016, 0), (70_000, 69_999)])
PYTHON
