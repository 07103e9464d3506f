#!/usr/bin/env bash
# Nobody nods in the second of three clips, so the nods of the third are 10 s early.
#
# Found: concatenate_textgrids of tgt 1.5 puts TextGrids behind each other, each later by what came before. The end
# of what came before is only moved on where a tier has something: a clip in which nothing is annotated takes no time at all. Of
# three clips of 10 s, with the second one empty, the nod at 1 s of the third comes at 11 s and not 21, and all ends at 20 s for
# 30. A clip that is empty but for one tier is counted, so that a nod anywhere puts it right; that clip's empty tiers then end
# early. The tiers, which should keep their order by a comment, come in that of a set: another one from run to run. Nothing
# is said. Add offsets yourself.
# Packages: tgt 1.5, and numpy 2.4.6, which it needs and does not name.
# Data: TextGrids of three made-up clips, made here and written and read by tgt.
# Output seen:
#   clips of 10, 10, 10 s, nothing in the second: nod 1.0 to 2.0, nod 11.0 to 12.0; the end is at 20.0
#   clips of 10, 10, 10 s, a blink in the second: nod 1.0 to 2.0, nod 21.0 to 22.0; the end is at 30.0
#   orders of three tiers in 20 runs: more than one
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check tgt==1.5 numpy==2.4.6
cat > join.py <<'PYTHON'
import sys

import tgt


def clip(name, nods, blinks):
    nod = tgt.IntervalTier(0, 10, "nod", [tgt.Interval(*span, "nod") for span in nods])
    blink = tgt.PointTier(0, 10, "blink", [tgt.Point(time, "blink") for time in blinks])
    grid = tgt.TextGrid()
    grid.add_tiers([nod, blink, tgt.IntervalTier(0, 10, "smile")])
    tgt.write_to_file(grid, name, format="long")
    return tgt.read_textgrid(name)


def joined(second):
    first, third = clip("a.TextGrid", [(1, 2)], [3]), clip("c.TextGrid", [(1, 2)], [3])
    return tgt.util.concatenate_textgrids([first, clip("b.TextGrid", [], second), third])


if len(sys.argv) > 1:
    print(*joined([]).get_tier_names())
    sys.exit()
seen = []
for what, second in (("nothing", []), ("a blink", [5])):
    grid = joined(second)
    nods = [(float(nod.start_time), float(nod.end_time)) for nod in grid.get_tier_by_name("nod")]
    seen.append((nods, float(grid.end_time)))
    spans = ", ".join("nod {} to {}".format(*nod) for nod in nods)
    print(f"clips of 10, 10, 10 s, {what} in the second: {spans}; the end is at {seen[-1][1]}")
sys.exit(seen != [([(1, 2), (11, 12)], 20), ([(1, 2), (21, 22)], 30)])
PYTHON
env/bin/python join.py
orders=$(for seed in $(seq 20); do PYTHONHASHSEED=$seed env/bin/python join.py order; done | sort -u | wc -l)
[ "$orders" -gt 1 ] && echo "orders of three tiers in 20 runs: more than one"
