"""What is tracked again: in which frames, with whose random numbers, and what it sees of the other targets."""

import os
import shutil

import numpy as np
import pytest

from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor.history import corrections_of
from facetrack_cli.editor.retrack import Task, frames_of, recorded_footprint
from facetrack_cli.trajectory.header import CORRECTED
from tests.editor.test_fixing_odd import fixing, nose, put, run, signing
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"


def test_frames_that_several_tasks_want_are_read_once():
    def frames(*wanted):
        return frames_of([Task("a", None, first, stop) for first, stop in wanted])

    assert frames((5, 20), (6, 10)) == frames((6, 10), (5, 20)) == [(5, 20)]
    assert frames((5, 8), (8, 10)) == frames((5, 9), (7, 10)) == [(5, 10)]
    assert frames((9, 12), (1, 3), (1, 2)) == [(1, 3), (9, 12)]
    assert frames() == []


def test_a_run_with_another_seed_is_put_right_with_that_seed(tmp_path):
    words = ["--seed", "7", "--stop", "10"]
    run(CLIP, "-o", tmp_path / "out", *words)
    put(tmp_path / "out", nose(4, 158, 140))
    run(CLIP, "-o", tmp_path / "again", *words, "--init", tmp_path / "out" / CORRECTED)
    ours, theirs = ((tmp_path / name / "trajectory.csv").read_bytes() for name in ("out", "again"))
    assert ours == theirs


def test_a_name_that_is_no_text_goes_through(tmp_path):
    """Names of files are bytes; those that are no UTF-8 stand escaped in JSON."""
    init = tmp_path / os.fsdecode(b"\xff.yaml")
    try:
        shutil.copy(CLIP.with_suffix(".init.yaml"), init)
    except OSError:
        pytest.skip("this file system wants UTF-8")
    run(CLIP, "-o", tmp_path / "out", "--init", init, "--stop", "6", "--format", "csv,json,jsonl")
    put(tmp_path / "out", nose(4, 158, 140))
    for name in ("trajectory.json", "trajectory.jsonl"):
        assert b"/\\udcff.yaml" in (tmp_path / "out" / name).read_bytes()
    with fixing(tmp_path / "out") as fixer:
        assert [one.frame for one in fixer.corrections] == [4] and corrections_of(init, fixer.run) == ()


@pytest.fixture(scope="module")
def hands(tmp_path_factory):
    out = tmp_path_factory.mktemp("hands") / "out"
    signing(out, "--stop", "9")
    return out


def test_targets_that_are_tracked_together_see_each_other_as_they_are_now(hands, monkeypatch):
    with fixing(hands) as fixer:
        seen = {}

        class Spy(type(fixer._tracking)):
            def _footprints(self, live, now, rows, index):
                seen[index, live.task.target] = footprints = super()._footprints(live, now, rows, index)
                return footprints

        monkeypatch.setattr(fixer._tracking, "__class__", Spy)
        left, right = (95.0, 120.0, 40.0, 46.0), (180.0, 110.0, 44.0, 50.0)
        given = {"left_hand": left, "right_hand": right}
        fixer.put([Correction(4, name, TargetStart(box=box)) for name, box in given.items()])

        def place(frame, name):
            one = fixer.rows.at(frame).find(name, "box")
            return pytest.approx([one.x[0], one.y[0]], abs=6e-4)

        # the first of them is known in this frame, the second where it is expected from the one before
        for frame in (5, 8):
            head, first = seen[frame, "right_hand"]
            assert first.centre.tolist() == place(frame, "left_hand")
            assert head.centre.tolist() == place(frame, "head")
        assert seen[4, "right_hand"][1].centre.tolist() == [left[0] + 19.5, left[1] + 22.5]
        recorded = fixer.run.rows.at(3).find("right_hand", "box")
        assert seen[4, "left_hand"][1].centre.tolist() == [recorded.x[0], recorded.y[0]]  # which has not begun
        ahead = seen[5, "left_hand"][1]
        assert ahead.centre.tolist() == [right[0] + 21.5, right[1] + 24.5] and ahead.half.tolist() == [22, 25]


def test_what_is_recorded_of_points_and_of_what_is_gone_covers_nothing(hands, tmp_path):
    run(CLIP, "-o", tmp_path / "out", "--stop", "4")
    with fixing(tmp_path / "out") as fixer:
        assert recorded_footprint(fixer.rows, 2, "face") is None
    with fixing(hands) as fixer:
        assert np.isfinite(recorded_footprint(fixer.rows, 5, "head").centre).all()
        fixer.put([Correction(4, "head", absent=True)])
        assert recorded_footprint(fixer.rows, 5, "head") is None
