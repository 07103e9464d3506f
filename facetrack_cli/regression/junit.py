"""JUnit XML, the report that CI services read: a test case a clip and recipe.

The schema is that of Ant and Jenkins: `testsuites` of `testsuite` of `testcase`, each with at most one of `failure` and
`skipped`. What XML cannot hold (control characters) is replaced.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

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
