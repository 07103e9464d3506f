#!/usr/bin/env bash
# Two blinks while the mouth is open have not happened, and who is lost for 2 s has blinked for 2 s.
#
# Found: events_find of neurokit2 0.3.0 makes events of signals. Several channels "are handled as reflecting different
# events": it adds them up as the bits of a number, and an event lasts as long as that number is not 0, with the condition
# of its first sample. Whatever begins while something else is on is no event, and what begins as another one ends makes
# the other one longer: of a mouth that is open for 4 s, two blinks in that time, and one later, there are two events, the
# mouth and the last blink. A mouth that opens as the brows come down is brows for both times. A channel counts
# only where it is at its own largest value. With threshold_keep="below", as for blinks in an eye's opening, samples
# without a number (nan) are below: each gap of a tracker is an event, while above a threshold it is none. Nothing is said.
# Give one channel at a time, and drop events in which samples are missing.
# Packages: neurokit2 0.3.0, pandas 3.1.1, scipy 1.17.1, scikit-learn 1.9.1, matplotlib 3.11.2, numpy 2.4.6.
# Data: made-up channels of 10 s at 25 frames/s, written here.
# Output seen:
#   mouth: condition - from 25 for 100
#   blink: condition - from 50 for 3, condition - from 90 for 3, condition - from 203 for 3
#   both: condition 1 from 25 for 100, condition 2 from 203 for 3
#   brows, then mouth: condition 1 from 20 for 80
#   eye below .5: condition - from 50 for 3, condition - from 90 for 3, condition - from 150 for 50, condition - from 203 for 3
#   messages 0
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

import neurokit2
import numpy as np
import pandas as pd


def channel(*spans):
    values = np.zeros(250)
    for begin, end in spans:
        values[begin:end] = 1
    return values


def events(name, signal, **options):
    found = neurokit2.events_find(signal, **options)
    conditions = found.get("condition", ["-"] * len(found["onset"]))
    result = [(str(c), int(o), int(d)) for c, o, d in zip(conditions, found["onset"], found["duration"])]
    print(f"{name}: " + ", ".join("condition {} from {} for {}".format(*event) for event in result))
    return result


mouth, blink = channel((25, 125)), channel((50, 53), (90, 93), (203, 206))
eye = 1 - blink
eye[150:200] = np.nan  # two seconds in which the face is lost
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    seen = [
        events("mouth", mouth),
        events("blink", blink),
        events("both", pd.DataFrame({"mouth": mouth, "blink": blink})),
        events("brows, then mouth", pd.DataFrame({"brows": channel((20, 60)), "mouth": channel((60, 100))})),
        events("eye below .5", eye, threshold=0.5, threshold_keep="below"),
    ]
print("messages", len(said))
blinks = [("-", 50, 3), ("-", 90, 3), ("-", 203, 3)]
expected = [
    [("-", 25, 100)],
    blinks,
    [("1", 25, 100), ("2", 203, 3)],
    [("1", 20, 80)],
    [*blinks[:2], ("-", 150, 50), blinks[2]],
]
sys.exit(seen != expected or bool(said))
PYTHON
