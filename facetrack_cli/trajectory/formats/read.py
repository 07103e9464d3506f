"""Truth files and the results of others, of any kind that is read here, known by their shape or by name.

    truth = read_truth(Path("groundtruth_rect.txt"))
    truth.header["read_as"]         # "OTB text: left,top,width,height a line, pixels from 1 ..."
    theirs = read_results(Path("MIL.txt"))

Frames and pixels of the table are counted from 0 whatever the file's own counting is.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.formats.boxes import BOX_COLUMNS, read_boxes, read_got10k, read_otb
from facetrack_cli.trajectory.formats.lines import delimiter, lines_with_frame, read_text
from facetrack_cli.trajectory.formats.mot import read_mot
from facetrack_cli.trajectory.formats.pts import read_pts
from facetrack_cli.trajectory.formats.vot import read_vot
from facetrack_cli.trajectory.reader import MAX_FRAME, REQUIRED, read_trajectory
from facetrack_cli.trajectory.trajectory import Trajectory

FORMATS: Final = ("auto", "facetrack", "boxes", "otb", "got10k", "mot", "vot", "pts")


class _Reader(Protocol):
    def __call__(self, path: Path, *, shift: int = 0) -> Trajectory: ...


def _read_facetrack(path: Path, *, shift: int = 0) -> Trajectory:
    table = read_trajectory(path)
    header = {**table.header, "read_as": "facetrack's own table"}
    return replace(table, frame=table.frame + shift, diagnostics={}, header=header)


_READERS: Final[dict[str, _Reader]] = {
    "facetrack": _read_facetrack,
    "boxes": read_boxes,
    "otb": read_otb,
    "got10k": read_got10k,
    "mot": read_mot,
    "vot": read_vot,
    "pts": read_pts,
}


def read_truth(path: Path | str, form: str = "auto", *, shift: int = 0) -> Trajectory:
    """The truth in a file or folder, read as `form`, one of FORMATS; `auto` goes by the shape.

    `shift` is added to every frame number. Of the table, `header["read_as"]` says in words how it was read, and
    `header["shift"]` is the shift. Raises InputError, one line with file and line, for a file that is broken or of no
    known shape; UsageError for a shift that no clip is long enough for.
    """
    path = Path(path)
    if abs(shift) > MAX_FRAME:
        raise UsageError(f"--shift {shift}: no clip has so many frames; correct it")
    with _looking_at(path):
        try:
            found, known = recognise(path) if form == "auto" else (path, form)
            table = _READERS[known](found, shift=shift)
        except InputError as e:
            raise InputError(f"{e}{_rather(path, form)}") from None
    return replace(table, header={**table.header, "shift": shift})


def read_results(path: Path, form: str = "auto") -> Trajectory:
    """A trajectory of ours, or what another tracker wrote: a file in one of FORMATS, read as `form` or by its shape.

    Status is init, tracked or lost where the file says so, else "". `header["read_as"]` is there for those of others.
    Raises InputError as `read_truth` does.
    """
    with _looking_at(path):
        shape = form
        if form == "auto":
            try:
                shape = "facetrack" if path.is_dir() and not any(path.glob("*.pts")) else recognise(path)[1]
            except InputError:
                shape = "facetrack"  # whose reader says what a trajectory is
        if shape == "facetrack":
            return read_trajectory(path)
        # its seventh column is a confidence, also where all are 0 or 1
        table = read_mot(path, results=True) if shape == "mot" else _READERS[shape](path)
    read_as = str(table.header["read_as"]).replace("--truth-format", "--format")
    status = np.where(np.isin(table.status, ("visible", "hidden", "absent")), "", table.status)
    return replace(table, status=status, header={**table.header, "read_as": read_as})


@contextmanager
def _looking_at(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable, or name another") from None


def _rather(path: Path, form: str) -> str:
    """What to do about a file that cannot be read as the user's own `form`, if its shape says another."""
    if form == "auto":
        return ""
    try:
        shape = recognise(path)[1]
    except (InputError, OSError):
        return ""
    return f" (its shape is that of {shape}: leave --truth-format out)" if shape != form else ""


def recognise(path: Path) -> tuple[Path, str]:
    """The file to read, inside of `path` if that is a folder, and which of FORMATS it has."""
    if path.is_dir():
        return _inside(path)
    if path.suffix.lower() == ".pts":
        return path, "pts"
    lines = lines_with_frame(read_text(path))
    first = lines[0].text
    place = f"{path}:{lines[0].number}"
    if first.startswith("{"):
        return path, "facetrack"
    if first.lower().startswith("version:"):
        return path, "pts"
    cells = [cell.strip() for cell in first.split(delimiter(first))]
    if _is_mask(cells[0]):
        return path, "vot"
    if not all(map(_is_number, cells)):
        return path, _by_header(place, first)
    return path, _by_count(path, place, cells, any(line.text in ("0", "1", "2") for line in lines))


def _inside(folder: Path) -> tuple[Path, str]:
    if any((folder / f"trajectory.{suffix}").is_file() for suffix in ("json", "csv", "jsonl")):
        return folder, "facetrack"
    if any(folder.glob("*.pts")) or any((folder / "annot").glob("*.pts")):
        return folder, "pts"
    named = ("gt/gt.txt", "groundtruth_rect.txt", "groundtruth.txt", "groundtruth.csv")
    for file in (folder / name for name in named):
        if file.is_file():
            return recognise(file)
    raise InputError(
        f"{folder}: is a folder without trajectory.csv, {', '.join(named)} or .pts files; name the truth file"
    )


def _by_header(place: str, first: str) -> str:
    names = {name.strip().lower() for name in next(csv.reader([first]))}
    for mark, word in ((";", "semicolons"), ("\t", "tabs")):
        columns = [name.strip().lower() for name in first.split(mark)]
        if "frame" in columns or (mark == ";" in first and first[0].isdigit()):
            raise InputError(f"{place}: {word} between the columns; write commas there, and decimals with a point")
    if {"target", "part"} <= names:
        return "facetrack"
    if set(BOX_COLUMNS) <= names:
        return "boxes"
    if first[0].isdigit():
        raise InputError(
            f"{place}: {first[:60]!r} are no numbers between commas, tabs or blanks; write decimals with a point"
        )
    raise InputError(
        f"{place}: {first[:60]!r} begins no truth file that is known here; a header reads {','.join(REQUIRED)} for "
        f"points or {','.join(BOX_COLUMNS)} for boxes, without a header a line is left,top,width,height"
    )


def _by_count(path: Path, place: str, cells: list[str], codes_follow: bool) -> str:
    count = len(cells)
    if count in (1, 8) or (count == 4 and codes_follow):
        return "vot"
    if count == 4:
        labelled = any((path.parent / f"{name}.label").is_file() for name in ("absence", "cover"))
        return "got10k" if labelled else "otb"
    if count == 5:
        raise InputError(f"{place}: five numbers a line; put the header {','.join(BOX_COLUMNS)} on top")
    if count in (6, 7, 9, 10) and all(float(cell).is_integer() and float(cell) >= 1 for cell in cells[:2]):
        return "mot"
    raise InputError(
        f"{place}: {count} values a line are no truth that is known here; name its kind by --truth-format: "
        f"{', '.join(FORMATS[1:])}"
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _is_mask(cell: str) -> bool:
    return cell[:1] in ("m", "M") and _is_number(cell[1:])
