#!/usr/bin/env bash
# The same pictures, encoded twice with the same options and one thread, are two files.
#
# Found: libx264 with its default settings, as the ffmpeg of imageio-ffmpeg 0.8.1 and PyAV 18.1.0 carry it, reads memory
# that nobody has written, by its macroblock tree: where the C library fills new memory with other bytes, the file has
# other bytes, though nothing else differs. In most runs fresh memory is zero and the files are equal, so that a test of
# equality passes for a year. Of pictures of 176x144 and 320x240 every filling gives another file; of 640x480 all
# are equal. Without the tree (mbtree=0) all are equal.
# Who is hurt: whoever keeps checksums of annotated videos, or compares them in CI.
# Packages: imageio-ffmpeg 0.8.1, av 18.1.0, numpy 2.4.6. Linux with glibc, whose variable MALLOC_PERTURB_ says with
# what memory is filled; on an x86-64 processor.
# Data: 30 pictures of moving waves, made here.
# Output seen:
#   ffmpeg 176x144, default: memory 0 twice equal, 4 fillings give 4 files; mbtree=0: 1 file
#   ffmpeg 320x240, default: memory 0 twice equal, 4 fillings give 4 files; mbtree=0: 1 file
#   ffmpeg 640x480, default: memory 0 twice equal, 4 fillings give 1 file; mbtree=0: 1 file
#   PyAV 176x144, default: memory 0 twice equal, 4 fillings give 4 files; mbtree=0: 1 file
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check imageio-ffmpeg==0.8.1 av==18.1.0 numpy==2.4.6
cat > encode.py <<'PYTHON'
import hashlib
import subprocess
import sys

import av
import imageio_ffmpeg
import numpy as np

program, width, height, tree = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
y, x = np.mgrid[:height, :width]
pictures = []
for k in range(30):
    waves = (127 + 60 * np.sin((x + 3 * k) / 9) + 60 * np.cos((y - 2 * k) / 7)).astype(np.uint8)
    pictures.append(np.stack([waves, waves[::-1], waves[:, ::-1]], -1))
options = [] if tree == "default" else ["-x264-params", "mbtree=0"]
if program == "ffmpeg":
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{width}x{height}", "-r", "25", "-i", "-", "-c:v", "libx264", "-pix_fmt", "yuv420p"]
    command += ["-threads", "1", *options, "-f", "h264", "-"]
    raw = b"".join(picture.tobytes() for picture in pictures)
    data = subprocess.run(command, input=raw, stdout=subprocess.PIPE, check=True).stdout
else:
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.framerate, codec.thread_count = width, height, "yuv420p", 25, 1
    codec.options = {options[0][1:]: options[1]} if options else {}
    data = b""
    for k, picture in enumerate([*pictures, None]):
        frame = None
        if picture is not None:
            frame = av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="yuv420p")
            frame.pts = k
        data += b"".join(bytes(packet) for packet in codec.encode(frame))
print(hashlib.sha256(data).hexdigest())
PYTHON
env/bin/python - <<'PYTHON'
import os
import subprocess
import sys


def encoded(filled, *words):
    command = [sys.executable, "encode.py", *map(str, words)]
    env = {**os.environ, "MALLOC_PERTURB_": str(filled)}
    return subprocess.run(command, env=env, stdout=subprocess.PIPE, check=True, text=True).stdout


as_described = True
for program, width, height, expected in (
    ("ffmpeg", 176, 144, 4), ("ffmpeg", 320, 240, 4), ("ffmpeg", 640, 480, 1), ("PyAV", 176, 144, 4),
):
    first, *others = [encoded(filled, program, width, height, "default") for filled in (0, 0, 1, 85, 170)]
    without = {encoded(filled, program, width, height, "none") for filled in (0, 1, 85, 170)}
    files = len({first, *others})
    print(
        f"{program} {width}x{height}, default: memory 0 twice {'equal' if first == others[0] else 'other'},",
        f"4 fillings give {files} file{'s' * (files > 1)}; mbtree=0: {len(without)} file{'s' * (len(without) > 1)}",
    )
    as_described &= first == others[0] and files == expected and len(without) == 1
raise SystemExit(not as_described)
PYTHON
