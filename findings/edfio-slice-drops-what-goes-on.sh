#!/usr/bin/env bash
# Who looks left when a recording is cut does not look left in the cut.
#
# Found: edfio 0.4.18 reads and writes EDF+, signals with events. slice_between_seconds(3, 7) keeps the events that begin in these four
# seconds. Who looks left from 1 to 5 s still does so for two seconds after the cut, and the event is gone. A smile from 6 to 9 s keeps
# its three seconds, two of them after the end. With keep_all_annotations=True every event of the recording stays, before the start
# and after the end, too. MNE 1.13.2 cuts the same file rightly: looks left for 2 s, smiles for 1 s. Nothing is said. Cut by MNE.
# Packages: edfio 0.4.18, mne 1.13.2, numpy 2.4.6, scipy 1.17.1.
# Data: ten seconds of the yaw of a head at 25 frames/s and four events, made here.
# Output seen:
#   edfio: blink 0.6 + 0.4, smile 3.0 + 3.0
#   edfio, all: looks left -2.0 + 4.0, blink 0.6 + 0.4, smile 3.0 + 3.0, nod 5.5 + 0.5
#   MNE: looks left 0.0 + 2.0, blink 0.6 + 0.4, smile 3.0 + 1.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check edfio==0.4.18 mne==1.13.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys
import warnings

import edfio
import mne
import numpy as np

EVENTS = ((1, 4, "looks left"), (3.6, 0.4, "blink"), (6, 3, "smile"), (8.5, 0.5, "nod"))


def recording():
    yaw = edfio.EdfSignal(np.linspace(-30, 30, 250), sampling_frequency=25, label="yaw", physical_range=(-90, 90))
    return edfio.Edf([yaw], annotations=[edfio.EdfAnnotation(*event) for event in EVENTS])


recording().write("head.edf")
rows = {}
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for name, options in (("edfio", {}), ("edfio, all", {"keep_all_annotations": True})):
        cut = edfio.read_edf("head.edf")
        cut.slice_between_seconds(3, 7, **options)
        cut.write("cut.edf")
        rows[name] = [(one.text, one.onset, one.duration) for one in edfio.read_edf("cut.edf").annotations]
cut = mne.io.read_raw_edf("head.edf", verbose="error").crop(3, 7, include_tmax=False)
rows["MNE"] = [(one["description"], one["onset"] - 3, one["duration"]) for one in cut.annotations]
seen = []
for name, row in rows.items():
    seen.append(", ".join(f"{text} {onset:.1f} + {duration:.1f}" for text, onset, duration in row))
    print(f"{name}: {seen[-1]}")
expected = [
    "blink 0.6 + 0.4, smile 3.0 + 3.0",
    "looks left -2.0 + 4.0, blink 0.6 + 0.4, smile 3.0 + 3.0, nod 5.5 + 0.5",
    "looks left 0.0 + 2.0, blink 0.6 + 0.4, smile 3.0 + 1.0",
]
sys.exit(seen != expected or bool(said))
PYTHON
