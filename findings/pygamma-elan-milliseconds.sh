#!/usr/bin/env bash
# A coder who works in ELAN and one who works in Praat agree in everything, and gamma is below 0.
#
# Found: pygamma-agreement 0.5.9 reads annotations of ELAN (add_elan) and of Praat (add_textgrid) into a continuum. Those
# of ELAN are in milliseconds there, as the file has them, and those of Praat in seconds; no documentation says so, and nothing
# keeps a continuum from having both. Gamma of two ELAN files of the same annotations is 1, of two TextGrids is 1, and of
# one of each is -.2: Praat's events lie in the first 57 ms of ELAN's time. Nothing is said. The same happens with events
# that are added from a tracker in seconds. Read the files yourself and add segments in seconds, or convert one file.
# Packages: pygamma-agreement 0.5.9, pympi-ling 1.71, TextGrid 1.6.1, numpy 2.4.6.
# Data: fifteen made-up annotations, written here as .eaf and as .TextGrid.
# Output seen:
#   eaf and eaf: gamma 1.0, ends at 56780
#   TextGrid and TextGrid: gamma 1.0, ends at 56.78
#   eaf and TextGrid: gamma below 0, ends at 56780
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pygamma-agreement==0.5.9 pympi-ling==1.71 TextGrid==1.6.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import logging
import sys

import numpy as np
import textgrid
from pygamma_agreement import CombinedCategoricalDissimilarity, Continuum
from pympi import Eaf

logging.disable(logging.WARNING)  # the solver is another than it would like best
noise = np.random.default_rng(1)
time, elan, praat = 0.0, Eaf(), textgrid.IntervalTier("face", 0, 100)
elan.add_tier("face")
elan.remove_tier("default")
for _ in range(15):
    time += noise.uniform(1, 5)
    begin, end, label = round(time, 2), round(time + 1, 2), ("nod", "shake", "smile")[noise.integers(3)]
    elan.add_annotation("face", round(begin * 1000), round(end * 1000), label)
    praat.add(begin, end, label)
    time += 1
elan.to_file("face.eaf")
grid = textgrid.TextGrid("face", 0, 100)
grid.append(praat)
grid.write("face.TextGrid")


def gamma(*formats):
    continuum = Continuum()
    for number, form in enumerate(formats):
        add = continuum.add_elan if form == "eaf" else continuum.add_textgrid
        add(f"coder {number}", f"face.{form}")
    np.random.seed(0)
    value = float(continuum.compute_gamma(CombinedCategoricalDissimilarity(), n_samples=30).gamma)
    said = "below 0" if value < 0 else round(value, 3)
    print(" and ".join(formats) + f": gamma {said}, ends at {continuum.bound_sup}")
    return said, continuum.bound_sup


seen = [gamma("eaf", "eaf"), gamma("TextGrid", "TextGrid"), gamma("eaf", "TextGrid")]
sys.exit(seen != [(1, 56780), (1, 56.78), ("below 0", 56780)])
PYTHON
