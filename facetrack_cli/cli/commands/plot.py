"""facetrack plot: a page of small plots of what happened in a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.core.errors import OutputError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.rows import Pair
    from facetrack_cli.trajectory.trajectory import Trajectory

FORMS = ("png", "svg", "pdf")  # those of plots/style.py, which would load numpy


@click.command()
@click.argument("trajectory", metavar="TRAJECTORY", type=click.Path(path_type=Path))
@click.option("--truth", metavar="FILE", type=click.Path(path_type=Path), help="Draw the truth too, and the error.")
@options.truth_format
@options.shift
@options.partial
@options.target
@click.option(
    "-o",
    "--out",
    metavar="FILE",
    help="File to write: .png, .svg or .pdf [default: plot.png beside TRAJECTORY].",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that is there already.")
@click.option("--title", metavar="TEXT", help="Title of the page [default: clip and recipe].")
@click.option(
    "--width", metavar="INCHES", type=click.FloatRange(4, 40), default=10, show_default=True, help="Width of the page."
)
@click.option(
    "--dpi",
    metavar="N",
    type=click.FloatRange(40, 600),
    default=120,
    show_default=True,
    help="Pixels an inch of a PNG.",
)
def command(
    trajectory: Path,
    truth: Path | None,
    truth_format: str,
    shift: int | None,
    partial: bool,
    target: str | None,
    out: str | None,
    overwrite: bool,
    title: str | None,
    width: float,
    dpi: float,
) -> None:
    """Draw what happened in a trajectory.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run. The page shows, over time, position and
    size of every part, confidence and what was lost, particles and their effective sample size, spread, and with
    --truth the error; of a tracker that adapts also who it is, scale, and how noise follows error, from its JSON. What
    the tracker does not tell is left out. A long track is drawn by the range and the mean of as many frames as fall on
    a pixel, so that no peak is lost.

    \b
    Examples:
      facetrack plot out/
      facetrack plot out/ --truth clip.truth.csv -o page.pdf
      facetrack plot out/trajectory.csv --target face/nose -o nose.svg
      facetrack plot out/ --truth groundtruth_rect.txt --partial --overwrite

    \b
    Exit codes: 0 done, 2 usage or output, or matplotlib is missing,
    3 a trajectory or truth that cannot be read, or that do not belong
    together, 130 interrupted.
    """
    if truth is None and (partial or shift is not None or truth_format != "auto"):
        raise UsageError("--truth-format, --shift and --partial say how to read a truth; give it with --truth FILE")
    if out == "":
        raise OutputError("--out is empty; name a file that ends in .png, .svg or .pdf")
    path = Path(out) if out else _beside(trajectory)
    form = path.suffix[1:].lower()
    if form not in FORMS:
        raise UsageError(f"{path}: cannot tell the kind of file; let its name end in .png, .svg or .pdf")
    from facetrack_cli.core.files import check_new, write_new

    check_new(path, overwrite=overwrite)
    from facetrack_cli.report.figures.style import need_matplotlib

    need_matplotlib()
    from facetrack_cli.report.figures import page_figure, render
    from facetrack_cli.trajectory.reader import read_trajectory
    from facetrack_cli.trajectory.select import choose

    table = read_trajectory(trajectory)
    pairs = None if truth is None else _pairs(table, truth, truth_format, shift, partial, target)
    figure = page_figure(choose(table, target), pairs, title=title, width=width)
    write_new(path, render(figure, form, dpi=dpi), overwrite=overwrite)
    click.echo(" ".join(f"{trajectory} -> {path}".splitlines()), err=True)


def _beside(trajectory: Path) -> Path:
    return (trajectory if trajectory.is_dir() else trajectory.parent) / "plot.png"


def _pairs(
    table: Trajectory, truth: Path, form: str, shift: int | None, partial: bool, target: str | None
) -> list[Pair]:
    from facetrack_cli.evaluation.match import match
    from facetrack_cli.trajectory.formats.read import read_truth

    theirs = read_truth(truth, form, shift=shift or 0)
    return match(
        table,
        theirs,
        partial=partial,
        select=target,
        check_shift=shift is None,
        note=lambda line: click.echo(line, err=True),
    )
