#!/usr/bin/env bash
# An empty first row of a DeepLabCut table moves every frame by one.
#
# Found: DeepLabCut's CSV has three or four header rows and the number of the frame in the first column. Programs read it
# as pandas.read_csv(file, header=[0, 1, 2], index_col=0). Where nothing is known in the FIRST frame (an animal or a face
# that comes later), its cells are empty, and pandas 3.1.1 takes that row for the line with the name of the index: the
# frame is gone, without a word, and what was in row n is in row n - 1. Empty rows further down stay. With the text nan
# in one cell of that row, or read with index_col=0 and one header row, nothing is lost.
# Packages: pandas 3.1.1 with numpy 2.4.6.
# Data: a made-up table of four frames, written here.
# Output seen:
#   header rows 3, first frame empty: frames [1, 2, 3], named '0', x at place 1 is 12.5
#   header rows 3, first frame has a text nan: frames [0, 1, 2, 3], named None, x at place 1 is 11.5
#   header rows 3, second frame empty: frames [0, 1, 2, 3], named None, x at place 1 is nan
#   header rows 4, first frame empty: frames [1, 2, 3], named '0', x at place 1 is 12.5
#   header rows 1, first frame empty: frames [0, 1, 2, 3], named 'frame', x at place 1 is 11.5
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import io
import sys

import pandas as pd


def read(headers, rows):
    head = {1: ["frame,x,y,likelihood"], 3: ["scorer,a,a,a", "bodyparts,nose,nose,nose", "coords,x,y,likelihood"]}
    head[4] = [head[3][0], "individuals,one,one,one", *head[3][1:]]
    text = "\n".join([*head[headers], *rows]) + "\n"
    return pd.read_csv(io.StringIO(text), header=list(range(headers)) if headers > 1 else 0, index_col=0)


full = [f"{frame},{frame + 10.5},20,0.9" for frame in range(4)]
late = ["0,,,", *full[1:]]
told = ["0,nan,,", *full[1:]]
hole = [full[0], "1,,,", *full[2:]]
found = {
    "3, first frame empty": read(3, late), "3, first frame has a text nan": read(3, told),
    "3, second frame empty": read(3, hole), "4, first frame empty": read(4, late), "1, first frame empty": read(1, late),
}
for what, table in found.items():
    print(f"header rows {what}: frames {table.index.tolist()}, named {table.index.name!r}, x at place 1 is", table.iloc[1, 0])
frames = [table.index.tolist() for table in found.values()]
four = [0, 1, 2, 3]
moved = float(found["3, first frame empty"].iloc[1, 0])
sys.exit(frames != [four[1:], four, four, four[1:], four] or moved != 12.5)
PYTHON
