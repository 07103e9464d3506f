"""What TrackEval and motmetrics say of identities, as JSON: `PYTHON people.py < clips.json`

Run by the Python that has those packages (requirements.txt); imports nothing of ours. Standard input is a list of
clips, each a list of frames with the numbers of `people` and `targets`, and the matrix `similar` of their similarities.
"""

import contextlib
import json
import sys
from importlib.metadata import version

with contextlib.redirect_stdout(sys.stderr):  # on import, TrackEval prints which data sets it cannot read
    import motmetrics
    import numpy as np
    from trackeval.metrics import CLEAR, HOTA, Identity


def trackeval_of(frames):
    people, targets = ([np.array(one[key], int) for one in frames] for key in ("people", "targets"))
    shapes = [(len(p), len(t)) for p, t in zip(people, targets, strict=True)]
    counts = [1 + max(int(each.max()) for each in one if each.size) for one in (people, targets)]
    data = {
        "gt_ids": people, "tracker_ids": targets, "num_gt_ids": counts[0], "num_tracker_ids": counts[1],
        "num_gt_dets": sum(map(len, people)), "num_tracker_dets": sum(map(len, targets)),
        "similarity_scores": [np.array(f["similar"], float).reshape(s) for f, s in zip(frames, shapes, strict=True)],
        "num_timesteps": len(frames),
    }  # fmt: skip
    hota, identity, clear = (metric.eval_sequence(data) for metric in (HOTA(), Identity(), CLEAR()))
    return {
        **{key.lower(): float(np.mean(hota[key])) for key in ("HOTA", "DetA", "AssA")},
        "idf1": float(identity["IDF1"]), "idr": float(identity["IDR"]), "idp": float(identity["IDP"]),
        "recall": float(clear["CLR_Re"]), "precision": float(clear["CLR_Pr"]),
        "switches": int(clear["IDSW"]), "fragments": int(clear["Frag"]),
    }  # fmt: skip


def motmetrics_of(frames):
    seen = motmetrics.MOTAccumulator(auto_id=True)
    for one in frames:
        far = 1 - np.array(one["similar"], float).reshape(len(one["people"]), len(one["targets"]))
        seen.update(one["people"], one["targets"], np.where(far > 0.5, np.nan, far))
    found = motmetrics.metrics.create().compute(seen, metrics=["idf1", "idr", "idp"])
    return {name: float(found[name].iloc[0]) for name in found}


def main():
    with contextlib.redirect_stdout(sys.stderr):
        clips = json.load(sys.stdin)
        measures = [{"trackeval": trackeval_of(clip), "motmetrics": motmetrics_of(clip)} for clip in clips]
    packages = {name: version(name) for name in ("trackeval", "motmetrics")}
    json.dump({"packages": packages, "measures": measures}, sys.stdout)


if __name__ == "__main__":
    main()
