#!/usr/bin/env bash
# A nod during which somebody blinks is three nods, and a third of all events begin a frame late.
#
# Found: ttconv 1.2.3 converts between subtitles. Of cues that overlap, as coded events do, it writes in .srt and .vtt what is on
# the screen at a time: a nod from 2 to 4 s with a blink from 3 to 3.5 s becomes a nod, a cue of two lines, "nod" and "blink",
# and another nod, of 1, .5 and .5 s. Even from .srt to .srt there are then three nods. In TTML with frames
# (IMSCWriterConfiguration(fps=30)) times are rounded up. Subtitles have whole milliseconds, and a third of those at
# 30 frames/s lie just above the frame's own time, 67 ms for frame 2: 33 of 100 events begin a frame late, and of the 100, which
# last one frame each, 32 last none and 33 two. Nothing is said. Write TTML without fps, and .srt with pysubs2.
# Packages: ttconv 1.2.3.
# Data: three events, and 100 of one frame each at 30 frames/s, written here as .srt.
# Output seen:
#   srt [('02.000', '03.000', 'nod'), ('03.000', '03.500', 'nod+blink'), ('03.500', '04.000', 'nod'), ('05.000', '05.400', 'smile')]
#   vtt [('02.000', '03.000', 'nod'), ('03.000', '03.500', 'nod+blink'), ('03.500', '04.000', 'nod'), ('05.000', '05.400', 'smile')]
#   frames late: 0 of 67 events, 1 of 33 events
#   frames long: 0 of 32 events, 1 of 35 events, 2 of 33 events
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check ttconv==1.2.3
env/bin/python - <<'PYTHON'
import io
import re
import sys
from collections import Counter
from fractions import Fraction

import ttconv.imsc.writer
import ttconv.srt.reader
import ttconv.srt.writer
import ttconv.vtt.writer
from ttconv.imsc.config import IMSCWriterConfiguration


def cue(start, end, text):
    stamps = [f"{ms // 3600000:02}:{ms // 60000 % 60:02}:{ms // 1000 % 60:02},{ms % 1000:03}" for ms in (start, end)]
    return f"{stamps[0]} --> {stamps[1]}\n{text}\n\n"


def model(cues):
    return ttconv.srt.reader.to_model(io.StringIO("".join(f"{n}\n{cue(*one)}" for n, one in enumerate(cues, 1))))


coded = model([(2000, 4000, "nod"), (3000, 3500, "blink"), (5000, 5400, "smile")])
seen = []
for name, text in (("srt", ttconv.srt.writer.from_model(coded)), ("vtt", ttconv.vtt.writer.from_model(coded))):
    cues = re.findall(r"(\S+) --> (\S+)\n(.*?)\n\n", text + "\n\n", re.DOTALL)
    seen.append([(start[-6:].replace(",", "."), end[-6:].replace(",", "."), words.replace("\n", "+")) for start, end, words in cues])
    print(name, seen[-1])
starts = range(0, 400, 4)
frames = model([(round(k * 100 / 3), round((k + 1) * 100 / 3), "blink") for k in starts])
file = io.BytesIO()
ttconv.imsc.writer.from_model(frames, IMSCWriterConfiguration(fps=Fraction(30))).write(file)
pairs = [tuple(map(int, pair)) for pair in re.findall(r'begin="(\d+)f" end="(\d+)f"', file.getvalue().decode())]
for name, counts in (
    ("frames late", Counter(start - k for (start, _), k in zip(pairs, starts))),
    ("frames long", Counter(end - start for start, end in pairs)),
):
    seen.append(sorted(counts.items()))
    print(f"{name}:", ", ".join(f"{frames} of {count} events" for frames, count in seen[-1]))
cues = [("02.000", "03.000", "nod"), ("03.000", "03.500", "nod+blink"), ("03.500", "04.000", "nod"), ("05.000", "05.400", "smile")]
expected = [cues, cues, [(0, 67), (1, 33)], [(0, 32), (1, 35), (2, 33)]]
sys.exit(seen != expected)
PYTHON
