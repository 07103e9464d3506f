#!/usr/bin/env bash
# Two coders who tick at random agree with a kappa of .7, since both know which face is which.
#
# Found: Cohen's kappa of BORIS 8.27.4 (time-unit; 9.15.0 has the same lines) writes into each cell of the contingency table who
# does what: "left nods" and "right nods" are two categories, "nothing" is one. What is coded of the left face is only ever compared
# with what is coded of the left face, but what would agree by chance is reckoned as if a coder could take the one for the other.
# So that the faces are two counts as agreement, and the more they nod, the more. Of two coders who tick seconds at random, nods in
# 9 of 10, kappa is about 0 for each face, and .7 for both together; at half it is .2.
# It is the number that is shown when several subjects are selected. Nothing is said. Select one subject at a time.
# Packages: boris-behav-obs 8.27.4, numpy 2.4.6, pandas 3.1.1. What plays sounds and videos (QtMultimedia, libmpv) is not needed
# and left out.
# Data: seconds drawn at random for two coders and two faces, made here. The formula is kappa's own, over seconds and faces.
# Output seen:
#   nods in 0.5, left: BORIS 0.01, by the formula 0.01
#   nods in 0.5, right: BORIS -0.02, by the formula -0.02
#   nods in 0.5, left and right: BORIS 0.2, by the formula -0.01
#   nods in 0.9, left: BORIS -0.01, by the formula -0.01
#   nods in 0.9, right: BORIS -0.01, by the formula -0.01
#   nods in 0.9, left and right: BORIS 0.7, by the formula -0.01
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check boris-behav-obs==8.27.4 numpy==2.4.6 pandas==3.1.1
QT_QPA_PLATFORM=offscreen env/bin/python - 2>errors.txt <<'PYTHON' || { cat errors.txt; exit 1; }
import logging
import sys
from decimal import Decimal
from unittest.mock import MagicMock

import numpy as np

for what in ("PyQt5.QtMultimedia", "boris.mpv2"):
    sys.modules[what] = MagicMock()
logging.disable(logging.CRITICAL)
from boris import config, db_functions, irr

noise = np.random.default_rng(0)
FACES = ["left", "right"]
SECONDS = 800


def observation(nods):
    events = []
    for face, ticked in zip(FACES, nods):
        edges = np.flatnonzero(np.diff(np.r_[False, ticked, False]))
        # A spell is from its first second to half a second before the first one without.
        times = [Decimal(int(edge)) - Decimal("0.5") * (k % 2) for k, edge in enumerate(edges)]
        events += [[time, face, "nod", "", ""] for time in times]
    return {config.TYPE: config.MEDIA, config.EVENTS: sorted(events, key=lambda event: event[0])}


def by_formula(first, second):
    by_chance = first.mean() * second.mean() + (1 - first.mean()) * (1 - second.mean())
    return round(float(((first == second).mean() - by_chance) / (1 - by_chance)), 2)


def kappa(project, faces):
    loaded, message, database = db_functions.load_aggregated_events_in_db(project, faces, ["a", "b"], ["nod"])
    assert loaded, message
    return round(float(irr.cohen_kappa(database.cursor(), "a", "b", Decimal(1), faces, False)[0]), 2)


seen = []
for often in (0.5, 0.9):
    coders = noise.random((2, 2, SECONDS)) < often
    coders[..., 0] = coders[..., -1] = True  # so that the first and last second are coded
    project = {
        config.ETHOGRAM: {"0": {config.BEHAVIOR_CODE: "nod", config.TYPE: config.STATE_EVENT}},
        config.SUBJECTS: {str(k): {config.SUBJECT_NAME: face} for k, face in enumerate(FACES)},
        config.OBSERVATIONS: {name: observation(nods) for name, nods in zip("ab", coders)},
    }
    for faces in (FACES[:1], FACES[1:], FACES):
        picked = coders[:, [FACES.index(face) for face in faces]].reshape(2, -1)
        seen.append((kappa(project, faces), by_formula(*picked)))
        print(f"nods in {often}, {' and '.join(faces)}: BORIS {seen[-1][0]}, by the formula {seen[-1][1]}")
alone, both = seen[:2] + seen[3:5], (seen[2], seen[5])
right = all(one == formula for one, formula in alone) and all(abs(formula) < 0.1 for _, formula in seen)
sys.exit(not right or not (both[0][0] > 0.15 and both[1][0] > 0.65))
PYTHON
