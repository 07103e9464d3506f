"""A trajectory as data frames of pandas, and as a dataset of xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError, needed
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


def data_frame(table: Trajectory, what: Literal["rows", "measures", "events"], *, measures: bool) -> DataFrame:
    """As `Trajectory.to_pandas` says."""
    if what not in ("rows", "measures", "events"):
        raise UsageError(f"{what!r} is no table; give rows, measures or events")
    with needed("data frames", "pandas", "pandas"):
        import pandas

    measured = table.measures if measures or what == "measures" else {}
    each = [(target, name, one) for target, found in measured.items() for name, one in found.items()]
    if what == "rows":
        columns = dict(table.columns())
        frame, of = columns["frame"], np.asarray(columns["target"])
        for target, name, one in each:
            column = columns.setdefault(name, np.full(len(table), np.nan))
            at = np.minimum(np.searchsorted(one.frame, frame), len(one.frame) - 1)
            here = (of == target) & (one.frame[at] == frame)
            column[here] = one.value[at[here]]
        return pandas.DataFrame(columns)
    if what == "events":
        from facetrack_cli.trajectory.analysis.face_events import FaceEvent

        return pandas.DataFrame(table.events, columns=FaceEvent._fields)
    names = ("frame", "time_s", "value", "std", "noise")
    frames = [
        pandas.DataFrame({"target": target, "measure": name, "unit": one.unit, **{k: getattr(one, k) for k in names}})
        for target, name, one in each
    ]
    if not frames:
        return pandas.DataFrame(columns=["target", "measure", *names])
    return pandas.concat(frames, ignore_index=True)


def dataset(table: Trajectory) -> Dataset:
    """As `Trajectory.to_xarray` says."""
    with needed("datasets", "xarray", "xarray"):
        import xarray

    known = np.isfinite(table.times)
    if not known.any():
        raise InputError("no row has a time_s, and a dataset needs times; fill that column")
    frames = np.arange(table.frames[0], table.frames[-1] + 1)
    parts, targets = list(dict.fromkeys(part for _, part in table.names)), list(table.targets)
    position = np.full((len(frames), 2, len(parts), len(targets)), np.nan)
    confidence = np.full((len(frames), len(parts), len(targets)), np.nan)
    for one in table.parts:
        at, k, n = one.frame - frames[0], parts.index(one.part), targets.index(one.target)
        position[at, 0, k, n], position[at, 1, k, n], confidence[at, k, n] = one.x, one.y, one.confidence
    places: dict[str, Any] = {
        "time": np.interp(frames, table.frames[known], table.times[known]),
        "space": ["x", "y"],
        "keypoints": parts,
        "individuals": [one or "target" for one in targets],
        "frame": ("time", frames),
    }
    values = {
        "position": (("time", "space", "keypoints", "individuals"), position),
        "confidence": (("time", "keypoints", "individuals"), confidence),
    }
    source = table.header.get("source")
    about: dict[str, Any] = {"source_software": "facetrack", "ds_type": "poses", "time_unit": "seconds"}
    if isinstance(source, dict) and "fps" in source:
        about["fps"] = source["fps"]
    elif len(frames) > 1:
        about["fps"] = round(1 / float(np.median(np.diff(places["time"]))), 6)
    return xarray.Dataset(values, places, about)
