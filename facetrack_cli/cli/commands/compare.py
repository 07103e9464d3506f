"""facetrack compare: recipes side by side on a clip with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import Command, Extent, TruthOptions, extent_options, flag, option, truth_options
from facetrack_cli.cli.types import FILE, FOLDER_OR_DASH, INPUT, RECIPE, Text, Whole
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.files import Folder
    from facetrack_cli.evaluation.compare import Comparison
    from facetrack_cli.runs.progress import Progress

TABLES = ("compare.json", "compare.csv", "compare.md")
PLOTS = ("success.png", "precision.png", "cumulative.png", "error.png")


@click.command(cls=Command, basic="config seeds rank_by overrides truth target init box stop out overwrite jobs")
@click.argument("clip", type=INPUT)
@option(
    "--config", type=RECIPE, multiple=True, required=True,
    help="Recipe: a file, a name, or either with its own keys, as sir:filter.particles=500; repeat for each.",
)  # fmt: skip
@option("--seeds", type=Whole(min=1), default=10, help="Runs of each, seed 0 on.")
@option("--rank-by", type=Text("MEASURE"), help="Rank by this, as points.median_px or boxes.precision_20.")
@options.set_("Override a key of all; repeatable.")
@options.gallery
@option("--truth", type=FILE, help="Ground truth [default: <clip>.truth.csv, else groundtruth.csv beside the clip].")
@truth_options
@extent_options
@option("-o", "--out", type=FOLDER_OR_DASH, help="Folder for results [default: ./<clip>-compare].")
@flag("--json", "as_json", help="Print JSON instead of the table.")
@flag("--csv", "as_csv", help="Print CSV instead of the table.")
@flag("--no-plots", help="Draw nothing.")
@options.overwrite
@options.jobs("Processes that share the runs.")
@flag("--quiet", "-q", help="Print the table, and nothing else but errors.")
def command(
    clip: Path, config: tuple[str, ...], seeds: int, rank_by: str | None, overrides: tuple[str, ...],
    gallery: str | None, truth: Path | None, known: TruthOptions, extent: Extent, out: str | None, as_json: bool,
    as_csv: bool, no_plots: bool, overwrite: bool, jobs: int, quiet: bool,
) -> int:  # fmt: skip
    """Run recipes on a clip with ground truth, and rank them.

    Each recipe runs with seeds 0 to N-1; one that cannot run on this clip gets a row that says why. The table has the
    mean and the standard deviation over seeds, the runs that failed, and the frames/s of the tracker alone, without
    decoding. All rows are timed in the same run; only ratios between them mean anything (best with -j 1).

    Boxes are ranked by success AUC, points by the mean normalised error. Recipes whose means +- 2 standard errors
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
    from facetrack_cli.evaluation import compare
    from facetrack_cli.evaluation.compare import Comparison
    from facetrack_cli.runs.batch import title
    from facetrack_cli.runs.plan import ClipRequest
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.seeds import labels, load_recipes, refuse_seed, variant
    from facetrack_cli.runs.signals import Stop

    extent.check(clip)
    if rank_by is not None:
        compare.check_measure(rank_by)
    asked = [(name, (*overrides, *own)) for name, own in map(variant, config)]
    refuse_seed([one for _, keys in asked for one in keys])
    recipes = dict(zip(labels(config), load_recipes(asked, gallery), strict=True))
    file = truth or compare.default_truth(clip)
    reference = known.read(file)
    names = [*TABLES, *(() if no_plots else PLOTS)]
    with (
        Stop().listening() as stop,
        progress(quiet) as shown,
        Folder(out, f"{title(clip)}-compare", names, overwrite=overwrite, clip=clip) as folder,
    ):
        begin = ClipRequest(clip, **vars(extent))
        with begin.open() as source:
            scoring = compare.Scoring(known.target, known.partial, extent.stop, source.size)
        entries = compare.run_recipes(
            recipes, begin, reference, seeds, scoring, rank_by=rank_by, workers=jobs, stop=stop, shown=shown
        )
        shown.close()
        if not any(entry.scores for entry in entries):
            shown.say(f"facetrack: {stop.reason} before a run was complete; nothing was written")
            return stop.code or ExitCode.FAULT
        measure = rank_by or compare.USUAL[compare.kind_of(entries)][0]
        found = Comparison(clip, file, seeds, tuple(entries), measure, jobs, stop.code is None)
        try:
            _write(found, folder, shown, plots=not no_plots)
        finally:  # what took long is not lost for a full disk
            if as_json or as_csv:
                click.echo(found.json() if as_json else found.csv(), nl=False)
            else:
                found.sheet().show()
        shown.say(f"{clip} -> {folder.summary()}")
        failed = sum(entry.error is not None for entry in entries)
        if failed:
            shown.say(f"{failed} of {len(entries)} recipes could not run")
    return stop.code or (ExitCode.BATCH if failed else ExitCode.DONE)


def _write(found: Comparison, folder: Folder, shown: Progress, *, plots: bool) -> None:
    """Write all files, without matplotlib all but the plots."""
    from facetrack_cli.report.figures.compare import compare_figures
    from facetrack_cli.report.figures.style import need_matplotlib

    for name, text in zip(TABLES, (found.json(), found.csv(), found.sheet().markdown()), strict=True):
        folder.write(name, text)
    if not plots:
        return
    try:
        need_matplotlib()
    except UsageError as e:
        shown.say(f"facetrack: warning: no plots: {e}")
        return
    for name, png in compare_figures(found):
        folder.write(name, png)
