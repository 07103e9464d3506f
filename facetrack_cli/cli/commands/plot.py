"""facetrack plot: a page of small plots of what happened in a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import TruthOptions, option, say, truth_options, write_figure
from facetrack_cli.cli.types import FILE, TRAJECTORY, Number, Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@click.command()
@click.argument("trajectory", type=TRAJECTORY)
@option("--truth", type=FILE, help="Draw the ground truth too, and the error.")
@truth_options
@option("--measure", type=Text("NAMES"), help="Draw these measures and events alone, separated by commas.")
@options.figure_file("plot.png beside TRAJECTORY")
@options.overwrite
@options.title
@option("--width", type=Number(4, 40), metavar="INCHES", default=10, help="Width of the page.")
@option("--dpi", type=Number(40, 600), metavar="N", default=120, help="Pixels an inch of a PNG.")
def command(
    trajectory: Path, truth: Path | None, known: TruthOptions, measure: str | None, out: Path | None, overwrite: bool,
    title: str | None, width: float, dpi: float,
) -> None:  # fmt: skip
    """Draw what happened in a trajectory.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run. The page shows, over time, position and
    size of every part, confidence and what was lost, particles and their effective sample size, spread, and with
    --truth the error. Of a tracker that adapts it also shows the identity, the scale, and how the noise follows the
    error, from its JSON. What the tracker does not report is left out. A long track is drawn by the range and the mean
    of as many frames as fall on a pixel, so that no peak is lost.

    With --measure the figure has a panel for each of these measures, with bars where the events named are.

    \b
    Examples:
      facetrack plot out/
      facetrack plot out/ --truth clip.truth.csv -o page.pdf
      facetrack plot out/trajectory.csv --target face/nose -o nose.svg
      facetrack plot out/ --truth groundtruth_rect.txt --partial --overwrite
      facetrack plot out/ --measure mouth_opening,blink -o figure.pdf

    \b
    Exit codes: 0 done, 2 usage or output, or matplotlib is missing,
    3 a trajectory or ground truth that cannot be read, or that do not belong
    together, 130 interrupted.
    """
    from facetrack_cli.report.figures import measures_figure, page_figure
    from facetrack_cli.run_folder.manifest import PLOT, read_run
    from facetrack_cli.trajectory.select import choose

    if truth is None:
        known.refuse(target=False)

    def draw() -> Figure:
        table = read_run(trajectory)
        if measure is not None:
            names = [name.strip() for name in measure.split(",")]
            return measures_figure(choose(table, known.target), names, title=title, width=width)
        pairs = None if truth is None else known.pairs(table, known.read(truth), say)
        return page_figure(choose(table, known.target), pairs, title=title, width=width)

    out = out or (trajectory if trajectory.is_dir() else trajectory.parent) / PLOT
    write_figure(out, draw, overwrite=overwrite, dpi=dpi)
    say(f"{trajectory} -> {out}")
