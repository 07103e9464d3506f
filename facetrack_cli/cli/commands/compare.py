"""facetrack compare: recipes side by side on a clip with truth."""

from __future__ import annotations

import contextlib
import itertools
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FRAME, Whole, rate
from facetrack_cli.core.errors import ExitCode, FacetrackError, InputError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.files import Folder
    from facetrack_cli.core.types import Box
    from facetrack_cli.evaluation.experiments.compare import Entry, Options, Score
    from facetrack_cli.evaluation.experiments.compare_text import Comparison
    from facetrack_cli.recipe.model import Recipe
    from facetrack_cli.runs.plan import Begin
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trajectory.trajectory import Trajectory

FILES = ("compare.json", "compare.csv", "compare.md")
PLOTS = ("success.png", "precision.png", "cumulative.png", "error.png")


@click.command()
@click.argument("clip", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "--truth",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Truth [default: <clip>.truth.csv, else groundtruth.csv beside the clip].",
)
@click.option(
    "--config",
    "configs",
    metavar="RECIPE",
    multiple=True,
    required=True,
    help="Recipe: a file, a name, or either with its own keys, as sir:filter.particles=500; repeat for each.",
)
@click.option("--seeds", metavar="N", type=Whole(min=1), default=10, show_default=True, help="Runs of each, seed 0 on.")
@click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Override a key of all; repeatable.")
@options.gallery
@options.init
@options.face_box
@options.truth_format
@options.target
@options.shift
@options.partial
@click.option("--stop", metavar="N", type=FRAME, help="Frame to stop before.")
@click.option("--fps", metavar="RATE", callback=rate, help="Frames per second of image folders.")
@click.option("--rank-by", metavar="MEASURE", help="Rank by this, as points.median_px or boxes.precision_20.")
@click.option("-o", "--out", metavar="DIR", help="Folder for results [default: ./<clip>-compare].")
@click.option("--json", "form", flag_value="json", help="Print JSON instead of the table.")
@click.option("--csv", "form", flag_value="csv", help="Print CSV, a row a recipe and seed, instead of the table.")
@click.option("--no-plots", is_flag=True, help="Draw nothing.")
@click.option("--overwrite", is_flag=True, help="Replace results that are there already.")
@click.option(
    "-j", "--jobs", "workers", metavar="N", type=Whole(min=1), default=1, help="Processes that share the runs."
)
@click.option("--quiet", "-q", is_flag=True, help="Print the table, and nothing else but errors.")
@click.pass_context
def command(
    ctx: click.Context,
    clip: Path,
    truth: Path | None,
    configs: tuple[str, ...],
    seeds: int,
    overrides: tuple[str, ...],
    gallery: str | None,
    init: str | None,
    box: Box | None,
    truth_format: str,
    target: str | None,
    shift: int | None,
    partial: bool,
    stop: int | None,
    fps: Fraction | None,
    rank_by: str | None,
    out: str | None,
    form: str | None,
    no_plots: bool,
    overwrite: bool,
    workers: int,
    quiet: bool,
) -> None:
    """Run recipes on a clip with truth, and rank them.

    Each recipe runs with seeds 0 to N-1; one that cannot run on this clip gets a row that says why. The table has the
    mean and the standard deviation over seeds, the runs that failed, and the frames/s of the tracker alone, decoding
    apart; all rows are timed in the same run, and only ratios between them mean anything (best with -j 1).

    Ranked are boxes by success AUC, points by the mean normalised error. Recipes whose means +- 2 standard errors
    overlap share their ranks: the runs do not tell them apart.

    \b
    The folder gets compare.json, compare.csv (a row a recipe and seed),
    compare.md, and
      success.png, precision.png    of boxes
      cumulative.png                of points
      error.png                     over time: median and 10-90 % of the
                                    seeds, hidden spans shaded

    \b
    Examples:
      facetrack compare clip.mp4 --config factorized --config sir
      facetrack compare clip.mp4 --config mil --config csrt --seeds 20 -j 2
      facetrack compare hands.mp4 --target left_hand \\
        --config histogram --config contour_histogram
      facetrack compare frames/ --truth groundtruth.txt \\
        --config sir:filter.particles=100 --config sir:filter.particles=500
      facetrack compare clip.mp4 --config adaptive --config mine.yaml \\
        --gallery people.npz
      facetrack compare clip.mp4 --config a.yaml --config b.yaml --csv -q

    \b
    Exit codes: 0 done, 2 usage, recipe or output, 3 input,
    5 some of the recipes could not run, 130 interrupted, 143 terminated.
    """
    from facetrack_cli.core.files import Folder
    from facetrack_cli.evaluation.experiments.compare import (
        PRIMARY,
        Options,
        check_measure,
        default_truth,
        kind_of,
        labels,
        variant,
    )
    from facetrack_cli.evaluation.experiments.compare_text import Comparison
    from facetrack_cli.recipe.gallery_option import with_gallery
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.runs.batch import title
    from facetrack_cli.runs.plan import Begin, refuse_seed
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.tracking.build.affine import check_gallery
    from facetrack_cli.trajectory.formats.read import read_truth

    begin = Begin.of(clip, init, box, stop, fps)
    if rank_by is not None:
        check_measure(rank_by)
    refuse_seed([*overrides, *(one for _, own in map(variant, configs) for one in own)])
    recipes = with_gallery([load_recipe(name, (*overrides, *own)) for name, own in map(variant, configs)], gallery)
    named = dict(zip(labels(configs), recipes, strict=True))
    for recipe in recipes if gallery is not None else ():
        check_gallery(recipe)
    file = default_truth(clip) if truth is None else truth
    known = read_truth(file, truth_format, shift=shift or 0)
    plots = () if no_plots else PLOTS
    with (
        Stop().listening() as ending,
        contextlib.closing(progress(quiet)) as shown,
        Folder(out, f"{title(clip)}-compare", FILES + plots, overwrite=overwrite, clip=clip) as folder,
    ):
        settings = Options(target, partial, stop, begin.picture_size())
        entries = _run(named, begin, known, seeds, workers, settings, rank_by, shift is None, ending, shown)
        shown.close()
        if not any(entry.scores for entry in entries):
            shown.say(f"facetrack: {ending.reason} before a run was complete; nothing was written")
            ctx.exit(ending.code or ExitCode.FAULT)
        measure = rank_by or PRIMARY[kind_of(entries)]
        found = Comparison(clip, file, seeds, tuple(entries), measure, workers, ending.code is None, named)
        try:
            _write(found, folder, shown, plots=not no_plots)
        finally:  # what took long is not lost for a full disk
            _show(found, form)
        shown.say(f"{clip} -> {folder.summary()}")
        failed = sum(bool(entry.why) for entry in entries)
        if failed:
            shown.say(f"{failed} of {len(entries)} recipes could not run")
    ctx.exit(ending.code or (ExitCode.BATCH if failed else ExitCode.DONE))


def _run(
    named: dict[str, Recipe],
    begin: Begin,
    truth: Trajectory,
    seeds: int,
    workers: int,
    settings: Options,
    rank_by: str | None,
    check_shift: bool,
    stop: Stop,
    shown: Progress,
) -> list[Entry]:
    """Every recipe with its scores, or with what kept it from running. Raises the error if all fail of one."""
    from facetrack_cli.evaluation.experiments.compare import Entry, kinds_of, score_run, shifted
    from facetrack_cli.evaluation.experiments.sheet import clip_name
    from facetrack_cli.runs.plan import far_from_truth
    from facetrack_cli.runs.seeds import run_plans

    refused: dict[str, FacetrackError] = {}
    scores: dict[str, list[Score]] = {label: [] for label in named}
    moved: dict[str, InputError | None] = {}
    noted: list[str] = []
    warned: dict[str, list[str]] = {label: [] for label in named}
    plans = []
    size = settings.size or begin.picture_size()
    family = (rank_by or "").partition(".")[0]
    for label, recipe in named.items():
        try:
            # what draws no random numbers has one run to show
            plan = begin.plan(label, recipe, seeds if recipe.random else 1, truth, stop)
            kinds = kinds_of(plan, truth, settings, size)
            if family in ("boxes", "points") and family not in kinds:
                measured = " and ".join(sorted(kinds))
                raise UsageError(f"--rank-by {rank_by}: this truth measures {measured} of {label}; rank by these")
            plans.append(plan)
            if (far := far_from_truth(plan.start, truth)) is not None:
                warned[label].append(far)
        except FacetrackError as e:
            if stop():
                return []
            refused[label] = e
    begins = {plan.label: f"{plan.start.origin}, frame {plan.start.frame}" for plan in plans}
    alike = len({(plan.start.frame, plan.recipe.points) for plan in plans}) == 1
    shown.begin(clip_name(begin.clip), "frames", None)
    with contextlib.closing(run_plans(plans, workers, stop, lambda done, of: shown.update(done, of or None))) as found:
        for ended in found:
            label = ended.plan.label
            try:
                if ended.error is not None:
                    raise ended.error
                for run in ended.runs:
                    warned[label] += run.warnings
                    scores[label].append(score_run(run, truth, settings, noted.append))
                if check_shift and ended.runs:
                    moved[label] = shifted(ended.runs[0], truth, settings)
            except FacetrackError as e:
                refused[label] = e
                if alike and ended.runs and not any(scores.values()):
                    break  # what is wrong with the truth is wrong for every other run too
    if refused and not any(scores.values()) and stop.code is None:
        first, *others = refused.items()
        for label, error in others:
            if str(error) != str(first[1]):
                shown.error(f"facetrack: error: {label}: {error}")
        raise first[1]
    for line in dict.fromkeys(itertools.chain(*warned.values())):
        shown.say(f"facetrack: warning: {line}")
    for line in dict.fromkeys(noted):
        shown.say(f"facetrack: note: {line}")
    # one recipe that trails behind is a bad tracker; all of them are a truth that counts otherwise
    if moved and (wrong := next(iter(moved.values()))) is not None and all(moved.values()):
        raise wrong
    return [
        Entry(
            label,
            tuple(sorted(scores[label], key=lambda score: score.seed)),
            str(refused[label]) if label in refused else "",
            deterministic=not recipe.random,
            begins=begins.get(label, ""),
            warnings=tuple(dict.fromkeys(warned[label])),
        )
        for label, recipe in named.items()
    ]


def _show(found: Comparison, form: str | None) -> None:
    """The table, or the data, on standard output."""
    from facetrack_cli.evaluation.experiments.compare_text import as_csv, as_json, sheet
    from facetrack_cli.evaluation.experiments.sheet import show

    if form is not None:
        click.echo(as_json(found) if form == "json" else as_csv(found), nl=False)
        return
    show(sheet(found), found.title)


def _write(found: Comparison, folder: Folder, shown: Progress, plots: bool) -> None:
    """All files; without matplotlib all but the plots, and a line that says so."""
    from facetrack_cli.evaluation.experiments.compare_text import as_csv, as_json, sheet
    from facetrack_cli.evaluation.experiments.sheet import markdown
    from facetrack_cli.report.figures.comparison import figures
    from facetrack_cli.report.figures.style import need_matplotlib

    folder.write("compare.json", as_json(found))
    folder.write("compare.csv", as_csv(found))
    folder.write("compare.md", markdown(sheet(found), found.title))
    if plots:
        try:
            need_matplotlib()
        except UsageError as e:
            shown.say(f"facetrack: warning: no plots: {e}")
            return
        for name, png in figures(found):
            folder.write(name, png)
