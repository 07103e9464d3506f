"""facetrack plot: a page of small plots of what happened in a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Truth, option

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@click.command()
@click.argument("trajectory", metavar="TRAJECTORY", type=FILE)
@options.truth("Draw the ground truth too, and the error.")
@options.figure_file("plot.png beside TRAJECTORY")
@options.overwrite
@options.title
@option("--width", "INCHES", "Width of the page.", type=click.FloatRange(4, 40), default=10)
@option("--dpi", "N", "Pixels an inch of a PNG.", type=click.FloatRange(40, 600), default=120)
def command(
    trajectory: Path, truth: Truth, out: Path | None, overwrite: bool, title: str | None, width: float, dpi: float
) -> None:
    """Draw what happened in a trajectory.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run. The page shows, over time, position and
    size of every part, confidence and what was lost, particles and their effective sample size, spread, and with
    --truth the error. Of a tracker that adapts it also shows the identity, the scale, and how the noise follows the
    error, from its JSON. What the tracker does not report is left out. A long track is drawn by the range and the mean
    of as many frames as fall on a pixel, so that no peak is lost.

    \b
    Examples:
      facetrack plot out/
      facetrack plot out/ --truth clip.truth.csv -o page.pdf
      facetrack plot out/trajectory.csv --target face/nose -o nose.svg
      facetrack plot out/ --truth groundtruth_rect.txt --partial --overwrite

    \b
    Exit codes: 0 done, 2 usage or output, or matplotlib is missing,
    3 a trajectory or ground truth that cannot be read, or that do not belong
    together, 130 interrupted.
    """
    truth.refuse_without_file(target=False)
    path = out or (trajectory if trajectory.is_dir() else trajectory.parent) / "plot.png"

    def draw() -> Figure:
        from facetrack_cli.report.figures import page_figure
        from facetrack_cli.trajectory.select import choose
        from facetrack_cli.trajectory.table import read_trajectory

        table = read_trajectory(trajectory)
        pairs = None if truth.path is None else truth.pairs(table, truth.read(), options.say)
        return page_figure(choose(table, truth.target), pairs, title=title, width=width)

    options.write_figure(path, draw, overwrite=overwrite, dpi=dpi)
    options.say(f"{trajectory} -> {path}")
