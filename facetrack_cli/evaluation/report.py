"""One HTML file about one finished run: what happened in it, with pictures, and how it was made.

page = make_report(Path("out"))
Path("report.html").write_bytes(page.html)
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from facetrack_cli.errors import InputError
from facetrack_cli.evaluation.plot_style import need_matplotlib
from facetrack_cli.evaluation.report_content import Content, Plot, Truth
from facetrack_cli.evaluation.report_events import Clock, key_frames, tell
from facetrack_cli.evaluation.report_frames import Clip, Report, pictures
from facetrack_cli.evaluation.report_header import command, read_header
from facetrack_cli.evaluation.report_html import Image
from facetrack_cli.evaluation.report_measures import about, measures
from facetrack_cli.evaluation.report_page import render
from facetrack_cli.formats.read import read_truth
from facetrack_cli.formats.table import Table, read_trajectory

if TYPE_CHECKING:
    from facetrack_cli.evaluation.match import Pair

NAME: Final = "report.html"
_VIDEO: Final = "annotated.mp4"
_MOST_SVG: Final = 400_000  # bytes; a larger drawing becomes a PNG
_WIDE, _NARROW = 10.0, 4.6  # inches


class Page(NamedTuple):
    """The document, and what could not be had for it, a line each."""

    html: bytes
    notes: tuple[str, ...]


def make_report(
    run: Path,
    *,
    truth: Path | None = None,
    truth_format: str = "auto",
    clip: Path | None = None,
    title: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
    report: Report = lambda done, total: None,
) -> Page | None:
    """The report of the run in the folder `run`, None when stopped; `report` is told the frames read of how many.

    Raises InputError for a folder without a JSON trajectory, a broken one, a `clip` that is not the run's, and truth
    that does not fit; UsageError without matplotlib.
    """
    need_matplotlib()
    table = read_trajectory(trajectory_of(run))
    header = read_header(table)
    clock = Clock(table, header.source.fps)
    story = tell(table, clock)
    pairs, measured = _measured(table, truth, truth_format)
    title = f"{header.clip_name}, {header.recipe_name}" if title is None else title
    keys = key_frames(story, int(clock.frames[0]), int(clock.frames[-1]))
    found = pictures(
        table,
        Clip(Path(header.source.path), header.source.size, header.source.fps),
        [key.frame for key in keys],
        given=clip,
        annotated=run / _VIDEO if (run / _VIDEO).is_file() else None,
        title=header.recipe_name,
        unit=max((max(t.box[2:]) for t in header.init.targets.values() if t.box), default=None),
        stopped=stopped,
        report=report,
    )
    if stopped():
        return None
    content = Content(
        title=title,
        table=table,
        header=header,
        clock=clock,
        story=story,
        keys=keys,
        pictures=found,
        plot=_plot(table, pairs, title),
        command=command(header, int(clock.frames[-1])),
        truth=measured,
    )
    return Page(render(content), tuple(found.notes))


def trajectory_of(run: Path) -> Path:
    """The trajectory of a run's folder that has a header. InputError, with the remedy, if there is none."""
    if run.is_file():
        raise InputError(f"{run}: is a file; name the folder of a run, which facetrack run wrote")
    if not run.is_dir():
        raise InputError(f"{run}: no such folder; name the folder of a run, which facetrack run wrote")
    for form in ("json", "jsonl"):
        if (path := run / f"trajectory.{form}").is_file():
            return path
    if (run / "trajectory.csv").is_file():
        raise InputError(
            f"{run}: has trajectory.csv alone, which does not tell of recipe and clip; run again with --format csv,json"
        )
    raise InputError(f"{run}: has no trajectory.json; name the folder of a run, which facetrack run wrote")


def _measured(table: Table, truth: Path | None, form: str) -> tuple[list[Pair], Truth | None]:
    if truth is None:
        return [], None
    from facetrack_cli.evaluation.match import match
    from facetrack_cli.evaluation.summary import evaluate

    pairs = match(table, read_truth(truth, form), partial=False, select=None, check_shift=True)
    found = evaluate(pairs)
    return pairs, Truth(str(truth), about(found), measures(found), found.notes)


def _plot(table: Table, pairs: list[Pair], title: str) -> Plot:
    """The plots, as a drawing that scales if it is small, and a narrow picture for phones."""
    from facetrack_cli.evaluation.plot_page import page_figure
    from facetrack_cli.evaluation.plot_style import render as rendered

    figure = page_figure(table, pairs, title=title, width=_WIDE)
    width, height = figure.get_size_inches()
    size = (round(96 * width), round(96 * height))
    drawing = rendered(figure, "svg")
    if len(drawing) <= _MOST_SVG:
        wide = Image(drawing, "image/svg+xml", size)
    else:
        wide = Image(rendered(figure, "png", dpi=150), "image/png", size)
    narrow = rendered(page_figure(table, pairs, title=title, width=_NARROW), "png", dpi=180)
    return Plot(wide, Image(narrow, "image/png", (442, 0)))
