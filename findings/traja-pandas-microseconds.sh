#!/usr/bin/env bash
# With a newer pandas every face moves a thousand times as fast.
#
# Found: traja 25.0.1 computes speeds and accelerations of tracks. Where times are dates, it divides their whole numbers
# by a thousand million, as nanoseconds. pandas 3 counts dates in microseconds unless somebody asks for more. The same
# CSV with the same program is 50 pixels/s with pandas 2.3.3 and 50,000 with 3.1.1, the times are 0 to .00016 s, and an
# acceleration of 0 becomes 7276 pixels/s². The numbers are kept in 32 bits besides, and so are not even equal from
# frame to frame. Nothing is said, and pip takes either pandas. Times as numbers, in seconds, are right in both; or bring
# the column to nanoseconds by .dt.as_unit("ns").
# Packages: traja 25.0.1, scikit-learn 1.9.1, which it needs and does not name, scipy 1.17.1, pandas 3.1.1 and 2.3.3, numpy 2.4.6.
# Data: a point that moves by two pixels in each of five frames at 25 frames/s, written here.
# Output seen:
#   pandas 3.1.1, dates (datetime64[us]): speeds [50000.2, 49999.9, 49999.9, 50000.2] to 0.00016 s; messages 0
#   pandas 3.1.1, as nanoseconds (datetime64[ns]): speeds [50.0, 50.0, 50.0, 50.0] to 0.16000 s; messages 0
#   pandas 3.1.1, seconds (float64): speeds [50.0, 50.0, 50.0, 50.0] to 0.16000 s; messages 0
#   pandas 2.3.3, dates (datetime64[ns]): speeds [50.0, 50.0, 50.0, 50.0] to 0.16000 s; messages 0
#   pandas 2.3.3, as nanoseconds (datetime64[ns]): speeds [50.0, 50.0, 50.0, 50.0] to 0.16000 s; messages 0
#   pandas 2.3.3, seconds (float64): speeds [50.0, 50.0, 50.0, 50.0] to 0.16000 s; messages 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > track.csv <<'CSV'
time,x,y
2026-01-01 00:00:00.000,10,20
2026-01-01 00:00:00.040,12,20
2026-01-01 00:00:00.080,14,20
2026-01-01 00:00:00.120,16,20
2026-01-01 00:00:00.160,18,20
CSV
cat > speed.py <<'PYTHON'
import sys
import warnings

import numpy as np
import pandas as pd

warnings.simplefilter("ignore")  # of the import: no PyTorch
import traja

dates = pd.read_csv("track.csv", parse_dates=["time"])
seconds = dates.assign(time=np.arange(5) / 25)
nanoseconds = dates.assign(time=dates["time"].dt.as_unit("ns"))
found = {}
for name, table in (("dates", dates), ("as nanoseconds", nanoseconds), ("seconds", seconds)):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        derived = traja.get_derivatives(traja.TrajaDataFrame(table))
    found[name] = derived["speed"].to_numpy()[1:]
    last = float(derived["displacement_time"].iloc[-1])
    speeds = found[name].round(1).tolist()
    print(f"pandas {pd.__version__}, {name} ({table['time'].dtype}): speeds {speeds} to {last:.5f} s; messages {len(said)}")
factors = {"dates": float(sys.argv[1]), "as nanoseconds": 1, "seconds": 1}
sys.exit(not all(np.allclose(found[name], 50 * factor, rtol=1e-4) for name, factor in factors.items()))
PYTHON
python3 -m venv new
new/bin/pip install --quiet --disable-pip-version-check traja==25.0.1 scikit-learn==1.9.1 scipy==1.17.1 pandas==3.1.1 numpy==2.4.6
python3 -m venv old
old/bin/pip install --quiet --disable-pip-version-check traja==25.0.1 scikit-learn==1.9.1 scipy==1.17.1 pandas==2.3.3 numpy==2.4.6
new/bin/python speed.py 1000
old/bin/python speed.py 1
