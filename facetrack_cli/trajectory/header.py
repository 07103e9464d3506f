"""What a trajectory's JSON says of its run, checked; and a start with its corrections as files hold them.

Starts are in init files, in the header of a trajectory, and in goldens.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from facetrack_cli.core.types import Correction, Start, TargetStart, checked_name
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS, not_as_written
from facetrack_cli.trajectory.trajectory import Trajectory, header_value

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
    return _members(corrections=[{"frame": one.frame, "target": one.target, **corrected(one)} for one in corrections])


def corrected(correction: Correction) -> dict[str, Any]:
    """What `CorrectedTarget` reads, for JSON: whole numbers without a fraction, and only members with a value."""
    start, learn = correction.given, correction.learn
    absent, sure = (one is True or list(one) for one in (correction.absent, correction.confirmed))
    box = start.box and list(map(whole, start.box))
    points, kept = ({k: list(map(whole, xy)) for k, xy in those.items()} for those in (start.points, correction.kept))
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
