#!/usr/bin/env bash
# The last blink of each file is lost on the way from tgt to praatio.
#
# Found: praatio 6.2.2 reads Praat's short TextGrids line by line, and takes a line without an end for the end of the tier. A file
# whose last line is not ended loses the last entry of its last tier without a word. Such files are what tgt 1.5 writes: its
# write_to_file writes the short form by default, and no end of the last line. Of a tier of points the last one is gone, of
# intervals the last one if it lasts until the end of the recording (before that it is an empty one that is lost). The same
# file is read in full by tgt and pympi, and by praatio once a line end is added; the long form is right, too.
# Write format="long", or add the line end.
# Packages: tgt 1.5 and numpy 2.4.6, which it needs and does not name, praatio 6.2.2, pympi-ling 1.71.
# Data: three made-up blinks, written here by tgt.
# Output seen:
#   short: praatio 1.0 2.0, tgt 1.0 2.0 3.0, pympi 1.0 2.0 3.0; messages 0
#   short with a line end: praatio 1.0 2.0 3.0, tgt 1.0 2.0 3.0, pympi 1.0 2.0 3.0; messages 0
#   long: praatio 1.0 2.0 3.0, tgt 1.0 2.0 3.0, pympi 1.0 2.0 3.0; messages 0
#   short, a face that is there until the end: praatio [], tgt [(2.0, 9.0)]
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check tgt==1.5 numpy==2.4.6 praatio==6.2.2 pympi-ling==1.71
env/bin/python - <<'PYTHON'
import sys
import warnings
from pathlib import Path

import pympi
import tgt
from praatio import textgrid as praatio


def written(tier, name, **options):
    grid = tgt.TextGrid()
    grid.add_tier(tier)
    tgt.write_to_file(grid, name, **options)


def read(name):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = {"praatio": [float(one.time) for one in praatio.openTextgrid(name, False).tiers[0].entries]}
    found["tgt"] = [float(one.time) for one in tgt.read_textgrid(name).tiers[0]]
    (tier,) = pympi.Praat.TextGrid(name).get_tiers()
    found["pympi"] = [float(time) for time, _ in tier.intervals]
    return found, len(said)


blinks = tgt.PointTier(0, 9, "blink", [tgt.Point(time, "blink") for time in (1, 2, 3)])
written(blinks, "short.TextGrid")
Path("ended.TextGrid").write_text(Path("short.TextGrid").read_text() + "\n")
written(blinks, "long.TextGrid", format="long")
seen = []
for what, name in (("short", "short"), ("short with a line end", "ended"), ("long", "long")):
    found, said = read(f"{name}.TextGrid")
    seen.append((found, said))
    print(f"{what}: " + ", ".join(f"{who} " + " ".join(map(str, times)) for who, times in found.items()) + f"; messages {said}")
written(tgt.IntervalTier(0, 9, "face", [tgt.Interval(2, 9, "face")]), "face.TextGrid")
last = [(float(one.start), float(one.end)) for one in praatio.openTextgrid("face.TextGrid", False).tiers[0].entries]
whole = [(float(one.start_time), float(one.end_time)) for one in tgt.read_textgrid("face.TextGrid").tiers[0]]
print(f"short, a face that is there until the end: praatio {last}, tgt {whole}")
all_three = dict.fromkeys(("praatio", "tgt", "pympi"), [1, 2, 3])
expected = [({**all_three, "praatio": [1, 2]}, 0), (all_three, 0), (all_three, 0)]
sys.exit(seen != expected or (last, whole) != ([], [(2, 9)]))
PYTHON
