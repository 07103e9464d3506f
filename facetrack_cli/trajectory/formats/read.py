"""Truth files and the results of others, of any kind that is read here, known by their shape or by name.

Frames and pixels of the table are counted from 0 whatever the file's own counting is.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError, reading
from facetrack_cli.trajectory.formats import READERS, load
from facetrack_cli.trajectory.formats.boxes import BOX_COLUMNS, LTWH, MOT_COLUMNS, Lines, delimiter
from facetrack_cli.trajectory.reader import MAX_FRAME, REQUIRED, read_trajectory
from facetrack_cli.trajectory.trajectory import Trajectory


def read_facetrack(path: Path, *, shift: int = 0) -> Trajectory:
    """A table of facetrack as ground truth."""
    table = read_trajectory(path)
    header = {**table.header, "read_as": "facetrack's own table"}
    return replace(table, frame=table.frame + shift, diagnostics={}, header=header)


def read_truth(path: Path | str, form: str = "auto", *, shift: int = 0, beside: Trajectory | None = None) -> Trajectory:
    """The ground truth in a file or folder.

    Parameters
    ----------
    form : one of TRUTH_FORMATS; `auto` goes by the shape of the file.
    shift : is added to every frame number.
    beside : results; what may be OTB's or VOT's is VOT's beside a result of VOT.

    Returns
    -------
    Trajectory : its `header["read_as"]` says how it was read, `header["shift"]` is the shift.

    Raises
    ------
    InputError : for a file that is broken or of no known shape.
    UsageError : for a shift beyond any clip.
    """
    path = Path(path)
    if abs(shift) > MAX_FRAME:
        raise UsageError(f"--shift {shift}: no clip has so many frames; correct it")
    with reading(path, "make it readable, or name another"):
        file, shape = recognise(path) if form == "auto" else (path, form)
        if form == "auto" and shape == "otb" and beside is not None:
            shape = "vot" if str(beside.header.get("read_as")).startswith("VOT") else shape
        table: Trajectory = load("read", shape)(file, shift=shift)
    return replace(table, header={**table.header, "shift": shift})


def read_results(path: Path, form: str = "auto") -> Trajectory:
    """A trajectory of ours, or what another tracker wrote, read as `form`, one of TRUTH_FORMATS, or by its shape.

    Status is init, tracked or lost where the file says so, else "". `header["read_as"]` is there for those of others.
    """
    with reading(path, "make it readable, or name another"):
        shape = form
        if form == "auto":
            try:
                shape = "facetrack" if path.is_dir() and not any(path.glob("*.pts")) else recognise(path)[1]
            except InputError:
                shape = "facetrack"  # whose reader says what a trajectory is
        if shape == "facetrack":
            return read_trajectory(path)
        # the seventh column of MOT results is a confidence, also where all are 0 or 1
        table: Trajectory = load("read", shape)(path, **({"results": True} if shape == "mot" else {}))
    read_as = str(table.header["read_as"]).replace("--truth-format", "--format")
    status = np.where(np.isin(table.status, ("visible", "hidden", "absent")), "", table.status)
    return replace(table, status=status, header={**table.header, "read_as": read_as})


def recognise(path: Path) -> tuple[Path, str]:
    """The file to read, inside of `path` if that is a folder, and which of TRUTH_FORMATS it has."""
    if path.is_dir():
        if any((path / f"trajectory.{suffix}").is_file() for suffix in ("json", "csv", "jsonl")):
            return path, "facetrack"
        if any(path.glob("*.pts")) or any(path.glob("annot/*.pts")):
            return path, "pts"
        named = ("gt/gt.txt", "groundtruth_rect.txt", "groundtruth.txt", "groundtruth.csv")
        if (file := next((path / name for name in named if (path / name).is_file()), None)) is not None:
            return recognise(file)
        files = f"trajectory.csv, {', '.join(named)} or .pts files"
        raise InputError(f"{path}: is a folder without {files}; name the ground truth file")
    by_name = {".pts": "pts", ".bin": "vot"}.get(path.suffix.lower())
    return path, by_name or _shape(Lines.of(path))


def _shape(lines: Lines) -> str:
    first = lines.texts[0]
    for begin, shape in (("{", "facetrack"), ("<", "cvat"), ("version:", "pts")):
        if first.lower().startswith(begin):
            return shape
    names = {name.strip().strip('"').lower() for name in first.split(",")}
    for own, shape in ((("target", "part"), "facetrack"), (BOX_COLUMNS, "boxes")):
        if names.issuperset(own):
            return shape
    cells = [cell.strip() for cell in first.split(delimiter([first]))]
    if cells[0][:1] in ("m", "M") and _is_number(cells[0][1:]):  # a mask
        return "vot"
    count = len(cells) if all(map(_is_number, cells)) else 0
    if count in (1, 8) or (count == 4 and not {"0", "1", "2"}.isdisjoint(lines.texts)):
        return "vot"
    if count == 4:
        if lines.path.with_name("sequence").is_file():  # what VOT says of a clip
            return "vot"
        labels = (lines.path.with_name(f"{name}.label") for name in ("absence", "cover"))
        return "got10k" if any(file.is_file() for file in labels) else "otb"
    if count in MOT_COLUMNS and all(float(cell).is_integer() and float(cell) >= 1 for cell in cells[:2]):
        return "mot"
    heads = f"a header reads {','.join(REQUIRED)} for points or {','.join(BOX_COLUMNS)} for boxes"
    why = f"begins no ground truth file that is known here; {heads}, without a header a line is {LTWH}"
    remedy = f"name its kind by --truth-format: {', '.join(READERS)}"
    place = f"{lines.path}:{lines.places[0]}: {first[:60]!r}"
    raise InputError(f"{place} {why}; commas stand between columns, and decimals have a point; or {remedy}")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
