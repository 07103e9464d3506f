"""facetrack repeat: how far the runs of a recipe differ from seed to seed."""

from __future__ import annotations

import contextlib
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FRAME, Whole, rate
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.files import Folder
    from facetrack_cli.core.types import Box
    from facetrack_cli.evaluation.experiments.repeat_text import Repetition
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.trajectory.trajectory import Trajectory

FILES = ("repeat.json", "repeat.csv", "repeat.md")
PLOTS = ("spread.png",)


@click.command()
@click.argument("clip", metavar="INPUT", type=click.Path(path_type=Path))
@click.option("--config", metavar="RECIPE", default="factorized", show_default=True, help="Recipe: a file, or a name.")
@click.option("--seeds", metavar="N", type=Whole(min=2), default=20, show_default=True, help="Runs, from seed 0 on.")
@click.option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Override a key of the recipe; repeatable."
)
@options.gallery
@options.init
@options.face_box
@click.option("--start", metavar="N", type=FRAME, default=0, help="First frame, from 0, of --box or a face looked for.")
@click.option("--stop", metavar="N", type=FRAME, help="Frame to stop before.")
@click.option("--fps", metavar="RATE", callback=rate, help="Frames per second of image folders.")
@click.option(
    "--apart",
    metavar="SHARE",
    type=click.FloatRange(0, min_open=True),
    default=0.25,
    show_default=True,
    help="Share of the target's size beyond which a run is apart from the others.",
)
@click.option("--truth", metavar="FILE", type=click.Path(path_type=Path), help="Truth, to say which runs are right.")
@click.option("-o", "--out", metavar="DIR", help="Folder for results [default: ./<clip>-<recipe>-repeat].")
@click.option("--json", "form", flag_value="json", help="Print JSON instead of the table.")
@click.option("--csv", "form", flag_value="csv", help="Print CSV, a row a frame and part, instead of the table.")
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
    config: str,
    seeds: int,
    overrides: tuple[str, ...],
    gallery: str | None,
    init: str | None,
    box: Box | None,
    start: int,
    stop: int | None,
    fps: Fraction | None,
    apart: float,
    truth: Path | None,
    out: str | None,
    form: str | None,
    no_plots: bool,
    overwrite: bool,
    workers: int,
    quiet: bool,
) -> None:
    """Show how far the runs of a recipe differ from seed to seed.

    For each part: the spread over seeds, the run farthest from the median of all, and the frame at which the runs
    part ways, which is the first of 5 frames in a row in which a run is farther from the median of most than a
    quarter of the target's size (--apart). Then who leaves, how far, who comes back, and the groups at the end.

    All runs advance together; after Ctrl-C the table holds the frames that they had reached.

    \b
    The folder gets repeat.csv (a row a frame and part: mean position,
    standard deviations, farthest run), repeat.json, repeat.md, spread.png.

    \b
    Examples:
      facetrack repeat clip.mp4 --config factorized
      facetrack repeat clip.mp4 --seeds 50 -j 2 --truth clip.truth.csv
      facetrack repeat frames/ --config sir --stop 200 --csv -q > spread.csv

    \b
    Exit codes: 0 done, 2 usage, recipe or output, 3 input, 130 interrupted,
    143 terminated.
    """
    from facetrack_cli.core.files import Folder
    from facetrack_cli.evaluation.experiments.repeat import spreads
    from facetrack_cli.evaluation.experiments.repeat_text import Repetition
    from facetrack_cli.evaluation.experiments.sheet import clip_name
    from facetrack_cli.recipe.gallery_option import with_gallery
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.runs.batch import title
    from facetrack_cli.runs.plan import Begin, refuse_seed
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.seeds import run_plans
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.tracking.build.affine import check_gallery
    from facetrack_cli.trajectory.formats.read import read_truth

    begin = Begin.of(clip, init, box, stop, fps, start)
    refuse_seed(overrides)
    [recipe] = with_gallery([load_recipe(config, overrides)], gallery)
    check_gallery(recipe)
    known = None if truth is None else read_truth(truth)
    names = FILES + (() if no_plots else PLOTS)
    with (
        Stop().listening() as ending,
        contextlib.closing(progress(quiet)) as shown,
        Folder(out, f"{title(clip)}-{recipe.name}-repeat", names, overwrite=overwrite, clip=clip) as folder,
    ):
        plan = begin.plan(recipe.name, recipe, seeds, known, ending)
        shown.begin(clip_name(clip), "frames", None)
        [ended] = run_plans([plan], workers, ending, lambda done, of: shown.update(done, of or None), partial=True)
        if ended.error is not None:
            raise ended.error
        runs = ended.runs
        shown.close()
        warned = tuple(dict.fromkeys(line for run in runs for line in run.warnings))
        for line in warned:
            shown.say(f"facetrack: warning: {line}")
        if len(runs) < 2:
            shown.say(f"facetrack: {ending.reason} before two runs had begun; nothing was written")
            ctx.exit(ending.code or ExitCode.FAULT)
        tables, ran = [run.trajectory for run in runs], tuple(run.seed for run in runs)
        found = Repetition(
            clip=clip,
            label=recipe.name,
            recipe=recipe,
            seeds=ran,
            spreads=spreads(ran, tables, apart, _matched(tables[0], known)),
            fraction=apart,
            truth=truth,
            complete=ending.code is None,
            warnings=warned,
        )
        try:
            _write(found, folder, shown, plots=not no_plots)
        finally:  # what took long is not lost for a full disk
            _show(found, form)
        shown.say(f"{clip} -> {folder.summary()}")
    ctx.exit(ending.code or ExitCode.DONE)


def _matched(table: Trajectory, truth: Trajectory | None) -> list[Trajectory]:
    """The parts of the truth under the names of the track's."""
    from facetrack_cli.evaluation.match import match

    if truth is None:
        return []
    pairs = match(table, truth, partial=True, select=None, check_shift=False)
    return [pair.truth.renamed(pair.ours.target, pair.ours.part) for pair in pairs]


def _write(found: Repetition, folder: Folder, shown: Progress, plots: bool) -> None:
    """All files; without matplotlib all but the plot, and a line that says so."""
    from facetrack_cli.evaluation.experiments.repeat_text import as_csv, as_json, sheet
    from facetrack_cli.evaluation.experiments.sheet import clip_name, markdown

    folder.write("repeat.json", as_json(found))
    folder.write("repeat.csv", as_csv(found))
    folder.write("repeat.md", markdown(sheet(found), found.title))
    if plots:
        from facetrack_cli.report.figures.style import need_matplotlib, render

        try:
            need_matplotlib()
        except UsageError as e:
            shown.say(f"facetrack: warning: no plot: {e}")
            return
        from facetrack_cli.report.figures import spread_figure

        figure = spread_figure(
            found.spreads[0].frame,
            {name: one.from_median for name, one in zip(found.names, found.spreads, strict=True)},
            found.parting,
            {name: one.limit for name, one in zip(found.names, found.spreads, strict=True)},
            title=f"{len(found.seeds)} runs of {found.label} on {clip_name(found.clip)}",
        )
        folder.write("spread.png", render(figure))


def _show(found: Repetition, form: str | None) -> None:
    """The table, or the data, on standard output."""
    from facetrack_cli.evaluation.experiments.repeat_text import as_csv, as_json, sheet
    from facetrack_cli.evaluation.experiments.sheet import show

    if form is not None:
        click.echo(as_json(found) if form == "json" else as_csv(found), nl=False)
        return
    show(sheet(found), found.title)
