"""An evaluation as JSON and as CSV, for programs."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.evaluation.boxes import BoxMeasures
from facetrack_cli.evaluation.points import RecoveryMeasures
from facetrack_cli.evaluation.summary import GROUPS, Evaluation, Measured, Value, figures, measured_groups, names

SCHEMA: Final = "facetrack-evaluation"
VERSION: Final = 1
CURVES: Final = ("success", "precision", "normalised_precision")


@dataclass(frozen=True)
class About:
    """What was compared: the files, how the truth was read, and by how many frames it was shifted.

    `results_read_as` says how a trajectory that is not facetrack's own was read.
    """

    trajectory: Path
    truth: Path
    read_as: str
    shift: int = 0
    results_read_as: str | None = None


def to_dict(evaluation: Evaluation, about: About) -> dict[str, Any]:
    """JSON-ready: what is not defined is None. Figures stand below their first words, as `all.points.mean_px`."""
    options = evaluation.options
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "facetrack": __version__,
        "trajectory": str(about.trajectory),
        **({"trajectory_read_as": about.results_read_as} if about.results_read_as else {}),
        "truth": {"path": str(about.truth), "read_as": about.read_as, "shift": about.shift},
        "options": {"normalise": options.normalise, "failure": options.failure},
        "frames": {"count": evaluation.frames, "first": evaluation.first, "last": evaluation.last},
        "rows": {"visible": evaluation.visible, "hidden": evaluation.hidden, "absent": evaluation.absent},
        "units": dict(evaluation.units),
        "all": _measured(evaluation.all, evaluation.recovery),
        "parts": [{"target": one.target, "part": one.part, **_measured(one)} for one in evaluation.parts],
        "occlusions": [_plain(one) for one in evaluation.occlusions],
        "notes": list(evaluation.notes),
    }


def to_json(evaluation: Evaluation, about: About) -> str:
    return json.dumps(to_dict(evaluation, about), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def to_csv(evaluation: Evaluation, about: About) -> str:
    """A header and a row a part, then one of all parts together, whose target is "all".

    The columns are the same whatever was measured: trajectory, truth, target, part, and all `names`.
    """
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n")
    write.writerow(["trajectory", "truth", "target", "part", *names()])
    for one in (*evaluation.parts, evaluation.all):
        found = figures(one, evaluation.recovery if one is evaluation.all else None)
        values = ["" if value is None else repr(value) for value in found.values()]
        write.writerow([about.trajectory, about.truth, one.target, one.part, *values])
    return out.getvalue()


def _measured(one: Measured, recovery: RecoveryMeasures | None = None) -> dict[str, Any]:
    """What was measured, by the first words of the figures' names; what was not is left out."""
    found = figures(one, recovery)
    there = measured_groups(one, recovery)
    out: dict[str, Any] = {
        group: {name: found[f"{group}.{name}"] for name in those} for group, those in GROUPS.items() if there[group]
    }
    if one.boxes is not None:
        out["boxes"]["curves"] = _curves(one.boxes)
    if one.trust.confidence is not None:
        out["confidence"]["bins"] = _plain(one.trust.confidence.bins)
    return out


def _curves(boxes: BoxMeasures) -> Mapping[str, list[Value]]:
    return {name: [_number(v) for v in getattr(boxes, name).tolist()] for name in CURVES}


def _plain(value: Any) -> Any:
    """Dataclasses as objects, tuples and arrays as lists, nan as None."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return [_plain(one) for one in value.tolist()]
    if isinstance(value, (tuple, list)):
        return [_plain(one) for one in value]
    return _number(value) if isinstance(value, float) else value


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
