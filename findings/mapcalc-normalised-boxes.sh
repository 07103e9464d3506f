#!/usr/bin/env bash
# With boxes as shares of the picture every tracker is perfect.
#
# Found: mapcalc 0.2.2 measures boxes x1, y1, x2, y2; its text names no unit. It adds 1 to each width and height, as for
# whole pixels, also to those of the overlap. Boxes in shares of the picture (0 to 1, as YOLO, MediaPipe and Label Studio
# give them) then overlap almost whatever they are: a face of 40 pixels that is found five times its width beside itself,
# in a picture of 640, has an overlap of .545, and mAP is 1. The same boxes in pixels give 0. In pixels small faces win:
# one of 6 pixels, off by 2.2, has an overlap of .463, and counts as .5 and more. Nothing is said. Multiply boxes by the
# picture's size before, and do not judge faces of less than some 20 pixels by it.
# Packages: mapcalc 0.2.2, numpy 2.4.6.
# Data: two made-up boxes, written here.
# Output seen:
#   a face of 40 px, off by 0 px: overlap 1.0; mAP in pixels 1.0, in shares 1.0
#   a face of 40 px, off by 200 px: overlap 0.0; mAP in pixels 0.0, in shares 1.0
#   a face of 6 px, off by 2.2 px: overlap 0.463; mAP in pixels 1.0, in shares 1.0
#   a face of 6 px, off by 2.6 px: overlap 0.395; mAP in pixels 0.0, in shares 1.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check mapcalc==0.2.2 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys

from mapcalc import calculate_map

seen = []
for size, off in ((40, 0), (40, 200), (6, 2.2), (6, 2.6)):
    overlap = round(max(size - off, 0) / (size + min(off, size)), 3)
    found = []
    for unit in (1, 640):  # a picture of 640 x 640
        truth = {"boxes": [[c / unit for c in (100, 100, 100 + size, 100 + size)]], "labels": [1]}
        moved = [c / unit for c in (100 + off, 100, 100 + off + size, 100 + size)]
        found.append(float(calculate_map(truth, {"boxes": [moved], "labels": [1], "scores": [0.9]}, 0.5)))
    seen.append((overlap, *found))
    print(f"a face of {size} px, off by {off} px: overlap {overlap}; mAP in pixels {found[0]}, in shares {found[1]}")
sys.exit(seen != [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (0.463, 1.0, 1.0), (0.395, 0.0, 1.0)])
PYTHON
