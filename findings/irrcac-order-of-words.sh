#!/usr/bin/env bash
# The ordinal agreement of coders who write words depends on the alphabet.
#
# Found: irrCAC 0.4.4 takes ratings as numbers or as words, and weights near misses less (weights="ordinal", "linear",
# "quadratic"). The scale is the sorted categories. Of words it is the alphabet: extreme, marked, none, severe, slight. So
# none and severe are neighbours, and none and slight are two steps apart. Of the same ratings alpha with ordinal weights
# is .834 as the numbers 1 to 5, and .736 as words; of two coders who never differ by more than a step, .792 and .098.
# Other words for the same scale give other numbers. Nothing is said, where krippendorff 0.9.0 raises an error. With
# identity weights all is well, since they need no order. Give categories= in their order, or code numbers.
# Packages: irrCAC 0.4.4, krippendorff 0.9.0, pandas 2.3.3, scipy 1.12.0, numpy 1.26.4.
# Data: Krippendorff's well-known example of four coders, and one of two coders, written here.
# Output seen:
#   four coders, identity: numbers 0.743, words 0.743, words with their order 0.743
#   four coders, ordinal: numbers 0.834, words 0.736, words with their order 0.834
#   one step off, ordinal: numbers 0.792, words 0.098, words with their order 0.792
#   krippendorff, words, ordinal: ValueError
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check irrCAC==0.4.4 krippendorff==0.9.0 pandas==2.3.3 scipy==1.12.0 numpy==1.26.4
env/bin/python - <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import krippendorff
import pandas as pd
from irrCAC.raw import CAC

SCALE = ["none", "slight", "marked", "severe", "extreme"]
NAN = float("nan")
FOUR = {
    "a": [1, 2, 3, 3, 2, 1, 4, 1, 2, NAN, NAN, NAN],
    "b": [1, 2, 3, 3, 2, 2, 4, 1, 2, 5, NAN, 3],
    "c": [NAN, 3, 3, 3, 2, 3, 4, 2, 2, 5, 1, NAN],
    "d": [1, 2, 3, 3, 2, 4, 4, 1, 2, 5, 1, NAN],
}
TWO = {"a": [1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 1, 2], "b": [1, 2, 2, 1, 3, 2, 4, 5, 5, 4, 2, 3]}


def alpha(ratings, weights, **order):
    return round(float(CAC(ratings, weights=weights, **order).krippendorff()["est"]["coefficient_value"]), 3)


seen = []
for what, ratings, weights in (("four coders", FOUR, "identity"), ("four coders", FOUR, "ordinal"), ("one step off", TWO, "ordinal")):
    numbers = pd.DataFrame(ratings)
    words = numbers.apply(lambda column: column.map(lambda v: SCALE[int(v) - 1] if v == v else NAN))
    found = alpha(numbers, weights), alpha(words, weights), alpha(words, weights, categories=SCALE)
    seen.append(found)
    print("{}, {}: numbers {}, words {}, words with their order {}".format(what, weights, *found))
try:
    krippendorff.alpha([[SCALE[v - 1] for v in row] for row in TWO.values()], level_of_measurement="ordinal")
    other = "a number"
except ValueError:
    other = "ValueError"
print(f"krippendorff, words, ordinal: {other}")
sys.exit(seen != [(0.743, 0.743, 0.743), (0.834, 0.736, 0.834), (0.792, 0.098, 0.792)] or other != "ValueError")
PYTHON
