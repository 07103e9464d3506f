"""One HTML file about one finished run: what happened in it, with images, and how it was made."""

from __future__ import annotations

import base64
import hashlib
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import needed
from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.core.types import BOX
from facetrack_cli.evaluation.output import facts, sheets
from facetrack_cli.evaluation.rows import Pair, match
from facetrack_cli.evaluation.summary import Options, evaluate
from facetrack_cli.recipe.load import calibrated
from facetrack_cli.report import figures as plots
from facetrack_cli.report import text
from facetrack_cli.report.cast import cast_section
from facetrack_cli.report.command_line import command, init_yaml, recipe_yaml
from facetrack_cli.report.events import LostSpan, Stretch, history_of, key_frames
from facetrack_cli.report.frames import Image, Report, key_images
from facetrack_cli.run_folder.manifest import read_manifest, read_run, trajectory_of
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.diagnostics import EVIDENCE
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.header import CORRECTED, Header, read_header
from facetrack_cli.trajectory.trajectory import Trajectory, joined

MAX_ROWS: Final = 12  # of a table that is open
MAX_PARTS, MAX_SPANS = 100, 100  # rows of a table by part, and of the table of lost spans
_VIDEO: Final = "annotated.mp4"
_MAX_SVG_BYTES: Final = 1_000_000  # a larger drawing becomes a PNG
_WIDTH_INCHES: Final = 10.0
_BINS: Final = 1000  # of the bar that shows when a part was lost
# what HTML forbids, and lone surrogates, which names of files may hold and UTF-8 may not
_UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")


class TruthFile(NamedTuple):
    """The file of ground truth, and how it is read: as the options of `facetrack eval`."""

    path: Path
    form: str = "auto"
    shift: int = 0
    partial: bool = False
    target: str | None = None


class ReportPage(NamedTuple):
    """The document, and lines that say which images are missing."""

    html: bytes
    notes: tuple[str, ...]


def make_report(
    run: Path,
    *,
    truth: TruthFile | None = None,
    clip: Path | None = None,
    title: str | None = None,
    report: Report = lambda done, total: None,
) -> ReportPage:
    """The report of the run in the folder `run`, which fetches nothing and runs no script.

    Raises InputError for a folder without a JSON trajectory, a broken one, a `clip` that is not the run's, and ground
    truth that does not fit; UsageError without matplotlib or Jinja2.
    """
    plots.need_matplotlib()
    template = page_template("report.html.j2")
    table = read_run(trajectory_of(run))
    header = read_header(table)
    clock = Clock(table, header.source.fps)
    people, known = cast_section(run), read_manifest(run)
    followed = table if people is None else _boxes_of(table)  # of a film's people the points come and go with the box
    history = history_of(followed, clock, header.seams)
    pairs, measured = ([], None) if truth is None else _measured(table, header, truth)
    title = f"{header.clip_name}, {header.recipe_name}" if title is None else title
    first, last = int(clock.frames[0]), int(clock.frames[-1])
    keys = key_frames(history, first, last)
    shown = [key.frame for key in keys]
    annotated = run / _VIDEO if (run / _VIDEO).is_file() else None
    found = key_images(table, header, shown, clip, annotated, report)
    mean, looks = text.confidence_of(table), text.to_look_at(followed, history, clock)
    longest = sorted(history.spans, key=lambda s: -s.seconds)[:MAX_SPANS]
    again = command(header, last, run)
    network = f" Its points were placed {known.network}." if known is not None and known.network else ""
    document: str = template.render(
        title=title,
        header=header,
        clock=clock,
        history=history,
        summary=text.sentences(table, header, clock, history) + network,
        cast=people,
        parts=[one for one in history.parts if one.spans or one.hidings or one.absences],
        looks=looks,
        leading=next((frame for frame in (*(at for at, _ in looks), *shown) if frame in found.found), None),
        identities=list(text.identities(table, clock)),
        mean=mean,
        calibrated=calibrated(header.recipe),
        warnings=[*text.doubts(header, mean), *header.warnings, *found.notes],
        bars=lambda spans: _bars(spans, first, _BINS / (last - first + 1)),
        events=sorted(sorted(table.events, key=lambda event: -event.probability)[:MAX_SPANS]),
        several=len(table.targets) > 1,
        spans=sorted(longest, key=lambda s: (s.first, s.name)),
        keys=keys,
        images=found.found,
        from_clip=found.origin == "clip",
        some_left_out=not {frame for frame, _ in history.events} <= {*shown},
        reasons={key.frame: text.reasons(key, followed, history, header.init.origin) for key in keys},
        plot=_plot(table, pairs, title),
        reported=any(one.values.keys() - {EVIDENCE.name} for one in table.diagnostics.values())
        or bool((table.identity != "").any()),
        truth=measured,
        recipe=recipe_yaml(header.recipe),
        init=init_yaml(header),
        command=again,
        words=shlex.split(again),
        relative=not Path(header.source.path).is_absolute(),
    )
    return ReportPage(encoded(document), tuple(found.notes))


def _boxes_of(table: Trajectory) -> Trajectory:
    """The boxes alone."""
    return joined([one for one in table.parts if one.part == BOX], header=table.header, path=table.path)


def encoded(document: str) -> bytes:
    """The bytes of a page, without characters that HTML forbids."""
    return _UNFIT.sub("\ufffd", document).encode()


def page_template(name: str) -> Any:
    """A page's jinja2.Template, which escapes whatever is put into it. UsageError without Jinja2."""
    with needed("reports", "jinja2"):
        import jinja2
        from markupsafe import Markup

    folder = Path(__file__).parent
    loader, strict = jinja2.FileSystemLoader(folder), jinja2.StrictUndefined
    trim: Any = {"trim_blocks": True, "lstrip_blocks": True}
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=strict, **trim)
    filters = (text.count, text.lasting, text.names, text.number, text.percent)
    environment.filters |= {"clock": at_clock, **{one.__name__: one for one in filters}}
    style = (folder / "report.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    environment.globals |= {"style": Markup(style), "style_hash": f"sha256-{digest}", "version": __version__}
    environment.globals |= {
        "bins": _BINS,
        "max_parts": MAX_PARTS,
        "max_spans": MAX_SPANS,
        "max_rows": MAX_ROWS,
        "corrected": CORRECTED,
    }
    return environment.get_template(name)


def _measured(table: Trajectory, header: Header, truth: TruthFile) -> tuple[list[Pair], Mapping[str, Any]]:
    """The pairs of the run and its ground truth, and the words and tables of the page."""
    theirs = read_truth(truth.path, truth.form, shift=truth.shift)
    notes: list[str] = []
    pairs = match(table, theirs, partial=truth.partial, select=truth.target, note=notes.append)
    found = evaluate(pairs, notes, Options(size=header.source.size), reference=theirs.parts)
    read_as = str(theirs.header.get("read_as", truth.form)) + (f", {truth.shift:+d} frames" if truth.shift else "")
    words = {"about": f"Read as {read_as}; {'; '.join(facts(found))}.", "tables": list(sheets(found))}
    return pairs, {"path": str(theirs.path), **words, "notes": found.notes}


def _plot(table: Trajectory, pairs: list[Pair], title: str) -> Image:
    """The plots, as a drawing that scales if it is small."""
    figure = plots.page_figure(table, pairs, title=title, width=_WIDTH_INCHES)
    width, height = figure.get_size_inches()
    size = (round(96 * width), round(96 * height))
    drawing = plots.render(figure, "svg")
    if len(drawing) <= _MAX_SVG_BYTES:
        return Image(drawing, size, "image/svg+xml")
    return Image(plots.render(figure, "png", dpi=150), size, "image/png")


def _bars(spans: Sequence[LostSpan | Stretch], first: int, scale: float) -> list[tuple[float, float]]:
    """(left, width) of the bars to paint; bars are joined where there is no room for a gap."""
    least = 2.0 if len(spans) <= _BINS // 20 else 0.5  # a single frame of many must still be seen
    bars: list[tuple[float, float]] = []
    for span in spans:
        left, right = (span.first - first) * scale, (span.last + 1 - first) * scale
        if bars and left < sum(bars[-1]) + 0.2:
            left = bars.pop()[0]
        bars.append((left, max(right - left, least)))
    return bars
