#!/usr/bin/env bash
# A portrait clip of a phone is squeezed to landscape: every face is wide and flat.
#
# Found: a phone held upright writes landscape pictures and a display matrix that turns them by 90 degrees. moviepy
# 2.2.1 learns of this turn from the text that ffmpeg prints, "displaymatrix: rotation of", exchanges width and
# height, and asks ffmpeg, which turns the pictures by itself, for that size. The ffmpeg in imageio-ffmpeg 0.8.1,
# which comes with it today, prints "Display Matrix:" instead. So moviepy knows of no turn: of a clip that is 48
# wide and 64 high it says 64 x 48, and gives turned pictures that are stretched to 64 x 48. A square of 16 pixels
# is 22 wide and 12 high. Nothing is said. With imageio-ffmpeg 0.6.0 size and pictures are right.
# Packages: moviepy 2.2.1 with imageio-ffmpeg 0.8.1 and 0.6.0; the clip by av 18.1.0; numpy 2.4.6.
# Data: ten black pictures with a white square, written here as H.264 in MP4, whose display matrix is then changed.
# Output seen:
#   imageio-ffmpeg 0.8.1: upright.mp4 size [64, 48], turned by 0, square 22 x 12
#   imageio-ffmpeg 0.6.0: upright.mp4 size [48, 64], turned by 90.0, square 16 x 16
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv one
one/bin/pip install --quiet --disable-pip-version-check moviepy==2.2.1 imageio-ffmpeg==0.8.1 av==18.1.0 numpy==2.4.6
python3 -m venv other
other/bin/pip install --quiet --disable-pip-version-check moviepy==2.2.1 imageio-ffmpeg==0.6.0 av==18.1.0 numpy==2.4.6
cat > see.py <<'PYTHON'
import logging
import struct
import sys
from fractions import Fraction
from importlib.metadata import version
from pathlib import Path

logging.disable(logging.CRITICAL)
import av
import numpy as np
from moviepy import VideoFileClip

picture = np.zeros((48, 64, 3), np.uint8)
picture[16:32, 24:40] = 255
with av.open("flat.mp4", "w") as container:
    stream = container.add_stream("libx264", rate=25, options={"crf": "5"})
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    for k in range(10):
        frame = av.VideoFrame.from_ndarray(picture, "rgb24")
        frame.pts, frame.time_base = k, Fraction(1, 25)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))
data = Path("flat.mp4").read_bytes()
at = data.index(struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30), data.index(b"tkhd"))
# x of a picture goes down, y to the left
turned = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 48 << 16, 0, 1 << 30)
Path("upright.mp4").write_bytes(data[:at] + turned + data[at + 36 :])
with VideoFileClip("upright.mp4", audio=False) as clip:
    white = clip.get_frame(0).mean(axis=2) > 128
    square = [int(white.any(axis=axis).sum()) for axis in (0, 1)]
    found = [list(clip.size), clip.rotation, square]
name = version("imageio-ffmpeg")
print(f"imageio-ffmpeg {name}: upright.mp4 size {found[0]}, turned by {found[1]}, square {square[0]} x {square[1]}")
expected = {"0.8.1": [[64, 48], 0, [22, 12]], "0.6.0": [[48, 64], 90, [16, 16]]}
sys.exit(found != expected[name])
PYTHON
one/bin/python see.py
other/bin/python see.py
