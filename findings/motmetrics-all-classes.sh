#!/usr/bin/env bash
# The same two files, IDF1 1.0 in one toolkit and 0.67 in the other.
#
# Found: the eighth column of MOTChallenge's ground truth (since MOT16) is a class. TrackEval 1.3.0 counts class 1 alone,
# and takes what a tracker puts on the distractors 2, 7, 8 and 12 for neither right nor wrong. motmetrics 1.4.0 reads the
# column (ClassId) and does not use it: loadtxt(..., fmt="mot16", min_confidence=1), which its documentation names for
# ground truth, goes by the seventh column, the flag, and compare_to_groundtruth counts every class as people. A tracker
# that is exactly right on the people of a file that has hands as class 2, flag 1, has IDF1 1 and no misses in TrackEval,
# and IDF1 .667 and as many misses as there are hands in motmetrics.
# Packages: trackeval 1.3.0 with numpy 2.4.6; motmetrics 1.4.0 with numpy 1.26.4 (its distances need one before 2),
# pandas 2.2.3 and scipy 1.15.3.
# Data: twenty frames of one made-up face and one made-up hand, written here.
# Output seen:
#   trackeval: IDF1 1.0, boxes of ground truth 20
#   motmetrics: IDF1 0.6667, boxes of ground truth 40, misses 20
#   motmetrics, rows of class 1 alone: IDF1 1.0, boxes of ground truth 20, misses 0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv one
one/bin/pip install --quiet --disable-pip-version-check trackeval==1.3.0 numpy==2.4.6
python3 -m venv other
other/bin/pip install --quiet --disable-pip-version-check motmetrics==1.4.0 numpy==1.26.4 pandas==2.2.3 scipy==1.15.3
mkdir -p gt/MOT17-train/clip/gt gt/seqmaps tr/MOT17-train/ours/data
truth=gt/MOT17-train/clip/gt/gt.txt result=tr/MOT17-train/ours/data/clip.txt
printf '[Sequence]\nname=clip\nseqLength=20\n' > gt/MOT17-train/clip/seqinfo.ini
printf 'name\nclip\n' > gt/seqmaps/MOT17-train.txt
for n in {1..20}; do
    echo "$n,1,$((100 + n)),50,40,50,1,1,1" >> "$truth"  # a face
    echo "$n,2,$((60 + n)),150,30,30,1,2,1" >> "$truth"  # a hand
    echo "$n,1,$((100 + n)),50,40,50,1,-1,-1,-1" >> "$result"
done
one/bin/python - <<'PYTHON'
import contextlib
import io
import sys

import trackeval

quiet = ("PRINT_RESULTS", "PRINT_CONFIG", "OUTPUT_SUMMARY", "OUTPUT_DETAILED", "PLOT_CURVES", "TIME_PROGRESS")
with contextlib.redirect_stdout(io.StringIO()):
    places = {"GT_FOLDER": "gt", "TRACKERS_FOLDER": "tr", "BENCHMARK": "MOT17", "SPLIT_TO_EVAL": "train"}
    dataset = trackeval.datasets.MotChallenge2DBox({**places, "PRINT_CONFIG": False})
    evaluator = trackeval.Evaluator({**dict.fromkeys(quiet, False), "LOG_ON_ERROR": None})
    found = evaluator.evaluate([dataset], [trackeval.metrics.Identity({"PRINT_CONFIG": False})])[0]
one = found["MotChallenge2DBox"]["ours"]["clip"]["pedestrian"]
idf1, boxes = float(one["Identity"]["IDF1"]), int(one["Count"]["GT_Dets"])
print(f"trackeval: IDF1 {idf1}, boxes of ground truth {boxes}")
sys.exit((idf1, boxes) != (1.0, 20))
PYTHON
other/bin/python - "$truth" "$result" <<'PYTHON'
import sys

import motmetrics

theirs = motmetrics.io.loadtxt(sys.argv[1], fmt="mot16", min_confidence=1)
ours = motmetrics.io.loadtxt(sys.argv[2], fmt="mot15-2D")


def measured(theirs):
    seen = motmetrics.utils.compare_to_groundtruth(theirs, ours, "iou", distth=0.5)
    found = motmetrics.metrics.create().compute(seen, metrics=["idf1", "num_objects", "num_misses"]).iloc[0]
    return round(float(found.idf1), 4), int(found.num_objects), int(found.num_misses)


all_, people = measured(theirs), measured(theirs[theirs.ClassId == 1])
for what, one in (("", all_), (", rows of class 1 alone", people)):
    print(f"motmetrics{what}: IDF1 {one[0]}, boxes of ground truth {one[1]}, misses {one[2]}")
sys.exit((all_, people) != ((0.6667, 40, 20), (1.0, 20, 0)))
PYTHON
