#!/usr/bin/env bash
# Flip and shrink, or shrink and flip: the same picture, and its points three pixels apart.
#
# Found: albumentations 2.0.8 changes pictures and their keypoints together. HorizontalFlip, rotations and Affine
# take a whole number for the middle of a pixel: x becomes width - 1 - x. Resize multiplies x by the scale, as if
# the picture began at 0; the pictures are resized by OpenCV, where it begins at -.5. So at a quarter of the size
# each point is .375 pixels too far right and below (1.5 pixels of the large picture), and at four times the size
# 1.5 pixels too far left and above. Of a picture that is flipped and then made a quarter, or made a quarter and
# then flipped, the pixels are equal, and the keypoints are .75 pixels apart, which is 3 of the original. The middle
# of a bright spot shows where they should be. A network that learns points on small pictures learns this shift.
# Packages: albumentations 2.0.8, opencv-python-headless 4.14.0.94, numpy 2.4.6.
# Data: a bright spot on black, made here.
# Output seen:
#   flipped: keypoint [195.0, 90.0], middle of the spot [195.0, 90.0]
#   a quarter: keypoint [15.0, 22.5], middle of the spot [14.625, 22.125]
#   four times: keypoint [240.0, 360.0], middle of the spot [241.5, 361.5]
#   flipped, a quarter: keypoint [48.75, 22.5], middle of the spot [48.375, 22.125]
#   a quarter, flipped: keypoint [48.0, 22.5], middle of the spot [48.375, 22.125]
#   the last two pictures are equal: True
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check albumentations==2.0.8 opencv-python-headless==4.14.0.94 numpy==2.4.6
env/bin/python - <<'PYTHON'
import os
import sys

os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"
import albumentations as A
import cv2
import numpy as np

y, x = np.mgrid[:192, :256]
SPOT = (60.0, 90.0)
spot = np.exp(-((x - SPOT[0]) ** 2 + (y - SPOT[1]) ** 2) / (2 * 9.0**2))
picture = np.repeat(spot[..., None], 3, axis=2).astype(np.float32)


def done(*steps):
    """The picture, its keypoint, and where the middle of the spot is, after these steps."""
    made = A.Compose([*steps], keypoint_params=A.KeypointParams(format="xy"))(image=picture, keypoints=[SPOT])
    image = made["image"][..., 0].astype(float)
    rows, columns = np.indices(image.shape)
    middle = [float((at * image).sum() / image.sum()) for at in (columns, rows)]
    return made["image"], [round(float(v), 3) for v in made["keypoints"][0]], [round(v, 3) for v in middle]


def quarter():
    return A.Resize(48, 64, interpolation=cv2.INTER_AREA, p=1)


flip = A.HorizontalFlip(p=1)
found = {}
for what, steps in {
    "flipped": [flip],
    "a quarter": [quarter()],
    "four times": [A.Resize(768, 1024, interpolation=cv2.INTER_LINEAR, p=1)],
    "flipped, a quarter": [flip, quarter()],
    "a quarter, flipped": [quarter(), flip],
}.items():
    image, point, middle = done(*steps)
    found[what] = (image, point, middle)
    print(f"{what}: keypoint {point}, middle of the spot {middle}")
first, second = found["flipped, a quarter"][0], found["a quarter, flipped"][0]
same = bool(np.allclose(first, second, atol=1e-6))
print(f"the last two pictures are equal: {same}")
expected = {
    "flipped": ([195, 90], [195, 90]),
    "a quarter": ([15, 22.5], [14.625, 22.125]),
    "four times": ([240, 360], [241.5, 361.5]),
    "flipped, a quarter": ([48.75, 22.5], [48.375, 22.125]),
    "a quarter, flipped": ([48, 22.5], [48.375, 22.125]),
}
sys.exit(not (same and all(np.allclose(found[what][1:], expected[what], atol=0.002) for what in expected)))
PYTHON
