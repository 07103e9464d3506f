#!/usr/bin/env bash
# Asked for the left eye, the samples are the left eye's, and the fixations and blinks the right eye's.
#
# Found: abra 1.4.2 reads EyeLink's .asc files. Of files with two eyes, eyes_recorded="left" or "right" chooses one, "which eye
# data to extract" by its documentation. Gaze and pupil follow that. Fixations, blinks and saccades do not: whichever is asked
# for, those of the right eye are kept and those of the left are dropped (the source compares with "R" in both branches). So of
# a left eye that blinks alone no blink is left, its fixations are where the other eye looks, and a trial's fixations, which are
# filed under left and right, are all under right. Besides, remove_eye_blinks cuts gaze at a blink and a buffer at both sides,
# but nothing where the blink is within the first samples, as many as the buffer has. Nothing is said. Read events yourself.
# Packages: abra 1.4.2, numpy 2.4.6, scipy 1.17.1, matplotlib 3.11.2.
# Data: two made-up trials at 500 Hz; the left eye is at x = 500 and blinks, the right eye is at 600 and does not, made here.
# Output seen:
#   left: gaze at 500, fixations at 600 600, of trials left 0 0, right 1 1, blinks 0
#   right: gaze at 600, fixations at 600 600, of trials left 0 0, right 1 1, blinks 0
#   gaze cut at a blink of 21 samples, buffer 50: 0 of frame 10, 120 of frame 100
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check abra==1.4.2 numpy==2.4.6 scipy==1.17.1 matplotlib==3.11.2
env/bin/python -W ignore - <<'PYTHON'
import pathlib
import sys
from types import SimpleNamespace

import abra
import numpy as np

lines, time = ["START\t1000\tLEFT\tRIGHT\tSAMPLES\tEVENTS", "SAMPLES\tGAZE\tLEFT\tRIGHT\tRATE\t 500.00\tTRACKING\tCR"], 1000
for trial in (1, 2):
    lines.append(f"MSG\t{time} TRIAL {trial} START")
    for sample in range(200):
        left = "   .\t   .\t    0.0" if 120 <= sample < 150 else "  500.0\t  300.0\t 1000.0"
        lines.append(f"{time}\t{left}\t  600.0\t  300.0\t 1000.0\t.....")
        if sample == 99:
            lines += [f"EFIX {eye}   {time - 100}\t{time}\t102\t  {x}.0\t  300.0\t   1000" for eye, x in (("L", 500), ("R", 600))]
        if sample == 149:
            lines.append(f"EBLINK L {time - 58}\t{time}\t60")
        time += 2
    lines.append(f"MSG\t{time} TRIAL {trial} END")
    time += 100
pathlib.Path("two.asc").write_text("\n".join([*lines, f"END\t{time}\tSAMPLES\tEVENTS\tRES\t  25.00\t  25.00"]) + "\n")
seen = []
for eye in ("left", "right"):
    read = abra.read("two.asc", eyes_recorded=eye, both_eyes_recorded=True, mode="u")
    trials = read.create_session().data
    fixations = [int(event[3]) for name, events in read.events.items() if name.startswith("EFIX") for event in events]
    blinks = sum(len(events) for name, events in read.events.items() if name.startswith("EBLINK"))
    counts = [[len(trial.event_L) for trial in trials], [len(trial.event_R) for trial in trials]]
    seen.append([int(np.nanmedian(read.movement[0])), fixations, *counts, blinks])
    told = [seen[-1][0], *(" ".join(map(str, numbers)) for numbers in seen[-1][1:4]), blinks]
    print("{}: gaze at {}, fixations at {}, of trials left {}, right {}, blinks {}".format(eye, *told))
widened = []
for first in (10, 100):
    pupil = np.ones(500)
    pupil[first : first + 21] = np.nan
    record = SimpleNamespace(pupil_size=pupil, movement=np.zeros((2, 500)))
    abra.remove_eye_blinks(record, buffer=50, inplace=True)
    widened.append(int(np.isnan(record.movement[0]).sum()))
print("gaze cut at a blink of 21 samples, buffer 50: {} of frame 10, {} of frame 100".format(*widened))
sys.exit(seen != [[x, [600, 600], [0, 0], [1, 1], 0] for x in (500, 600)] or widened != [0, 120])
PYTHON
