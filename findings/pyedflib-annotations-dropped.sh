#!/usr/bin/env bash
# Forty events are written, ten are in the file.
#
# Found: EDF+ keeps events beside signals. pyedflib 0.1.42 (EdfWriter.writeAnnotation) takes any number of them and
# returns 0, success, for each; what is written when the file is closed is one event for each data record, which lasts a
# second by default, in the order in which they were given. Of forty blinks, four in each of ten seconds, the file has
# the first ten, those of the first two and a half seconds; nothing is said, and the other thirty are lost. With
# set_number_of_annotation_signals(4) before anything is written all forty are there.
# Packages: pyEDFlib 0.1.42 with numpy 2.4.6.
# Data: ten seconds of a flat signal and made-up events, written here.
# Output seen:
#   1 for each record: returned {0}, 10 of 40 events, the last at 2.25 s
#   4 for each record: returned {0}, 40 of 40 events, the last at 9.75 s
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyEDFlib==0.1.42 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys

import numpy as np
import pyedflib


def kept(signals, events):
    header = {"label": "x", "dimension": "V", "sample_frequency": 100, "physical_max": 1, "physical_min": -1,
              "digital_max": 100, "digital_min": -100, "transducer": "", "prefilter": ""}
    writer = pyedflib.EdfWriter("a.edf", 1, file_type=pyedflib.FILETYPE_EDFPLUS)
    writer.setSignalHeaders([header])
    if signals:
        writer.set_number_of_annotation_signals(signals)
    writer.writeSamples([np.zeros(1000)])
    said = [writer.writeAnnotation(onset, length, text) for onset, length, text in events]
    writer.close()
    with pyedflib.EdfReader("a.edf") as reader:
        onsets, _, _ = reader.readAnnotations()
    return set(said), onsets.tolist()


blinks = [(k / 4, 0.1, f"blink {k}") for k in range(40)]
found = []
for signals in (0, 4):
    said, onsets = kept(signals, blinks)
    found.append((said, len(onsets), onsets[-1]))
    count = f"{len(onsets)} of {len(blinks)} events, the last at {onsets[-1]} s"
    print(f"{signals or 1} for each record: returned {said}, {count}")
sys.exit(found != [({0}, 10, 2.25), ({0}, 40, 9.75)])
PYTHON
