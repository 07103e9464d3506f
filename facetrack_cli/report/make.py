"""HTML pages: one of a finished run, what happened in it, with images, and how it was made; and one of a batch.

Images are key frames of the clip with the overlay drawn on them. How the run was made is its recipe and start as YAML,
and the command that repeats it. Each page is a single file that fetches nothing and runs no script; that of a batch
links to the files of its runs. First comes what happened in a run: when each part was lost, hidden or absent, the
source frames that show it, and why.
"""

import base64
import contextlib
import hashlib
import io
import math
import os
import re
import shlex
import urllib.parse
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
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
from facetrack_cli.core.numbers import spans, union
from facetrack_cli.core.types import BOX, Frame
from facetrack_cli.core.types import Image as Pixels
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.evaluation.summary import evaluate, facts, sheets
from facetrack_cli.recipe.load import calibrated, fitted, load_recipe
from facetrack_cli.recipe.model import completed, to_dict
from facetrack_cli.report.figures.page import page_figure
from facetrack_cli.report.figures.style import need_matplotlib, render
from facetrack_cli.run_folder.manifest import REPORT, VIDEO, other_clip, read_manifest, read_run, trajectory_of
from facetrack_cli.run_folder.status import ClipStatus, badness, name_of, survey
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.start.init_file import as_yaml
from facetrack_cli.trajectory.diagnostics import DOUBTFUL, EVIDENCE, SURE
from facetrack_cli.trajectory.people import PersonRecord, TrackRecord, read_people, read_still
from facetrack_cli.trajectory.reader import Header, SeamHeader, read_header
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, joined, recorded
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.video.overlay import Overlay
from facetrack_cli.video.source import Frames, given_rate

MAX_KEY_FRAMES: Final = 12
_HEADINGS: Final = {
    "start": "Start", "corrected": "Corrected by hand", "seam": "Two chunks differ", "lost": "Called lost",
    "hidden": "Hidden", "back": "No longer called lost", "worst": "Lowest confidence", "end": "End",
}  # fmt: skip
"""Of each kind of reason to show a frame, in the order in which those of one frame stand."""
_DETECTORS: Final[Mapping[str, str]] = {"haar": "the Haar cascades", "yunet": "YuNet"}


class Stretch(NamedTuple):
    """Frames `first` to `last`, both included."""

    first: int
    last: int


class Span(NamedTuple):
    """A part lost, hidden or absent in frames `first` to `last`; `back`: where it is tracked again, if so; `by_hand`: a
    correction ended it; `lowest`: the lowest confidence, nan where there is none.
    """

    first: int
    last: int
    name: str
    back: int | None
    frames: int
    seconds: float
    by_hand: bool
    lowest: float


@dataclass(frozen=True)
class PartHistory:
    """One part: when it was lost, hidden and absent, its mean confidence after the start, its status at the end."""

    name: str
    rows: int
    mean: float
    last_status: str
    lost: tuple[Span, ...]
    hidden: tuple[Span, ...]
    absent: tuple[Span, ...]


@dataclass(frozen=True)
class RunHistory:
    """A whole run: its parts, the `episodes` in which any is lost, the frame of the lowest mean confidence of those in
    which none is, the frames with `corrections`, and the `seams` of a clip that was tracked in chunks.
    """

    parts: tuple[PartHistory, ...]
    episodes: tuple[Stretch, ...]
    frames_lost: int
    worst: int | None
    corrections: tuple[int, ...]
    seams: tuple[SeamHeader, ...] = ()

    @property
    def lost(self) -> list[Span]:
        """When parts were lost, in the order in which that begins."""
        return sorted(span for part in self.parts for span in part.lost)

    @property
    def hidden(self) -> list[Span]:
        return sorted(span for part in self.parts for span in part.hidden)

    @property
    def longest(self) -> list[Stretch]:
        """The three longest episodes, in their order."""
        return sorted(sorted(self.episodes, key=lambda episode: episode.first - episode.last)[:3])

    def ending(self, status: str) -> list[str]:
        """The parts with this status at the end."""
        return [part.name for part in self.parts if part.last_status == status]


def history_of(table: Trajectory, clock: Clock, seams: tuple[SeamHeader, ...] = ()) -> RunHistory:
    """What happened, from the rows of a trajectory; `seams` are where chunks of its clip meet."""
    several, boxes = len(table.targets) > 1, all(part == BOX for _, part in table.names)
    parts = tuple(
        _part(rows, (rows.target if boxes else rows.name) if several else rows.part, clock) for rows in table.parts
    )
    any_lost = np.isin(clock.frames, table.frame[table.status == "lost"])
    # as the run says it: frames in which a part is lost are shown as such
    sure = np.isfinite(table.confidence) & (table.status != "init") & ~np.isin(table.frame, clock.frames[any_lost])
    frames, place = np.unique(table.frame[sure], return_inverse=True)
    mean = np.round(np.bincount(place, table.confidence[sure]) / np.bincount(place), 12)
    return RunHistory(
        parts,
        tuple(Stretch(int(clock.frames[a]), int(clock.frames[b - 1])) for a, b in spans(any_lost)),
        int(any_lost.sum()),
        int(frames[np.argmin(mean)]) if len(frames) else None,
        tuple(np.unique(np.concatenate([rows.frame[rows.corrected] for rows in table.parts])).tolist()),
        seams,
    )


def _part(rows: Trajectory, name: str, clock: Clock) -> PartHistory:
    frames = [*rows.frame.tolist(), int(rows.frame[-1]) + 1]

    def unseen(status: str) -> Iterator[Span]:
        for a, b in spans(rows.status == status):
            ends = b < len(rows)
            back = frames[b] if ends and rows.status[b] != "absent" else None
            seconds, lowest = clock.at(frames[b]) - clock.at(frames[a]), float(np.fmin.reduce(rows.confidence[a:b]))
            yield Span(frames[a], frames[b - 1], name, back, b - a, seconds, ends and bool(rows.corrected[b]), lowest)

    lost, hidden, absent = (tuple(unseen(status)) for status in ("lost", "hidden", "absent"))
    mean = confidence_of(rows)
    return PartHistory(name, len(rows), math.nan if mean is None else mean, str(rows.status[-1]), lost, hidden, absent)


def key_frames(history: RunHistory, events: Iterable[int], first: int, last: int) -> list[int]:
    """At most MAX_KEY_FRAMES: the first, the last, that of the lowest mean confidence, and of `events`. Of too many
    events that where the longest episode begins, then, one by one, that furthest in time from all taken.
    """
    left, taken = np.array(sorted({*events, first})), {first, last}
    taken |= set() if history.worst is None else {history.worst}
    taken |= {min(history.episodes, key=lambda e: e.first - e.last).first} if history.episodes else set()
    while len(taken) < MAX_KEY_FRAMES:
        away = np.abs(left[:, None] - np.array(sorted(taken))).min(axis=1)
        if not away.max():
            break
        taken.add(int(left[np.argmax(away)]))
    return sorted(taken)


def reasons(
    table: Trajectory, history: RunHistory, origin: str, first: int, last: int
) -> dict[int, list[tuple[str, str, str]]]:
    """By frame, (kind, heading, words) of each reason to show it; `origin` is that of the start, as `--box`."""
    why: dict[int, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    why[first]["start"] = [f"placed by {_DETECTORS.get(origin) or Path(origin).name or origin}"]
    for frame in history.corrections:
        rows = table.at(frame)
        for part, status in zip(rows.which.tolist(), rows.status.tolist(), strict=True):
            if status in ("init", "absent"):
                why[frame]["corrected"].append(history.parts[part].name + " absent" * (status == "absent"))
    for seam in history.seams:
        if not seam.agrees:
            why[seam.frame]["seam"] = [f"they agree in {percent(seam.agreement)} of the frames that both have"]
    for span in history.lost:
        why[span.first]["lost"].append(span.name)
        if span.back is not None and not span.by_hand:
            why[span.back]["back"].append(f"{span.name} after {lasting(span.seconds)}")
    for span in history.hidden:
        why[span.first]["hidden"].append(f"{span.name} for {lasting(span.seconds)}")
    if history.worst is not None:
        why[history.worst]["worst"] = [number(float(np.nanmean(table.at(history.worst).confidence)))]
    ends = [f"{status}: {names(gone, 5)}" for status in ("lost", "absent") if (gone := history.ending(status))]
    why[last]["end"] = ["; ".join(ends) or "nothing is lost"]
    return {
        frame: [(kind, heading, names(own[kind], 5)) for kind, heading in _HEADINGS.items() if kind in own]
        for frame, own in why.items()
    }


def identities(table: Trajectory) -> Iterator[tuple[str, str, float, int | None]]:
    """Of each target with an identity the last one, its probability, and the frame since which it is sure."""
    for target in table.targets:
        rows = table.of_target(target)[0]
        for last in np.flatnonzero(rows.identity != "")[-1:]:
            name = str(rows.identity[last])
            yield target, name, float(rows.identity_prob[last]), table.recognised(target, name)


def confidence_of(table: Trajectory) -> float | None:
    """The mean confidence of all rows after the start, also of rows called lost; None without confidences."""
    sure = table.confidence[np.isfinite(table.confidence) & (table.status != "init")]
    return float(sure.mean()) if sure.size else None


def doubts(header: Header, mean: float | None) -> list[str]:
    """A line if a confidence of this mean speaks against the track, be it calibrated with other settings."""
    if mean is None or mean >= DOUBTFUL or not fitted(header.recipe):
        return []
    return ["The track is doubtful: by its confidence fewer than half of its rows are right"]


# --- in words --------------------------------------------------------------------------------------------------------


def count(n: int, singular: str, many: str = "") -> str:
    """`1 frame`, `2 frames`, `12,000 frames`."""
    return f"{n:,} {singular if n == 1 else many or singular + 's'}"


def lasting(seconds: float) -> str:
    """A length of time."""
    if not math.isfinite(seconds):
        return "–"
    return f"{seconds:.2f} s" if seconds < 60 else at_clock(seconds)


def percent(share: float | None) -> str:
    """A share in percent; 0 % and 100 % stand for exactly none and all."""
    if share is None or not math.isfinite(share):
        return "–"
    return f"{100 * share:.0f}\u00a0%" if share in (0, 1) else f"{100 * min(max(share, 0.001), 0.999):.1f}\u00a0%"


def number(value: float | None, decimals: int = 2) -> str:
    """A figure, or a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def names(items: Sequence[str], most: int = 8) -> str:
    """`a, b and c`; of many, the first and how many more."""
    if len(items) > most:
        return f"{', '.join(items[: most - 1])} and {len(items) - most + 1} more"
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


# --- the pages -------------------------------------------------------------------------------------------------------


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
    why = reasons(followed, history, header.init.origin, first, last)
    keys = key_frames(history, why, first, last)
    images, notes = key_images(table, header, keys, clip, report)
    mean, looks = confidence_of(table), [*(episode.first for episode in history.longest), history.worst]
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
        identities=list(identities(table)),
        mean=mean,
        calibrated=calibrated(header.recipe),
        warnings=[*doubts(header, mean), *header.warnings, *notes],
        bars=lambda spans: _bars(spans, first, _BINS / (last - first + 1)),
        events=sorted(sorted(table.events, key=lambda event: -event.probability)[:MAX_SPANS]),
        several=len(table.targets) > 1,
        spans=sorted(sorted(history.lost, key=lambda span: -span.seconds)[:MAX_SPANS]),
        keys=keys,
        images=images,
        some_left_out=not why.keys() <= {*keys},
        reasons={frame: why[frame] for frame in keys},
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
    return Image(_jpeg(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), 80), size)


def encoded(document: str) -> bytes:
    """The bytes of a page, without characters that HTML forbids."""
    return _UNFIT.sub("\ufffd", document).encode()


def page_template(name: str) -> Any:
    """A page's jinja2.Template, which escapes whatever is put into it. UsageError without Jinja2."""
    with needed("reports", "jinja2"):
        return _templates().get_template(name)


@cache
def _templates() -> Any:
    """A jinja2.Environment: it keeps the pages that it has compiled, which takes longer than to fill one."""
    import jinja2
    from markupsafe import Markup

    folder = Path(__file__).parent
    loader, strict = jinja2.FileSystemLoader(folder), jinja2.StrictUndefined
    trim: Any = {"trim_blocks": True, "lstrip_blocks": True}
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=strict, **trim)
    filters = (count, lasting, names, number, percent)
    environment.filters |= {"clock": at_clock, **{function.__name__: function for function in filters}}
    style = (folder / "report.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    environment.globals |= {"style": Markup(style), "style_hash": f"sha256-{digest}", "version": __version__}
    environment.globals |= {"bins": _BINS, "max_spans": MAX_SPANS, "sure": SURE}
    return environment


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
