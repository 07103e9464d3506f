#!/usr/bin/env bash
# A face is labelled in frames 0, 10 and 20, and Lightning Pose learns these points on the pictures of frames 0, 5 and 10.
#
# Found: the converter of lightning-pose 2.4.3 makes a project of a SLEAP package (.pkg.slp), in which pictures are embedded.
# Each labelled frame has its number there; the converter does not use it. It takes the embedded pictures in their order, and
# the labelled frames in theirs, and pairs them. A package whose suggestions are embedded, too, as SLEAP offers, has pictures
# without labels between, and pictures are in the order of the clip, while labels are in the order in which they were made. So
# points go to the pictures of other frames, and a network learns them there. Besides, points that are visible and not marked
# "complete" are left out, as all are that were not set by hand in SLEAP: a file written by sleap-io has no points at all.
# Nothing is said. Export without suggestions, sort labels by frame, and mark points complete.
# Packages: lightning-pose 2.4.3 without what it needs for training, sleap-io 0.9.5, omegaconf 2.3.0, h5py 3.16.0, pandas 2.3.3,
#   numpy 2.4.6, pillow 12.0.0, imageio 2.37.0, opencv-python-headless 4.14.0.94.
# Data: 30 grey pictures and labels whose nose is at x = the frame's number, made here. Shown is each picture, and x of its nose.
# Output seen:
#   labelled in order: 0: 0, 10: 10, 20: 20
#   two suggestions: 0: 0, 5: 10, 10: 20
#   frame 20 labelled first: 0: 20, 10: 0, 20: 10
#   not marked complete: 0: nothing, 10: nothing, 20: nothing
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check sleap-io==0.9.5 omegaconf==2.3.0 h5py==3.16.0 pandas==2.3.3 numpy==2.4.6
env/bin/pip install --quiet --disable-pip-version-check pillow==12.0.0 imageio==2.37.0 opencv-python-headless==4.14.0.94
env/bin/pip install --quiet --disable-pip-version-check --no-deps lightning-pose==2.4.3
env/bin/python -W ignore - 2>log.txt <<'PYTHON' || { cat log.txt >&2; exit 1; }
import csv
import pathlib
import sys

import imageio.v3 as iio
import numpy as np
import sleap_io
from lightning_pose.converters.sleap import convert

pictures = []
for number in range(30):
    pictures.append(f"{number:03}.png")
    iio.imwrite(pictures[-1], np.full((32, 32), number * 8, np.uint8))
video, face = sleap_io.Video.from_filename(pictures), sleap_io.Skeleton(["nose", "chin"])


def labelled(number, complete):
    instance = sleap_io.Instance.from_numpy(np.array([[number, 5.0], [number, 9.0]]), skeleton=face)
    instance.points["complete"] = complete
    return sleap_io.LabeledFrame(video=video, frame_idx=number, instances=[instance])


seen = {}
for name, order, suggested, complete in (
    ("labelled in order", (0, 10, 20), (), True), ("two suggestions", (0, 10, 20), (5, 15), True),
    ("frame 20 labelled first", (20, 0, 10), (), True), ("not marked complete", (0, 10, 20), (), False),
):
    labels = sleap_io.Labels(
        [labelled(number, complete) for number in order], videos=[video], skeletons=[face],
        suggestions=[sleap_io.SuggestionFrame(video=video, frame_idx=number) for number in suggested],
    )
    labels.save(f"{name}.pkg.slp", embed="user+suggestions")
    convert(pathlib.Path(f"{name}.pkg.slp"), pathlib.Path(name))
    rows = csv.reader(pathlib.Path(name, "CollectedData.csv").read_text().splitlines()[3:])
    seen[name] = ", ".join(f"{int(picture[-12:-4])}: {nose[:-2] or 'nothing'}" for picture, nose, *_ in rows)
    print(f"{name}: {seen[name]}")
expected = ["0: 0, 10: 10, 20: 20", "0: 0, 5: 10, 10: 20", "0: 20, 10: 0, 20: 10", "0: nothing, 10: nothing, 20: nothing"]
sys.exit(list(seen.values()) != expected)
PYTHON
