"""The head of the report: the run in words and figures, when each part was lost, and how often."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from facetrack_cli.report.content import Content
from facetrack_cli.report.events import Corrected
from facetrack_cli.report.html import Html, join, section, table, tag
from facetrack_cli.report.text import at_clock, count, ended, lasting, names, number, percent, sentences
from facetrack_cli.report.told import named

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
