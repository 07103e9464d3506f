#!/usr/bin/env bash
# Of a camcorder's clip, frame 0 is picture 12.
#
# Found: camcorders and broadcasts write H.264 with reordered pictures (B frames) as a transport stream, .ts or
# .mts. decord 0.6.0 gives such a clip without the pictures before the second key frame: of 40 pictures with a key
# frame every 12, frame 0 is picture 12, frame 1 is 13, and so on; from number 27 on each frame is picture 39. Asked
# for numbers out of order, it is wrong in other ways: 20 is 32, and 39 is 30. Its log speaks of recovered frames.
# OpenCV 5.0.0.93 reads all pictures in order, but by number (CAP_PROP_POS_FRAMES) frames 0 to 11 are the pictures
# 12 or 13. The same pictures in MP4, or in a transport stream without B frames, are right in both, and PyAV reads
# all three from the beginning rightly.
# Packages: opencv-python-headless 5.0.0.93, decord 0.6.0, av 18.1.0, numpy 2.4.6.
# Data: 40 pictures at 25 frames/s whose grey says their number, as H.264, written here.
# Output seen:
#   b.mp4: PyAV in order True; OpenCV in order 0 to 39, asked for [0, 5, 11, 20, 39]: [0, 5, 11, 20, 39]
#   b.mp4: PyAV in order True; decord in order 0 to 39, asked for [0, 5, 11, 20, 39]: [0, 5, 11, 20, 39]
#   plain.ts: PyAV in order True; OpenCV in order 0 to 39, asked for [0, 5, 11, 20, 39]: [0, 5, 11, 20, 39]
#   plain.ts: PyAV in order True; decord in order 0 to 39, asked for [0, 5, 11, 20, 39]: [0, 5, 11, 20, 39]
#   b.ts: PyAV in order True; OpenCV in order 0 to 39, asked for [0, 5, 11, 20, 39]: [12, 13, 13, 20, 39]
#   b.ts: PyAV in order True; decord in order 12 to 39, asked for [0, 5, 11, 20, 39]: [12, 17, 23, 32, 30]
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 decord==0.6.0 av==18.1.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
from fractions import Fraction

import av
import cv2
import decord
import numpy as np

ASKED = (0, 5, 11, 20, 39)


def write(path, reordered):
    """40 pictures at 25 frames/s, a key frame every 12; the first is shown at 1.4 s."""
    with av.open(path, "w") as container:
        options = {"g": "12", "keyint_min": "12", "sc_threshold": "0", "bf": str(reordered), "threads": "1"}
        stream = container.add_stream("libx264", rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for k in range(40):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 4 * k, np.uint8), "rgb24")
            frame.pts, frame.time_base = 1400 + 40 * k, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def number(picture):
    return round((float(picture.mean()) - 20) / 4)


def by_opencv(path, numbers):
    clip, found = cv2.VideoCapture(path), []
    for k in numbers:
        if len(numbers) < 40:
            clip.set(cv2.CAP_PROP_POS_FRAMES, k)
        found.append(number(clip.read()[1]))
    return found


def by_decord(path, numbers):
    clip = decord.VideoReader(path, num_threads=1)
    return [number(clip[k].asnumpy()) for k in numbers]


order, right, found = list(range(40)), list(ASKED), {}
for path, reordered in (("b.mp4", 2), ("plain.ts", 0), ("b.ts", 2)):
    write(path, reordered)
    with av.open(path) as container:
        whole = [number(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)] == order
    for name, by in (("OpenCV", by_opencv), ("decord", by_decord)):
        row, asked = by(path, order), by(path, ASKED)
        found[path, name] = (whole, row, asked)
        rows = f"PyAV in order {whole}; {name} in order {row[0]} to {row[-1]}"
        print(f"{path}: {rows}, asked for {right}: {asked}")
as_it_is = (True, order, right)
expected = {(path, name): as_it_is for path in ("b.mp4", "plain.ts") for name in ("OpenCV", "decord")}
expected["b.ts", "OpenCV"] = (True, order, [12, 13, 13, 20, 39])
expected["b.ts", "decord"] = (True, [*range(12, 40), *[39] * 12], [12, 17, 23, 32, 30])
sys.exit(found != expected)
PYTHON
