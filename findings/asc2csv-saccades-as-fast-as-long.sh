#!/usr/bin/env bash
# A saccade's average velocity is the mean of its peak velocity and of how long it took.
#
# Found: asc2csv 1.4.1 makes a table of EyeLink's .asc files. "Average Velocity" of a saccade is (peak velocity + duration) / 2,
# degrees per second plus milliseconds: the longer of two equal movements is the faster. Samples are taken only if their time
# has a point, as at 2,000 Hz; of all files at 250, 500 and 1,000 Hz not a single sample is in the table, and its gaze columns
# are empty. At 2,000 Hz samples of a blink, which have no gaze, are at (0, 0), the corner of the screen, and so is what an
# event lacks; the documented helper says so, the table does not. The text promises gaze samples, and speaks of "missing data"
# without it. Nothing is said. Take another reader.
# Packages: asc2csv 1.4.1, pandas 2.3.3, numpy 2.4.6.
# Data: a made-up trial of .1 s with a blink of 20 ms, and two saccades of 10 degrees in 40 and 80 ms, made here.
# Output seen:
#   2000 Hz: 200 samples, of them 40 at (0, 0); 40 ms, peak 400 deg/s: average 220; 80 ms, peak 200 deg/s: average 140
#   1000 Hz: 0 samples, of them 0 at (0, 0); 40 ms, peak 400 deg/s: average 220; 80 ms, peak 200 deg/s: average 140
#   500 Hz: 0 samples, of them 0 at (0, 0); 40 ms, peak 400 deg/s: average 220; 80 ms, peak 200 deg/s: average 140
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check asc2csv==1.4.1 pandas==2.3.3 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import contextlib
import io
import pathlib
import sys

import pandas as pd
from asc2csv import process_asc_file

seen = []
for rate in (2000, 1000, 500):
    lines = ["MSG\t5000 TRIALID 1"]
    for sample in range(rate // 10):
        time = 5000 + 1000 * sample / rate
        gaze = "   .\t   .\t    0.0\t   .\t   ." if 5040 <= time < 5060 else "  500.0\t  300.0\t 1000.0\t    1.0\t    2.0"
        lines.append(f"{time:.1f}\t{gaze}\t..." if rate == 2000 else f"{time:.0f}\t{gaze}\t...")
    lines.append("ESACC R  5000\t5040\t40\t  100.0\t  300.0\t  500.0\t  300.0\t  10.00\t    400")
    lines.append("ESACC R  5010\t5090\t80\t  100.0\t  300.0\t  500.0\t  300.0\t  10.00\t    200")
    pathlib.Path("film.asc").write_text("\n".join(lines) + "\n")
    with contextlib.redirect_stdout(io.StringIO()):
        process_asc_file("film.asc", "film.csv")
    table = pd.read_csv("film.csv")
    saccades = table[table["Event Type"] == "Saccade"]
    samples = table["Gaze X"].notna()
    at_zero = (table["Gaze X"] == 0) & (table["Gaze Y"] == 0)
    told = [tuple(map(int, row)) for row in saccades[["Duration", "Peak Velocity", "Average Velocity"]].to_numpy()]
    seen.append((int(samples.sum()), int(at_zero.sum()), told))
    each = "; ".join(f"{duration} ms, peak {peak} deg/s: average {average}" for duration, peak, average in told)
    print(f"{rate} Hz: {seen[-1][0]} samples, of them {seen[-1][1]} at (0, 0); {each}")
saccades = [(40, 400, 220), (80, 200, 140)]
sys.exit(seen != [(200, 40, saccades), (0, 0, saccades), (0, 0, saccades)])
PYTHON
