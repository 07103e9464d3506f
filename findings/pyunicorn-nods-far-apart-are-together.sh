#!/usr/bin/env bash
# Two people who nod 36 minutes apart nod together.
#
# Found: pyunicorn 1.0.0 measures the synchrony of two series of events, a 0 or 1 for each frame (event_synchronization). It keeps
# numbers of frames in 16 bits: frame 32,768, after 18 minutes at 30 frames/s, is -32,768, and events 65,536 frames apart are
# at the same time. Who nods in the first 15 minutes is so followed, perfectly, by one who nods in the 15 after 36. In an
# hour in which two people nod by chance, one follows the other twice as often as is true; in 20 minutes in which one does
# follow, some nods are lost where the numbers turn. With the frames' numbers or times as ts1 and ts2 it counts rightly, save
# for the ends: the first and the last event of each series never count, so that of three nods the second alone does, and two
# nods that are the same in both have 0. The text speaks of neither. Nothing is said. Give ts1 and ts2, and many events.
# Packages: pyunicorn 1.0.0, numpy 2.4.6, scipy 1.17.1.
# Data: made-up nods at 30 frames/s, made here. The first number is for a who follows b, the second for b who follows a.
# Output seen:
#   36 minutes later: by frames 0.0 1.0, by times 0.0 0.0
#   by chance, 60 minutes: by frames 0.042 0.048, by times 0.017 0.022
#   20 minutes, b follows: by frames 0.026 0.888, by times 0.026 0.922
#   three nods, the second is lost: by frames 0.0 0.0, by times 0.0 0.0
#   two nods, the same: by frames 0.0 0.0, by times 0.0 0.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyunicorn==1.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np
from pyunicorn.eventseries import EventSeries


def by_chance(minutes):
    """Three nods a minute of a, of b .03 to .5 s after each, and of b at any time, as numbers of frames."""
    frames = minutes * 60 * 30
    a = np.sort(random.choice(frames, minutes * 3, replace=False))
    follows = np.unique(np.clip(a + random.integers(1, 15, len(a)), 0, frames - 1))
    return a, follows, np.sort(random.choice(frames, minutes * 3, replace=False))


early = np.arange(1000, 27000, 937)
cases = [("36 minutes later", early, early + 65536 + 5)]
random = np.random.default_rng(0)
clips = {minutes: by_chance(minutes) for minutes in (20, 60)}
cases.append(("by chance, 60 minutes", clips[60][0], clips[60][2]))
cases.append(("20 minutes, b follows", clips[20][0], clips[20][1]))
cases.append(("three nods, the second is lost", [300, 900, 1500], [300, 1200, 1500]))
cases.append(("two nods, the same", [300, 900], [300, 900]))
seen = []
warnings.simplefilter("error")
for name, *nods in cases:
    numbers = np.arange(108000.0)
    a, b = ((np.isin(numbers, events)).astype(int) for events in nods)
    frames = EventSeries.event_synchronization(a, b, taumax=15)
    times = EventSeries.event_synchronization(a, b, ts1=numbers, ts2=numbers, taumax=15)
    seen.append([round(float(rate), 3) for rate in (*frames, *times)])
    print("{}: by frames {} {}, by times {} {}".format(name, *seen[-1]))
expected = [[0.0, 1.0, 0.0, 0.0], [0.042, 0.048, 0.017, 0.022], [0.026, 0.888, 0.026, 0.922], [0.0] * 4, [0.0] * 4]
sys.exit(seen != expected)
PYTHON
