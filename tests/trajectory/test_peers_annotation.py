"""Exports as datumaro, which reads CVAT's XML, and Label Studio's own SDK read them."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.trajectory.formats.annotation import write_cvat, write_labelstudio
from facetrack_cli.trajectory.formats.boxes import write_mot
from facetrack_cli.trajectory.trajectory import one_part
from tests.trajectory.test_annotation_tools import SIZE, table

PEERS = os.environ.get("FACETRACK_ANNOTATION_PEERS")
pytestmark = pytest.mark.skipif(
    not PEERS, reason="FACETRACK_ANNOTATION_PEERS names no Python with the packages of tests/peers/annotation.txt"
)


def truth():
    place = {"x": 60.5 + np.arange(6), "y": np.full(6, 40.0), "w": np.full(6, 20.0), "h": np.full(6, 30.0)}
    return one_part("head", "box", range(6), **place, status=["visible", "visible", "hidden", *["visible"] * 3])


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder = tmp_path_factory.mktemp("annotations")
    (folder / "cvat").mkdir()
    (folder / "cvat/annotations.xml").write_text(write_cvat(table(), SIZE, "c.mp4"), encoding="utf-8")
    (folder / "track.labelstudio.json").write_text(write_labelstudio(table(), SIZE, 25.0, "c.mp4"), encoding="utf-8")
    (folder / "mot/gt").mkdir(parents=True)
    (folder / "mot/gt/gt.txt").write_text(write_mot([truth()]))
    script = Path(__file__).parents[1] / "peers/read_annotations.py"
    run = subprocess.run([PEERS, script, folder], capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def test_datumaro_reads_every_track_and_frame(read):
    found, made = read["cvat"], table()
    assert found["labels"] == ["face/nose", "face/lip", "hand"]
    assert sorted(map(int, found["frames"])) == list(range(2, 8))
    hand = made.find("hand", "box")
    for frame, shapes in found["frames"].items():
        by_label = {one["label"]: one for one in shapes}
        nose, row = by_label["face/nose"], made.find("face", "nose").row(int(frame))
        status = made.find("face", "nose").status[row]
        assert (nose["kind"], nose["keyframe"]) == ("points", True)
        assert (nose["outside"], nose["occluded"]) == (status == "absent", status == "lost")
        if status != "absent":
            one = made.find("face", "nose")
            assert nose["points"] == pytest.approx([one.x[row] + 0.5, one.y[row] + 0.5], abs=0.006)
        if (at := hand.row(int(frame))) is not None:
            left, top, w, h = hand.boxes[at]
            assert by_label["hand"]["kind"] == "bbox"
            assert by_label["hand"]["points"] == pytest.approx([left, top, left + w, top + h], abs=0.006)


def test_datumaro_reads_what_is_visible(read):
    boxes = [read["mot"][str(frame + 1)][0] for frame in range(6)]
    assert [one["occluded"] for one in boxes] == [False, False, True, False, False, False]
    assert [one["ignored"] for one in boxes] == [False] * 6 and {one["track_id"] for one in boxes} == {1}
    # datumaro leaves the pixels as they are in the file, where they count from 1
    assert [one["box"] for one in boxes] == (truth().boxes + np.array([1, 1, 0, 0])).tolist()


def test_label_studio_s_sdk_has_nothing_to_interpolate(read):
    (task,) = json.loads(write_labelstudio(table(), SIZE, 25.0, "c.mp4"))
    assert read["label_studio"] == task["annotations"][0]["result"]
