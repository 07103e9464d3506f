#!/usr/bin/env bash
# A head that never turns does so when the clip begins, when it ends, and when the nose is lost.
#
# Found: physbeh 0.6.6 reads DeepLabCut's HDF5 or BIDS' motion.tsv. It smooths by a window of 101 frames, at any frame rate:
# speed by default, angular velocity by default though its text says not, direction if asked to. Before that lost frames are
# set to 0: 0 pixels/s, and 0 degrees, which is to the right. Beyond the ends all is 0 as well. A head that looks
# 150 degrees to the left, and moves at 50 pixels/s, looks 78 degrees in the first and the last frame, turns by up to 149
# degrees/s there and by 83 beside 10 lost frames, and moves at 20 pixels/s in these. The index of good frames,
# which comes with each result, marks the lost frames alone, and for the direction not even those: one good point of the two is
# enough. Nothing is said. Take smooth=False, fill gaps before, and smooth the result.
# Packages: physbeh 0.6.6, pandas 2.3.3, numpy 2.4.6, scipy 1.17.1, pint-pandas 0.7.1, pint 0.25.3, opencv-python 5.0.0.93,
# tables 3.11.1, joblib 1.5.3, matplotlib 3.11.2.
# Data: ten seconds of a made-up eye and nose at 25 frames/s as motion.tsv, written here.
# Output seen:
#   smooth: frame 0 direction 78.0, turns by 148.9/s, speed 23.3; good True, True, True
#   smooth: frame 60 direction 150.0, turns by 0.1/s, speed 50.0; good True, True, True
#   smooth: frame 95 direction 150.0, turns by 82.7/s, speed 39.1; good True, True, True
#   smooth: frame 104 direction 150.0, turns by 6.6/s, speed 20.3; good True, False, False
#   smooth: frame 249 direction 78.0, turns by 148.9/s, speed 26.7; good True, True, True
#   raw: frame 60 direction 150.0, turns by 0.0/s, speed 50.0; good True, True, True
#   raw: frame 249 direction 150.0, turns by 0.0/s, speed 50.0; good True, True, True
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check physbeh==0.6.6 pandas==2.3.3 numpy==2.4.6 scipy==1.17.1 pint-pandas==0.7.1 pint==0.25.3 opencv-python==5.0.0.93 tables==3.11.1 joblib==1.5.3 matplotlib==3.11.2
cat > face_motion.json <<'JSON'
{"SamplingFrequency": 25}
JSON
env/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np
import physbeh

with open("face_motion.tsv", "w") as file:
    file.write("eye_x\teye_y\teye_likelihood\tnose_x\tnose_y\tnose_likelihood\n")
    for k in range(250):
        x, y = 100 + 2 * k + 40 * np.cos(np.radians(150)), 200 - 40 * np.sin(np.radians(150))
        likelihood = 0.1 if 100 <= k < 110 else 1.0
        file.write(f"{100.0 + 2 * k}\t200.0\t1.0\t{x:.4f}\t{y:.4f}\t{likelihood}\n")
track = physbeh.load_tracking("face_motion.tsv")
seen = []
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for name, options, frames in (("smooth", {}, (0, 60, 95, 104, 249)), ("raw", {"smooth": False}, (60, 249))):
        results = (
            track.get_direction_array("eye", "nose", mode="deg", smooth=not options),
            track.get_angular_velocity("eye", "nose", **options),
            track.get_speed("nose", **options),
        )
        direction, turn, speed = results[0][0], np.degrees(results[1][0]), results[2][0]
        for k in frames:
            good = [bool(result[2][k]) for result in results]
            row = [round(abs(float(value[k])), 1) for value in (direction, turn, speed)]
            seen.append((*row, all(good[1:]), good[0]))
            print(f"{name}: frame {k} direction {row[0]}, turns by {row[1]}/s, speed {row[2]}; good", ", ".join(map(str, good)))
expected = [
    (78.0, 148.9, 23.3, True, True),
    (150.0, 0.1, 50.0, True, True),
    (150.0, 82.7, 39.1, True, True),
    (150.0, 6.6, 20.3, False, True),
    (78.0, 148.9, 26.7, True, True),
    (150.0, 0.0, 50.0, True, True),
    (150.0, 0.0, 50.0, True, True),
]
sys.exit(seen != expected or bool(said))
PYTHON
