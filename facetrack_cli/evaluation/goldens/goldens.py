"""Golden files: the bands of a recipe's runs on a clip, against which later runs are checked.

    sample_videos/goldens/occlusion.factorized.json

A golden is JSON with a line for each band: part, quantity, first and last frame, the band's edges (`bands.py`), and how
many runs have no value. Before the bands stands what a run needs: clip, recipe, start, seeds.
"""

import contextlib
import json
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, ValidationError

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.files import digest, read_bounded, write_new
from facetrack_cli.core.types import Start
from facetrack_cli.core.version import __version__
from facetrack_cli.evaluation.goldens import bands
from facetrack_cli.evaluation.goldens.bands import RUNS, Band
from facetrack_cli.trajectory.header import StartRecord, TargetRecord, to_record
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.images import listing

FOLDER: Final = "goldens"
FIRST_SEED: Final = 1000  # of recorded runs; tested runs count from 0
# settings that change no band; the gallery is a file, whose checksum is compared
NOT_COMPARED: Final = ("description", "seed", "recognition.gallery")


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


class Golden(_Strict):
    """What was recorded, as the file holds it.

    `recipe` is a shipped name or a path from the folder of clips; `gallery` that of a recipe that recognises, `names`
    who each target is, if anybody; `seeds` how many, from FIRST_SEED; `frames` first and last; `parts` `target/part`.
    """

    schema_: Literal["facetrack-golden"] = Field(alias="schema")
    version: Literal[2]
    clip: Clip
    recipe: str
    settings: dict[str, Any]
    gallery: File | None = None
    names: dict[str, str] = {}
    start: Annotated[GoldenStart, PlainSerializer(lambda start: to_record(start.start_from("")))]
    stop: int | None
    seeds: int = Field(ge=1)
    versions: dict[str, str]
    frames: tuple[int, int]
    parts: list[str] = Field(min_length=1)
    bands: list[Band] = Field(min_length=1)

    @property
    def tested(self) -> int:
        """How many seeds a check runs."""
        return min(RUNS, self.seeds)

    @property
    def recipe_name(self) -> str:
        return Path(self.recipe).name.removesuffix(".yaml")

    def recipe_from(self, folder: Path) -> str:
        """The shipped name, or the path of a recipe beside the clips."""
        return str(folder / self.recipe) if self.recipe.endswith(".yaml") else self.recipe

    def short(self, series: str) -> str:
        """The name of a part without its target, where there is only one target."""
        targets = {name.split("/")[0] for name in self.parts}
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
    named = bands.names(tables)
    statistics = bands.select_statistics(tables, named)
    recorded = bands.measure(tables, statistics, named)
    if bands.deterministic(recorded):
        recorded = recorded[:1]
    frames = tables[0].frames
    return Golden(
        schema="facetrack-golden",
        version=2,
        clip=Clip(file=clip.name, sha256=checksum(clip)),
        recipe=recipe,
        settings=dict(settings),
        gallery=None if gallery is None else File(file=beside(clip.parent, gallery), sha256=checksum(gallery)),
        names=named,
        start=GoldenStart.model_validate(to_record(start)),
        stop=stop,
        seeds=len(recorded),
        versions=versions(),
        frames=(int(frames[0]), int(frames[-1])),
        parts=[part.name for part in tables[0].parts],
        bands=bands.bands_of(statistics, recorded),
    )


def beside(folder: Path, file: Path) -> str:
    """A file's path from the folder of clips."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def versions() -> dict[str, str]:
    """The versions of the software that the numbers of a track depend on."""
    found = {"facetrack": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for name in ("numpy", "numba", "opencv-python-headless", "opencv-contrib-python-headless"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def checksum(clip: Path) -> str:
    """SHA-256 of a clip's bytes; of an image folder, of the names and bytes of its images."""
    images = listing(clip)
    with reading(clip, "a golden names it"):
        return digest([clip] if images is None else images, names=images is not None)


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


def write_golden(path: Path, golden: Golden) -> None:
    """Write the golden whole or not at all; it replaces the golden before it."""
    head = golden.model_dump(by_alias=True, exclude={"bands"})
    lines = [f'  "{key}": {_json(value)},' for key, value in head.items() if value or key not in ("gallery", "names")]
    lines += ['  "bands": [', ",\n".join(f"    {_json(band)}" for band in golden.bands), "  ]"]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_new(path, "\n".join(["{", *lines, "}", ""]).encode(), overwrite=True)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":") if isinstance(value, list | tuple) else None)


def read_golden(path: Path) -> Golden:
    """Raises InputError, in one line, for a file that is no golden of this version."""
    anew = "record it again with facetrack regress --update"
    try:
        with reading(path, f"make it readable, or {anew}"):
            golden = Golden.model_validate_json(read_bounded(path, what="golden"))
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        place = ".".join(str(step) for step in first["loc"])
        raise InputError(f"{path}: is no golden: {place + ': ' if place else ''}{first['msg']}; {anew}") from None
    if unknown := {band.series for band in golden.bands} - {*golden.parts, ""}:
        raise InputError(f"{path}: {min(unknown)} has a band and is no part; {anew}")
    return golden
