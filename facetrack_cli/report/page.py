"""The report as HTML: the values that the template `report.html.j2` shows."""

from __future__ import annotations

import base64
import hashlib
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.report import text
from facetrack_cli.report.command_line import init_yaml, recipe_yaml
from facetrack_cli.report.events import Clock, KeyFrame, RunHistory
from facetrack_cli.report.figures.style import needed
from facetrack_cli.report.frames import KeyImages
from facetrack_cli.report.measures import Measures
from facetrack_cli.trajectory.header import CORRECTED, Header
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from jinja2 import Template

MOST_PARTS: Final = 100  # rows of a table by part
MOST_SPANS: Final = 100  # rows of the table of lost spans
_BINS: Final = 1000  # of the bar that shows when a part was lost
# what HTML forbids, and lone surrogates, which names of files may hold and UTF-8 may not
_UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")


class Image(NamedTuple):
    """Bytes of an image, its MIME type, and its (width, height) in CSS pixels."""

    data: bytes
    mime: str
    size: tuple[int, int]

    @property
    def uri(self) -> str:
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"


class Plot(NamedTuple):
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
    history: RunHistory
    keys: Sequence[KeyFrame]
    images: KeyImages
    plot: Plot
    command: str
    truth: Truth | None = None


def template() -> Template:
    """The page's template, which escapes whatever goes in. UsageError without Jinja2."""
    with needed("reports", "jinja2"):
        import jinja2
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters = (text.count, text.lasting, text.names, text.number, text.percent, text.rate)
    environment.filters |= {"clock": at_clock, **{one.__name__: one for one in filters}}
    return environment.get_template("report.html.j2")


def render(content: Content) -> bytes:
    """The document as UTF-8: nothing in it is fetched from anywhere, and no script may run."""
    page = template()
    from markupsafe import Markup

    style = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    filled = page.render(
        **vars(content) | _values(content),
        version=__version__,
        style=Markup(style),
        style_hash=f"sha256-{digest}",
        bins=_BINS,
        most_parts=MOST_PARTS,
        most_spans=MOST_SPANS,
    )
    return _UNFIT.sub("\ufffd", filled).encode()


def _values(content: Content) -> dict[str, Any]:
    """What the template shows beside the content itself."""
    header, history, clock = content.header, content.history, content.clock
    found = content.images.found
    origin = header.init.origin
    known = [part.mean for part in history.parts if np.isfinite(part.mean)]
    words, name = shlex.split(content.command), f"{header.recipe_name}.yaml"
    to_save = [f"the recipe above as {name}"] if name in words else []
    to_save += [f"the init file above as {CORRECTED}"] if CORRECTED in words else []
    short = {"haar": "the Haar cascades", "--box": "--box"}.get(origin, Path(origin).name or origin)
    long = {"haar": "Haar cascades, which found the face", "--box": "a box that was given (--box)"}
    return {
        "summary": text.sentences(content.table, header, clock, history),
        "identities": list(text.identities(content.table, clock)),
        "ended": text.ended(header),
        "absences": any(part.absences for part in history.parts),
        "mean": float(np.mean(known)) if known else None,
        "warnings": [*header.warnings, *content.images.notes],
        "timeline": list(_timeline(content)),
        # the longest of too many, in their order
        "spans": sorted(sorted(history.spans, key=lambda s: -s.seconds)[:MOST_SPANS], key=lambda s: (s.first, s.name)),
        "from_clip": content.images.origin == "clip",
        "some_left_out": not {frame for frame, _ in history.events} <= {key.frame for key in content.keys},
        "images": [
            {
                "frame": key.frame,
                "time": at_clock(clock.at(key.frame)),
                "image": Image(found[key.frame].jpeg, "image/jpeg", found[key.frame].size),
                "view": found[key.frame].view,
                "reasons": text.reasons(key, content.table, history, short),
            }
            for key in content.keys
            if key.frame in found
        ],
        "reported": bool(content.table.diagnostics) or bool((content.table.identity != "").any()),
        "started_by": long.get(origin, origin),
        "versions": ", ".join(f"{key} {v}" for key, v in {"facetrack": header.facetrack, **header.versions}.items()),
        "recipe": recipe_yaml(header.recipe),
        "init": init_yaml(header),
        "relative": not Path(header.source.path).is_absolute(),
        "to_save": " and ".join(to_save),
    }


def _timeline(content: Content) -> Iterator[dict[str, Any]]:
    """When each part was lost or absent, as bars over the run, and below them corrections and key frames as ticks."""
    first, last = int(content.clock.frames[0]), int(content.clock.frames[-1])
    scale = _BINS / (last - first + 1)
    for part in content.history.parts[:MOST_PARTS]:
        label = f"{part.name}: " + (f"lost in {text.count(len(part.spans), 'span')}" if part.spans else "never lost")
        label += f", absent in {text.count(part.frames_absent, 'frame')}" if part.frames_absent else ""
        bars: list[tuple[str, Any, Any]] = [("track", 0, _BINS)]
        lost = [(span.first, span.last) for span in part.spans]
        for kind, spans in (("lost", lost), ("absent", part.absences)):
            bars += [(kind, f"{x:.1f}", f"{w:.1f}") for x, w in _bars(spans, first, scale)]
        yield {"name": part.name, "label": label, "bars": bars, "ticks": []}
    corrected = [one.frame for one in content.history.corrections]
    keys = [key.frame for key in content.keys]
    for name, frames, label in (
        ("by hand", corrected, f"corrected in {text.count(len(corrected), 'frame')}"),
        ("key frames", keys, text.count(len(keys), "key frame")),
    ):
        if frames:
            ticks = [f"{(frame - first + 0.5) * scale:.1f}" for frame in frames]
            yield {"name": name, "label": label, "bars": [], "ticks": ticks}


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
