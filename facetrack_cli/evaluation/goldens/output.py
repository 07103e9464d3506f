"""The results of a check as lines for people, as JSON, and as JUnit XML."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Literal
from xml.etree import ElementTree

from facetrack_cli.evaluation.goldens.bands import Deviation
from facetrack_cli.evaluation.goldens.check import Checked

SUITE = "facetrack regress"


def line(one: Checked) -> list[str]:
    """The line of a golden, and below it, indented, what more there is to say of a failure."""
    what = {"ok": "ok", "fails": "FAILS", "skipped": "skipped"}[one.status]
    more = f"({one.message}; {one.seeds} seeds, {one.seconds:.1f} s)" if one.status == "ok" else ""
    first = f"{one.clip} {one.recipe}: {what} {more}" if more else f"{one.clip} {one.recipe}: {what}: {one.message}"
    return [first, *(f"    {detail}" for detail in one.details)]


def summary(found: Sequence[Checked], seconds: float) -> str:
    counts = {status: sum(one.status == status for one in found) for status in ("ok", "fails", "skipped")}
    goldens = "1 golden" if len(found) == 1 else f"{len(found)} goldens"
    skipped = f", {counts['skipped']} skipped" if counts["skipped"] else ""
    fails = f"{counts['fails']} FAIL{'S' if counts['fails'] == 1 else ''}"
    return f"{goldens} in {seconds:.0f} s: {counts['ok']} ok, {fails}{skipped}"


def as_junit(found: Sequence[Checked], seconds: float) -> str:
    """A test case a golden: the clip is its class, the recipe its name."""
    cases = [
        Case(
            group=one.clip,
            name=one.recipe,
            seconds=one.seconds,
            status=one.status,
            message=one.message,
            text="\n".join([one.message, *one.details, f"golden: {one.golden}"]),
        )
        for one in found
    ]
    now = datetime.now(timezone.utc).replace(tzinfo=None).isoformat(timespec="seconds")
    return junit(SUITE, cases, seconds, now)


def as_json(found: Sequence[Checked]) -> str:
    """`closest`: the farthest statistic in units of its band; `p`: the probability of runs like these, unchanged."""
    whole = {
        "schema": "facetrack-regress",
        "version": 1,
        **{status: sum(one.status == status for one in found) for status in ("ok", "fails", "skipped")},
        "results": [_result(one) for one in found],
    }
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


def _result(one: Checked) -> dict[str, Any]:
    verdict = one.verdict
    return {
        "clip": one.clip,
        "recipe": one.recipe,
        "golden": str(one.golden),
        "status": one.status,
        "message": one.message,
        "details": list(one.details),
        "seeds": one.seeds,
        "seconds": round(one.seconds, 3),
        "closest": round(verdict.closest, 4) if verdict else None,
        "p": round(verdict.p, 6) if verdict else None,
        "leaves": None
        if one.leave is None
        else {
            "frame": one.leave.frame,
            "part": one.leave.series,
            "distance_px": round(one.leave.distance, 2),
            "band_px": round(one.leave.reach, 2),
        },
        "deviations": [_deviation(d) for d in verdict.deviations] if verdict else [],
    }


def _deviation(one: Deviation) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return round(value, 4) if math.isfinite(value) else None

    return {
        "family": "joint" if one.together else "overall" if one.relative else "local",
        "quantity": one.statistic.quantity,
        "part": one.statistic.series or None,
        "frames": [one.statistic.first, one.statistic.last],
        "value": number(one.value),
        "band": [number(one.low), number(one.high)],
        "far": number(one.far),
        "text": str(one),
    }


_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Case:
    """One test: `group` is what services sort by. `text` is the whole of a failure, `message` its line."""

    group: str
    name: str
    seconds: float
    status: Literal["ok", "fails", "skipped"]
    message: str = ""
    text: str = ""


def junit(suite: str, cases: Sequence[Case], seconds: float, timestamp: str) -> str:
    """The report of one suite. `timestamp` is ISO 8601 without a zone, as in 2024-05-01T12:00:00."""
    counts = {
        "tests": str(len(cases)),
        "failures": str(sum(case.status == "fails" for case in cases)),
        "errors": "0",
        "skipped": str(sum(case.status == "skipped" for case in cases)),
        "time": f"{seconds:.3f}",
    }
    whole = {key: counts[key] for key in ("tests", "failures", "errors", "time")}
    root = ElementTree.Element("testsuites", {"name": _clean(suite), **whole})
    element = ElementTree.SubElement(root, "testsuite", {"name": _clean(suite), **counts, "timestamp": timestamp})
    for case in cases:
        attributes = {"classname": _clean(case.group), "name": _clean(case.name), "time": f"{case.seconds:.3f}"}
        test = ElementTree.SubElement(element, "testcase", attributes)
        if case.status == "fails":
            failure = ElementTree.SubElement(
                test, "failure", {"message": _clean(case.message), "type": "RegressionFailure"}
            )
            failure.text = _clean(case.text or case.message)
        elif case.status == "skipped":
            ElementTree.SubElement(test, "skipped", {"message": _clean(case.message)})
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
