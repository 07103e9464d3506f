#!/usr/bin/env bash
# From the 258th region on nobody ever looks at anything.
#
# Found: sideeye 1.0.0a13 measures how long somebody looks at each region (a word, a part of a picture), whose numbers count
# from 0. It asks whether a fixation's region "is" the region that was asked for, and not whether it equals it. Python keeps the
# whole numbers up to 256 once and makes all others anew: of regions from 257 on every time is 0 or None, as if they had been
# skipped, in a text of 400 words those of the last 143. First pass, total, go-past and second pass alike, and the table of all
# measures too. The text has no limit. Nothing is said. Cut the text in trials of 257 regions at most.
# Packages: sideeye 1.0.0a13.
# Data: a made-up reader who looks at each of 400 words for 200 ms, in their order, and at the first and last again, made here.
# Output seen:
#   word 0: total 400, first pass 200, go past 200, looked at again 200
#   word 256: total 200, first pass 200, go past 200, looked at again 0
#   word 257: total 0, first pass None, go past None, looked at again 0
#   word 399: total 0, first pass None, go past None, looked at again 0
#   words that were looked at: 257 of 400
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check sideeye==1.0.0a13
env/bin/python - <<'PYTHON'
import sys

from sideeye.data import Fixation, Item, Point, Region, Trial
from sideeye.measures.region import duration

regions = [Region(Point(number * 5, 0), Point(number * 5 + 5, 0), length=5, text="word ") for number in range(400)]
item = Item("1", "1", regions)
fixations = []
for looked, number in enumerate([*range(400), 0, 399]):
    place = number * 5 + 2
    fixations.append(Fixation(Point(place, 0), looked * 230, looked * 230 + 200, looked, item.find_region(place, 0)))
assert all(fixation.region.number == fixation.char // 5 for fixation in fixations)
trial = Trial(0, 402 * 230, item, fixations)
seen = []
for number in (0, 256, 257, 399):
    measures = (duration.total_time, duration.first_pass, duration.go_past, duration.second_pass)
    seen.append(tuple(measure(trial, number)["value"] for measure in measures))
    print("word {}: total {}, first pass {}, go past {}, looked at again {}".format(number, *seen[-1]))
looked_at = sum(duration.total_time(trial, number)["value"] > 0 for number in range(400))
print(f"words that were looked at: {looked_at} of 400")
sys.exit(seen != [(400, 200, 200, 200), (200, 200, 200, 0), (0, None, None, 0), (0, None, None, 0)] or looked_at != 257)
PYTHON
