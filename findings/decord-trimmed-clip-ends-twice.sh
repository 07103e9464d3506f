#!/usr/bin/env bash
# A clip cut without encoding it again gets copies of its last picture, and each time is too early.
#
# Found: phones, LosslessCut and `ffmpeg -c copy` trim a clip without encoding it again: the file keeps the pictures from the key
# frame before the cut, and an edit list says which of them are not shown. decord 0.6.0 leaves these out when it reads, as it
# should, and yet counts them: a clip of 60 pictures has length 66, and its frames 60 to 65 are copies of the last one. The times
# of get_frame_timestamp are those of the pictures that are not shown: frame 0 is at -.2 s, and every frame .2 s too early, which
# is by as much as the cut is after a key frame, up to many seconds. Nothing is said. PyAV gives 60 pictures from 0 s on. OpenCV
# 5.0.0.93 gives them, too, though its CAP_PROP_FRAME_COUNT is 66. The clip before the cut is right in all three.
# Packages: decord 0.6.0, av 18.1.0, opencv-python-headless 5.0.0.93, imageio-ffmpeg 0.6.0 (for the cut), numpy 2.4.6.
# Data: 150 pictures at 29.97 frames/s with their number in stripes, a key frame every 30; cut from 1.2 s on, all made here.
# Output seen:
#   whole.mp4: PyAV 150 pictures, 0 at 0.0 s to 149; OpenCV reads 150, counts 150
#   whole.mp4: decord 150 pictures, 0 at 0.0 s to 149, 0 copies of the last; times 0.0 s too early
#   cut.mp4: PyAV 60 pictures, 36 at 0.0 s to 95; OpenCV reads 60, counts 66
#   cut.mp4: decord 66 pictures, 36 at -0.2 s to 95, 6 copies of the last; times 0.2 s too early
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check decord==0.6.0 av==18.1.0 opencv-python-headless==5.0.0.93 imageio-ffmpeg==0.6.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import subprocess
import sys
from fractions import Fraction

import av
import cv2
import decord
import imageio_ffmpeg
import numpy as np


def picture(number):
    """A stripe of 16 pixels for each of eight bits."""
    stripes = [220 if number >> bit & 1 else 40 for bit in range(8)]
    return np.broadcast_to(np.repeat(np.uint8(stripes), 16)[None, :, None], (96, 128, 3)).copy()


def number(pixels):
    return sum((pixels[40:56, 16 * bit + 8].mean() > 128) << bit for bit in range(8))


with av.open("whole.mp4", "w") as container:
    options = {"g": "30", "keyint_min": "30", "sc_threshold": "0", "bf": "0", "threads": "1"}
    stream = container.add_stream("libx264", rate=Fraction(30000, 1001), options=options)
    stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
    for k in range(150):
        container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(k), "rgb24")))
    container.mux(stream.encode(None))
cut = "-v error -ss 1.2 -i whole.mp4 -t 2 -c copy cut.mp4"
subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *cut.split()], check=True)

seen = []
for path in ("whole.mp4", "cut.mp4"):
    with av.open(path) as container:
        frames = [(number(f.to_ndarray(format="rgb24")), float(f.time)) for f in container.decode(video=0)]
    clip = cv2.VideoCapture(path)
    counted, by_opencv = int(clip.get(cv2.CAP_PROP_FRAME_COUNT)), []
    while (answer := clip.read())[0]:
        by_opencv.append(number(answer[1]))
    print(
        f"{path}: PyAV {len(frames)} pictures, {frames[0][0]} at {frames[0][1]:.1f} s to {frames[-1][0]}; "
        f"OpenCV reads {len(by_opencv)}, counts {counted}"
    )
    reader = decord.VideoReader(path, num_threads=1)
    found = [number(reader[k].asnumpy()) for k in range(len(reader))]
    times = [float(time) for time in reader.get_frame_timestamp(range(len(reader)))[:, 0]]
    early = {round(right - time, 3) for (_, right), time in zip(frames, times)}
    copies = found.count(found[-1]) - 1
    print(
        f"{path}: decord {len(found)} pictures, {found[0]} at {times[0]:.1f} s to {found[-1]}, {copies} copies of the last; "
        f"times {max(early):.1f} s too early"
    )
    same = [number for number, _ in frames] == found[: len(frames)] == by_opencv
    seen.append((len(frames), frames[0][0], counted, len(found), round(times[0], 1), copies, round(max(early) - min(early), 2), same))
sys.exit(seen != [(150, 0, 150, 150, 0, 0, 0, True), (60, 36, 66, 66, -0.2, 6, 0, True)])
PYTHON
