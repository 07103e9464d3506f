"""facetrack report: one HTML page about a run."""

from __future__ import annotations

import contextlib
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Truth, option
from facetrack_cli.core.errors import OutputError


@click.command()
@click.argument("run", metavar="RUN_DIR", type=FILE)
@options.truth("Measure against this file of ground truth.")
@option("-o --out", "FILE", "The page [default: RUN_DIR/report.html].", type=FILE)
@options.clip
@options.title
@options.overwrite
@options.quiet
def command(
    run: Path, truth: Truth, out: Path | None, clip: Path | None, title: str | None, overwrite: bool, quiet: bool
) -> int:
    """Write one HTML page about a run.

    RUN_DIR is the folder that facetrack run wrote. The page shows when each part was lost and found again, with
    images of those frames, the plots, the recipe, and the command that repeats the run; with --truth also the
    measures. It is a single file that needs neither network nor scripts.

    The images are drawn from the clip, or taken from annotated.mp4 where the clip cannot be read.

    \b
    Examples:
      facetrack report out
      facetrack report out --truth clip.truth.csv -o paper/supplement.html
      facetrack report out --clip /archive/clip.mp4 --overwrite

    \b
    Exit codes: 0 done, 2 usage, output, or matplotlib is missing,
    3 input, 130 interrupted, 143 terminated.
    """
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.report.make import NAME, TruthFile, make_report, trajectory_of
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop

    truth.refuse_without_file(target=True)
    trajectory_of(run)
    to = run / NAME if out is None else out
    for what, given in (("--truth", truth.path), ("--clip", clip)):
        if given is not None and given.exists() and to.exists() and given.samefile(to):
            raise OutputError(f"{to}: is what {what} names; write the page elsewhere with -o")
    check_new(to, overwrite=overwrite)
    with contextlib.closing(progress(quiet)) as shown:
        shown.begin(run.name or str(run), "frames", None)
        against = None if truth.path is None else TruthFile(truth.path, *truth[1:])
        page = make_report(run, truth=against, clip=clip, title=title, report=shown.update)
        with Stop().listening() as stop:  # a Ctrl-C before this ends us with nothing written, from here on with all
            write_new(to, page.html, overwrite=overwrite)
        for note in page.notes:
            shown.say(f"facetrack: warning: {note}")
        shown.say(f"{run} -> {to} ({len(page.html) / 1e6:.1f} MB)")
    return stop.code or 0
