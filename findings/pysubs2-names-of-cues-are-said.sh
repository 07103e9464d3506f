#!/usr/bin/env bash
# A smile is "smile AU12-2" on the way from webvtt-py to pysubs2.
#
# Found: pysubs2 1.8.1 reads WebVTT as if it were SubRip, where a line of digits alone stands before a time. In WebVTT any line may
# stand there, the identifier of the cue, and blocks of NOTE may stand between cues; webvtt-py 0.6.0 writes both. pysubs2 takes
# them for the end of the text before: each event is labelled with the name of the next one, or with the coder's remark.
# Counted by label, four smiles are four kinds of event. A name of digits alone is taken away, so that files of players, which
# number their cues, look right. What is before the first cue is dropped, and what is saved as .srt has the names in the texts
# for good. Nothing is said. Read by webvtt-py, or write cues without names.
# Packages: pysubs2 1.8.1, webvtt-py 0.6.0.
# Data: four smiles and a blink with a remark, written here by webvtt-py.
# Output seen:
#   named AU12-1, AU12-2, ...: pysubs2 'smile|AU12-2' 'smile|AU12-3' 'smile|AU12-4' 'smile|NOTE not sure' 'blink'
#   named AU12-1, AU12-2, ...: webvtt-py 'smile' 'smile' 'smile' 'smile' 'blink'
#   named 1, 2, ...: pysubs2 'smile' 'smile' 'smile' 'smile|NOTE not sure' 'blink'
#   named 1, 2, ...: webvtt-py 'smile' 'smile' 'smile' 'smile' 'blink'
#   as SubRip: smile, AU12-2; messages 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pysubs2==1.8.1 webvtt-py==0.6.0
env/bin/python - <<'PYTHON'
import sys
import warnings

import pysubs2
import webvtt


def written(name, before):
    clip = webvtt.WebVTT()
    for k, label in enumerate(("smile", "smile", "smile", "smile", "blink")):
        cue = webvtt.Caption(f"00:00:0{k}.000", f"00:00:0{k}.480", label, identifier=f"{before}{k + 1}" if k < 4 else None)
        clip.captions.append(cue)
    clip.captions[4].comments = ["not sure"]
    clip.save(name)


seen = {}
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for before in ("AU12-", ""):
        written("clip.vtt", before)
        read = pysubs2.load("clip.vtt")
        labels = [event.plaintext.replace("\n\n", "|") for event in read]
        assert [(event.start, event.end) for event in read] == [(1000 * k, 1000 * k + 480) for k in range(5)]
        seen[before] = labels, [cue.text for cue in webvtt.read("clip.vtt")]
        for who, texts in zip(("pysubs2", "webvtt-py"), seen[before]):
            print(f"named {before}1, {before}2, ...: {who} " + " ".join(map(repr, texts)))
        if before:
            first = read.to_string("srt").splitlines()[2:4]
print(f"as SubRip: {', '.join(first)}; messages {len(said)}")
right = ["smile"] * 4 + ["blink"]
named = ["smile|AU12-2", "smile|AU12-3", "smile|AU12-4", "smile|NOTE not sure", "blink"]
numbered = ["smile"] * 3 + ["smile|NOTE not sure", "blink"]
expected = {"AU12-": (named, right), "": (numbered, right)}
sys.exit(seen != expected or first != ["smile", "AU12-2"] or bool(said))
PYTHON
