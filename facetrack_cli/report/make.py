"""HTML pages: one of a finished run, what happened in it, with images, and how it was made; and one of a batch.

Each is a single file that fetches nothing and runs no script; that of a batch links to the files of its runs.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import shlex
import urllib.parse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import FacetrackError, InputError, needed
from facetrack_cli.core.files import TABLES
from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.core.types import BOX
from facetrack_cli.evaluation.rows import Pair, match
from facetrack_cli.evaluation.summary import Options, evaluate, facts, sheets
from facetrack_cli.recipe.load import calibrated
from facetrack_cli.report import figures as plots
from facetrack_cli.report import story
from facetrack_cli.report.command_line import command, init_yaml, recipe_yaml
from facetrack_cli.report.frames import Image, key_images
from facetrack_cli.report.story import LostSpan, Stretch, history_of, key_frames
from facetrack_cli.run_folder.manifest import REPORT, VIDEO, read_manifest, read_run, trajectory_of
from facetrack_cli.run_folder.status import ClipStatus, badness, name_of, survey
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.diagnostics import EVIDENCE
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.header import CORRECTED, Header, read_header
from facetrack_cli.trajectory.people import PersonRecord, TrackRecord, read_people, read_still
from facetrack_cli.trajectory.trajectory import Trajectory, joined

BATCH_PAGE: Final = "batch.html"
MAX_SPANS: Final = 100  # rows of a table
MAX_NOTES: Final = 5  # lines on clips of a batch without a picture
_MAX_SVG_BYTES: Final = 1_000_000  # a larger drawing becomes a PNG
_WIDTH_INCHES: Final = 10.0
_PERSON_PX, _STILL_PX = 120, 320  # the width of a picture of a person, and of a frame of a clip of a batch
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
    report: Report = silent,
) -> ReportPage:
    """The report of the run in the folder `run`.

    Raises InputError for a folder without a JSON trajectory, a broken one, a `clip` that is not the run's, and ground
    truth that does not fit; UsageError without matplotlib or Jinja2.
    """
    plots.need_matplotlib()
    template = page_template("report.html.j2")
    table = read_run(trajectory_of(run))
    header, people, manifest = read_header(table), read_people(run), read_manifest(run)
    clock = Clock(table, header.source.fps)
    followed = table
    if people is not None:  # the points of a film's people come and go with the box
        boxes = [one for one in table.parts if one.part == BOX]
        followed = joined(boxes, header=table.header, path=table.path)
    history = history_of(followed, clock, header.seams)
    pairs, measured = ([], None) if truth is None else _measured(table, header, truth)
    title = f"{header.clip_name}, {header.recipe_name}" if title is None else title
    first, last = int(clock.frames[0]), int(clock.frames[-1])
    keys = key_frames(history, first, last)
    shown = [key.frame for key in keys]
    images = key_images(table, header, shown, clip, _video(run), report)
    mean, looks = story.confidence_of(table), story.to_look_at(followed, history, clock)
    longest = sorted(history.spans, key=lambda s: -s.seconds)[:MAX_SPANS]
    again = command(header, last, run)
    network = f" Its points were placed {manifest.network}." if manifest is not None and manifest.network else ""

    def picture(one: PersonRecord | TrackRecord) -> Image | None:
        still = read_still(run, one.still)
        return Image(still, (_PERSON_PX, _PERSON_PX)) if still else None

    reported = any(one.values.keys() - {EVIDENCE.name} for one in table.diagnostics.values())
    document: str = template.render(
        title=title,
        header=header,
        clock=clock,
        history=history,
        summary=story.sentences(table, header, clock, history) + network,
        cast=people,
        seen=lambda person: [Stretch(begin, stop - 1) for begin, stop in person.intervals],
        picture=picture,
        pictures={} if people is None else {one.name: picture(one) for one in people.people},
        parts=[one for one in history.parts if one.spans or one.hidings or one.absences],
        looks=looks,
        leading=next((frame for frame in (*(at for at, _ in looks), *shown) if frame in images.found), None),
        identities=list(story.identities(table, clock)),
        mean=mean,
        calibrated=calibrated(header.recipe),
        warnings=[*story.doubts(header, mean), *header.warnings, *images.notes],
        bars=lambda spans: _bars(spans, first, _BINS / (last - first + 1)),
        events=sorted(sorted(table.events, key=lambda event: -event.probability)[:MAX_SPANS]),
        several=len(table.targets) > 1,
        spans=sorted(longest, key=lambda s: (s.first, s.name)),
        keys=keys,
        images=images.found,
        from_clip=images.origin == "clip",
        some_left_out=not {frame for frame, _ in history.events} <= {*shown},
        reasons={key.frame: story.reasons(key, followed, history, header.init.origin) for key in keys},
        plot=_plot(table, pairs, title),
        reported=reported or bool((table.identity != "").any()),
        truth=measured,
        recipe=recipe_yaml(header.recipe),
        init=init_yaml(header),
        command=again,
        words=shlex.split(again),
        relative=not Path(header.source.path).is_absolute(),
    )
    return ReportPage(encoded(document), tuple(images.notes))


def make_batch_report(batch: Path, to: Path, title: str | None = None, report: Report = silent) -> ReportPage:
    """The page about the runs in the folder `batch`, to be written to the file `to`: its clips, the worst first.

    Raises InputError for a folder without runs, UsageError without Jinja2.
    """
    template, found = page_template("batch.html.j2"), survey(batch)
    notes: list[str] = []
    rows = []
    for n, clip in enumerate(sorted(found.clips, key=badness)):
        report(n, len(found.clips))
        folder, still = batch / clip.folder, None
        if clip.state == "done":
            try:
                still = _still(folder, clip)
            except FacetrackError as e:
                notes.append(str(e))
        files = [folder / name for name in (REPORT, VIDEO, *TABLES) if (folder / name).is_file()]
        links = [(file.name, urllib.parse.quote(os.path.relpath(file, to.parent))) for file in files]
        rows.append({"clip": clip, "name": name_of(clip), "still": still, "links": links})
    if not rows:
        raise InputError(f"{batch}: has no runs yet; wait for the first, or look at facetrack status {batch}")
    title = f"{batch.resolve().name}, {len(rows)} clips" if title is None else title
    if len(notes) > MAX_NOTES:
        notes[MAX_NOTES:] = [f"and {len(notes) - MAX_NOTES} more clips without a picture"]
    return ReportPage(encoded(template.render(title=title, rows=rows, counts=found.counts)), tuple(notes))


def _video(run: Path) -> Path | None:
    return run / VIDEO if (run / VIDEO).is_file() else None


def _still(folder: Path, clip: ClipStatus) -> Image | None:
    """The frame to look at first, or else the middle one, reduced."""
    table = read_run(trajectory_of(folder))
    at = int(table.frames[len(table.frames) // 2]) if clip.still is None else clip.still
    images = key_images(table, read_header(table), [at], None, _video(folder), silent)
    if at not in images.found:
        return None
    image = cv2.imdecode(np.frombuffer(images.found[at].data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    size = (_STILL_PX, max(round(_STILL_PX * image.shape[0] / image.shape[1]), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return Image(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes(), size)


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
    filters = (story.count, story.lasting, story.names, story.number, story.percent)
    environment.filters |= {"clock": at_clock, **{one.__name__: one for one in filters}}
    style = (folder / "report.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    environment.globals |= {"style": Markup(style), "style_hash": f"sha256-{digest}", "version": __version__}
    environment.globals |= {"bins": _BINS, "max_spans": MAX_SPANS, "corrected": CORRECTED}
    return environment.get_template(name)


def _measured(table: Trajectory, header: Header, truth: TruthFile) -> tuple[list[Pair], Mapping[str, Any]]:
    """The pairs of the run and its ground truth, and the words and tables of the page."""
    theirs = read_truth(truth.path, truth.form, shift=truth.shift)
    notes: list[str] = []
    pairs = match(table, theirs, partial=truth.partial, select=truth.target, note=notes.append)
    found = evaluate(pairs, notes, Options(size=header.source.size), reference=theirs.parts)
    read_as = str(theirs.header.get("read_as", truth.form)) + (f", {truth.shift:+d} frames" if truth.shift else "")
    about = f"Read as {read_as}; {'; '.join(facts(found))}."
    return pairs, {"path": str(theirs.path), "about": about, "tables": list(sheets(found)), "notes": found.notes}


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
