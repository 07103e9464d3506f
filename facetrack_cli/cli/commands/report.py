"""facetrack report: one HTML page about a run."""

from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import TruthOptions, option, truth_options
from facetrack_cli.cli.types import FILE, RUN


@click.command()
@click.argument("folder", type=RUN)
@option("--truth", type=FILE, help="Measure against this file of ground truth.")
@truth_options
@option("-o", "--out", type=FILE, help="The page [default: RUN_DIR/report.html, or batch.html].")
@options.clip
@options.title
@options.overwrite
@options.quiet
def command(
    folder: Path, truth: Path | None, known: TruthOptions, out: Path | None, clip: Path | None, title: str | None,
    overwrite: bool, quiet: bool,
) -> int:  # fmt: skip
    """Write one HTML page about a run, or about a batch.

    RUN_DIR is the folder that facetrack run wrote. The page shows when each part was lost and found again, with
    images of those frames, the plots, the recipe, and the command that repeats the run; with --truth also the
    measures. It is a single file that needs neither network nor scripts.

    Of a folder with the runs of a batch the page is batch.html: a table of the clips, the worst first, with a still of
    each and links to its files.

    The images are drawn from the clip, or taken from annotated.mp4 where the clip cannot be read.

    \b
    Examples:
      facetrack report out
      facetrack report out --truth clip.truth.csv -o paper/supplement.html
      facetrack report out --clip /archive/clip.mp4 --overwrite
      facetrack report results

    \b
    Exit codes: 0 done, 2 usage, output, or matplotlib is missing,
    3 input, 130 interrupted, 143 terminated.
    """
    from facetrack_cli.core.errors import UsageError
    from facetrack_cli.core.files import check_new, check_plain, write_new
    from facetrack_cli.report.make import BATCH_PAGE, TruthFile, make_batch_report, make_report
    from facetrack_cli.run_folder.manifest import REPORT, trajectory_of
    from facetrack_cli.run_folder.status import is_batch
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop

    if truth is None:
        known.refuse(target=True)
    batch = is_batch(folder)
    if batch and (truth or clip):
        raise UsageError("--truth and --clip are of one run; name its folder, or leave them out")
    if not batch:
        trajectory_of(folder)
    to = folder / (BATCH_PAGE if batch else REPORT) if out is None else out
    if out is None:
        check_plain(to)
    check_new(to, overwrite=overwrite, inputs=(truth, clip))
    with progress(quiet) as shown:
        shown.begin(folder.name or str(folder), "clips" if batch else "frames")
        measured = None if truth is None else TruthFile(truth, *vars(known).values())
        if batch:
            page = make_batch_report(folder, to, title, shown.update)
        else:
            page = make_report(folder, truth=measured, clip=clip, title=title, report=shown.update)
        with Stop().listening() as stop:  # a Ctrl-C before this ends us with nothing written, from here on with all
            write_new(to, page.html, overwrite=overwrite)
        for note in page.notes:
            shown.say(f"facetrack: warning: {note}")
        shown.say(f"{folder} -> {to} ({len(page.html) / 1e6:.1f} MB)")
    return stop.code or 0
