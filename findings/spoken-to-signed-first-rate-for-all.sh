#!/usr/bin/env bash
# A sign filmed at 50 frames/s takes twice as long, if the sign before it was filmed at 25.
#
# Found: spoken-to-signed 0.4.0 joins signs of a lexicon, .pose files, to a sentence (concatenate_poses). The frames of all
# signs are laid one after another, and the sentence has the rate of its first sign. So where the lexicon has clips of several
# rates, as those of several sources have, a sign of 50 frames/s after one of 25 is signed at half its speed, one of 60 slower
# still, and one of 25 after one of 50 twice as fast. The limit of .8 s for each sign, which is there since citation forms are
# too slow, is kept at the sign's own rate, before, and so does not help: with it two signs take 1.4, 2.1 or .9 s. Speed is part
# of what a sign says. Nothing is said. Interpolate all poses to one rate before.
# Packages: spoken-to-signed 0.4.0, pose-format 0.15.0, pose-anonymization 0.0.1 for its mean person, numpy 2.4.6, scipy 1.17.1.
# Data: two signs of 2 s of a person who waves, at two rates, made here.
# Output seen:
#   25 and 25 frames/s: 3.64 s at 25 frames/s, with the limit 1.44 s
#   25 and 50 frames/s: 5.28 s at 25 frames/s, with the limit 2.12 s
#   25 and 60 frames/s: 6.36 s at 25 frames/s, with the limit 2.40 s
#   50 and 25 frames/s: 2.66 s at 50 frames/s, with the limit 0.94 s
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check spoken-to-signed==0.4.0 pose-format==0.15.0 numpy==2.4.6 scipy==1.17.1
env/bin/pip install --quiet --disable-pip-version-check pose-anonymization==0.0.1
env/bin/python -W ignore - <<'PYTHON'
import contextlib
import io
import sys

import numpy as np
from pose_anonymization.data import load_mean_and_std, load_pose_header
from pose_format import Pose
from pose_format.numpy import NumPyPoseBody
from spoken_to_signed.gloss_to_pose.concatenate import concatenate_poses

header, (mean, _) = load_pose_header(), load_mean_and_std()
LEFT, RIGHT = (header.get_point_index("POSE_LANDMARKS", f"{side}_WRIST") for side in ("LEFT", "RIGHT"))


def sign(rate):
    times = np.arange(2 * rate) / rate
    places = np.tile(mean.reshape(1, 1, -1, 3) * 1000 + 500, (len(times), 1, 1, 1))
    places[:, 0, [LEFT, RIGHT], 1] -= 300
    places[:, 0, RIGHT, 0] += 100 * np.sin(4 * np.pi * times)
    return Pose(header, NumPyPoseBody(rate, np.ma.masked_array(places, np.zeros(places.shape, bool)), np.ones(places.shape[:3])))


seen = []
for rates in ((25, 25), (25, 50), (25, 60), (50, 25)):
    lengths = []
    for limit in (None, 0.8):
        with contextlib.redirect_stdout(io.StringIO()):
            sentence = concatenate_poses([sign(rate) for rate in rates], max_sign_seconds=limit)
        lengths.append(round(len(sentence.body) / sentence.body.fps, 2))
    seen.append((*lengths, sentence.body.fps))
    print("{} and {} frames/s: {:.2f} s at {:.0f} frames/s, with the limit {:.2f} s".format(*rates, lengths[0], sentence.body.fps, lengths[1]))
sys.exit(seen != [(3.64, 1.44, 25), (5.28, 2.12, 25), (6.36, 2.4, 25), (2.66, 0.94, 50)])
PYTHON
