#!/usr/bin/env bash
# A spike beside a lost frame is no spike.
#
# Found: the Hampel filter replaces samples that lie far from the median of their neighbours. In hampel 1.0.2 one missing
# value (nan) makes the median of each window that holds it nan, no sample is far from that, and what is in the middle of
# these windows stays as it is: with the default window of 5 samples the two before a gap and the two after it, with 11 five
# on each side. Trackers jump just before they lose a point and just after they find it again, so that the spikes for
# which one takes the filter are those that it keeps. Of three equal spikes, one alone, one two frames before a lost frame
# and one just before another, it takes away the first. Nothing is said, and outlier_indices names that one alone. Cut the
# lost rows out before, and put them back after.
# Packages: hampel 1.0.2, pandas 3.1.1, numpy 2.4.6.
# Data: a smooth made-up track of 200 frames with three spikes and two lost frames, made here.
# Output seen:
#   window 5, nothing lost: outliers [50, 100, 150]; largest error left 1.2 pixels; samples without a median 0
#   window 5, two frames lost: outliers [50]; largest error left 60.0 pixels; samples without a median 10
#   window 11, two frames lost: outliers [50]; largest error left 60.0 pixels; samples without a median 22
#   window 5, lost rows cut out: outliers [50, 100, 150]; largest error left 2.5 pixels; samples without a median 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check hampel==1.0.2 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys

import numpy as np
from hampel import hampel

TRACK = 10 * np.sin(np.arange(200) / 8)
SPIKES, LOST = [50, 100, 150], [102, 151]


def filtered(what, window, lost):
    x = TRACK.copy()
    x[SPIKES] += 60
    x[lost] = np.nan
    known = np.isfinite(x)
    frames = np.flatnonzero(known) if what == "lost rows cut out" else np.arange(x.size)
    result = hampel(x[frames], window_size=window, n_sigma=3.0)
    outliers = [int(frames[k]) for k in result.outlier_indices]
    error = round(float(np.nanmax(np.abs(result.filtered_data - TRACK[frames]))), 1)
    blind = int(np.isnan(result.medians).sum())
    print(f"window {window}, {what}: outliers {outliers}; largest error left {error} pixels; samples without a median {blind}")
    return outliers, error, blind


seen = [
    filtered("nothing lost", 5, []),
    filtered("two frames lost", 5, LOST),
    filtered("two frames lost", 11, LOST),
    filtered("lost rows cut out", 5, LOST),
]
spikes, first = [50, 100, 150], [50]
sys.exit(seen != [(spikes, 1.2, 0), (first, 60.0, 10), (first, 60.0, 22), (spikes, 2.5, 0)])
PYTHON
