"""HTML for the report: escaped text, tables, pictures, and the page around them. Nothing here knows of tracking."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from typing import NamedTuple

from facetrack_cli import __version__

# what HTML forbids, and lone surrogates, which names of files may hold and UTF-8 may not
_UNFIT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")


class Html(str):
    """Text that is HTML already; a plain `str` is escaped wherever it goes in."""

    __slots__ = ()


class Image(NamedTuple):
    """Bytes of a picture, its MIME type, and its (width, height) in CSS pixels."""

    data: bytes
    mime: str
    size: tuple[int, int]

    @property
    def uri(self) -> str:
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"


def esc(text: object) -> Html:
    """Text as HTML, fit for content and for attributes in double quotes; `Html` is passed on as it is."""
    return text if isinstance(text, Html) else Html(html.escape(_UNFIT.sub("\ufffd", str(text))))


def join(pieces: Iterable[object], between: str = "") -> Html:
    """The pieces, escaped, with HTML between them."""
    return Html(between.join(esc(piece) for piece in pieces))


def tag(name: str, *inside: object, **attributes: object) -> Html:
    """`<name ...>inside</name>`. An attribute that is None is left out; `class_` is class, `data_x` is data-x."""
    return Html(f"<{name}{_attributes(attributes)}>{join(inside)}</{name}>")


def void(name: str, **attributes: object) -> Html:
    """An element without content or end tag, as img."""
    return Html(f"<{name}{_attributes(attributes)}>")


def _attributes(given: dict[str, object]) -> str:
    return "".join(
        f' {key.rstrip("_").replace("_", "-")}="{esc(value)}"' for key, value in given.items() if value is not None
    )


def section(name: str, title: str, *inside: object) -> Html:
    """A section with the heading `title`, which links may name by `name`."""
    return Html(
        f'<section aria-labelledby="{name}">\n<h2 id="{name}">{esc(title)}</h2>\n{join(inside, chr(10))}\n</section>\n'
    )


def table(
    caption: object, head: Sequence[object], rows: Iterable[Sequence[object]], *, text: Sequence[int] = (0,)
) -> Html:
    """A table that may be wider than the page: `rows` begin with their header; columns `text` are set left."""
    place = ["text" if column in text else None for column in range(len(head))]
    top = [tag("th", cell, scope="col", class_=at) for cell, at in zip(head, place, strict=True)]
    body = [_row(list(row), place) for row in rows]
    inside = tag("caption", caption), tag("thead", tag("tr", *top)), tag("tbody", *body)
    # a box that scrolls must be reachable by keyboard, and have a name
    label = Html(re.sub("<[^>]*>", "", esc(caption)))
    return tag("div", tag("table", *inside), class_="scroll", tabindex="0", role="region", aria_label=label)


def _row(cells: Sequence[object], place: Sequence[str | None]) -> Html:
    first = tag("th", cells[0], scope="row", class_=place[0])
    rest = [tag("td", cell, class_=at) for cell, at in zip(cells[1:], place[1:], strict=True)]
    return Html(f"{tag('tr', first, *rest)}\n")


def pairs(rows: Iterable[tuple[object, object]]) -> Html:
    """A table of names and what they stand for."""
    body = join(tag("tr", tag("th", name, scope="row"), tag("td", value)) for name, value in rows)
    return tag("table", tag("tbody", body), class_="pairs")


def page(title: str, body: Html) -> bytes:
    """The whole document: nothing in it is fetched from anywhere, and no script may run."""
    here = Path(__file__).parent
    style = (here / "report.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    shell = Template((here / "report.html").read_text(encoding="utf-8"))
    text = shell.substitute(
        title=esc(title), version=esc(__version__), style=style, style_hash=f"sha256-{digest}", body=body
    )
    return text.encode()
