#!/usr/bin/env bash
# Two coders agree fully, since the second file that is read takes the place of the first.
#
# Found: pyvyu 0.3.6 is the Python API of Datavyu, in which coders of behaviour mark events. All its spreadsheets share a single table
# of columns (a dict of the class). Load the file of a second coder, and the spreadsheet of the first has the second one's cells wherever
# a column has the same name, as it has when agreement is measured: here left, left, right against left, right, up agree in 3 of 3
# cells and not in 1. A column that only the first coder has appears in the second spreadsheet, too. A text with a comma is cut
# there on reading, also a text that save_opf wrote: "slow, then fast" with intensity 3 comes back as "slow" with intensity
# " then fast", and 3 is gone. Nothing is said of it. Read each file in a process of its own, or copy cells out before the next.
# Packages: pyvyu 0.3.6, pandas 3.1.1, numpy 2.4.6.
# Data: the files of two coders with three cells each, written here.
# Output seen:
#   first coder alone: left, left, right
#   then second coder: left, right, up
#   first coder now: left, right, up
#   columns of the second: head, note
#   written and read: {'text': 'slow', 'intensity': ' then fast'}
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyvyu==0.3.6 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys
import zipfile

import pyvyu


def write(name, codes, more=""):
    cells = "".join(f"00:00:0{k}:000,00:00:0{k}:900,({code})\n" for k, code in enumerate(codes, 1))
    with zipfile.ZipFile(name, "w") as file:
        file.writestr("db", f"#4\nhead (MATRIX,true,)-direction|NOMINAL\n{cells}{more}")


def codes(sheet):
    return ", ".join(cell.get_code("direction") for cell in sheet.get_column("head").cells)


write("first.opf", ("left", "left", "right"), "note (MATRIX,true,)-text|NOMINAL\n00:00:01:000,00:00:01:900,(slow)\n")
write("second.opf", ("left", "right", "up"))
first = pyvyu.load_opf("first.opf")
seen = [codes(first)]
second = pyvyu.load_opf("second.opf")
seen += [codes(second), codes(first), ", ".join(sorted(second.get_column_list()))]
sheet = pyvyu.Spreadsheet()
sheet.new_column("note", "text", "intensity").new_cell("slow, then fast", "3", ordinal=1, onset=1000, offset=1900)
with contextlib.redirect_stdout(io.StringIO()):
    pyvyu.save_opf(sheet, "third.opf", True, "note")
cell = pyvyu.load_opf("third.opf").get_column("note").cells[0]
seen.append(str({code: cell.get_code(code) for code in ("text", "intensity")}))
for name, row in zip(("first coder alone", "then second coder", "first coder now", "columns of the second", "written and read"), seen):
    print(f"{name}: {row}")
expected = [
    "left, left, right",
    "left, right, up",
    "left, right, up",
    "head, note",
    "{'text': 'slow', 'intensity': ' then fast'}",
]
sys.exit(seen != expected)
PYTHON
