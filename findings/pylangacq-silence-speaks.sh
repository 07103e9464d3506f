#!/usr/bin/env bash
# In Praat the silence before an utterance is part of it, and ELAN gets a file that is no XML.
#
# Found: pylangacq 0.23.0 writes CHAT (CLAN's transcripts) as Praat's TextGrid and as ELAN's .eaf. Praat's tiers of intervals have
# no holes: silence is an interval without a label. Here the utterances alone are written, so that Praat, which looks for the
# first interval that does not end before a time, answers 2.0 s, a second before the second utterance, with that utterance; before
# the first and after the last there is no interval. An utterance without a time is left out. An utterance with two
# time bullets, as CHAT allows, ends with the first one, and so does a subtitle in .srt. In .eaf each text keeps
# its bullet with the control characters 0x15, which XML forbids: ELAN, pympi or any other parser rejects the whole file.
# Nothing is said by the writer. Take the bullets out of the .eaf, and let tgt read and write the TextGrid, which fills the holes.
# Packages: pylangacq 0.23.0, rustling 0.9.0, praat-parselmouth 0.4.7 (Praat itself), tgt 1.5, numpy 2.4.6.
# Data: a transcript of four utterances, written here.
# Output seen:
#   Praat at 0.1, 1.0, 2.0, 3.5, 5.2, 6.0 s: [None, 'I see the face .', 'it nods .', 'it nods .', 'yes  it nods .', None]
#   the same after tgt: ['', 'I see the face .', '', 'it nods .', 'yes  it nods .', None]
#   .srt: ['00:00:00,333 --> 00:00:01,667', '00:00:03,000 --> 00:00:04,000', '00:00:05,000 --> 00:00:05,400']
#   .eaf: not well-formed (invalid token)
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pylangacq==0.23.0 rustling==0.9.0 praat-parselmouth==0.4.7 numpy==2.4.6 tgt==1.5
env/bin/python - <<'PYTHON'
import sys
import warnings
from xml.etree import ElementTree

import parselmouth
import pylangacq
import tgt

CHAT = """@UTF8
@Begin
@Languages:\teng
@Participants:\tCHI Target_Child
@ID:\teng|x|CHI|2;00.|female|||Target_Child|||
@Media:\tclip, video
*CHI:\tI see the face . \x15333_1667\x15
*CHI:\tit nods . \x153000_4000\x15
*CHI:\tno time here .
*CHI:\tyes \x155000_5400\x15 it nods . \x155400_6200\x15
@End
"""
with open("clip.cha", "w") as file:
    file.write(CHAT)
seen = []
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    transcript = pylangacq.read_chat("clip.cha")
    with open("clip.TextGrid", "w") as file:
        file.write(transcript.to_textgrid_strs()[0])
    with open("clip.eaf", "w") as file:
        file.write(transcript.to_elan_strs()[0])


def labels(name):
    grid = parselmouth.read(name)
    row = []
    for time in (0.1, 1.0, 2.0, 3.5, 5.2, 6.0):
        number = int(parselmouth.praat.call(grid, "Get interval at time", 1, time))
        row.append(parselmouth.praat.call(grid, "Get label of interval", 1, number) if number else None)
    return row


seen.append(labels("clip.TextGrid"))
print("Praat at 0.1, 1.0, 2.0, 3.5, 5.2, 6.0 s:", seen[-1])
tgt.write_to_file(tgt.read_textgrid("clip.TextGrid"), "filled.TextGrid", format="long")
seen.append(labels("filled.TextGrid"))
print("the same after tgt:", seen[-1])
seen.append([line for line in transcript.to_srt_strs()[0].splitlines() if "-->" in line])
print(".srt:", seen[-1])
try:
    ElementTree.parse("clip.eaf")
    seen.append("read")
except ElementTree.ParseError as error:
    seen.append(str(error).split(":")[0])
print(".eaf:", seen[-1])
expected = [
    [None, "I see the face .", "it nods .", "it nods .", "yes  it nods .", None],
    ["", "I see the face .", "", "it nods .", "yes  it nods .", None],
    ["00:00:00,333 --> 00:00:01,667", "00:00:03,000 --> 00:00:04,000", "00:00:05,000 --> 00:00:05,400"],
    "not well-formed (invalid token)",
]
sys.exit(seen != expected or bool(said))
PYTHON
