"""facetrack report: one HTML page about a run."""

from __future__ import annotations

import contextlib
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.core.errors import UsageError


@click.command()
@click.argument("run", metavar="RUN_DIR", type=click.Path(path_type=Path))
@click.option("--truth", metavar="FILE", type=click.Path(path_type=Path), help="Measure against this truth file.")
@options.truth_format
@options.shift
@options.partial
@options.target
@click.option(
    "-o", "--out", metavar="FILE", type=click.Path(path_type=Path), help="The page [default: RUN_DIR/report.html]."
)
@click.option("--clip", metavar="INPUT", type=click.Path(path_type=Path), help="The clip, if it is elsewhere now.")
@click.option("--title", metavar="TEXT", help="Title of the page [default: clip and recipe].")
@click.option("--overwrite", is_flag=True, help="Replace the page if it is there already.")
@click.option("--quiet", "-q", is_flag=True, help="Say nothing but errors.")
@click.pass_context
def command(
    ctx: click.Context,
    run: Path,
    truth: Path | None,
    truth_format: str,
    shift: int | None,
    partial: bool,
    target: str | None,
    out: Path | None,
    clip: Path | None,
    title: str | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Write one HTML page about a run.

    RUN_DIR is the folder that facetrack run wrote. The page shows when each part was lost and found again, with
    pictures of those frames, the plots, the recipe, and the command that repeats the run; with --truth also the
    measures. It is a single file that needs neither network nor scripts.

    The pictures are drawn from the clip, or taken from annotated.mp4 where the clip cannot be read.

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

    told = {
        "--truth-format": truth_format != "auto",
        "--shift": shift is not None,
        "--partial": partial,
        "--target": target,
    }
    if truth is None and (idle := [option for option, given in told.items() if given]):
        raise UsageError(f"{idle[0]} says how to use a truth file; give one with --truth")
    against = None if truth is None else TruthFile(truth, truth_format, shift, partial, target)
    trajectory_of(run)
    to = run / NAME if out is None else out
    check_new(to, overwrite=overwrite, inputs=(truth, clip))
    with contextlib.closing(progress(quiet)) as shown:
        shown.begin(run.name or str(run), "frames", None)
        page = make_report(run, truth=against, clip=clip, title=title, report=shown.update)
        with Stop().listening() as stop:  # a Ctrl-C before this ends us with nothing written, from here on with all
            write_new(to, page.html, overwrite=overwrite)
        for note in page.notes:
            shown.say(f"facetrack: warning: {note}")
        shown.say(f"{run} -> {to} ({len(page.html) / 1e6:.1f} MB)")
    ctx.exit(stop.code or 0)
