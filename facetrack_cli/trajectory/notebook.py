"""A trajectory as notebooks show it."""

from __future__ import annotations

from collections import Counter
from html import escape
from typing import Final

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory

WIDE, HIGH, BINS = 160, 24, 80  # of a line of confidence: pixels, and means that it shows
SHOWN: Final = 20  # rows of the table


def html(table: Trajectory) -> str:
    """A small table: of each target its parts, frames, the share of rows that are seen, its events, and confidence."""
    events = Counter((event.target, event.value) for event in table.events)
    lines = []
    for target in table.targets[:SHOWN]:
        parts = table.of_target(target)
        seen = float(np.mean(np.concatenate([np.isin(one.status, SEEN) for one in parts])))
        said = ", ".join(f"{n} {value}" for (of, value), n in sorted(events.items()) if of == target)
        cells = target or "-", len(parts), len(parts[0]), f"{seen:.0%}", said, _line(parts[0].confidence)
        lines.append("<tr>" + "".join(f"<td>{one if i == 5 else escape(str(one))}</td>" for i, one in enumerate(cells)))
    if (more := len(table.targets) - SHOWN) > 0:
        lines.append(f"<tr><td>and {more} more")
    heads = "".join(f"<th>{one}" for one in ("target", "parts", "frames", "seen", "events", "confidence"))
    return f"<table><tr>{heads}{''.join(lines)}</table>"


def _line(values: Array) -> str:
    """Values from 0 to 1 over time as a picture."""
    known = np.nan_to_num(values)
    if not len(known):
        return ""
    means = [float(one.mean()) for one in np.array_split(known, min(BINS, len(known)))]
    x = np.linspace(0, WIDE, len(means)) if len(means) > 1 else [WIDE / 2]
    points = " ".join(f"{a:.1f},{HIGH - 1 - v * (HIGH - 2):.1f}" for a, v in zip(x, means, strict=True))
    line = f'<polyline points="{points}" fill="none" stroke="currentColor"/>'
    return f'<svg width="{WIDE}" height="{HIGH}" role="img" aria-label="confidence over time">{line}</svg>'
