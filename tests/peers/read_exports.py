"""What other tools read in exported files, as JSON: `PYTHON read_exports.py FOLDER`

Run by the Python that has them (requirements.txt); imports nothing of ours. The folder holds track.mot.txt,
track.otb.txt, track.got10k.txt, track.vot.txt, track.coco.json, track.dlc.csv, two.dlc.csv, track.openface.csv and
track.eaf.
"""

import contextlib
import json
import math
import os
import sys
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

import exploface  # noqa: E402
import motmetrics  # noqa: E402
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
import pympi  # noqa: E402
from pycocotools.coco import COCO  # noqa: E402
from vot.region import Special  # noqa: E402
from vot.region.io import read_trajectory  # noqa: E402


def mot(path):
    """frame, id (both from 1), left, top (from 0, as motmetrics has it), width, height, confidence."""
    return motmetrics.io.loadtxt(str(path), fmt="mot15-2D").reset_index().iloc[:, :7].to_numpy().tolist()


def boxes(path):
    """As got10k's ExperimentOTB.report and ExperimentGOT10k.report read results."""
    return np.loadtxt(path, delimiter=",").tolist()


def vot(path):
    regions = read_trajectory(str(path))
    return [one.code if isinstance(one, Special) else [one.x, one.y, one.width, one.height] for one in regions]


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


def dlc(path, header):
    """As DeepLabCut reads its own CSV."""
    table = pd.read_csv(path, header=header, index_col=0)
    return {
        "names": list(table.columns.names),
        "columns": [list(column) for column in table.columns],
        "index": table.index.tolist(),
        "kinds": sorted({str(kind) for kind in table.dtypes}),
        "values": table.to_numpy().tolist(),
    }


def openface(path):
    found = exploface.get_feature_time_series(str(path))
    return {"info": exploface.get_info(str(path)), "rows": found.dropna(axis=1, how="all").to_dict(orient="list")}


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


def plain(value):
    """Without NaN, which JSON has no word for: null."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def main():
    folder = Path(sys.argv[1])
    found = {
        "mot": mot(folder / "track.mot.txt"),
        "otb": boxes(folder / "track.otb.txt"),
        "got10k": boxes(folder / "track.got10k.txt"),
        "vot": vot(folder / "track.vot.txt"),
        "coco": coco(folder / "track.coco.json"),
        "dlc": dlc(folder / "track.dlc.csv", [0, 1, 2]),
        "dlc_of_two": dlc(folder / "two.dlc.csv", [0, 1, 2, 3]),
        "openface": openface(folder / "track.openface.csv"),
        "eaf": eaf(folder / "track.eaf"),
    }
    sys.stdout.write(json.dumps(plain(found)))


if __name__ == "__main__":
    main()
