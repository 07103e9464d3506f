"""Tables for spreadsheets and data frames: one row a frame, head poses, and the rows as they are in Parquet.

All keep the conventions of trajectory.csv: frames and pixels from 0, x and y the centre, "" or null what is not known.
"""

import csv
import io
import json
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import BOX
from facetrack_cli.trajectory.head_pose import SHAPE, head_pose
from facetrack_cli.trajectory.trajectory import COLUMNS, DECIMALS, FLOATS, Trajectory, aligned

WIDE = ("x", "y", "w", "h", "confidence", "status")
WHOLE = ("frame", "particles")
POSE = ("frame", "time_s", "target", "pitch", "yaw", "roll", "std_pitch", "std_yaw", "std_roll", "ambiguous")


def write_wide(table: Trajectory) -> str:
    """A CSV with one row a frame: frame, time_s, and of each part `target_part_x`, y, w, h, confidence, status.

    Of a part `box` the name is the target's alone. Frames are those that have a row. The text begins with a byte order
    mark only where a name is not ASCII: spreadsheets need it then. A name that they would take for a formula is put
    behind an underscore.
    """
    frames, columns = aligned(table.parts, *WIDE)
    cells = np.full((len(frames), 2 + len(WIDE) * len(table.parts)), "", dtype=object)
    cells[:, 0] = frames
    cells[:, 1] = texts(table.times, DECIMALS["time_s"])
    for at, (name, values) in enumerate(columns.items(), 2):
        cells[:, at :: len(WIDE)] = values if name == "status" else texts(values, DECIMALS[name])
    names = [f"{_called(*pair)}_{column}" for pair in table.names for column in WIDE]
    text = csv_text(["frame", "time_s", *names], cells.tolist())
    return text if "".join(names).isascii() else "\ufeff" + text


def write_pose(table: Trajectory) -> str:
    """A CSV with a row for each frame and target that has points: roll, yaw, pitch in degrees, and their spread.

    InputError if no target has enough points for a pose.
    """
    found: list[tuple[int, int, list[Any]]] = []
    for n, name in enumerate(table.targets):
        parts = table.of_target(name)
        if (pose := head_pose(parts)) is None:
            continue
        times = dict(zip(table.frames.tolist(), texts(table.times, 4).tolist(), strict=True))
        angles, ambiguous = texts(np.concatenate([pose.angles, pose.std], axis=1), 2), pose.ambiguous.astype(int)
        for frame, row, more in zip(pose.frame.tolist(), angles.tolist(), ambiguous.tolist(), strict=True):
            found.append((frame, n, [frame, times[frame], name, *row, more if row[0] else ""]))
    if not found:
        raise InputError(f"a pose needs four parts that are not in a plane, among {', '.join(SHAPE)}")
    return csv_text(POSE, [row for *_, row in sorted(found, key=lambda one: one[:2])])


def write_parquet(table: Trajectory) -> bytes:
    """The columns of trajectory.csv as an Apache Parquet file; what is not known is null.

    `frame` and `particles` are int64, other numbers float64, texts dictionaries of strings. The header of a
    trajectory.json is the JSON text of the key `facetrack` in the file's metadata. UsageError without pyarrow.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise UsageError("Parquet needs pyarrow; install it: pip install 'facetrack[parquet]'") from None
    named = pa.dictionary(pa.int32(), pa.string())
    kinds = dict.fromkeys(COLUMNS, named) | dict.fromkeys(FLOATS, pa.float64()) | dict.fromkeys(WHOLE, pa.int64())
    metadata = {"facetrack": json.dumps(dict(table.header))}
    schema = pa.schema([pa.field(name, kinds[name]) for name in COLUMNS], metadata=metadata)
    columns: list[Any] = []
    for name, values in table.columns().items():
        missing = values == "" if values.dtype.kind == "U" else ~np.isfinite(values)
        whole = np.where(missing, 0, values).astype(np.int64) if name in WHOLE else values
        columns.append(pa.array(whole, mask=missing).cast(kinds[name]))
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.Table.from_arrays(columns, schema=schema), sink)
    found: bytes = sink.getvalue().to_pybytes()
    return found


def _called(target: str, part: str) -> str:
    name = part if not target else target if part == BOX else f"{target}_{part}"
    return re.sub(r"^(?=[=+@\t\r-])", "_", name)


def texts(values: Any, decimals: int) -> Any:
    """The numbers as text with so many decimals, and never -0; "" for what is not known."""
    return np.where(np.isfinite(values), np.char.mod(f"%.{decimals}f", np.round(values, decimals) + 0.0), "")


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()
