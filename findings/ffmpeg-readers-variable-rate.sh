#!/usr/bin/env bash
# A clip of variable rate runs five times slower, and only its first .4 s are there.
#
# Found: moviepy 2.2.1 and the plugin FFMPEG of imageio 2.38.1 take pictures from ffmpeg's pipe, which repeats
# pictures to make a constant rate of a variable one. It repeats them by the base rate of the stream, here 100; both
# packages count them by the mean rate, here 20. imageio gives 200 frames for the 40 of the file, says 20 frames/s,
# and frame 20 is picture 5. clip.iter_frames() of moviepy, which also write_videofile goes through, gives 40
# pictures for 2 s, but they are the pictures 0 to 9, each several times: the rest of the film never comes.
# get_frame(1.0) seeks, and is right. Nothing is said. At a constant rate all is well.
# Packages: moviepy 2.2.1, imageio 2.38.1 with imageio-ffmpeg 0.8.1; the clip by av 18.1.0; numpy 2.4.6.
# Data: 40 pictures in 2 s whose grey says their number, as H.264 in MP4, written here.
# Output seen:
#   constant.mp4: 40 frames; imageio: 40 at 25.0/s, frame 20 is 20; moviepy: 40, up to picture 39; at 1 s 25 for 25
#   variable.mp4: 40 frames; imageio: 200 at 20.0/s, frame 20 is 5; moviepy: 40, up to picture 9; at 1 s 15 for 15
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check moviepy==2.2.1 imageio==2.38.1 imageio-ffmpeg==0.8.1 av==18.1.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import logging
import sys
import warnings
from fractions import Fraction

warnings.simplefilter("ignore")
import av
import imageio.v3 as iio
import numpy as np
from moviepy import VideoFileClip

logging.disable(logging.CRITICAL)
# 40 pictures in 2 s: about 40 ms each, every third 10 ms later, and .4 s more after the tenth
TIMES = [40 * k + 400 * (k >= 10) + 10 * (k % 3 == 1) for k in range(40)]


def write(path, times):
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"bf": "0", "threads": "1"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for k, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 4 * k, np.uint8), "rgb24")
            frame.pts, frame.time_base = time, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def number(picture):
    return round((float(picture.mean()) - 20) / 4)


found = {}
for path, times in (("constant.mp4", [40 * k for k in range(40)]), ("variable.mp4", TIMES)):
    write(path, times)
    with av.open(path) as container:
        true = [number(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    ffmpeg = [number(picture) for picture in iio.imiter(path, plugin="FFMPEG")]
    rate, twenty = iio.immeta(path, plugin="FFMPEG")["fps"], number(iio.imread(path, plugin="FFMPEG", index=20))
    with VideoFileClip(path, audio=False) as clip:
        movie, second = [number(picture) for picture in clip.iter_frames()], number(clip.get_frame(1.0))
    shown = max(k for k, time in enumerate(times) if time <= 1000)
    found[path] = [len(true), len(ffmpeg), rate, twenty, len(movie), max(movie), second, shown]
    print(f"{path}: {len(true)} frames; imageio: {len(ffmpeg)} at {rate}/s, frame 20 is {twenty};", end=" ")
    print(f"moviepy: {len(movie)}, up to picture {max(movie)}; at 1 s {second} for {shown}")
sys.exit(
    found["constant.mp4"] != [40, 40, 25.0, 20, 40, 39, 25, 25]
    or found["variable.mp4"] != [40, 200, 20.0, 5, 40, 9, 15, 15]
)
PYTHON
