#!/usr/bin/env bash
# An annotation of ELAN with a duration of -.04 s.
#
# Found: in ELAN's .eaf the annotations of a tier of the stereotype Time_Subdivision share a span, and the slots
# between them need no time; those of a Symbolic_Subdivision have no slots at all. ELAN shows both as equal shares
# of the span until somebody moves them. speach 0.1a15.post1 reads such a file without a word, and takes a slot
# without a time for 0 where it computes durations. The three parts of a span from .04 to 1.24 s have durations of
# -.04, 0 and 1.24 s, for .4 each; their sum is right, and hides it. Of the symbolic tier each part has the whole
# span, so that three parts last three times as long as what they are parts of.
# Packages: speach 0.1a15.post1.
# Data: a small EAF 3.0 file with made-up annotations, written here.
# Output seen:
#   nods: durations [1.2], sum 1.2
#   swings: durations [-0.04, 0, 1.24], sum 1.2
#   phases: durations [1.2, 1.2, 1.2], sum 3.6
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check speach==0.1a15.post1
env/bin/python - <<'PYTHON'
import sys
from pathlib import Path

from speach import elan

PARTS = "abc"
TIMES = {1: ' TIME_VALUE="40"', 2: "", 3: "", 4: ' TIME_VALUE="1240"'}
SLOTS = "".join(f'<TIME_SLOT TIME_SLOT_ID="ts{n}"{time}/>' for n, time in TIMES.items())


def aligned(name, first, last, text):
    ends = f'ANNOTATION_ID="{name}" TIME_SLOT_REF1="ts{first}" TIME_SLOT_REF2="ts{last}"'
    value = f"<ANNOTATION_VALUE>{text}</ANNOTATION_VALUE>"
    return f"<ANNOTATION><ALIGNABLE_ANNOTATION {ends}>{value}</ALIGNABLE_ANNOTATION></ANNOTATION>"


def symbolic(name, previous, text):
    about = f'ANNOTATION_ID="{name}" ANNOTATION_REF="a1"' + (f' PREVIOUS_ANNOTATION="{previous}"' if previous else "")
    value = f"<ANNOTATION_VALUE>{text}</ANNOTATION_VALUE>"
    return f"<ANNOTATION><REF_ANNOTATION {about}>{value}</REF_ANNOTATION></ANNOTATION>"


def tier(name, kind, annotations, parent=""):
    above = f' PARENT_REF="{parent}"' if parent else ""
    return f'<TIER LINGUISTIC_TYPE_REF="{kind}"{above} TIER_ID="{name}">{"".join(annotations)}</TIER>'


def kind(name, stereotype, time):
    constraint = f' CONSTRAINTS="{stereotype}"' if stereotype else ""
    about = f'GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="{name}" TIME_ALIGNABLE="{time}"'
    return f"<LINGUISTIC_TYPE{constraint} {about}/>"


Path("a.eaf").write_text(
    '<?xml version="1.0" encoding="UTF-8"?><ANNOTATION_DOCUMENT AUTHOR="" DATE="2024-01-01T00:00:00+00:00" FORMAT="3.0"'
    ' VERSION="3.0" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
    ' xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">'
    '<HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"/>'
    f"<TIME_ORDER>{SLOTS}</TIME_ORDER>"
    + tier("nods", "plain", [aligned("a1", 1, 4, "nod")])
    + tier("swings", "cut", [aligned(f"a{n + 1}", n, n + 1, text) for n, text in enumerate(PARTS, 1)], "nods")
    + tier("phases", "symbols", [symbolic(f"a{n}", n > 5 and f"a{n - 1}", v) for n, v in enumerate(PARTS, 5)], "nods")
    + kind("plain", "", "true")
    + kind("cut", "Time_Subdivision", "true")
    + kind("symbols", "Symbolic_Subdivision", "false")
    + '<CONSTRAINT DESCRIPTION="time" STEREOTYPE="Time_Subdivision"/>'
    '<CONSTRAINT DESCRIPTION="symbols" STEREOTYPE="Symbolic_Subdivision"/></ANNOTATION_DOCUMENT>'
)
found = {}
for one in elan.read_eaf("a.eaf").tiers():
    found[one.ID] = [round(annotation.duration, 3) for annotation in one]
    print(f"{one.ID}: durations {found[one.ID]}, sum {round(sum(found[one.ID]), 3)}")
sys.exit(found != {"nods": [1.2], "swings": [-0.04, 0, 1.24], "phases": [1.2] * 3})
PYTHON
