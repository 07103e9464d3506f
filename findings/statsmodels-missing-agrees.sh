#!/usr/bin/env bash
# Two coders who agree by chance, and both leave most of the clip uncoded, have a kappa of .73.
#
# Found: agreement of coders (or of a coder and a tracker) is told by kappa. statsmodels 0.15.0 makes the tables for
# it of units and coders: to_table for cohens_kappa, aggregate_raters for fleiss_kappa. A unit that was not coded,
# nan, becomes a category of its own, and two coders who both have nothing there agree. Of twenty units in which two
# coders agree just as often as chance would have it, kappa is 0. With twenty more that neither coded, since the
# face was out of the picture, it is .6, and with 180 more .73. Nothing is said. Krippendorff's alpha, by
# krippendorff 0.9.0, leaves such units out: .025 in each case. Rows with nan have to be dropped before.
# Packages: statsmodels 0.15.0, krippendorff 0.9.0, numpy 2.4.6, pandas 3.1.1, scipy 1.17.1.
# Data: made-up codes of two coders, written here.
# Output seen:
#   0 units that neither coded: Cohen 0.0, Fleiss 0.0, alpha 0.025; table (2, 2)
#   20 units that neither coded: Cohen 0.6, Fleiss 0.6, alpha 0.025; table (3, 3)
#   180 units that neither coded: Cohen 0.73, Fleiss 0.73, alpha 0.025; table (3, 3)
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check statsmodels==0.15.0 krippendorff==0.9.0 numpy==2.4.6 pandas==3.1.1 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys

import krippendorff
import numpy as np
from statsmodels.stats.inter_rater import aggregate_raters, cohens_kappa, fleiss_kappa, to_table

CODED = [(0, 0), (0, 1), (1, 0), (1, 1)] * 5  # by chance: half of them agree


def measured(uncoded):
    """Cohen's kappa, Fleiss' kappa, Krippendorff's alpha of 20 coded units and so many that neither has coded."""
    units = np.array([*CODED, *[(np.nan, np.nan)] * uncoded])
    table, _ = to_table(units)
    counts, _ = aggregate_raters(units)
    alpha = krippendorff.alpha(reliability_data=units.T, level_of_measurement="nominal")
    kappa = cohens_kappa(table, return_results=False)
    return [round(float(value), 3) for value in (kappa, fleiss_kappa(counts), alpha)], table.shape


found = [measured(uncoded) for uncoded in (0, 20, 180)]
for uncoded, (values, shape) in zip((0, 20, 180), found, strict=True):
    cohen, fleiss, alpha = values
    print(f"{uncoded} units that neither coded: Cohen {cohen}, Fleiss {fleiss}, alpha {alpha}; table {shape}")
coders = [([0.0, 0.0, 0.025], (2, 2)), ([0.6, 0.6, 0.025], (3, 3)), ([0.73, 0.73, 0.025], (3, 3))]
sys.exit(found != coders)
PYTHON
