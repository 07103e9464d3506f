#!/usr/bin/env bash
# A mouth that is open for 4 s is open for 1 s, since an eye blinks meanwhile.
#
# Found: subtitles may be shown at the same time, and events written as subtitles are: a blink while the mouth is open.
# textgrid-convert 1.2.0 puts all cues of an .srt into one tier of a Praat TextGrid, in which intervals must not overlap,
# and lets each end a millisecond before the next one begins. What lasts longer than until the next event is cut: a mouth
# open from 1 to 5 s, with blinks at 2 and 3 s, is open from 1 to 1.999 s. Nothing says so, and sums of durations are wrong
# by any factor. The times between cues have no intervals at all, as a tier of Praat has, and the tier begins
# with the first cue. Write the events as a TextGrid of several tiers, or make an .srt for each kind before.
# Packages: textgrid-convert 1.2.0, and pytest 9.2.0, which it needs when it runs and does not name.
# Data: subtitles of four made-up events, written here.
# Output seen:
#   in the .srt: mouth open 1.0 to 5.0, blink 2.0 to 2.12, blink 3.0 to 3.16, nod 6.0 to 6.48
#   in the TextGrid, from 1.0 to 6.48: mouth open 1.0 to 1.999, blink 2.0 to 2.12, blink 3.0 to 3.16, nod 6.0 to 6.48
#   without the blinks: mouth open 1.0 to 5.0, nod 6.0 to 6.48
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check textgrid-convert==1.2.0 pytest==9.2.0
env/bin/python - <<'PYTHON'
import re
import sys

from textgrid_convert.srtParser import srtParser

MOUTH, NOD = (1.0, 5.0, "mouth open"), (6.0, 6.48, "nod")
EVENTS = [MOUTH, (2.0, 2.12, "blink"), (3.0, 3.16, "blink"), NOD]


def clock(seconds):
    return f"00:00:{int(seconds):02d},{round(seconds % 1 * 1000):03d}"


def told(events):
    return ", ".join(f"{text} {begin} to {end}" for begin, end, text in events)


def converted(events):
    cues = "\n".join(f"{k}\n{clock(a)} --> {clock(b)}\n{text}\n" for k, (a, b, text) in enumerate(events, 1))
    parser = srtParser(cues)
    parser.parse_transcription()
    grid = parser.to_textgrid()
    found = re.findall(r'intervals \[\d+\]:\s*xmin = ([\d.]+)\s*xmax = ([\d.]+)\s*text = "(.*)"', grid)
    ends = [float(re.search(rf"{end} = ([\d.]+)", grid)[1]) for end in ("xmin", "xmax")]
    return ends, [(float(a), float(b), text) for a, b, text in found]


print("in the .srt:", told(EVENTS))
ends, all_four = converted(EVENTS)
print(f"in the TextGrid, from {ends[0]} to {ends[1]}: {told(all_four)}")
_, two = converted([MOUTH, NOD])
print("without the blinks:", told(two))
sys.exit(ends != [1.0, 6.48] or all_four != [(1.0, 1.999, "mouth open"), *EVENTS[1:]] or two != [MOUTH, NOD])
PYTHON
