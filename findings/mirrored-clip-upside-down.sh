#!/usr/bin/env bash
# A mirrored clip is turned upside down.
#
# Found: the display matrix of an MP4 may also mirror the picture (x to the left, y stays); players show it
# mirrored. cv2.VideoCapture of 5.0.0.93 and 4.14.0.94, which turns pictures by default, and decord 0.6.0 know
# angles alone: of this matrix ffmpeg's angle is 180 degrees, and they turn the pictures by half a turn. What should
# be mirrored left to right stands on its head, and a face with it. Nothing is said. ffmpeg itself, here by
# imageio-ffmpeg 0.8.1, mirrors. PyAV 18.1.0 does not turn by itself; its frame.rotation says -180 for the mirrored
# and the turned clip alike, so what goes by that number makes the same mistake.
# Packages: opencv-python-headless 5.0.0.93 and 4.14.0.94, decord 0.6.0, imageio 2.38.1 with imageio-ffmpeg 0.8.1,
# av 18.1.0, numpy 2.4.6.
# Data: ten pictures with a bright corner at the upper left, written here as H.264 in MP4, whose matrix is then
# changed.
# Output seen:
#   the bright corner of turned.mp4: ffmpeg lower right, OpenCV 5.0.0 lower right, decord lower right; PyAV says -180
#   the bright corner of mirrored.mp4: ffmpeg upper right, OpenCV 5.0.0 lower right, decord lower right; PyAV says -180
#   the bright corner of turned.mp4: ffmpeg lower right, OpenCV 4.14.0 lower right, decord lower right; PyAV says -180
#   the bright corner of mirrored.mp4: ffmpeg upper right, OpenCV 4.14.0 lower right, decord lower right; PyAV says -180
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv one
one/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 decord==0.6.0 imageio==2.38.1 imageio-ffmpeg==0.8.1 av==18.1.0 numpy==2.4.6
python3 -m venv other
other/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==4.14.0.94 decord==0.6.0 imageio==2.38.1 imageio-ffmpeg==0.8.1 av==18.1.0 numpy==2.4.6
cat > see.py <<'PYTHON'
import struct
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import decord
import imageio.v3 as iio
import numpy as np

picture = np.full((48, 64, 3), 40, np.uint8)
picture[:12, :16] = 255
with av.open("flat.mp4", "w") as container:
    stream = container.add_stream("libx264", rate=25)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    for k in range(10):
        frame = av.VideoFrame.from_ndarray(picture, "rgb24")
        frame.pts, frame.time_base = k, Fraction(1, 25)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))
data = Path("flat.mp4").read_bytes()
at = data.index(struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30), data.index(b"tkhd"))


def corner(image):
    rows, columns = np.nonzero(image.mean(axis=2) > 150)
    upright = "upper" if rows.mean() < 24 else "lower"
    return f"{upright} {'left' if columns.mean() < 32 else 'right'}"


def seen(name, *matrix):
    Path(name).write_bytes(data[:at] + struct.pack(">9i", *matrix) + data[at + 36 :])
    with av.open(name) as container:
        angle = next(container.decode(video=0)).rotation
    by = {
        "ffmpeg": corner(iio.imread(name, plugin="FFMPEG", index=0)),
        f"OpenCV {cv2.__version__}": corner(cv2.VideoCapture(name).read()[1]),
        "decord": corner(decord.VideoReader(name)[0].asnumpy()),
    }
    print(f"the bright corner of {name}: {', '.join(map(' '.join, by.items()))}; PyAV says {angle}")
    return [*by.values(), angle]


turned = seen("turned.mp4", -1 << 16, 0, 0, 0, -1 << 16, 0, 64 << 16, 48 << 16, 1 << 30)
mirrored = seen("mirrored.mp4", -1 << 16, 0, 0, 0, 1 << 16, 0, 64 << 16, 0, 1 << 30)
half = ["lower right", "lower right", -180]
sys.exit(turned != ["lower right", *half] or mirrored != ["upper right", *half])
PYTHON
one/bin/python see.py
other/bin/python see.py
