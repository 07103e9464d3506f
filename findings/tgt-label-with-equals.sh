#!/usr/bin/env bash
# "AU12 = 3" is read as "AU1".
#
# Found: tgt 1.5 reads a TextGrid in Praat's long form by cutting each line at " = ", and takes the second part, less its
# first and last character, which should be quotes. Of a label that holds " = " itself, as an intensity or a setting is written,
# all from there on is lost, and the letter before, too: "AU12 = 3" becomes "AU1", another action unit; "AU25 = 1" and
# "AU26 = 4" both become "AU2". Names of tiers and of points are cut likewise, so that the tiers of two raters have one name. The
# file itself is right, also where tgt has written it; praatio reads the labels as they are, and tgt does in Praat's
# short form. Nothing is said. Write "AU12=3", or keep to the short form.
# Packages: tgt 1.5 and numpy 2.4.6, which it needs and does not name, praatio 6.2.2.
# Data: four made-up labels, written here by tgt.
# Output seen:
#   long, by tgt: tier "rate", labels "AU1", "AU2", "AU2", "AU12=3"
#   long, by praatio: tier "rater = a", labels "AU12 = 3", "AU25 = 1", "AU26 = 4", "AU12=3"
#   short, by tgt: tier "rater = a", labels "AU12 = 3", "AU25 = 1", "AU26 = 4", "AU12=3"
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check tgt==1.5 numpy==2.4.6 praatio==6.2.2
env/bin/python - <<'PYTHON'
import sys

import tgt
from praatio import textgrid

LABELS = ["AU12 = 3", "AU25 = 1", "AU26 = 4", "AU12=3"]
grid = tgt.TextGrid()
grid.add_tier(tgt.IntervalTier(0, 9, "rater = a", [tgt.Interval(k, k + 1, label) for k, label in enumerate(LABELS)]))


def by_tgt(name):
    (tier,) = tgt.read_textgrid(name)
    return tier.name, [interval.text for interval in tier]


def by_praatio(name):
    (tier,) = textgrid.openTextgrid(name, includeEmptyIntervals=False).tiers
    return tier.name, [interval.label for interval in tier.entries]


seen = []
for form, reader in (("long", by_tgt), ("long", by_praatio), ("short", by_tgt)):
    tgt.write_to_file(grid, f"{form}.TextGrid", format=form)
    name, labels = reader(f"{form}.TextGrid")
    seen.append((name, labels))
    quoted = ", ".join(f'"{label}"' for label in labels)
    print(f'{form}, by {reader.__name__[3:]}: tier "{name}", labels {quoted}')
right = ("rater = a", LABELS)
sys.exit(seen != [("rate", ["AU1", "AU2", "AU2", "AU12=3"]), right, right])
PYTHON
