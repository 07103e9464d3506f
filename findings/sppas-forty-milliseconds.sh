#!/usr/bin/env bash
# The same blinks, as .eaf and as .TextGrid: two are longer than 150 ms, or one.
#
# Found: SPPAS gives each boundary a radius within which it may lie, and compares with it. Of an ELAN file sppas 5.1.0 takes
# a radius of 20 ms for each boundary, of a TextGrid half a millisecond; neither file says so. A duration, between two
# boundaries, is then "equal" to all that are up to 40 ms away. The filter of durations, sppasTierFilters(tier).dur, which
# its window for analysis uses as well, asked for blinks of more than 80 ms leaves out one of 100 ms, and of those of at
# least 80 ms it finds one of 60; at 25 frames/s these are a frame. The very same events give 4 and 7, or 5 and 6: rates
# of blinks, and what is called long, depend on the file's form. Nothing is said. Write the TextGrid for SPPAS, or count
# durations from the exported numbers.
# Packages: sppas 5.1.0.
# Data: seven made-up blinks of 60 to 200 ms, as .eaf and as .TextGrid, written here.
# Output seen:
#   .eaf, above 0.08: 120 133 160 200
#   .eaf, at least 0.08: 60 80 100 120 133 160 200
#   .eaf, below 0.15: 60 80 100
#   .eaf, above 0.15: 200
#   .TextGrid, above 0.08: 100 120 133 160 200
#   .TextGrid, at least 0.08: 80 100 120 133 160 200
#   .TextGrid, below 0.15: 60 80 100 120 133
#   .TextGrid, above 0.15: 160 200
#   both hold the same times: True
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME="$folder" XDG_DATA_HOME="$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check sppas==5.1.0
env/bin/python - 2>log <<'PYTHON'
import sys
from pathlib import Path

from sppas.src.analysis import sppasTierFilters
from sppas.src.anndata import sppasTrsRW

BLINKS, end = [], 1000
for lasts in (60, 80, 100, 120, 133, 160, 200):
    BLINKS.append((end, end + lasts))
    end += lasts + 1000
slots, annotations = "", ""
for k, (a, b) in enumerate(BLINKS):
    slots += f'<TIME_SLOT TIME_SLOT_ID="ts{2 * k + 1}" TIME_VALUE="{a}"/><TIME_SLOT TIME_SLOT_ID="ts{2 * k + 2}" TIME_VALUE="{b}"/>'
    annotations += (
        f'<ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a{k + 1}" TIME_SLOT_REF1="ts{2 * k + 1}" TIME_SLOT_REF2="ts{2 * k + 2}">'
        f"<ANNOTATION_VALUE>{b - a}</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>"
    )
Path("blinks.eaf").write_text(
    '<?xml version="1.0" encoding="UTF-8"?><ANNOTATION_DOCUMENT AUTHOR="" DATE="2026-01-01T00:00:00+00:00" FORMAT="3.0" VERSION="3.0">'
    f'<HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"/><TIME_ORDER>{slots}</TIME_ORDER>'
    f'<TIER LINGUISTIC_TYPE_REF="default-lt" TIER_ID="blink">{annotations}</TIER>'
    '<LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="default-lt" TIME_ALIGNABLE="true"/></ANNOTATION_DOCUMENT>'
)
parts, last = [], 0
for a, b in BLINKS:
    parts += [(last, a, ""), (a, b, str(b - a))]
    last = b
parts.append((last, end, ""))
head = f'File type = "ooTextFile"\nObject class = "TextGrid"\n\nxmin = 0\nxmax = {end / 1000}\ntiers? <exists>\nsize = 1\nitem []:\n'
tier = f'    item [1]:\n        class = "IntervalTier"\n        name = "blink"\n        xmin = 0\n        xmax = {end / 1000}\n'
intervals = "".join(
    f'        intervals [{k}]:\n            xmin = {a / 1000}\n            xmax = {b / 1000}\n            text = "{text}"\n'
    for k, (a, b, text) in enumerate(parts, 1)
)
Path("blinks.TextGrid").write_text(f"{head}{tier}        intervals: size = {len(parts)}\n{intervals}")


def text(annotation):
    return "".join(label.get_best().get_content() for label in annotation.get_labels())


def times(tier):
    ends = (annotation.get_location().get_best() for annotation in tier if text(annotation))
    return [(round(1000 * one.get_begin().get_midpoint()), round(1000 * one.get_end().get_midpoint())) for one in ends]


seen, same = {}, True
for form in ("eaf", "TextGrid"):
    blinks = sppasTrsRW(f"blinks.{form}").read()[0]
    same = same and times(blinks) == BLINKS
    for what, asked in {"above 0.08": {"gt": 0.08}, "at least 0.08": {"ge": 0.08}, "below 0.15": {"lt": 0.15}, "above 0.15": {"gt": 0.15}}.items():
        chosen = [text(annotation) for annotation in sppasTierFilters(blinks).dur(**asked) if text(annotation)]
        seen[form, what] = " ".join(sorted(chosen, key=int))
        print(f".{form}, {what}: {seen[form, what]}")
print(f"both hold the same times: {same}")
sys.exit(
    not same
    or list(seen.values())
    != [
        "120 133 160 200",
        "60 80 100 120 133 160 200",
        "60 80 100",
        "200",
        "100 120 133 160 200",
        "80 100 120 133 160 200",
        "60 80 100 120 133",
        "160 200",
    ]
)
PYTHON
