#!/usr/bin/env bash
# What happens 1.5 frames earlier or later has the same time in an epoch.
#
# Found: epochs_create of neurokit2 0.3.0 cuts pieces around events, each indexed by the time from its event. It takes the
# samples from onset + start up to, and without, onset + end, both rounded to whole samples, and lays the times from
# start to end over them, both included. So the last sample, one short of the end, is called the end, the steps are
# too long, and where start is no whole sample the first is off as well: at 25 frames/s the epoch from -.5 to 1 s
# has the sample of -.52 s as -.5, that of .96 s as 1, and the sample nearest to 0 is the frame before the event. Up
# to 1.5 frames, 60 ms, are more than a blink's closing or a difference of latencies. At 1000 samples/s, for which one
# tests such a thing, it is 1 ms. Nothing is said. The column Index has the samples' own numbers: take (Index - onset) /
# rate for the time.
# Packages: neurokit2 0.3.0, pandas 3.1.1, scipy 1.17.1, scikit-learn 1.9.1, matplotlib 3.11.2, numpy 2.4.6.
# Data: a signal whose value is the number of its sample, and an event at sample 1000, made here.
# Output seen:
#   25/s, -0.5 to 1 s: first -0.52 s called -0.5, last 0.96 s called 1.0, called 0: -0.04 s; up to 1.0 samples off
#   25/s, -0.3 to 0.7 s: first -0.32 s called -0.3, last 0.64 s called 0.7, called 0: -0.04 s; up to 1.5 samples off
#   30/s, -0.5 to 1 s: first -0.5 s called -0.5, last 0.967 s called 1.0, called 0: 0.0 s; up to 1.0 samples off
#   1000/s, -0.5 to 1 s: first -0.5 s called -0.5, last 0.999 s called 1.0, called 0: 0.0 s; up to 1.0 samples off
#   the column Index is right: True
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check neurokit2==0.3.0 pandas==3.1.1 scipy==1.17.1 scikit-learn==1.9.1 matplotlib==3.11.2 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import neurokit2
import numpy as np
import pandas as pd

signal = pd.DataFrame({"signal": np.arange(4000.0)})
seen, right = [], True
for rate, start, end in ((25, -0.5, 1), (25, -0.3, 0.7), (30, -0.5, 1), (1000, -0.5, 1)):
    made = neurokit2.epochs_create(signal, [1000], sampling_rate=rate, epochs_start=start, epochs_end=end)
    epoch = made["1"]
    called = epoch.index.to_numpy(float)
    true = (epoch["signal"].to_numpy() - 1000) / rate
    right = right and bool((epoch["Index"] == epoch["signal"]).all())
    off = np.abs(called - true).max() * rate
    zero = true[np.abs(called).argmin()]
    found = [float(v) for v in (true[0], called[0], true[-1], called[-1], zero)]
    found = [*(round(v, 3) + 0.0 for v in found), round(float(off), 2)]
    seen.append(found)
    print("{}/s, {} to {} s: first {} s called {}, last {} s called {}, called 0: {} s;".format(rate, start, end, *found), end=" ")
    print(f"up to {found[-1]} samples off")
print(f"the column Index is right: {right}")
sys.exit(
    not right
    or seen
    != [
        [-0.52, -0.5, 0.96, 1.0, -0.04, 1.0],
        [-0.32, -0.3, 0.64, 0.7, -0.04, 1.5],
        [-0.5, -0.5, 0.967, 1.0, 0.0, 1.0],
        [-0.5, -0.5, 0.999, 1.0, 0.0, 1.0],
    ]
)
PYTHON
