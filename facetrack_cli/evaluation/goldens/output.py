"""The results of a check as lines for people, as JSON, and as JUnit XML."""

import json
import re
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any
from xml.etree import ElementTree

from facetrack_cli.evaluation.goldens.bands import Deviation
from facetrack_cli.evaluation.goldens.check import Checked
from facetrack_cli.evaluation.sheet import rounded

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
    """`farthest`: the farthest statistic, above 1 outside of its band."""
    whole = {"schema": "facetrack-regress", "version": 2, **_counts(found), "results": [_result(one) for one in found]}
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


def _result(one: Checked) -> dict[str, Any]:
    plain = {key: getattr(one, key) for key in ("clip", "recipe", "status", "message", "details", "seeds")}
    return {
        **plain,
        "golden": str(one.golden),
        "seconds": round(one.seconds, 3),
        "farthest": rounded(one.farthest, 4),
        "deviations": [_deviation(left) for left in one.deviations],
    }


def _deviation(one: Deviation) -> dict[str, Any]:
    runs, band = one.shown
    return {
        "quantity": one.band.quantity,
        "part": one.band.series or None,
        "frames": [one.band.first, one.band.last],
        "runs": [rounded(v, 4) for v in runs],
        "band": [rounded(v, 4) for v in band],
        "farthest": rounded(one.far, 4),
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
