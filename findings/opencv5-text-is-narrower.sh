#!/usr/bin/env bash
# A label that cv2.putText draws has another size in OpenCV 5, and its thickness no longer makes it higher.
#
# Found: the Hershey fonts of OpenCV 5 are outlines of a type face in place of strokes. cv2.getTextSize of the same text, font
# and scale is a sixth narrower; with a thickness of 6 a capital is as high as with 1, where OpenCV 4 adds the pen's width; its
# foot ends on the pixel above the baseline. Boxes that programs lay behind a label by fixed numbers do not fit any more,
# and pictures that tests compare differ.
# Packages: opencv-python-headless 4.14.0.94 and 5.0.0.93, numpy 2.4.6.
# Data: none.
# Output seen:
#   4.14.0: "frame 0123456789" is 309 wide; an H is 22 rows high, 28 with a pen of 6
#   5.0.0: "frame 0123456789" is 255 wide; an H is 20 rows high, 20 with a pen of 6
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > text.py <<'PYTHON'
import sys

import cv2
import numpy as np

face, text = cv2.FONT_HERSHEY_SIMPLEX, "frame 0123456789"
wide = cv2.getTextSize(text, face, 1.0, 1)[0][0]
high = []
for pen in (1, 6):
    picture = np.zeros((200, 200), np.uint8)
    cv2.putText(picture, "H", (50, 150), face, 1.0, 255, pen, cv2.LINE_AA)
    high.append(int((picture > 110).any(axis=1).sum()))
print(f'{cv2.__version__}: "{text}" is {wide} wide; an H is {high[0]} rows high, {high[1]} with a pen of 6')
sys.exit((high[1] > high[0]) != cv2.__version__.startswith("4.") or wide != int(sys.argv[1]))
PYTHON
for one in "4.14.0.94 309" "5.0.0.93 255"; do
    read -r version wide <<< "$one"
    python3 -m venv "env-$version"
    "env-$version"/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==$version numpy==2.4.6
    "env-$version/bin/python" text.py "$wide"
done
