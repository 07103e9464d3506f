#!/usr/bin/env bash
# A tracker for a clip at 30 frames/s takes another clip's 5 frames/s, and its head is another head nine times or never.
#
# Found: motpy 0.0.10 tracks boxes by Kalman filters. MultiObjectTracker(dt=...) is given the time between two frames, and
# writes it into the one default model that all its trackers share. So the last tracker that was made says what dt is for every
# track that any of them begins from then on: two clips of two rates, two cameras, or a second pass are followed at one rate. A
# head that sways at 30 frames/s is lost and found as nine heads, 26 pixels off, by a tracker that is alone, and is one head, 1
# pixel off, once another tracker was made with dt=1/5; after one with dt=1/240 it is as bad as alone. A dict or a preset's name
# as model_spec is shared, too, and the dict is changed. Nothing is said. Give each tracker a dict of its own.
# Packages: motpy 0.0.10, filterpy 2.0.0, numpy 2.4.6, scipy 1.17.1.
# Data: a made-up box that sways by 60 pixels to either side in 2 s, for 8 s, with 1 pixel of noise, made here.
# Output seen:
#   alone: 9 heads, 25.89 pixels off
#   another made with dt=1/5: 1 head, 0.96 pixels off
#   another made with dt=1/240: 9 heads, 28.63 pixels off
#   another made with dt=1/5, a dict each: 9 heads, 25.89 pixels off
#   my dict afterwards: dt=0.2
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check motpy==0.0.10 filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys

import numpy as np
from motpy import Detection, MultiObjectTracker

MODEL = {"order_pos": 1, "dim_pos": 2, "order_size": 0, "dim_size": 2}


def follow(tracker, rate=30):
    random = np.random.default_rng(0)
    heads, errors = set(), []
    for time in np.arange(8 * rate) / rate:
        left = 300 + 60 * np.sin(np.pi * time)
        measured = left + random.normal(0, 1)
        for track in tracker.step([Detection(box=[measured, 100, measured + 40, 140], score=1)]):
            heads.add(track.id)
            if time > 1:
                errors.append(abs(track.box[0] - left))
    return len(heads), round(float(np.mean(errors)), 2)


seen = []
for name, other, own in (
    ("alone", None, False), ("another made with dt=1/5", 5, False), ("another made with dt=1/240", 240, False),
    ("another made with dt=1/5, a dict each", 5, True),
):
    options = [{"model_spec": dict(MODEL)} if own else {} for _ in range(2)]
    tracker = MultiObjectTracker(dt=1 / 30, **options[0])
    if other:
        MultiObjectTracker(dt=1 / other, **options[1])
    seen.append(follow(tracker))
    print(f"{name}: {seen[-1][0]} head{'s' * (seen[-1][0] > 1)}, {seen[-1][1]} pixels off")
MultiObjectTracker(dt=1 / 30, model_spec=MODEL)
MultiObjectTracker(dt=1 / 5, model_spec=MODEL)
print(f"my dict afterwards: dt={MODEL['dt']}")
sys.exit(seen != [(9, 25.89), (1, 0.96), (9, 28.63), (9, 25.89)] or MODEL["dt"] != 0.2)
PYTHON
