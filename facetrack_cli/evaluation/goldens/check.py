"""Clips checked against their goldens, and goldens recorded: what `facetrack regress` does, a result at a time."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.evaluation.goldens.bands import Deviation, judge, last_names, measure, names
from facetrack_cli.evaluation.goldens.goldens import (
    FIRST_SEED,
    Golden,
    beside,
    checksum,
    differences,
    find_goldens,
    golden_path,
    read_golden,
    record,
    versions,
    write_golden,
)
from facetrack_cli.recipe.gallery_option import put
from facetrack_cli.recipe.load import load_recipe, resolve_file
from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, Recipe, completed, to_dict
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import Report, SeedPlan, SeedRun, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.start.init_file import find_init
from facetrack_cli.trackers.opencv import find as find_opencv
from facetrack_cli.trajectory.trajectory import Trajectory

Status: TypeAlias = Literal["ok", "fails", "skipped"]
NO_CLIPS = (".csv", ".json", ".md", ".py", ".txt", ".yaml", ".yml")
UPDATE = "record again with --update if that is meant"


@dataclass(frozen=True)
class Checked:
    """The result of checking or recording a golden: `message` is a line, `details` are further lines.

    "skipped": it cannot be run here, and nothing is wrong. `seconds` are those of the trackers alone. `farthest`: the
    farthest statistic, above 1 outside of its band.
    """

    golden: Path
    clip: str
    recipe: str
    status: Status
    message: str
    details: tuple[str, ...] = ()
    seconds: float = 0.0
    seeds: int = 0
    farthest: float | None = None
    deviations: tuple[Deviation, ...] = ()


class _SkippedError(FacetrackError):
    """Why a golden cannot be run or recorded here, although nothing is wrong."""


class _Job(NamedTuple):
    golden: Path
    clip: str
    recipe: str
    prepare: Callable[[], SeedPlan]
    finish: Callable[[SeedPlan, Sequence[SeedRun]], Checked]


def _run(jobs: Sequence[_Job], workers: int, stopped: Stop | None, report: Report) -> Iterator[Checked]:
    """The results of jobs, in their order; fewer once `stopped` says so."""
    stopped = stopped or Stop()
    prepared: list[SeedPlan | FacetrackError] = []
    for job in jobs:
        try:
            prepared.append(job.prepare())
        except FacetrackError as e:
            prepared.append(e)
        if stopped():
            return
    with closing(run_plans([one for one in prepared if isinstance(one, SeedPlan)], workers, stopped, report)) as runs:
        for job, one in zip(jobs, prepared, strict=True):
            ended = next(runs, None) if isinstance(one, SeedPlan) else None
            if stopped():
                return
            error = ended.error if ended is not None else one
            if isinstance(error, FacetrackError):
                status: Status = "skipped" if isinstance(error, _SkippedError) else "fails"
                yield Checked(job.golden, job.clip, job.recipe, status, str(error))
            elif ended is not None:
                yield job.finish(ended.plan, ended.runs)


def _check_runs_here(recipe: Recipe) -> None:
    if isinstance(recipe, OpenCvRecipe) and find_opencv(recipe.tracker) is None:
        raise _SkippedError(
            f"the installed OpenCV has no {recipe.tracker.upper()} tracker; opencv-contrib-python-headless has"
        )


def _gallery(recipe: Recipe) -> Path | None:
    """The gallery of a recipe, if it names one; RecipeError if there is no such file."""
    if not isinstance(recipe, ParticleRecipe) or recipe.recognition is None or recipe.recognition.gallery is None:
        return None
    return resolve_file(recipe, recipe.recognition.gallery, "recognition.gallery")


def _recognising(recipe: Recipe, folder: Path, golden: Golden | None, gallery: Path | None) -> Recipe:
    """A recipe that recognises with `gallery`, else with its own gallery, else with that of the golden."""
    if gallery is None and golden is not None and golden.gallery is not None and _gallery(recipe) is None:
        gallery = folder / golden.gallery.file
    if gallery is None or not isinstance(recipe, ParticleRecipe) or recipe.recognition is None:
        return recipe
    if not gallery.is_file():
        raise InputError(f"the gallery {gallery} is not there; put it back, or name another with --gallery")
    return put(recipe, str(gallery))


def _identities(recorded: Mapping[str, str], tables: Sequence[Trajectory]) -> str:
    """With which names runs end, as `grace in 4 of 4`, and of which target if there are several; "" for nobody."""
    counted = last_names(tables)
    targets, found = dict.fromkeys([*recorded, *counted]), []
    for target in targets:
        counts = counted.get(target, Counter())
        each = [f"{name} in {counts[name]} of {len(tables)}" for name in sorted(counts, key=lambda n: (-counts[n], n))]
        found.append((f"{target}: " if len(targets) > 1 else "") + (", ".join(each) or "nobody"))
    return "; ".join(found)


def select(folder: Path, recipes: Sequence[Recipe]) -> list[tuple[Path, Golden]]:
    """The goldens of a folder, only those of these recipes if any are given.

    Raises InputError where there are none, or where one cannot be read.
    """
    goldens = [(path, read_golden(path)) for path in find_goldens(folder)]
    if not goldens:
        raise InputError(
            f"{folder}: has no goldens; record some with facetrack regress {folder} --config RECIPE --update"
        )
    known = {golden.recipe_name for _, golden in goldens}
    wanted = {recipe.name: recipe for recipe in recipes} or known
    for name in wanted:
        if name not in known:
            raise InputError(
                f"{folder}: has no golden of {name}, only of {', '.join(sorted(known))}; record it with --update"
            )
    return [(path, golden) for path, golden in goldens if golden.recipe_name in wanted]


def check(
    folder: Path,
    goldens: Sequence[tuple[Path, Golden]],
    recipes: Sequence[Recipe] = (),
    overrides: Sequence[str] = (),
    *,
    gallery: Path | None = None,
    first_seed: int = 0,
    workers: int = 1,
    stopped: Stop | None = None,
    report: Report = lambda done, total: None,
) -> Iterator[Checked]:
    """Run the clip of every golden and judge the runs, in their order; fewer results once `stopped` says so.

    `recipes` are taken in place of the goldens' own of the same name, `overrides` are set in these, and `gallery` is
    taken in place of theirs. Seeds count from `first_seed`.
    """
    given = {recipe.name: recipe for recipe in recipes}

    def prepare(path: Path, golden: Golden) -> SeedPlan:
        clip = folder / golden.clip.file
        if not clip.exists():
            raise InputError(f"the clip {clip} is not there; put it back, or remove {path}")
        if checksum(clip) != golden.clip.sha256:
            raise InputError(f"the clip {clip} is not the one recorded; restore it, or {UPDATE}")
        recipe = given.get(golden.recipe_name) or load_recipe(golden.recipe_from(folder), overrides, installed=False)
        recipe = _recognising(recipe, folder, golden, gallery)
        _check_runs_here(recipe)
        seeds = (*range(first_seed, first_seed + golden.tested), first_seed)  # the first seed must repeat its run
        return SeedPlan(path.stem, clip, recipe, golden.start.start_from(str(path)), seeds, golden.stop)

    jobs = []
    for path, golden in goldens:
        make, finish = partial(prepare, path, golden), partial(_compare, path, golden)
        jobs.append(_Job(path, golden.clip.file, golden.recipe_name, make, finish))
    return _run(jobs, workers, stopped, report)


def _compare(path: Path, golden: Golden, plan: SeedPlan, runs: Sequence[SeedRun]) -> Checked:
    *runs, again = runs
    tables = [run.trajectory for run in runs]
    seconds = sum(len(run.trajectory.frames) / run.frames_per_s for run in runs)
    changed = differences(completed(golden.settings), to_dict(plan.recipe))
    notes = [f"recipe differs from the golden's: {', '.join(changed)}; {UPDATE}"] if changed else []
    gallery = _gallery(plan.recipe)
    if golden.gallery is not None and gallery is not None and checksum(gallery) != golden.gallery.sha256:
        notes.append(f"the gallery {gallery} is not the one recorded, {golden.gallery.file}; {UPDATE}")
    result = partial(Checked, path, golden.clip.file, golden.recipe_name, seconds=seconds, seeds=len(runs))
    if shape := _other_shape(golden, tables[0]):
        return result("fails", shape, tuple(notes))
    columns = [(getattr(tables[0], name), getattr(again.trajectory, name)) for name in ("x", "y", "confidence")]
    if not all(np.array_equal(*both, equal_nan=True) for both in columns):
        return result("fails", f"two runs with seed {again.seed} differ: the tracker does not repeat", tuple(notes))
    who = _identities(golden.names, tables)
    statistics = [band.statistic for band in golden.bands]
    farthest, left = judge(golden.bands, measure(tables, statistics, golden.names))
    if not left:
        message = f"the farthest statistic is at {100 * farthest:.0f} % of its band{who and '; ' + who}"
        return result("ok", message, tuple(notes), farthest=farthest)
    first = [one.band.first for one in left if one.band.quantity in ("x", "y") and one.band.series]
    shown = [left[0], *([left[-1]] if left[-1].band.series == "" and len(left) > 1 else [])]
    lines = []
    for one in shown:
        part = golden.short(one.band.series) if one.band.series else "all parts"
        lines.append(f"frames {one.band.first}-{one.band.last}, {part}: {one}")
    lines.insert(1, f"positions are off from frame {min(first)} on" if first else "positions are as recorded")
    if names(tables) != golden.names or any(one.band.quantity == "identity" for one in left):
        recorded = ", ".join(golden.names.values() if len(golden.names) == 1 else map(": ".join, golden.names.items()))
        lines.append(f"recorded was {recorded or 'nobody'}; now it is {who or 'nobody'}")
    now = versions()
    other = [f"{key} {was} -> {now.get(key, 'none')}" for key, was in golden.versions.items() if now.get(key) != was]
    if other:
        notes.append(f"other versions than recorded with: {', '.join(other)}")
    message = f"{lines[0]} (of {golden.seeds} seeds)"
    return result("fails", message, (*lines[1:], *notes), farthest=farthest, deviations=tuple(left))


def _other_shape(golden: Golden, table: Trajectory) -> str:
    first, last = golden.frames
    frames, series = table.frames.tolist(), [one.name for one in table.parts]
    if frames != list(range(first, last + 1)):
        return f"tracked frames {frames[0]}-{frames[-1]}, recorded were {first}-{last}; {UPDATE}"
    if series != golden.parts:
        return f"tracks {', '.join(series)}, recorded were {', '.join(golden.parts)}; {UPDATE}"
    return ""


def update(
    folder: Path,
    configs: Sequence[str],
    seeds: int,
    stop: int | None = None,
    *,
    gallery: Path | None = None,
    workers: int = 1,
    stopped: Stop | None = None,
    report: Report = lambda done, total: None,
) -> Iterator[Checked]:
    """Record goldens: of every clip with an init file and these recipes, or of those that are there if none is given.

    Recipes that recognise take `gallery`; where it is None, their own, or that of the golden that is replaced. Each
    file is written when its runs have ended, and replaces the one before. InputError where nothing is to be recorded.
    """
    for config in configs:
        load_recipe(config, installed=False)  # a wrong one is refused before anything runs

    def prepare(clip: Path, config: str, known: Golden | None) -> SeedPlan:
        recipe = _recognising(load_recipe(config, installed=False), folder, known, gallery)
        _check_runs_here(recipe)
        last = known.stop if known is not None and not configs and stop is None else stop
        start = ClipRequest(clip, stop=last).find(recipe, stopped=stopped or Stop())
        start = replace(start, detector="", placed=False)  # the cascades are there wherever goldens are checked
        boxed = all(target.box for target in start.targets.values())
        missing = [part for part in recipe.points if any(part not in one.points for one in start.targets.values())]
        why = ""
        if missing:
            why = f"has no point for {', '.join(missing)}, which the recipe follows"
            why += "; a recipe of regions, as contour_histogram, follows its boxes" if boxed else ""
        elif not recipe.points and not boxed:
            why = "has no box, which the recipe follows; one of points, as factorized, may do"
        if why:
            raise _SkippedError(f"{start.origin}: {why}")
        numbers = tuple(range(FIRST_SEED, FIRST_SEED + seeds))
        return SeedPlan(f"{clip.stem}.{recipe.name}", clip, recipe, start, numbers, last)

    jobs = []
    for clip, config, known in _asked(folder, configs):
        name = Path(config).name.removesuffix(".yaml")
        make, finish = partial(prepare, clip, config, known), partial(_record, folder)
        jobs.append(_Job(golden_path(folder, clip.name, name), clip.name, name, make, finish))
    return _run(jobs, workers, stopped, report)


def _record(folder: Path, plan: SeedPlan, runs: Sequence[SeedRun]) -> Checked:
    recipe, tables = plan.recipe, [run.trajectory for run in runs]
    shipped = recipe.path.resolve().parent == shipped_folder().resolve()
    golden = record(
        tables,
        clip=plan.clip,
        recipe=recipe.name if shipped else beside(folder, recipe.path),
        settings=to_dict(recipe),
        start=plan.start,
        stop=plan.stop,
        gallery=_gallery(recipe),
    )
    path = golden_path(folder, plan.clip.name, recipe.name)
    write_golden(path, golden)
    who = _identities(golden.names, tables)
    message = f"{len(tables)} seeds, {golden.tested} to test{who and '; ' + who}"
    return Checked(path, plan.clip.name, recipe.name, "ok", message)


def _asked(folder: Path, configs: Sequence[str]) -> list[tuple[Path, str, Golden | None]]:
    """Clip, recipe, and the golden so far of each golden to record."""
    present = find_goldens(folder)
    if not configs:
        if not present:
            raise InputError(f"{folder}: has no goldens to record again; name recipes with --config")
        goldens = [read_golden(path) for path in present]
        return [(folder / golden.clip.file, golden.recipe_from(folder), golden) for golden in goldens]
    clips = [path for path in sorted(folder.iterdir()) if path.suffix.lower() not in NO_CLIPS and find_init(path)]
    if not clips:
        raise InputError(f"{folder}: has no clip with an init file beside it; make one with facetrack init CLIP")
    twice = [name for name, count in Counter(clip.stem for clip in clips).items() if count > 1]
    if twice:
        raise UsageError(f"{folder}: two clips are called {twice[0]}; rename one, goldens are kept by that name")
    found: list[tuple[Path, str, Golden | None]] = []
    for clip, config in itertools.product(clips, configs):
        path = golden_path(folder, clip.name, Path(config).name.removesuffix(".yaml"))
        known = None
        with suppress(InputError):  # it may be that there is none yet, or none that can be read
            known = read_golden(path)
        found.append((clip, config, known))
    return found
