#!/usr/bin/env bash
# Where a marker has not yet come into the picture, filling gaps puts it outside of it.
#
# Found: fill_missing_samples of kineticstoolkit 0.17.0 fills gaps of at most so many samples, 0 for any number. Its text
# speaks of interpolation; the samples before the first known one and after the last are filled as well, by a line through
# the two known ones beside them. A face that comes into the picture at 2 s, at 2 pixels a frame, gets places for the two
# seconds before, as far as 100 pixels from where it was first seen, here at -80 pixels, outside of the picture; the
# result has no mark of it, and no message. A limit helps only where the face comes later than that: with 60 all 50 frames
# are still made up, with 49 none.
# Packages: kineticstoolkit 0.17.0 with numpy 2.4.6.
# Data: a point that moves by two pixels a frame and is known in frames 50 to 79 of 100, made here.
# Output seen:
#   0: frame 0 at -80.0, frame 49 at 18.0, frame 99 at 118.0; filled before 50, after 20
#   60: frame 0 at -80.0, frame 49 at 18.0, frame 99 at 118.0; filled before 50, after 20
#   49: frame 0 at nan, frame 49 at nan, frame 99 at 118.0; filled before 0, after 20
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check kineticstoolkit==0.17.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys

with contextlib.redirect_stdout(io.StringIO()):
    import kineticstoolkit as ktk
import numpy as np

x = 20 + 2.0 * (np.arange(100) - 50)
x[:50] = x[80:] = np.nan
series = ktk.TimeSeries(time=np.arange(100) / 25, data={"x": x})
found = {}
for limit in (0, 60, 49):
    y = series.fill_missing_samples(limit).data["x"]
    found[limit] = [*y[[0, 49, 99]].round(6).tolist(), int(np.isfinite(y[:50]).sum()), int(np.isfinite(y[80:]).sum())]
    print("{}: frame 0 at {}, frame 49 at {}, frame 99 at {}; filled before {}, after {}".format(limit, *found[limit]))
whole = [-80.0, 18.0, 118.0, 50, 20]
sys.exit(not (np.allclose(found[0], whole) and np.allclose(found[60], whole) and found[49][3:] == [0, 20]))
PYTHON
