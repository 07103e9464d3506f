"""One HTML file about one finished run: what happened in it, with images, and how it was made.

page = make_report(Path("out"))
Path("report.html").write_bytes(page.html)
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from facetrack_cli.core.errors import InputError
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.evaluation.summary import Options, evaluate
from facetrack_cli.report import figures as plots
from facetrack_cli.report.command_line import command
from facetrack_cli.report.events import Clock, history_of, key_frames
from facetrack_cli.report.frames import Clip, Report, key_images
from facetrack_cli.report.measures import about, measures
from facetrack_cli.report.page import Content, Image, Plot, Truth, render, template
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.header import Header, read_header
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import Trajectory

NAME: Final = "report.html"
_VIDEO: Final = "annotated.mp4"
_MOST_SVG: Final = 400_000  # bytes; a larger drawing becomes a PNG
_WIDE, _NARROW = 10.0, 4.6  # inches


class TruthFile(NamedTuple):
    """The ground truth to measure against, and how: as `facetrack eval` takes them."""

    path: Path
    form: str = "auto"
    shift: int | None = None
    partial: bool = False
    target: str | None = None


class Page(NamedTuple):
    """The document, and lines on what is missing in it."""

    html: bytes
    notes: tuple[str, ...]


def make_report(
    run: Path,
    *,
    truth: TruthFile | None = None,
    clip: Path | None = None,
    title: str | None = None,
    report: Report = lambda done, total: None,
) -> Page:
    """The report of the run in the folder `run`; `report` gets the number of frames read, and of how many.

    Raises InputError for a folder without a JSON trajectory, a broken one, a `clip` that is not the run's, and ground
    truth that does not fit; UsageError without matplotlib or Jinja2.
    """
    plots.need_matplotlib()
    template()
    table = read_trajectory(trajectory_of(run))
    header = read_header(table)
    clock = Clock(table, header.source.fps)
    history = history_of(table, clock)
    pairs, measured = _measured(table, header, truth)
    title = f"{header.clip_name}, {header.recipe_name}" if title is None else title
    first, last = int(clock.frames[0]), int(clock.frames[-1])
    keys = key_frames(history, first, last)
    found = key_images(
        table,
        Clip(Path(header.source.path), header.source.size, header.source.fps),
        [key.frame for key in keys],
        given=clip,
        annotated=run / _VIDEO if (run / _VIDEO).is_file() else None,
        title=header.recipe_name,
        unit=max((max(t.box[2:]) for t in header.init.targets.values() if t.box), default=None),
        report=report,
    )
    plot, again = _plot(table, pairs, title), command(header, last, run)
    content = Content(title, table, header, clock, history, keys, found, plot, again, measured)
    return Page(render(content), tuple(found.notes))


def trajectory_of(run: Path) -> Path:
    """The trajectory of a run's folder that has a header. InputError, with the remedy, if there is none."""
    remedy = "name the folder of a run, which facetrack run wrote"
    if run.is_file():
        raise InputError(f"{run}: is a file; {remedy}")
    if not run.is_dir():
        raise InputError(f"{run}: no such folder; {remedy}")
    for form in ("json", "jsonl"):
        if (path := run / f"trajectory.{form}").is_file():
            return path
    if (run / "trajectory.csv").is_file():
        missing = "has trajectory.csv alone, without recipe and clip"
        raise InputError(f"{run}: {missing}; run again with --format csv,json")
    raise InputError(f"{run}: has no trajectory.json; {remedy}")


def _measured(table: Trajectory, header: Header, truth: TruthFile | None) -> tuple[list[Pair], Truth | None]:
    if truth is None:
        return [], None
    theirs = read_truth(truth.path, truth.form, shift=truth.shift or 0)
    notes: list[str] = []
    check = truth.shift is None
    pairs = match(table, theirs, partial=truth.partial, select=truth.target, check_shift=check, note=notes.append)
    found = evaluate(pairs, notes, Options(size=header.source.size), reference=theirs.parts)
    read_as = str(theirs.header.get("read_as", truth.form)) + (f", {truth.shift:+d} frames" if truth.shift else "")
    return pairs, Truth(str(theirs.path), f"Read as {read_as}. {about(found)}", measures(found), found.notes)


def _plot(table: Trajectory, pairs: list[Pair], title: str) -> Plot:
    """The plots, as a drawing that scales if it is small, and a narrow image for phones."""
    figure = plots.page_figure(table, pairs, title=title, width=_WIDE)
    width, height = figure.get_size_inches()
    size = (round(96 * width), round(96 * height))
    wide = Image(plots.render(figure, "svg"), "image/svg+xml", size)
    if len(wide.data) > _MOST_SVG:
        wide = Image(plots.render(figure, "png", dpi=150), "image/png", size)
    narrow = plots.render(plots.page_figure(table, pairs, title=title, width=_NARROW), "png", dpi=180)
    return Plot(wide, Image(narrow, "image/png", (442, 0)))
