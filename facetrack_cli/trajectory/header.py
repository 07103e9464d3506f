"""What a trajectory's JSON says of its run, checked; its recipe as YAML, and the command that repeats it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, Field, ValidationError

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Start
from facetrack_cli.trajectory.start import StartRecord
from facetrack_cli.trajectory.trajectory import Trajectory

CORRECTED: Final = "corrected.init.yaml"


_Positive = Annotated[int, Field(gt=0)]


class ClipHeader(BaseModel):
    path: str
    size: tuple[_Positive, _Positive]
    fps: Annotated[float, Field(gt=0, le=1e6)]


class InitHeader(StartRecord):
    origin: Annotated[str, Field(alias="from")]

    @property
    def start(self) -> Start:
        return self.start_from(self.origin)


class Header(BaseModel):
    """The JSON around the frames; what only its end says is None where a file of lines was cut off."""

    facetrack: str = "unknown"
    versions: dict[str, str] = {}
    source: ClipHeader
    recipe: dict[str, Any]
    seed: int
    init: InitHeader
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
        first = e.errors()[0]
        key = ".".join(str(step) for step in first["loc"])
        raise InputError(
            f"{table.path}: {key} is not as facetrack run writes it ({first['msg'].lower()}); make the run again"
        ) from None


def said(table: Trajectory, group: str, key: str) -> Any:
    """The value below `group`, as of "recipe" and "name"; None where there is none."""
    found = table.header.get(group)
    return found.get(key) if isinstance(found, dict) else None


def clip_of(table: Trajectory) -> Path | None:
    """The clip, looked for where the run was started and beside the trajectory; it need not be there."""
    named = said(table, "source", "path")
    if not isinstance(named, str) or not named:
        return None
    beside = table.path.absolute().parent
    return next((p for p in (Path(named), beside / named, beside.parent / named) if is_there(p)), Path(named))


def picture_of(table: Trajectory) -> tuple[int, int] | None:
    """Width and height of its pictures in pixels."""
    size = said(table, "source", "size")
    if isinstance(size, list) and len(size) == 2 and all(type(side) is int and side > 0 for side in size):
        return size[0], size[1]
    return None


def is_there(path: Path) -> bool:
    """Whether there is such a file or folder, as far as the system lets us look."""
    try:
        return path.exists()
    except OSError:  # no permission, or a name that is too long
        return False
