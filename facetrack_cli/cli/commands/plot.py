"""facetrack plot: a page of small plots of what happened in a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Number, TruthOptions, argument, group, option, say, verb, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Plot:
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

    trajectory: Path = argument("TRAJECTORY")
    truth: Path | None = option("--truth FILE", "Draw the ground truth too, and the error.", type=FILE)
    truth_options: TruthOptions = group(TruthOptions)
    measure: str | None = option("--measure NAMES", "Draw these measures and events alone, separated by commas.")
    out: Path | None = options.figure_file("plot.png beside TRAJECTORY")
    overwrite: bool = options.OVERWRITE
    title: str | None = options.TITLE
    width: float = option("--width INCHES", "Width of the page.", type=Number(4, 40), default=10)
    dpi: float = option("--dpi N", "Pixels an inch of a PNG.", type=Number(40, 600), default=120)

    def run(self) -> None:
        from facetrack_cli.run_folder.manifest import PLOT

        if self.truth is None:
            self.truth_options.refuse(target=False)
        folder = self.trajectory if self.trajectory.is_dir() else self.trajectory.parent
        out = self.out or folder / PLOT
        write_figure(out, self._draw, overwrite=self.overwrite, dpi=self.dpi)
        say(f"{self.trajectory} -> {out}")

    def _draw(self) -> Figure:
        from facetrack_cli.report.figures import measures_figure, page_figure
        from facetrack_cli.run_folder.manifest import read_run
        from facetrack_cli.trajectory.select import choose

        table = read_run(self.trajectory)
        known = self.truth_options
        if self.measure is not None:
            names = [name.strip() for name in self.measure.split(",")]
            return measures_figure(choose(table, known.target), names, title=self.title, width=self.width)
        pairs = None if self.truth is None else known.pairs(table, known.read(self.truth), say)
        return page_figure(choose(table, known.target), pairs, title=self.title, width=self.width)


command = verb(Plot)
