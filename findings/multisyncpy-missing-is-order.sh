#!/usr/bin/env bash
# A face that is lost for one frame is in perfect order with everybody.
#
# Found: multiSyncPy 0.1.2 measures how far several people move together. Its symbolic entropy calls each value low, medium
# or high, and counts the patterns over people; order is a low entropy, 0 at best. One missing value (nan) in a signal
# makes its limits nan, no comparison with nan is true, and the whole signal is high: with one frame lost for each of three
# people who have nothing to do with each other the entropy falls from 3.28 to 0, and of windows the one with the lost
# frame is the most ordered. With one person's frame it falls to 2.2. Another measure of the package, coherence_team,
# answers nan. Nothing is said. Fill or cut lost frames before, and look for nan yourself.
# Packages: multiSyncPy 0.1.2, scipy 1.17.1, scikit-learn 1.9.1, matplotlib 3.11.2, seaborn 0.13.2, numpy 2.4.6.
# Data: three made-up signals of 500 frames without any relation, made here.
# Output seen:
#   all known: entropy 3.28, in 5 windows 3.21 3.14 3.16 3.26 3.17; coherence 0.17
#   one of 500 frames lost, one person: entropy 2.2, in 5 windows 2.19 3.14 3.16 3.26 3.17; coherence nan
#   one of 500 frames lost, all three: entropy 0.0, in 5 windows 0.0 3.14 3.16 3.26 3.17; coherence nan
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check multiSyncPy==0.1.2 scipy==1.17.1 scikit-learn==1.9.1 matplotlib==3.11.2 seaborn==0.13.2 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import numpy as np
from multiSyncPy import synchrony_metrics as sync

KNOWN = np.random.default_rng(0).normal(size=(3, 500))


def measured(what, lost):
    data = KNOWN.copy()
    data[:lost, 50] = np.nan
    entropy = round(float(sync.symbolic_entropy(data)), 2) + 0.0
    windows = [round(float(v), 2) + 0.0 for v in sync.apply_windowed(data, sync.symbolic_entropy, 100)]
    other = round(float(sync.coherence_team(data)), 2)
    print(f"{what}: entropy {entropy}, in 5 windows {' '.join(map(str, windows))}; coherence {other}")
    return entropy, windows, other


seen = [
    measured("all known", 0),
    measured("one of 500 frames lost, one person", 1),
    measured("one of 500 frames lost, all three", 3),
]
others = [3.14, 3.16, 3.26, 3.17]
sys.exit(
    [one[:2] for one in seen] != [(3.28, [3.21, *others]), (2.2, [2.19, *others]), (0.0, [0.0, *others])]
    or [bool(np.isnan(one[2])) for one in seen] != [False, True, True]
)
PYTHON
