"""Results of a tracker, and rows of a trajectory, put together by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from facetrack_cli.core.types import Frame
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostics
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import FrameResult, TargetResult, build, joined


def part(name, x=None, y=None, w=None, h=None, status="tracked", confidence=None, cov=None, ess=None, angle=None,
         corners=None, by_hand=False):  # fmt: skip
    """What a tracker says of one part; `cov` is (xx, xy, yy) in pixels squared."""
    xx, xy, yy = (np.nan, np.nan, np.nan) if cov is None else cov
    return {
        "part": name, "x": x, "y": y, "w": w, "h": h, "status": status, "confidence": confidence, "ess": ess,
        "angle": angle, "corners": corners, "by_hand": by_hand, "cov_xy": xy,
        "std_x": np.sqrt(max(xx, 0.0)), "std_y": np.sqrt(max(yy, 0.0)),
    }  # fmt: skip


def target(name, parts, particles=None, cloud=None, identity=None, identity_prob=None, notes=(), reported=None):
    """What a tracker says of one target; `reported` are the values of its diagnostics. Frame and time come later."""
    parts = list(parts)
    columns = {key: [one[key] for one in parts] for key in parts[0]} if parts else {"part": []}
    names = [(name, one) for one in columns.pop("part")]
    corners = columns.pop("corners", None)
    if corners is not None and any(one is not None for one in corners):
        columns["corners"] = [np.full((4, 2), np.nan) if one is None else one for one in corners]
    k = len(parts)
    for key in columns:
        if key not in ("status", "by_hand", "corners"):
            columns[key] = np.array([np.nan if v is None else v for v in columns[key]], float)
    shared = {"particles": particles, "identity_prob": identity_prob}
    columns |= {key: np.full(k, np.nan if value is None else value, float) for key, value in shared.items()}
    rows = build(names or [(name, "")], np.arange(k), np.zeros(k), identity=[identity or ""] * k, **columns)
    if reported is not None:
        declared = tuple(KNOWN.values())
        rows = replace(rows, diagnostics={name: Diagnostics.of(declared, [0], [reported])})
    return TargetResult(rows, np.zeros((0, k, 2)) if cloud is None else cloud, tuple(notes))


def result(frame, targets):
    """The result of a frame, or of the frame number `frame` at 25 frames/s, black."""
    if not isinstance(frame, Frame):
        frame = Frame(frame, frame / 25, np.zeros((4, 6, 3), np.uint8))
    placed = []
    for one in targets:
        k = len(one.rows)
        frames = np.array([frame.index])
        said = {name: replace(found, frame=frames) for name, found in one.rows.diagnostics.items()}
        rows = replace(one.rows, frame=np.full(k, frame.index), time_s=np.full(k, frame.time_s), diagnostics=said)
        placed.append(one._replace(rows=rows))
    return FrameResult(frame, tuple(placed))


def table(path, parts, header=None, diagnostics=None):
    """A trajectory of these parts."""
    return joined(parts, path=path, header=header or {}, diagnostics=diagnostics or {})


def rows_of(trajectory):
    """The rows in the order of a file, each with the columns of the CSV and `by_hand`; None is what is not known."""
    columns = trajectory.columns()
    lists = {name: column.tolist() for name, column in columns.items()}
    order = np.lexsort((trajectory.which, trajectory.frame))
    lists["by_hand"] = trajectory.by_hand[order].tolist()
    return [
        SimpleNamespace(**{name: None if value != value else value for name, value in zip(lists, row, strict=True)})
        for row in zip(*lists.values(), strict=True)
    ]


def parts_of(found):
    """The parts of a target's result, as `rows_of` has them, with `cov` as (xx, xy, yy), None if not known."""
    rows = rows_of(found.rows)
    for one, xy in zip(rows, found.rows.cov_xy.tolist(), strict=True):
        one.cov = None if one.std_x is None else (one.std_x**2, xy, one.std_y**2)
    return rows


def file_rows(path):
    """The rows of a file, as `rows_of` has them."""
    return rows_of(read_trajectory(path))
