#!/usr/bin/env bash
# Two coders agree with an alpha of .99 in whole numbers, and of -.17 in the same numbers as bytes.
#
# Found: krippendorff 0.9.0 takes the values of an array as they come, and subtracts them in their own type. Codes are often
# kept as uint8 (intensities 0 to 5 of action units, percents, what is read from a picture or from HDF5): 3 - 4 is then
# 255. Differences downwards count as the largest of all, and upwards as they are: alpha of intensities falls from .91 to .37
# (interval, which is the default) and from .67 to -.38 (ratio), that of percents from .99 to -.17, and to -14 for
# ratios. Nominal and ordinal are right. Without missing codes nothing turns the array into floats; with a nan it is a float
# anyway, and right. Nothing is said. Give floats.
# Packages: krippendorff 0.9.0, numpy 2.4.6.
# Data: intensities and percents of 200 frames from two made-up coders, made here.
# Output seen:
#   intensities, int64: nominal 0.37, ordinal 0.91, interval 0.91, ratio 0.67
#   intensities, uint8: nominal 0.37, ordinal 0.91, interval 0.37, ratio -0.38
#   intensities, float64: nominal 0.37, ordinal 0.91, interval 0.91, ratio 0.67
#   percents, int64: nominal 0.06, ordinal 0.99, interval 0.99, ratio 0.91
#   percents, uint8: nominal 0.06, ordinal 0.99, interval -0.17, ratio -14.47
#   percents, float64: nominal 0.06, ordinal 0.99, interval 0.99, ratio 0.91
#   messages 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check krippendorff==0.9.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

import krippendorff
import numpy as np

noise = np.random.default_rng(0)
LEVELS = ("nominal", "ordinal", "interval", "ratio")


def coders(most, apart):
    first = noise.integers(0, most + 1, 200)
    return np.array([first, np.clip(first + noise.integers(-apart, apart + 1, 200), 0, most)])


seen = {}
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for what, codes in {"intensities": coders(5, 1), "percents": coders(100, 5)}.items():
        for kind in ("int64", "uint8", "float64"):
            alphas = [round(float(krippendorff.alpha(codes.astype(kind), level_of_measurement=level)), 2) for level in LEVELS]
            print(f"{what}, {kind}: " + ", ".join(f"{level} {alpha}" for level, alpha in zip(LEVELS, alphas)))
            seen[what, kind] = alphas
print("messages", len(said))
right = {"intensities": [0.37, 0.91, 0.91, 0.67], "percents": [0.06, 0.99, 0.99, 0.91]}
wrong = {"intensities": [0.37, 0.91, 0.37, -0.38], "percents": [0.06, 0.99, -0.17, -14.47]}
expected = {(what, kind): (wrong if kind == "uint8" else right)[what] for what, kind in seen}
sys.exit(seen != expected or bool(said))
PYTHON
