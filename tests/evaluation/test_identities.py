"""Identities: the measures against TrackEval and motmetrics, the assignment against all of them tried, and names."""

import itertools
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.evaluation.identities import Seen, assigned, identified, measure_people, seen_in
from facetrack_cli.trajectory.formats.boxes import read_mot
from facetrack_cli.trajectory.trajectory import build

PEERS = Path(__file__).parents[1] / "peers"


def clips(seed):
    """Clips of people who come and go, followed by targets that change, are missing or are of nobody."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(4):
        count = int(rng.integers(1, 6))
        target, frames, new = list(range(count)), [], count
        for _ in range(50):
            people = np.flatnonzero(rng.random(count) < 0.8)
            if rng.random() < 0.1:
                target[rng.integers(count)], new = new, new + 1
            if count > 1 and rng.random() < 0.1:
                i, j = rng.choice(count, 2, replace=False)
                target[i], target[j] = target[j], target[i]
            seen = [target[i] for i in people if rng.random() < 0.85]
            targets = np.array([*seen, *([new] if rng.random() < 0.1 else [])], int)
            own = np.array([[target[i] == j for j in targets] for i in people]).reshape(len(people), len(targets))
            similar = np.where(own, rng.uniform(0.35, 1, own.shape), rng.uniform(0, 0.7, own.shape).clip(0.3) - 0.3)
            frames.append(Seen(people, targets, similar.round(6)))
        found.append(frames)
    return found


def check(of, measures):
    for clip, theirs in zip(of, measures, strict=True):
        ours = vars(measure_people(clip))
        for expected in theirs.values():
            assert {name: ours[name] for name in expected} == pytest.approx(expected, abs=1e-9)


def test_the_measures_are_those_recorded_from_the_toolkits():
    recorded = json.loads((PEERS / "people.json").read_text(encoding="utf-8"))["measures"]  # of clips(0)
    assert all(any(clip["trackeval"][name] for clip in recorded) for name in ("switches", "fragments"))
    check(clips(0), recorded)


def test_the_measures_are_those_of_the_toolkits_now():
    python = os.environ.get("FACETRACK_PEERS")
    if not python:
        pytest.skip("FACETRACK_PEERS names no Python that has the packages of tests/peers/requirements.txt")
    every = [clip for seed in range(10) for clip in clips(seed)]
    frames = [[{key: value.tolist() for key, value in frame._asdict().items()} for frame in clip] for clip in every]
    command = [python, PEERS / "people.py"]
    done = subprocess.run(command, input=json.dumps(frames), capture_output=True, text=True, check=True)
    check(every, json.loads(done.stdout)["measures"])


@given(st.integers(0, 5), st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_the_best_assignment_is_found(rows, columns, seed):
    rng = np.random.default_rng(seed)
    score = rng.integers(0, 4, (rows, columns)).astype(float)
    pairs = assigned(score)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    short, long = sorted((rows, columns))
    wide = score if rows <= columns else score.T
    best = max(sum(wide[i, j] for i, j in enumerate(chosen)) for chosen in itertools.permutations(range(long), short))
    assert sum(score[pair] for pair in pairs) == best and all(score[pair] > 0 for pair in pairs)


def table(rows, *, parts=("box",), status=None):
    """Of rows (frame, target, x): targets 20 pixels large, whose points are 6 pixels apart."""
    names = tuple((name, part) for name in dict.fromkeys(name for _, name, _ in rows) for part in parts)
    each = [(names.index((name, part)), t, at + 6.0 * k) for t, name, at in rows for k, part in enumerate(parts)]
    which, frame, x = zip(*each, strict=True)
    sides = np.full(len(x), 20.0) if parts == ("box",) else None
    return build(names, which, frame, x=x, y=np.full(len(x), 50.0), w=sides, h=sides, status=status or [""] * len(x))


@pytest.mark.parametrize("parts", [("box",), ("nose", "chin")])
def test_targets_take_the_names_of_the_people_they_are(parts):
    truth = table([(t, name, at) for t in range(10) for name, at in (("Ann", 10.0), ("Bob", 100.0))], parts=parts)
    ours = table(
        [(t, name, at) for t in range(10) for name, at in (("b", 100.5), ("Bob", 10.5), ("c", 200.0))], parts=parts
    )
    named, found, told = identified(ours, truth)
    assert named.targets == ("Bob", "Ann", "c")
    assert set(told) == {"b is Bob of the ground truth", "Bob is Ann of the ground truth"}
    assert (found.people, found.targets, found.recall, found.switches) == (2, 3, 1.0, 0)
    assert found.precision == pytest.approx(2 / 3) and found.idf1 == pytest.approx(0.8)


def test_who_is_hidden_or_lost_does_not_count_and_frames_of_nobody_do():
    truth = table([(t, "Ann", 10.0) for t in range(8) if t not in (3, 4)], status=["visible"] * 3 + ["hidden"] * 3)
    ours = table([(t, "a", 10.0) for t in range(8)], status=["tracked"] * 2 + ["lost"] + ["tracked"] * 5)
    frames = seen_in(ours, truth)
    assert [len(one.people) for one in frames] == [1, 1, 1, 0, 0, 0, 0, 0]
    assert [len(one.targets) for one in frames] == [1, 1, 0, 1, 1, 0, 0, 0], "on nobody in frames 3 and 4"


def test_class_1_of_mot_counts_and_targets_on_distractors_do_not(tmp_path):
    """Which TrackEval 1.3.0 gives 1.0, too: a person, a static person (7, flag 0) and a hand (2), all followed."""
    boxes = {1: (100, "1,1,1"), 2: (200, "0,7,1"), 3: (300, "1,2,1")}
    lines = [f"{n},{who},{left + n},50,40,50,{rest}" for n in range(1, 11) for who, (left, rest) in boxes.items()]
    (tmp_path / "gt.txt").write_text("\n".join(lines))
    names = [(f"person_{who}", "box") for who in boxes]
    which, frame = np.repeat(np.arange(3), 10), np.tile(np.arange(10), 3)
    left = np.array([left for left, _ in boxes.values()])[which] + frame + 0.0
    place = {"x": left + 19.5, "y": np.full(30, 73.5), "w": np.full(30, 40.0), "h": np.full(30, 50.0)}
    _, found, _ = identified(build(names, which, frame, **place), read_mot(tmp_path / "gt.txt"))
    assert (found.people, found.targets, found.idf1, found.hota) == (1, 1, 1.0, 1.0)


def test_the_option_measures_people_whatever_their_names(tmp_path, capsys):
    truth, ours = tmp_path / "truth.csv", tmp_path / "ours.csv"
    for path, names in ((truth, ("Ann", "Bob")), (ours, ("p2", "p1"))):
        rows = [f"{t},{name},box,{x},50,20,20\n" for t in range(9) for name, x in zip(names, (10, 99), strict=True)]
        path.write_text("frame,target,part,x,y,w,h\n" + "".join(rows))
    assert main(["eval", str(ours), "--truth", str(truth)]) == 3
    assert "--people" in capsys.readouterr().err
    with pytest.raises(InputError, match="neither boxes nor two points in common"):
        seen_in(table([(0, "a", 1.0)]), table([(0, "a", 1.0)], parts=("nose",)))
    assert main(["eval", str(ours), "--truth", str(truth), "--people", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["all"]["people"]["idf1"] == found["all"]["people"]["hota"] == 1.0
    assert [one["target"] for one in found["parts"]] == ["Ann", "Bob"]
    assert main(["eval", str(ours), "--truth", str(truth), "--people"]) == 0
    assert "IDF1" in capsys.readouterr().out
