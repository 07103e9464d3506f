"""A trajectory as data frames of pandas, as a dataset of xarray, and as notebooks show it."""

from __future__ import annotations

from collections import Counter
from html import escape
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError, needed
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, header_value

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

WIDE, HIGH, BINS = 160, 24, 80  # of a line of confidence: pixels, and means that it shows
SHOWN: Final = 20  # rows of the table


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
    about: dict[str, Any] = {"source_software": "facetrack", "ds_type": "poses", "time_unit": "seconds"}
    if (fps := header_value(table, "source", "fps")) is not None:
        about["fps"] = fps
    elif len(frames) > 1:
        about["fps"] = round(1 / float(np.median(np.diff(places["time"]))), 6)
    return xarray.Dataset(values, places, about)


def html(table: Trajectory) -> str:
    """A small table: of each target its parts, frames, the share of rows that are seen, its events, and confidence."""
    events = Counter((event.target, event.value) for event in table.events)
    lines = []
    for target in table.targets[:SHOWN]:
        parts = table.of_target(target)
        seen = float(np.mean(np.concatenate([np.isin(one.status, SEEN) for one in parts])))
        said = ", ".join(f"{n} {value}" for (of, value), n in sorted(events.items()) if of == target)
        cells = target or "-", len(parts), len(parts[0]), f"{seen:.0%}", said, _line(parts[0].confidence)
        lines.append("<tr>" + "".join(f"<td>{one if i == 5 else escape(str(one))}</td>" for i, one in enumerate(cells)))
    if (more := len(table.targets) - SHOWN) > 0:
        lines.append(f"<tr><td>and {more} more")
    heads = "".join(f"<th>{one}" for one in ("target", "parts", "frames", "seen", "events", "confidence"))
    return f"<table><tr>{heads}{''.join(lines)}</table>"


def _line(values: Array) -> str:
    """Values from 0 to 1 over time as a picture."""
    known = np.nan_to_num(values)
    if not len(known):
        return ""
    means = [float(one.mean()) for one in np.array_split(known, min(BINS, len(known)))]
    x = np.linspace(0, WIDE, len(means)) if len(means) > 1 else [WIDE / 2]
    points = " ".join(f"{a:.1f},{HIGH - 1 - v * (HIGH - 2):.1f}" for a, v in zip(x, means, strict=True))
    line = f'<polyline points="{points}" fill="none" stroke="currentColor"/>'
    return f'<svg width="{WIDE}" height="{HIGH}" role="img" aria-label="confidence over time">{line}</svg>'
