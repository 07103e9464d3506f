#!/usr/bin/env bash
# Two faces in a clip: a coder and a tracker who agree have an ICC of .09 and an alpha of 0.
#
# Found: what a coder and a tracker say of each frame is one table; with two people in the clip each frame has two rows for
# each of them. Packages for agreement take the columns of units and raters, and frames are units. pingouin 0.7.0
# (intraclass_corr) averages rows of the same frame and rater first: of people who speak in turn the mean of both mouths
# is compared, which hardly changes, and ICC is .09 where each mouth alone has .83 and more. With the default
# nan_policy="raise" a face that is lost in a frame is no error then, either. nltk 3.10.4 (AnnotationTask) compares all rows of
# a frame with each other, the left face with the right, too: alpha is 0 where each face has .6 and more, and kappa, which
# takes twice as many rows for chance, is 1.5. Neither says anything, where pandas' pivot raises an error. Join frame and
# person into a column, and give it as the unit.
# Packages: pingouin 0.7.0, nltk 3.10.4, pandas 3.1.1, numpy 2.4.6, scipy 1.17.1.
# Data: mouth openings of two people who speak in turn, and the same as three codes, from a coder and a tracker, made here.
# Output seen:
#   left, by frame: ICC 0.83 with 99 degrees of freedom; alpha 0.69, kappa 0.69; messages 0
#   right, by frame: ICC 0.85 with 99 degrees of freedom; alpha 0.63, kappa 0.63; messages 0
#   both faces, by frame: ICC 0.09 with 99 degrees of freedom; alpha -0.01, kappa 1.5; messages 0
#   both faces, by frame and face: ICC 0.85 with 199 degrees of freedom; alpha 0.66, kappa 0.66; messages 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pingouin==0.7.0 nltk==3.10.4 pandas==3.1.1 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np
import pandas as pd
import pingouin
from nltk.metrics.agreement import AnnotationTask

noise = np.random.default_rng(1)
frames = np.arange(100)
rows = []
for face, sign in (("left", 1), ("right", -1)):
    opening = 0.5 + 0.3 * sign * np.sin(frames / 6)
    for rater in ("coder", "tracker"):
        measured = opening + noise.normal(0, 0.1, frames.size)
        rows += [(int(k), face, f"{k} {face}", rater, x, int(np.digitize(x, (0.4, 0.6)))) for k, x in zip(frames, measured)]
table = pd.DataFrame(rows, columns=["frame", "face", "frame and face", "rater", "opening", "code"])


def agreement(who, part, unit):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = pingouin.intraclass_corr(part, targets=unit, raters="rater", ratings="opening").set_index("Type")
    said = [one for one in said if not issubclass(one.category, (DeprecationWarning, PendingDeprecationWarning))]
    task = AnnotationTask(list(part[["rater", unit, "code"]].itertuples(index=False, name=None)))
    values = (result.loc["ICC(A,1)", "ICC"], result.loc["ICC(A,1)", "df1"], task.alpha(), task.kappa())
    values = [round(float(value), 2) for value in values]
    print("{}, by {}: ICC {} with {:.0f} degrees of freedom; alpha {}, kappa {}".format(who, unit, *values) + f"; messages {len(said)}")
    return [*values, len(said)]


seen = [agreement(face, table[table["face"] == face], "frame") for face in ("left", "right")]
seen += [agreement("both faces", table, unit) for unit in ("frame", "frame and face")]
expected = [[0.83, 99, 0.69, 0.69, 0], [0.85, 99, 0.63, 0.63, 0], [0.09, 99, -0.01, 1.5, 0], [0.85, 199, 0.66, 0.66, 0]]
sys.exit(seen != expected)
PYTHON
