#!/usr/bin/env bash
# OpenCV 5 moved CascadeClassifier to contrib, and contrib's wheel has no cascade to load.
#
# Found: opencv-python-headless 5.0 has no cv2.CascadeClassifier. opencv-contrib-python-headless 5.0 has the class, but
# cv2.data.haarcascades names a folder without an .xml. The classifier of a file that is not there is made without an
# error, says empty(), and raises at the first detectMultiScale. The 17 files of 4.14 can be loaded by contrib 5.
# HOGDescriptor, the other old detector, is in contrib alone, too.
# Packages: opencv-python-headless 4.14.0.94 and 5.0.0.93, opencv-contrib-python-headless 5.0.0.93, numpy 2.4.6.
# Data: none but what the wheels hold.
# Output seen:
#   opencv-python-headless 4.14.0.94: CascadeClassifier True, HOGDescriptor True, 17 cascades
#   opencv-python-headless 5.0.0.93: CascadeClassifier False, HOGDescriptor False, 0 cascades
#   opencv-contrib-python-headless 5.0.0.93: CascadeClassifier True, HOGDescriptor True, 0 cascades; 4.14's file is loaded
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > look.py <<'PYTHON'
import sys
from pathlib import Path

import cv2

files = sorted(Path(cv2.data.haarcascades).glob("*.xml"))
has = hasattr(cv2, "CascadeClassifier"), hasattr(cv2, "HOGDescriptor")
print(f"{sys.argv[1]}: CascadeClassifier {has[0]}, HOGDescriptor {has[1]}, {len(files)} cascades", end="")
if files:
    Path("kept.xml").write_bytes(files[0].read_bytes())
elif has[0]:
    print("; 4.14's file is", "not loaded" if cv2.CascadeClassifier("kept.xml").empty() else "loaded", end="")
    has = (*has, not cv2.CascadeClassifier("kept.xml").empty())
print()
sys.exit((*has, len(files)) != {"4": (True, True, 17), "5": (False, False, 0), "c": (True, True, True, 0)}[sys.argv[2]])
PYTHON
for one in "opencv-python-headless 4.14.0.94 4" "opencv-python-headless 5.0.0.93 5" "opencv-contrib-python-headless 5.0.0.93 c"; do
    read -r package version kind <<< "$one"
    python3 -m venv "env-$kind"
    "env-$kind"/bin/pip install --quiet --disable-pip-version-check "$package==$version" numpy==2.4.6
    "env-$kind/bin/python" look.py "$package $version" "$kind"
done
