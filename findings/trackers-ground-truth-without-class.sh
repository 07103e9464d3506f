#!/usr/bin/env bash
# A tracker without a mistake has HOTA 0, where the ground truth has -1 for what is not used.
#
# Found: evaluate_mot_sequence of trackers 2.6.1 is "intentionally designed to match" TrackEval. It takes the eighth column of
# ground truth for a class, and leaves out all that is not class 1. MOT15, SoccerNet (one of the four benchmarks that trackers
# itself names) and annotation tools write ten columns, of which the last three are -1 or a place in the room. All of their boxes
# are left out without a word: HOTA, MOTA and IDF1 are 0 for a result that is the ground truth, whose every box is a false
# positive. TrackEval 1.3.0 gives 1 for the same two files when it is told that they are MOT15. With seven columns, or a 1 in the
# eighth, trackers gives 1 as well. Rows of frame 0 are left out, too. Write 1 into the eighth column, and count frames from 1.
# Packages: trackers 2.6.1, trackeval 1.3.0, numpy 2.4.6, opencv-python 5.0.0.93.
# Data: a face in 20 frames, and a tracker's result that is the same, written here.
# Output seen:
#   seven columns: HOTA 1, MOTA 1, IDF1 1; 20 right, 0 missed, 0 false
#   class 1: HOTA 1, MOTA 1, IDF1 1; 20 right, 0 missed, 0 false; TrackEval's HOTA 1
#   -1, -1, -1: HOTA 0, MOTA 0, IDF1 0; 0 right, 0 missed, 20 false; TrackEval's HOTA 1
#   a place: HOTA 0, MOTA 0, IDF1 0; 0 right, 0 missed, 20 false; TrackEval's HOTA 1
#   class 1 from frame 0: HOTA 1, MOTA 1, IDF1 1; 19 right, 0 missed, 0 false
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check trackers==2.6.1 trackeval==1.3.0 numpy==2.4.6 opencv-python==5.0.0.93
env/bin/python - <<'PYTHON'
import contextlib
import io
import sys
import warnings
from pathlib import Path

warnings.simplefilter("ignore")
import trackeval
from trackers.eval import evaluate_mot_sequence

TRUTH, RESULT = Path("truth/CLIP/gt/gt.txt"), Path("results/one/data/CLIP.txt")
for path in (TRUTH, RESULT):
    path.parent.mkdir(parents=True)
Path("truth/CLIP/seqinfo.ini").write_text("[Sequence]\nname=CLIP\nseqLength=20\n")


def write(path, first, last):
    rows = [(k + first, 1, 100 + 3 * k, 50, 40, 50, 1, *last) for k in range(20)]
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


def by_trackeval():
    config = {
        "GT_FOLDER": "truth",
        "TRACKERS_FOLDER": "results",
        "BENCHMARK": "MOT15",
        "SEQ_INFO": {"CLIP": None},
        "SKIP_SPLIT_FOL": True,
        "PRINT_CONFIG": False,
    }
    with contextlib.redirect_stdout(io.StringIO()):
        evaluator = trackeval.Evaluator({"OUTPUT_SUMMARY": False, "OUTPUT_DETAILED": False, "PLOT_CURVES": False})
        answers, _ = evaluator.evaluate([trackeval.datasets.MotChallenge2DBox(config)], [trackeval.metrics.HOTA({"PRINT_CONFIG": False})])
    return float(answers["MotChallenge2DBox"]["one"]["CLIP"]["pedestrian"]["HOTA"]["HOTA"].mean())


seen, others = [], []
for title, first, last in (
    ("seven columns", 1, ()),
    ("class 1", 1, (1, 1)),
    ("-1, -1, -1", 1, (-1, -1, -1)),
    ("a place", 1, (-3.2, 16.3, 0.5)),
    ("class 1 from frame 0", 0, (1, 1)),
):
    write(TRUTH, first, last)
    write(RESULT, first, (-1, -1, -1))
    found = evaluate_mot_sequence(TRUTH, RESULT, ["CLEAR", "HOTA", "Identity"])
    seen.append([found.HOTA.HOTA, found.CLEAR.MOTA, found.Identity.IDF1, found.CLEAR.CLR_TP, found.CLEAR.CLR_FN, found.CLEAR.CLR_FP])
    scores = "HOTA {:g}, MOTA {:g}, IDF1 {:g}; {} right, {} missed, {} false".format(*seen[-1])
    if first and last:  # TrackEval refuses both seven columns and frame 0
        others.append(by_trackeval())
        scores += f"; TrackEval's HOTA {others[-1]:g}"
    print(f"{title}: {scores}")
right, wrong = [1, 1, 1, 20, 0, 0], [0, 0, 0, 0, 0, 20]
sys.exit(seen != [right, right, wrong, wrong, [1, 1, 1, 19, 0, 0]] or others != [1, 1, 1])
PYTHON
