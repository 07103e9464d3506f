#!/usr/bin/env bash
# Ten seconds of a face at 10 Hz last three, since the 10 were rows, and at 1 Hz nothing was done.
#
# Found: py-feat 2.1.5 keeps what a face does as a table of rows and a rate (Fex). downsample(target) takes, by its
# documentation, the "target sampling frequency in Hz". It averages so many rows instead: of 30 frames/s 10 make 3 rows/s, 15
# make 2, 5 make 6 and 1 leaves all 30. The table then says that its rate is the target, so that 10 s are 3, 0.7, 12 or 300 s
# long to what follows, and every frequency, filter and speed is wrong by as much. The function beneath (feat.utils.stats) says
# "samples" and has "hz" as an option, which downsample(10, target_type="hz") reaches, and which is right. upsample takes hertz,
# but with samples or seconds it writes those as the rate. Nothing is said. Always give target_type="hz".
# Packages: py-feat 2.1.5 without what finds faces, pandas 2.3.3, numpy 2.4.6, scipy 1.17.1, scikit-learn 1.9.1.
# Data: a made-up course of AU12 for 10 s at 30 frames/s, made here.
# Output seen:
#   downsample(15): 20 rows, rate 15, so 1.33 s
#   downsample(10): 30 rows, rate 10, so 3.0 s
#   downsample(5): 60 rows, rate 5, so 12.0 s
#   downsample(1): 300 rows, rate 1, so 300.0 s
#   downsample(10, target_type="hz"): 100 rows, rate 10, so 10.0 s
#   upsample(60): 600 rows, rate 60, so 10.0 s
#   upsample(600, target_type="samples"): 600 rows, rate 600, so 1.0 s
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

course = Fex(pd.DataFrame({"AU12": np.sin(np.arange(300) / 30)}), au_columns=["AU12"], sampling_freq=30)
seen = []
for name, *arguments in (
    ("downsample", 15), ("downsample", 10), ("downsample", 5), ("downsample", 1), ("downsample", 10, "hz"), ("upsample", 60),
    ("upsample", 600, "samples"),
):
    options = {"target_type": arguments[1]} if arguments[1:] else {}
    made = getattr(course, name)(arguments[0], **options)
    seen.append((len(made), made.sampling_freq, round(len(made) / made.sampling_freq, 2)))
    kind = f', target_type="{arguments[1]}"' if options else ""
    print(f"{name}({arguments[0]}{kind}): {seen[-1][0]} rows, rate {seen[-1][1]}, so {seen[-1][2]} s")
expected = [(20, 15, 1.33), (30, 10, 3), (60, 5, 12), (300, 1, 300), (100, 10, 10), (600, 60, 10), (600, 600, 1)]
sys.exit(seen != expected)
PYTHON
