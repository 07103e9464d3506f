"""Ground truth and results of any kind that is read here; boxes, polygons and landmarks of tracking benchmarks as text.

docs/measure.md lists them. Frames and pixels of the table are counted from 0 whatever the file's own counting is.

- `boxes`: a CSV of ours.
- `otb`: Matlab's pixels: 1 is subtracted. Line 1 is the first frame. A line of zeros or nan: the target is absent.
- `got10k`: also from 1 ("All coordinate values are 1-based", its author in got-10k/toolkit#6). Absent is also a box
  without width or height, four times -1, and what `absence.label` marks. Where `cover.label` is 0 the target is hidden.
- `vot`: as vot-toolkit reads, writes and draws it. Line 1 is frame 0. Polygons are kept as `corners`; their x, y, w, h
  are the axis-aligned bounding box, width = right - left, and the angle is not known. In ground truth, the code 0
  ("unknown") and regions of nan are absent. A file with a code 1 is a result: 1 is the frame where the tracker was set
  on the target (status init, no place); 2 is a failure (lost, no place); 0 was not tracked, and has no row.
- `mot`: ground truth (motchallenge.net/instructions; MOT16 and later) has nine values, results and MOT15 ground truth
  ten, -1 where not known (`MOT_COLUMNS`). Ids become the targets "1", "2", ..., each with the part "box". A row of flag
  0 is left out, as if the frame were not annotated. A visibility of 0 is "hidden". If every conf of ten values is 0 or
  1 it is taken for the flag, else for a confidence, and then all rows count, as the benchmark has it. Rows of the
  classes in DISTRACTORS are "hidden" whatever their flag, as in TrackEval. A file of a single class is of what counts.
- `pts`: landmarks of iBUG (300-W, 300VW), a file a frame, `annot/000001.pts`: "version: 1", "n_points: 68", then in
  braces a line "123.5 200.25" for each point. Files and pixels are counted from 1, as in Matlab: the centre of the top
  left pixel is 1, 1. The target is "face", with the parts point_01, ... in the file's order; of 68 points five have
  names too. The lips' points are on the outer border, as ours are.
"""

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from facetrack_cli.core.errors import InputError, UsageError, reading
from facetrack_cli.core.files import MAX_TABLE_BYTES, read_bounded
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.trajectory.formats import READERS, load
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS, REQUIRED, read_trajectory, table_in
from facetrack_cli.trajectory.trajectory import MAX_ROWS, SEEN, Trajectory, build
from facetrack_cli.trajectory.views import check_sized

_BEGINS: Final = {"{": "facetrack", "<": "cvat", "version:": "pts"}  # how files of formats begin
FROM_ONE: Final = np.array([1.0, 1.0, 0.0, 0.0])  # boxes (..., 4) that count pixels from 1, minus boxes that do from 0
BOX_COLUMNS: Final = ("frame", "x", "y", "w", "h")
LTWH: Final = "left,top,width,height"
REGION: Final = f"{LTWH}, x1,y1,...,x4,y4 or a code 0, 1, 2"
UNKNOWN, INIT, FAILURE = 0, 1, 2
DISTRACTORS: Final = (2, 7, 8, 12)  # of MOT16 and MOT17: on a vehicle, a static person, a distractor, a reflection
_MOT: Final = f"frame,id,{LTWH}"
MOT_COLUMNS: Final = {6: _MOT, 7: f"{_MOT},conf", 9: f"{_MOT},flag,class,visibility", 10: f"{_MOT},conf,x,y,z"}
# iBUG's numbers of the 68 points, from 1; left and right as seen in the image, which is where iBUG begins to count
NAMED: Final = {"nose": 31, "mouth_left": 49, "mouth_right": 55, "lip_upper": 52, "lip_lower": 58}
_NUMBER: Final = re.compile(r"([-+]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?|[-+]?nan)?", re.IGNORECASE)


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
    """A trajectory of ours, or what another tracker wrote; `form` and errors as of `read_truth`.

    `status` is init, tracked or lost where the file says so, else ""; of others there is `header["read_as"]`.
    """
    with reading(path, "make it readable, or name another"):
        shape = form
        if form == "auto":
            shape = "facetrack"  # whose reader says what a trajectory is
            with contextlib.suppress(InputError):
                shape = recognise(path)[1] if path.is_file() or any(path.glob("*.pts")) else shape
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
        if table_in(path) != path:
            return path, "facetrack"
        if any(path.glob("*.pts")) or any(path.glob("annot/*.pts")):
            return path, "pts"
        named = ("gt/gt.txt", "groundtruth_rect.txt", "groundtruth.txt", "groundtruth.csv")
        if (file := next((path / name for name in named if (path / name).is_file()), None)) is not None:
            return recognise(file)
        raise InputError(f"{path}: is a folder without trajectory, {', '.join(named)} or .pts files; name a file")
    lines = Lines.of(path)
    first = lines.texts[0]
    names = {name.strip().strip('"').lower() for name in first.split(",")}
    cells = lines.take([0]).cells[0]
    count = len(cells) if all(cells) and all(map(_NUMBER.fullmatch, cells)) else 0
    shape = next((form for begin, form in _BEGINS.items() if first.lower().startswith(begin)), "")
    if shape or {"target", "part"} <= names:
        return path, shape or "facetrack"
    if names.issuperset(BOX_COLUMNS):
        return path, "boxes"
    mask = cells[0][:1] in ("m", "M") and _NUMBER.fullmatch(cells[0][1:])
    if mask or count in (1, 8) or (count == 4 and not {"0", "1", "2"}.isdisjoint(lines.texts)):
        return path, "vot"
    if count == 4:
        beside = {"sequence": "vot", "absence.label": "got10k", "cover.label": "got10k"}
        return path, next((form for name, form in beside.items() if path.with_name(name).is_file()), "otb")
    if count in MOT_COLUMNS and all(float(cell).is_integer() and float(cell) >= 1 for cell in cells[:2]):
        return path, "mot"
    form = f"a header reads {','.join(REQUIRED)} or {','.join(BOX_COLUMNS)}; commas stand between columns"
    why = f"begins no ground truth file that is known here: {form}; or give --truth-format: {', '.join(READERS)}"
    raise lines.error(0, why)


def read_text(path: Path) -> str:
    """The text of a file, with `\\n` after each line. InputError if missing, a folder, a pipe, empty, or no text."""
    with reading(path, "name another file"):
        raw = read_bounded(path, MAX_TABLE_BYTES, "table of rows")
    if raw.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: is a ZIP archive; unpack it, and name the file in it")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = raw.count(b"\n", 0, e.start) + 1
        raise InputError(f"{path}:{line}: is not UTF-8 text; save it as UTF-8, or name another file") from e
    if not text.strip() or "\0" in text:
        raise InputError(f"{path}: is {'binary' if text.strip() else 'empty'}; name another file")
    return text.replace("\r\n", "\n").replace("\r", "\n")


@dataclass(frozen=True)
class Lines:
    """T lines of the file `path`, without blanks at their ends, and their `places` in it, counted from 1."""

    path: Path
    texts: Any
    places: Whole

    @classmethod
    def of(cls, path: Path, *, by_frame: bool = False) -> "Lines":
        """Those that are not blank. With `by_frame` line i is frame i: a blank one is an error, but not at the end."""
        known = {place: line.strip() for place, line in enumerate(read_text(path).split("\n"), 1) if line.strip()}
        if by_frame and (blank := {*range(1, max(known) + 1)} - known.keys()):
            raise InputError(f"{path}:{min(blank)}: is blank, and a line is a frame; for none write nan,nan,nan,nan")
        return cls(path, np.array([*known.values()], object), np.array([*known]))

    def __len__(self) -> int:
        return len(self.texts)

    @cached_property
    def cells(self) -> list[list[str]]:
        """What stands between commas where there are some, else between tabs or blanks."""
        between = "," if any("," in text for text in self.texts) else None
        return [[cell.strip() for cell in text.split(between)] for text in self.texts]

    def take(self, rows: Any) -> "Lines":
        """These rows: indices, a mask or a slice."""
        return Lines(self.path, self.texts[rows], self.places[rows])

    def error(self, row: int, why: str) -> InputError:
        """What is wrong with a line."""
        return InputError(f"{self.path}:{self.places[row]}: {self.texts[row]!r:.60} {why}")

    def refuse(self, wrong: ArrayLike, why: str) -> None:
        """Raises InputError for the first line that is `wrong` (T,)."""
        for row in np.flatnonzero(wrong)[:1].tolist():
            raise self.error(row, why)

    def numbers(self, wanted: str, *counts: int, use: Sequence[int] | None = None) -> Array:
        """(T, last of `counts`, or `use`) numbers of lines of so many cells; nan for an empty cell, and beyond a line.

        InputError with the line of what is not `wanted`.
        """
        which = use or range(counts[-1])
        rows = [[row[k] for k in which if k < len(row)] if len(row) in counts else ["?"] for row in self.cells]
        why = f"is no line of {wanted}; write numbers with a point, and one kind of comma, tab or blank between them"
        self.refuse([not all(map(_NUMBER.fullmatch, row)) for row in rows], why)
        cells = [float(cell or "nan") for row in rows for cell in row + ["nan"] * (len(which) - len(row))]
        return np.array(cells).reshape(len(self), len(which))

    def whole(self, values: Array, name: str, least: int) -> Whole:
        """A column (T,) as whole numbers from `least` on."""
        fine = (values >= least) & (values <= MAX_FRAME) & (values == np.floor(values))
        self.refuse(~fine, f"has no {name} that is a whole number from {least} up; correct it")
        return values.astype(np.int64)

    def boxes(self, frame: Whole, ltwh: Array, *, ids: Any = "", status: Any = "visible", **others: Any) -> Trajectory:
        """The boxes (T, 4) of these lines, left, top, width, height from 0; `ids` (T,) name the targets.

        A row of nan, or without width and height, is absent. `status` (T,) may say hidden or absent already; rows that
        it calls absent may hold any box, which is not kept. Raises InputError with the line for what is no box.
        """
        state = np.broadcast_to(status, len(frame)).astype("<U8")
        absent = (state == "absent") | np.isnan(ltwh).all(axis=1) | (ltwh[:, 2:] == 0).all(axis=1)
        fine = (np.abs(ltwh) <= MAX_PIXELS).all(axis=1) & (ltwh[:, 2:] > 0).all(axis=1)
        why = "is no box: left, top, a width and a height above 0, within any image; four times nan or 0 for none"
        self.refuse(~fine & ~absent, why)
        left, top, w, h = np.where(absent[:, None], np.nan, ltwh).T
        place = {"x": left + (w - 1) / 2, "y": top + (h - 1) / 2, "w": w, "h": h}
        targets, which = np.unique(np.broadcast_to(ids, len(frame)), return_inverse=True)
        pairs = [(str(target), "box") for target in targets.tolist()]
        return build(pairs, which, frame, **place, status=np.where(absent, "absent", state), path=self.path, **others)


def read_facetrack(path: Path, *, shift: int = 0) -> Trajectory:
    """A table of facetrack as ground truth."""
    table = read_trajectory(path)
    header = {**table.header, "read_as": "facetrack's own table"}
    return replace(table, frame=table.frame + shift, diagnostics={}, header=header)


def read_boxes(path: Path, *, shift: int = 0) -> Trajectory:
    """CSV with the header frame,x,y,w,h: frames from 0, the left and top edges in pixels from 0."""
    lines = Lines.of(path)
    names = [name.strip().strip('"').lower() for name in lines.texts[0].split(",")]
    if {"target", "part"} <= {*names}:
        raise lines.error(0, "has target and part, with which x, y are centres; read it as facetrack's own table")
    if missing := ", ".join(name for name in BOX_COLUMNS if name not in names):
        raise lines.error(0, f"is a header without {missing}; it should read frame,x,y,w,h")
    lines = lines.take(slice(1, None))
    if not len(lines):
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    values = lines.numbers(",".join(names), len(names), use=[names.index(name) for name in BOX_COLUMNS])
    frame = lines.whole(values[:, 0], "frame", 0)
    return lines.boxes(frame + shift, values[:, 1:], header={"read_as": "boxes: frame,x,y,w,h, all from 0"})


def read_otb(path: Path, *, shift: int = 0) -> Trajectory:
    """OTB text; line i, from 0, is frame i + `shift`."""
    lines = Lines.of(path, by_frame=True)
    header = {"read_as": f"OTB text: {LTWH} a line, pixels from 1 (--truth-format vot: from 0)"}
    return lines.boxes(np.arange(len(lines)) + shift, lines.numbers(LTWH, 4) - FROM_ONE, header=header)


def read_got10k(path: Path, *, shift: int = 0) -> Trajectory:
    """GOT-10k text, with absence.label and cover.label where they lie beside it."""
    lines = Lines.of(path, by_frame=True)
    ltwh = lines.numbers(LTWH, 4) - FROM_ONE
    gone = (ltwh[:, 2:] == 0).any(axis=1) | (ltwh == [-2, -2, -1, -1]).all(axis=1)
    status = np.where(gone, "absent", "visible")
    for name, means in (("cover", "hidden"), ("absence", "absent")):  # what is absent is so whatever covers it
        if (file := path.with_name(f"{name}.label")).is_file():
            labels = Lines.of(file, by_frame=True).numbers("one number", 1)[:, 0]
            if len(labels) != len(lines):
                raise InputError(f"{file}: has {len(labels)} lines, {path.name} beside it {len(lines)}; move one away")
            status[((labels == 0) == (name == "cover")) & ~gone] = means
    header = {"read_as": f"GOT-10k text: {LTWH} a line, pixels from 1, and .label files that lie beside it"}
    return lines.boxes(np.arange(len(lines)) + shift, ltwh, status=status, header=header)


def read_vot(path: Path, *, shift: int = 0) -> Trajectory:
    """VOT ground truth or results; line i, from 0, is frame i + `shift`. Polygons are the rows' `corners`."""
    lines = Lines.of(path, by_frame=True)
    values = lines.numbers(f"{REGION} (masks and other polygons are not read)", 1, 4, 8)
    count = np.array([*map(len, lines.cells)])[:, None]
    codes = np.where(count == 1, np.nan_to_num(values), np.nan)[:, 0]
    polygons, boxes = (np.where(count == n, values[:, :n], np.nan) for n in (8, 4))
    known = np.isnan(polygons).all(axis=1) | (np.abs(polygons) <= MAX_PIXELS).all(axis=1)
    result = bool((codes == INIT).any())
    wrong = ~known | ~(np.isnan(codes) | np.isin(codes, (UNKNOWN, INIT, FAILURE) if result else (UNKNOWN,)))
    lines.refuse(wrong, f"is none of {REGION}, within any image; a 2, a failure, comes after a 1, where a track begins")
    corners = polygons.reshape(-1, 4, 2)
    low, high = corners.min(axis=1), corners.max(axis=1)
    kept = np.flatnonzero(codes != UNKNOWN) if result else np.arange(len(lines))
    ltwh = np.where(count == 8, np.concatenate([low, high - low], axis=1), boxes)[kept]
    header = {"read_as": f"VOT {'result' if result else 'text'}: pixels from 0"}
    table = lines.take(kept).boxes(kept + shift, ltwh, header=header)
    unknown, outline = np.isnan(table.x), np.where(np.isnan(table.x)[:, None, None], np.nan, corners[kept])
    status = np.select([codes[kept] == INIT, unknown], ["init", "lost"], "tracked") if result else table.status
    return replace(table, status=status, corners=None if np.isnan(outline).all() else outline)


def read_mot(path: Path, *, shift: int = 0, results: bool | None = None) -> Trajectory:
    """Ground truth or results of MOTChallenge; of `results` column 7 is a confidence, no flag; None: by its values."""
    lines = Lines.of(path)
    count = len(lines.cells[0])
    if count not in MOT_COLUMNS:
        raise lines.error(0, f"has {count} values; MOTChallenge text has {MOT_COLUMNS[9]}, or {MOT_COLUMNS[10]}")
    values = np.pad(lines.numbers(MOT_COLUMNS[count], count), ((0, 0), (0, 10 - count)), constant_values=np.nan)
    frame, ident = lines.whole(values[:, 0], "frame", 1), lines.whole(values[:, 1], "id", 1)
    seventh, eighth, covered = values[:, 6:9].T
    if results is None:
        results = count != 9 and not np.isin(seventh, (0, 1)).all()
    kept: Mask = (seventh != 0) | results
    # of ten values the eighth is a class where all are whole numbers, else a coordinate in the world
    of_class = (count == 9 or bool((eighth == np.floor(eighth)).all())) & (eighth >= 1) & (not results)
    classes = np.unique(eighth[of_class & kept])
    other: Mask = of_class & (eighth != (classes[0] if len(classes) == 1 else 1))
    ignored = other & np.isin(eighth, DISTRACTORS)
    counts = (kept & ~other) | ignored
    if not counts[~ignored].any():
        raise InputError(f"{path}: no row counts; write 1 for the flag of those that do, and for the class of people")
    confidence = np.where(results & (seventh >= 0) & (seventh <= 1), seventh, np.nan)
    left_out = f", {(~counts).sum()} rows of flag 0 or other classes left out" if not counts.all() else ""
    header = {"read_as": f"MOTChallenge: frames and pixels from 1{left_out}"}
    hidden = ignored | ((covered == 0) & (count == 9) & (not results))
    status = np.where(hidden, "hidden", "visible")
    own = {"ids": ident[counts], "status": status[counts], "confidence": confidence[counts], "header": header}
    return lines.take(counts).boxes(frame[counts] - 1 + shift, values[counts, 2:6] - FROM_ONE, **own)


def read_pts(path: Path, *, shift: int = 0) -> Trajectory:
    """A folder of .pts files, numbered by the last digits of their names, or one file. InputError with the line."""
    files = sorted(path.glob("*.pts")) or sorted(path.glob("annot/*.pts")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: no .pts file in this folder, nor in annot/ below it; name the folder with them")
    frames = np.array([int((re.findall(r"\d+", file.stem) or ["1"])[-1]) for file in files])
    if len(np.unique(frames)) < len(files) or not (frames.min() >= 1 and frames.max() <= MAX_FRAME):
        raise InputError(f"{path}: its .pts files are not numbered by their frames, the first 000001.pts; rename them")
    points = [_points(file) for file in files]
    count = len(points[0])
    if strange := next((file for file, own in zip(files, points, strict=True) if len(own) != count), None):
        raise InputError(f"{strange}: has not the {count} points of {files[0].name}; a folder is one clip")
    numbers = {**(NAMED if count == 68 else {}), **{f"point_{number:02d}": number for number in range(1, count + 1)}}
    xy = np.stack(points, axis=1)[[number - 1 for number in numbers.values()]] - 1  # (parts, T, 2)
    x, y = xy.reshape(-1, 2).T
    unnamed = "" if count == 68 else ", which have no names of ours"
    header = {"read_as": f".pts: {count} points{unnamed}, files and pixels from 1"}
    which = np.repeat(np.arange(len(numbers)), len(files))
    frame = np.tile(frames - 1 + shift, len(numbers))
    place = {"x": x, "y": y, "status": np.where(np.isnan(x), "absent", "visible")}
    return build([("face", name) for name in numbers], which, frame, **place, path=path, header=header)


def _points(path: Path) -> Array:
    """(points, 2), as the file has them; nan where it says so."""
    lines = Lines.of(path)
    head = re.fullmatch(r"version:\s*\S+ n_points:\s*(\d{1,4}) \{", " ".join(lines.texts[:3]), re.IGNORECASE)
    if head is None:
        raise lines.error(0, 'begins no .pts file, whose first lines are "version: 1", "n_points: 68" and "{"')
    if lines.texts[-1] != "}" or len(lines) != int(head[1]) + 4 or len(lines) < 5:
        raise InputError(f"{path}: has not the {head[1]} points between braces that it says; was it cut short?")
    lines = lines.take(slice(3, -1))
    points = lines.numbers("x y", 2)
    fine = np.isnan(points).all(axis=1) | (np.abs(points) <= MAX_PIXELS).all(axis=1)
    lines.refuse(~fine, "is no point: two numbers, none farther out than any image, or nan nan")
    return points


def write_otb(part: Trajectory, unknown: str = "nan,nan,nan,nan") -> str:
    """A box a line from the first frame on, as in OTB's own files of clips that begin late (David at frame 300).

    `unknown` is the line of a place that is not known. InputError for a gap between frames, and a place without a size.
    """
    if (gaps := np.flatnonzero(np.diff(part.frame) != 1)).size:
        first, then = part.frame[gaps[0] : gaps[0] + 2]
        raise InputError(f"{part.name}: no row between frames {first} and {then}; a line is a frame, so export to vot")
    return "".join(f"{region or unknown}\n" for region in _regions(part, FROM_ONE))


def write_got10k(part: Trajectory) -> str:
    """The same as GOT-10k's toolkit has it, which wants it as `<clip>_001.txt`: after nan the mean overlap is nan."""
    return write_otb(part, "0,0,0,0")


def write_vot(part: Trajectory) -> str:
    """A result from frame 0 on: 1 in the first frame of the series, then a region a line, a polygon where there is one.

    Frames before the first and in gaps are 0, a place that is not known is 2. InputError for one without a size.
    """
    first, last = int(part.frame[0]), int(part.frame[-1])
    if first < 0 or last >= MAX_ROWS:
        raise InputError(f"{part.name}: frames {first} to {last} have no room in VOT text, a line a frame from frame 0")
    lines = ["0"] * (last + 1)
    corners = np.full((len(part), 4, 2), np.nan) if part.corners is None else part.corners
    polygons = map(_region, corners.reshape(-1, 8).tolist())
    for frame, box, polygon in zip(part.frame.tolist(), _regions(part), polygons, strict=True):
        lines[frame] = polygon or box or "2"
    lines[first] = "1"
    return "\n".join(lines) + "\n"


def write_mot(parts: Sequence[Trajectory]) -> str:
    """Results or ground truth of MOTChallenge, sorted by frame, without rows that have no place.

    Ground truth, as its statuses say, has nine values: flag and class 1, and visibility, 0 of hidden rows. Results have
    ten: a conf, -1 where not known, then class and visibility as well, which readers look for there, and -1. A series
    is an id: its target's name if all are numbers and differ, else 1, 2, ... InputError for a place without a size.
    """
    idents = [int(part.target) if part.target.isascii() and part.target.isdigit() else 0 for part in parts]
    if 0 in idents or len(set(idents)) < len(idents):
        idents = list(range(1, len(parts) + 1))
    statuses = {status for part in parts for status in part.status.tolist()}
    truth = "visible" in statuses and statuses <= {"", "visible", "hidden", "absent"}
    rows: list[tuple[int, int, str]] = []
    for ident, part in zip(idents, parts, strict=True):
        seen, regions = np.isin(part.status, SEEN).astype(int).tolist(), _regions(part, FROM_ONE)
        for frame, conf, box, visible in zip(part.frame.tolist(), part.confidence.tolist(), regions, seen, strict=True):
            rest = f"1,1,{visible}" if truth else f"{_region([conf]) or '-1'},1,{visible},-1"
            rows += [(frame + 1, ident, f"{box},{rest}")] if box else []
    return "".join(f"{frame},{ident},{rest}\n" for frame, ident, rest in sorted(rows))


def _regions(part: Trajectory, moved: Array | float = 0.0) -> list[str]:
    """left,top,width,height of each row, moved from 0; "" where the place is not known, InputError without a size."""
    check_sized(part, "these formats hold boxes: export points to coco or dlc")
    return [_region(box) for box in (part.boxes + moved).tolist()]


def _region(values: Sequence[float]) -> str:
    """At most 4 decimals, as the centres of a CSV need: it has 3, and half a width makes a fourth. "" of nan."""
    texts = [f"{value:.4f}".rstrip("0").rstrip(".") for value in values]
    return "" if "nan" in texts else ",".join("0" if text == "-0" else text for text in texts)
