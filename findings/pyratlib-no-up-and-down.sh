#!/usr/bin/env bash
# A head that nods moves no further than one that is still, and a small shake goes as far as a large one.
#
# Found: pyratlib 0.7.7 measures DeepLabCut's tables. MotionMetrics, from which its Reports come, brings x to the scale 0
# to max_real and y to the scale 0 to min_real, which is "usually zero", by its text and by default: y is 0 in each frame,
# and all that moves up or down has no distance, speed or acceleration. x is stretched from its own smallest and largest
# value, not from the picture's, so that a nod of 40 pixels beside a sway of .5 is measured by its sway, as is one of 10,
# and a shake of 2 pixels goes as far as one of 20. With min_real as large as max_real y counts, stretched by itself, and
# the sway beside a shake goes 60 units as well. Nothing is said. Take distances from the pixels.
# Packages: pyratlib 0.7.7, pandas 3.1.1, numpy 2.4.6, scipy 1.17.1, scikit-learn 1.9.1, neo 0.14.6, matplotlib 3.11.2.
# Data: ten seconds of a made-up nose at 30 frames/s in DeepLabCut's CSV, written here.
# Output seen:
#   a shake of 20 px: 792.1 px long; distance 1193.7, with min_real 60 1340.2
#   a shake of 2 px: 80.2 px long; distance 1193.7, with min_real 60 1340.2
#   a nod of 40 px: 1583.5 px long; distance 477.5, with min_real 60 1340.2
#   a nod of 10 px: 396.4 px long; distance 477.5, with min_real 60 1340.2
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyratlib==0.7.7 pandas==3.1.1 numpy==2.4.6 scipy==1.17.1 scikit-learn==1.9.1 neo==0.14.6 matplotlib==3.11.2
env/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np
import pandas as pd
import pyratlib

warnings.simplefilter("error")
TIME = np.arange(300) / 30
SWAY = 0.5 * np.sin(2 * np.pi * 0.4 * TIME)


def measured(name, x, y):
    with open("nose.csv", "w") as file:
        file.write("scorer,made,made,made\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n")
        file.writelines(f"{k},{300 + x[k]:.4f},{200 + y[k]:.4f},1\n" for k in range(len(x)))
    table = pd.read_csv("nose.csv")
    length = np.hypot(np.diff(x), np.diff(y)).sum()
    default, both = (
        pyratlib.MotionMetrics(table, "nose", filter=1000, fps=30, max_real=60, **more)["Distance"].sum()
        for more in ({}, {"min_real": 60})
    )
    print(f"{name}: {length:.1f} px long; distance {default:.1f}, with min_real 60 {both:.1f}")
    return round(float(default)), round(float(both))


def wave(size):
    return size * np.sin(2 * np.pi * TIME)


seen = [
    measured("a shake of 20 px", wave(20), SWAY),
    measured("a shake of 2 px", wave(2), SWAY),
    measured("a nod of 40 px", SWAY, wave(40)),
    measured("a nod of 10 px", SWAY, wave(10)),
]
sys.exit(seen != [(1194, 1340), (1194, 1340), (477, 1340), (477, 1340)])
PYTHON
