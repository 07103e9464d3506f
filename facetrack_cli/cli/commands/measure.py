"""facetrack eval, compare and regress: a trajectory, recipes and an installation, against what is known to be right."""

import contextlib
import itertools
import math
import os
import re
import time
from pathlib import Path
from typing import Any

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE_OR_DASH, Command, extent_options, flag, option, refuse, say, truth_options
from facetrack_cli.core.errors import ExitCode, UsageError, flat

TABLES = ("compare.json", "compare.csv")
PLOTS = ("success.png", "precision.png", "cumulative.png", "error.png")


# --- eval ------------------------------------------------------------------------------------------------------------


def _length(value: str) -> str:
    """What `lengths_of` in evaluation/rows.py takes."""
    with contextlib.suppress(ValueError):
        if value == "size" or re.fullmatch(r"([^:]+):(?!\1$)[^:]+", value) or 0 < float(value) < math.inf:
            return value
    raise click.BadParameter(f"{value!r}: give size, two parts as nose:mouth_left, or a number of pixels above 0")


def _share(value: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < (share := float(value)) <= 100:  # which nan is not, though Click's own range has it
            return share
    raise click.BadParameter(f"{value!r}: give a normalised error above 0, as 0.1 or 0.08")


@click.command()
@click.argument("trajectory", type=options.TRAJECTORY)
@option(
    "--truth", type=options.FILE,
    help="File or folder of ground truth [default: of the clip that a JSON trajectory names, as compare finds it].",
)  # fmt: skip
@truth_options
@options.format_of("--format", "How to read TRAJECTORY if another tracker wrote it: one of the same")
@option(
    "--normalise", type=options.Text("LENGTH", _length), default="size",
    help="Length that errors are divided by: size (the largest distance between two points in the first frame; of a "
    "box the root of its area), two parts as A:B, or a number of pixels.",
)  # fmt: skip
@option(
    "--failure", type=options.Text("SHARE", _share), default=0.1,
    help="A point has failed above this normalised error; 300-W takes 0.08.",
)  # fmt: skip
@flag(
    "--people",
    help="Find which target is which person, whatever their names, and measure HOTA, IDF1, switches and fragments; "
    "other tables are of the rows that both have.",
)
@option("--json", "json_file", type=FILE_OR_DASH, help="Write all measures as JSON; - is standard output.")
@option("--csv", "csv_file", type=FILE_OR_DASH, help="Write a row a part and one of all as CSV; - is standard output.")
@options.overwrite
def eval_command(
    trajectory: Path, truth: Path | None, reference: options.TruthOptions, format: str, normalise: str, failure: float,
    people: bool, json_file: str | None, csv_file: str | None, overwrite: bool,
) -> None:  # fmt: skip
    """Measure a trajectory against ground truth.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, the folder of a run, or what another tracker wrote, in any of the
    formats of ground truth. It prints the errors of points, or the overlaps of boxes, and how far the
    status lost, the confidence and the spread can be trusted. With --json - or --csv - the data take the place of the
    tables. The first frame, which the tracker is given, counts among the points;
    the measures of trust leave it out.

    \b
    Examples:
      facetrack eval out/ --truth clip.truth.csv
      facetrack eval out/ --truth annot/ --partial --normalise point_37:point_46
      facetrack eval film/ --truth film.truth.csv --people
      facetrack eval results/MIL.txt --truth groundtruth_rect.txt --json -
    """
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.evaluation.compare import default_truth
    from facetrack_cli.evaluation.identities import identified
    from facetrack_cli.evaluation.summary import evaluate, show, to_csv, to_json
    from facetrack_cli.run_folder.manifest import check_run, other_clip
    from facetrack_cli.trajectory.formats.boxes import read_results
    from facetrack_cli.trajectory.reader import clip_of, frame_size_of

    both = json_file == csv_file == "-"
    refuse((both, "--json - and --csv - both name standard output; write one of them to a file"))
    check_run(trajectory)
    ours = read_results(trajectory, format)
    clip = clip_of(ours)
    if truth is None:
        if clip is None:
            unnamed = "does not name its clip, beside which the ground truth might be"
            raise UsageError(f"{ours.path}: {unnamed}; give --truth FILE")
        truth = default_truth(clip)
    theirs = reference.read(truth, ours)
    for file in (json_file, csv_file):
        if file is not None and file != "-":
            check_new(Path(file), overwrite=overwrite, inputs=(ours.path, theirs.path, clip))
    other = None if clip is None else other_clip(ours, clip)
    notes = [] if other is None else [other]
    persons = None
    if people:
        ours, persons, renamed = identified(ours, theirs)
        notes += renamed
        reference.partial = True
    pairs = reference.pairs(ours, theirs, notes.append)
    how: dict[str, Any] = {"normalise": normalise, "failure": failure, "size": frame_size_of(ours)}
    evaluation = evaluate(pairs, notes, reference=theirs.parts, people=persons, **how)

    for text_of, file in ((to_json, json_file), (to_csv, csv_file)):
        if file == "-":
            click.echo(text_of(evaluation, ours, theirs), nl=False)
        elif file is not None:
            text = text_of(evaluation, ours, theirs)
            write_new(Path(file), text.encode(errors="backslashreplace"), overwrite=overwrite)
            say(f"{trajectory} -> {file}")
    if "-" not in (json_file, csv_file):
        show(evaluation, ours, theirs)


# --- compare ---------------------------------------------------------------------------------------------------------


@click.command(cls=Command, basic="config seeds rank_by overrides truth target init box stop out overwrite jobs")
@click.argument("clip", type=options.INPUT)
@option(
    "--config", type=options.RECIPE, multiple=True, required=True,
    help="Recipe: a file, a name, or either with its own keys, as sir:filter.particles=500; repeat for each.",
)  # fmt: skip
@option("--seeds", type=click.IntRange(1), default=10, help="Runs of each, seed 0 on.")
@option("--rank-by", type=options.Text("MEASURE"), help="Rank by this, as points.median_px or boxes.precision_20.")
@options.set_("Override a key of all; repeatable.")
@option("--gallery", type=options.GALLERY, help="People to recognise, as facetrack gallery fit writes them.")
@option(
    "--truth", type=options.FILE,
    help="Ground truth [default: <clip>.truth.csv, else groundtruth.csv, groundtruth_rect.txt or groundtruth.txt in "
    "its folder].",
)  # fmt: skip
@truth_options
@extent_options
@option("-o", "--out", type=options.FOLDER, help="Folder for results [default: ./<clip>-compare].")
@flag("--no-plots", help="Draw nothing; plots need the extra [plot].")
@options.overwrite
@options.jobs("Processes that share the runs.")
@flag("--quiet", "-q", help="Print the table, and nothing else but errors.")
def compare_command(
    clip: Path, config: tuple[str, ...], seeds: int, rank_by: str | None, overrides: tuple[str, ...],
    gallery: str | None, truth: Path | None, reference: options.TruthOptions, extent: options.Extent,
    out: Path | None, no_plots: bool, overwrite: bool, jobs: int, quiet: bool,
) -> int:  # fmt: skip
    """Run recipes on a clip with ground truth, and rank them.

    Each recipe runs with seeds 0 to N-1; one that cannot run on this clip gets a row that says why. The table has the
    mean and the standard deviation over seeds, the runs that failed, and the frames/s of the tracker alone, without
    decoding. All rows are timed in the same run; only ratios between them mean anything (best with -j 1).

    Boxes are ranked by success AUC, points by the mean normalised error. Recipes whose means +- 2 standard errors
    overlap share their ranks: the runs do not tell them apart.

    The folder gets compare.json, compare.csv (a row a recipe and seed), and plots of success, precision and cumulative
    error, and of the error over time: the median and 10-90 % of the seeds.

    \b
    Examples:
      facetrack compare clip.mp4 --config factorized --config sir
      facetrack compare clip.mp4 --config mil --config csrt --seeds 20 -j 2
      facetrack compare frames/ --truth groundtruth.txt \\
        --config sir:filter.particles=100 --config sir:filter.particles=500
    """
    from facetrack_cli.core.files import check_folder, make_folder, remove_folders, write_new
    from facetrack_cli.evaluation import compare
    from facetrack_cli.evaluation.compare import Comparison
    from facetrack_cli.report.figures.compare import compare_figures
    from facetrack_cli.report.figures.style import need_matplotlib
    from facetrack_cli.runs.batch import title
    from facetrack_cli.runs.plan import ClipRequest
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.seeds import labels, load_recipes, variant
    from facetrack_cli.runs.signals import Stop

    extent.check()
    refuse((out == Path("-"), "--out '-' names no folder; the table goes to standard output in any case"))
    if rank_by is not None:
        compare.check_measure(rank_by)
    asked = [(name, (*overrides, *own)) for name, own in map(variant, config)]
    recipes = dict(zip(labels(config), load_recipes(asked, gallery), strict=True))
    file = truth or compare.default_truth(clip)
    rows = reference.read(file)
    if not no_plots:
        need_matplotlib()
    folder = out or Path(f"{title(clip)}-compare")
    check_folder(folder, [*TABLES, *(() if no_plots else PLOTS)], overwrite=overwrite, inputs=[clip])
    made = make_folder(folder)
    try:
        with Stop().listening() as stop, progress(quiet) as shown:
            request = ClipRequest(clip, **vars(extent))
            how: dict[str, Any] = {"select": reference.target, "partial": reference.partial, "workers": jobs}
            entries = compare.run_recipes(recipes, request, rows, seeds, **how, stop=stop, shown=shown)
            shown.close()
            if not any(entry.scores for entry in entries):
                shown.say(f"facetrack: {stop.reason} before a run was complete; nothing was written")
                return stop.code or ExitCode.FAULT
            comparison = Comparison(clip, file, seeds, tuple(entries), rank_by, stop.code is None)
            comparison.sheet().show()  # before it is written: what took long is not lost for a full disk
            texts = comparison.json(), comparison.csv()
            tables = ((name, text.encode(errors="backslashreplace")) for name, text in zip(TABLES, texts, strict=True))
            names = []
            for name, content in itertools.chain(tables, () if no_plots else compare_figures(comparison)):
                write_new(folder / name, content, overwrite=overwrite)
                names.append(name)
            shown.say(f"{clip} -> {folder}{os.sep} ({', '.join(names)})")
            failed = sum(entry.error is not None for entry in entries)
            if failed:
                shown.say(f"{failed} of {len(entries)} recipe{'s' * (len(entries) > 1)} could not run")
        return stop.code or (ExitCode.BATCH if failed else ExitCode.DONE)
    finally:
        remove_folders(made)  # if they are empty


# --- regress ---------------------------------------------------------------------------------------------------------


@click.command()
@click.argument("folder", type=options.FOLDER)
@option(
    "--config", type=options.RECIPE, multiple=True,
    help="Only this recipe, a file or a name; repeatable [default: all that have goldens].",
)  # fmt: skip
@options.set_("Check with this key changed; repeatable.")
@option("--gallery", type=options.FILE, help="People that recipes with recognition know; a golden remembers its own.")
@flag("--update", help="Record goldens instead: of --config, else of all that have one.")
@option("--stop", type=click.IntRange(2), help="Record up to this frame only; for slow trackers.")
@options.jobs("Goldens at a time.")
@flag("--quiet", "-q", help="No progress.")
def regress_command(
    folder: Path, config: tuple[str, ...], overrides: tuple[str, ...], gallery: Path | None, update: bool,
    stop: int | None, jobs: int, quiet: bool,
) -> int:  # fmt: skip
    """Check clips against their golden results.

    Runs every clip in DIR that has a golden, DIR/goldens/<clip>.<recipe>.json. With the recipe and the versions that it
    was recorded with, a run must give the same rows. With others, also on another processor, four seeds are run: a
    check fails if all of them are off more than the seeds that were recorded are from each other.

    \b
    Examples:
      facetrack regress sample_videos -j 2
      facetrack regress clips --config factorized --update
      facetrack regress sample_videos --config sir --set motion.sigma=0.13

    Exit codes: 0 all pass, 3 no goldens, 5 some could not be recorded, 6 a regression.
    """
    from facetrack_cli.evaluation.goldens import regress, tasks
    from facetrack_cli.recipe.load import gallery_file, load_recipe
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trackers.appearance.gallery import load_gallery

    refuse((update and overrides, "--update records recipes as they are; leave --set to a check"))
    if gallery is not None:  # a mistake in the option is no regression
        load_gallery(gallery_file(str(gallery)))
    names = {load_recipe(name, overrides, installed=False).name: name for name in config}
    asked = tasks(folder, names, update=update)
    fails, began, results = "not recorded" if update else "FAILS", time.monotonic(), []
    with Stop().listening() as stopped, progress(quiet) as shown:
        shown.begin(str(folder))
        how: dict[str, Any] = {"stopped": stopped, "workers": jobs, "report": shown.update}
        for result in regress(folder, asked, update=update, overrides=overrides, stop=stop, gallery=gallery, **how):
            results.append(result)
            why = result.message if update else f"ok ({result.message}; {result.seconds:.1f} s)"
            why = f"{fails}: {result.message}" if result.failed else why
            name = f"{result.task.clip.name} {Path(result.task.recipe).stem}"
            click.echo("\n    ".join(map(flat, (f"{name}: {why}", *result.details))))
        if stopped.code is not None:
            shown.say(f"{stopped.reason} after {len(results)} of {len(asked)} goldens")
            return stopped.code
    failed = sum(result.failed for result in results)
    if update:
        return ExitCode.BATCH if failed else ExitCode.DONE
    count = f"{len(results)} golden{'s' * (len(results) != 1)} in {time.monotonic() - began:.0f} s"
    click.echo(f"{count}: {len(results) - failed} ok, {failed} FAIL{'S' * (failed == 1)}")
    return ExitCode.REGRESSION if failed else ExitCode.DONE
