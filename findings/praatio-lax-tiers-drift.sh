#!/usr/bin/env bash
# A nod and a smile that begin together begin 1.5 s apart in a part of the recording.
#
# Found: crop of praatio 6.2.2 makes a TextGrid of a part. With rebaseToZero the start of the part is taken off all times, by
# its documentation. With mode "lax", which keeps intervals whole that reach over the edges, each tier is moved by another time:
# by the start of its own first interval, if that begins before the part. Of the time from 10 to 15 s, with a nod from
# 9.5 and a smile from 8 s, the nods move by 9.5 s, the smiles by 8 and the points by 10: what began together at 13 s is at 3.5,
# 5 and 3 s. The modes "truncated" and "strict" put all at 3. Warnings of tiers of other lengths are
# switched off for "lax". Take rebaseToZero=False, and shift all tiers by the same time.
# Packages: praatio 6.2.2.
# Data: a made-up TextGrid with a nod, a smile and a blink at 13 s, and earlier ones of the first two, made here.
# Output seen:
#   lax: nod 3.5, smile 5.0, blink 3.0
#   truncated: nod 3.0, smile 3.0, blink 3.0
#   strict: nod 3.0, smile 3.0, blink 3.0
#   messages 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check praatio==6.2.2
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys
import warnings

from praatio import textgrid

grid = textgrid.Textgrid(0, 20)
grid.addTier(textgrid.IntervalTier("nod", [(9.5, 11, "nod"), (13, 14, "nod")], 0, 20))
grid.addTier(textgrid.IntervalTier("smile", [(8, 10.5, "smile"), (13, 14, "smile")], 0, 20))
grid.addTier(textgrid.PointTier("blink", [(13, "blink")], 0, 20))
seen = {}
printed = io.StringIO()
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for mode in ("lax", "truncated", "strict"):
        with contextlib.redirect_stdout(printed):
            part = grid.crop(10, 15, mode=mode, rebaseToZero=True)
        seen[mode] = [(tier.name, float(tier.entries[-1][0])) for tier in part.tiers]
        print(f"{mode}: " + ", ".join("{} {}".format(*one) for one in seen[mode]))
messages = len(said) + len(printed.getvalue())
print("messages", messages)
together = [("nod", 3), ("smile", 3), ("blink", 3)]
sys.exit(seen != {"lax": [("nod", 3.5), ("smile", 5), ("blink", 3)], "truncated": together, "strict": together} or messages > 0)
PYTHON
