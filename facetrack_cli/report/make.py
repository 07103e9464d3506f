"""One HTML file about one finished run: what happened in it, with pictures, and how it was made.

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
from facetrack_cli.report.events import Clock, key_frames, tell
from facetrack_cli.report.frames import Clip, Report, pictures
from facetrack_cli.report.html import Image
from facetrack_cli.report.measures import about, measures
from facetrack_cli.report.page import Content, Plot, Truth, render
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.header import Header, read_header
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import Trajectory

NAME: Final = "report.html"
_VIDEO: Final = "annotated.mp4"
_MOST_SVG: Final = 400_000  # bytes; a larger drawing becomes a PNG
_WIDE, _NARROW = 10.0, 4.6  # inches


class TruthFile(NamedTuple):
    """The truth to measure against, and how: as `facetrack eval` takes them."""

    path: Path
    form: str = "auto"
    shift: int | None = None
    partial: bool = False
    target: str | None = None


class Page(NamedTuple):
    """The document, and what could not be had for it, a line each."""

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
    """The report of the run in the folder `run`; `report` is told the frames read of how many.

    Raises InputError for a folder without a JSON trajectory, a broken one, a `clip` that is not the run's, and truth
    that does not fit; UsageError without matplotlib.
    """
    plots.need_matplotlib()
    table = read_trajectory(trajectory_of(run))
    header = read_header(table)
    clock = Clock(table, header.source.fps)
    story = tell(table, clock)
    pairs, measured = _measured(table, header, truth)
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
        report=report,
    )
    content = Content(
        title=title,
        table=table,
        header=header,
        clock=clock,
        story=story,
        keys=keys,
        pictures=found,
        plot=_plot(table, pairs, title),
        command=command(header, int(clock.frames[-1]), run),
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


def _measured(table: Trajectory, header: Header, truth: TruthFile | None) -> tuple[list[Pair], Truth | None]:
    if truth is None:
        return [], None
    theirs = read_truth(truth.path, truth.form, shift=truth.shift or 0)
    notes: list[str] = []
    pairs = match(
        table,
        theirs,
        partial=truth.partial,
        select=truth.target,
        check_shift=truth.shift is None,
        note=notes.append,
    )
    found = evaluate(pairs, notes, Options(size=header.source.size), reference=theirs.parts)
    read_as = str(theirs.header.get("read_as", truth.form)) + (f", {truth.shift:+d} frames" if truth.shift else "")
    return pairs, Truth(str(theirs.path), f"Read as {read_as}. {about(found)}", measures(found), found.notes)


def _plot(table: Trajectory, pairs: list[Pair], title: str) -> Plot:
    """The plots, as a drawing that scales if it is small, and a narrow picture for phones."""
    figure = plots.page_figure(table, pairs, title=title, width=_WIDE)
    width, height = figure.get_size_inches()
    size = (round(96 * width), round(96 * height))
    drawing = plots.render(figure, "svg")
    if len(drawing) <= _MOST_SVG:
        wide = Image(drawing, "image/svg+xml", size)
    else:
        wide = Image(plots.render(figure, "png", dpi=150), "image/png", size)
    narrow = plots.render(plots.page_figure(table, pairs, title=title, width=_NARROW), "png", dpi=180)
    return Plot(wide, Image(narrow, "image/png", (442, 0)))
