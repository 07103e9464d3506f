"""The plots of `compare` as PNG files: names and bytes, which need matplotlib."""

from collections.abc import Callable, Iterator

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.evaluation.boxes import PRECISION_THRESHOLDS, SUCCESS_THRESHOLDS
from facetrack_cli.evaluation.compare import CUMULATIVE_AT, Comparison, Score, aligned
from facetrack_cli.evaluation.points import FAILURE
from facetrack_cli.evaluation.sheet import clip_name
from facetrack_cli.report import figures as plots
from facetrack_cli.report.figures.style import render


def compare_figures(comparison: Comparison) -> Iterator[tuple[str, bytes]]:
    """Success, precision, cumulative error and error over time, of what is measured; recipes in their order."""
    entries = [place.entry for place in comparison.places if place.entry.scores]

    def curves(at: Array, of: Callable[[Score], Array | None]) -> dict[str, tuple[Array, Array]]:
        found = {entry.label: [one for score in entry.scores if (one := of(score)) is not None] for entry in entries}
        return {label: (at, np.stack(values)) for label, values in found.items() if values}

    clip = clip_name(comparison.clip)
    if success := curves(SUCCESS_THRESHOLDS, lambda score: score.success):
        yield "success.png", render(plots.success_figure(success, title=f"Success on {clip}"))
    if precision := curves(PRECISION_THRESHOLDS, lambda score: score.precision):
        yield "precision.png", render(plots.precision_figure(precision, title=f"Precision on {clip}"))
    if cumulative := curves(100 * CUMULATIVE_AT, lambda score: score.cumulative):
        labels = {"unit": "% of the size", "title": f"Cumulative error on {clip}"}
        figure = plots.cumulative_error_figure(cumulative, threshold=100 * FAILURE, **labels)
        yield "cumulative.png", render(figure)
    frame, errors = aligned(entries)
    hidden = np.unique(np.concatenate([score.hidden for entry in entries for score in entry.scores]))
    figure = plots.error_over_time_figure(frame, errors, np.isin(frame, hidden), title=f"Error on {clip}")
    yield "error.png", render(figure)
