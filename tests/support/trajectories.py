"""Trajectories of all kinds for property tests, and files of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import Trajectory, build
from facetrack_cli.trajectory.writers import WRITERS, Format, RunSummary
from tests.support.sinks import Alone

UNKNOWN = st.just(math.nan)
PIXELS = UNKNOWN | st.floats(-1e6, 1e6)
LENGTHS = UNKNOWN | st.floats(0, 1e6)
SHARES = UNKNOWN | st.floats(0, 1)
VALUES: Mapping[str, st.SearchStrategy[Any]] = {
    **dict.fromkeys(("x", "y", "angle", "confidence", "ess", "cov_xy"), PIXELS),
    **dict.fromkeys(("w", "h", "std_x", "std_y", "std_w", "std_h"), LENGTHS),
    "status": st.sampled_from(["init", "tracked", "lost", "absent", "visible", ""]),
    "by_hand": st.booleans(),
}
NAMES = st.text(st.characters(blacklist_categories=["Cs", "Cc"]), min_size=1).filter(lambda s: s == s.strip())


def records(shape: tuple[int, ...] | None, least: float, most: float) -> st.SearchStrategy[Any]:
    """Values of a diagnostic, each known or not; of a list all or nothing."""
    low, high = max(least, -1e6), min(most, 1e6)
    number = UNKNOWN | st.floats(low, high)
    if shape is None:
        return st.none() | st.dictionaries(NAMES, number, max_size=3)
    if shape:
        return st.none() | st.tuples(*[st.floats(low, high)] * shape[0]) | st.just((math.nan,) * shape[0])
    return st.none() | number


@st.composite
def trajectories(draw: st.DrawFn, declared: tuple[Diagnostic, ...] = tuple(KNOWN.values())) -> Trajectory:
    """A trajectory whose names stand in the order in which a file of it has them."""
    pairs = draw(st.lists(st.tuples(NAMES, NAMES), min_size=1, max_size=4, unique=True))
    names: dict[tuple[str, str], int] = {}
    rows: dict[str, list[Any]] = {name: [] for name in ("which", "frame", "time_s", *VALUES)}
    shared: dict[str, list[Any]] = {name: [] for name in ("particles", "identity", "identity_prob")}
    reported: dict[str, dict[int, Mapping[str, Any]]] = {}
    for frame in sorted(draw(st.lists(st.integers(0, 10**9), min_size=1, max_size=4, unique=True))):
        time_s = draw(PIXELS)
        of_target: dict[str, tuple[Any, ...]] = {}
        for pair in draw(st.lists(st.sampled_from(pairs), min_size=1, unique=True)):
            target = pair[0]
            if target not in of_target:
                who = draw(NAMES | st.just(""))
                of_target[target] = draw(UNKNOWN | st.integers(0, 10**6)), who, draw(SHARES)
                if draw(st.booleans()):
                    values = {one.name: draw(records(one.shape, one.least, one.most)) for one in declared}
                    reported.setdefault(target, {})[frame] = values
            rows["which"].append(names.setdefault(pair, len(names)))
            rows["frame"].append(frame)
            rows["time_s"].append(time_s)
            for name, strategy in VALUES.items():
                rows[name].append(draw(strategy))
            for column, value in zip(shared.values(), of_target[target], strict=True):
                column.append(value)
    diagnostics = {
        target: Diagnostics.of(declared, list(found), list(found.values())) for target, found in reported.items()
    }
    return build(tuple(names), rows.pop("which"), rows.pop("frame"), **rows, **shared, diagnostics=diagnostics)


def write(
    path: Path, rows: Trajectory, header: Mapping[str, Any] | None = None, footer: RunSummary | None = None
) -> Path:
    """A file of these rows, in the format that its name ends with."""
    form: Format = path.suffix[1:]  # type: ignore[assignment]
    writer = WRITERS[form](Alone(path), header or {})
    writer.write(rows)
    writer.close(footer or RunSummary())
    return path


def known(found: Diagnostics) -> dict[int, dict[str, Any]]:
    """What is known in each frame in which anything is."""
    frames = {}
    for frame, record in zip(found.frame.tolist(), found.records(), strict=True):
        values = {}
        for name, value in record.items():
            if isinstance(value, dict):
                value = {key: number for key, number in value.items() if not math.isnan(number)}
            if value != {} and not np.isnan(value if not isinstance(value, dict) else 0.0).any():
                values[name] = value
        if values:
            frames[frame] = values
    return frames
