"""The style of all figures, and how one becomes a file: equal numbers give equal bytes, whatever the user has set."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from facetrack_cli.core.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI: Final = 120.0
WIDTH: Final = 10.0  # inches

# the annotated video's colours (video/overlay/marks.py), in their order, darkened for white paper so that colour-blind
# readers still tell them apart; the dark one, which stands for white, comes last, since the ground truth is dark too
COLOURS: Final = ("#30A2DC", "#C49500", "#00795A", "#BE5CA6", "#2B3FC0", "#222222")
INK: Final = "#222222"
FAINT: Final = "#6B6B6B"
# vermilion is never a line's colour
STATUS: Final = {"tracked": "#D5E4EE", "lost": "#E0480A", "hidden": "#8A8A8A", "absent": "#4A4A4A"}
# where colours run out: solid, dashed, dotted, dash-dotted
DASHES: Final[tuple[Any, ...]] = ("-", (0, (5, 1.8)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
TRUTH: Final[Any] = {"color": INK, "linewidth": 0.9, "linestyle": (0, (1, 1.6)), "zorder": 3}
GUIDE: Final[Any] = {"color": FAINT, "linewidth": 0.8, "linestyle": (0, (4, 2.5)), "zorder": 1.5}
CORRECTED: Final[Any] = {
    "marker": "^", "color": INK, "linestyle": "none", "markersize": 5, "clip_on": False, "zorder": 5,
}  # fmt: skip

_STYLE: Final = Path(__file__).with_name("facetrack.mplstyle")


@contextmanager
def needed(what: str, package: str) -> Iterator[None]:
    """Around imports of the extra `plot`: UsageError in one line where a package is missing or broken."""
    try:
        yield
    except ModuleNotFoundError as e:
        missing = (e.name or package).partition(".")[0]
        raise UsageError(f"{what} need {missing}, which is not installed: pip install 'facetrack[plot]'") from None
    except (ImportError, ValueError, OSError) as e:
        said = " ".join(str(e).split())
        raise UsageError(f"{package} cannot be loaded: {said}; install it anew: pip install 'facetrack[plot]'") from e


@cache
def need_matplotlib() -> None:
    """UsageError where matplotlib is missing or broken.

    What it logs on its first import, on its font cache or the home folder, is suppressed: it changes no figure.
    """
    log = logging.getLogger("matplotlib")
    before = log.level
    log.setLevel(logging.ERROR)
    backend = os.environ.pop("MPLBACKEND", None)  # none is needed, and a wrong one stops the import
    try:
        with needed("figures", "matplotlib"):
            import matplotlib.font_manager  # builds the cache

        if backend is not None:
            with contextlib.suppress(ValueError):
                matplotlib.rcParams["backend"] = backend
    finally:
        log.setLevel(before)
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


@contextmanager
def style() -> Iterator[None]:
    """The settings of all figures, instead of the user's; without warnings of overflow and of missing glyphs."""
    need_matplotlib()
    import matplotlib
    import numpy as np

    with matplotlib.rc_context(), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        matplotlib.rc_file(_STYLE)
        yield


def new_figure(width: float, height: float) -> Figure:
    """A figure of `width` x `height` inches, made without pyplot, within `style()`."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def render(figure: Figure, form: str = "png", *, dpi: float = DPI) -> bytes:
    """The bytes of the figure as png, svg or pdf, without a date."""
    none = {"png": ["Software"], "svg": ["Date", "Creator"], "pdf": ["CreationDate", "Creator", "Producer"]}
    into = io.BytesIO()
    with style():
        figure.savefig(into, format=form, dpi=dpi, metadata=dict.fromkeys(none[form]))
    return into.getvalue()


def line_style(index: int) -> dict[str, Any]:
    """Colour and dash of line `index`: all colours solid, then all of them dashed, and so on."""
    turn, place = divmod(index, len(COLOURS))
    return {"color": COLOURS[place], "linestyle": DASHES[turn % len(DASHES)]}


def heading(axes: Axes, title: str, note: str = "", above: float = 0.0) -> None:
    """A title at the top left, `above` points higher, and after it a note in grey."""
    from matplotlib.offsetbox import AnchoredOffsetbox, HPacker, TextArea
    from matplotlib.transforms import ScaledTranslation

    words: list[Any] = [TextArea(title, textprops={"weight": "bold", "color": INK, "size": 9})]
    if note:
        words.append(TextArea(note, textprops={"color": FAINT, "size": 8}))
    figure = axes.get_figure(root=True)
    assert figure is not None
    box = AnchoredOffsetbox(
        loc="lower left",
        child=HPacker(children=words, align="baseline", pad=0, sep=6),
        pad=0,
        borderpad=0.25,
        frameon=False,
        bbox_to_anchor=(0, 1),
        bbox_transform=axes.transAxes + ScaledTranslation(0, above / 72, figure.dpi_scale_trans),
    )
    axes.add_artist(box)


def clean(text: str, most: int) -> str:
    """A name on one line of at most `most` characters; legends hide names that begin with an underscore."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    text = text if len(text) <= most else text[: most - 1] + "…"
    return f" {text}" if text.startswith("_") else text
