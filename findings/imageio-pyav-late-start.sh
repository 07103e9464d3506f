#!/usr/bin/env bash
# Asked for frame 20, it gives frame 15, since the clip begins .2 s late.
#
# Found: imageio 2.38.1 reads videos with PyAV when plugin="pyav" is given. imiter gives all frames in order.
# imread(index=k) seeks to the time k / rate and counts this time from 0, not from the clip's first time stamp.
# Where the first frame is shown at .2 s (an MP4 whose edit list says so, as after a cut), frames 20 and 39 are the
# pictures 15 and 34, frames 2 to 5 are picture 0, and numbers up to 44 are answered, of 40. In a transport stream,
# as camcorders write it, that begins at 1.4 s, frame 39 is picture 12 and the others are picture 0. Nothing is
# said. The same clip from 0 is right, and so are all of them with constant_framerate=False, which counts from the
# first frame.
# Packages: imageio 2.38.1 with av 18.1.0, numpy 2.4.6 and pillow 12.3.0.
# Data: 40 pictures at 25 frames/s whose grey says their number, as H.264, written here.
# Output seen:
#   zero.mp4: in order True; asked for [0, 5, 11, 20, 39]: [0, 5, 11, 20, 39]; the other way right True; last 39
#   late.mp4: in order True; asked for [0, 5, 11, 20, 39]: [0, 0, 6, 15, 34]; the other way right True; last 44
#   late.ts: in order True; asked for [0, 5, 11, 20, 39]: [0, 0, 0, 0, 12]; the other way right True; last 71
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check imageio==2.38.1 av==18.1.0 numpy==2.4.6 pillow==12.3.0
env/bin/python - <<'PYTHON'
import sys
from fractions import Fraction

import av
import imageio.v3 as iio
import numpy as np

ASKED = (0, 5, 11, 20, 39)


def write(path, start):
    """40 pictures at 25 frames/s, the first at `start` ms."""
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"g": "12", "bf": "0", "threads": "1"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for k in range(40):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 4 * k, np.uint8), "rgb24")
            frame.pts, frame.time_base = start + 40 * k, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def number(picture):
    return round((float(picture.mean()) - 20) / 4)


def last(path):
    """The last number that is answered."""
    for k in range(30, 100):
        try:
            iio.imread(path, plugin="pyav", index=k)
        except (StopIteration, RuntimeError, EOFError, IndexError):
            return k - 1


found = {}
for path, start in (("zero.mp4", 0), ("late.mp4", 200), ("late.ts", 1400)):
    write(path, start)
    order = [number(picture) for picture in iio.imiter(path, plugin="pyav")] == list(range(40))
    fast = [number(iio.imread(path, plugin="pyav", index=k)) for k in ASKED]
    slow = [number(iio.imread(path, plugin="pyav", index=k, constant_framerate=False)) for k in ASKED]
    found[path] = (order, fast, slow, last(path))
    asked = f"in order {order}; asked for {list(ASKED)}: {fast}"
    print(f"{path}: {asked}; the other way right {slow == list(ASKED)}; last {found[path][3]}")
right = list(ASKED)
sys.exit(
    found["zero.mp4"] != (True, right, right, 39)
    or found["late.mp4"] != (True, [0, 0, 6, 15, 34], right, 44)
    or found["late.ts"] != (True, [0, 0, 0, 0, 12], right, 71)
)
PYTHON
