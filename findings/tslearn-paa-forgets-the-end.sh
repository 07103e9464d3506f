#!/usr/bin/env bash
# A clip of 20 s is shortened to 17 s, since it has a frame less than it should.
#
# Found: tslearn 0.10.0 shortens time courses to a number of segments (PiecewiseAggregateApproximation, PAA) and to symbols of
# them (SAX, 1d-SAX). A segment has the frames of the clip divided by the segments, without the rest, and the rest belongs to
# none: of 600 frames in 100 segments all are used, of 599 the last 99 are not, and of 1,199 neither. A blink there changes
# nothing: two clips that are opposites in their last 3 s have the same symbols and a distance of 0. inverse_transform, which should
# have the clip's length, has zeros for these frames, so that an eye that is open seems to close. The example in the text divides
# without a rest. Nothing is said. Give a number of segments that divides the frames, or resample the clip before.
# Packages: tslearn 0.10.0, numpy 2.4.6.
# Data: made-up time courses, an eye that is open (1) and closed (0) for 6 frames in the last second, and noise.
# Output seen:
#   600 frames: 0 in no segment; least of the segments 0.0; back again 6 closed; opposite ends differ in 17 symbols
#   599 frames: 99 in no segment; least of the segments 1.0; back again 99 closed; opposite ends differ in 0 symbols
#   1199 frames: 99 in no segment; least of the segments 1.0; back again 99 closed; opposite ends differ in 0 symbols
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check tslearn==0.10.0 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import sys

import numpy as np
from tslearn.piecewise import PiecewiseAggregateApproximation, SymbolicAggregateApproximation

seen = []
for frames in (600, 599, 1199):
    paa, sax = PiecewiseAggregateApproximation(100), SymbolicAggregateApproximation(100, alphabet_size_avg=8)
    used = paa.fit_transform(np.eye(frames)).any(axis=(1, 2))  # a course each with a single frame that is not 0
    eye = np.ones(frames)
    eye[-24:-18] = 0
    short = paa.fit_transform(eye[None])
    back = paa.inverse_transform(short)[0, :, 0]
    noise = np.random.default_rng(0).normal(size=frames)
    opposite = np.where(np.arange(frames) < frames - 99, noise, -noise)
    symbols = sax.fit_transform(np.stack([noise, opposite]))
    row = (int((~used).sum()), float(short.min()), int((back == 0).sum()), int((symbols[0] != symbols[1]).sum()))
    seen.append(row)
    print(f"{frames} frames: {row[0]} in no segment; least of the segments {row[1]}; back again {row[2]} closed;",
          f"opposite ends differ in {row[3]} symbols")
sys.exit(seen != [(0, 0.0, 6, 17), (99, 1.0, 99, 0), (99, 1.0, 99, 0)])
PYTHON
