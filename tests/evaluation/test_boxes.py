"""Measures of boxes and identities: against plain twins, their own laws, a case worked out by hand, and other tools.

These were recorded to 1e-9, and are asked again if FACETRACK_PEERS says by whom.
"""

import itertools
import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation.accuracy import centre_errors, measure_boxes, within
from facetrack_cli.evaluation.identities import Seen, assigned, identified, measure_people, seen_in
from facetrack_cli.trajectory.formats.boxes import read_mot
from facetrack_cli.trajectory.trajectory import build
from tests.peers import cases
from tests.twins import boxes as naive_boxes

NAN = [np.nan] * 4
SHARES = ("success_auc", "precision_20", "normalised_auc", "ao", "sr50", "good_rate")
place = st.floats(-50, 150).map(lambda v: round(v, 2))
side = st.floats(0.1, 90).map(lambda v: round(v, 2))
box = st.tuples(place, place, side, side)
pairs = st.lists(st.tuples(box, box), min_size=1, max_size=8)


def arrays(rows):
    a, b = np.array(rows, dtype=float).transpose(1, 0, 2)
    return a, b


@given(pairs, place, place)
def test_iou_is_its_definition_and_does_not_depend_on_the_place(rows, dx, dy):
    a, b = arrays(rows)
    overlap = iou(a, b)
    np.testing.assert_allclose(overlap, [naive_boxes.iou(*row) for row in rows], atol=1e-12)
    clipped = [naive_boxes.iou(*(naive_boxes.clip(box, 100, 60) for box in row)) for row in rows]
    np.testing.assert_allclose(iou(a, b, (100, 60)), clipped, atol=1e-12)
    np.testing.assert_array_equal(overlap, iou(b, a))
    np.testing.assert_allclose(iou(a, a), 1.0, rtol=1e-12)
    moved = np.array([dx, dy, 0, 0])
    np.testing.assert_allclose(iou(a + moved, b + moved), overlap, atol=1e-9)


def test_iou_of_empty_turned_and_unknown_boxes():
    full = [0, 0, 10, 10]
    rows = [([3, 3, 0, 0], full), ([3, 3, 0, 5], [3, 3, 0, 5]), ([5, 5, -3, -3], full), ([8, 0, -3, 3], [8, 0, 3, 3])]
    np.testing.assert_array_equal(iou(*arrays(rows)), 0.0)
    assert np.isnan(iou(*arrays([(NAN, full), (full, NAN)]))).all()


def test_a_box_that_sticks_out_on_the_left_is_moved_when_clipped():
    """What GOT-10k does, strange as it is: not cut, as on the right."""
    assert iou(*arrays([([-5, 0, 20, 10], [0, 0, 20, 10])]), (100, 60)) == pytest.approx(1.0)
    assert iou(*arrays([([85, 0, 20, 10], [85, 0, 15, 10])]), (100, 60)) == pytest.approx(1.0)


def test_centre_lies_in_the_box_up_to_its_border():
    truth = np.tile([10.0, 20, 40, 20], (6, 1))
    ours = truth.copy()
    ours[:, 0] += [0, 10, 10.01, 20, 20.01, 0]  # a quarter of 40, and a half
    ours[5, 1] += 10.01
    assert within(ours, truth).tolist() == [True, True, True, True, False, False]


def test_measures_of_an_example_worked_out_by_hand():
    """Rows: given, exact, 25 px off to the right (IoU 3/13), missing, absent, hidden, half the width."""
    truth = np.tile([10.0, 20, 40, 20], (7, 1))
    ours = truth.copy()
    ours[0, 0] = 12
    ours[2, 0] += 25
    ours[3] = [10, np.nan, 40, 20]
    truth[4] = NAN
    ours[5] = [90, 90, 5, 5]
    ours[6, 2] = 20
    valid = np.array([True] * 5 + [False, True])
    found = measure_boxes(ours, truth, visible=valid)
    assert (found.rows, found.missing) == (5, 1)
    np.testing.assert_allclose(found.overlap, [1, 1, 3 / 13, 0, np.nan, np.nan, 0.5], rtol=1e-12)
    # strictly above: IoU 1 misses the last threshold, 0.5 the one at 0.5; 3/13 is above 0, .05, .1, .15, .2
    success = [4 / 5] * 5 + [3 / 5] * 5 + [2 / 5] * 10 + [0]
    np.testing.assert_allclose(found.success, success)
    assert found.success_auc == pytest.approx(np.mean(success))
    precision = [2 / 5] * 10 + [3 / 5] * 15 + [4 / 5] * 26
    np.testing.assert_allclose(found.precision, precision)
    assert found.precision_20 == 3 / 5
    # 25 of 40 px is beyond the curve, 10 of 40 is 0.25
    np.testing.assert_allclose(found.normalised_precision, [2 / 5] * 25 + [3 / 5] * 26)
    assert found.normalised_auc == pytest.approx((25 * 2 + 26 * 3) / 5 / 51)
    assert found.normalised_20 == 2 / 5
    assert found.ao == pytest.approx((1 + 3 / 13 + 0 + 0.5) / 4)
    assert (found.sr50, found.sr75) == (1 / 4, 1 / 4)
    assert found.good_rate == 3 / 5
    found = measure_boxes(ours, truth, visible=valid, init=np.zeros(7, bool))  # the first counts as any
    assert found.overlap[0] == pytest.approx(38 / 42)
    assert found.ao == pytest.approx((38 / 42 + 1 + 3 / 13 + 0 + 0.5) / 5)


@pytest.mark.parametrize("rows", [0, 1, 4])
def test_nothing_to_measure_has_no_value(rows):
    found = measure_boxes(np.ones((rows, 4)), np.full((rows, 4), np.nan), size=(10, 10))
    assert (found.rows, found.missing, found.hidden_rows) == (0, 0, 0)
    for name in SHARES:
        assert getattr(found, name) is None, name
    assert found.success.shape == (21,)
    assert np.isnan(found.precision).all() and found.overlap.shape == (rows,)
    if rows:  # without a box of ours all is zero
        truth = np.tile([10.0, 20, 40, 20], (rows, 1))
        found = measure_boxes(np.full((rows, 4), np.nan), truth, init=np.zeros(rows, bool))
        assert (found.rows, found.missing) == (rows, rows) and {getattr(found, name) for name in SHARES} == {0.0}


CLOSE = 1e-9
RECORDED = cases.expected()


def ours(case):
    """The measures as measure.py has them."""
    known = ~np.isnan(case.truth).any(axis=1)
    found = measure_boxes(case.ours, case.truth, size=case.size)
    return {
        "iou": iou(case.ours, case.truth),
        "iou_clipped": iou(case.ours, case.truth, case.size),
        "centre_error": centre_errors(case.ours, case.truth),
        "otb": {
            "success_curve": found.success,
            "precision_curve": found.precision,
            "success_score": found.success_auc,
            "precision_score": found.precision_20,
            "success_rate": found.success[10],
        },
        "otb_success_of_all": found.success_auc * known.sum() / len(known),
        "normalised": {"curve": found.normalised_precision, "score": found.normalised_auc},
        "got10k": {"ao": found.ao, "sr": found.sr50, "sr75": found.sr75},
    }


def differences(mine, theirs, place=""):
    """Every value that differs by more than CLOSE, or is known to one of us alone."""
    if isinstance(theirs, dict):
        assert mine.keys() == theirs.keys()
        return [each for key in theirs for each in differences(mine[key], theirs[key], f"{place} {key}")]
    a, b = np.atleast_1d(np.array(mine, dtype=float)), np.atleast_1d(np.array(theirs, dtype=float))
    assert a.shape == b.shape, place
    with np.errstate(invalid="ignore"):
        apart = ~((np.abs(a - b) <= CLOSE) | (np.isnan(a) & np.isnan(b)))
    return [f"{place}[{at}]: ours {a[at]!r}, theirs {b[at]!r}" for at in np.flatnonzero(apart)]


def check(case, theirs):
    mine, theirs = ours(case), dict(theirs)
    # a single missing box makes their AO nan, and we count it as 0
    missing = np.isnan(case.ours).any(axis=1) & ~np.isnan(case.truth).any(axis=1)
    with_nan = theirs.pop("got10k_ao_with_nan")
    theirs["got10k"] = {name: theirs["got10k"][name] for name in mine["got10k"]}
    assert with_nan is None if missing[1:].any() else with_nan == theirs["got10k"]["ao"]
    assert not differences(mine, theirs)


@pytest.mark.parametrize("name", RECORDED)
def test_measures_are_those_recorded_from_the_toolkits(name):
    check(*RECORDED[name])


def test_records_reach_every_rule():
    """What would make the comparison empty: no miss, no absence, no value on a threshold."""
    edges, walk = RECORDED["edges"][0], RECORDED["walk"][0]
    for case in (edges, walk):
        assert np.isnan(case.ours).any() and np.isnan(case.truth).any()
    overlaps = iou(edges.ours, edges.truth)
    assert {0.0, 0.5, 0.75, 1.0} <= set(overlaps[~np.isnan(overlaps)])
    assert 20.0 in centre_errors(edges.ours, edges.truth)


@pytest.mark.nightly
def test_the_toolkits_say_now_what_they_said_and_what_we_say_of_new_cases():
    python = os.environ.get("FACETRACK_PEERS")
    if not python:
        pytest.skip("FACETRACK_PEERS names no Python that has the packages of tests/peers/requirements.txt")
    seed = int(time.time()) // 86400  # new ones each day; the names of the cases tell the seed
    given = {name: case for name, (case, _) in RECORDED.items()} | cases.random(seed)
    said = cases.run(python, given)["measures"]
    for name, case in given.items():
        check(case, said[name])
    for name, (_, held) in RECORDED.items():
        assert not differences(held, said[name], name)


# --- identities over time
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


def check_people(of, measures):
    for clip, theirs in zip(of, measures, strict=True):
        ours = vars(measure_people(clip))
        for expected in theirs.values():
            assert {name: ours[name] for name in expected} == pytest.approx(expected, abs=1e-9)


def test_the_measures_are_those_recorded_from_the_toolkits():
    recorded = json.loads((PEERS / "people.json").read_text(encoding="utf-8"))["measures"]  # of clips(0)
    assert all(any(clip["trackeval"][name] for clip in recorded) for name in ("switches", "fragments"))
    check_people(clips(0), recorded)


def test_the_measures_are_those_of_the_toolkits_now():
    python = os.environ.get("FACETRACK_PEERS")
    if not python:
        pytest.skip("FACETRACK_PEERS names no Python that has the packages of tests/peers/requirements.txt")
    every = [clip for seed in range(10) for clip in clips(seed)]
    frames = [[{key: value.tolist() for key, value in frame._asdict().items()} for frame in clip] for clip in every]
    command = [python, PEERS / "people.py"]
    done = subprocess.run(command, input=json.dumps(frames), capture_output=True, text=True, check=True)
    check_people(every, json.loads(done.stdout)["measures"])


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
