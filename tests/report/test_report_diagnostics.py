"""The report of a tracker that adapts: who it is, in words and on the images, and the box as it was deformed."""

from __future__ import annotations

import html
import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from facetrack_cli.core.geometry import corners
from facetrack_cli.core.types import Array
from facetrack_cli.report import make as report
from facetrack_cli.report.frames import key_images
from facetrack_cli.report.make import Image
from facetrack_cli.report.text import identities
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.header import read_header
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import Trajectory
from tests.support.media import write_video
from tests.support.report_run import write_run


def with_more(folder: Path, *, target: str = "face", parts: int = 1, **more: Any) -> Path:
    """Adds to what a run wrote: identities, and in every frame what else is given."""
    path = folder / "trajectory.json"
    whole = json.loads(path.read_text())
    for record in whole["frames"]:
        for one in record["targets"]:
            del one["parts"][parts:]
            if one["target"] == target:
                sure = 0.4 if record["frame"] < 9 else 0.95
                one |= {"identity": "anna" if record["frame"] > 6 else "<b>", "identity_prob": sure, **more}
    path.write_text(json.dumps(whole))
    return folder


def table_of(folder: Path) -> Trajectory:
    return read_trajectory(folder / "trajectory.json")


def jpeg_of(folder: Path) -> bytes:
    table = table_of(folder)
    return key_images(table, read_header(table), [10], None, None, lambda *_: None).found[10].data


def test_who_it_is_since_when(tmp_path: Path) -> None:
    table = table_of(with_more(write_run(tmp_path / "run", tmp_path / "clip.mp4")))
    said = "It is named anna at the end, with a probability of 95.0\u00a0%; that passed 0.9 in frame 9, at 0:00.36."
    assert list(identities(table, Clock(table, 25.0))) == [said]
    two = table_of(with_more(write_run(tmp_path / "two", tmp_path / "clip.mp4", targets=("a", "b")), target="b"))
    (line,) = identities(two, Clock(two, 25.0))
    assert line.startswith("b is named anna at the end")


def test_who_stays_in_doubt_or_is_not_named(tmp_path: Path) -> None:
    doubt = table_of(with_more(write_run(tmp_path / "doubt", tmp_path / "clip.mp4"), identity_prob=0.6))
    (line,) = identities(doubt, Clock(doubt, 25.0))
    assert line.endswith("60.0\u00a0%; that never passed 0.9.")
    bare = table_of(with_more(write_run(tmp_path / "bare", tmp_path / "clip.mp4"), identity_prob=None))
    assert list(identities(bare, Clock(bare, 25.0))) == ["It is named anna at the end."]
    none = table_of(write_run(tmp_path / "none", tmp_path / "clip.mp4"))
    assert list(identities(none, Clock(none, 25.0))) == []


def test_the_page_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dot = Image(b"", (1, 1), "image/png")
    monkeypatch.setattr(report, "_plot", lambda *_: dot)
    run = write_run(tmp_path / "run", write_video(tmp_path / "clip.mp4", frames=25))
    assert b"is named" not in report.make_report(run).html
    page = report.make_report(with_more(run)).html.decode()
    assert "It is named anna at the end" in html.unescape(page)
    assert "what the tracker reported of identity" in page


def test_pictures_have_the_name_and_the_parallelogram(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", tmp_path / "clip.mp4")
    write_video(tmp_path / "clip.mp4", frames=12)

    def drawn(folder: Path) -> np.ndarray[Any, Any]:
        return cv2.imdecode(np.frombuffer(jpeg_of(folder), np.uint8), cv2.IMREAD_COLOR).astype(float)

    plain = drawn(with_more(run, identity=None, identity_prob=None))
    name = drawn(with_more(run))
    upright = drawn(with_more(run, affine=[1, 0, 0, 1, 12, 44]))
    lean = drawn(with_more(run, affine=[1, 0.8, 0, 1, 12, 44]))
    assert np.abs(plain - name).max() > 100
    assert np.abs(lean - name).mean() > 2 * np.abs(upright - name).mean(), "half a pixel aside, a box is a box"


def test_corners_follow_the_affine_map() -> None:
    def outline(*affine: float) -> Array:
        (found,) = corners(np.array([affine]), np.array([(10.0, 20.0)]), np.array([(4.0, 6.0)]))
        return found

    assert outline(2.0, 0, 0, 3, 0, 0).tolist() == [[8, 17], [12, 17], [12, 23], [8, 23]]
    turned = outline(0.0, -1, 1, 0, 0, 0)  # a quarter turn: x goes down, y to the left
    assert turned.tolist() == [[13, 18], [13, 22], [7, 22], [7, 18]]
    lean = outline(1.0, 1, 0, 1, 0, 0)
    assert math.dist(lean[0], lean[1]) == pytest.approx(4) and math.dist(lean[1], lean[2]) == pytest.approx(6)
    assert np.isnan(outline(0.0, 1, 0, 1, 0, 0)).all() and np.isnan(outline(*[math.nan] * 6)).all()
    several = corners(np.array([(1.0, 0, 0, 1, 0, 0), (0.0,) * 6]), np.zeros((2, 2)), np.full((2, 2), 2.0))
    assert several[0].tolist() == [[-1, -1], [1, -1], [1, 1], [-1, 1]] and np.isnan(several[1]).all()
