#!/usr/bin/env bash
# The head nods by 10 degrees, and is read as nodding by 3,641.
#
# Found: load_edf of biosppy 2.2.4 reads EDF+, by its documentation as signals "into physical units". It scales all signals but
# the last, which it takes for that of the annotations. A file without annotations, plain EDF or EDF+ with none, has no such
# signal, and its last signal keeps the numbers of the file: here up to 3,641 for 10 degrees. Rates are cut to whole numbers:
# 29.97 frames/s are 29, 23.976 are 23, so that time by the rate runs 3 or 4 % slow, a minute is 2 s longer. Onsets of
# annotations are text as "0:00:02". Nothing is said. Read by edfio or MNE, or write an annotation.
# Packages: biosppy 2.2.4, PeakUtils 1.3.5, which it needs and does not name, edfio 0.4.18, numpy 2.4.6.
# Data: 2,997 frames of a head that turns from -20 to 20 and nods from -10 to 10 degrees, at 29.97 frames/s, written here by edfio.
# Output seen:
#   plain: yaw -20.0 to 20.0, pitch -3641.0 to 3640.0, 29 frames/s
#   with a nod: yaw -20.0 to 20.0, pitch -10.0 to 10.0, 29 frames/s, [('0:00:02', '0:00:00', 'nod')]
#   only pitch, plain: pitch -3641.0 to 3640.0, 29 frames/s
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check biosppy==2.2.4 PeakUtils==1.3.5 edfio==0.4.18 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import sys

import numpy as np
from biosppy.storage import load_edf
from edfio import Edf, EdfAnnotation, EdfSignal


def signal(name, most):
    return EdfSignal(np.linspace(-most, most, 2997), 29.97, label=name, physical_dimension="deg", physical_range=(-90, 90))


seen = []
yaw, pitch = signal("yaw", 20), signal("pitch", 10)
for name, signals, events in (
    ("plain", [yaw, pitch], None), ("with a nod", [yaw, pitch], [EdfAnnotation(2, None, "nod")]), ("only pitch, plain", [pitch], None),
):
    Edf(signals, annotations=events).write("head.edf")
    values, header = load_edf("head.edf")
    ranges = [f"{label} {column.min():.1f} to {column.max():.1f}" for label, column in zip(header["labels"], values.T)]
    rate = {f"{rate} frames/s" for rate in header["sampling_rates"]}
    seen.append(", ".join([*ranges, *rate, *([str(header["annotations"])] if events else [])]))
    print(f"{name}: {seen[-1]}")
expected = [
    "yaw -20.0 to 20.0, pitch -3641.0 to 3640.0, 29 frames/s",
    "yaw -20.0 to 20.0, pitch -10.0 to 10.0, 29 frames/s, [('0:00:02', '0:00:00', 'nod')]",
    "pitch -3641.0 to 3640.0, 29 frames/s",
]
sys.exit(seen != expected)
PYTHON
