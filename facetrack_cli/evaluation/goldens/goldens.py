"""Golden files: what many seeds of a recipe gave on a clip, to be checked against later.

    sample_videos/goldens/occlusion.factorized.json

A golden is JSON with a line a statistic: part, quantity, first and last frame, the median over seeds, and each seed's
offset from it, both in the quantity's unit (`units`; means of logarithms for those that `bands.py` averages so).
`paths` are the medians of x and y in every frame, with the band's reach for each five of them. What it takes to run
the same again stands before them: the clip and its checksum, the recipe and its settings, the gallery if somebody is
to be recognised, who that is, the start, the seeds, the versions.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from facetrack_cli import __version__
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import write_new
from facetrack_cli.core.types import Array, Start
from facetrack_cli.evaluation.goldens import bands, paths
from facetrack_cli.evaluation.goldens.bands import QUANTITIES, Name, Statistic
from facetrack_cli.evaluation.goldens.identities import names
from facetrack_cli.trajectory.header import StartRecord, TargetRecord, to_record
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.images import listing

FOLDER: Final = "goldens"
SCHEMA: Final = "facetrack-golden"
FIRST_SEED: Final = 1000  # of those recorded; those tested count from 0
# settings that change no band; the gallery is a file, whose checksum is compared
NOT_COMPARED: Final = ("description", "seed", "recognition.gallery")


class Gallery(NamedTuple):
    """The gallery of a golden: its path from the folder of clips, and its checksum."""

    file: str
    sha256: str


@dataclass(frozen=True, eq=False)
class Golden:
    """What was recorded. `clip` is a file name in the folder of clips, `recipe` a shipped name or a path from there.

    `gallery` is that of a recipe that recognises, `names` who each target is, if anybody.
    `recorded` (S, F) as `bands.measure` gives it; `tested`: how many seeds a check runs, from 0;
    `frames`: first and last.
    """

    clip: str
    sha256: str
    recipe: str
    settings: Mapping[str, Any]
    start: Start
    stop: int | None
    tested: int
    versions: Mapping[str, str]
    frames: tuple[int, int]
    statistics: tuple[Statistic, ...]
    recorded: Array
    paths: tuple[paths.Path, ...]
    gallery: Gallery | None = None
    names: Mapping[str, str] = field(default_factory=dict)

    @property
    def series(self) -> tuple[str, ...]:
        return tuple(path.series for path in self.paths)

    def short(self, series: str) -> str:
        """A part's name without its target, where there is only one target."""
        targets = {name.split("/")[0] for name in self.series}
        return series.split("/", 1)[-1] if len(targets) == 1 else series


def golden_path(folder: Path, clip: str, recipe: str) -> Path:
    """Where the golden of a clip in `folder` and a recipe's name is kept."""
    return folder / FOLDER / f"{Path(clip).stem if Path(clip).suffix else clip}.{recipe}.json"


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
    if bands.alike(recorded):  # a tracker without chance: one run says it all
        recorded = recorded[:1]
    frames = tables[0].frames
    return Golden(
        clip=clip.name,
        sha256=checksum(clip),
        recipe=recipe,
        settings=settings,
        start=start,
        stop=stop,
        tested=bands.runs_to_test(statistics, recorded),
        versions=versions(),
        frames=(int(frames[0]), int(frames[-1])),
        statistics=statistics,
        recorded=recorded,
        paths=paths.paths(tables),
        gallery=None if gallery is None else Gallery(beside(clip.parent, gallery), checksum(gallery)),
        names=names(tables),
    )


def beside(folder: Path, file: Path) -> str:
    """A file's path from the folder of clips."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def versions() -> dict[str, str]:
    """Of what a track's numbers depend on."""
    found = {"facetrack": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for name in ("numpy", "numba", "opencv-python-headless", "opencv-contrib-python-headless"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def checksum(clip: Path) -> str:
    """SHA-256 of a clip's bytes; of an image folder, of the names and bytes of its images."""
    digest = hashlib.sha256()
    images = listing(clip)
    try:
        for file in [clip] if images is None else images:
            if images is not None:
                digest.update(file.name.encode(errors="surrogateescape") + b"\0")
            digest.update(file.read_bytes())
    except OSError as e:
        raise InputError(f"{clip}: cannot be read: {e.strerror or e}; a golden names it") from e
    return digest.hexdigest()


def differences(recorded: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Settings that differ, as `filter.particles 100 -> 200`."""
    before, after = _flat(recorded), _flat(now)
    keys = [key for key in dict.fromkeys([*before, *after]) if key not in NOT_COMPARED]
    return [f"{key} {_shown(before, key)} -> {_shown(after, key)}" for key in keys if before.get(key) != after.get(key)]


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            out |= _flat(value, f"{prefix}{key}.")
        elif value is not None:  # a section that is left out is as good as null
            out[f"{prefix}{key}"] = value
    return out


def _shown(settings: Mapping[str, Any], key: str) -> str:
    return json.dumps(settings[key], ensure_ascii=False) if key in settings else "nothing"


# --- files ---------------------------------------------------------------------------------------------------------


def write_golden(path: Path, golden: Golden) -> None:
    """Whole or not at all; replaces the one before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_new(path, _text(golden).encode(), overwrite=True)


def _text(golden: Golden) -> str:
    head = {
        "schema": SCHEMA,
        "version": 1,
        "clip": {"file": golden.clip, "sha256": golden.sha256},
        "recipe": golden.recipe,
        "settings": golden.settings,
        **({} if golden.gallery is None else {"gallery": golden.gallery._asdict()}),
        **({"names": golden.names} if golden.names else {}),
        "start": to_record(golden.start),
        "stop": golden.stop,
        "seeds": {"first": FIRST_SEED, "recorded": len(golden.recorded), "tested": golden.tested},
        "versions": golden.versions,
        "frames": list(golden.frames),
        "units": {name: QUANTITIES[name].unit for name in dict.fromkeys(s.quantity for s in golden.statistics)},
    }
    lines = [f'  "{key}": {_json(value)},' for key, value in head.items()]
    rows = []
    for s, column in zip(golden.statistics, golden.recorded.T, strict=True):
        known = column[np.isfinite(column)]
        middle = round(float(np.median(known))) if known.size else 0
        offsets = [None if math.isnan(v) else round(v) - middle for v in column.tolist()]
        rows.append("    " + _json([s.series, s.quantity, s.first, s.last, middle, offsets]))
    drawn = [
        f'    {_json(path.series)}: {{\n      "x": {_json(_list(path.x))},\n      "y": {_json(_list(path.y))},\n'
        f'      "reach": {_json(_list(path.reach))}\n    }}'
        for path in golden.paths
    ]
    lines += ['  "statistics": [', ",\n".join(rows), "  ],", '  "paths": {', ",\n".join(drawn), "  }"]
    return "{\n" + "\n".join(lines) + "\n}\n"


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":") if isinstance(value, list) else (", ", ": "))


def _list(values: Array) -> list[float | None]:
    return [None if math.isnan(v) else round(v, 1) for v in values.tolist()]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Clip(_Strict):
    file: str = Field(pattern=r"^[^/\\]+$")
    sha256: str


class _Gallery(_Strict):
    file: str = Field(min_length=1)
    sha256: str


class _Start(StartRecord):
    targets: dict[str, TargetRecord] = Field(min_length=1)


class _Seeds(_Strict):
    first: int
    recorded: int = Field(ge=1)
    tested: int = Field(ge=1, le=FIRST_SEED)


class _Path(_Strict):
    x: list[float | None]
    y: list[float | None]
    reach: list[float]


class _File(_Strict):
    schema_: Literal["facetrack-golden"] = Field(alias="schema")
    version: Literal[1]
    clip: _Clip
    recipe: str
    settings: dict[str, Any]
    gallery: _Gallery | None = None
    names: dict[str, str] = {}
    start: _Start
    stop: int | None
    seeds: _Seeds
    versions: dict[str, str]
    frames: tuple[int, int]
    units: dict[Name, float]
    statistics: list[tuple[str, Name, int, int, int, list[int | None]]] = Field(min_length=1)
    paths: dict[str, _Path] = Field(min_length=1)


def read_golden(path: Path) -> Golden:
    """Raises InputError, in one line, for a file that is no golden of this version."""
    anew = "record it anew with facetrack regress --update"
    try:
        file = _File.model_validate_json(path.read_bytes())
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable, or {anew}") from e
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        place = ".".join(str(step) for step in first["loc"])
        raise InputError(f"{path}: is no golden: {place + ': ' if place else ''}{first['msg']}; {anew}") from None
    count = file.frames[1] - file.frames[0] + 1
    if any(QUANTITIES[name].unit != unit for name, unit in file.units.items()):
        raise InputError(f"{path}: was recorded in other units than this version measures in; {anew}")
    if any(len(row[5]) != file.seeds.recorded for row in file.statistics):
        raise InputError(f"{path}: a statistic has not {file.seeds.recorded} values, one a seed; {anew}")
    blocks = -(-count // paths.EVERY)
    if any((len(p.x), len(p.y), len(p.reach)) != (count, count, blocks) for p in file.paths.values()):
        raise InputError(f"{path}: a path has not a position for each of {count} frames; {anew}")
    if unknown := {row[0] for row in file.statistics} - set(file.paths):
        raise InputError(f"{path}: {min(unknown)} has statistics and no path; {anew}")
    columns = [[math.nan if v is None else row[4] + v for v in row[5]] for row in file.statistics]
    return Golden(
        clip=file.clip.file,
        sha256=file.clip.sha256,
        recipe=file.recipe,
        settings=file.settings,
        start=file.start.start_from(str(path)),
        stop=file.stop,
        tested=file.seeds.tested,
        versions=file.versions,
        frames=file.frames,
        statistics=tuple(Statistic(row[1], row[0], row[2], row[3]) for row in file.statistics),
        recorded=np.array(columns, dtype=float).T,
        paths=tuple(
            paths.Path(name, _array(p.x), _array(p.y), np.array(p.reach, dtype=float)) for name, p in file.paths.items()
        ),
        gallery=None if file.gallery is None else Gallery(file.gallery.file, file.gallery.sha256),
        names=file.names,
    )


def _array(values: Sequence[float | None]) -> Array:
    return np.array([math.nan if v is None else v for v in values], dtype=float)
