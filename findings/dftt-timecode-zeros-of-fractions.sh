#!/usr/bin/env bash
# A nod at 65.04 s is at 65.4 s, and minute 1 of a film has no frame 0.
#
# Found: dftt-timecode 1.0.0 turns times into frames and timecode, and knows them by their form. Hours, minutes and seconds with
# a point are times of ffmpeg, whose fraction it reads as a whole number, so that zeros in front are gone: 00:01:05.04, and
# 00:01:05.040 of WebVTT, are 65.4 s, and 00:01:05.005 is 65.5 s. Its own times of ffmpeg come back so, too: of 1,500 frames at
# 25/s those that are shown in the first tenth of a second, 120, are up to 18 frames late. The comma of SubRip is read rightly. At
# 23.976 frames/s, for which there is no drop-frame timecode, it drops numbers all the same and whatever drop_frame says:
# frame 1440 is 00:01:00;01, and frame 86400 01:00:03;14. Nothing is said. Write a comma, and give 24 for timecode of 23.976.
# Packages: dftt-timecode 1.0.0.
# Data: times and frames, in this script.
# Output seen:
#   00:01:05.04 is 65.4 s, 00:01:05.040 is 65.4 s, 00:01:05.005 is 65.5 s, 00:01:05.4 is 65.4 s, 00:01:05,040 is 65.04 s
#   ffmpeg: 120 of 1500 frames come back as others, by up to 18
#   srt: 0 of 1500 frames come back as others, by up to 0
#   23.976 frames/s: 1439 is 00:00:59;23, 1440 is 00:01:00;01, 86400 is 01:00:03;14
#   24 frames/s: 1439 is 00:00:59:23, 1440 is 00:01:00:00, 86400 is 01:00:00:00
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check dftt-timecode==1.0.0
env/bin/python - <<'PYTHON'
import sys

from dftt_timecode import DfttTimecode

seen = [[(text, float(DfttTimecode(text, fps=25).timestamp)) for text in (
    "00:01:05.04", "00:01:05.040", "00:01:05.005", "00:01:05.4", "00:01:05,040")]]
print(", ".join(f"{text} is {seconds} s" for text, seconds in seen[0]))
for form in ("ffmpeg", "srt"):
    times = [DfttTimecode(frame, "frame", fps=25).timecode_output(form) for frame in range(1500)]
    late = [DfttTimecode(time, fps=25).framecount - frame for frame, time in enumerate(times)]
    seen.append((sum(frames != 0 for frames in late), max(late)))
    print(f"{form}: {seen[-1][0]} of {len(times)} frames come back as others, by up to {max(late)}")
for rate in (23.976, 24):
    named = [(frame, DfttTimecode(frame, "frame", fps=rate, drop_frame=False).timecode_output("smpte")) for frame in (1439, 1440, 86400)]
    seen.append(named)
    print(f"{rate} frames/s:", ", ".join(f"{frame} is {code}" for frame, code in named))
times = [("00:01:05.04", 65.4), ("00:01:05.040", 65.4), ("00:01:05.005", 65.5), ("00:01:05.4", 65.4), ("00:01:05,040", 65.04)]
film = [(1439, "00:00:59;23"), (1440, "00:01:00;01"), (86400, "01:00:03;14")]
whole = [(1439, "00:00:59:23"), (1440, "00:01:00:00"), (86400, "01:00:00:00")]
sys.exit(seen != [times, (120, 18), (0, 0), film, whole])
PYTHON
