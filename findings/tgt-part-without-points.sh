#!/usr/bin/env bash
# A part of a recording has lost the blink at its begin, and the other blinks last 0 ms.
#
# Found: extract_part of tgt 1.5 makes a new TextGrid of the time from start to end, and each tier an interval tier, also
# tiers of points: events without a length, such as blinks or the begin of a nod, become intervals of 0 s, which Praat does
# not know, and in ELAN's .eaf annotations from a slot to the same slot, while the whole recording's points last 40 ms
# there. A point at the start is left out, and one at the end, too, so that of a recording cut at a point into two
# parts, as one is cut at its events, none has that point. Intervals are right. Nothing is said. Cut points yourself.
# Packages: tgt 1.5, and numpy 2.4.6, which it needs and does not name.
# Data: a made-up TextGrid of 10 s with blinks at 1, 4 and 6 s, and a nod, made here.
# Output seen:
#   whole: TextTier blink 1.0 4.0 6.0; IntervalTier nod 3.0 to 5.0; blinks in ELAN last 40, 40, 40 ms
#   0 to 4 s: IntervalTier blink 1.0 to 1.0; IntervalTier nod 3.0 to 4.0; blinks in ELAN last 0 ms
#   4 to 10 s: IntervalTier blink 2.0 to 2.0; IntervalTier nod 0.0 to 1.0; blinks in ELAN last 0 ms
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check tgt==1.5 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import xml.etree.ElementTree as xml

import tgt

whole = tgt.TextGrid()
whole.add_tier(tgt.PointTier(0, 10, "blink", [tgt.Point(time, "blink") for time in (1, 4, 6)]))
whole.add_tier(tgt.IntervalTier(0, 10, "nod", [tgt.Interval(3, 5, "nod")]))


def lengths(grid):
    """How long the blinks last in ELAN's file, in ms."""
    root = xml.fromstring(tgt.io.export_to_elan(grid).encode())
    slots = {slot.get("TIME_SLOT_ID"): int(slot.get("TIME_VALUE")) for slot in root.iter("TIME_SLOT")}
    (tier,) = root.findall("TIER[@TIER_ID='blink']")
    return [slots[one.get("TIME_SLOT_REF2")] - slots[one.get("TIME_SLOT_REF1")] for one in tier.iter("ALIGNABLE_ANNOTATION")]


def told(tier):
    point = tier.tier_type() == "TextTier"
    times = " ".join(f"{one.start_time}" if point else f"{one.start_time} to {one.end_time}" for one in tier)
    return f"{tier.tier_type()} {tier.name} {times}"


seen = []
for what, grid in {"whole": whole, "0 to 4 s": whole.extract_part(0, 4), "4 to 10 s": whole.extract_part(4, 10)}.items():
    seen.append(([told(tier) for tier in grid], lengths(grid)))
    print(f"{what}: " + "; ".join(seen[-1][0]) + "; blinks in ELAN last " + ", ".join(map(str, seen[-1][1])) + " ms")
expected = [
    (["TextTier blink 1.0 4.0 6.0", "IntervalTier nod 3.0 to 5.0"], [40, 40, 40]),
    (["IntervalTier blink 1.0 to 1.0", "IntervalTier nod 3.0 to 4.0"], [0]),
    (["IntervalTier blink 2.0 to 2.0", "IntervalTier nod 0.0 to 1.0"], [0]),
]
sys.exit(seen != expected)
PYTHON
