#!/usr/bin/env bash
# Two codings of the same frames agree by 95 %, as an event of one frame fills one frame or two.
#
# Found: sed_eval 0.2.1 compares coded events by segments, and a segment of one frame (time_resolution=1/fps) seems natural. Begin and
# end are divided by it, and rounded down and up, with no room for a last bit. At 30 frames/s 100 blinks of one frame each, from
# k/30 to (k+1)/30 s, fill 113 segments. The same blinks in whole milliseconds fill 102, and with ends that are the begin
# plus 1/30 s they fill 109. So codings of the same frames have F .949 and .946 and not 1, and error rates of .1; at 25
# frames/s, whose frames are whole milliseconds, it is still .991 for the sum. Nothing is said. Move begin and end by
# nearly half a frame into the event, which gives 100 segments and F 1.
# Packages: sed_eval 0.2.1, dcase_util 0.2.20, numpy 2.4.6, scipy 1.17.1.
# Data: 100 blinks of one frame each, made here.
# Output seen:
#   25/s, begin + 1 frame: 113 and 111 segments, F 0.991, error rate 0.018
#   25/s, milliseconds: 113 and 113 segments, F 1.0, error rate 0.0
#   25/s, milliseconds, moved inwards: 100 and 100 segments, F 1.0, error rate 0.0
#   30/s, begin + 1 frame: 113 and 109 segments, F 0.946, error rate 0.106
#   30/s, milliseconds: 113 and 102 segments, F 0.949, error rate 0.097
#   30/s, milliseconds, moved inwards: 100 and 100 segments, F 1.0, error rate 0.0
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check sed_eval==0.2.1 dcase_util==0.2.20 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import sys
import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import sed_eval
    from dcase_util.containers import MetaDataContainer


def events(times):
    keys = ("filename", "scene_label", "event_label", "event_onset", "event_offset")
    return MetaDataContainer([dict(zip(keys, ("clip", "room", "blink", *time))) for time in times])


def inner(times, rate):
    return [(start + 0.45 / rate, end - 0.45 / rate) for start, end in times]


frames = range(0, 300, 3)
seen = []
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for rate in (25, 30):
        coded = [(k / rate, (k + 1) / rate) for k in frames]
        added = [(k / rate, k / rate + 1 / rate) for k in frames]
        rounded = [(round(start, 3), round(end, 3)) for start, end in coded]
        for name, first, second in (
            ("begin + 1 frame", coded, added),
            ("milliseconds", coded, rounded),
            ("milliseconds, moved inwards", inner(coded, rate), inner(rounded, rate)),
        ):
            metrics = sed_eval.sound_event.SegmentBasedMetrics(event_label_list=["blink"], time_resolution=1 / rate)
            metrics.evaluate(events(first), events(second))
            result = metrics.results_overall_metrics()
            row = [int(metrics.overall["Nref"]), int(metrics.overall["Nsys"])]
            row += [round(float(result["f_measure"]["f_measure"]), 3), round(float(result["error_rate"]["error_rate"]), 3)]
            seen.append(row)
            print("{}/s, {}: {} and {} segments, F {}, error rate {}".format(rate, name, *row))
expected = [
    [113, 111, 0.991, 0.018],
    [113, 113, 1.0, 0.0],
    [100, 100, 1.0, 0.0],
    [113, 109, 0.946, 0.106],
    [113, 102, 0.949, 0.097],
    [100, 100, 1.0, 0.0],
]
sys.exit(seen != expected or bool(said))
PYTHON
