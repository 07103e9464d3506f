"""A finished run, as its folder tells of it: rows, recipe, start, and the clip that it was made from.

with open_run(Path("out")) as run:
    run.recipe, run.start, run.index
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from pydantic import ValidationError

from facetrack_cli.core.errors import FacetrackError, InputError, OutputError
from facetrack_cli.core.types import Start
from facetrack_cli.editor.files.journal import finish
from facetrack_cli.editor.files.run_index import Index
from facetrack_cli.editor.files.run_reader import read_index
from facetrack_cli.recipe.files import shipped_folder, shipped_recipes
from facetrack_cli.recipe.model import KINDS, ParticleRecipe, Recipe
from facetrack_cli.report.make import trajectory_of
from facetrack_cli.runs.outputs import VIDEO
from facetrack_cli.tracking.build.build import build_tracker
from facetrack_cli.tracking.start import check_start
from facetrack_cli.trajectory.header import CORRECTED, Header, read_header
from facetrack_cli.trajectory.json_reader import check_schema
from facetrack_cli.trajectory.row import FORMATS
from facetrack_cli.trajectory.table import Table
from facetrack_cli.video.images import listing

__all__ = ["CORRECTED", "UNSAVED", "Run", "check_size", "check_writable", "open_run"]

UNSAVED: Final = "unsaved.init.yaml"


@dataclass(frozen=True)
class Run:
    """A run whose files are open. `start` has the corrections that it was made with; `fps` is None for a video."""

    folder: Path
    index: Index
    header: Header
    recipe: Recipe
    start: Start
    clip: Path
    fps: Fraction | None

    @property
    def video(self) -> Path | None:
        """The video that the run painted, if it did."""
        path = self.folder / VIDEO
        return path if path.is_file() else None

    @property
    def init(self) -> Mapping[str, Any]:
        """What the header says of the start."""
        found: Mapping[str, Any] = self.index.header["init"]
        return found

    def __enter__(self) -> Run:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.index.close()


def open_run(folder: Path, clip: Path | None = None) -> Run:
    """Open the run that `facetrack run` wrote into a folder; `clip` is where its clip is now, if not where it was.

    Raises InputError, in one line, for a folder without JSON, files that are cut short or differ, rows that do not fit
    the recipe and the start, a recipe of another version, and a clip or a file of the recipe that is not there.
    """
    finish(folder)  # what a save that was torn off has left
    main = trajectory_of(folder)
    files = {form: folder / f"trajectory.{form}" for form in FORMATS if (folder / f"trajectory.{form}").is_file()}
    index = read_index(files)
    try:
        check_schema(main, index.header)
        header = read_header(Table(main, (), index.header))
        path = Path(header.source.path) if clip is None else clip
        if clip is None and not _is_there(path):
            raise InputError(f"{path}: is not there, and the run in {folder} is of it; name the clip with --clip")
        recipe = _recipe(main, index.header["recipe"], [Path(), folder, folder.parent, path.parent])
        start = _start(main, header)
        _check_rows(main, index, recipe, start, header)
        fps = None if listing(path) is None else Fraction(header.source.fps).limit_denominator(1001)
        return Run(folder, index, header, recipe, start, path, fps)
    except BaseException:
        index.close()
        raise


def check_writable(run: Run) -> None:
    """OutputError if nothing can be written into the run's folder: before somebody has corrected it for an hour."""
    if not os.access(run.folder, os.W_OK):
        raise OutputError(
            f"{run.folder}: cannot be written, where what is corrected is to go; make it writable, or copy the run"
        )


def check_size(run: Run, size: tuple[int, int]) -> None:
    """InputError if a clip of this (width, height) is not the run's."""
    if size != run.header.source.size:
        width, height = run.header.source.size
        raise InputError(
            f"{run.clip}: is {size[0]}x{size[1]}, not {width}x{height} pixels as in the run; name its clip with --clip"
        )


def _is_there(path: Path) -> bool:
    try:
        return path.exists() or bool(listing(path))
    except (OSError, ValueError):  # it is no name at all
        return False


# --- the recipe ----------------------------------------------------------------------------------------------------


def _recipe(main: Path, settings: Mapping[str, Any], folders: Sequence[Path]) -> Recipe:
    """The recipe as the run had it; files that it names are sought in `folders` and among the shipped ones."""
    name = str(settings.get("name", "recipe"))
    known: dict[str, Any] = {key: deepcopy(value) for key, value in settings.items() if key != "name"}
    if any(file.stem == name for file in shipped_recipes()):
        folders = [shipped_folder(), *folders]
    for one in [known, *_mappings(known.get("targets"))]:
        for section, key in (("prior", "file"), ("recognition", "gallery")):
            for place in _mappings({section: one.get(section)}):
                if isinstance(file := place.get(key), str):
                    place[key] = str(_sought(main, file, [*folders, shipped_folder()]))
    kind = KINDS.get(str(known.get("type", "particle_filter")), ParticleRecipe)
    try:
        return kind.model_validate(known, context={"path": main.parent / f"{name}.yaml", "root": None})
    except ValidationError as e:
        first = e.errors()[0]
        key = ".".join(str(step) for step in first["loc"])
        raise InputError(
            f"{main}: this version of facetrack does not know its recipe ({key}: {first['msg'].lower()}); "
            "make the run again"
        ) from None


def _mappings(value: Any) -> list[dict[str, Any]]:
    """Those of its values that are mappings."""
    return [one for one in value.values() if isinstance(one, dict)] if isinstance(value, dict) else []


def _sought(main: Path, name: str, folders: Sequence[Path]) -> Path:
    for folder in folders:
        if _is_there(folder / name) and (folder / name).is_file():
            return (folder / name).resolve()
    places = ", ".join(dict.fromkeys(str(folder.resolve()) for folder in folders))
    raise InputError(f'{main}: its recipe names the file "{name}", which is in none of {places}; put it into one')


# --- the start -----------------------------------------------------------------------------------------------------


def _start(main: Path, header: Header) -> Start:
    start = header.init.start
    places = [(one.frame, one.target) for one in start.corrections]
    ours = all(
        one.target in start.targets
        and one.frame > start.frame
        and (one.absent or one.given.box is not None or one.given.points)
        for one in start.corrections
    )
    if not ours or len({*places}) < len(places) or sorted(frames := [frame for frame, _ in places]) != frames:
        raise InputError(f"{main}: init.corrections is not as facetrack run writes it; make the run again")
    return start


# --- the rows ------------------------------------------------------------------------------------------------------


def _check_rows(main: Path, index: Index, recipe: Recipe, start: Start, header: Header) -> None:
    """InputError if the rows are not what this recipe makes of this start."""
    try:
        check_start(start, header.source.size, recipe.points)
        tracker = build_tracker(recipe, start)
    except FacetrackError as e:
        raise InputError(f"{main}: its start and its recipe do not go together: {e}") from None
    expected = {target.name: target.parts for target in tracker}
    if expected != dict(index.parts) or tuple(expected) != index.targets:
        there, wanted = (
            ", ".join(f"{name}/{part}" for name, parts in both.items() for part in parts)
            for both in (index.parts, expected)
        )
        raise InputError(f"{main}: has rows of {there}, and its recipe follows {wanted}; make the run again")
    if index.first != start.frame:
        raise InputError(
            f"{main}: its rows begin with frame {index.first}, its start with {start.frame}; make the run again"
        )
    frames = index.footer.get("frames_tracked")
    if isinstance(frames, int) and frames != len(index):
        raise InputError(f"{main}: says it has {frames} frames, and there are {len(index)}; make the run again")
