"""Reading trajectories and ground truth of facetrack: CSV, JSON and JSON lines, and what is wrong with a file.

The header of a trajectory says how its run was made; here it is checked. A start with its corrections has one form
as files hold it: starts are in init files, in the header of a trajectory, and in goldens.
"""

import csv
import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import MAX_TABLE_BYTES, check_readable
from facetrack_cli.core.types import Correction, Start, TargetStart, checked_name
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import COLUMNS, FLOATS, SPREAD, TEXTS, Trajectory, build, header_value
from facetrack_cli.trajectory.writers import SCHEMA, VERSION

REQUIRED: Final = ("frame", "target", "part", "x", "y")
MAX_PIXELS: Final = 1e6  # no image is larger: what is beyond is a slip, or no pixel
MAX_FRAME: Final = 10**9
_DIGITS: Final = 18  # of a whole number: more do not fit into 64 bits
_STDS: Final = tuple(name for name in SPREAD if name.startswith("std"))
_BLOCK: Final = 1_000  # lines that become columns at a time: few enough to stay in the processor's cache


def read_trajectory(path: Path | str) -> Trajectory:
    """A trajectory or ground truth of facetrack.

    Parameters
    ----------
    path : a CSV, JSON or JSON lines file, told apart by their content, or the folder of a run. Columns of a CSV may
        stand in any order; frame, target, part, x and y are required, columns of other tools are passed over. A column
        `hidden` of 0 and 1 says where an empty status is that of a hidden part.

    Raises
    ------
    InputError : with the line where there is one, for a file that is none of them.
    """
    path = Path(path)
    try:
        path = table_in(path)
        if not path.is_dir():
            check_readable(path, MAX_TABLE_BYTES, "table of rows")
        return read_table(path)
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder without a trajectory.csv or .json; name the file") from None
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is CSV or JSON in UTF-8") from e
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or ground-truth file") from e


def table_in(path: Path) -> Path:
    """The trajectory in the folder of a run; any other path is itself."""
    inside = (path / f"trajectory.{form}" for form in ("json", "csv", "jsonl"))
    return next((file for file in inside if file.is_file()), path) if path.is_dir() else path


def read_table(path: Path) -> Trajectory:
    """The rows of a file, wherever it lies and whichever run it is of. InputError for its contents, OSError."""
    with path.open("rb") as file:
        first = file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    return _read_json(path) if first == b"{" else _read_csv(path)


def not_as_written(path: Path, error: Any, *above: str) -> InputError:
    """The first error of a pydantic.ValidationError, in the key that is `above` what was validated."""
    first = error.errors()[0]
    key = ".".join(map(str, (*above, *first["loc"])))
    problem = " ".join(filter(None, (key, "is not as facetrack run writes it")))
    return InputError(f"{path}: {problem} ({first['msg'].lower()}); make the run again")


def _build(path: Path, targets: list[str], parts: list[str], columns: dict[str, Any], **others: Any) -> Trajectory:
    """The trajectory of columns whose rows are of these targets and parts; InputError for numbers that cannot be."""
    if not targets:
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    numbers: dict[tuple[str, str], int] = {}
    which = [numbers.setdefault(pair, len(numbers)) for pair in zip(targets, parts, strict=True)]
    for name in FLOATS:
        values = columns[name]
        with np.errstate(invalid="ignore"):
            checks = [(np.isinf(values), "is no finite number")]
            if name in ("x", "y", "w", "h", *_STDS):
                checks.append((np.abs(values) > MAX_PIXELS, "is farther out than any image"))
            if name in ("w", "h", *_STDS):
                checks.append((values < 0, "is negative"))
            if name == "identity_prob":
                checks.append(((values < 0) | (values > 1), "is no probability"))
        for wrong, why in checks:
            if wrong.any():
                row = int(np.flatnonzero(wrong)[0])
                place = f"{path}: frame {columns['frame'][row]}, {targets[row]}/{parts[row]}"
                raise InputError(f"{place}: {name} {values[row]:.15g} {why}; correct it, or leave it empty")
    return build(tuple(numbers), which, path=path, **columns, **others)


def _read_csv(path: Path) -> Trajectory:
    blocks: list[dict[str, Any]] = []
    names: dict[str, list[str]] = {"target": [], "part": []}
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            header = [name.strip() for name in next(lines, [])]
            if not any(header):
                raise InputError(f"{path}: is empty; a trajectory begins with the header {','.join(COLUMNS)}")
            if missing := ", ".join(name for name in REQUIRED if name not in header):
                raise InputError(f"{path}:1: the header has no column {missing}; it should read {','.join(COLUMNS)}")
            if twice := sorted(name for name in (*COLUMNS, "hidden") if header.count(name) > 1):
                raise InputError(f"{path}:1: column {twice[0]} is there twice; keep one of them")
            rows = _rows(path, lines, len(header))
            while block := list(itertools.islice(rows, _BLOCK)):
                numbers = [number for number, _ in block]
                cells = dict(zip(header, zip(*(row for _, row in block), strict=True), strict=True))
                columns = {name: list(map(str.strip, cells.get(name, [""] * len(block)))) for name in COLUMNS}
                if "hidden" in cells:
                    columns["status"] = _hidden(path, cells["hidden"], columns["status"], numbers)
                for name in names:
                    if "" in columns[name]:
                        place = f"{path}:{numbers[columns[name].index('')]}"
                        raise InputError(f"{place}: column {name} is empty; name the {name}")
                    names[name] += columns.pop(name)
                blocks.append({name: _column(path, name, texts, numbers) for name, texts in columns.items()})
    except csv.Error as e:
        raise InputError(f"{path}:{lines.line_num}: is not CSV: {e}") from e
    whole = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]} if blocks else {}
    return _build(path, names["target"], names["part"], whole)


def _rows(path: Path, lines: Any, width: int) -> Iterator[tuple[int, list[str]]]:
    """Lines of `width` cells, each with its number."""
    for cells in lines:
        if len(cells) not in (0, width):
            why = "give every column a value, or leave it empty between its commas; or was the run cut short?"
            raise InputError(f"{path}:{lines.line_num}: {len(cells)} values under {width} columns; {why}")
        if cells:
            yield lines.line_num, cells


def _hidden(path: Path, cells: Sequence[str], status: Sequence[str], numbers: Sequence[int]) -> list[str]:
    """The `status`, and where it is empty what a column of 0 and 1, or false and true, says of it."""
    statuses = {"": "", "0": "", "false": "", "1": "hidden", "true": "hidden"}
    for number, cell in zip(numbers, cells, strict=True):
        if cell.strip().lower() not in statuses:
            why = "is none of 0, 1, true and false; correct it or leave it empty"
            raise InputError(f"{path}:{number}: column hidden: {cell.strip()!r} {why}")
    return [text or statuses[cell.strip().lower()] for text, cell in zip(status, cells, strict=True)]


def _column(path: Path, name: str, cells: Sequence[str], numbers: Sequence[int]) -> NDArray[Any]:
    """The values of a column's cells without blanks; InputError, with the line, for the first that is none."""
    if name in TEXTS:
        return np.array(cells, dtype=np.str_)
    whole = name in ("frame", "particles")

    def is_number(cell: str) -> bool:
        if whole or not cell:
            return cell.isascii() and cell.isdigit() and len(cell) <= _DIGITS if cell else name != "frame"
        try:
            return math.isfinite(float(cell)) and "_" not in cell  # float() takes 1_0 for 10
        except ValueError:
            return False

    if not whole and "_" not in "".join(cells):  # as below, and faster
        with suppress(ValueError):
            values = np.array([float(cell) if cell else math.nan for cell in cells])
            if np.isfinite(values).sum() == len(cells) - cells.count(""):
                return values
    for line, cell in zip(numbers, cells, strict=True):
        if not is_number(cell):
            why = "whole number from 0 up; correct it" if whole else "finite number; correct it or leave it empty"
            raise InputError(f"{path}:{line}: column {name}: {cell!r} is no {why}")
    return np.array([int(cell) if cell else math.nan for cell in cells], dtype=np.int64 if name == "frame" else float)


_SHARED: Final = ("frame", "time_s", "target", "particles", "identity", "identity_prob")
_OWN: Final = {"status": "", "by_hand": False, **{name: None for name in FLOATS if name not in _SHARED}}
_KEYS: Final = frozenset(("part", *_OWN))
_KINDS: Final[Mapping[str, tuple[Callable[[Any], bool], str]]] = {
    **dict.fromkeys(
        FLOATS, (lambda v: v is None or type(v) is float or (type(v) is int and abs(v) < 10**300), "no number")
    ),
    **dict.fromkeys(("target", "part"), (lambda v: type(v) is str and v != "", "no name")),
    **dict.fromkeys(TEXTS, (lambda v: type(v) is str, "no name")),
    "frame": (lambda v: type(v) is int and 0 <= v < 10**_DIGITS, "no whole number from 0 up"),
    "by_hand": (lambda v: type(v) is bool, "neither true nor false"),
}


def _read_json(path: Path) -> Trajectory:
    header, records = _records(path)
    columns: dict[str, list[Any]] = {name: [] for name in (*_SHARED, "part", *_OWN)}
    row_of: list[int] = []  # the record of each row
    reported: dict[str, dict[int, Mapping[str, Any]]] = {}
    declared = _declared(path, header)

    def unlike(at: int, why: object) -> InputError:
        return InputError(f"{path}: record {at} of frames is not as facetrack writes it: {why}")

    for at, record in enumerate(records):
        try:
            for target in record["targets"]:
                parts, about = target["parts"], {"particles": None, "identity_prob": None, **target}
                about |= {"frame": record["frame"], "time_s": record.get("time_s")}
                about["identity"] = "" if about.get("identity") is None else about["identity"]
                for key in _SHARED:
                    columns[key] += [about[key]] * len(parts)
                if unknown := sorted({key for part in parts for key in part.keys() - _KEYS}):
                    raise ValueError(f"unknown key {unknown[0]!r}")
                columns["part"] += [part["part"] for part in parts]
                for key, missing in _OWN.items():
                    columns[key] += [part.get(key, missing) for part in parts]
                row_of += [at] * len(parts)
                if not declared.keys().isdisjoint(target):
                    reported.setdefault(about["target"], {}).setdefault(about["frame"], target)
        except (KeyError, TypeError, ValueError, AttributeError) as e:
            raise unlike(at, e) from None
    for name, values in columns.items():
        is_one, what = _KINDS[name]
        if (row := next((i for i, value in enumerate(values) if not is_one(value)), None)) is not None:
            raise unlike(row_of[row], f"{name} {values[row]!r:.60} is {what}")
    targets, names = columns.pop("target"), columns.pop("part")
    arrays = {name: np.array(values, np.float64 if name in FLOATS else None) for name, values in columns.items()}
    diagnostics = {}
    for target, by_diagnostic in reported.items():
        frames = sorted(by_diagnostic)
        chosen = [kind for name, kind in declared.items() if any(name in each for each in by_diagnostic.values())]
        try:
            diagnostics[target] = Diagnostics.of(chosen, frames, [by_diagnostic[frame] for frame in frames])
        except ValueError as e:
            at, why = e.args
            raise InputError(f"{path}: frame {frames[at]}, {target}: {why}; correct it, or leave it out") from None
    return _build(path, targets, names, arrays, header=header, diagnostics=diagnostics)


def _declared(path: Path, header: Mapping[str, Any]) -> dict[str, Diagnostic]:
    """The diagnostics that every version knows, then those that a header declares."""
    if "diagnostics" not in header:
        return dict(KNOWN)
    from pydantic import TypeAdapter, ValidationError

    try:
        listed = TypeAdapter(list[Diagnostic]).validate_python(header["diagnostics"])
    except ValidationError as e:
        raise not_as_written(path, e, "diagnostics") from None
    return {**KNOWN, **{diagnostic.name: diagnostic for diagnostic in listed if diagnostic.name not in KNOWN}}


def _records(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """(header, frames) of a JSON or JSON-lines trajectory; InputError, with the line, if it is none."""
    text, frames, header = path.read_text(encoding="utf-8-sig"), list[Any](), dict[str, Any]()
    number, line = 0, text
    try:
        with suppress(json.JSONDecodeError):
            whole = json.loads(text)
            if isinstance(whole, dict) and whole.get("type") != "header":
                header, frames, text = whole, whole.pop("frames", None), ""
        for number, line in enumerate(text.split("\n"), 1):  # noqa: B007 -- named in the error
            record: Any = json.loads(line) if line.strip() else None
            kind = record.get("type") if isinstance(record, dict) else None
            if kind == "frame":
                frames.append(record)
            elif kind in ("header", "footer"):
                header = {**header, **record} if kind == "header" else {**record, **header}
    except (ValueError, RecursionError) as e:  # also a number of thousands of digits
        why = f"is not JSON: {e!s:.60}; was the run cut short? of a .jsonl remove this line"
        raise InputError(f"{path}:{number or 1}: {why}") from None
    check_schema(path, header)
    if not isinstance(frames, list):
        raise InputError(f'{path}: has no list "frames"; it is no trajectory of facetrack')
    return header, frames


def check_schema(path: Path, header: Any) -> None:
    """InputError if a header is not that of a trajectory, or of a version to come."""
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f'{path}: does not say "schema": "{SCHEMA}"; it is no trajectory of facetrack')
    version = header.get("version", VERSION)
    if type(version) is not int or version > VERSION:
        raise InputError(f"{path}: is of version {version!r}, and this facetrack reads {VERSION}; update facetrack")


CORRECTED: Final = "corrected.init.yaml"
UNSAVED: Final = "unsaved.init.yaml"
PEOPLE: Final = "people.json"
STILLS: Final = "people"  # the folder of the pictures of people, in that of a run
Pixels: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_PIXELS, le=MAX_PIXELS, allow_inf_nan=False)]
Side: TypeAlias = Annotated[float, Field(strict=True, gt=0, le=MAX_PIXELS, allow_inf_nan=False)]
FrameNumber: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=MAX_FRAME)]
Name: TypeAlias = Annotated[str, AfterValidator(lambda name: checked_name(name, "target or part"))]
_Positive: TypeAlias = Annotated[int, Field(gt=0)]
_Parts: TypeAlias = Annotated[
    Annotated[Literal[True], Tag("all")] | Annotated[tuple[Name, ...], Tag("parts")],
    Discriminator(lambda given: "all" if given is True else "parts"),
]


class _Target(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
    box: tuple[Pixels, Pixels, Side, Side] | None = None  # left, top, width, height
    points: dict[Name, tuple[Pixels, Pixels]] = {}  # x, y


class TargetRecord(_Target):
    """Where one target is at the start."""

    windows: dict[Name, tuple[Side, Side]] = {}  # width, height

    def target(self) -> TargetStart:
        return TargetStart(self.box, self.points, self.windows)


class CorrectedTarget(_Target):
    """What is corrected of one target in one frame; the members are those of `core.types.Correction`."""

    kept: dict[Name, tuple[Pixels, Pixels]] = {}
    absent: _Parts = ()
    learn: Annotated[bool, Field(strict=True)] | None = None
    confirmed: _Parts = ()

    def correction(self, frame: int, target: str) -> Correction:
        start = TargetStart(self.box, self.points)
        return Correction(frame, target, start, self.kept, self.absent, self.learn, self.confirmed)


class CorrectionRecord(CorrectedTarget):
    """The same with its frame and its target: a member of a list of corrections."""

    frame: FrameNumber
    target: Name


class StartRecord(BaseModel):
    """A start: its frame, its targets by name, and the corrections after it."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
    frame: FrameNumber
    targets: dict[Name, TargetRecord]
    corrections: tuple[CorrectionRecord, ...] = ()
    detector: Literal["", "haar", "yunet"] = ""
    placed: bool = False

    def start_from(self, origin: str) -> Start:
        """The start; `origin` is what said so."""
        corrections = tuple(record.correction(record.frame, record.target) for record in self.corrections)
        targets = {name: record.target() for name, record in self.targets.items()}
        return Start(self.frame, targets, origin, corrections, detector=self.detector, placed=self.placed)


def to_record(start: Start) -> dict[str, Any]:
    """What `StartRecord` reads, for JSON; members without a value are left out."""
    targets = {}
    for name, target in start.targets.items():
        targets[name] = _members(box=target.box, points=dict(target.points), windows=dict(target.windows))
    measured = _members(detector=start.detector, placed=start.placed)
    return {"frame": start.frame, "targets": targets, **measured, **corrections_record(start.corrections)}


def corrections_record(corrections: Sequence[Correction]) -> dict[str, Any]:
    """The member `corrections` of a start's record; no member without any."""
    return _members(corrections=[{"frame": fix.frame, "target": fix.target, **corrected(fix)} for fix in corrections])


def corrected(correction: Correction) -> dict[str, Any]:
    """What `CorrectedTarget` reads, for JSON: whole numbers without a fraction, and only members with a value."""
    start, learn = correction.given, correction.learn
    absent, sure = (names is True or list(names) for names in (correction.absent, correction.confirmed))
    box = start.box and list(map(whole, start.box))
    points, kept = ({k: list(map(whole, xy)) for k, xy in places.items()} for places in (start.points, correction.kept))
    members = _members(box=box, points=points, kept=kept, absent=absent, confirmed=sure)
    return members if learn is None else {**members, "learn": learn}


def whole(value: float) -> float | int:
    """A number without a fraction as an integer."""
    return int(value) if value == int(value) else float(value)


def _members(**members: Any) -> dict[str, Any]:
    return {key: value for key, value in members.items() if value}


class ClipHeader(BaseModel, defer_build=True):
    """A clip: `pixel_aspect` is the width of a pixel over its height, `begins_s` the time of its first frame."""

    path: str
    size: tuple[_Positive, _Positive]
    fps: Annotated[float, Field(gt=0, le=1e6)]
    pixel_aspect: Annotated[float, Field(gt=0.01, le=100)] = 1.0
    begins_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    stream: int | None = None


class InitHeader(StartRecord):
    origin: Annotated[str, Field(alias="from")]

    @property
    def start(self) -> Start:
        return self.start_from(self.origin)


class SplitHeader(BaseModel):
    """How a clip was cut into chunks, as --split takes it."""

    model_config = ConfigDict(frozen=True, defer_build=True)
    length: str


class SeamHeader(BaseModel):
    """Where two chunks of a clip meet: the first frame of the later one's rows, the share of frames that agree."""

    model_config = ConfigDict(frozen=True, defer_build=True)
    frame: FrameNumber
    agreement: float | None
    agrees: bool


class SmoothedHeader(BaseModel, defer_build=True):
    """By how many frames rows are late; None: they were given the whole clip."""

    lag: int | None = None


class Header(BaseModel, defer_build=True):
    """The JSON around the frames; what only its end says is None where a file of lines was cut off."""

    facetrack: str = "unknown"
    versions: dict[str, str] = {}
    source: ClipHeader
    recipe: dict[str, Any]
    seed: int
    init: InitHeader
    split: SplitHeader | None = None
    seams: tuple[SeamHeader, ...] = ()
    smoothed: SmoothedHeader | None = None
    complete: bool | None = None
    stopped: str | None = None
    variable_fps: bool | None = None
    warnings: tuple[str, ...] = ()

    @property
    def clip_name(self) -> str:
        """The clip's name without its folder; a folder of images with the one above, since many are called `img`."""
        path = Path(self.source.path)
        names = [path.name] if path.suffix else [path.parent.name, path.name]
        return "/".join(filter(None, names)) or self.source.path

    @property
    def recipe_name(self) -> str:
        return str(self.recipe.get("name", "recipe"))


def read_header(table: Trajectory) -> Header:
    """The header of a trajectory in JSON or JSON lines. InputError, with the key, if it is not as a run writes it."""
    try:
        return Header.model_validate(dict(table.header))
    except ValidationError as e:
        raise not_as_written(table.path, e) from None


def clip_of(table: Trajectory) -> Path | None:
    """The clip, looked for where the run was started and beside the trajectory; it need not be there."""
    named = header_value(table, "source", "path")
    if not isinstance(named, str) or not named:
        return None
    beside = table.path.absolute().parent
    return next((p for p in (Path(named), beside / named, beside.parent / named) if is_there(p)), Path(named))


def frame_size_of(table: Trajectory) -> tuple[int, int] | None:
    """Width and height of its images in pixels."""
    size = header_value(table, "source", "size")
    if isinstance(size, list) and len(size) == 2 and all(type(side) is int and side > 0 for side in size):
        return size[0], size[1]
    return None


def is_there(path: Path) -> bool:
    """Whether there is such a file or folder, as far as the system tells."""
    try:
        return path.exists()
    except (OSError, ValueError):  # no permission, or a name that is too long, or none
        return False
