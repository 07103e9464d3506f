"""The results of a check as lines for people, as JSON, and as JUnit XML."""

import json
import math
import re
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any
from xml.etree import ElementTree

from facetrack_cli.evaluation.goldens.bands import Deviation
from facetrack_cli.evaluation.goldens.check import Checked

SUITE = "facetrack regress"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def line(one: Checked) -> list[str]:
    """The line of a golden, and below it, indented, the details of a failure."""
    said = f"FAILS: {one.message}" if one.status == "fails" else f"skipped: {one.message}"
    if one.status == "ok":
        said = f"ok ({one.message}; {one.seeds} seeds, {one.seconds:.1f} s)"
    return [f"{one.clip} {one.recipe}: {said}", *(f"    {detail}" for detail in one.details)]


def _counts(found: Sequence[Checked]) -> dict[str, int]:
    return {status: sum(one.status == status for one in found) for status in ("ok", "fails", "skipped")}


def summary(found: Sequence[Checked], seconds: float) -> str:
    ok, fails, skipped = _counts(found).values()
    goldens = "1 golden" if len(found) == 1 else f"{len(found)} goldens"
    more = f", {skipped} skipped" if skipped else ""
    return f"{goldens} in {seconds:.0f} s: {ok} ok, {fails} FAIL{'S' if fails == 1 else ''}{more}"


def as_json(found: Sequence[Checked]) -> str:
    """`closest`: the farthest statistic in units of its band; `p`: the probability of runs like these, unchanged."""
    results = [_result(one) for one in found]
    whole = {"schema": "facetrack-regress", "version": 1, **_counts(found), "results": results}
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


def _result(one: Checked) -> dict[str, Any]:
    verdict, leave = one.verdict, one.leave
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
        "leaves": leave
        and {
            "frame": leave.frame,
            "part": leave.series,
            "distance_px": round(leave.distance, 2),
            "band_px": round(leave.reach, 2),
        },
        "deviations": [_deviation(one) for one in verdict.deviations] if verdict else [],
    }


def _deviation(one: Deviation) -> dict[str, Any]:
    value, low, high, far = (round(v, 4) if math.isfinite(v) else None for v in (one.value, one.low, one.high, one.far))
    return {
        "family": one.family,
        "quantity": one.statistic.quantity,
        "part": one.statistic.series or None,
        "frames": [one.statistic.first, one.statistic.last],
        "value": value,
        "band": [low, high],
        "far": far,
        "text": str(one),
    }


def as_junit(found: Sequence[Checked], seconds: float) -> str:
    """One suite with a test case for each golden: the clip is its class, the recipe its name."""
    _, fails, skipped = _counts(found).values()
    counts = {"tests": str(len(found)), "failures": str(fails), "errors": "0", "time": f"{seconds:.3f}"}
    now = datetime.now(timezone.utc).replace(tzinfo=None).isoformat(timespec="seconds")
    root = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(root, "testsuite", {**root.attrib, "skipped": str(skipped), "timestamp": now})
    for one in found:
        names = {"classname": _clean(one.clip), "name": _clean(one.recipe), "time": f"{one.seconds:.3f}"}
        case = ElementTree.SubElement(suite, "testcase", names)
        message = {"message": _clean(one.message)}
        if one.status == "fails":
            failure = ElementTree.SubElement(case, "failure", {**message, "type": "RegressionFailure"})
            failure.text = _clean("\n".join([one.message, *one.details, f"golden: {one.golden}"]))
        elif one.status == "skipped":
            ElementTree.SubElement(case, "skipped", message)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
