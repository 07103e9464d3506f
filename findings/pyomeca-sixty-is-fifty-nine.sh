#!/usr/bin/env bash
# Sixty frames a second are 59, and 120 are 125.
#
# Found: .trc and .mot are OpenSim's tables of markers and of angles. pyomeca 2026.0.2 gives a rate with them, attrs["rate"], and its
# filters take that one when they are not told another. It is not the DataRate that a .trc has in its header, nor made from the
# recording's length: it is one over the time of the second row less that of the first, rounded to a whole number. Times are
# often written in milliseconds, so that 60 frames/s, whose second row is at .017 s, are 59, and 120 are 125; 29.97 and 23.976 are
# 30 and 24 with any number of digits. What is said to cut at 6 Hz cuts at 5.76 where 120 are 125. time_normalize with
# norm_time=True, "from 0 to 100", ends at 99, and puts these numbers in the place of the CALLER's times as well: the table
# that was normalised lasts 99 s afterwards. Take the rate from the header, and normalise a copy.
# Packages: pyomeca 2026.0.2, xarray 2026.9.0, pandas 3.1.1, numpy 2.4.6, ezc3d 1.7.2.
# Data: a marker over 120 frames as .trc and an angle as .mot, written here.
# Output seen:
#   times of 3 digits: .trc {23.976: 24, 29.97: 30, 30: 30, 59.94: 59, 60: 59, 120: 125, 240: 250}
#   times of 3 digits: .mot {23.976: 24, 29.97: 30, 30: 30, 59.94: 59, 60: 59, 120: 125, 240: 250}
#   times of 6 digits: .trc {23.976: 24, 29.97: 30, 30: 30, 59.94: 60, 60: 60, 120: 120, 240: 240}
#   times of 6 digits: .mot {23.976: 24, 29.97: 30, 30: 30, 59.94: 60, 60: 60, 120: 120, 240: 240}
#   last time of the table 0.496 s, after time_normalize(norm_time=True) of it 99.0 s
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyomeca==2026.0.2 xarray==2026.9.0 pandas==3.1.1 numpy==2.4.6 ezc3d==1.7.2
env/bin/python - <<'PYTHON'
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
from pyomeca import Analogs, Markers

RATES = (23.976, 29.97, 30, 59.94, 60, 120, 240)
TABS = {"pandas_kwargs": {"sep": "\t"}}


def read_trc(rate, digits):
    lines = ["PathFileType\t4\t(X/Y/Z)\tlip.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits"]
    lines += [f"{rate}\t{rate}\t120\t1\tmm", "Frame#\tTime\tlip\t\t", "\t\tX1\tY1\tZ1", ""]
    lines += [f"{k + 1}\t{k / rate:.{digits}f}\t{k}\t0\t0" for k in range(120)]
    Path("lip.trc").write_text("\n".join(lines) + "\n")
    return Markers.from_trc("lip.trc", **TABS)


def read_mot(rate, digits):
    lines = ["head", "version=1", "nRows=120", "nColumns=2", "inDegrees=yes", "endheader", "time\tpitch"]
    lines += [f"{k / rate:.{digits}f}\t{k}" for k in range(120)]
    Path("head.mot").write_text("\n".join(lines) + "\n")
    return Analogs.from_mot("head.mot", **TABS)


seen = []
for digits in (3, 6):
    for kind, read in ((".trc", read_trc), (".mot", read_mot)):
        seen.append({rate: int(read(rate, digits).attrs["rate"]) for rate in RATES})
        print(f"times of {digits} digits: {kind} {seen[-1]}")
table = read_trc(240, 3)
before = float(table.time[-1])
table.meca.time_normalize(n_frames=100, norm_time=True)
after = float(table.time[-1])
print(f"last time of the table {before} s, after time_normalize(norm_time=True) of it {after} s")
three, six = (24, 30, 30, 59, 59, 125, 250), (24, 30, 30, 60, 60, 120, 240)
expected = [dict(zip(RATES, rates)) for rates in (three, three, six, six)]
sys.exit((seen, before, after) != (expected, 0.496, 99.0))
PYTHON
