"""Numbers and names as results hold them: equal values give equal bytes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any


def fixed(decimals: int) -> Callable[[Any], str]:
    """A function that writes a number with so many decimals; "" for None and what is not finite, and never -0."""
    spec, zero = f".{decimals}f", f"{0:.{decimals}f}"

    def text(value: Any) -> str:
        if value is None:
            return ""
        written = format(value, spec)
        if written[0] in "-ni":  # a minus, nan or inf
            if not math.isfinite(value):
                return ""
            return zero if written[1:] == zero else written
        return written

    return text


def dumps(value: object) -> str:
    """A value as JSON on one line, in UTF-8."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss.cc, without the hours if there are none; "-:--" for what is not finite."""
    if not math.isfinite(seconds):
        return "-:--"
    hundredths = round(abs(seconds) * 100)
    minutes, rest = divmod(hundredths, 6000)
    hours, minutes = divmod(minutes, 60)
    sign = "-" if seconds < 0 and hundredths else ""
    tail = f"{rest // 100:02d}.{rest % 100:02d}"
    return f"{sign}{hours}:{minutes:02d}:{tail}" if hours else f"{sign}{minutes}:{tail}"
