"""Goldens: what the rows of a recipe's run on a clip were, and whether those of later runs are the same.

A golden holds a checksum of the rows of each frame of a run with seed 0, and `spread`: the range over SEEDS seeds of
the mean of each quantity after the first frame, of each part and of all parts (""). With the same settings and versions
a run must give the same rows. With others it gives those of another seed, at best, since a rounding changes what is
drawn: RUNS seeds are run that were not recorded, and the golden fails if all of them are on the same side outside of a
spread, which is widened by MARGIN.
"""

import contextlib
import json
import math
import os
import platform
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from llvmlite import binding
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, ValidationError

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import FacetrackError, InputError, reading
from facetrack_cli.core.files import read_bounded, write_new
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.recipe.load import load_recipe, put_gallery
from facetrack_cli.recipe.model import Recipe, completed, to_dict
from facetrack_cli.run_folder.manifest import clip_digest
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import SeedPlan, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.start.init_file import find_init
from facetrack_cli.trajectory.reader import StartRecord, to_record
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.writers import csv_frames
from facetrack_cli.video.source import is_clip

SEEDS, RUNS = 10, 4
UNSEEN: Final = 1000  # the first seed of those that are not recorded
MARGIN: Final = 0.5  # of a spread, to both sides
# what the mean of a quantity may always differ by; with an offset that is relative, and the mean of log(value + offset)
QUANTITIES: Final[Mapping[str, tuple[float, float | None]]] = {
    "x": (0.1, None), "y": (0.1, None), "w": (0.01, 0.0), "h": (0.01, 0.0), "angle": (0.1, None),
    "std_x": (0.03, 0.05), "std_y": (0.03, 0.05), "ess": (0.03, 0.0), "particles": (0.01, 0.0),
    "confidence": (0.02, None), "unseen": (0.03, None), "identity_prob": (0.02, None),
}  # fmt: skip
UPDATE: Final = "record again with --update if that is meant"


class Golden(BaseModel):
    """What was recorded. `recipe` is a shipped name or a path from the folder of clips, `gallery` such a path; `names`
    who each target is at the end, if anybody; `frames` first and last; `checksums` four hexadecimal digits a frame.
    """

    model_config = ConfigDict(allow_inf_nan=False)
    schema_: Literal["facetrack-golden"] = Field(alias="schema")
    version: Literal[4]
    clip: str = Field(pattern=r"^[^/\\]+$")
    sha256: str
    recipe: str
    settings: dict[str, Any]
    gallery: str = ""
    names: dict[str, str] = {}
    start: Annotated[StartRecord, PlainSerializer(lambda start: to_record(start.start_from("")))]
    stop: int | None
    versions: dict[str, str]
    seeds: int = Field(ge=1)
    frames: tuple[int, int]
    checksums: str
    spread: dict[str, dict[str, tuple[float, float]]] = Field(min_length=1)

    @property
    def tracks(self) -> str:
        names = "".join(f", {target} is {name}" for target, name in self.names.items())
        return f"{', '.join(filter(None, self.spread))} in frames {self.frames[0]}-{self.frames[1]}{names}"


class Task(NamedTuple):
    """A golden to check, or to record in place of `golden`; the recipe is a name or a file."""

    path: Path
    clip: Path
    recipe: str
    golden: Golden | None = None


@dataclass(frozen=True)
class Verdict:
    """What came of a task, in a line and further ones; `seconds` are those of the trackers alone."""

    task: Task
    failed: bool = False
    message: str = ""
    details: tuple[str, ...] = ()
    seconds: float = 0.0


def means(run: Trajectory) -> dict[str, dict[str, float]]:
    """The mean of each quantity over the frames after the first, of each part, and of all as ""."""
    after = run.take(run.frame > run.frames[0])
    series = {part.name: part for part in after.parts} | ({"": after} if len(after.parts) > 1 else {})
    result: dict[str, dict[str, float]] = {part: {} for part in series}
    for (part, rows), (quantity, (_, offset)) in product(series.items(), QUANTITIES.items()):
        values: Any = getattr(rows, quantity)
        if (finite := values[np.isfinite(values)]).size:
            logs = None if offset is None else np.log(np.maximum(finite + offset, 1e-9))
            result[part][quantity] = float(finite.mean() if logs is None else np.exp(logs.mean()) - offset)
    return result


def record(folder: Path, plan: SeedPlan, runs: Sequence[Trajectory]) -> Golden:
    """The golden of runs with different seeds, the first with 0."""
    first, recipe, settings = runs[0], plan.recipe, to_dict(plan.recipe)
    gallery = (settings.get("recognition") or {}).get("gallery") or ""
    if Path(gallery).is_file():  # a path from the folder, wherever it was recorded from
        settings["recognition"]["gallery"] = gallery = _beside(folder, Path(gallery))
    measured = [means(run) for run in runs]
    spread: dict[str, dict[str, tuple[float, float]]] = {part: {} for part in measured[0]}
    for part, quantity in product(spread, QUANTITIES):
        if values := [of_run[part][quantity] for of_run in measured if quantity in of_run[part]]:
            spread[part][quantity] = (round(min(values), 4), round(max(values), 4))
    identities = {name: [*filter(None, first.of_target(name)[0].identity.tolist())] for name in first.targets}
    shipped = recipe.path.resolve().parent == shipped_folder().resolve()
    return Golden(
        schema="facetrack-golden", version=4, clip=plan.clip.name, sha256=clip_digest(plan.clip), settings=settings,
        recipe=recipe.name if shipped else _beside(folder, recipe.path), gallery=gallery,
        names={name: those[-1] for name, those in identities.items() if those},
        start=StartRecord.model_validate(to_record(plan.start)), stop=plan.stop, versions=versions(), seeds=len(runs),
        frames=(int(first.frames[0]), int(first.frames[-1])), spread=spread,
        checksums="".join(map(_digits, csv_frames(first))),
    )  # fmt: skip


def _ends(values: tuple[float, float]) -> str:
    return "nowhere" if math.isinf(values[0]) else "..".join(dict.fromkeys(f"{end:.4g}" for end in values))


def _digits(text: str) -> str:
    return f"{zlib.crc32(text.encode()) & 0xFFFF:04x}"


def _beside(folder: Path, file: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def versions() -> dict[str, str]:
    """What the bytes of rows depend on: versions of software, and the processor that it is compiled for."""
    cpu = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    cpu += "-" + _digits(binding.get_host_cpu_features().flatten())
    result = {"facetrack": __version__, "machine": f"{platform.system()} {platform.machine()} {cpu}"}
    for name in ("numpy", "numba", "opencv-python-headless", "opencv-contrib-python-headless", "av"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            result[name] = metadata.version(name)
    return result


def differences(golden: Golden, recipe: Recipe) -> list[str]:
    """Settings and versions that are not as recorded, as `filter.particles 100 -> 200`."""

    def flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
        for key, value in settings.items():
            if isinstance(value, Mapping):
                yield from flat(value, f"{prefix}{key}.")
            elif value is not None and prefix + key not in ("description", "seed", "recognition.gallery"):
                yield f"{prefix}{key}", value[:40] if isinstance(value, str) else json.dumps(value)

    was = dict(flat({**completed(golden.settings), **golden.versions}))
    now = dict(flat({**to_dict(recipe), **versions()}))
    return [f"{k} {was.get(k, 'nothing')} -> {now.get(k, 'nothing')}" for k in was | now if was.get(k) != now.get(k)]


def write_golden(path: Path, golden: Golden) -> None:
    """Write the golden whole or not at all, a member a line; it replaces the one before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    members = golden.model_dump(by_alias=True, exclude_defaults=True).items()
    text = ",\n".join(f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in members)
    write_new(path, f"{{\n{text}\n}}\n".encode(), overwrite=True)


def read_golden(path: Path) -> Golden:
    """Raises InputError, in one line, for a file that is no golden of this version."""
    again = f"record it again with facetrack regress {path.parent.parent} --config RECIPE --update"
    try:
        with reading(path, f"make it readable, or {again}"):
            return Golden.model_validate_json(read_bounded(path, what="golden"))
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        reason = ": ".join(filter(None, [".".join(map(str, first["loc"])), first["msg"]]))
        raise InputError(f"{path}: is no golden: {reason}; {again}") from None


def tasks(folder: Path, recipes: Mapping[str, str], *, update: bool = False) -> list[Task]:
    """The goldens of a folder, only of these `recipes` if there are any: names or files, by their names.

    To `update` those of some recipes, one for each clip with an init file and each recipe, whether recorded or not.
    InputError where there is none.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the folder that holds the clips")
    place = folder / "goldens"
    if update and recipes:
        clips = [path for path in sorted(folder.glob("*")) if (is_clip(path) or path.is_dir()) and find_init(path)]
        if not clips:
            raise InputError(f"{folder}: has no clip with an init file beside it; make one with facetrack init CLIP")
        stems = [clip.stem for clip in clips]
        if twice := next((stem for n, stem in enumerate(stems) if stem in stems[:n]), ""):
            raise InputError(f"{folder}: two clips are called {twice}; rename one, goldens are kept by that name")
        new = [Task(place / f"{clip.stem}.{name}.json", clip, recipes[name]) for clip, name in product(clips, recipes)]
        for i, task in enumerate(new):
            with contextlib.suppress(InputError):  # it may be that there is none yet, or none that can be read
                new[i] = task._replace(golden=read_golden(task.path))
        return new
    goldens = [(path, read_golden(path)) for path in sorted(place.glob("*.json"))]
    there = {Path(golden.recipe).stem: golden.recipe for _, golden in goldens}
    if not goldens or not recipes.keys() <= there.keys():
        absent = ", ".join(sorted(recipes.keys() - there.keys()))
        what = f"no golden of {absent}, only of {', '.join(sorted(there))}" if goldens else "no goldens"
        raise InputError(f"{folder}: has {what}; record some with facetrack regress {folder} --config RECIPE --update")
    use = recipes or {name: str(folder / file) if file.endswith(".yaml") else file for name, file in there.items()}
    named = ((Path(golden.recipe).stem, path, golden) for path, golden in goldens)
    return [Task(path, folder / golden.clip, use[name], golden) for name, path, golden in named if name in use]


def regress(
    folder: Path, asked: Sequence[Task], *, update: bool = False, overrides: Sequence[str] = (),
    stop: int | None = None, gallery: Path | None = None, stopped: Stop | None = None, **how: Any,
) -> Iterator[Verdict]:  # fmt: skip
    """Check goldens, or `update` them, in their order; fewer once `stopped` says so. `how` is told to `run_plans`.

    `overrides` are set in all recipes. Those that recognise know the people of `gallery`, else of the golden's, else
    their own. A golden is recorded up to the frame `stop`, else that of the golden before it.
    """
    stopped, plans, refused = stopped or Stop(), dict[Path, SeedPlan](), dict[Path, FacetrackError]()
    for task in asked:
        golden = task.golden
        try:
            recipe = load_recipe(task.recipe, overrides, installed=False)
            people = gallery or (folder / golden.gallery if golden and golden.gallery else None)
            if people is not None and any(each.recognition for each in recipe.filters.values()):
                recipe = put_gallery(recipe, str(people))
            if update or golden is None:
                clip = ClipRequest(task.clip, stop=stop or (golden.stop if golden else None))
                start = replace(clip.find(recipe, stopped=stopped), detector="", placed=False)  # cascades are anywhere
                until, seeds = clip.stop, range(SEEDS)
            elif clip_digest(task.clip) != golden.sha256:
                raise InputError(f"the clip {task.clip} is not the one recorded; put that one back, or {UPDATE}")
            else:
                start, until = golden.start.start_from(str(task.path)), golden.stop
                seeds = range(UNSEEN, UNSEEN + RUNS) if differences(golden, recipe) else range(1)
            tried = tuple(seeds) if recipe.random else (0,)
            plans[task.path] = SeedPlan(task.path.stem, task.clip, recipe, start, tried, until)
        except FacetrackError as e:
            if str(e).startswith("--set"):  # a mistake in the option is no regression
                raise
            refused[task.path] = e
    with contextlib.closing(run_plans([*plans.values()], stopped=stopped, **how)) as ends:
        for task in asked:
            ended = next(ends, None) if task.path in plans else None
            if stopped():
                return
            error = ended.error if ended else refused[task.path]
            if ended is None or error is not None:
                yield Verdict(task, True, str(error))
                continue
            now = record(folder, ended.plan, [run.trajectory for run in ended.runs])
            if update or task.golden is None:
                write_golden(task.path, now)
                yield Verdict(task, message=f"wrote {task.path} ({len(ended.runs)} seeds)")
            else:
                seconds = sum(len(run.trajectory.frames) / run.frames_per_s for run in ended.runs)
                changed = differences(task.golden, ended.plan.recipe)
                yield compared(Verdict(task, seconds=seconds), task.golden, now, changed)


def compared(verdict: Verdict, golden: Golden, now: Golden, changed: list[str]) -> Verdict:
    """The verdict on what is recorded `now`; `changed` are the `differences` of recipe and versions."""
    if (was := golden.tracks) != now.tracks:
        return replace(verdict, failed=True, message=f"tracks {now.tracks}; recorded were {was}; {UPDATE}")
    far: list[tuple[float, str]] = []
    for part, (quantity, (least, offset)) in product(golden.spread, QUANTITIES.items()):
        if (band := golden.spread[part].get(quantity)) is not None:
            least *= 1 if offset is None else abs(band[1]) + offset + 1e-3
            least *= 1 if golden.seeds > 1 else 10  # a deterministic tracker has no spread over seeds
            half = (band[1] - band[0]) * (0.5 + MARGIN) + least
            ends = now.spread[part].get(quantity, (math.inf, math.inf))
            text = f"{part or 'all parts'}: mean {quantity} {_ends(ends)}, of recorded seeds {_ends(band)}"
            far.append((max(ends[0] - sum(band) / 2, sum(band) / 2 - ends[1], 0.0) / half, text))
    off = [text for share, text in sorted(far, reverse=True) if share > 1][:3]
    note = f"not as recorded: {', '.join(changed)}"
    if not changed:
        sums = zip(*(re.findall("....", each.checksums) for each in (golden, now)), strict=False)
        other = next((golden.frames[0] + i for i, (was, own) in enumerate(sums) if was != own), None)
        if other is None:
            return replace(verdict, message="the same rows")
        first = f"other rows than recorded from frame {other} on, by the same recipe and versions"
        off = [first, *(off or ["they are within the spread of seeds"])]
    elif off:
        off.append(f"{note}; {UPDATE}")
    else:
        share = f"at {100 * max(far)[0]:.0f} % of the spread of {golden.seeds} seeds"
        return replace(verdict, message=share, details=(note,))
    return replace(verdict, failed=True, message=off[0], details=tuple(off[1:]))
