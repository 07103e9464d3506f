#!/usr/bin/env bash
# A recogniser that finds no blink at its place has an F1 of 1, and its blinks are perfectly continuous.
#
# Found: banos 1.0.0 measures coded behaviour against a person's, event by event. By its text a measure is nan where the person
# coded no event. It is the other way round: there it is 1 or 0, and nan where the person did and the recogniser hit none of
# them: F1, overlap (so) and precision in time (tp) of what was missed altogether are nan, and the means over behaviours and
# clips leave nan out. So all blinks missed, or all at wrong times, cost nothing, and finding one of three costs a lot.
# Continuity (ic) of an event that was never seen is 1, since it never flickers. Only the recall shows it. The text says
# "excluded from NaN-averaging correctly". Take F1 = 0 where it is nan, and no continuity of missed events, before you average.
# Packages: banos 1.0.0, pandas 2.3.3, numpy 2.4.6, scipy 1.17.1.
# Data: a clip of 300 frames with two nods, a smile and three blinks, and four recognisers that are right but for blinks, made here.
# Numbers are means of the clip.
# Output seen:
#   all right: precision 1.0, recall 1.0, f1 1.0, so 1.0, tp 1.0, ic 1.0
#   one of three blinks: precision 1.0, recall 0.778, f1 0.833, so 1.0, tp 1.0, ic 1.0
#   no blink: precision 1.0, recall 0.667, f1 1.0, so 1.0, tp 1.0, ic 1.0
#   three blinks elsewhere: precision 0.667, recall 0.667, f1 1.0, so 1.0, tp 1.0, ic 1.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check banos==1.0.0 pandas==2.3.3 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys

import banos
import numpy as np
import pandas as pd

NODS, SMILE, BLINKS = [(20, 60), (100, 140)], [(50, 120)], [(10, 15), (90, 95), (200, 205)]


def coded(blinks):
    frames = np.arange(300)
    events = {"nod": NODS, "smile": SMILE, "blink": blinks}
    return pd.DataFrame({name: sum(((frames >= a) & (frames < b)).astype(int) for a, b in of) + 0 * frames for name, of in events.items()})


seen = []
elsewhere = [(first + 30, last + 30) for first, last in BLINKS]
for name, blinks in {"all right": BLINKS, "one of three blinks": BLINKS[:1], "no blink": [], "three blinks elsewhere": elsewhere}.items():
    _, means = banos.score({"clip": (coded(blinks), coded(BLINKS))})
    seen.append([round(float(means[key]), 3) for key in ("precision", "recall", "f1_score", "so", "tp", "ic")])
    print(name + ": precision {}, recall {}, f1 {}, so {}, tp {}, ic {}".format(*seen[-1]))
expected = [[1, 1, 1, 1, 1, 1], [1, 0.778, 0.833, 1, 1, 1], [1, 0.667, 1, 1, 1, 1], [0.667, 0.667, 1, 1, 1, 1]]
sys.exit(seen != expected)
PYTHON
