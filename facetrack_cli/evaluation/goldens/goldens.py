"""Golden files: what many seeds of a recipe gave on a clip, to be checked against later.

    sample_videos/goldens/occlusion.factorized.json

A golden is JSON with one line for each statistic: part, quantity, first and last frame, the median over seeds, and the
offset of each seed from it, both in the quantity's unit (`units`; means of logarithms for those that `bands.py`
averages so). `paths` are the medians of x and y in every frame. What it takes to run the same again stands before them.
"""

import contextlib
import json
import math
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, ValidationError

from facetrack_cli import __version__
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import MOST, check_readable, digest, write_new
from facetrack_cli.core.types import Array, Start
from facetrack_cli.evaluation.goldens import bands
from facetrack_cli.evaluation.goldens.bands import QUANTITIES, Name, Statistic, names
from facetrack_cli.evaluation.goldens.permutation_test import median_of_runs
from facetrack_cli.trajectory.header import StartRecord, TargetRecord, to_record
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.images import listing

FOLDER: Final = "goldens"
FIRST_SEED: Final = 1000  # of those recorded; those tested count from 0
# settings that change no band; the gallery is a file, whose checksum is compared
NOT_COMPARED: Final = ("description", "seed", "recognition.gallery")
HOLD: Final = 3  # frames in a row outside the band that make leaving more than noise
WIDE: Final = 2.5  # times the median distance of runs from their median: three standard deviations of a normal one
LEAST_PX: Final = 0.5
EVERY: Final = 5  # frames that share a reach


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class File(_Strict):
    """A file by its path from the folder of clips, and its checksum."""

    file: str = Field(min_length=1)
    sha256: str


class Clip(File):
    file: str = Field(pattern=r"^[^/\\]+$")


class GoldenStart(StartRecord):
    targets: dict[str, TargetRecord] = Field(min_length=1)


class Seeds(_Strict):
    """The first seed recorded, how many were, and how many a check runs, from 0."""

    first: int
    recorded: int = Field(ge=1)
    tested: int = Field(ge=1, le=FIRST_SEED)


class Row(NamedTuple):
    """A statistic of all seeds: `median + offsets` in the quantity's unit, None where a seed has no value."""

    series: str
    quantity: Name
    first: int
    last: int
    median: int
    offsets: list[int | None]


class PartPath(_Strict):
    """The medians of one part over runs, x and y (T,) in pixels, None where no run has a position, and how far the
    band reaches around them, one number for each EVERY frames.
    """

    x: list[float | None]
    y: list[float | None]
    reach: list[float]


class Golden(_Strict):
    """What was recorded, as the file holds it.

    `recipe` is a shipped name or a path from the folder of clips; `gallery` that of a recipe that recognises, `names`
    who each target is, if anybody; `frames` the first and the last one; `paths` by `target/part`.
    """

    schema_: Literal["facetrack-golden"] = Field(alias="schema")
    version: Literal[1]
    clip: Clip
    recipe: str
    settings: dict[str, Any]
    gallery: File | None = None
    names: dict[str, str] = {}
    start: Annotated[GoldenStart, PlainSerializer(lambda start: to_record(start.start_from("")))]
    stop: int | None
    seeds: Seeds
    versions: dict[str, str]
    frames: tuple[int, int]
    units: dict[Name, float]
    rows: list[Row] = Field(alias="statistics", min_length=1)
    paths: dict[str, PartPath] = Field(min_length=1)

    @cached_property
    def statistics(self) -> tuple[Statistic, ...]:
        return tuple(Statistic(row.quantity, row.series, row.first, row.last) for row in self.rows)

    @cached_property
    def recorded(self) -> Array:
        """(S, F) as `bands.measure` gives it."""
        rows = [[math.nan if v is None else row.median + v for v in row.offsets] for row in self.rows]
        return np.array(rows, float).T

    @property
    def recipe_name(self) -> str:
        return Path(self.recipe).name.removesuffix(".yaml")

    def recipe_from(self, folder: Path) -> str:
        """The shipped name, or the path of a recipe beside the clips."""
        return str(folder / self.recipe) if self.recipe.endswith(".yaml") else self.recipe

    def short(self, series: str) -> str:
        """The name of a part without its target, where there is only one target."""
        targets = {name.split("/")[0] for name in self.paths}
        return series.split("/", 1)[-1] if len(targets) == 1 else series


def golden_path(folder: Path, clip: str, recipe: str) -> Path:
    """Where the golden of a clip in `folder` and a recipe's name is kept."""
    return folder / FOLDER / f"{Path(clip).stem}.{recipe}.json"


def find_goldens(folder: Path) -> list[Path]:
    """The golden files of a folder of clips, by name. InputError if there is no such folder."""
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "there is no such folder"
        raise InputError(f"{folder}: {what}; name the folder that holds the clips")
    return sorted((folder / FOLDER).glob("*.json"))


def record(
    tables: Sequence[Trajectory],
    *,
    clip: Path,
    recipe: str,
    settings: Mapping[str, Any],
    start: Start,
    stop: int | None = None,
    gallery: Path | None = None,
) -> Golden:
    """A golden of runs of one recipe on one clip with different seeds."""
    if gallery is not None:  # a path from the clip's folder, wherever it was recorded from
        settings = {**settings, "recognition": {**settings["recognition"], "gallery": beside(clip.parent, gallery)}}
    statistics = bands.choose(tables)
    recorded = bands.measure(tables, statistics)
    if bands.alike(recorded):  # a deterministic tracker: one run is enough
        recorded = recorded[:1]
    frames = tables[0].frames
    return Golden(
        schema="facetrack-golden",
        version=1,
        clip=Clip(file=clip.name, sha256=checksum(clip)),
        recipe=recipe,
        settings=dict(settings),
        gallery=None if gallery is None else File(file=beside(clip.parent, gallery), sha256=checksum(gallery)),
        names=names(tables),
        start=GoldenStart.model_validate(to_record(start)),
        stop=stop,
        seeds=Seeds(first=FIRST_SEED, recorded=len(recorded), tested=bands.runs_to_test(statistics, recorded)),
        versions=versions(),
        frames=(int(frames[0]), int(frames[-1])),
        units={name: QUANTITIES[name].unit for name in dict.fromkeys(one.quantity for one in statistics)},
        statistics=[_row(*each) for each in zip(statistics, recorded.T, strict=True)],
        paths=paths_of(tables),
    )


def _row(of: Statistic, values: Array) -> Row:
    known = values[np.isfinite(values)]
    median = round(float(np.median(known))) if known.size else 0
    offsets = [round(value) - median if math.isfinite(value) else None for value in values.tolist()]
    return Row(of.series, of.quantity, of.first, of.last, median, offsets)


def beside(folder: Path, file: Path) -> str:
    """A file's path from the folder of clips."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def versions() -> dict[str, str]:
    """Of what a track's numbers depend on."""
    found = {"facetrack": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for name in ("numpy", "numba", "opencv-python-headless", "opencv-contrib-python-headless"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def checksum(clip: Path) -> str:
    """SHA-256 of a clip's bytes; of an image folder, of the names and bytes of its images."""
    images = listing(clip)
    try:
        return digest([clip] if images is None else images, names=images is not None)
    except OSError as e:
        raise InputError(f"{clip}: cannot be read: {e.strerror or e}; a golden names it") from e


def differences(recorded: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Settings that differ, as `filter.particles 100 -> 200`."""
    both = [dict(_flat(settings)) for settings in (recorded, now)]
    keys = [key for key in both[0] | both[1] if both[0].get(key) != both[1].get(key) and key not in NOT_COMPARED]
    shown = [[json.dumps(one[k], ensure_ascii=False) if k in one else "nothing" for one in both] for k in keys]
    return [f"{key} {before} -> {after}" for key, (before, after) in zip(keys, shown, strict=True)]


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:  # a section that is left out is as good as null
            yield f"{prefix}{key}", value


# --- paths ---------------------------------------------------------------------------------------------------------
# they are there to be read: what decides is `bands.py`


@dataclass(frozen=True)
class Leave:
    """Where runs leave the path: the source frame, the part, its distance, and the band's reach there; pixels."""

    frame: int
    series: str
    distance: float
    reach: float

    def __str__(self) -> str:
        times = f"{self.distance / self.reach:.1f} times the band of {self.reach:.1f} px"
        return f"leaves its path at frame {self.frame}: {self.distance:.1f} px off, {times}"


def paths_of(tables: Sequence[Trajectory]) -> dict[str, PartPath]:
    """The paths of runs over the same frames and parts, by `target/part`, in tenths of pixels."""
    found = {}
    for i, one in enumerate(tables[0].parts):
        x, y = _medians(tables, i)
        away = np.hypot([t.parts[i].x - x for t in tables], [t.parts[i].y - y for t in tables])
        reach = np.nan_to_num(np.maximum(WIDE * median_of_runs(away), LEAST_PX), nan=LEAST_PX)
        widest = np.maximum.reduceat(reach, np.arange(0, len(reach), EVERY))
        mx, my = ([None if np.isnan(v) else v for v in np.round(axis, 1).tolist()] for axis in (x, y))
        found[one.name] = PartPath(x=mx, y=my, reach=np.round(widest, 1).tolist())
    return found


def first_leave(recorded: Mapping[str, PartPath], tables: Sequence[Trajectory]) -> Leave | None:
    """Where the median of these runs first leaves the band of a path, for HOLD frames in a row; None if it does not."""
    leaves = []
    for i, (name, path) in enumerate(recorded.items()):
        x, y = _medians(tables, i)
        distance = np.hypot(x - np.array(path.x, float), y - np.array(path.y, float))
        reach = np.repeat(path.reach, EVERY)[: len(distance)]
        held = np.convolve(distance > reach, np.ones(HOLD))[HOLD - 1 :] == HOLD
        if held.any():
            at = int(held.argmax())
            leaves.append(Leave(int(tables[0].parts[i].frame[at]), name, float(distance[at]), float(reach[at])))
    return min(leaves, key=lambda leave: leave.frame, default=None)


def _medians(tables: Sequence[Trajectory], i: int) -> tuple[Array, Array]:
    parts = [table.parts[i] for table in tables]
    return median_of_runs(np.array([one.x for one in parts])), median_of_runs(np.array([one.y for one in parts]))


# --- files ---------------------------------------------------------------------------------------------------------


def write_golden(path: Path, golden: Golden) -> None:
    """Whole or not at all; replaces the one before."""
    head = golden.model_dump(by_alias=True, exclude={"rows", "paths"})
    lines = [f'  "{key}": {_json(value)},' for key, value in head.items() if value or key not in ("gallery", "names")]
    rows = [f"    {_json(row)}" for row in golden.rows]
    parts = []
    for name, one in golden.paths.items():
        columns = ",\n".join(f'      "{key}": {_json(values)}' for key, values in one)
        parts.append(f"    {_json(name)}: {{\n{columns}\n    }}")
    lines += ['  "statistics": [', ",\n".join(rows), "  ],", '  "paths": {', ",\n".join(parts), "  }"]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_new(path, "\n".join(["{", *lines, "}", ""]).encode(), overwrite=True)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":") if isinstance(value, list | tuple) else None)


def read_golden(path: Path) -> Golden:
    """Raises InputError, in one line, for a file that is no golden of this version."""
    anew = "record it again with facetrack regress --update"
    try:
        check_readable(path, MOST, "golden")
        golden = Golden.model_validate_json(path.read_bytes())
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable, or {anew}") from e
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        place = ".".join(str(step) for step in first["loc"])
        raise InputError(f"{path}: is no golden: {place + ': ' if place else ''}{first['msg']}; {anew}") from None
    if flaw := _flaw(golden):
        raise InputError(f"{path}: {flaw}; {anew}")
    return golden


def _flaw(golden: Golden) -> str:
    """What in a golden does not fit the rest of it, or this version."""
    count = golden.frames[1] - golden.frames[0] + 1
    lengths = count, count, -(-count // EVERY)
    if any(QUANTITIES[name].unit != unit for name, unit in golden.units.items()):
        return "was recorded in other units than this version measures in"
    if any(len(row.offsets) != golden.seeds.recorded for row in golden.rows):
        return f"a statistic does not have {golden.seeds.recorded} values, one for each seed"
    if any((len(one.x), len(one.y), len(one.reach)) != lengths for one in golden.paths.values()):
        return f"a path does not have a position for each of {count} frames"
    if unknown := {row.series for row in golden.rows} - set(golden.paths):
        return f"{min(unknown)} has statistics and no path"
    return ""
