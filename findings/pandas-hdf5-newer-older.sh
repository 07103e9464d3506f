#!/usr/bin/env bash
# The HDF5 table that pandas 3.1 writes cannot be read by the pandas that DeepLabCut needs.
#
# Found: DeepLabCut's tables are HDF5 files of pandas (to_hdf with format="table"). DeepLabCut 3.0.2 asks for a
# pandas below 3. Tables that pandas 3.1.1 writes no longer have the attribute pandas_version, which was "0.15.2"
# before; pandas 2.2.3 then takes the file for one of before 0.10, looks for the values under the names of that
# time, and ends with AttributeError: 'NoneType' object has no attribute 'startswith'. It does so with plain
# columns, too. With that one attribute put there by hand the same file is read, with all numbers and names. The
# other way round all is well.
# Packages: pandas 3.1.1 and 2.2.3, with tables 3.11.1 and 3.10.1, numpy 2.4.6 and 1.26.4.
# Data: a made-up table of five frames with two points, written here.
# Output seen:
#   of pandas 2.2.3, read by 3.1.1: plain columns right; DeepLabCut's right
#   of pandas 3.1.1, read by 3.1.1: plain columns right; DeepLabCut's right
#   of pandas 3.1.1-mended, read by 3.1.1: plain columns right; DeepLabCut's right
#   of pandas 2.2.3, read by 2.2.3: plain columns right; DeepLabCut's right
#   of pandas 3.1.1, read by 2.2.3: plain columns 'NoneType' object has no attribute 'startswith'; DeepLabCut's the same
#   of pandas 3.1.1-mended, read by 2.2.3: plain columns right; DeepLabCut's right
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv one
one/bin/pip install --quiet --disable-pip-version-check pandas==3.1.1 tables==3.11.1 numpy==2.4.6
python3 -m venv other
other/bin/pip install --quiet --disable-pip-version-check pandas==2.2.3 tables==3.10.1 numpy==1.26.4
cat > see.py <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import numpy as np
import pandas as pd

KEY = "df_with_missing"
LEVELS = {"scorer": ["x"], "bodyparts": ["nose", "chin"], "coords": ["x", "y", "likelihood"]}
COLUMNS = {
    "plain": pd.Index(["nose_x", "nose_y", "chin_x", "chin_y"]),
    "dlc": pd.MultiIndex.from_product([*LEVELS.values()], names=[*LEVELS]),
}


def table(columns):
    return pd.DataFrame(np.arange(5.0 * len(columns)).reshape(5, -1), columns=columns)


def write(by):
    for name, columns in COLUMNS.items():
        for mended in (False, True) if by == "3.1.1" else (False,):
            path = f"{by}{'-mended' if mended else ''}-{name}.h5"
            table(columns).to_hdf(path, key=KEY, format="table", mode="w")
            if mended:
                with pd.HDFStore(path, "a") as store:
                    store.get_storer(KEY).attrs.pandas_version = "0.15.2"


def read(path, columns):
    try:
        found = pd.read_hdf(path, KEY)
    except AttributeError as e:
        return str(e)
    return "right" if np.array_equal(found, table(columns)) and list(found) == list(columns) else "other"


if sys.argv[1] == "write":
    write(pd.__version__)
else:
    seen = {}
    for by in ("2.2.3", "3.1.1", "3.1.1-mended"):
        seen[by] = [read(f"{by}-{name}.h5", columns) for name, columns in COLUMNS.items()]
        second = "the same" if seen[by][0] == seen[by][1] != "right" else seen[by][1]
        print(f"of pandas {by}, read by {pd.__version__}: plain columns {seen[by][0]}; DeepLabCut's {second}")
    right = ["right", "right"]
    wrong = ["'NoneType' object has no attribute 'startswith'"] * 2 if pd.__version__ == "2.2.3" else right
    sys.exit(seen != {"2.2.3": right, "3.1.1": wrong, "3.1.1-mended": right})
PYTHON
one/bin/python see.py write
other/bin/python see.py write
one/bin/python see.py read
other/bin/python see.py read
