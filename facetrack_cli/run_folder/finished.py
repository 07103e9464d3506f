"""A finished run, read from its folder: rows, recipe, start, and the clip that it was made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from pydantic import ValidationError

from facetrack_cli.core.errors import FacetrackError, InputError, reading
from facetrack_cli.core.models import shipped_folder, shipped_recipes
from facetrack_cli.core.types import Start
from facetrack_cli.recipe.model import KINDS, ParticleRecipe, Recipe
from facetrack_cli.run_folder.manifest import VIDEO, check_belongs, other_clip, read_run, trajectory_of
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import check_start
from facetrack_cli.trajectory.reader import PEOPLE, Header, is_there, read_header
from facetrack_cli.trajectory.trajectory import Status, Trajectory
from facetrack_cli.trajectory.writers import FORMATS, Format
from facetrack_cli.video.images import listing
from facetrack_cli.video.source import given_rate

_AGAIN: Final = "make the run again"


@dataclass(frozen=True)
class Run:
    """A finished run: the `rows` of its JSON, and the `start` with its corrections.

    `files` are its trajectories, each with its `stamp` when it was opened. `fps` is None for a video. Of a `film` it is
    one track of one person.
    """

    folder: Path
    rows: Trajectory
    header: Header
    recipe: Recipe
    start: Start
    clip: Path
    fps: Fraction | None
    files: Mapping[Format, tuple[Path, object]]
    film: bool = False

    @cached_property
    def first(self) -> int:
        return int(self.rows.frame[0])

    @cached_property
    def last(self) -> int:
        return int(self.rows.frame[-1])

    @cached_property
    def parts(self) -> Mapping[str, tuple[str, ...]]:
        """The parts of each target."""
        return {name: tuple(part for target, part in self.rows.names if target == name) for name in self.rows.targets}

    @property
    def fixed_by(self) -> str:
        """The command that corrects it."""
        of = f" --person {self.rows.targets[0]}@{self.first}f" if self.film else ""
        return f"facetrack fix {self.folder}{of}"

    @property
    def video(self) -> Path | None:
        """The video that the run wrote, if it did."""
        path = self.folder / VIDEO
        return path if path.is_file() else None


def open_run(folder: Path, clip: Path | None = None) -> Run:
    """The run that `facetrack run` wrote into a folder; `clip` is where its clip is now, if not where it was.

    Raises InputError for a folder without JSON, files that are cut short or differ, rows that do not fit the recipe and
    the start, a recipe of another version, and a clip or a file of the recipe that is missing.
    """
    main = trajectory_of(folder)
    if (folder / PEOPLE).is_file():
        who = f"facetrack people {folder} --page corrects who is who"
        raise InputError(f"{folder}: is of a film; {who}, and --person NAME@TIME of facetrack fix one's points")
    files = run_files(folder)
    stamped = {form: (path, stamp(path)) for form, path in files.items()}
    rows = read_files(files)
    header = read_header(rows)
    path = Path(header.source.path) if clip is None else clip
    if clip is None and not is_there(path) and not listing(path):
        raise InputError(f"{path}: is not there, and the run in {folder} is of it; name the clip with --clip")
    if (other := other_clip(rows, path)) is not None:
        raise InputError(f"{other}; name its clip with --clip")
    recipe = recipe_of(main, rows.header["recipe"], [Path(), folder, folder.parent, path.parent])
    fps = given_rate(path, header.source.fps)
    run = Run(folder, rows, header, recipe, header.init.start, path, fps, stamped)
    _check_rows(main, run)
    return run


def run_files(folder: Path) -> dict[Format, Path]:
    """The trajectories in the folder of a run."""
    return {form: folder / f"trajectory.{form}" for form in FORMATS if (folder / f"trajectory.{form}").is_file()}


def read_files(files: Mapping[Format, Path]) -> Trajectory:
    """The rows of a run's JSON, or else its JSON lines.

    Raises InputError for a file that is not as its run wrote it, by the checksums in run.json, and for rows that no run
    writes.
    """
    main = files["json"] if "json" in files else files["jsonl"]
    rows = read_run(main)
    for path in files.values():
        with reading(path):
            check_belongs(path)
    whole = (np.diff(rows.frames) == 1).all() and all(len(part) == len(rows.frames) for part in rows.parts)
    if not whole or not {"lost_frames", "init"} <= {*rows.header} or not np.isin(rows.status, get_args(Status)).all():
        raise InputError(f"{main}: is not as facetrack run writes it, was it edited? {_AGAIN}")
    return rows


def stamp(path: Path) -> object:
    """What changes when a file is written again."""
    try:
        stats = path.stat()
    except OSError:
        return None
    return stats.st_ino, stats.st_size, stats.st_mtime_ns


def recipe_of(main: Path, settings: Mapping[str, Any], folders: Sequence[Path]) -> Recipe:
    """The run's recipe; the files that it names are looked for in `folders` and among the shipped ones."""
    name = str(settings.get("name", "recipe"))
    values: dict[str, Any] = {key: deepcopy(value) for key, value in settings.items() if key != "name"}
    if any(file.stem == name for file in shipped_recipes()):
        folders = [shipped_folder(), *folders]
    _place(main, values, [*folders, shipped_folder()])
    kind = KINDS.get(str(values.get("type", "particle_filter")), ParticleRecipe)
    try:
        return kind.model_validate(values, context={"path": main.parent / f"{name}.yaml", "root": None})
    except ValidationError as e:
        first = e.errors()[0]
        wrong = f"{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}"
        raise InputError(f"{main}: this version of facetrack does not know its recipe ({wrong}); {_AGAIN}") from None


def _place(main: Path, values: dict[str, Any], folders: Sequence[Path]) -> None:
    """Put the place where each file of a recipe's sections is now."""
    for key, value in values.items():
        if isinstance(value, dict):
            _place(main, value, folders)
        elif key in ("file", "gallery", "calibration") and isinstance(value, str):
            values[key] = str(_sought(main, value, folders))


def _sought(main: Path, name: str, folders: Sequence[Path]) -> Path:
    for folder in folders:
        if is_there(folder / name) and (folder / name).is_file():
            return (folder / name).resolve()
    places = ", ".join(dict.fromkeys(str(folder.resolve()) for folder in folders))
    raise InputError(f'{main}: its recipe names the file "{name}", which is in none of {places}; put it into one')


def _check_rows(main: Path, run: Run) -> None:
    """InputError if the rows are not what this recipe makes of this start and its corrections."""
    try:
        check_start(run.start, run.header.source.size, run.recipe.points)
        tracker = build_tracker(run.recipe, run.start)
    except FacetrackError as e:
        raise InputError(f"{main}: its start and its recipe do not go together: {e}") from None
    if run.first != run.start.frame or [(target.name, target.parts) for target in tracker] != list(run.parts.items()):
        raise InputError(f"{main}: its rows are not those of its recipe, start and corrections; {_AGAIN}")
