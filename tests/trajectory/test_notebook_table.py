"""A trajectory as a notebook shows it."""

import re
from xml.etree import ElementTree

import numpy as np

from facetrack_cli.trajectory.trajectory import joined, one_part


def face(name, n, seen):
    x, confidence = np.full(n, 5.0), np.linspace(0, 1, n)
    status = np.where(np.arange(n) < seen, "tracked", "lost")
    return one_part(name, "nose", np.arange(n), x=x, y=x, confidence=confidence, status=status)


def test_a_row_for_each_target_with_what_is_seen_and_its_confidence():
    page = joined([face("Ann", 40, 30), face("<b>&", 20, 20)])._repr_html_()
    assert re.findall(r"<td>([^<]*)</td><td>(\d+)</td><td>(\d+)</td><td>(\d+%)</td>", page) == [
        ("Ann", "1", "40", "75%"), ("&lt;b&gt;&amp;", "1", "20", "100%"),
    ]  # fmt: skip
    for line in re.findall(r"<svg.*?</svg>", page):
        points = ElementTree.fromstring(line)[0].attrib["points"].split()
        assert len(points) in (40, 20) and points[0].endswith(",23.0") and points[-1].endswith(",1.0")


def test_of_many_targets_the_first_are_shown():
    page = joined([face(f"p{i}", 2, 2) for i in range(30)])._repr_html_()
    assert page.count("<svg") == 20 and "and 10 more" in page


def test_a_part_that_has_no_confidence_and_a_single_frame():
    one = one_part("face", "box", [3], x=[1.0], y=[2.0])
    assert "<td>1</td><td>100%" in one._repr_html_()
