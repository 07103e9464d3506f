"""All figures, as matplotlib Figures from arrays; `render` makes the bytes of a file of one.

matplotlib comes with the extra `plot`; it is imported when the first figure is made, a UsageError if it is missing.
"""

from facetrack_cli.report.figures.compare import calibration_figure as calibration_figure
from facetrack_cli.report.figures.compare import curves_figure as curves_figure
from facetrack_cli.report.figures.compare import error_over_time_figure as error_over_time_figure
from facetrack_cli.report.figures.page import measures_figure as measures_figure
from facetrack_cli.report.figures.page import page_figure as page_figure
from facetrack_cli.report.figures.style import need_matplotlib as need_matplotlib
from facetrack_cli.report.figures.style import render as render
