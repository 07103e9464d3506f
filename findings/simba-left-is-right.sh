#!/usr/bin/env bash
# Heads that look 15 degrees to the left look 15 degrees to the right, and two that turn against each other turn together.
#
# Found: SimBA 5.6.1 (simba-uw-tf-dev) has statistics of angles in degrees, 0 to 360. circular_mean returns the size of what
# arctan2 gives, -180 to 180, without its sign: angles between 180 and 360 degrees have the mirrored mean, so that of 340 and
# 350 it is 15, while the same mean in sliding windows, sliding_circular_mean, is 345. circular_correlation "ranges from -1 to
# 1: -1 indicates perfect negative correlation" by its documentation, and returns the size alone, never below 0, in windows too.
# Nothing is said. Take sliding windows of the whole length, and scipy.
# Packages: simba-uw-tf-dev 5.6.1 without its windows, numba 0.68.1, numpy 2.4.6.
# Data: made-up directions of heads in degrees, made here.
# Output seen:
#   10 20: mean 15, in a window 15
#   340 350: mean 15, in a window 345
#   190 200: mean 165, in a window 195
#   two heads that turn together: correlation 1.00
#   two heads that turn against each other: correlation 1.00, in a window 1.00
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check numba==0.68.1 numpy==2.4.6
env/bin/pip install --quiet --disable-pip-version-check --no-deps simba-uw-tf-dev==5.6.1
env/bin/python -W ignore - <<'PYTHON'
import sys
from unittest.mock import MagicMock

UTILS = (f"simba.utils.{part}" for part in ("checks", "data", "enums", "errors", "read_write", "warnings"))
for name in ("matplotlib", "sklearn", "sklearn.ensemble", "simba.utils", *UTILS):
    sys.modules[name] = MagicMock()  # windows and checks of what is given, which are not used here
enums = sys.modules["simba.utils.enums"]
enums.ENV_VARS.MP_START_METHOD.value, enums.OS.SPAWN.value = "NOT_SET", "spawn"
import numpy as np
from simba.mixins.circular_statistics import CircularStatisticsMixin as Circular


def degrees(*angles):
    return np.array(angles, dtype=np.float32)


means = []
for angles in ((10, 20), (340, 350), (190, 200)):
    window = Circular.sliding_circular_mean(degrees(*angles), np.array([1.0]), 2.0)[-1, 0]
    means.append((round(float(Circular.circular_mean(degrees(*angles)))), round(float(window))))
    print("{} {}: mean {}, in a window {}".format(*angles, *means[-1]))
sway = 20 * np.sin(np.arange(300) / 20)
one, with_it, against = (degrees(*(180 + side * sway)) for side in (1, 1, -1))
window = Circular.sliding_circular_correlation(one, against, np.array([10.0]), 30)[-1, 0]
whole = [Circular.circular_correlation(one, other) for other in (with_it, against)]
correlations = [round(float(number), 2) for number in (*whole, window)]
print("two heads that turn together: correlation {:.2f}".format(correlations[0]))
print("two heads that turn against each other: correlation {:.2f}, in a window {:.2f}".format(*correlations[1:]))
sys.exit(means != [(15, 15), (15, 345), (165, 195)] or correlations != [1, 1, 1])
PYTHON
