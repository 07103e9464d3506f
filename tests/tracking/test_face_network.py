"""A face whose points a network places: its rows, what is lost, corrections and smoothing. The network is a fake."""

import json
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from click.testing import CliRunner

from facetrack_cli.cli.app import cli
from facetrack_cli.core.face_points import GROUPS, POINTS
from facetrack_cli.core.types import BOX, Correction
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.face import assembly as targets
from facetrack_cli.trackers.face.mesh import CROPS, NAMES
from facetrack_cli.trackers.face.stabilized import EYES
from facetrack_cli.trackers.smoothed import smoothed_rows
from facetrack_cli.trajectory.diagnostics import NETWORK
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import UNSEEN, successive
from tests.support import moving_face as moving
from tests.support.fake_mesh import IN_CLIP, FakeMesh, clip
from tests.support.moving_face import PARTS, Pose
from tests.support.samples import FOLDER

OF_EYES = GROUPS["eyes"]  # by the regression
OTHERS = tuple(part for part in POINTS if part not in (*PARTS, *OF_EYES))
FEATURES = (*OF_EYES, *OTHERS)
ALL = tuple(name for name in NAMES if name not in (*PARTS, *OF_EYES))
POSES = [Pose(120 + 1.2 * t, 112 + 6 * np.sin(t / 6), 100 * 1.003**t) for t in range(40)]


def results_of(mesh, poses, points="features", corrections=(), particles=100):
    """What a tracker gives that was built with `mesh` as the network."""
    more = [f"head.landmarks.{key}={value}" for key, value in (("network", "mesh"), ("points", points))]
    recipe = load_recipe("face", [*more, f"filter.particles={particles}", "head.detections=null"])
    start = replace(moving.start(poses[0]), corrections=tuple(corrections))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(targets, "model_path", lambda name: name)
        patch.setattr(targets, "Mesh", {"mesh": mesh}.get)
        return list(track(build_tracker(recipe, start), iter(clip(poses)), 0))


def column(results, name, parts):
    """(T, J) of a column."""
    names = [part for _, part in results[0].rows.names]
    return np.stack([getattr(one.rows, name) for one in results])[:, [names.index(part) for part in parts]]


def places(results, parts):
    return np.stack([column(results, name, parts) for name in "xy"], axis=-1)


def errors(at, mesh, poses, parts):
    """(T, J) in distances between the eyes."""
    index = [NAMES[part] for part in parts]
    return np.stack(
        [np.hypot(*(one - mesh.truth(t)[index]).T) / (moving.EYES * poses[t].side) for t, one in enumerate(at)]
    )


@pytest.fixture(scope="module")
def moved():
    """A face that moves and grows, seen by a network that trembles by a pixel."""
    mesh = FakeMesh(POSES, noise=1.0)
    return mesh, results_of(mesh, POSES)


def test_rows_are_those_of_the_parts_of_the_box_and_of_the_points_of_the_network(moved):
    mesh, results = moved
    assert all(tuple(part for _, part in one.rows.names) == (*PARTS, BOX, *FEATURES) for one in results)
    assert len(FEATURES) == 23
    assert {*results[0].rows.status[:6]} == {"init"} and {*results[0].rows.status[6:]} == {"tracked"}
    for one in results:
        np.testing.assert_array_equal(one.rows.frame, one.frame.index)
        assert np.isfinite([one.rows.x, one.rows.y, one.rows.std_x, one.rows.std_y, one.rows.confidence]).all()
        assert np.isfinite(one.rows.w[:6]).all() and np.isnan(one.rows.w[6:]).all(), "they have no windows"
    for parts in (PARTS, FEATURES):
        found = errors(places(results, parts), mesh, POSES, parts)
        assert np.median(found) < 0.06 and (found < 0.35).mean() > 0.99
    assert (column(results, "status", FEATURES) == "lost").mean() < 0.1


def test_of_all_points_there_is_a_row_each():
    mesh = FakeMesh(POSES[:3])
    results = results_of(mesh, POSES[:3], "all")
    names = [part for _, part in results[2].rows.names]
    assert len({*names} - {BOX}) == 468 and len(names) == 469 and names[:6] == [*PARTS, BOX]
    found = errors(places(results, ALL), mesh, POSES, ALL)
    assert found[0] == pytest.approx(0, abs=1e-6) and found.max() < 0.2


def test_before_the_network_has_seen_the_face_its_points_are_lost_and_have_no_place():
    mesh = FakeMesh([None if t < 4 else pose for t, pose in enumerate(POSES[:14])])
    results = results_of(mesh, POSES[:14])
    assert (column(results[:4], "status", OTHERS) == "lost").all() and np.isnan(places(results[:4], OTHERS)).all()
    assert (column(results, "status", (*PARTS, BOX, *OF_EYES)) != "lost").all(), "windows and regression show them"
    assert errors(places(results, PARTS), FakeMesh(POSES), POSES, PARTS).max() < 0.35
    assert (column(results[4:], "status", FEATURES) == "tracked").mean() > 0.9
    assert np.isfinite(places(results[4:], FEATURES)).all()
    # a run of which the network never sees the face has rows that can be smoothed
    never = results_of(FakeMesh([None] * 6), POSES[:6])
    rows = successive([one.rows for one in never])
    after = smoothed_rows(rows, [one.targets[0].beliefs() for one in never])
    for one in (rows, after):
        part = np.array([part for _, part in one.names])[one.which]
        assert {*one.status[np.isin(part, OTHERS)]} == {"lost"} and np.isnan(one.x[np.isin(part, OTHERS)]).all()
        assert np.isfinite(one.x[~np.isin(part, OTHERS)]).all()


def test_points_of_a_network_are_lost_while_it_sees_no_face_and_with_the_head():
    still, head_gone = [POSES[0]] * 45, slice(34, 45)
    seen = [None if 10 <= t < 24 else pose for t, pose in enumerate(still)]
    shown = [pose if t < 28 else None for t, pose in enumerate(still)]
    results = results_of(FakeMesh(seen), shown)
    gone = np.isin(column(results, "status", OTHERS), UNSEEN)
    assert gone[20:24].all() and gone[:11].mean() < 0.2 and gone[27].mean() < 0.2
    assert (column(results[:28], "status", (BOX,)) != "lost").all()
    confidence = column(results, "confidence", OTHERS)
    assert (confidence[23] < confidence[9]).mean() > 0.8
    status = column(results, "status", OTHERS)
    known = np.isfinite(confidence) & (status != "init")
    assert ((status == "lost") == (confidence < 0.5))[known].all(), "one rule"
    assert gone[head_gone].all() and (column(results[head_gone], "status", (BOX,)) == "lost").all()


def test_a_correction_puts_parts_and_points_of_the_network_right_and_all_may_be_absent():
    poses = [POSES[0]] * 5 + [Pose(200, 120)] * 10
    mesh = FakeMesh(poses)
    given = dict(zip(PARTS, map(tuple, moving.truth(poses[5], 0).tolist()), strict=True))
    for learn in (None, True):
        one = Correction(5, "face", points=given, learn=learn)
        gone = Correction(11, "face", absent=PARTS)
        results = results_of(mesh, poses, corrections=(one, gone))
        rows = results[5].rows
        assert rows.by_hand.tolist() == [True] * 5 + [False] * 24
        assert {*rows.status[:5]} == {"init"} and {*rows.status[6:]} <= {"tracked", "lost"}
        found = errors(places(results[:11], (*PARTS, *FEATURES)), mesh, poses, (*PARTS, *FEATURES))
        assert found[5].max() < 0.1 and (found[5:] < 0.35).mean() > 0.97
        assert {*results[12].rows.status} == {"absent"} and np.isnan(results[12].rows.x).all()


def jitter(at):
    return np.median(np.abs(at[2:] - 2 * at[1:-1] + at[:-2]))


def test_smoothed_points_of_parts_and_network_are_nearer_and_quieter(moved):
    mesh, results = moved
    rows = successive([one.rows for one in results])
    beliefs = [one.targets[0].beliefs() for one in results]
    assert [len(one.mean) for one in beliefs[0]] == [5, 1, 8, 15]
    after = smoothed_rows(rows, beliefs)
    assert after.names == rows.names
    for name in ("status", "confidence", "frame"):
        np.testing.assert_array_equal(getattr(after, name), getattr(rows, name))
    smooth = [after.at(one.frame.index) for one in results]
    index = {part: i for i, (_, part) in enumerate(rows.names)}
    for parts, quieter in ((FEATURES, 0.8), (PARTS, 1.05)):
        which = [index[part] for part in parts]
        at = np.stack([np.stack([one.x, one.y], axis=1)[which] for one in smooth])
        before = places(results, parts)
        assert jitter(at) < quieter * jitter(before)
        shown = column(results, "status", parts) != "lost"
        off = errors(at, mesh, POSES, parts)
        # where windows follow a part nothing is left to gain
        assert off[shown].mean() < (1.01 if parts is PARTS else 1.0) * errors(before, mesh, POSES, parts)[shown].mean()
    box = np.stack([[one.x[5], one.y[5], one.w[5]] for one in smooth])
    assert np.isfinite(box).all() and np.abs(box[:, 0] - [pose.x for pose in POSES]).max() < 8


class Astray(FakeMesh):
    """A network that takes what is above or below for the lower lip, for a while."""

    def measure(self, frame, head, crops=CROPS):
        found = super().measure(frame, head, crops)
        if frame.index >= 12 and frame.index % 14 < 9:
            found[:, NAMES["lip_lower"]] += (0, 0.28 * EYES * (1 if frame.index % 28 < 14 else -1))
        return found


def test_a_network_that_takes_something_else_for_a_lip_does_not_move_it_and_is_said_to():
    mesh = Astray(POSES, noise=0.5)
    results = results_of(mesh, POSES, particles=300)
    with_it, known = places(results, ["lip_lower"]), FakeMesh(POSES)
    assert errors(with_it, known, POSES, ["lip_lower"]).max() < 0.14
    share = np.array([one.rows.diagnostics["face"].get(NETWORK.name)[-1] for one in results[1:]])
    assert share[:10].min() > 0.95 and share.min() < 0.9, "one of five points"
    assert (column(results, "status", PARTS)[1:] == "tracked").all()


def test_a_smoothed_run_of_a_clip_and_its_report_name_the_network(tmp_path, monkeypatch, no_plot):
    monkeypatch.setattr(targets, "model_path", lambda name: name)
    monkeypatch.setattr(targets, "Mesh", lambda path: FakeMesh([IN_CLIP] * 9, noise=0.6))
    sets = ("--set", "head.landmarks.network=mesh", "--set", "filter.particles=100", "--stop", "9", "--no-video")
    out = tmp_path / "run"
    output = called("run", FOLDER / "expressions.mp4", "--config", "face", *sets, "--smooth", "-o", out)
    record = json.loads((out / "run.json").read_text())
    assert record["networks"] == ["mesh"]
    assert "with the network mesh" in output
    table = read_trajectory(out / "trajectory.csv")
    assert [part for _, part in table.names] == [*PARTS, BOX, *FEATURES] and len(table.frames) == 9
    if find_spec("matplotlib"):
        called("report", out)
        [page] = out.glob("*.html")
        assert "Its points were placed with the network mesh." in page.read_text()


def called(*words):
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.output
