"""What a report says of a run: lost spans, stretches, and which frames it shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.types import Start
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.report.events import history_of, key_frames
from facetrack_cli.report.text import number, reasons, to_look_at
from facetrack_cli.runs.verdict import RunMonitor
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import mean_confidence
from tests.support.face_shape import moving_face
from tests.support.report_run import LOST, write_run


def test_the_history_of_each_part(tmp_path):
    table = read_trajectory(write_run(tmp_path, Path("clip.mp4")))
    clock = Clock(table, 25.0)
    history = history_of(table, clock)
    a, b = history.parts
    assert [(s.first, s.last, s.back, s.frames) for s in a.spans] == [(8, 11, 12, 4)]
    assert [(s.first, s.last, s.back, s.frames) for s in b.spans] == [(14, 24, None, 11)]
    assert sum(span.seconds for span in a.spans) == pytest.approx(0.16)
    assert sum(span.seconds for span in b.spans) == pytest.approx(0.44)  # until the last frame ends
    assert clock.duration == pytest.approx(0.8)
    assert a.mean == pytest.approx((15 * 0.75 + 4 * 0.05) / 19)  # without the first frame
    assert (history.frames_lost, history.episodes, history.ending("lost")) == (15, ((8, 11), (14, 24)), ["b"])
    assert history.worst == 6, "of the frames in which nothing is lost, as the run says"
    kinds = {key.frame: [event.kind for event in key.events] for key in key_frames(history, 5, 24)}
    assert kinds == {5: ["start"], 6: ["worst"], 8: ["lost"], 12: ["back"], 14: ["lost"], 24: ["end"]}


def test_an_open_mouth_a_smile_and_a_blink_are_shown():
    t = np.arange(150)
    moves = {
        "open": np.where((t >= 50) & (t < 70), 0.3 + 0.01 * (t == 60), 0.0),
        "shut": (t % 60 >= 28) & (t % 60 < 32),
    }
    table = moving_face(150, std=0.5, **moves)
    history = history_of(table, Clock(table, 25.0))
    (opening, wide), (_, smile), (_, blink) = history.peaks
    assert (opening, wide.kind, wide.words) == (60, "opening", "mouth opening 0.56 ± 0.01 eye distances")
    assert smile.kind == "smile" and smile.words.startswith("mouth width 0.80 ± 0.01")
    assert blink.kind == "blink" and blink.words.startswith("eye opening 0.00")
    keys = {key.frame: key for key in key_frames(history, 0, 149)}
    said = [row for key in keys.values() for row in reasons(key, table, history, "haar")]
    assert [heading for _, heading, _ in said].count("Mouth open widest") == 1
    assert {"Widest smile", "Blink"} <= {heading for _, heading, _ in said}
    quiet = moving_face(150)
    assert [event.kind for _, event in history_of(quiet, Clock(quiet, 25.0)).peaks] == ["opening", "smile"]


@pytest.mark.parametrize("seed", range(2))
def test_key_frames_are_few_and_far_apart(tmp_path, monkeypatch, seed):
    rng = np.random.default_rng(seed)
    lost = {name: set(np.flatnonzero(np.repeat(rng.random(100) < 0.4, 20)).tolist()) for name in "ab"}
    monkeypatch.setitem(LOST, "a", lost["a"])
    monkeypatch.setitem(LOST, "b", lost["b"])
    table = read_trajectory(write_run(tmp_path, Path("clip.mp4"), start=0, frames=2000))
    history = history_of(table, Clock(table, 25.0))
    keys = key_frames(history, 0, 1999)
    at = [key.frame for key in keys]
    assert len(at) == 12
    assert at == sorted(set(at))
    assert {0, 1999, history.worst} <= set(at)
    longest = max(history.episodes, key=lambda e: e[1] - e[0])
    assert longest[0] in at
    assert max(np.diff(at)) < 700
    for key in keys:
        for event in key.events:
            for span in event.spans:
                assert key.frame == (span.first if event.kind == "lost" else span.back)


def test_the_frames_to_look_at_are_those_that_the_run_names(tmp_path):
    table = read_trajectory(write_run(tmp_path, Path("clip.mp4")))
    clock = Clock(table, 25.0)
    history = history_of(table, clock)
    assert to_look_at(table, history, clock) == [
        (8, "0:00.32, frames 8 to 11: a lost"),
        (14, "0:00.56, frames 14 to 24: b lost"),
        (6, f"0:00.24, frame 6: the lowest confidence, {number(mean_confidence(table.at(6).confidence))}"),
    ]
    watch = RunMonitor.of(load_recipe("factorized"), Start(5, {}, "x"))
    for frame in table.frames.tolist():
        watch.take(table.at(frame))
    assert watch.least[1] == history.worst and watch.look == ((14, 24), (8, 11))


def test_means_of_a_file_tie_where_those_of_the_run_do():
    exact = np.array([0.70004, 0.7, 0.69996])
    assert mean_confidence(exact) == mean_confidence(np.round(exact, 4)) == mean_confidence(np.full(5, 0.7))
