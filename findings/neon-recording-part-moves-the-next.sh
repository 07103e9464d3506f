#!/usr/bin/env bash
# The second part of a recording has the gaze of 100 ms later, since the first part lacks 20 samples.
#
# Found: pupil-labs-neon-recording 2.1.6 reads the folders of the Neon eye tracker. A recording that was interrupted has parts,
# ps1, ps2, ..., each with a file of times and a file of values. Where the two are not equally long, as after the app was
# stopped, the reader takes as many as the shorter has. But it joins the parts first: the times of all, and the values of all.
# So the values of the second part move to the times of the first that have no value, those of the rest are early by as many
# samples, and it is the end of the last part that goes. At 200 Hz, with 20 values less, gaze from after a break of 10 s is
# shown before it, and all later gaze is 100 ms early. More values than times move it the other way. So do blinks, fixations and
# the open lids. Nothing is said. Read part by part, each in a folder of its own.
# Packages: pupil-labs-neon-recording 2.1.6, pupil-labs-video 1.0.14, numpy 2.4.6, pandas 2.3.3.
# Data: a folder with two parts of a second at 200 Hz, 10 s apart; the gaze is where the second it was measured in says, made here.
# Numbers are how late the gaze is, in ms, that is shown at a time.
# Output seen:
#   first part whole: at .975 s 0, at 10 s 0, at 10.5 s 0, last time 10.995
#   first part has 20 values less: at .975 s 9100, at 10 s 100, at 10.5 s 100, last time 10.895
#   first part has 20 times less: at .5 s 0, at 10 s -9100, at 10.5 s -100, last time 10.995
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pupil-labs-neon-recording==2.1.6 pupil-labs-video==1.0.14 numpy==2.4.6 pandas==2.3.3
env/bin/python - <<'PYTHON'
import json
import pathlib
import sys

import numpy as np
from pupil_labs.neon_recording import NeonRecording


def recorded(name, times, values):
    """Gaze that is at x = the number of ms since the start; the first part keeps these numbers of times and values."""
    folder = pathlib.Path(name)
    folder.mkdir()
    (folder / "info.json").write_text(json.dumps({"start_time": 0, "duration": 11 * 10**9}))
    for part, begin, last in ((1, 0, (times, values)), (2, 10_000, (200, 200))):
        milliseconds = begin + np.arange(200) * 5
        (milliseconds[: last[0]].astype("<i8") * 10**6).tofile(folder / f"gaze ps{part}.time")
        np.stack([milliseconds[: last[1]]] * 2, axis=1).astype("<f4").tofile(folder / f"gaze ps{part}.raw")
    gaze = NeonRecording(folder).gaze
    return np.array(gaze.time) // 10**6, np.array(gaze.point)[:, 0]


seen = []
for name, times, values, early in (
    ("first part whole", 200, 200, 975), ("first part has 20 values less", 200, 180, 975), ("first part has 20 times less", 180, 200, 500),
):
    shown, measured = recorded(name, times, values)
    late = [int(measured[shown == at][0]) - at for at in (early, 10_000, 10_500)]
    seen.append([*late, int(shown[-1])])
    at = f"{early / 1000}"[1:]
    print("{}: at {} s {}, at 10 s {}, at 10.5 s {}, last time {}".format(name, at, *late, shown[-1] / 1000))
sys.exit(seen != [[0, 0, 0, 10995], [9100, 100, 100, 10895], [0, -9100, -100, 10995]])
PYTHON
