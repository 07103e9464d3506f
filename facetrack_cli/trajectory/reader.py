"""Reading trajectories and ground truth of facetrack: CSV, JSON and JSON lines, and what is wrong with a file.

The header of a trajectory says how its run was made; here it is checked. A start with its corrections has one form
as files hold it: starts are in init files, in the header of a trajectory, and in goldens.
"""

import csv
import itertools
import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.files import MAX_TABLE_BYTES, check_readable
from facetrack_cli.core.types import Correction, Start, TargetStart, checked_name
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import COLUMNS, FLOATS, TEXTS, Trajectory, build, header_value
from facetrack_cli.trajectory.writers import OF_PART, OF_TARGET, SCHEMA, VERSION

REQUIRED: Final = ("frame", "target", "part", "x", "y")
MAX_PIXELS: Final = 1e6  # no image is larger: what is beyond is a slip, or no pixel
MAX_FRAME: Final = 10**9
FrameNumber: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=MAX_FRAME)]
_BLOCK: Final = 1_000  # lines that become columns at a time: few enough to stay in the processor's cache
_BOUNDS: Final = {
    **dict.fromkeys(("x", "y"), (-MAX_PIXELS, MAX_PIXELS)),
    **dict.fromkeys(("w", "h", "std_x", "std_y", "std_w", "std_h"), (0.0, MAX_PIXELS)),
    "identity_prob": (0.0, 1.0),
}
# of the cells of a column: the type of their values, the characters that stand in them, and what they are
_CELLS: Final[Mapping[str, tuple[type, str, str]]] = {
    **dict.fromkeys(COLUMNS, (np.float64, r"[-+.0-9eE]*", "finite number")),
    **dict.fromkeys((*TEXTS, "target", "part"), (np.str_, r"(?s).*", "name")),
    "frame": (np.int64, r"[0-9]*", "whole number from 0 up"),
    "particles": (np.float64, r"[0-9]*", "whole number from 0 up"),
}
# the JSON of a frame
_Number: TypeAlias = Annotated[float, Field(strict=True)] | None
_Word: TypeAlias = Annotated[str, Field(min_length=1)]
_OWN: dict[str, Any] = {**dict.fromkeys(OF_PART, (_Number, None)), "part": (_Word, ...), "status": (str, "")}
_OWN["by_hand"] = (pydantic.StrictBool, False)


@cache
def _frame() -> Any:
    part: Any = pydantic.create_model("_PART", __config__=ConfigDict(extra="forbid"), **_OWN)
    target: Any = pydantic.create_model(
        "_TARGET", __config__=ConfigDict(extra="allow"), target=(_Word, ...), particles=(_Number, None),
        identity=(str | None, None), identity_prob=(_Number, None), parts=(list[part], ...),
    )  # fmt: skip
    more: dict[str, Any] = {"time_s": (_Number, None), "targets": (list[target], ...)}
    return pydantic.create_model("_FRAME", frame=(FrameNumber, ...), **more)


def read_trajectory(path: Path | str) -> Trajectory:
    """A trajectory or ground truth of facetrack.

    Parameters
    ----------
    path : a CSV, JSON or JSON lines file, told apart by their content, or the folder of a run. Columns of a CSV may
        stand in any order; frame, target, part, x and y are required, columns of other tools are passed over.

    Raises
    ------
    InputError : with the line where there is one, for a file that is none of them.
    """
    path = table_in(Path(path))
    try:
        with reading(path, "name a trajectory or ground-truth file, or the folder of a run"):
            if not path.is_dir():
                check_readable(path, MAX_TABLE_BYTES, "table of rows")
            return read_table(path)
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is CSV or JSON in UTF-8") from e


def table_in(path: Path) -> Path:
    """The trajectory in the folder of a run; any other path is itself."""
    inside = (path / f"trajectory.{form}" for form in ("json", "jsonl", "csv"))
    return next((file for file in inside if file.is_file()), path) if path.is_dir() else path


def read_table(path: Path) -> Trajectory:
    """The rows of a file, wherever it lies and whichever run it is of. InputError for its contents, OSError."""
    with path.open("rb") as file:
        first = file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    return _read_json(path) if first == b"{" else _read_csv(path)


def not_as_written(path: Path, error: Any, *above: object) -> InputError:
    """The first error of a pydantic.ValidationError, in the key that is `above` what was validated."""
    first = error.errors()[0]
    key = ".".join(map(str, (*above, *first["loc"]))) or "all of it"
    return InputError(f"{path}: {key} is not as facetrack run writes it ({first['msg'].lower()}); make the run again")


def _build(path: Path, names: Mapping[tuple[str, str], int], columns: dict[str, Any], **others: Any) -> Trajectory:
    """The trajectory of columns, `which` among them; InputError for numbers that cannot be."""
    if not names:
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    for name in FLOATS:
        values, (least, most) = columns[name], _BOUNDS.get(name, (-1e300, 1e300))
        if (wrong := np.flatnonzero((values < least) | (values > most))).size:
            frame, part = columns["frame"][wrong[0]], "/".join(list(names)[columns["which"][wrong[0]]])
            why = f"{name} {values[wrong[0]]:.15g} is no number from {least:g} to {most:g}"
            raise InputError(f"{path}: frame {frame}, {part}: {why}; correct it, or leave it empty")
    return build(tuple(names), path=path, **columns, **others)


def _read_csv(path: Path) -> Trajectory:
    blocks, names = list[dict[str, Any]](), dict[tuple[str, str], int]()
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            header = [name.strip() for name in next(lines, [])]
            if "hidden" in header:
                raise InputError(f"{path}:1: column hidden is not read; write hidden in its column status")
            if wrong := ", ".join(name for name in COLUMNS if not (name in REQUIRED) <= header.count(name) <= 1):
                why = f"the header has no column, or two, called {wrong}"
                raise InputError(f"{path}:1: {why}; it should read {','.join(COLUMNS)}")
            rows = ((lines.line_num, cells) for cells in lines if cells)
            while block := list(itertools.islice(rows, _BLOCK)):
                numbers, texts = zip(*block, strict=True)
                for number, cells in block:
                    if len(cells) != len(header):
                        count = f"{len(cells)} values under {len(header)} columns"
                        raise InputError(f"{path}:{number}: {count}; complete it, or was the run cut short?")
                columns = dict(zip(header, zip(*texts, strict=True), strict=True))
                empty = ("",) * len(block)
                read: dict[str, Any] = {n: _column(path, n, columns.get(n, empty), numbers) for n in COLUMNS}
                pairs = zip(read.pop("target").tolist(), read.pop("part").tolist(), strict=True)
                read["which"] = [names.setdefault(pair, len(names)) for pair in pairs]
                blocks.append(read)
    except csv.Error as e:
        raise InputError(f"{path}:{lines.line_num}: is not CSV: {e}") from e
    whole = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]} if blocks else {}
    return _build(path, names, whole)


def _column(path: Path, name: str, cells: Sequence[str], numbers: Sequence[int]) -> NDArray[Any]:
    """The values of a column's cells; InputError, with the line, for the first that it cannot have."""
    kind, characters, what = _CELLS[name]
    cells = [cell.strip() for cell in cells]
    with suppress(ValueError, OverflowError):
        if (name not in ("target", "part") or "" not in cells) and re.fullmatch(characters, "".join(cells)):
            return np.array([cell or "nan" for cell in cells] if kind is np.float64 else cells, kind)
    if len(cells) > 1:  # each alone, to name the line
        return np.concatenate([_column(path, name, [cell], [at]) for cell, at in zip(cells, numbers, strict=True)])
    raise InputError(f"{path}:{numbers[0]}: column {name}: {cells[0]!r} is no {what}; correct it")


def _read_json(path: Path) -> Trajectory:
    header, records = _records(path)
    columns: dict[str, list[Any]] = {name: [] for name in ("which", "frame", "time_s", *OF_TARGET[1:], *OF_PART[1:])}
    names: dict[tuple[str, str], int] = {}
    reported: dict[str, dict[int, Mapping[str, Any]]] = {}
    where: tuple[object, ...] = ("diagnostics",)
    try:
        listed = pydantic.TypeAdapter(list[Diagnostic]).validate_python(header.get("diagnostics", []))
        declared = {**KNOWN, **{each.name: each for each in listed}, **KNOWN}  # a known name keeps its meaning
        for at, record in enumerate(records):
            where = "frames", at
            frame = _frame().model_validate(record)
            for target in frame.targets:
                for part in target.parts:
                    columns["which"].append(names.setdefault((target.target, part.part), len(names)))
                    for said, keys in ((frame, ("frame", "time_s")), (target, OF_TARGET[1:]), (part, OF_PART[1:])):
                        for name in keys:
                            columns[name].append(getattr(said, name))
                if not declared.keys().isdisjoint(target.model_extra):
                    reported.setdefault(target.target, {}).setdefault(frame.frame, target.model_extra)
    except ValidationError as e:
        raise not_as_written(path, e, *where) from None
    columns["identity"] = [name or "" for name in columns["identity"]]
    arrays = {name: np.array(values, np.float64 if name in FLOATS else None) for name, values in columns.items()}
    diagnostics = {}
    for name, by_frame in reported.items():
        frames = sorted(by_frame)
        chosen = [kind for kind in declared.values() if any(kind.name in each for each in by_frame.values())]
        try:
            diagnostics[name] = Diagnostics.of(chosen, frames, [by_frame[number] for number in frames])
        except ValueError as e:
            at, why = e.args
            raise InputError(f"{path}: frame {frames[at]}, {name}: {why}; correct it, or leave it out") from None
    return _build(path, names, arrays, header=header, diagnostics=diagnostics)


def _records(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """(header, frames) of a JSON or JSON-lines trajectory; InputError, with the line, if it is none."""
    text, header, frames, number = path.read_text(encoding="utf-8-sig"), dict[str, Any](), list[Any](), 1
    first, _, rest = text.strip().partition("\n")
    by_line = first.rstrip().endswith("}") and rest.lstrip().startswith("{")  # in whatever order the keys stand
    lines = text.split("\n") if by_line else [text]
    try:
        for number, line in enumerate(lines, 1):  # noqa: B007 -- named in the error
            record = json.loads(line) if line.strip() else None
            if isinstance(record, dict) and record.get("type") == "frame":
                frames.append(record)
            elif isinstance(record, dict):  # the header, the footer, or the whole file
                header = {**record, **header}
    except (ValueError, RecursionError) as e:  # also a number of thousands of digits
        why = f"is not JSON: {e!s:.60}; was the run cut short? of a .jsonl remove this line"
        raise InputError(f"{path}:{number + getattr(e, 'lineno', 1) - 1}: {why}") from None
    frames = header.pop("frames", frames)
    if header.get("schema") != SCHEMA or not isinstance(frames, list):
        raise InputError(f'{path}: is no trajectory of facetrack, with "schema": "{SCHEMA}" and a list "frames"')
    if type(version := header.get("version", VERSION)) is not int or version > VERSION:
        raise InputError(f"{path}: is of version {version!r}, and this facetrack reads {VERSION}; update facetrack")
    return header, frames


CORRECTED: Final = "corrected.init.yaml"
UNSAVED: Final = "unsaved.init.yaml"
PEOPLE: Final = "people.json"
STILLS: Final = "people"  # the folder of the pictures of people, in that of a run
Pixels: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_PIXELS, le=MAX_PIXELS, allow_inf_nan=False)]
Side: TypeAlias = Annotated[float, Field(strict=True, gt=0, le=MAX_PIXELS, allow_inf_nan=False)]
Name: TypeAlias = Annotated[str, AfterValidator(lambda name: checked_name(name, "target or part"))]
_Parts: TypeAlias = Annotated[
    Annotated[Literal[True], Tag("all")] | Annotated[tuple[Name, ...], Tag("parts")],
    Discriminator(lambda given: "all" if given is True else "parts"),
]


class TargetRecord(BaseModel, extra="forbid", defer_build=True):
    """Where one target is at the start."""

    box: tuple[Pixels, Pixels, Side, Side] | None = None  # left, top, width, height
    points: dict[Name, tuple[Pixels, Pixels]] = {}  # x, y
    windows: dict[Name, tuple[Side, Side]] = {}  # width, height


class CorrectionRecord(BaseModel, extra="forbid", defer_build=True):
    """What is corrected of one target in one frame; the members are those of `core.types.Correction`."""

    box: tuple[Pixels, Pixels, Side, Side] | None = None
    points: dict[Name, tuple[Pixels, Pixels]] = {}
    kept: dict[Name, tuple[Pixels, Pixels]] = {}
    absent: _Parts = ()
    learn: Annotated[bool, Field(strict=True)] | None = None
    confirmed: _Parts = ()
    frame: FrameNumber
    target: Name


class StartRecord(BaseModel, extra="forbid", defer_build=True):
    """A start: its frame, its targets by name, and the corrections after it."""

    frame: FrameNumber
    targets: dict[Name, TargetRecord]
    corrections: tuple[CorrectionRecord, ...] = ()
    detector: Literal["", "haar", "yunet"] = ""
    placed: bool = False

    def start_from(self, origin: str) -> Start:
        """The start; `origin` is what said so."""
        corrections = tuple(Correction(**dict(record)) for record in self.corrections)
        targets = {name: TargetStart(**dict(target)) for name, target in self.targets.items()}
        return Start(self.frame, targets, origin, corrections, detector=self.detector, placed=self.placed)


def to_record(start: Start) -> dict[str, Any]:
    """What `StartRecord` reads, for JSON; members without a value are left out."""
    targets = {k: _known(box=t.box, points=dict(t.points), windows=dict(t.windows)) for k, t in start.targets.items()}
    measured = _known(detector=start.detector, placed=start.placed)
    return {"frame": start.frame, "targets": targets, **measured, **corrections_record(start.corrections)}


def corrections_record(corrections: Sequence[Correction]) -> dict[str, Any]:
    """The member `corrections` of a start's record; no member without any."""
    return _known(corrections=[{"frame": fix.frame, "target": fix.target, **corrected(fix)} for fix in corrections])


def corrected(correction: Correction) -> dict[str, Any]:
    """What is corrected, for JSON: whole numbers without a fraction, and only members with a value."""
    learn, box = correction.learn, correction.box and list(map(whole, correction.box))
    absent, sure = (names is True or list(names) for names in (correction.absent, correction.confirmed))
    both = correction.points, correction.kept
    points, kept = ({k: list(map(whole, xy)) for k, xy in places.items()} for places in both)
    members = _known(box=box, points=points, kept=kept, absent=absent, confirmed=sure)
    return members if learn is None else {**members, "learn": learn}


def whole(value: float) -> float | int:
    """A number without a fraction as an integer."""
    return int(value) if value == int(value) else float(value)


def _known(**members: Any) -> dict[str, Any]:
    return {key: value for key, value in members.items() if value}


class ClipHeader(BaseModel, defer_build=True):
    """A clip: `pixel_aspect` is the width of a pixel over its height, `begins_s` the time of its first frame."""

    path: str
    size: tuple[pydantic.PositiveInt, pydantic.PositiveInt]
    fps: Annotated[float, Field(gt=0, le=1e6)]
    pixel_aspect: Annotated[float, Field(gt=0.01, le=100)] = 1.0
    begins_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    stream: int | None = None


class InitHeader(StartRecord):
    origin: Annotated[str, Field(alias="from")]

    @property
    def start(self) -> Start:
        return self.start_from(self.origin)


class SeamHeader(BaseModel, defer_build=True):
    """Where two chunks of a clip meet: the first frame of the later one's rows, the share of frames that agree."""

    frame: FrameNumber
    agreement: float | None
    agrees: bool


class Header(BaseModel, defer_build=True):
    """The JSON around the frames; what only its end says is None where a file of lines was cut off."""

    facetrack: str = "unknown"
    versions: dict[str, str] = {}
    source: ClipHeader
    recipe: dict[str, Any]
    seed: int
    init: InitHeader
    split: dict[str, str] = {}  # the `length` of chunks, as --split takes it
    seams: tuple[SeamHeader, ...] = ()
    smoothed: dict[str, int | None] | None = None  # `lag`: by how many frames rows are late; None: by all
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
    known = isinstance(size, list) and len(size) == 2 and all(type(side) is int and side > 0 for side in size)
    return (size[0], size[1]) if known else None


def is_there(path: Path) -> bool:
    """Whether there is such a file or folder, as far as the system tells."""
    return os.path.exists(path)  # noqa: PTH110 -- Path.exists raises where a folder may not be looked into
