#!/usr/bin/env bash
# Between two keyframes a box may turn the long way round, and after the last one it goes on to the end of the video.
#
# Found: label-studio-sdk 2.1.2 has extract_key_frames, which gives the frames between the keyframes of a video's
# rectangles, as Label Studio's export with interpolated frames has them. (1) It interpolates the rotation as a number: a
# box that tilts from 350 to 10 degrees in four frames, by 20 degrees, is given 265, 180 and 95 in between, upside down
# in the middle. (2) A last keyframe that is not switched off is copied to all frames up to framesCount, each with
# "auto": true; a face that was marked in three frames of 300 has a box in 298. (3) The times of the frames in between are
# rounded to hundredths and those of keyframes are not: at 29.97 frames/s they are up to 5 ms off.
# Packages: label-studio-sdk 2.1.2.
# Data: made-up keyframes, written here.
# Output seen:
#   rotation of frames 1 to 5: [350, 265.0, 180.0, 95.0, 10]
#   keyframes 3 to 5 of 300 frames: a box in 298 frames, the last one 300, of them marked as interpolated 296
#   time of frames 3 and 4 at 29.97 frames/s: [0.1001001, 0.13] for [0.1001001, 0.1334668]
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check label-studio-sdk==2.1.2
env/bin/python - <<'PYTHON'
import sys

from label_studio_sdk._extensions.label_studio_tools.postprocessing.video import extract_key_frames


def frames(keyframes, rate, count):
    place = {"x": 10.0, "y": 10.0, "width": 5.0, "height": 5.0, "enabled": True}
    sequence = [{"frame": n, "time": n / rate, "rotation": turn, **place} for n, turn in keyframes]
    value = {"framesCount": count, "duration": count / rate, "sequence": sequence}
    (region,) = extract_key_frames([{"type": "videorectangle", "value": value}])
    return region["value"]["sequence"]


turned = [one["rotation"] for one in frames([(1, 350), (5, 10)], 25, 5)]
print("rotation of frames 1 to 5:", turned)
going = frames([(3, 0), (5, 0)], 29.97, 300)
auto = sum(one.get("auto", False) for one in going)
there = f"a box in {len(going)} frames, the last one {going[-1]['frame']}, of them marked as interpolated {auto}"
print(f"keyframes 3 to 5 of 300 frames: {there}")
times = [round(one["time"], 7) for one in going[:2]]
print("time of frames 3 and 4 at 29.97 frames/s:", times, "for", [round(n / 29.97, 7) for n in (3, 4)])
sys.exit(
    turned != [350, 265.0, 180.0, 95.0, 10]
    or (len(going), going[-1]["frame"], auto) != (298, 300, 296)
    or times != [0.1001001, 0.13]
)
PYTHON
