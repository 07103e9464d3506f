"""What a report says of a run: lost spans, stretches, which frames it shows; the recipe that ran, and its command."""

import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.recipe.load import _shipped, calibrated, load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.report.make import command, doubts, history_of, key_frames, reasons, recipe_yaml
from facetrack_cli.start.init_file import as_yaml
from facetrack_cli.trajectory.reader import read_header, read_trajectory
from facetrack_cli.trajectory.trajectory import joined, mean_confidence
from facetrack_cli.trajectory.views import Clock
from tests.support.report_run import LOST, write_run
from tests.support.samples import FOLDER

SAMPLE = FOLDER / "occlusion.mp4"


def test_the_history_of_each_part(tmp_path):
    table = read_trajectory(write_run(tmp_path, Path("clip.mp4")))
    clock = Clock(table, 25.0)
    history = history_of(table, clock)
    a, b = history.parts
    assert [(s.first, s.last, s.back, s.frames) for s in a.lost] == [(8, 11, 12, 4)]
    assert [(s.first, s.last, s.back, s.frames) for s in b.lost] == [(14, 24, None, 11)]
    assert sum(span.seconds for span in a.lost) == pytest.approx(0.16)
    assert sum(span.seconds for span in b.lost) == pytest.approx(0.44)  # until the last frame ends
    assert clock.duration == pytest.approx(0.8)
    assert a.mean == pytest.approx((15 * 0.75 + 4 * 0.05) / 19)  # without the first frame
    assert (history.frames_lost, history.episodes, history.ending("lost")) == (15, ((8, 11), (14, 24)), ["b"])
    assert history.longest == [*history.episodes]
    assert history.worst == 6, "of the frames in which nothing is lost, as the run says"
    events = reasons(table, history, "haar", 5, 24)
    assert key_frames(history, events, 5, 24) == sorted(events)
    kinds = {frame: [kind for kind, *_ in why] for frame, why in events.items()}
    assert kinds == {5: ["start"], 6: ["worst"], 8: ["lost"], 12: ["back"], 14: ["lost"], 24: ["end"]}
    by_hand = joined([replace(part, by_hand=part.frame == 12) for part in table.parts], header=table.header)
    assert 12 not in reasons(by_hand, history_of(by_hand, clock), "haar", 5, 24), "it does not come back by itself"


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_key_frames_are_few_and_far_apart(tmp_path, monkeypatch, seed):
    rng = np.random.default_rng(seed)
    lost = {name: set(np.flatnonzero(np.repeat(rng.random(100) < 0.4, 20)).tolist()) for name in "ab"}
    monkeypatch.setitem(LOST, "a", lost["a"])
    monkeypatch.setitem(LOST, "b", lost["b"])
    table = read_trajectory(write_run(tmp_path, Path("clip.mp4"), start=0, frames=2000))
    history = history_of(table, Clock(table, 25.0))
    events = reasons(table, history, "haar", 0, 1999)
    at = key_frames(history, events, 0, 1999)
    assert len(at) == 12
    assert at == sorted(set(at))
    assert {0, 1999, history.worst} <= set(at)
    longest = max(history.episodes, key=lambda e: e[1] - e[0])
    assert longest[0] in at
    assert max(np.diff(at)) < 700
    ends = {"lost": {span.first for span in history.lost}, "back": {span.back for span in history.lost} - {None}}
    for kind, frames in ends.items():
        assert frames == {frame for frame, why in events.items() if kind in {each[0] for each in why}}


def test_means_of_a_file_tie_where_those_of_the_run_do():
    exact = np.array([0.70004, 0.7, 0.69996])
    assert mean_confidence(exact) == mean_confidence(np.round(exact, 4)) == mean_confidence(np.full(5, 0.7))


def test_the_recipe_shown_is_the_recipe(tmp_path):
    for path in shipped_recipes():
        recipe = load_recipe(str(path))
        copy = tmp_path / f"{path.stem}.yaml"
        copy.write_text(recipe_yaml({"name": recipe.name, **to_dict(recipe)}), encoding="utf-8")
        assert to_dict(load_recipe(str(copy))) == to_dict(recipe), path


@pytest.mark.parametrize(
    "options",
    [
        ["--config", "sir", "--set", "filter.particles=15", "--box", "115,58,113,113", "--init-frame", "4"],
        ["--config", "mine.yaml", "--init", "haar", "--start", "3"],
        ["--faces", "all", "--start", "3"],
        ["--config", "factorized", "--smooth"],
        ["--config", "factorized", "--lag", "3"],
    ],
)
def test_the_command_repeats_the_run(options, tmp_path, monkeypatch, no_plot):
    monkeypatch.chdir(tmp_path)
    own = to_dict(load_recipe("independent")) | {"description": "mine"}
    Path("mine.yaml").write_text(recipe_yaml(own))
    clip = str(SAMPLE.with_name("film.mp4") if "--faces" in options else SAMPLE)
    assert main(["run", clip, *options, "--seed", "7", "--stop", "12", "-o", "run", "--no-video", "-q"]) == 0
    table = read_trajectory(Path("run"))
    header = read_header(table)
    words = shlex.split(command(header, int(table.frames[-1])))
    assert words[:3] == ["facetrack", "run", clip]
    name = header.recipe_name  # as the page has them
    Path(f"{name}.yaml").write_text(recipe_yaml(table.header["recipe"]))
    Path(f"{name}.init.yaml").write_text(as_yaml(header.init.start, header.clip_name))
    assert main([*words[1:], "--no-video", "-q"]) == 0
    assert Path("again/trajectory.csv").read_bytes() == Path("run/trajectory.csv").read_bytes()
    if header.init.targets:
        return
    assert main(["people", "run", "--rename", "person_1=Ann", "--no-video", "-q"]) == 0
    assert main(["report", "run"]) == 0
    page = Path("run/report.html").read_text(encoding="utf-8")
    assert "of the same bytes, as it was before it was corrected by hand." in page and "init.yaml" not in page


def test_folders_are_repeated_at_their_rate(tmp_path):
    (clip := tmp_path / "pictures").mkdir()
    header = {
        "source": {"path": str(clip), "size": [64, 48], "fps": 29.97003},
        "recipe": {"name": "my own", "description": "x"},
        "seed": 1,
        "init": {"from": "x.init.yaml", "frame": 4, "targets": {}},
    }
    table = joined([], path=tmp_path / "trajectory.json", header=header)
    words = shlex.split(command(read_header(table), 30))
    assert words[words.index("--fps") + 1] == "30000/1001"
    assert words[words.index("--config") + 1] == "my own.yaml"


def test_a_confidence_is_called_a_probability_only_where_it_is_one():
    known, unknown = {"confidence": {"calibration": "a.json"}}, {"confidence": {"calibration": None}}
    assert calibrated(known) and not calibrated(unknown) and not calibrated({})
    assert calibrated({"targets": {"a": known, "b": None}})
    assert not calibrated({"targets": {"a": known, "b": unknown}})
    assert doubts(SimpleNamespace(recipe=known), 0.49) and not doubts(SimpleNamespace(recipe=known), 0.5)
    assert not doubts(SimpleNamespace(recipe=unknown), 0.1) and not doubts(SimpleNamespace(recipe=known), None)


def test_a_shipped_calibration_holds_for_the_recipe_as_it_is_shipped_without_a_network(monkeypatch, tmp_path):
    assert calibrated(to_dict(load_recipe("skin_ncc_robust", ["seed=7"])))
    changed = to_dict(load_recipe("skin_ncc_robust", ["likelihood.skin=null"]))
    assert not calibrated(changed) and doubts(SimpleNamespace(recipe=changed), 0.4)  # low, it still says something
    assert not calibrated(to_dict(load_recipe("skin_ncc")))
    monkeypatch.setattr("facetrack_cli.recipe.load.model_path", lambda name: tmp_path)
    _shipped.cache_clear()
    assert calibrated(to_dict(load_recipe("face", installed=False)))
    assert not calibrated(to_dict(load_recipe("face")))
