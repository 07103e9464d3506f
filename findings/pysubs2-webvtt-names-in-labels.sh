#!/usr/bin/env bash
# The name of an event stands in the label of the event before it, and a line whose words have times is lost.
#
# Found: pysubs2 1.8.1 reads WebVTT by the rules of SubRip: all lines up to the next two times are a cue's text, and of what
# stands between cues it takes away a number alone. In WebVTT a cue may have a name in words above its times, and comments
# (NOTE) stand between cues. Both become lines of the label before: "nod" is "nod", "NOTE unsure", "coder B", so that labels
# no longer compare, and who coded an event is said of another. A line with the times of two of its words, as
# captions that are aligned to speech have, is taken for the times of a cue: the words are gone, the cue has no text, and there
# is one more, which nobody wrote. webvtt-py and pycaption read all of it as it is. Nothing is said. Read WebVTT by webvtt-py.
# Packages: pysubs2 1.8.1, webvtt-py 0.6.0, pycaption 2.3.14.
# Data: three coded events, written here by webvtt-py, and a caption with times of its words.
# Output seen:
#   events by webvtt-py: 1 to 2 s "nod", 3 to 4 s "AU12", 5 to 6 s "AU4"
#   events by pycaption: 1 to 2 s "nod", 3 to 4 s "AU12", 5 to 6 s "AU4"
#   events by pysubs2: 1 to 2 s "nod / NOTE unsure / coder B", 3 to 4 s "AU12 / AU6 follows", 5 to 6 s "AU4"
#   words by webvtt-py: 1 to 4 s "so you nod"
#   words by pycaption: 1 to 4 s "so you nod"
#   words by pysubs2: 1 to 4 s "", 2 to 3 s ""
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pysubs2==1.8.1 webvtt-py==0.6.0 pycaption==2.3.14
env/bin/python - <<'PYTHON'
import io
import sys

import pycaption
import pysubs2
import webvtt


def by_webvtt_py(text):
    return [(cue.start_in_seconds, cue.end_in_seconds, cue.text) for cue in webvtt.from_string(text)]


def by_pycaption(text):
    (language,) = (cues := pycaption.WebVTTReader().read(text)).get_languages()
    return [(cue.start // 1000000, cue.end // 1000000, cue.get_text()) for cue in cues.get_captions(language)]


def by_pysubs2(text):
    return [(cue.start // 1000, cue.end // 1000, " / ".join(cue.text.split("\\N\\N"))) for cue in pysubs2.SSAFile.from_string(text)]


coded, file = webvtt.WebVTT(), io.StringIO()
for second, label, name in ((1, "nod", "coder A"), (3, "AU12", "coder B"), (5, "AU4", "AU6 follows")):
    coded.captions.append(webvtt.Caption(f"00:00:0{second}.000", f"00:00:0{second + 1}.000", label, identifier=name))
coded.captions[1].comments.append("unsure")
coded.write(file)
words = "WEBVTT\n\n00:00:01.000 --> 00:00:04.000\nso <00:00:02.000>you <00:00:03.000>nod\n"
seen = []
for name, text in (("events", file.getvalue()), ("words", words)):
    for reader in (by_webvtt_py, by_pycaption, by_pysubs2):
        cues = reader(text)
        seen.append(cues)
        by = reader.__name__[3:].replace("_", "-")
        print(f"{name} by {by}:", ", ".join(f'{start} to {end} s "{label}"' for start, end, label in cues))
right, spoken = [(1, 2, "nod"), (3, 4, "AU12"), (5, 6, "AU4")], [(1, 4, "so you nod")]
wrong = [(1, 2, "nod / NOTE unsure / coder B"), (3, 4, "AU12 / AU6 follows"), (5, 6, "AU4")]
sys.exit(seen != [right, right, wrong, spoken, spoken, [(1, 4, ""), (2, 3, "")]])
PYTHON
