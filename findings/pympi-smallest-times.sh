#!/usr/bin/env bash
# A blink at 0.3 s, less 0.3 s, is at 17 s.
#
# Found: 0.1 * 3 - 0.3 is 5.551115123125783e-17 in floating point, and so an event that is moved to the start of a
# recording seldom is at 0 exactly. praatio 6.2.2 (editTimestamps) and tgt write this number in full, as Praat
# does. pympi-ling 1.71 and crowsetta 5.1.2 look in a TextGrid's line for digits and points before its end, and find the 17 after
# the minus: the first blink is at 17 s, after all others. 1e-05 s is 5 s. A sign goes the same way: what is at -.5 s, before
# a stimulus at 0, is at .5 s after it. tgt reads all three. Nothing is said. Round times before writing.
# Packages: praatio 6.2.2, pympi-ling 1.71, crowsetta 5.1.2, tgt 1.5, numpy 2.4.6.
# Data: a made-up TextGrid of two blinks at 0.1 * 3 and 5 s, moved by praatio, and blinks at -.5 and 1e-05 s, all made here.
# Output seen:
#   moved by -0.3 s, as written: 5.551115123125783e-17, 4.7
#   moved by -0.3 s: pympi 17.0, 4.7; crowsetta 17.0, 4.7; tgt 5.551115123125783e-17, 4.7
#   others: pympi 0.5, 5.0; crowsetta 0.5, 5.0; tgt -0.5, 1e-05
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check praatio==6.2.2 pympi-ling==1.71 crowsetta==5.1.2 tgt==1.5 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import re
import sys
from pathlib import Path

import crowsetta
import pympi
import tgt
from praatio import textgrid


def read(name):
    (tier,) = pympi.Praat.TextGrid(name).get_tiers()
    return {
        "pympi": [float(time) for time, _ in tier.intervals],
        "crowsetta": [float(point.number) for point in crowsetta.formats.seq.TextGrid.from_file(name).tiers[0]],
        "tgt": [float(point.time) for point in tgt.read_textgrid(name).tiers[0]],
    }


grid = textgrid.Textgrid(0, 20)
grid.addTier(textgrid.PointTier("blink", [(0.1 * 3, "first"), (5, "second")], 0, 20))
grid.editTimestamps(-0.3).save("moved.TextGrid", "long_textgrid", includeBlankSpaces=True)
text = Path("moved.TextGrid").read_text()
as_written = re.findall(r"number = (\S+)", text)
print("moved by -0.3 s, as written: " + ", ".join(as_written))
Path("others.TextGrid").write_text(text.replace(as_written[0], "-0.5").replace(as_written[1], "1e-05"))
seen = []
for what, name in (("moved by -0.3 s", "moved"), ("others", "others")):
    seen.append(read(f"{name}.TextGrid"))
    print(f"{what}: " + "; ".join(f"{who} " + ", ".join(map(str, times)) for who, times in seen[-1].items()))
tiny = 0.1 * 3 - 0.3
expected = [
    {"pympi": [17, 4.7], "crowsetta": [17, 4.7], "tgt": [tiny, 4.7]},
    {"pympi": [0.5, 5], "crowsetta": [0.5, 5], "tgt": [-0.5, 1e-5]},
]
sys.exit(as_written != ["5.551115123125783e-17", "4.7"] or seen != expected)
PYTHON
