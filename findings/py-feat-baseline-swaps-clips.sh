#!/usr/bin/env bash
# Less its baseline, the smile is the frown's.
#
# Found: py-feat 2.1.5 takes a baseline off each session of a table (a clip, or a face of several): Fex.baseline. It goes
# through the sessions by the alphabet, and puts their rows one after another. The labels of the sessions and the features of
# the rows stay as they were. So where clips do not come in the order of their names, and where two faces take turns from row to
# row, each row is labelled by another's name: the smile's numbers are the frown's, and half of a face's rows are the other's.
# Rows are numbered anew, so nothing in the table leads back. Every mean by session is then wrong, and none is 0, as it should
# be. normalize="db" is no decibel: it is 10 log10(x - baseline) / baseline, and nan wherever the face is below its baseline.
# clean() keeps the order, and so do means. Nothing is said. Sort the table by session first.
# Packages: py-feat 2.1.5 without what finds faces, pandas 2.3.3, numpy 2.4.6, scipy 1.17.1, scikit-learn 1.9.1.
# Data: made-up courses of AU12 of two clips, or of two faces of one clip, made here.
# Output seen:
#   clips by name: frown -2 0 2, smile -30 -10 10 30
#   clips not by name: smile -2 0 2 -30, frown -10 10 30
#   two faces in turns: face_2 -2 2 0, face_1 0 -20 20
#   db of 1 2 4: nan nan 0.95
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 pandas==2.3.3 scipy==1.17.1 scikit-learn==1.9.1
env/bin/pip install --quiet --disable-pip-version-check --no-deps py-feat==2.1.5
env/bin/python -W ignore - <<'PYTHON'
import sys
from unittest.mock import MagicMock

ABSENT = """torch torch.utils torch.utils.data torchvision torchvision.io torchvision.transforms torchcodec torchcodec.decoders xgboost PIL
seaborn matplotlib matplotlib.pyplot matplotlib.patches plotly plotly.graph_objects feat.detector feat.detector_v2 feat.pretrained
feat.plotting feat.transforms feat.utils.io feat.utils.blendshape_to_au"""
for name in ABSENT.split():
    sys.modules[name] = MagicMock()  # gigabytes that find faces and draw them, and are not used here
sys.modules["torch"].Tensor = type("Tensor", (), {})
import numpy as np
import pandas as pd
from feat.data import Fex

FROWN, SMILE = [1.0, 3.0, 5.0], [10.0, 30.0, 50.0, 70.0]


def less_its_mean(rows):
    """For each session, in the order of the table, what it has less its mean."""
    sessions, values = zip(*rows)
    table = Fex(pd.DataFrame({"AU12": values}), au_columns=["AU12"], sampling_freq=30, sessions=list(sessions))
    made = table.baseline("mean")
    assert list(made.sessions) == list(sessions) and list(made.index) == list(range(len(rows)))
    return ", ".join(
        " ".join([name, *(f"{number:.0f}" for number in made["AU12"][np.array(made.sessions) == name])]) for name in dict.fromkeys(sessions)
    )


frown, smile = [("frown", number) for number in FROWN], [("smile", number) for number in SMILE]
turns = [row for one, two in zip(FROWN, SMILE) for row in (("face_2", two), ("face_1", one))]
seen = [less_its_mean(frown + smile), less_its_mean(smile + frown), less_its_mean(turns)]
for name, told in zip(("clips by name", "clips not by name", "two faces in turns"), seen):
    print(f"{name}: {told}")
few = Fex(pd.DataFrame({"AU12": [1.0, 2.0, 4.0]}), au_columns=["AU12"], sampling_freq=30)
decibel = [round(float(number), 2) for number in few.baseline("mean", normalize="db")["AU12"]]
print("db of 1 2 4:", *decibel)
expected = ["frown -2 0 2, smile -30 -10 10 30", "smile -2 0 2 -30, frown -10 10 30", "face_2 -2 2 0, face_1 0 -20 20"]
sys.exit(seen != expected or decibel[2] != 0.95 or not np.isnan(decibel[:2]).all())
PYTHON
