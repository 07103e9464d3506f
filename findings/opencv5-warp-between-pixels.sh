#!/usr/bin/env bash
# The same picture under the same map has other pixels in OpenCV 5 than in OpenCV 4.
#
# Found: cv2.warpAffine, warpPerspective and remap of OpenCV 4.14 read at multiples of 1/32 pixel, those of 5.0 exactly
# where they are told to. Of a smooth picture two grey values in a hundred differ, by 1 or 2, of noise most, by up to 5.
# What was tuned by the one, or draws random numbers by what it sees, takes another way with the other. The
# parameter hint, which is new in 5 (cv2.ALGO_HINT_APPROX), changes nothing. Bit for bit as 4 is in 5 only remap with
# fixed-point maps: whole pixels as int16 (h, w, 2), and the 32nds beyond, 32 * y + x, as uint16; of a picture of bytes
# or of float32, linear.
# Packages: opencv-python-headless 4.14.0.94 and 5.0.0.93, numpy 2.4.6.
# Data: made-up noise, as it is and blurred, written here.
# Output seen:
#   smooth, warpAffine: 2.0 % differ, by up to 2
#   smooth, warpAffine, hint APPROX: 2.0 % differ, by up to 2
#   smooth, remap, float maps: 1.8 % differ, by up to 2
#   smooth, remap, fixed-point maps: 0.0 % differ, by up to 0
#   noise, warpAffine: 60.4 % differ, by up to 5
#   noise, warpAffine, hint APPROX: 60.4 % differ, by up to 5
#   noise, remap, float maps: 60.4 % differ, by up to 5
#   noise, remap, fixed-point maps: 0.0 % differ, by up to 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > warp.py <<'PYTHON'
import sys

import cv2
import numpy as np

noise = np.random.default_rng(0).integers(0, 256, (240, 320, 3)).astype(np.uint8)
matrix, size = np.array([[0.7, 0.1, 3.3], [-0.1, 0.7, 5.7]]), (200, 150)
x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
inverse = {"flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP}
u, v = (row[0] * x + row[1] * y + row[2] for row in matrix)
fine_x, fine_y = (np.rint(one * 32).astype(np.int64) for one in (u, v))
fixed = np.stack([fine_x >> 5, fine_y >> 5], -1).astype(np.int16), ((fine_y & 31) * 32 + (fine_x & 31)).astype(np.uint16)
hint = {"hint": cv2.ALGO_HINT_APPROX} if cv2.__version__ >= "5" else {}
found = {}
for name, picture in {"smooth": cv2.GaussianBlur(noise, (0, 0), 3), "noise": noise}.items():
    found[f"{name}, warpAffine"] = cv2.warpAffine(picture, matrix, size, **inverse)
    found[f"{name}, warpAffine, hint APPROX"] = cv2.warpAffine(picture, matrix, size, **inverse, **hint)
    found[f"{name}, remap, float maps"] = cv2.remap(picture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    found[f"{name}, remap, fixed-point maps"] = cv2.remap(picture, *fixed, cv2.INTER_LINEAR)
np.savez(sys.argv[1], **found)
PYTHON
for version in 4.14.0.94 5.0.0.93; do
    python3 -m venv "env-$version"
    "env-$version"/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==$version numpy==2.4.6
    "env-$version/bin/python" warp.py "${version%%.*}.npz"
done
env-5.0.0.93/bin/python - <<'PYTHON'
import sys

import numpy as np

four, five, as_said = np.load("4.npz"), np.load("5.npz"), True
for name in four.files:
    off = np.abs(four[name].astype(int) - five[name])
    print(f"{name}: {np.mean(off > 0):.1%} differ, by up to {off.max()}".replace("%", " %"))
    as_said &= bool(off.max()) != ("fixed-point" in name)
sys.exit(not as_said)
PYTHON
