#!/usr/bin/env bash
# Two heads that have nothing to do with each other recur all the time, once a frame is lost.
#
# Found: CrossRecurrencePlot of pyunicorn 1.0.0 takes a nan for no distance at all, in its default metric ("supremum"): each lost
# frame of a head recurs with every frame of the other. Of two unrelated heads, a fifth of the frames of one lost, the
# cross-recurrence rate is .3 and not .12; with "euclidean" or "manhattan" lost frames recur with none, and it is .1. With
# normalize=True a single lost frame makes all of its head nan, and the rate 1: perfect coupling. With recurrence_rate=.1, by which
# a threshold is sought at which a tenth recurs, the lost frames are that tenth, and then the threshold is 0: nothing recurs.
# The class has no setting for missing values (RecurrencePlot, of one head, has). Nothing is raised or said.
# Cut the lost frames out of the series, which may be of two lengths, or fill them before.
# Packages: pyunicorn 1.0.0, numpy 2.4.6, scipy 1.17.1.
# Data: angles of two unrelated heads in 500 frames, made here.
# Output seen:
#   none lost: supremum 0.12, euclidean 0.12, normalized 0.12, a tenth asked for 0.1
#   1 lost: supremum 0.12, euclidean 0.12, normalized 1.0, a tenth asked for 0.1
#   100 lost: supremum 0.3, euclidean 0.1, normalized 1.0, a tenth asked for 0.0
#   100 lost, cut out: supremum 0.12, a tenth asked for 0.1
#   warnings 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyunicorn==1.0.0 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys
import warnings

import numpy as np

with contextlib.redirect_stdout(io.StringIO()):  # matplotlib, of which it speaks here, is for its maps
    from pyunicorn.timeseries import CrossRecurrencePlot

noise = np.random.default_rng(0)


def head():
    smooth = np.convolve(noise.normal(size=600), np.hanning(40), mode="valid")[:500]
    return (smooth - smooth.mean()) / smooth.std()


def rate(x, y, **options):
    return round(float(CrossRecurrencePlot(x, y, silence_level=2, **options).cross_recurrence_rate()), 2)


first, second = head(), head()
seen, messages = {}, 0
for lost in (0, 1, 100):
    gone = first.copy()
    gone[200 : 200 + lost] = np.nan
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rates = [rate(gone, second, threshold=0.2), rate(gone, second, threshold=0.2, metric="euclidean")]
        rates += [rate(gone, second, threshold=0.2, normalize=True), rate(gone, second, recurrence_rate=0.1)]
    messages += len(said)
    seen[lost] = rates
    names = ("supremum", "euclidean", "normalized", "a tenth asked for")
    print(f"{lost or 'none'} lost: " + ", ".join(f"{name} {value}" for name, value in zip(names, rates)))
there = first[~np.isnan(gone)]
cut = rate(there, second, threshold=0.2), rate(there, second, recurrence_rate=0.1)
print(f"100 lost, cut out: supremum {cut[0]}, a tenth asked for {cut[1]}")
print("warnings", messages)
expected = {0: [0.12, 0.12, 0.12, 0.1], 1: [0.12, 0.12, 1, 0.1], 100: [0.3, 0.1, 1, 0]}
sys.exit(seen != expected or cut != (0.12, 0.1) or messages > 0)
PYTHON
