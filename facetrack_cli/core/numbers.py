"""Values as text."""

from __future__ import annotations

import json
import math


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
