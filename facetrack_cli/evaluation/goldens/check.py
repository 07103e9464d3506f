"""Clips checked against their goldens, and goldens recorded: what `facetrack regress` does, a result at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.evaluation.goldens.bands import Deviation, Verdict, judge, measure
from facetrack_cli.evaluation.goldens.goldens import (
    FIRST_SEED,
    Gallery,
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
from facetrack_cli.evaluation.goldens.identities import names, sentence
from facetrack_cli.evaluation.goldens.paths import Leave, first_leave
from facetrack_cli.recipe.files import resolve_file, shipped_folder
from facetrack_cli.recipe.gallery_option import put
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import OpenCvRecipe, ParticleRecipe, Recipe, completed, to_dict
from facetrack_cli.runs.seeds import Plan, Report, SeedRun, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import Begin
from facetrack_cli.tracking.opencv import find as find_opencv
from facetrack_cli.tracking.start import find_init

Status: TypeAlias = Literal["ok", "fails", "skipped"]
NO_CLIPS = (".csv", ".json", ".md", ".py", ".txt", ".yaml", ".yml")
UPDATE = "record anew with --update if that is meant"


@dataclass(frozen=True)
class Checked:
    """What came of one golden: `message` is one line, `details` more of them. `seconds` of the trackers alone."""

    golden: Path
    clip: str
    recipe: str
    status: Status
    message: str
    details: tuple[str, ...] = ()
    seconds: float = 0.0
    seeds: int = 0
    verdict: Verdict | None = None
    leave: Leave | None = None


@dataclass(frozen=True)
class Updated:
    """What came of recording one golden: a file, or why not. `skipped`: it cannot be made here; nothing is wrong."""

    clip: str
    recipe: str
    path: Path | None
    message: str
    skipped: bool = False


def select(folder: Path, recipes: Sequence[Recipe]) -> list[tuple[Path, Golden]]:
    """The goldens of a folder, only those of these recipes if any are given.

    Raises InputError where there are none, or where one cannot be read.
    """
    found = find_goldens(folder)
    if not found:
        raise InputError(
            f"{folder}: has no goldens; record some with facetrack regress {folder} --config RECIPE --update"
        )
    goldens = [(path, read_golden(path)) for path in found]
    names = {_name(golden) for _, golden in goldens}
    for recipe in recipes:
        if recipe.name not in names:
            raise InputError(
                f"{folder}: has no golden of {recipe.name}, only of {', '.join(sorted(names))}; record it with --update"
            )
    wanted = {recipe.name for recipe in recipes} or names
    return [(path, golden) for path, golden in goldens if _name(golden) in wanted]


def _name(golden: Golden) -> str:
    return Path(golden.recipe).name.removesuffix(".yaml")


# --- checking ------------------------------------------------------------------------------------------------------


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
    """Run every golden's clip and judge what comes out, in their order; fewer results once `stopped` says so.

    `recipes` are taken in place of the goldens' own of the same name, `overrides` are set in these, and `gallery` is
    taken in place of theirs. Seeds count from `first_seed`.
    """
    stopped = stopped or Stop()
    given = {recipe.name: recipe for recipe in recipes}
    prepared = [_prepare(folder, path, golden, given, overrides, gallery, first_seed) for path, golden in goldens]
    plans = [one for one in prepared if isinstance(one, Plan)]
    runs = run_plans(plans, workers, stopped, report)
    for (path, golden), one in zip(goldens, prepared, strict=True):
        if stopped():
            break
        if isinstance(one, Checked):
            yield one
            continue
        ended = next(runs, None)
        if ended is not None and ended.error is not None:
            yield _checked(path, golden, "fails", str(ended.error))
        elif ended is not None:
            yield _compare(path, golden, one, ended.runs)
    runs.close()


def _prepare(
    folder: Path,
    path: Path,
    golden: Golden,
    given: Mapping[str, Recipe],
    overrides: Sequence[str],
    gallery: Path | None,
    first_seed: int,
) -> Plan | Checked:
    clip = folder / golden.clip
    if not clip.exists():
        return _checked(path, golden, "fails", f"the clip {clip} is not there; put it back, or remove {path}")
    try:
        if checksum(clip) != golden.sha256:
            return _checked(path, golden, "fails", f"the clip {clip} is not the one recorded; restore it, or {UPDATE}")
        recipe = given.get(_name(golden)) or _load(folder, golden, overrides)
        if golden.gallery is not None and (gallery or _gallery(recipe) is None):
            recipe = _recognising(recipe, gallery or folder / golden.gallery.file)
    except FacetrackError as e:
        return _checked(path, golden, "fails", str(e))
    if reason := _cannot_run(recipe):
        return _checked(path, golden, "skipped", reason)
    seeds = tuple(range(first_seed, first_seed + golden.tested))
    return Plan(path.stem, clip, recipe, golden.start, seeds, golden.stop)


def _load(folder: Path, golden: Golden, overrides: Sequence[str] = ()) -> Recipe:
    beside = folder / golden.recipe
    return load_recipe(str(beside) if golden.recipe.endswith(".yaml") else golden.recipe, overrides)


def _recognising(recipe: Recipe, gallery: Path) -> Recipe:
    """The same recipe with this gallery, if it recognises anybody."""
    if not isinstance(recipe, ParticleRecipe) or recipe.recognition is None:
        return recipe
    if not gallery.is_file():
        raise InputError(f"the gallery {gallery} is not there; put it back, or name another with --gallery")
    return put(recipe, str(gallery))


def _gallery(recipe: Recipe) -> Path | None:
    """The gallery of a recipe, if it names one; RecipeError if that is nowhere."""
    if not isinstance(recipe, ParticleRecipe) or recipe.recognition is None or recipe.recognition.gallery is None:
        return None
    return resolve_file(recipe, recipe.recognition.gallery)


def _cannot_run(recipe: Recipe) -> str:
    """Why this installation cannot run a recipe, if so."""
    if isinstance(recipe, OpenCvRecipe) and find_opencv(recipe.tracker) is None:
        return f"the installed OpenCV has no {recipe.tracker.upper()} tracker; opencv-contrib-python-headless has"
    return ""


def _checked(path: Path, golden: Golden, status: Status, message: str) -> Checked:
    return Checked(path, golden.clip, _name(golden), status, message)


def _compare(path: Path, golden: Golden, plan: Plan, runs: Sequence[SeedRun]) -> Checked:
    tables = [run.trajectory for run in runs]
    seconds = sum(len(run.trajectory.frames) / run.frames_per_s for run in runs)
    changed = differences(completed(golden.settings), to_dict(plan.recipe))
    notes = [f"recipe differs from the golden's: {', '.join(changed)}; {UPDATE}"] if changed else []
    gallery = _gallery(plan.recipe)
    if golden.gallery is not None and gallery is not None and checksum(gallery) != golden.gallery.sha256:
        notes.append(f"the gallery {gallery} is not the one recorded, {golden.gallery.file}; {UPDATE}")
    name, seeds = _name(golden), len(runs)
    if shape := _other_shape(golden, tables[0].frames.tolist(), [one.name for one in tables[0].parts]):
        return Checked(path, golden.clip, name, "fails", shape, tuple(notes), seconds, seeds)
    verdict = judge(golden.statistics, golden.recorded, measure(tables, golden.statistics, golden.names))
    who = sentence(golden.names, tables)
    if verdict.passed:
        message = f"the farthest statistic is at {100 * verdict.closest:.0f} % of its band{who and '; ' + who}"
        return Checked(path, golden.clip, name, "ok", message, tuple(notes), seconds, seeds, verdict)
    leave = first_leave(golden.paths, tables)
    lines = [f"{_where(golden, d.statistic.series, d.statistic.first, d.statistic.last)}: {d}" for d in _told(verdict)]
    if leave is not None:
        lines.insert(1, f"{golden.short(leave.series)} {leave}")
    elif not any(d.statistic.quantity in ("x", "y") for d in verdict.deviations):
        lines.insert(1, "no part leaves its path; positions are as recorded")
    if names(tables) != golden.names or any(d.statistic.quantity == "identity" for d in verdict.deviations):
        lines.append(f"recorded was {_named(golden.names)}; now it is {who or 'nobody'}")
    now = versions()
    other = [f"{key} {was} -> {now.get(key, 'none')}" for key, was in golden.versions.items() if now.get(key) != was]
    if other:
        notes.append(f"other versions than recorded with: {', '.join(other)}")
    message = f"{lines[0]} (from {len(golden.recorded)} seeds)"
    return Checked(
        path, golden.clip, name, "fails", message, (*lines[1:], *notes), seconds, seeds, verdict, leave
    )  # fmt: skip


def _named(recorded: Mapping[str, str]) -> str:
    return ", ".join(recorded.values() if len(recorded) == 1 else map(": ".join, recorded.items())) or "nobody"


def _told(verdict: Verdict) -> list[Deviation]:
    """The deviations to tell: the farthest of a span, the farthest overall, and the joint one if it stands alone."""
    local = [d for d in verdict.deviations if not (d.relative or d.together)]
    overall = [d for d in verdict.deviations if d.relative]
    return [*local[:1], *overall[:1]] or list(verdict.deviations[:1])


def _where(golden: Golden, series: str, first: int, last: int) -> str:
    return f"frames {first}-{last}, {golden.short(series) if series else 'all parts'}"


def _other_shape(golden: Golden, frames: list[int], series: list[str]) -> str:
    first, last = golden.frames
    if frames != list(range(first, last + 1)):
        return f"tracked frames {frames[0]}-{frames[-1]}, recorded were {first}-{last}; {UPDATE}"
    if series != list(golden.series):
        return f"tracks {', '.join(series)}, recorded were {', '.join(golden.series)}; {UPDATE}"
    return ""


# --- recording -----------------------------------------------------------------------------------------------------


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
) -> Iterator[Updated]:
    """Record goldens: of every clip with an init file and these recipes, or of those that are there if none is given.

    Recipes that recognise take `gallery`; where it is None, their own, or that of the golden which is recorded anew.
    Each file is written when its runs have ended, and replaces the one before. Raises InputError where there is nothing
    to record.
    """
    stopped = stopped or Stop()
    prepared: list[tuple[str, Updated | Plan]] = []  # with the recipe's name or path, as the golden keeps it
    for config in configs:
        load_recipe(config)  # a wrong one is refused before anything runs
    for clip, config, last, known in _asked(folder, configs, stop):
        try:
            recipe = load_recipe(config)
            file = gallery or (folder / known.file if known is not None and _gallery(recipe) is None else None)
            if file is not None:
                recipe = _recognising(recipe, file)
        except FacetrackError as e:
            prepared.append((config, Updated(clip.name, Path(config).name, None, str(e))))
            continue
        one = _plan(clip, recipe, seeds, last, stopped)
        if stopped():
            return
        prepared.append((_reference(folder, recipe), one))
    runs = run_plans([one for _, one in prepared if isinstance(one, Plan)], workers, stopped, report)
    for reference, one in prepared:
        if isinstance(one, Updated):
            yield one
            continue
        name = one.recipe.name
        ended = next(runs, None)
        if ended is not None and ended.error is not None:
            yield Updated(one.clip.name, name, None, str(ended.error))
        elif ended is not None:
            tables = [run.trajectory for run in ended.runs]
            golden = record(
                tables,
                clip=one.clip,
                recipe=reference,
                settings=to_dict(one.recipe),
                start=one.start,
                stop=one.stop,
                gallery=_gallery(one.recipe),
            )
            path = golden_path(folder, one.clip.name, name)
            write_golden(path, golden)
            who = sentence(golden.names, tables)
            message = f"{len(tables)} seeds, {golden.tested} to test{who and '; ' + who}"
            yield Updated(one.clip.name, name, path, message)


def _asked(
    folder: Path, configs: Sequence[str], stop: int | None
) -> list[tuple[Path, str, int | None, Gallery | None]]:
    """Clip, recipe, last frame and gallery so far of each golden to record."""
    present = [read_golden(path) for path in find_goldens(folder)] if not configs else []
    if configs:
        clips = [
            path for path in sorted(folder.iterdir()) if path.suffix.lower() not in NO_CLIPS and find_init(path)
        ] if folder.is_dir() else []  # fmt: skip
        if not folder.is_dir():
            find_goldens(folder)
        if not clips:
            raise InputError(f"{folder}: has no clip with an init file beside it; make one with facetrack init CLIP")
        twice = [name for name, count in Counter(clip.stem for clip in clips).items() if count > 1]
        if twice:
            raise UsageError(f"{folder}: two clips are called {twice[0]}; rename one, goldens are kept by that name")
        return [(clip, config, stop, _known(folder, clip, config)) for clip in clips for config in configs]
    if not present:
        raise InputError(f"{folder}: has no goldens to record anew; name recipes with --config")
    beside = [str(folder / g.recipe) if g.recipe.endswith(".yaml") else g.recipe for g in present]
    return [
        (folder / golden.clip, recipe, golden.stop if stop is None else stop, golden.gallery)
        for golden, recipe in zip(present, beside, strict=True)
    ]


def _known(folder: Path, clip: Path, config: str) -> Gallery | None:
    """The gallery of the golden that is to be replaced, if there is one that can be read."""
    try:
        return read_golden(golden_path(folder, clip.name, Path(config).name.removesuffix(".yaml"))).gallery
    except InputError:
        return None


def _plan(clip: Path, recipe: Recipe, seeds: int, stop: int | None, stopped: Stop) -> Plan | Updated:
    if reason := _cannot_run(recipe):
        return Updated(clip.name, recipe.name, None, reason, skipped=True)
    try:
        start = Begin(clip, stop=stop).find(recipe, stopped=stopped)
    except InputError as e:
        return Updated(clip.name, recipe.name, None, str(e))
    targets = start.targets.values()
    missing = [part for part in recipe.points if any(part not in target.points for target in targets)]
    if missing:
        message = f"{start.origin}: has no point for {', '.join(missing)}, which the recipe follows"
        if all(target.box for target in targets):
            message += "; a recipe of regions, as contour_histogram, follows its boxes"
        return Updated(clip.name, recipe.name, None, message, skipped=True)
    if not recipe.points and not all(target.box for target in targets):
        message = f"{start.origin}: has no box, which the recipe follows; one of points, as factorized, may do"
        return Updated(clip.name, recipe.name, None, message, skipped=True)
    return Plan(
        f"{clip.stem}.{recipe.name}", clip, recipe, start, tuple(range(FIRST_SEED, FIRST_SEED + seeds)), stop
    )  # fmt: skip


def _reference(folder: Path, recipe: Recipe) -> str:
    """A shipped recipe's name, or the path of any other from the folder of clips."""
    if recipe.path.resolve().parent == shipped_folder().resolve():
        return recipe.name
    return beside(folder, recipe.path)
