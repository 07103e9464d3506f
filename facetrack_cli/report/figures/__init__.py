"""All figures, as matplotlib Figures from arrays; `render` makes the bytes of a file of one.

    figure = page_figure(read_trajectory(Path("out")))
    Path("page.svg").write_bytes(render(figure, "svg"))

matplotlib comes with the extra `plot`; it is imported when the first figure is made, a UsageError if it is missing.
"""

from facetrack_cli.report.figures.compare import (
    calibration_figure,
    cumulative_error_figure,
    error_over_time_figure,
    precision_figure,
    spread_figure,
    success_figure,
)
from facetrack_cli.report.figures.page import page_figure
from facetrack_cli.report.figures.style import need_matplotlib, render

__all__ = [
    "calibration_figure",
    "cumulative_error_figure",
    "error_over_time_figure",
    "need_matplotlib",
    "page_figure",
    "precision_figure",
    "render",
    "spread_figure",
    "success_figure",
]
