#!/usr/bin/env bash
# A minute at 29.97 frames/s becomes 100 seconds, the last 40 of them zeros.
#
# Found: EDF stores signals in data records of equal length, each with a whole number of samples. At 25 or 30 samples/s
# pyedflib 0.1.42 takes records of 1 s. At 30000/1001, the rate of many cameras, it takes 50.05 s, at 24000/1001 also,
# at 29.97 3.7037 s, and fills the last record with zeros: 1800 samples at 30000/1001 are read back as 3000, of which the
# last 1200 are a face that nobody saw, with a mouth that is exactly closed, yaw 0. The mean of a mouth opening of .5 falls
# to .3. The rate is right, neither writer nor reader warns, and no header says where the data end. edfio 0.4.18 refuses
# such signals. Cut what is read to the number of frames, or bring the signal to 30 samples/s or a multiple before.
# Packages: pyEDFlib 0.1.42, edfio 0.4.18, numpy 2.4.6.
# Data: a signal of 1800 samples about .5, made here.
# Output seen:
#   30/s: record 1.0 s, 1800 samples read, 60.0 s, after the end none; mean 0.5 for 0.5; warnings 0; edfio writes 1800
#   29.97/s: record 3.7037 s, 1887 samples read, 62.96 s, after the end zeros; mean 0.477 for 0.5; warnings 0; edfio
#       refuses
#   30000/1001/s: record 50.05 s, 3000 samples read, 100.1 s, after the end zeros; mean 0.3 for 0.5; warnings 0; edfio
#       refuses
#   24000/1001/s: record 50.05 s, 2400 samples read, 100.1 s, after the end zeros; mean 0.375 for 0.5; warnings 0; edfio
#       refuses
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check pyEDFlib==0.1.42 edfio==0.4.18 numpy==2.4.6
env/bin/python - <<'PYTHON'
import sys
import warnings

import edfio
import numpy as np
import pyedflib

x = 0.5 + 0.3 * np.tile([-1.0, 1.0], 900)
HEADER = {
    "label": "mouth", "dimension": "eyes", "physical_min": 0.0, "physical_max": 1.0,
    "digital_min": -32768, "digital_max": 32767, "transducer": "", "prefilter": "",
}
seen = []
for name, rate in (("30", 30), ("29.97", 29.97), ("30000/1001", 30000 / 1001), ("24000/1001", 24000 / 1001)):
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with pyedflib.EdfWriter("face.edf", 1, file_type=pyedflib.FILETYPE_EDFPLUS) as writer:
            writer.setSignalHeaders([{**HEADER, "sample_frequency": rate}])
            writer.writeSamples([x])
        with pyedflib.EdfReader("face.edf") as reader:
            y, record, lasts = reader.readSignal(0), reader.datarecord_duration, reader.getFileDuration()
    after = "none" if y.size == x.size else "zeros" if np.abs(y[x.size :]).max() < 1e-4 else "others"
    try:
        edfio.Edf([edfio.EdfSignal(x, sampling_frequency=rate)]).write("other.edf")
        other = f"writes {edfio.read_edf('other.edf').signals[0].data.size}"
    except ValueError:
        other = "refuses"
    mean = round(float(y.mean()), 3)
    seen.append((y.size, after, mean, len(warned), other))
    print(f"{name}/s: record {round(record, 4)} s, {y.size} samples read, {round(lasts, 2)} s, after the end {after};", end=" ")
    print(f"mean {mean} for {round(float(x.mean()), 3)}; warnings {len(warned)}; edfio {other}")
sys.exit(
    seen
    != [
        (1800, "none", 0.5, 0, "writes 1800"),
        (1887, "zeros", 0.477, 0, "refuses"),
        (3000, "zeros", 0.3, 0, "refuses"),
        (2400, "zeros", 0.375, 0, "refuses"),
    ]
)
PYTHON
