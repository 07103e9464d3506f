#!/usr/bin/env bash
# A signer whose face is not seen in the first frame is not made anonymous: the file has the own face, as small as a pixel.
#
# Found: pose-anonymization 0.0.1 makes the signer of a .pose file look like an average person (remove_appearance) or like
# somebody else (transfer_appearance): it takes what differs in the first frame off all frames. A point that is missing in that
# frame has no difference, and is masked in all other frames, so that there is no face at all, while its confidence stays 1. A
# file keeps no masks, but hides what has confidence 0. So in a file that is written and read again the face is seen in every
# frame but the first, at its places of before: with the signer's own shape, which was to be hidden, and in units of the
# shoulders' width, a pixel wide in the corner of the picture. Clips are often cut such that the signer looks up after a frame
# or two. A face missing in any other frame is missing there alone. Nothing is said. Begin clips where all is seen.
# Packages: pose-anonymization 0.0.1, pose-format 0.15.0, numpy 2.4.6.
# Data: the mean person with a face 1.5 times as wide, swaying for 50 frames; the face is not seen in one of them, made here.
# Output seen:
#   width by height of the signer's own face 1.24, of the mean face 0.83
#   face seen in all frames: 50 frames with a face; in the file 50, 95.3 pixels wide, width by height 0.83
#   not in frame 0: 0 frames with a face; in the file 49, 0.7 pixels wide, width by height 1.24
#   not in frame 1: 49 frames with a face; in the file 49, 95.3 pixels wide, width by height 0.83
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pose-anonymization==0.0.1 pose-format==0.15.0 numpy==2.4.6
env/bin/python -W ignore - <<'PYTHON'
import io
import sys

import numpy as np
from pose_anonymization.appearance import remove_appearance
from pose_anonymization.data import load_mean_and_std, load_pose_header
from pose_format import Pose
from pose_format.numpy import NumPyPoseBody

header, (mean, _) = load_pose_header(), load_mean_and_std()
(face,) = (component for component in header.components if component.name == "FACE_LANDMARKS")
first = header.get_point_index("FACE_LANDMARKS", face.points[0])
points = slice(first, first + len(face.points))


def signer(lost):
    places = np.tile(mean.reshape(1, 1, -1, 3) * 1000 + 500, (50, 1, 1, 1))
    middle = places[:, :, points, 0].mean()
    places[:, :, points, 0] = middle + 1.5 * (places[:, :, points, 0] - middle)
    places += 5 * np.sin(np.arange(50) / 5)[:, None, None, None]
    confidence = np.ones(places.shape[:3])
    if lost is not None:
        confidence[lost, 0, points] = 0
    mask = np.repeat((confidence == 0)[..., None], 3, axis=-1)
    return Pose(header, NumPyPoseBody(25, np.ma.masked_array(places, mask), confidence))


def told(pose):
    """In how many frames the face is seen, its width in pixels in frame 10, and the ratio of width and height."""
    places = pose.body.data[:, 0, points]
    frames = int((~np.ma.getmaskarray(places).any(axis=(1, 2))).sum())
    width, height = np.ptp(np.ma.getdata(places)[10, :, :2], axis=0)
    return frames, round(float(width), 1) if frames else None, round(float(width / height), 2) if frames else None


seen = []
print("width by height of the signer's own face {2}, of the mean face {3:.2f}".format(
    *told(signer(None)), np.divide(*np.ptp(mean[points, :2], axis=0))))
for name, lost in (("face seen in all frames", None), ("not in frame 0", 0), ("not in frame 1", 1)):
    pose = remove_appearance(signer(lost))
    file = io.BytesIO()
    pose.write(file)
    seen.append((told(pose)[0], *told(Pose.read(file.getvalue()))))
    print("{}: {} frames with a face; in the file {}, {} pixels wide, width by height {}".format(name, *seen[-1]))
sys.exit(seen != [(50, 50, 95.3, 0.83), (0, 49, 0.7, 1.24), (49, 49, 95.3, 0.83)])
PYTHON
