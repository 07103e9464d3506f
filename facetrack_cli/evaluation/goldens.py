"""Goldens: rows of a recipe's run on a clip, with which later runs are compared; what `facetrack regress` does.

A golden is of a run with seed 0: a checksum of the rows of each frame, and the places in ROWS frames, each with the
distance of the farthest of the other recorded seeds. `spread` is the range over all recorded seeds of the mean of each
quantity after the first frame, of each part and of all parts ("").

With the settings and versions that it was recorded with, a run must give the same rows. With others it gives those of
another seed, at best, since a rounding changes what is drawn: RUNS seeds are run that were not recorded, and the golden
fails if all of them are on the same side outside of a spread, or farther from a row than any recorded seed; both are
widened by MARGIN.
"""

import contextlib
import json
import math
import os
import platform
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np
from llvmlite import binding
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, ValidationError

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import FacetrackError, InputError, UsageError, flat, reading
from facetrack_cli.core.files import read_bounded, write_new
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.types import Array
from facetrack_cli.core.yaml_tree import YamlProblems
from facetrack_cli.recipe.load import files_of, load_recipe, put_gallery
from facetrack_cli.recipe.model import OpenCvRecipe, Recipe, completed, to_dict
from facetrack_cli.run_folder.manifest import clip_digest
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import SeedPlan, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.init_file import find_init
from facetrack_cli.trackers.opencv import find as find_opencv
from facetrack_cli.trajectory.reader import StartRecord, to_record
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.writers import csv_frames

SEEDS, RUNS, ROWS = 10, 4, 16
UNSEEN: Final = 1000  # the first seed of those that are not recorded
MARGIN: Final = 0.5  # of a spread, to both sides
LEAST_PX: Final = 0.5  # that a row may always be off
# what the mean of a quantity may always differ by; with an offset that is relative, and the mean of log(value + offset)
QUANTITIES: Final[Mapping[str, tuple[float, float | None]]] = {
    "x": (0.1, None), "y": (0.1, None), "w": (0.01, 0.0), "h": (0.01, 0.0), "angle": (0.1, None),
    "std_x": (0.03, 0.05), "std_y": (0.03, 0.05), "ess": (0.03, 0.0), "particles": (0.01, 0.0),
    "confidence": (0.02, None), "unseen": (0.03, None), "identity": (0.02, None),
}  # fmt: skip
UPDATE: Final = "record again with --update if that is meant"
NO_CLIPS: Final = (".csv", ".json", ".md", ".py", ".txt", ".yaml", ".yml")


class Golden(BaseModel):
    """What was recorded, as the file holds it.

    `recipe` is a shipped name or a path from the folder of clips, `gallery` such a path; `files` are checksums of what
    the recipe names; `names` who each target is, if anybody; `frames` first and last; `checksums` four hexadecimal
    digits a frame; `rows` frame, part, x, y, and how far other seeds are.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    schema_: Literal["facetrack-golden"] = Field(alias="schema")
    version: Literal[3]
    clip: str = Field(pattern=r"^[^/\\]+$")
    sha256: str
    recipe: str
    settings: dict[str, Any]
    gallery: str = ""
    files: dict[str, str] = {}
    names: dict[str, str] = {}
    start: Annotated[StartRecord, PlainSerializer(lambda start: to_record(start.start_from("")))]
    stop: int | None
    versions: dict[str, str]
    seeds: int = Field(ge=1)
    frames: tuple[int, int]
    checksums: str
    spread: dict[str, dict[str, tuple[float, float]]] = Field(min_length=1)
    rows: list[tuple[int, str, float, float, float]]


class Task(NamedTuple):
    """A golden to check, or to record in place of `golden`; the recipe is a name or a file."""

    path: Path
    clip: Path
    recipe: str
    golden: Golden | None


@dataclass(frozen=True)
class Verdict:
    """What came of a task: `message` is a line, `details` are further lines, `seconds` are those of the trackers alone.

    "skipped": the clip lacks what the recipe follows. `farthest`: above 1 outside of the spread.
    """

    golden: Path
    clip: str
    recipe: str
    status: Literal["ok", "fails", "skipped"] = "ok"
    message: str = ""
    details: tuple[str, ...] = ()
    seconds: float = 0.0
    seeds: int = 0
    farthest: float | None = None


class _SkippedError(FacetrackError):
    """The clip lacks what the recipe follows, or this installation has no such tracker."""


def means(run: Trajectory, names: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """The mean of each quantity over the frames after the first, of each part, and of all as "".

    Identity is the probability of the target's name in `names`, 0 in frames where another is more likely.
    """
    after = run.take(run.frame > run.frames[0])
    series = {part.name: part for part in after.parts} | ({"": after} if len(after.parts) > 1 else {})
    result: dict[str, dict[str, float]] = {part: {} for part in series}
    for (part, rows), (quantity, (_, offset)) in product(series.items(), QUANTITIES.items()):
        values: Any = getattr(rows, quantity)
        if quantity == "identity":
            named = np.array([names.get(target, "") for target, _ in rows.names])[rows.which]
            values = np.where(values == "", np.nan, np.where(values == named, rows.identity_prob, 0.0))
        if (finite := values[np.isfinite(values)]).size:
            logs = None if offset is None else np.log(np.maximum(finite + offset, 1e-9))
            result[part][quantity] = float(finite.mean() if logs is None else np.exp(logs.mean()) - offset)
    return result


def distances(run: Trajectory, rows: Sequence[tuple[int, str, float, float, float]]) -> Array:
    """(R,): how far the run is from these rows, in px; infinite where it has no place."""
    parts = {part.name: part for part in run.parts}
    own = [(parts[part].at(frame), x, y) for frame, part, x, y, _ in rows]
    return np.nan_to_num([math.hypot(row.x[0] - x, row.y[0] - y) for row, x, y in own], nan=math.inf)


def record(
    folder: Path, plan: SeedPlan, runs: Sequence[Trajectory], people: Path | None, names: Mapping[str, str] | None
) -> Golden:
    """The golden of runs with different seeds, the first with 0, that know `people`.

    The probability of `names` is measured, of None that of the names with which the first run ends.
    """
    recipe, (first, *others), settings, gallery = plan.recipe, runs, to_dict(plan.recipe), ""
    if people is not None and settings.get("recognition"):  # a path from the folder, wherever it was recorded from
        settings["recognition"]["gallery"] = gallery = _beside(folder, people)
    if names is None:
        ends = {target: [*filter(None, first.of_target(target)[0].identity.tolist())] for target in first.targets}
        names = {target: identities[-1] for target, identities in ends.items() if identities}
    measured = [means(run, names) for run in runs]
    spread: dict[str, dict[str, tuple[float, float]]] = {part: {} for part in measured[0]}
    for part, quantity in product(spread, QUANTITIES):
        if values := [of_run[part][quantity] for of_run in measured if quantity in of_run[part]]:
            spread[part][quantity] = (round(min(values), 4), round(max(values), 4))
    frames = first.frames.tolist()
    kept = sorted({frames[round(i * (len(frames) - 1) / ROWS)] for i in range(1, ROWS + 1)})
    places = [(frame, part.name, *part.at(frame).x, *part.at(frame).y, 0.0) for frame in kept for part in first.parts]
    places = [row for row in places if math.isfinite(row[2])]
    reach = np.max([np.zeros(len(places)), *(distances(run, places) for run in others)], axis=0)
    rows = [(*row[:2], *np.round(row[2:4], 3), min(round(far, 2), 1e4)) for row, far in zip(places, reach, strict=True)]
    shipped = recipe.path.resolve().parent == shipped_folder().resolve()
    return Golden(
        schema="facetrack-golden", version=3, clip=plan.clip.name, sha256=clip_digest(plan.clip), settings=settings,
        recipe=recipe.name if shipped else _beside(folder, recipe.path), gallery=gallery, files=_files(recipe),
        names=dict(names), start=StartRecord.model_validate(to_record(plan.start)), stop=plan.stop,
        versions=versions(), seeds=len(runs), frames=(frames[0], frames[-1]), spread=spread, rows=rows,
        checksums="".join(map(_digits, csv_frames(first))),
    )  # fmt: skip


def _ends(values: Sequence[float] | Array) -> str:
    if not np.isfinite(values).all():
        return "nowhere"
    return "..".join(dict.fromkeys(f"{end:.4g}" for end in (min(values), max(values))))


def _digits(text: str) -> str:
    return f"{zlib.crc32(text.encode()) & 0xFFFF:04x}"


def _beside(folder: Path, file: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def _files(recipe: Recipe) -> dict[str, str]:
    try:
        return {path.name: clip_digest(path) for path in files_of(recipe)}
    except YamlProblems:  # one is not there: the run says so
        return {}


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
    """Settings, files and versions that are not as recorded, as `filter.particles 100 -> 200`."""

    def flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
        for key, value in settings.items():
            if isinstance(value, Mapping):
                yield from flat(value, f"{prefix}{key}.")
            elif value is not None and prefix + key not in ("description", "seed", "recognition.gallery"):
                yield f"{prefix}{key}", value[:40] if isinstance(value, str) else json.dumps(value)

    was = dict(flat({**completed(golden.settings), **golden.files, **golden.versions}))
    now = dict(flat({**to_dict(recipe), **_files(recipe), **versions()}))
    return [f"{k} {was.get(k, 'nothing')} -> {now.get(k, 'nothing')}" for k in was | now if was.get(k) != now.get(k)]


def write_golden(path: Path, golden: Golden) -> None:
    """Write the golden whole or not at all, a line for each part's spread and each row; it replaces the one before."""
    texts = {key: json.dumps(value) for key, value in golden.model_dump(by_alias=True, exclude_defaults=True).items()}
    spread = [f"{json.dumps(part)}: {json.dumps(bands)}" for part, bands in golden.spread.items()]
    for key, lines, ends in (("spread", spread, "{}"), ("rows", map(json.dumps, golden.rows), "[]")):
        texts[key] = ends[0] + "\n    " + ",\n    ".join(lines) + "\n  " + ends[1]
    path.parent.mkdir(parents=True, exist_ok=True)
    text = ",\n".join(f'  "{key}": {value}' for key, value in texts.items())
    write_new(path, f"{{\n{text}\n}}\n".encode(), overwrite=True)


def read_golden(path: Path) -> Golden:
    """Raises InputError, in one line, for a file that is no golden of this version."""
    again = "record it again with facetrack regress --update"
    try:
        with reading(path, f"make it readable, or {again}"):
            golden = Golden.model_validate_json(read_bounded(path, what="golden"))
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        place = "".join(f"{step}." for step in first["loc"])[:-1]
        raise InputError(f"{path}: is no golden: {place + ': ' if place else ''}{first['msg']}; {again}") from None
    for frame, part, *_ in golden.rows:
        if not part or part not in golden.spread or not golden.frames[0] <= frame <= golden.frames[1]:
            raise InputError(f"{path}: is no golden: it has no spread of {part}, or no frame {frame}; {again}")
    return golden


def tasks(folder: Path, recipes: Mapping[str, str], *, update: bool = False) -> list[Task]:
    """The goldens of a folder, only of these `recipes` if there are any: names or files, by their names.

    To `update` those of some recipes, one for each clip with an init file and each recipe, whether recorded or not.
    InputError where there is none.
    """
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "there is no such folder"
        raise InputError(f"{folder}: {what}; name the folder that holds the clips")
    place = folder / "goldens"
    if update and recipes:
        clips = [path for path in sorted(folder.iterdir()) if path.suffix.lower() not in NO_CLIPS and find_init(path)]
        if not clips:
            raise InputError(f"{folder}: has no clip with an init file beside it; make one with facetrack init CLIP")
        stems = [clip.stem for clip in clips]
        if twice := [stem for stem in stems if stems.count(stem) > 1]:
            raise UsageError(f"{folder}: two clips are called {twice[0]}; rename one, goldens are kept by that name")
        new = []
        for clip, (name, recipe) in product(clips, recipes.items()):
            new.append(Task(place / f"{clip.stem}.{name}.json", clip, recipe, None))
            with contextlib.suppress(InputError):  # it may be that there is none yet, or none that can be read
                new[-1] = new[-1]._replace(golden=read_golden(new[-1].path))
        return new
    goldens = [(path, read_golden(path)) for path in sorted(place.glob("*.json"))]
    recorded = {Path(golden.recipe).stem: golden.recipe for _, golden in goldens}
    if not goldens:
        remedy = f"record some with facetrack regress {folder} --config RECIPE --update"
        raise InputError(f"{folder}: has no goldens; {remedy}")
    if absent := [name for name in recipes if name not in recorded]:
        there = f"has no golden of {absent[0]}, only of {', '.join(sorted(recorded))}"
        raise InputError(f"{folder}: {there}; record it with --update")
    use = recipes or {name: str(folder / file) if file.endswith(".yaml") else file for name, file in recorded.items()}
    named = ((path, golden, use.get(Path(golden.recipe).stem)) for path, golden in goldens)
    return [Task(path, folder / golden.clip, recipe, golden) for path, golden, recipe in named if recipe is not None]


def regress(
    folder: Path, asked: Sequence[Task], *, update: bool = False, overrides: Sequence[str] = (), seeds: int = SEEDS,
    stop: int | None = None, gallery: Path | None = None, stopped: Stop | None = None, **how: Any,
) -> Iterator[Verdict]:  # fmt: skip
    """Check goldens, or `update` them, in their order; fewer once `stopped` says so. `how` is told to `run_plans`.

    `overrides` are set in all recipes. Those that recognise know the people of `gallery`, else of the golden's, else
    their own. A golden is recorded from `seeds` runs up to the frame `stop`, else that of the golden before it.
    """
    stopped, plans = stopped or Stop(), list[SeedPlan]()
    prepared: list[tuple[Task, Path | None, FacetrackError | None]] = []
    for task in asked:
        people, error = gallery or (folder / task.golden.gallery if task.golden and task.golden.gallery else None), None
        try:
            plans.append(_plan(task, people, overrides, update, seeds, stop, stopped))
        except FacetrackError as e:
            if str(e).startswith("--set"):  # a mistake in the option is no regression
                raise
            error = e
        prepared.append((task, people, error))
        if stopped():
            return
    with contextlib.closing(run_plans(plans, stopped=stopped, **how)) as ends:
        for task, people, error in prepared:
            ended = None if error else next(ends, None)
            if stopped():
                return
            error = ended.error if ended else error
            verdict = Verdict(task.path, task.clip.name, task.path.stem[len(task.clip.stem) + 1 :])
            if ended is None or error is not None:
                status: Any = "skipped" if isinstance(error, _SkippedError) else "fails"
                yield replace(verdict, status=status, message=str(error))
                continue
            runs, golden = [run.trajectory for run in ended.runs], None if update else task.golden
            now = record(folder, ended.plan, runs, people, golden.names if golden else None)
            if golden is None:
                write_golden(task.path, now)
                yield replace(verdict, message=f"wrote {task.path} ({len(runs)} seeds)")
            else:
                seconds = sum(len(run.trajectory.frames) / run.frames_per_s for run in ended.runs)
                verdict = replace(verdict, seconds=seconds, seeds=len(runs))
                yield compared(verdict, golden, now, differences(golden, ended.plan.recipe), runs)


def _plan(
    task: Task, people: Path | None, overrides: Sequence[str], update: bool, seeds: int, stop: int | None, stopped: Stop
) -> SeedPlan:
    recipe, golden = load_recipe(task.recipe, overrides, installed=False), task.golden
    if isinstance(recipe, OpenCvRecipe) and find_opencv(recipe.tracker) is None:
        there = f"the installed OpenCV has no {recipe.tracker.upper()} tracker"
        raise _SkippedError(f"{there}; opencv-contrib-python-headless has")
    if people is not None and any(each.recognition for each in recipe.filters.values()):
        if not people.is_file():
            raise InputError(f"the gallery {people} is not there; put it back, or name another with --gallery")
        recipe = put_gallery(recipe, str(people))
    if update or golden is None:
        clip = ClipRequest(task.clip, stop=stop or (golden.stop if golden else None))
        start = replace(clip.find(recipe, stopped=stopped), detector="", placed=False)  # cascades are on any machine
        with clip.open() as source:
            try:
                tracker_for(recipe, start, source.size, source.fps)
            except InputError as e:
                raise _SkippedError(str(e)) from None
        tried = tuple(range(seeds if recipe.random else 1))
        return SeedPlan(task.path.stem, task.clip, recipe, start, tried, clip.stop)
    if not task.clip.exists():
        raise InputError(f"the clip {task.clip} is not there; put it back, or remove {task.path}")
    if clip_digest(task.clip) != golden.sha256:
        raise InputError(f"the clip {task.clip} is not the one recorded; restore it, or {UPDATE}")
    other = recipe.random and differences(golden, recipe)
    tried = tuple(range(UNSEEN, UNSEEN + RUNS)) if other else (0,)
    return SeedPlan(task.path.stem, task.clip, recipe, golden.start.start_from(str(task.path)), tried, golden.stop)


def compared(verdict: Verdict, golden: Golden, now: Golden, changed: list[str], runs: Sequence[Trajectory]) -> Verdict:
    """The verdict on runs, of which `now` is recorded; `changed` are the `differences` of recipe and versions."""
    parts, own = ([part for part in each.spread if part] for each in (golden, now))
    if parts != own or golden.frames != now.frames:
        texts = (f"{', '.join(p)} in frames {f[0]}-{f[1]}" for p, f in ((own, now.frames), (parts, golden.frames)))
        return replace(verdict, status="fails", message=f"tracks {'; recorded were '.join(texts)}; {UPDATE}")
    rows, spreads, away = [], [], np.stack([distances(run, golden.rows) for run in runs])
    loose = 1 if any(reach for *_, reach in golden.rows) else 10  # a deterministic tracker has no spread over seeds
    for (frame, part, *_, reach), each in zip(golden.rows, away.T, strict=True):
        text = f"{part}: {_ends(each)} px from its golden row of frame {frame}, recorded seeds up to {reach:.4g} px"
        rows.append((float(each.min()) / (reach * (1 + MARGIN) + LEAST_PX * loose), text))
    for part, (quantity, (least, offset)) in product(golden.spread, QUANTITIES.items()):
        if (band := golden.spread[part].get(quantity)) is not None:
            least *= 1 if offset is None else abs(band[1]) + offset + 1e-3
            half = (band[1] - band[0]) * (0.5 + MARGIN) + loose * least
            ends = now.spread[part].get(quantity, (math.inf, math.inf))
            far = max(ends[0] - sum(band) / 2, sum(band) / 2 - ends[1], 0.0) / half
            text = f"{part or 'all parts'}: mean {quantity} {_ends(ends)}, of recorded seeds {_ends(band)}"
            spreads.append((far, text))
    spreads.sort(reverse=True)
    off = [text for far, text in rows if far > 1][:1] + [text for far, text in spreads if far > 1][:3]
    notes = [f"not as recorded: {', '.join(changed)}"] if changed else []
    farthest = min(max(far for far, _ in rows + spreads), 1e6)
    verdict = replace(verdict, farthest=farthest, details=tuple(notes))
    if not changed:
        sums = zip(*(re.findall("....", each.checksums) for each in (golden, now)), strict=False)
        others = [golden.frames[0] + i for i, (was, own) in enumerate(sums) if was != own]
        others += [was[0] for was, own in zip(golden.rows, now.rows, strict=False) if was[:4] != own[:4]]
        if not others:
            return replace(verdict, message="the same rows")
        first = f"other rows than recorded from frame {min(others)} on, by the same recipe and versions"
        off = [first, *(off or ["they are within the spread of seeds"])]
    if not off:
        return replace(verdict, message=f"at {100 * farthest:.0f} % of the spread of {golden.seeds} seeds")
    return replace(
        verdict, status="fails", message=off[0], details=(*off[1:], *(f"{note}; {UPDATE}" for note in notes))
    )


def counts(verdicts: Sequence[Verdict]) -> dict[str, int]:
    return {status: sum(verdict.status == status for verdict in verdicts) for status in ("ok", "fails", "skipped")}


def as_json(verdicts: Sequence[Verdict]) -> str:
    results = [{**asdict(verdict), "golden": str(verdict.golden)} for verdict in verdicts]
    whole = {"schema": "facetrack-regress", "version": 3, **counts(verdicts), "results": results}
    return json.dumps(whole, indent=2) + "\n"


def as_junit(verdicts: Sequence[Verdict]) -> str:
    """JUnit XML: a test case for each golden, the clip is its class, the recipe its name."""
    many, root = counts(verdicts), ElementTree.Element("testsuites")
    about = {"tests": str(len(verdicts)), "failures": str(many["fails"]), "skipped": str(many["skipped"])}
    suite = ElementTree.SubElement(root, "testsuite", {"name": "facetrack regress", **about, "errors": "0"})
    for verdict in verdicts:  # XML cannot hold control characters
        clip, recipe, *lines = map(flat, (verdict.clip, verdict.recipe, verdict.message, *verdict.details))
        about = {"classname": clip, "name": recipe, "time": f"{verdict.seconds:.3f}"}
        case = ElementTree.SubElement(suite, "testcase", about)
        if kind := {"fails": "failure", "skipped": "skipped"}.get(verdict.status):
            ElementTree.SubElement(case, kind, {"message": lines[0]}).text = "\n".join(lines)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
