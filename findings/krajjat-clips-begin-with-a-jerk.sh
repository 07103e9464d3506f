#!/usr/bin/env bash
# The head's greatest acceleration is in the first frame, of each clip.
#
# Found: get_measure of krajjat 1.99.24, a toolbox for motion and speech, gives velocity, acceleration and jerk of a joint by a
# Savitzky-Golay filter, and refers to scipy's documentation for it. scipy fits the ends by the polynomial; krajjat has the first
# and last place go on for ever, as if the head stood still before and after. A head in steady motion has half its velocity at
# the ends, and acceleration and jerk where it has none. Here it drifts by .3 m/s, with a nod in the middle whose acceleration
# is up to 1.78 m/s2 by scipy. By krajjat the maximum is 5.43, in frame 0, and the velocity there is .15. Each trial
# that trim cuts out begins and ends like that. Leave three frames at each end out.
# Packages: krajjat 1.99.24, numpy 2.4.6, scipy 1.17.1, joblib 1.6.0 (which it needs and does not name).
# Data: 300 frames at 29.97 frames/s, made here.
# Output seen:
#   whole: velocity [0.15, 0.325, 0.3]..., by scipy [0.3, 0.3, 0.3]...
#   whole: greatest acceleration 5.43 in frame 0, by scipy 1.78 in 179
#   a second of drift: velocity [0.15, 0.325, 0.3]..., by scipy [0.3, 0.3, 0.3]...
#   a second of drift: greatest acceleration 5.43 in frame 0, by scipy 0.0 in 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check krajjat==1.99.24 numpy==2.4.6 scipy==1.17.1 joblib==1.6.0
env/bin/python - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import numpy as np
from krajjat.classes.joint import Joint
from krajjat.classes.pose import Pose
from krajjat.classes.sequence import Sequence
from scipy.signal import savgol_filter

RATE = 29.97
times = np.arange(300) / RATE
nod = np.where((times > 4) & (times < 6), 0.02 * np.cos(3 * np.pi * (times - 4)) - 0.02, 0)
places = 0.3 * times + nod


def measure(sequence, name):
    return np.array(sequence.get_measure(name, "Head", verbosity=0))


sequence = Sequence(verbosity=0)
for time, place in zip(times, places):
    pose = Pose(float(time))
    pose.add_joint(Joint("Head", float(place), 0.0, 0.0))
    sequence.add_pose(pose, verbosity=0)
trial = sequence.trim(1.0, 2.0, verbosity=0)  # nothing but the drift
seen = []
for title, clip in (("whole", sequence), ("a second of drift", trial)):
    x = np.array(clip.get_measure("x", "Head", verbosity=0))
    velocity, acceleration = measure(clip, "velocity"), measure(clip, "acceleration")
    scipy = [savgol_filter(x, 5, 3 + k - 1, k, 1 / RATE) for k in (1, 2)]
    greatest = [(round(float(np.abs(a).max()), 2), int(np.abs(a).round(2).argmax())) for a in (acceleration, scipy[1])]
    ends = [[round(float(v), 3) for v in values[:3]] for values in (velocity, scipy[0])]
    seen.append((greatest, ends))
    print(f"{title}: velocity {ends[0]}..., by scipy {ends[1]}...")
    print(f"{title}: greatest acceleration {greatest[0][0]} in frame {greatest[0][1]}, by scipy {greatest[1][0]} in {greatest[1][1]}")
expected = [
    ([(5.43, 0), (1.78, 179)], [[0.15, 0.325, 0.3], [0.3, 0.3, 0.3]]),
    ([(5.43, 0), (0.0, 0)], [[0.15, 0.325, 0.3], [0.3, 0.3, 0.3]]),
]
sys.exit(seen != expected)
PYTHON
