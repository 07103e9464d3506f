"""What got10k computes for folders of boxes, as JSON: `PYTHON measure.py FOLDER...`

Run by the Python that has that package (requirements.txt); imports nothing of ours. A folder holds, a line a frame:

    truth.txt, ours.txt          left,top,w,h; nan,nan,nan,nan where there is none
    size.txt                     width,height of the image

Everything runs through the toolkit's own code, but for the normalised precision, which got10k 0.1.3 on PyPI is without:
there its later definition is written down. NaN is null in the JSON, since it has no other word for it.
"""

import contextlib
import json
import math
import os
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
from got10k.experiments import ExperimentGOT10k, ExperimentOTB
from got10k.utils.metrics import center_error, rect_iou


class Dataset(tuple):
    """One sequence of got10k's datasets, without its images; asked for in turn, or by its name."""

    seq_names = ("boxes",)
    return_meta = True

    def __getitem__(self, name):
        return next(iter(self))


def experiment(kind, folder, sequence):
    """An experiment of got10k on one sequence; its constructors would download or check a data set."""
    made = kind.__new__(kind)
    made.dataset = Dataset([sequence])
    made.result_dir, made.report_dir = str(folder), str(folder / "report")
    made.subset, made.nbins_iou, made.nbins_ce = "val", 21 if kind is ExperimentOTB else 101, 51
    made.plot_curves = lambda *_: None
    return made


def report(made):
    with contextlib.redirect_stdout(None):
        return made.report(["ours"])["ours"]["overall"]


def otb(ours, truth):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "ours").mkdir()
        np.savetxt(folder / "ours/boxes.txt", ours, fmt="%.17g", delimiter=",")
        found = report(experiment(ExperimentOTB, folder, (None, truth)))
    keys = ("success_curve", "precision_curve", "success_score", "precision_score", "success_rate")
    return {key: found[key] for key in keys}


def got10k_val(ours, truth, size):
    """Rows without ground truth are `cover` 0, as in GOT-10k's own files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "ours/boxes").mkdir(parents=True)
        np.savetxt(folder / "ours/boxes/boxes_001.txt", ours, fmt="%.17g", delimiter=",")
        # without the times of one run, report() stops with a NameError
        np.savetxt(folder / "ours/boxes/boxes_time.txt", np.full((len(ours), 1), 0.1), delimiter=",")
        meta = {"resolution": str(size), "cover": np.where(np.isnan(truth).any(axis=1), 0, 8)}
        found = report(experiment(ExperimentGOT10k, folder, (None, truth, meta)))
    # 0.1.3 has no SR at 0.75: it is the value of its curve there
    return {key: found[key] for key in ("ao", "sr", "succ_curve")} | {"sr75": found["succ_curve"][75]}


def normalised_precision(ours, truth):
    """`normalized_center_error` and its curve as in got10k's sources after 0.1.3 (ExperimentLaSOT): the definition."""
    centres = [boxes[:, :2] + (boxes[:, 2:] - 1) / 2 for boxes in (ours, truth)]
    offsets = (centres[0] - centres[1]) / np.maximum(np.array([[1.0, 1.0]]), truth[:, 2:])
    errors = np.sqrt(np.sum(np.power(offsets, 2), axis=-1))
    curve = np.mean(np.less_equal(errors[:, None], np.linspace(0, 0.5, 51)[None, :]), axis=0)
    return {"curve": curve.tolist(), "score": float(np.mean(curve))}


def measure(folder):
    size = tuple(np.loadtxt(folder / "size.txt", delimiter=",", dtype=int).tolist())
    ours, truth = (np.loadtxt(folder / f"{name}.txt", delimiter=",", ndmin=2) for name in ("ours", "truth"))
    known = ~np.isnan(truth).any(axis=1)
    given = np.concatenate([truth[:1], ours[1:]])
    empty = np.where(np.isnan(ours), 0.0, ours)
    return {
        "iou": rect_iou(ours, truth).tolist(),
        "iou_clipped": rect_iou(ours.copy(), truth.copy(), bound=size).tolist(),
        "centre_error": center_error(ours, truth).tolist(),
        "otb": otb(ours[known], truth[known]),
        # rows without ground truth count as failures, if they are left in
        "otb_success_of_all": otb(ours, truth)["success_score"],
        "normalised": normalised_precision(given[known], truth[known]),
        "got10k": got10k_val(empty, truth, size),
        # AO is nan as soon as one box is, so that above they are 0,0,0,0
        "got10k_ao_with_nan": got10k_val(ours, truth, size)["ao"],
    }


def plain(value):
    """NaN as None, all the way down."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def main():
    found = {Path(name).name: measure(Path(name)) for name in sys.argv[1:]}
    packages = {name: version(name) for name in ("got10k",)}
    json.dump(plain({"packages": packages, "measures": found}), sys.stdout)


if __name__ == "__main__":
    main()
