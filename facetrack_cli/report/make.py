"""HTML pages: one of a finished run, what happened in it, with images, and how it was made; and one of a batch.

Images are key frames of the clip with the overlay drawn on them. How the run was made is its recipe and start as YAML,
and the command that repeats it. Each page is a single file that fetches nothing and runs no script; that of a batch
links to the files of its runs.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import io
import math
import os
import re
import shlex
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from ruamel.yaml import YAML

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import FacetrackError, InputError, needed
from facetrack_cli.core.files import TABLES
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.core.numbers import union
from facetrack_cli.core.types import BOX, Frame
from facetrack_cli.core.types import Image as Pixels
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.evaluation.summary import evaluate, facts, sheets
from facetrack_cli.recipe.load import calibrated, load_recipe
from facetrack_cli.recipe.model import completed, to_dict
from facetrack_cli.report import story
from facetrack_cli.report.figures.page import page_figure
from facetrack_cli.report.figures.style import need_matplotlib, render
from facetrack_cli.report.story import Span, Stretch, history_of, key_frames
from facetrack_cli.run_folder.manifest import REPORT, VIDEO, other_clip, read_manifest, read_run, trajectory_of
from facetrack_cli.run_folder.status import ClipStatus, badness, name_of, survey
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.start.init_file import as_yaml
from facetrack_cli.trajectory.diagnostics import EVIDENCE, SURE
from facetrack_cli.trajectory.people import PersonRecord, TrackRecord, read_people, read_still
from facetrack_cli.trajectory.reader import Header, read_header
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, joined, recorded
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.video.overlay import Overlay
from facetrack_cli.video.source import Frames, given_rate


def recipe_yaml(recipe: Mapping[str, Any]) -> str:
    """A recipe file of these settings."""
    text = io.StringIO()
    writer: Any = YAML(typ="safe", pure=True)
    writer.default_flow_style, writer.sort_base_mapping_type_on_output, writer.width = None, False, 120
    writer.dump({key: value for key, value in recipe.items() if key != "name"}, text)
    return text.getvalue()


def command(header: Header, last: int) -> str:
    """The command that makes the run again, up to the frame `last`, with the start of the page as NAME.init.yaml, and
    with its recipe as NAME.yaml, where that is not the shipped one.
    """
    name, source, recipe = header.recipe_name, header.source, dict(header.recipe)
    shipped = name in (file.stem for file in shipped_recipes())
    with contextlib.suppress(FacetrackError):  # of another version
        shipped = shipped and to_dict(load_recipe(name)) | {"seed": 0, "name": name} == completed(recipe) | {"seed": 0}
    words = ["facetrack", "run", source.path, "--config", name if shipped else f"{name}.yaml"]
    words += ["--init", f"{name}.init.yaml"] if header.init.targets else ["--faces", "all"]  # a film has no start
    words += ["--start", str(header.init.frame)] if header.init.frame and not header.init.targets else []
    words += ["--seed", str(header.seed), "--stop", str(last + 1)]
    if header.smoothed is not None:
        words += ["--lag", str(lag)] if (lag := header.smoothed.get("lag")) else ["--smooth"]
    words += [] if source.stream is None else ["--stream", str(source.stream)]
    with contextlib.suppress(FacetrackError, OSError, ValueError):
        rate = given_rate(Path(source.path), source.fps)
        words += ["--fps", str(rate)] if rate else []
    words += ["--split", header.split["length"]] if "length" in header.split else []
    return shlex.join([*words, "-o", "again"])


MIN_SIZE: Final = (640, 480)  # images are enlarged to fit this, so that the overlay can be read ...
MAX_SIZE: Final = (960, 720)  # ... and reduced to fit this
_VIEW = 3.5  # an image shows this many times the target's size; larger clips are cut out around it
View: TypeAlias = tuple[int, int, int, int]  # left, top, width, height in the clip's pixels


class Image(NamedTuple):
    """Bytes of an image, its (width, height) in CSS pixels, its MIME type, and what of the clip it shows."""

    data: bytes
    size: tuple[int, int]
    mime: str = "image/jpeg"
    view: View = (0, 0, 0, 0)

    @property
    def uri(self) -> str:
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"


def key_images(
    table: Trajectory, header: Header, wanted: Sequence[int], clip: Path | None, report: Report
) -> tuple[dict[int, Image], list[str]]:
    """Images of the `wanted` frames that could be made, from `clip` or the header's; notes on what is missing.

    Raises InputError if `clip` is not the run's.
    """
    source, done, notes, path = header.source, dict[int, Image](), list[str](), clip or Path(header.source.path)
    marked = [replace(part, by_hand=part.corrected) for part in table.parts]
    table = joined(marked, header=table.header, path=table.path, diagnostics=table.diagnostics)
    clock = Clock(table, source.fps)
    try:
        if (other := other_clip(table, path)) is not None:
            raise InputError(other)
        with Frames(path, fps=given_rate(path, source.fps), stream=source.stream) as frames:
            if frames.size != source.size:
                is_, was = (f"{width}x{height}" for width, height in (frames.size, source.size))
                raise InputError(f"{path}: is {is_}, not {was} pixels as in the run")
            for index in sorted(wanted):
                done[index] = _drawn(frames.read(index), clock.at(index), table.at(index), header)
                report(len(done), len(wanted))
    except InputError as e:
        notes.append(str(e) if "--clip" in str(e) else f"{e}; name its clip with --clip")
        if clip is not None:
            raise InputError(notes[0]) from None
    return done, notes


def _drawn(frame: Frame, seconds: float, rows: Trajectory, header: Header) -> Image:
    """The image of a frame of the clip: cut out, scaled, with the overlay of `facetrack run` but for the trail."""
    left, top, width, height = view = _view(rows, header)
    least, most = (min(limit[0] / width, limit[1] / height) for limit in (MIN_SIZE, MAX_SIZE))
    enlarged = min(max(least, 1.0), most)
    out = max(round(width * enlarged), 1), max(round(height * enlarged), 1)
    part = np.ascontiguousarray(frame.bgr[top : top + height, left : left + width])
    whole = cv2.resize(part, out, interpolation=cv2.INTER_AREA if out[0] < width else cv2.INTER_CUBIC)
    scaled, zoom = Frame(frame.index, seconds, np.asarray(whole, np.uint8), aspect=frame.aspect), out[0] / width
    columns = {name: getattr(rows, name) * zoom for name in ("std_x", "std_y")}
    columns |= {name: np.nan_to_num(getattr(rows, name)) * zoom for name in "wh"}
    columns |= {name: (getattr(rows, name) - at + 0.5) * zoom - 0.5 for name, at in zip("xy", view, strict=False)}
    shown = replace(rows, **columns, status=np.where(rows.status == "", "tracked", rows.status))
    # without diagnostics: their numbers stand in the plots
    targets = (each._replace(rows=replace(each.rows, diagnostics={})) for each in recorded(frame.index, shown))
    result = FrameResult(scaled, tuple(targets))
    return Image(_jpeg(Overlay(out, title=header.recipe_name, trail_s=0).draw(result)), out, view=view)


def _view(rows: Trajectory, header: Header) -> View:
    """The part of the clip to show of a frame with these rows."""
    width, height = header.source.size
    targets = header.init.targets.values()
    sides = [side for target in targets for side in (target.box or ())[2:]]
    sides += [2 * float(np.ptp([*target.points.values()], axis=0).max()) for target in targets if target.points]
    unit = max(sides, default=0.0) or max(width, height)
    rows = rows.take((rows.x >= 0) & (rows.x < width) & (rows.y >= 0) & (rows.y < height))  # nan is not
    shown = 1.25 * _VIEW * unit  # a little less than the whole is not worth a cut
    if max(width, height) <= shown or not len(rows):
        return 0, 0, width, height
    x, y, half_w, half_h = rows.x, rows.y, np.nan_to_num(rows.w) / 2, np.nan_to_num(rows.h) / 2
    across, down = (x + half_w).max() - (x - half_w).min(), (y + half_h).max() - (y - half_h).min()
    wide = max(_VIEW * unit, 1.4 * across, 1.9 * down)
    w, h = min(width, math.ceil(wide)), min(height, math.ceil(0.75 * wide))
    left = round(min(max((x.min() + x.max() - w) / 2, 0), width - w))
    top = round(min(max((y.min() + y.max() - h) / 2, 0), height - h))
    return left, top, w, h


def _jpeg(image: Pixels, quality: int = 85) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


BATCH_PAGE: Final = "batch.html"
MAX_SPANS: Final = 100  # rows of a table
_PERSON_PX, _STILL_PX = 120, 320  # the width of a picture of a person, and of a frame of a clip of a batch
_BINS: Final = 1000  # of the bar that shows when a part was lost
# what HTML forbids, and lone surrogates, which names of files may hold and UTF-8 may not
_UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")


Pairing: TypeAlias = Callable[[Trajectory, Trajectory, Callable[[str], None]], list[Pair]]
"""Rows of a trajectory beside those of the ground truth, as `match` makes them; called with what takes its notes."""


class ReportPage(NamedTuple):
    """The document, and lines that say which images are missing."""

    html: bytes
    notes: tuple[str, ...]


def make_report(
    run: Path, *, truth: tuple[Trajectory, Pairing] | None = None, clip: Path | None = None, report: Report = silent
) -> ReportPage:
    """The report of the run in the folder `run`, beside ground truth and what pairs its rows with those of the run.

    Raises InputError for a folder without a JSON trajectory, a broken one, a `clip` that is not the run's, and ground
    truth that does not fit; UsageError without matplotlib or Jinja2.
    """
    need_matplotlib()
    template = page_template("report.html.j2")
    table = read_run(trajectory_of(run))
    header, people, manifest = read_header(table), read_people(run), read_manifest(run)
    clock = Clock(table, header.source.fps)
    # the points of a film's people come and go with the box
    boxes = [part for part in table.parts if part.part == BOX]
    followed = table if people is None else joined(boxes, header=table.header, path=table.path)
    history = history_of(followed, clock, header.seams)
    pairs, measured = ([], None) if truth is None else _measured(table, header, *truth)
    title = f"{header.clip_name}, {header.recipe_name}"
    first, last = int(clock.frames[0]), int(clock.frames[-1])
    reasons = story.reasons(followed, history, header.init.origin, first, last)
    keys = key_frames(history, reasons, first, last)
    images, notes = key_images(table, header, keys, clip, report)
    mean, looks = story.confidence_of(table), [*(episode.first for episode in history.longest), history.worst]
    again = command(header, last)

    def picture(entry: PersonRecord | TrackRecord) -> Image | None:
        still = read_still(run, entry.still)
        return Image(still, (_PERSON_PX, _PERSON_PX)) if still else None

    reported = any(each.values.keys() - {EVIDENCE.name} for each in table.diagnostics.values())
    document: str = template.render(
        title=title,
        header=header,
        clock=clock,
        history=history,
        network=manifest and manifest.network,
        cast=people,
        seen=lambda person: [Stretch(begin, stop - 1) for begin, stop in person.intervals],
        picture=picture,
        pictures={} if people is None else {person.name: picture(person) for person in people.people},
        parts=[part for part in history.parts if part.lost or part.hidden or part.absent],
        leading=next((frame for frame in (*looks, *keys) if frame in images), None),
        identities=list(story.identities(table)),
        mean=mean,
        calibrated=calibrated(header.recipe),
        warnings=[*story.doubts(header, mean), *header.warnings, *notes],
        bars=lambda spans: _bars(spans, first, _BINS / (last - first + 1)),
        events=sorted(sorted(table.events, key=lambda event: -event.probability)[:MAX_SPANS]),
        several=len(table.targets) > 1,
        spans=sorted(sorted(history.lost, key=lambda span: -span.seconds)[:MAX_SPANS]),
        keys=keys,
        images=images,
        some_left_out=not reasons.keys() <= {*keys},
        reasons={frame: reasons[frame] for frame in keys},
        plot=_plot(table, pairs, title),
        reported=reported or bool((table.identity != "").any()),
        truth=measured,
        recipe=recipe_yaml(header.recipe),
        init=as_yaml(header.init.start, header.clip_name),
        command=again,
        words=shlex.split(again),
        by_hand=bool(table.by_hand.any() or (people is not None and people.corrections)),
        relative=not Path(header.source.path).is_absolute(),
    )
    return ReportPage(encoded(document), tuple(notes))


def make_batch_report(batch: Path, to: Path, report: Report = silent) -> ReportPage:
    """The page about the runs in the folder `batch`, to be written to the file `to`: its clips, the worst first.

    Raises InputError for a folder without runs, UsageError without Jinja2.
    """
    template, progress = page_template("batch.html.j2"), survey(batch)
    notes, rows = list[str](), list[dict[str, Any]]()
    for n, clip in enumerate(sorted(progress.clips, key=badness)):
        report(n, len(progress.clips))
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
    title = f"{batch.resolve().name}, {len(rows)} clips"
    return ReportPage(encoded(template.render(title=title, rows=rows, counts=progress.counts)), tuple(notes))


def _still(folder: Path, clip: ClipStatus) -> Image | None:
    """The frame to look at first, or else the middle one, reduced."""
    table = read_run(trajectory_of(folder))
    at = int(table.frames[len(table.frames) // 2]) if clip.still is None else clip.still
    images, _ = key_images(table, read_header(table), [at], None, silent)
    if at not in images:
        return None
    image = cv2.imdecode(np.frombuffer(images[at].data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    size = (_STILL_PX, max(round(_STILL_PX * image.shape[0] / image.shape[1]), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return Image(_jpeg(np.asarray(small, np.uint8), 80), size)


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
    environment.filters |= {"clock": at_clock, **{function.__name__: function for function in filters}}
    style = (folder / "report.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    environment.globals |= {"style": Markup(style), "style_hash": f"sha256-{digest}", "version": __version__}
    environment.globals |= {"bins": _BINS, "max_spans": MAX_SPANS, "sure": SURE}
    return environment.get_template(name)


def _measured(
    table: Trajectory, header: Header, truth: Trajectory, pair: Pairing
) -> tuple[list[Pair], Mapping[str, Any]]:
    """The pairs of the run and its ground truth, and the words and tables of the page."""
    notes: list[str] = []
    pairs = pair(table, truth, notes.append)
    measures = evaluate(pairs, notes, size=header.source.size, reference=truth.parts)
    shift = f", {truth.header['shift']:+d} frames" if truth.header["shift"] else ""
    about = f"Read as {truth.header['read_as']}{shift}; {'; '.join(facts(measures))}."
    return pairs, {"path": str(truth.path), "about": about, "tables": list(sheets(measures)), "notes": measures.notes}


def _plot(table: Trajectory, pairs: list[Pair], title: str) -> Image:
    figure = page_figure(table, pairs, title=title)
    width, height = figure.get_size_inches()
    return Image(render(figure, dpi=150), (round(96 * width), round(96 * height)), "image/png")


def _bars(spans: Sequence[Span | Stretch], first: int, scale: float) -> list[tuple[float, float]]:
    """(left, width) of the bars to paint; bars are joined where there is no room for a gap."""
    least = 2.0 if len(spans) <= _BINS // 20 else 0.5  # a single frame of many must still be seen
    bars = union((((span.first - first) * scale, (span.last + 1 - first) * scale) for span in spans), 0.2)
    return [(left, max(right - left, least)) for left, right in bars]
