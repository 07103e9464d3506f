"""Trackers that adapt, on real clips: the figures of docs/results.md are by benchmarks/adaptive.py, of many seeds."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.types import Array, Frame
from facetrack_cli.evaluation.boxes import measure_boxes
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.seeds import Plan, run_plans
from facetrack_cli.runs.start import Begin
from facetrack_cli.tracking.build.build import build_tracker
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.source import open_source

CLIPS = Path(os.environ.get("FACETRACK_CLIPS", "clips"))
pytestmark = pytest.mark.clips


def clip_of(name: str) -> Path:
    path = CLIPS / name
    if not path.exists():
        pytest.skip(f"no clips at {CLIPS}; set FACETRACK_CLIPS")
    return path


def truth_of(clip: Path) -> Trajectory:
    return read_truth(clip.parent / "groundtruth.csv")


def auc(clip: Path, config: str, stop: int) -> float:
    """Of two seeds, up to the frame `stop`."""
    recipe, truth = load_recipe(config), truth_of(clip)
    start = Begin(clip).find(recipe, truth)
    found = []
    (true,) = truth.parts
    [ended] = run_plans([Plan(config, clip, recipe, start, (0, 1), stop)])
    for run in ended.runs:
        (ours,) = run.trajectory.parts
        found.append(measure_boxes(ours.boxes, true.take(np.isin(true.frame, ours.frame)).boxes).success_auc)
    return float(np.mean(found))


def test_a_face_that_jumps_is_kept_by_the_search() -> None:
    """It moves 10 pixels a frame in the mean, of a face of 33, and blurs."""
    clip = clip_of("jumping/jumping.mpg")
    assert auc(clip, "adaptive_robust", 150) > 0.55
    assert auc(clip, "fixed_template", 150) < 0.4


def test_adapting_keeps_a_face_that_comes_out_of_the_dark() -> None:
    clip = clip_of("david/david.webm")
    assert auc(clip, "adaptive", 770) > auc(clip, "fixed_template", 770) + 0.05


@pytest.mark.parametrize("name", ["david/david.webm", "jumping/jumping.mpg"])
def test_the_predicted_shift_points_to_the_true_place(name: str) -> None:
    """Eq. 12 from the ground truth: nearer to that of the next than the last place; as printed, farther."""
    clip = clip_of(name)
    truth, recipe = truth_of(clip), load_recipe("adaptive")
    start = Begin(clip).find(recipe, truth)
    (target,) = build_tracker(recipe, start)
    motion, model = target.motion, target.likelihood  # type: ignore[attr-defined]
    (true,) = truth.parts
    box = dict(zip(true.frame.tolist(), true.boxes, strict=True))
    width, height = box[start.frame][2:]

    def state(frame: int) -> Array:
        left, top, w, h = box[frame]
        return np.array([[left + (w - 1) / 2, top + (h - 1) / 2, w / width, 0.0, 0.0, h / height]])

    rng, last, rows = np.random.default_rng(0), None, []
    with open_source(clip, start=start.frame, stop=start.frame + 80) as source:
        for frame in source:
            if isinstance(last, Frame):
                here, moved = state(last.index), (state(frame.index) - state(last.index))[0, :2]
                mixture = model.init(last, here)
                flow = motion.begin(rng, last, here)
                shift = motion.predict(
                    flow, frame, lambda y, m=mixture: model.error(m, y), lambda m=mixture: model.expected(m)
                ).shift[0, :2]
                rows.append([np.linalg.norm(moved - guess) for guess in (np.zeros(2), shift, -shift)])
            last = frame
    still, ahead, opposite = np.mean(rows, axis=0)
    assert ahead < 0.7 * still < still < opposite


def test_people_are_named_in_a_part_of_their_clips_that_was_not_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four of the ten talkers, among them two who are hard to tell apart, bbaf2n and sbia1a."""
    names = ("bbaf2n", "lbax4n", "pwij3p", "sbia1a")
    clips = {name: clip_of(f"talkers/{name}.mpg") for name in names}
    for name, clip in clips.items():
        (tmp_path / "people" / name).mkdir(parents=True)
        (tmp_path / "people" / name / clip.name).symlink_to(clip.resolve())
    monkeypatch.chdir(tmp_path)
    assert main(["gallery", "fit", "people", "--stop", "30", "--frames", "6", "--jitter", "2", "-q"]) == 0
    for name, clip in clips.items():
        out = tmp_path / name
        asked = ["run", str(clip), "--config", "adaptive_recognition", "--gallery", "gallery.npz", "--no-video"]
        assert main([*asked, "--start", "38", "--stop", "50", "-o", str(out), "-q"]) == 0
        frames = json.loads((out / "trajectory.json").read_text())["frames"]
        (target,) = frames[-1]["targets"]
        assert target["identity"] == name and target["identity_prob"] > 0.9
