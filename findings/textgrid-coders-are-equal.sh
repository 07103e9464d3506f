#!/usr/bin/env bash
# Two coders who agree on no label are equal, and the first tier that is taken out is the last.
#
# Found: TextGrid 1.6.1 compares two TextGrids by == through their times alone, and only as far as the shorter list goes: labels,
# names of tiers, and all that one has beyond the other do not count. A coder who writes "frown" where the other wrote "smile",
# under another tier, with one event more, is equal to that coder; an empty file is equal to every file. Who looks for what a
# correction has changed, or whether two coders differ at all, is told that nothing has. != says the same. pop(i) removes "tier at
# index i (default last)" by its documentation, and takes 0 for no index: pop(0) removes the last tier.
# Nothing is said. Compare lists of (minTime, maxTime, mark) of each tier; take del grid.tiers[0].
# Packages: TextGrid 1.6.1.
# Data: a smile and a frown of two made-up coders, made here.
# Output seen:
#   other labels, another tier: equal True, unequal False
#   three events and two: equal True, unequal False
#   events and none: equal True, unequal False
#   another time: equal False, unequal True
#   points with other labels: equal True, unequal False
#   pop(0) of head, mouth, eyes: eyes, left are head, mouth
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check TextGrid==1.6.1
env/bin/python - <<'PYTHON'
import sys

from textgrid import IntervalTier, PointTier, TextGrid


def coded(tier, *events):
    for event in events:
        tier.add(*event)
    grid = TextGrid(maxTime=10)
    grid.append(tier)
    return grid


first = coded(IntervalTier("mouth", 0, 10), (1, 2, "smile"), (4, 5, "frown"))
others = {
    "other labels, another tier": coded(IntervalTier("coder 2", 0, 10), (1, 2, "frown"), (4, 5, "smile")),
    "three events and two": coded(IntervalTier("mouth", 0, 10), (1, 2, "smile"), (4, 5, "frown"), (7, 8, "smile")),
    "events and none": coded(IntervalTier("mouth", 0, 10)),
    "another time": coded(IntervalTier("mouth", 0, 10), (1, 2, "smile"), (4, 5.04, "frown")),
}
pairs = {what: (first, other) for what, other in others.items()}
points = [coded(PointTier("lids", 0, 10), (3, label)) for label in ("blink", "wink")]
pairs["points with other labels"] = tuple(points)
seen = {what: (one == other, one != other) for what, (one, other) in pairs.items()}
for what, (equal, unequal) in seen.items():
    print(f"{what}: equal {equal}, unequal {unequal}")
grid = TextGrid(maxTime=10)
for name in ("head", "mouth", "eyes"):
    grid.append(IntervalTier(name, 0, 10))
taken, left = grid.pop(0).name, grid.getNames()
print(f"pop(0) of head, mouth, eyes: {taken}, left are {', '.join(left)}")
expected = {what: (what != "another time", what == "another time") for what in pairs}
sys.exit(seen != expected or (taken, left) != ("eyes", ["head", "mouth"]))
PYTHON
