#!/usr/bin/env bash
# Heads that look one way look everywhere, if that way is 180 degrees.
#
# Found: the omnibus test of Hodges and Ajne in pycircstat2 0.1.15 asks whether angles lie all around the circle, by the fewest
# of them on one side of a line through its centre. Lines at 0 to 180 degrees have two sides each; omnibus_test counts
# the angles on one. Around 180 degrees, where pitch lies by OpenCV's axes, angles have no line that leaves them out: 20 angles
# within 100 degrees have p = 4e-5 around 0 or 90, .11 around 150, and .96 around 170, "uniform". Where both sides
# have ten angles, p is 0: around 180 degrees, but also for 20 angles that are spread as evenly as can be, which are then
# "not uniform", without a doubt. Nothing is said. rayleigh_test does not depend on the direction, and has 1 for the latter.
# Packages: pycircstat2 0.1.15, numpy 2.4.6.
# Data: 20 angles in equal steps over 100 degrees, around several directions, and over the circle, made here.
# Output seen:
#   around 0: m = 0, p = 4e-05, Rayleigh 5e-09; by both sides m = 0
#   around 90: m = 0, p = 4e-05, Rayleigh 5e-09; by both sides m = 0
#   around 150: m = 4, p = 0.1, Rayleigh 5e-09; by both sides m = 0
#   around 170: m = 8, p = 1, Rayleigh 5e-09; by both sides m = 0
#   around 180: m = 10, p = 0, Rayleigh 5e-09; by both sides m = 0
#   around 210: m = 4, p = 0.1, Rayleigh 5e-09; by both sides m = 0
#   all around: m = 10, p = 0, Rayleigh 1; by both sides m = 10
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pycircstat2==0.1.15 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import sys

import numpy as np
from pycircstat2.hypothesis import omnibus_test, rayleigh_test


def fewest(angles):
    """The fewest angles within half a circle, of all half circles that begin at a multiple of .5 degrees, off the angles."""
    begins = np.radians(np.arange(0, 360, 0.5) + 0.123)
    return int(((angles - begins[:, None]) % (2 * np.pi) < np.pi).sum(axis=1).min())


near = np.linspace(-50, 50, 20)
seen = []
for name, degrees in [(f"around {way}", way + near) for way in (0, 90, 150, 170, 180, 210)] + [("all around", 4.4 + 18.0 * np.arange(20))]:
    angles = np.radians(degrees) % (2 * np.pi)
    result, rayleigh = omnibus_test(angles), rayleigh_test(alpha=angles).pval
    seen.append((result.m, f"{result.pval:.0e}", f"{rayleigh:.0e}", fewest(angles)))
    print(f"{name}: m = {result.m}, p = {result.pval:.1g}, Rayleigh {rayleigh:.1g}; by both sides m = {seen[-1][3]}")
expected = [(m, p, "5e-09", 0) for m, p in ((0, "4e-05"), (0, "4e-05"), (4, "1e-01"), (8, "1e+00"), (10, "0e+00"), (4, "1e-01"))]
sys.exit(seen != [*expected, (10, "0e+00", "1e+00", 10)])
PYTHON
