#!/usr/bin/env bash
# The event of the first frame is written, and not read.
#
# Found: WFDB is PhysioNet's form for signals and coded events. Events with a text of one's own have the symbol '"', a note.
# wfdb 4.3.1 writes such events with wrann, all of them are in the file, and rdann takes each note at sample 0 for a
# definition of the file's own, as of its time resolution, and throws it away, whatever it says. A mouth that is open when
# the clip begins, or the mark of the start by which recordings are aligned, is gone; the second event is the first. Other
# symbols at sample 0, and notes from sample 1 on, stay, with their texts. Nothing is said. Give such events another
# symbol (here "s"), or write the start at sample 1.
# Packages: wfdb 4.3.1, pandas 3.1.1, numpy 2.4.6.
# Data: four made-up events at 30 samples/s, written here.
# Output seen:
#   symbol ", first at 0: in the file 4 texts; read [5, 9, 1500], ['nod', 'blink', 'end']
#   symbol ", two at 0: in the file 4 texts; read [9, 1500], ['blink', 'end']
#   symbol ", first at 1: in the file 4 texts; read [1, 5, 9, 1500], ['mouth open', 'nod', 'blink', 'end']
#   symbol s, first at 0: in the file 4 texts; read [0, 5, 9, 1500], ['mouth open', 'nod', 'blink', 'end']
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check wfdb==4.3.1 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import wfdb

TEXTS = ["mouth open", "nod", "blink", "end"]


def read(what, symbol, *samples):
    wfdb.wrann("face", "atr", np.array(samples), symbol=[symbol] * 4, aux_note=TEXTS, fs=30)
    there = sum(text.encode() in Path("face.atr").read_bytes() for text in TEXTS)
    events = wfdb.rdann("face", "atr")
    found = events.sample.tolist(), list(events.aux_note)
    print(f"symbol {symbol}, {what}: in the file {there} texts; read {found[0]}, {found[1]}")
    return there, *found


seen = [
    read("first at 0", '"', 0, 5, 9, 1500),
    read("two at 0", '"', 0, 0, 9, 1500),
    read("first at 1", '"', 1, 5, 9, 1500),
    read("first at 0", "s", 0, 5, 9, 1500),
]
sys.exit(
    seen
    != [
        (4, [5, 9, 1500], TEXTS[1:]),
        (4, [9, 1500], TEXTS[2:]),
        (4, [1, 5, 9, 1500], TEXTS),
        (4, [0, 5, 9, 1500], TEXTS),
    ]
)
PYTHON
