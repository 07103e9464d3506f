#!/usr/bin/env bash
# A mouth that is open for 1.2 s, cut in three, is open for .44 s.
#
# Found: elan-data 1.7.3 edits ELAN's .eaf files. split_segment, which cuts an annotation at the times that it is given,
# makes parts that end where they begin, all but the last: 40 to 1240 ms, cut at 400 and 800, becomes 400 to 400, 800 to
# 800 and 800 to 1240, and the 760 ms before are nobody's. What hangs on the annotation (tiers of the type
# Symbolic_Subdivision or Symbolic_Association, as glosses and translations) still refers to the old number, which is no
# longer in the file; so it does after remove_segment. Such tiers are no part of the table tier_data, either, although
# tier_names has them. Nothing is said, and the file is saved. Cut in ELAN, or, where nothing hangs on the annotation, with
# remove_segment and an add_segment for each part; read glosses by another program.
# Packages: elan-data 1.7.3, pandas 3.1.1, numpy 2.4.6.
# Data: an .eaf of two annotations and two glosses, written here.
# Output seen:
#   tiers ['mouth', 'gloss'], in the table ['mouth']
#   cut at 400 and 800: 40 to 1240 is now 400 to 400, 800 to 800, 800 to 1240; lasts 440 of 1200 ms
#   the glosses refer to a1, a1; in the file are a2, a5, a6, a7
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check elan-data==1.7.3 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import re
import sys
from pathlib import Path

from elan_data import ELAN_Data

SPANS = [(40, 1240, "open"), (1280, 2000, "wide")]
slots = "".join(
    f'<TIME_SLOT TIME_SLOT_ID="ts{2 * k + 1 + j}" TIME_VALUE="{span[j]}"/>' for k, span in enumerate(SPANS) for j in (0, 1)
)
mouth = "".join(
    f'<ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a{k + 1}" TIME_SLOT_REF1="ts{2 * k + 1}" TIME_SLOT_REF2="ts{2 * k + 2}">'
    f"<ANNOTATION_VALUE>{text}</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>"
    for k, (_, _, text) in enumerate(SPANS)
)
gloss = "".join(
    f'<ANNOTATION><REF_ANNOTATION ANNOTATION_ID="{name}" ANNOTATION_REF="a1"{after}>'
    f"<ANNOTATION_VALUE>{text}</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>"
    for name, after, text in (("a3", "", "ah"), ("a4", ' PREVIOUS_ANNOTATION="a3"', "oh"))
)
Path("mouth.eaf").write_text(
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<ANNOTATION_DOCUMENT AUTHOR="" DATE="2026-01-01T00:00:00+00:00" FORMAT="3.0" VERSION="3.0"'
    ' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
    ' xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">'
    '<HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"><PROPERTY NAME="lastUsedAnnotationId">4</PROPERTY></HEADER>'
    f"<TIME_ORDER>{slots}</TIME_ORDER>"
    f'<TIER LINGUISTIC_TYPE_REF="free" TIER_ID="mouth">{mouth}</TIER>'
    f'<TIER LINGUISTIC_TYPE_REF="parts" PARENT_REF="mouth" TIER_ID="gloss">{gloss}</TIER>'
    '<LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="free" TIME_ALIGNABLE="true"/>'
    '<LINGUISTIC_TYPE CONSTRAINTS="Symbolic_Subdivision" GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="parts"'
    ' TIME_ALIGNABLE="false"/><CONSTRAINT DESCRIPTION="equal parts" STEREOTYPE="Symbolic_Subdivision"/></ANNOTATION_DOCUMENT>'
)
file = ELAN_Data.from_file("mouth.eaf", init_df=True)
names, rows = list(file.tier_names), sorted(set(file.tier_data.TIER_ID))
print(f"tiers {names}, in the table {rows}")
file.split_segment([400, 800], "a1")
file.save_ELAN("cut.eaf")
cut = ELAN_Data.from_file("cut.eaf", init_df=True).tier_data
parts = [(int(a), int(b)) for a, b, text in zip(cut.START, cut.STOP, cut.TEXT) if text == "open"]
lasts = sum(b - a for a, b in parts)
print(f"cut at 400 and 800: 40 to 1240 is now {', '.join(f'{a} to {b}' for a, b in parts)}; lasts {lasts} of 1200 ms")
text = Path("cut.eaf").read_text()
refers = re.findall(r'ANNOTATION_REF="(\w+)"', text)
there = sorted(re.findall(r'ALIGNABLE_ANNOTATION ANNOTATION_ID="(\w+)"', text))
print(f"the glosses refer to {', '.join(refers)}; in the file are {', '.join(there)}")
sys.exit(
    (names, rows) != (["mouth", "gloss"], ["mouth"])
    or parts != [(400, 400), (800, 800), (800, 1240)]
    or refers != ["a1", "a1"]
    or "a1" in there
)
PYTHON
