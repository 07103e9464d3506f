"""What other tools read in exported files, as JSON: `PYTHON read_exports.py FOLDER`

Run by the Python that has them (requirements.txt); imports nothing of ours. The folder holds track, truth and same
.mot.txt, track.otb.txt, track and dropped .got10k.txt, track.vot.txt, track.coco.json, track and two .dlc.csv and
.dlc.h5, track.wide.csv, track.openface.csv, track.eaf, quoted.eaf, session.eaf, to which tiers were added, and
face.TextGrid.
"""

import contextlib
import json
import os
import shutil
import sys
import tempfile
import typing
import warnings
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

# attributee 0.1.10, which vot-toolkit needs, uses typing.dataclass_transform without calling it, and so cannot be
# imported from Python 3.11 on; without the name it falls back to a decorator of its own
_transform = typing.__dict__.pop("dataclass_transform", None)
import attributee  # noqa: E402, F401

if _transform is not None:
    typing.dataclass_transform = _transform

with contextlib.redirect_stdout(sys.stderr):  # some greet on import
    import exploface
    import kineticstoolkit
    import motmetrics
    import trackeval
    from corflow import fromElan, toElan
    from elan_data import ELAN_Data
    from got10k.utils.metrics import rect_iou
    from speach import elan
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
import pympi  # noqa: E402
from pycocotools.coco import COCO  # noqa: E402
from vot.region import Special  # noqa: E402
from vot.region.io import read_trajectory  # noqa: E402


def track_eval(truth, result):
    """TrackEval's figures of a result against ground truth, both files of MOTChallenge."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        for file, place in ((truth, "gt/MOT17-train/clip/gt/gt.txt"), (result, "tr/MOT17-train/ours/data/clip.txt")):
            (target := Path(folder, place)).parent.mkdir(parents=True)
            shutil.copy(file, target)
        length = max(int(line.split(",")[0]) for line in truth.read_text().splitlines())
        Path(folder, "gt/MOT17-train/clip/seqinfo.ini").write_text(f"[Sequence]\nname=clip\nseqLength={length}\n")
        Path(folder, "gt/seqmaps").mkdir()
        Path(folder, "gt/seqmaps/MOT17-train.txt").write_text("name\nclip\n")
        data = {"GT_FOLDER": f"{folder}/gt", "TRACKERS_FOLDER": f"{folder}/tr", "BENCHMARK": "MOT17"}
        dataset = trackeval.datasets.MotChallenge2DBox({**data, "SPLIT_TO_EVAL": "train", "PRINT_CONFIG": False})
        quiet = ("PRINT_RESULTS", "PRINT_CONFIG", "OUTPUT_SUMMARY", "OUTPUT_DETAILED", "PLOT_CURVES", "TIME_PROGRESS")
        evaluator = trackeval.Evaluator({**dict.fromkeys(quiet, False), "LOG_ON_ERROR": None})
        metrics = [trackeval.metrics.HOTA(), trackeval.metrics.Identity({"PRINT_CONFIG": False})]
        found = evaluator.evaluate([dataset], metrics)[0]["MotChallenge2DBox"]["ours"]["clip"]["pedestrian"]
    numbers = {name: int(found["Count"][name]) for name in ("Dets", "GT_Dets", "GT_IDs")}
    return {**numbers, "IDF1": float(found["Identity"]["IDF1"]), "HOTA": float(found["HOTA"]["HOTA"].mean())}


def coco(path):
    with contextlib.redirect_stdout(None):
        truth = COCO(str(path))
        results = truth.loadRes([dict(one) for one in truth.dataset["annotations"]])
    return {
        "images": truth.loadImgs(truth.getImgIds()),
        "categories": truth.loadCats(truth.getCatIds()),
        "annotations": truth.loadAnns(truth.getAnnIds()),
        "of_first_category": truth.getAnnIds(catIds=[1]),
        "results": len(results.getAnnIds()),
        "mask_pixels": int(truth.annToMask(results.loadAnns([1])[0]).sum()),
    }


def dlc(table):
    """A table of DeepLabCut."""
    return {
        "names": list(table.columns.names),
        "columns": [list(column) for column in table.columns],
        "index": table.index.tolist(),
        "kinds": sorted({str(kind) for kind in table.dtypes}),
        "values": table.to_numpy().tolist(),
    }


def other_eaf(path):
    """The file as corflow, speach and elan-data read it; in how many of the files that they write links are left."""
    found = fromElan.fromElan(str(path))
    toElan.toElan(str(path.with_name("corflow.eaf")), found)
    spoken = elan.read_eaf(str(path))
    spoken.save(str(path.with_name("speach.eaf")))
    data = ELAN_Data.from_file(str(path))
    data.init_dataframe()
    rows = data.tier_data
    return {
        "corflow": {tier.name: [tier.start, tier.end, len(tier)] for tier in found},
        "speach": {
            tier.name: [[one.from_ts.sec, one.to_ts.sec, one.value, one.cve_ref] for one in tier] for tier in spoken
        },
        "elan_data": {
            name: [[row.START, row.STOP, row.TEXT] for row in rows[name == rows.TIER_ID].itertuples()]
            for name in data.tier_names
        },
        "links": {
            name: path.with_name(f"{name}.eaf").read_text(encoding="utf-8").count("CVE_REF")
            for name in (path.stem, "corflow", "speach")
        },
    }


def eaf(path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an unknown version of the format
        found = pympi.Eaf(str(path))
    again = path.with_name("again.eaf")
    found.to_file(str(again))
    kept = pympi.Eaf(str(again))
    return {
        "tiers": {name: found.get_annotation_data_for_tier(name) for name in found.get_tier_names()},
        "parameters": {name: dict(found.get_parameters_for_tier(name)) for name in found.get_tier_names()},
        "media": [dict(one) for one in found.get_linked_files()],
        "properties": dict(found.properties),
        "types": {name: dict(found.linguistic_types[name]) for name in found.get_linguistic_type_names()},
        "vocabularies": {
            name: [value[0][0] for value, _ in entries.values()]
            for name, (_, entries, _) in found.controlled_vocabularies.items()
        },
        "kept_when_written_again": sorted(
            [tier, *row] for tier in kept.get_tier_names() for row in kept.get_annotation_data_for_tier(tier)
        ),
    }


def main():
    folder = Path(sys.argv[1])
    otb, got10k, dropped = (
        np.loadtxt(folder / name, delimiter=",") for name in ("track.otb.txt", "track.got10k.txt", "dropped.got10k.txt")
    )
    results, truth = folder / "track.mot.txt", folder / "truth.mot.txt"
    series = pd.read_csv(folder / "track.wide.csv").set_index("time_s")[["frame"]]
    series = kineticstoolkit.TimeSeries.from_dataframe(series)
    openface = str(folder / "track.openface.csv")
    landmarks = exploface.get_feature_time_series(openface).dropna(axis=1, how="all")
    tiers = pympi.Praat.TextGrid(str(folder / "face.TextGrid")).get_tiers()
    found = {
        # frame, id (both from 1), left, top (from 0, as motmetrics has it), width, height, confidence
        "mot": motmetrics.io.loadtxt(str(results), fmt="mot15-2D").reset_index().iloc[:, :7].to_numpy().tolist(),
        # the same with flag, class, visibility
        "mot_truth": motmetrics.io.loadtxt(str(truth), fmt="mot16", min_confidence=1).reset_index().to_numpy().tolist(),
        "track_eval": track_eval(truth, folder / "same.mot.txt"),
        "average_overlap": float(np.mean(rect_iou(dropped[1:], got10k[1:]))),  # of the rows after the first
        "otb": otb.tolist(),
        "got10k": got10k.tolist(),
        "vot": [
            one.code if isinstance(one, Special) else [one.x, one.y, one.width, one.height]
            for one in read_trajectory(str(folder / "track.vot.txt"))
        ],
        "coco": coco(folder / "track.coco.json"),
        # as DeepLabCut reads its own files
        "dlc": dlc(pd.read_csv(folder / "track.dlc.csv", header=[0, 1, 2], index_col=0)),
        "dlc_of_two": dlc(pd.read_csv(folder / "two.dlc.csv", header=[0, 1, 2, 3], index_col=0)),
        "dlc_h5": dlc(pd.read_hdf(folder / "track.dlc.h5", key="df_with_missing")),
        "dlc_h5_of_two": dlc(pd.read_hdf(folder / "two.dlc.h5", key="df_with_missing")),
        "wide": {"rate": float(series.get_sample_rate()), "times": series.time.tolist()},  # nan: it is not constant
        "openface": {"info": exploface.get_info(openface), "rows": landmarks.to_dict(orient="list")},
        "eaf": eaf(folder / "track.eaf"),
        "other_eaf": other_eaf(folder / "quoted.eaf"),
        "session": eaf(folder / "session.eaf"),
        "textgrid": {tier.name: tier.get_all_intervals() for tier in tiers},  # also those without text
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
