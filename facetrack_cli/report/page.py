"""The report as HTML: what happened at the top, how it was made at the bottom."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.report.command_line import init_yaml, needs_file, recipe_yaml
from facetrack_cli.report.diagnostics import named
from facetrack_cli.report.events import Clock, Corrected, KeyFrame, LostSpan, Story
from facetrack_cli.report.frames import Pictures
from facetrack_cli.report.html import Html, Image, join, page, pairs, section, table, tag, void
from facetrack_cli.report.measures import Measures
from facetrack_cli.report.text import count, ended, lasting, names, number, percent, rate, sentences, why
from facetrack_cli.trajectory.header import CORRECTED, Header
from facetrack_cli.trajectory.start import TargetRecord
from facetrack_cli.trajectory.trajectory import Trajectory

MOST_SPANS = 100  # rows of the table of lost spans


_CORRECTED = " A filled diamond is what a correction gave; what is absent is not drawn."


_LEGEND = (
    "A solid window with a dot is a part that is tracked, a dashed one with a cross a part called lost, a diamond "
    "where the track began. The line is the way of the last second, the ellipse two standard deviations of the "
    "particles."
)


def render(content: Content) -> bytes:
    """The document as UTF-8."""
    sections = [
        summary(content),
        _key_frames(content),
        _plots(content),
        *([_against_truth(content.truth)] if content.truth else []),
        *([_spans(content)] if content.story.spans else []),
        _making(content),
    ]
    return page(content.title, join([_head(content), *sections, _foot(content)], "\n"))


def _head(content: Content) -> Html:
    source = content.header.source
    links = [("summary", "Summary"), ("key-frames", "Key frames"), ("over-time", "Over time")]
    links += [("truth", "Against the truth")] if content.truth else []
    links += [("lost", "Lost and found")] if content.story.spans else []
    links += [("making", "How it was made")]
    facts = (
        f"{content.header.clip_name} · {source.size[0]} × {source.size[1]} pixels, {rate(content.header)} · "
        f"recipe {content.header.recipe_name} · seed {content.header.seed}"
    )
    return tag(
        "header",
        tag("p", "Report of a facetrack run", class_="kicker"),
        tag("h1", content.title),
        tag("p", facts, class_="facts"),
        tag("nav", *(tag("a", text, href=f"#{name}") for name, text in links), aria_label="On this page"),
    )


def _key_frames(content: Content) -> Html:
    found = content.pictures
    if not found.found:
        text = (
            "There are no pictures: neither the clip nor annotated.mp4 could be read. The option --clip names the clip."
        )
        return section("key-frames", "Key frames", tag("p", text))
    origin = {
        "clip": f"Frames of {content.header.clip_name}, with what facetrack run draws on them.",
        "annotated": "Frames of annotated.mp4, since the clip itself could not be had.",
    }[found.origin]
    some = not {frame for frame, _ in content.story.events} <= {key.frame for key in content.keys}
    ends = "Start, end, lowest confidence" if content.story.worst is not None else "Start, end"
    chosen = (
        f"{ends}, and where the longest stretches began and ended in which a part was lost, with others spread over "
        "the rest."
        if some
        else f"{ends}, and every frame in which a part was called lost or tracked again"
        + (", or put right by hand." if content.story.corrections else ".")
    )
    shown = [_figure(content, key) for key in content.keys if key.frame in found.found]
    return section(
        "key-frames",
        "Key frames",
        tag("p", f"{origin} {chosen}"),
        tag("p", _LEGEND + (_CORRECTED if content.story.corrections else ""), class_="note"),
        tag("div", *shown, class_="frames"),
    )


def _figure(content: Content, key: KeyFrame) -> Html:
    picture = content.pictures.found[key.frame]
    confidence, gone, absent = {}, [], []
    for series, part in zip(content.table.parts, content.story.parts, strict=True):
        at = int(np.searchsorted(series.frame, key.frame))
        if at < len(series) and series.frame[at] == key.frame:
            confidence[part.name] = float(series.confidence[at])
            gone += [part.name] if series.status[at] == "lost" else []
            absent += [part.name] if series.status[at] == "absent" else []
    known = [value for value in confidence.values() if value == value]
    mean = sum(known) / len(known) if known else float("nan")
    origin = _origin(content.header)
    said = [(e.kind, *why(e, confidence, mean, origin, gone, len(confidence), absent)) for e in key.events]
    when = f"Frame {key.frame}"
    time = at_clock(content.clock.at(key.frame))
    alt = f"{when} at {time}. " + " ".join(f"{heading}: {words}." for _, heading, words in said)
    left, top, width, height = picture.view
    whole = content.header.source.size
    part_of = (
        tag("p", f"{width} × {height} of {whole[0]} × {whole[1]} pixels, from ({left}, {top})", class_="small")
        if (width, height) != tuple(whole)
        else ""
    )
    image = Image(picture.jpeg, "image/jpeg", picture.size)
    return tag(
        "figure",
        void("img", src=Html(image.uri), width=image.size[0], height=image.size[1], alt=alt),
        tag(
            "figcaption",
            tag("p", tag("strong", when), f" · {time}"),
            tag("ul", *(tag("li", tag("strong", heading), f" {words}", class_=kind) for kind, heading, words in said)),
            part_of,
        ),
    )


def _origin(header: Header) -> str:
    told = {"haar": "the Haar cascades", "--box": "--box"}
    return told.get(header.init.origin, Path(header.init.origin).name or header.init.origin)


def _plots(content: Content) -> Html:
    wide, narrow = content.plot.wide, content.plot.narrow
    reported = bool(content.table.diagnostics) or bool((content.table.identity != "").any())
    alt = (
        "Plots over time: position and size of each part, confidence with lost spans shaded, status, particles and "
        "effective sample size, spread"
        + (", what the tracker told of identity, scale, noise and error" if reported else "")
        + (", error against the truth." if content.truth else ".")
    )
    picture = tag(
        "picture",
        void("source", media="screen and (max-width: 40rem)", srcset=Html(narrow.uri)),
        void("img", src=Html(wide.uri), width=wide.size[0], height=wide.size[1], alt=alt),
    )
    return section("over-time", "Over time", tag("figure", picture, class_="plot"))


def _against_truth(truth: Truth) -> Html:
    return section(
        "truth",
        "Against the truth",
        tag("p", "Truth: ", tag("code", truth.path), f". {truth.about}"),
        *(table(m.caption, m.head, m.rows[: MOST_PARTS + 1]) for m in truth.tables),
        tag("ul", *(tag("li", note) for note in (*truth.notes, "facetrack eval prints all measures")), class_="note"),
    )


def _spans(content: Content) -> Html:
    """The lost spans in their order; of too many, the longest."""
    clock, spans = content.clock, content.story.spans
    shown = sorted(sorted(spans, key=lambda s: -s.seconds)[:MOST_SPANS], key=lambda s: (s.first, s.name))
    head = ("part", "lost in frame", "at", "tracked again in frame", "at", "frames", "time", "lowest confidence")
    rows = [
        (
            span.name,
            span.first,
            at_clock(clock.at(span.first)),
            _again(span),
            "–" if span.back is None else at_clock(clock.at(span.back)),
            f"{span.frames:,}",
            lasting(span.seconds),
            number(span.lowest),
        )
        for span in shown
    ]
    many = len(spans) > MOST_SPANS
    note = f"The {MOST_SPANS} longest of {len(spans):,} lost spans; trajectory.csv has all." if many else ""
    return section(
        "lost",
        "Lost and found",
        *([tag("p", note, class_="note")] if many else []),
        table("Every time that a part was lost" if not many else "The longest times that a part was lost", head, rows),
    )


def _again(span: LostSpan) -> Html | str:
    if span.back is None:
        return "absent then" if span.by_hand else tag("span", "never", class_="bad-text")
    return f"{span.back}, by hand" if span.by_hand else str(span.back)


def _versions(header: Header) -> list[str]:
    return [f"{name} {version}" for name, version in {"facetrack": header.facetrack, **header.versions}.items()]


def _making(content: Content) -> Html:
    header = content.header
    source, init = header.source, header.init
    facts: list[tuple[object, object]] = [
        ("Clip", tag("code", source.path)),
        ("Size, rate", f"{source.size[0]} × {source.size[1]} pixels, {rate(header)}"),
        ("Frames", f"{content.clock.frames[0]} to {content.clock.frames[-1]} of the clip, counted from 0"),
        ("Began", f"in frame {init.frame}, placed by {_began(init.origin)}"),
        *_places(init.targets),
        *([("Put right", _corrected(content.story))] if content.story.corrections else []),
        ("Seed", header.seed),
        ("Versions", f"run by {', '.join(_versions(header))}; this page by facetrack {__version__}"),
    ]
    where = "" if Path(source.path).is_absolute() else " Paths are as given then: call it in the same folder."
    saved = [f"the recipe above as {header.recipe_name}.yaml"] if needs_file(header) else []
    saved += [f"the init file above as {CORRECTED}"] if f"--init {CORRECTED} " in content.command else []
    file = f" Save {' and '.join(saved)} first." if saved else ""
    return section(
        "making",
        "How it was made",
        pairs(facts),
        tag("h3", f"Recipe {header.recipe_name}"),
        tag("p", "Every setting as it was run, defaults and overrides included.", class_="note"),
        tag(
            "pre", tag("code", recipe_yaml(header.recipe)), tabindex="0", role="region", aria_label="The recipe as YAML"
        ),
        *(_init_file(header) if init.corrections else ()),
        tag("h3", "To repeat the run"),
        tag("pre", tag("code", content.command), class_="command"),
        tag("p", f"The same version gives a trajectory.csv of the same bytes.{where}{file}", class_="note"),
    )


def _corrected(story: Story) -> str:
    frames = [str(one.frame) for one in story.corrections]
    return f"by hand in frame{'s' * (len(frames) > 1)} {names(frames, 20)}"


def _init_file(header: Header) -> Iterator[Html]:
    """The start and what was put right, as a file that the run can be made from again."""
    yield tag("h3", "The start, and what was put right by hand")
    text = tag("code", init_yaml(header))
    yield tag("pre", text, tabindex="0", role="region", aria_label="The init file as YAML")


def _places(targets: Mapping[str, TargetRecord]) -> Iterator[tuple[str, str]]:
    for name, target in targets.items():
        of = f" of {name}" if len(targets) > 1 else ""
        if target.box:
            yield f"Box{of}", f"[{', '.join(f'{v:g}' for v in target.box)}]: left, top, width, height"
        if target.points:
            yield f"Points{of}", "; ".join(f"{part} ({x:g}, {y:g})" for part, (x, y) in target.points.items())


def _began(origin: str) -> str:
    return {"haar": "Haar cascades, which found the face", "--box": "a box that was given (--box)"}.get(origin, origin)


def _foot(content: Content) -> Html:
    return tag(
        "footer",
        "Everything on this page is inside this one file. Frames are counted from 0 of the clip; times are on the "
        "clip's clock; left and right are as seen in the picture.",
    )


@dataclass(frozen=True)
class Plot:
    """The page of plots, drawn wide and, for phones, narrow."""

    wide: Image
    narrow: Image


class Truth(NamedTuple):
    """What was measured against the file `path`: `about` in words, tables, and lines on what could not be."""

    path: str
    about: str
    tables: Sequence[Measures]
    notes: Sequence[str]


@dataclass(frozen=True)
class Content:
    """All that the page shows."""

    title: str
    table: Trajectory
    header: Header
    clock: Clock
    story: Story
    keys: Sequence[KeyFrame]
    pictures: Pictures
    plot: Plot
    command: str
    truth: Truth | None = None


MOST_PARTS = 100  # rows of a table by part


_BINS = 1000  # of the bar that shows when a part was lost


def summary(content: Content) -> Html:
    story, clock, header = content.story, content.clock, content.header
    how, good = ended(header)
    frames = len(clock.frames)
    gone, absent = story.lost_at_end, story.absent_at_end
    good_frames = "No part lost" if any(part.frames_absent for part in story.parts) else "All parts tracked"
    ends = (
        (f"{len(gone)} lost", names(gone, 3))
        if gone
        else (f"{len(absent)} absent", names(absent, 3))
        if absent
        else ("tracked", "no part is lost")
    )
    longest = max((part.longest for part in story.parts), default=0.0)
    known = [part.mean for part in story.parts if np.isfinite(part.mean)]
    mean = float(np.mean(known)) if known else np.nan
    figures = [
        ("Frames", f"{frames:,}", f"{clock.frames[0]} to {clock.frames[-1]}"),
        ("Duration", lasting(clock.duration), f"from {at_clock(clock.times[0])}"),
        (good_frames, percent(1 - story.frames_lost / frames), f"{count(frames - story.frames_lost, 'frame')}"),
        ("Lost spans", f"{len(story.spans):,}", f"longest {lasting(longest)}" if story.spans else "none"),
        *([("Mean confidence", number(mean), "over all parts and frames")] if np.isfinite(mean) else []),
        *([("Put right by hand", count(len(put), "frame"), _put_right(put))] if (put := story.corrections) else []),
        ("At the end", *ends),
    ]
    cells = [tag("div", tag("dt", name), tag("dd", value, tag("small", note))) for name, value, note in figures]
    warnings = [*header.warnings, *content.pictures.notes]
    box = tag(
        "div",
        tag("strong", "Warnings" if len(warnings) > 1 else "Warning"),
        tag("ul", *(tag("li", line) for line in warnings)),
        class_="warnings",
    )
    return section(
        "summary",
        "Summary",
        tag("p", sentences(content.table, header, clock, story), class_="lead"),
        *(tag("p", line) for line in named(content.table, clock)),
        tag("p", how, class_=f"ended {'good' if good else 'bad'}"),
        tag("dl", *cells, class_="figures"),
        *([box] if warnings else []),
        *_when(content),
        _parts(content),
    )


def _put_right(corrections: Sequence[Corrected]) -> str:
    absent = {name for one in corrections for name in one.absent}
    return f"{len(absent)} said to be absent" if absent else "none said to be absent"


def _when(content: Content) -> Iterator[Html]:
    """When each part was lost, as bars over the run, and below them the key frames."""
    first, last = int(content.clock.frames[0]), int(content.clock.frames[-1])
    scale = _BINS / (last - first + 1)
    rows = []
    for part in content.story.parts[:MOST_PARTS]:
        said = f"{part.name}: " + (f"lost in {count(len(part.spans), 'span')}" if part.spans else "never lost")
        said += f", absent in {count(part.frames_absent, 'frame')}" if part.frames_absent else ""
        bars = [tag("rect", class_="track", x=0, y=0, width=_BINS, height=10)]
        lost = [(span.first, span.last) for span in part.spans]
        for kind, spans in (("lost", lost), ("absent", part.absences)):
            for x, w in _bars(spans, first, scale):
                bars.append(tag("rect", class_=kind, x=f"{x:.1f}", y=0, width=f"{w:.1f}", height=10))
        rows.append((part.name, _svg("bar", said, join(bars))))
    put = [one.frame for one in content.story.corrections]
    for name, frames in (("by hand", put), ("key frames", [key.frame for key in content.keys])):
        if frames:
            at = [(frame - first + 0.5) * scale for frame in frames]
            ticks = [tag("line", class_="tick", x1=f"{x:.1f}", x2=f"{x:.1f}", y1=0, y2=10) for x in at]
            what = f"put right in {count(len(at), 'frame')}" if frames is put else count(len(at), "key frame")
            rows.append((name, _svg("bar ticks", what, join(ticks))))
    body = join(tag("tr", tag("th", name, scope="row", title=name), tag("td", svg)) for name, svg in rows)
    absent = any(part.absences for part in content.story.parts)
    yield tag("h3", "When each part was lost or absent" if absent else "When each part was lost")
    yield tag("table", tag("tbody", body), class_="when")
    ends = (content.clock.times[0], content.clock.after(last))
    yield tag("p", *(tag("span", at_clock(float(time))) for time in ends), class_="axis")


def _svg(kind: str, said: str, inside: Html) -> Html:
    return tag(
        "svg", inside, class_=kind, viewBox=f"0 0 {_BINS} 10", preserveAspectRatio="none", role="img", aria_label=said
    )


def _bars(spans: Sequence[tuple[int, int]], first: int, scale: float) -> list[tuple[float, float]]:
    """(left, width) of what to paint: thousands of spans are no more than the bar has room for."""
    least = 2.0 if len(spans) <= _BINS // 20 else 0.5  # a single frame of many must still be seen
    bars: list[tuple[float, float]] = []
    for begin, end in spans:
        left, right = (begin - first) * scale, (end + 1 - first) * scale
        if bars and left < sum(bars[-1]) + 0.2:
            left = bars.pop()[0]
        bars.append((left, max(right - left, least)))
    return bars


def _parts(content: Content) -> Html:
    head = (
        "part",
        "times lost",
        "frames lost",
        "share",
        "time lost",
        "longest",
        "confidence, mean",
        "lowest",
        "in frame",
        "at the end",
    )
    rows = []
    for part in content.story.parts[:MOST_PARTS]:
        end = tag("span", "lost", class_="bad-text") if part.last_status == "lost" else part.last_status or "–"
        rows.append(
            (
                part.name,
                f"{len(part.spans):,}",
                f"{part.frames_lost:,}",
                percent(part.frames_lost / part.rows),
                lasting(part.seconds_lost),
                lasting(part.longest) if part.spans else "–",
                number(part.mean),
                number(part.lowest),
                part.worst if part.lowest == part.lowest else "–",
                end,
            )
        )
    cut = _cut(len(content.story.parts), MOST_PARTS, "parts")
    return join([table("How often and how long each part was lost", head, rows), cut])


def _cut(there: int, shown: int, what: str) -> Html:
    return tag("p", f"{shown} of {there:,} {what} are shown.", class_="note") if there > shown else Html("")
