#!/usr/bin/env bash
# Of five blinks at 30 frames/s one is left, three times as long.
#
# Found: blink detection of pymovements 0.28.0 joins blinks between which the eye is open for less than minimum_gap. By its
# documentation this is a duration in the units of the times, as minimum_duration and maximum_duration are; in fact it
# is a number of samples. At 1,000 samples/s both are the same. Of a video at 30 frames/s the default of 5 ms is 5 frames, 167 ms:
# a double blink is a single blink of three times the length. With 50 ms it is 50 frames, 1.7 s: blinks that follow
# each other sooner become a closure of seconds, which is longer than maximum_duration (500 ms), and all of them are
# gone. Nothing is said as long as any blink is left. Give minimum_gap in frames, at most 2 for a video, and the others in ms.
# Packages: pymovements 0.28.0, polars 2.1.0, numpy 2.4.6.
# Data: a made-up opening of an eye that blinks five times, at two rates, made here; times in ms.
# Output seen:
#   1000 samples/s, gap 5 ms: 2000 to 2150, 2300 to 2450, 4500 to 4650, 5500 to 5650, 6500 to 6650
#   1000 samples/s, gap 50 ms: 2000 to 2150, 2300 to 2450, 4500 to 4650, 5500 to 5650, 6500 to 6650
#   30 samples/s, gap 5 ms: 2000 to 2433, 4500 to 4633, 5500 to 5633, 6500 to 6633
#   30 samples/s, gap 50 ms: 2000 to 2433
#   30 samples/s, gap 2 ms: 2000 to 2133, 2300 to 2433, 4500 to 4633, 5500 to 5633, 6500 to 6633
#   messages about blinks: 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pymovements==0.28.0 polars==2.1.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np
import polars
import pymovements

noise = np.random.default_rng(1)
BLINKS = [(begin, begin + 150) for begin in (2000, 2300, 4500, 5500, 6500)]


def found(rate, gap):
    time = np.arange(8 * rate) * 1000 / rate
    opening = 5 + noise.normal(0, 0.02, time.size)
    for begin, end in BLINKS:
        opening[(time >= begin) & (time <= end)] = np.nan
    samples = polars.DataFrame({"time": time, "pupil": opening})
    gaze = pymovements.Gaze(samples=samples, time_column="time", time_unit="ms")
    gaze.detect("blink", minimum_gap=gap)
    events = [(round(begin), round(end)) for begin, end in gaze.events.frame.select("onset", "offset").rows()]
    print(f"{rate} samples/s, gap {gap} ms: " + ", ".join("{} to {}".format(*event) for event in events))
    return events


with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    seen = [found(1000, 5), found(1000, 50), found(30, 5), found(30, 50), found(30, 2)]
messages = sum("blink" in str(one.message) for one in said)
print("messages about blinks:", messages)
frames = [(begin, begin + 133) for begin, _ in BLINKS]
expected = [BLINKS, BLINKS, [(2000, 2433), *frames[2:]], [(2000, 2433)], frames]
sys.exit(seen != expected or messages > 0)
PYTHON
