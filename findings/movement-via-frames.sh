#!/usr/bin/env bash
# Of 600 frames 37 are written with the number of the frame before.
#
# Found: movement 0.15.0 keeps times in seconds, k / fps. save_bboxes.to_via_tracks_file makes frame numbers of them
# by time x fps, and cuts off what is behind the point: 29 / 25 * 25 is 28.999..., and becomes 28. Of 600 frames at
# 25 frames/s 37 have the number before their own; at 30 frames/s it is 10, at 24000/1001 it is 45. The frame before
# then has two boxes of the same track, this one has none, and a box is a frame early. Nothing is said when it is
# written. When movement reads its own file, it refuses it, since one picture has two boxes of one track; other
# programs that read VIA's table take Without fps (times in frames) all numbers are right.
# Packages: movement 0.15.0, xarray 2026.9.0, numpy 2.4.6, pandas 3.1.1.
# Data: a box that moves by one pixel a frame, made here.
# Output seen:
#   25 frames/s: 600 rows, 567 frames; 37 rows have the frame before True, first [29, 57, 58]; read back: refused
#   30 frames/s: 600 rows, 592 frames; 10 rows have the frame before True, first [123, 245, 246]; read back: refused
#   24000/1001 frames/s: 600 rows, 558 frames; 45 rows have the frame before True, first [27, 49, 54];
#       read back: refused
#   no frames/s: 600 rows, 600 frames; 0 rows have the frame before True, first []; read back: 600
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check movement==0.15.0 xarray==2026.9.0 numpy==2.4.6 pandas==3.1.1 loguru==0.7.3
env/bin/python - <<'PYTHON'
import contextlib
import csv
import io
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
with contextlib.redirect_stderr(io.StringIO()):
    from movement.io import load_bboxes, save_bboxes
import numpy as np
from loguru import logger

logger.remove()
COUNT = 600


def seen(what, rate):
    path = Path(f"{what.replace('/', '-')}.csv")
    place = np.full((COUNT, 2, 1), 100.0) + np.arange(COUNT)[:, None, None]
    boxes = load_bboxes.from_numpy(
        position_array=place,
        shape_array=np.full((COUNT, 2, 1), 20.0),
        confidence_array=np.full((COUNT, 1), 0.9),
        individual_names=["id_0"],
        fps=rate,
    )
    save_bboxes.to_via_tracks_file(boxes, path)
    with path.open(newline="") as file:
        numbers = [int(Path(row["filename"]).stem) for row in csv.DictReader(file)]
    wrong = [k for k, number in enumerate(numbers) if number != k]
    before = all(numbers[k] == k - 1 for k in wrong)
    try:
        back = load_bboxes.from_via_tracks_file(path, fps=rate).sizes["time"]
    except ValueError:
        back = "refused"
    counts = f"{len(numbers)} rows, {len(set(numbers))} frames; {len(wrong)} rows have the frame before {before}"
    print(f"{what} frames/s: {counts}, first {wrong[:3]}; read back: {back}")
    return len(numbers), len(set(numbers)), len(wrong), before, wrong[:3], back


found = [seen(what, rate) for what, rate in (("25", 25), ("30", 30), ("24000/1001", 24000 / 1001), ("no", None))]
sys.exit(
    found
    != [
        (600, 567, 37, True, [29, 57, 58], "refused"),
        (600, 592, 10, True, [123, 245, 246], "refused"),
        (600, 558, 45, True, [27, 49, 54], "refused"),
        (600, 600, 0, True, [], 600),
    ]
)
PYTHON
