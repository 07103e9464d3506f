"""The landmark network, where its file is there, and the sensors of points with and without it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from facetrack_cli.core.face_points import MESH, POINTS
from facetrack_cli.trackers.face.cascaded_regression import face_channels, load_regression
from facetrack_cli.trackers.face.detectors import Detection
from facetrack_cli.trackers.face.landmark_filters import DETECTOR, FADES, NETWORK, REGRESSION
from facetrack_cli.trackers.face.landmark_sensors import LandmarkSensors
from facetrack_cli.trackers.face.mesh import COUNT, CROPS, NAMES, Mesh
from facetrack_cli.trackers.face.stabilized import EYES
from tests.support import moving_face as moving
from tests.support.fake_mesh import IN_CLIP, FakeMesh, head_of
from tests.support.moving_face import PARTS, Pose

CORE = [NAMES[part] for part in PARTS]
POSES = [IN_CLIP, Pose(120, 110, 60), Pose(180, 125, 130, 12), Pose(160, 120, 90, -20)]


def off(a, b):
    """Distances, in those between the eyes of the stabilized image."""
    return np.hypot(*(a - b).T) / EYES


def test_each_point_of_the_mesh_has_one_name():
    assert sorted(NAMES.values()) == list(range(COUNT))
    assert {part: NAMES[part] for part in POINTS} == MESH
    assert all(name in POINTS or name == f"mesh_{i}" for name, i in NAMES.items())


@pytest.mark.parametrize("pose", POSES)
def test_the_network_places_the_points_where_they_are(mesh_model, pose):
    """Wherever the face is in the frame, however large and turned, it is seen in its head."""
    [frame] = moving.clip([pose])
    head = head_of(pose)
    found = Mesh(mesh_model).measure(frame, head)
    assert found.shape == (len(CROPS), COUNT, 2)
    at = found.mean(axis=0)
    true = head.to_stabilized(moving.truth(pose, 0))
    assert off(at[CORE], true).max() < 0.12
    assert off(at[CORE], load_regression().fit(head.read(frame).bgr).at).max() < 0.2, (
        "and where the regression has them"
    )
    # brows above eyes above nose, and the left of the image at the left
    brow, eye, chin = (at[MESH[part]] for part in ("brow_left_middle", "eye_left_upper", "chin"))
    assert brow[1] < eye[1] < at[MESH["nose"], 1] < chin[1] and eye[0] < chin[0] < at[MESH["eye_right_upper"], 0]
    assert np.median(off(*found)) < 0.06, "both crops say nearly the same"
    # the same face in another head: turned, smaller and beside it
    other = head._replace(centre=head.centre + 3, scale=0.93 * head.scale, angle=head.angle + 0.15)
    again = other.to_frame(Mesh(mesh_model).measure(frame, other).mean(axis=0))
    assert np.median(off(head.to_stabilized(again), at)) < 0.06


def test_the_network_sees_no_face_where_there_is_none_and_one_in_each_thread(mesh_model):
    mesh, head = Mesh(mesh_model), head_of(IN_CLIP)
    assert mesh.measure(moving.frame(0, moving.ground()), head) is None
    frames = moving.clip([IN_CLIP] * 8)
    alone = [mesh.measure(frame, head) for frame in frames]
    assert not np.allclose(alone[0], alone[7])
    with ThreadPoolExecutor(2) as pool:
        for one, other in zip(alone, pool.map(lambda frame: mesh.measure(frame, head), frames), strict=True):
            np.testing.assert_array_equal(one, other)


def sensed(sensors, pose=IN_CLIP):
    [frame] = moving.clip([pose])
    head = head_of(pose)
    seen = head.read(frame)
    return sensors.read(frame, head, seen), seen.bgr


def begun(sensors, x0, found=None):
    [frame] = moving.clip([IN_CLIP])
    head = head_of(IN_CLIP)
    return sensors.begin(frame, head, head.read(frame), found, x0)


def sensors_of(parts, mesh=None, others=(), searched=False):
    return LandmarkSensors(parts, None, searched, mesh, others)


def test_without_a_network_the_regression_places_its_parts_and_of_others_nothing_is_known():
    (_, parts, network, others, _), seen = sensed(sensors_of(("lip_lower", "ear_left", "nose", "chin")))
    expected, order = load_regression().fit(seen), [PARTS.index("lip_lower"), 0]
    np.testing.assert_array_equal(parts.at[[0, 2]], expected.at[order])
    np.testing.assert_array_equal(parts.odds[[0, 2]], expected.odds[order])
    assert np.isnan(parts.at[[1, 3]]).all() and (parts.odds[[1, 3]] == 0).all()
    assert others is None and np.isnan(network).all()


def test_a_network_and_the_regression_place_parts_which_are_visible_where_either_says():
    mesh, names = FakeMesh([IN_CLIP], noise=0.4), tuple(name for name in NAMES if name not in PARTS)
    (_, parts, network, others, _), seen = sensed(sensors_of((*PARTS, "ear_left"), mesh, names))
    [frame] = moving.clip([IN_CLIP])
    at = mesh.measure(frame, head_of(IN_CLIP)).mean(axis=0)
    np.testing.assert_allclose(network[:5], at[CORE])
    assert np.isnan([parts.at[5], network[5]]).all() and parts.odds[5] == 0
    regressed = load_regression().fit(seen)
    np.testing.assert_array_equal(parts.at[:5], regressed.at)
    np.testing.assert_allclose(others.at, at[[NAMES[name] for name in names]])
    # of each point of which something is known, the odds at its place; of all others those of the nearest
    descent = load_regression()
    core = at[[NAMES[point] for point in descent.points]]
    odds = descent.visible(face_channels(seen), core)
    both = 0.5 * np.exp(odds[:5]) + 0.5 * np.exp(regressed.odds)
    np.testing.assert_allclose(np.exp(parts.odds[:5]), both, rtol=1e-5)
    assert len(set(others.odds.tolist())) > 20
    for place, said in zip(others.at, others.odds, strict=True):
        assert said == odds[min(range(len(core)), key=lambda j: np.hypot(*(core[j] - place)))]


def test_a_network_that_sees_no_face_places_nothing_and_the_regression_says_what_is_visible():
    (_, parts, network, others, _), seen = sensed(sensors_of(PARTS, FakeMesh([None]), ("chin",)))
    assert np.isnan(network).all() and others is None
    np.testing.assert_array_equal(parts.odds, load_regression().fit(seen).odds)
    sensors, points, _ = begun(sensors_of(PARTS, FakeMesh([None]), ("chin",)), np.zeros((5, 2)))
    assert points is None
    reading, *_ = sensors.reading(np.stack([parts.at, network, network]), np.ones(5), parts.at)
    assert (sensors.bias[1:] == 0).all() and (reading.sure[1:] == 0).all() and (reading.sure[0] > 0).all()


@pytest.mark.parametrize("searched", [False, True])
def test_the_bias_of_sensors_fades_where_the_points_of_the_start_were_searched(searched):
    x0 = head_of(IN_CLIP).to_stabilized(moving.truth(IN_CLIP, 0)) + 1.5
    sensors = sensors_of(PARTS, FakeMesh([IN_CLIP]), searched=searched)
    found, _ = sensed(sensors)
    biases, *_ = begun(sensors, x0, Detection((0, 0, 9, 9), None, {"nose": tuple(x0[0] + 2.0)}))
    assert biases.keep == (FADES if searched else 1.0)
    np.testing.assert_array_equal(biases.min_std, [REGRESSION, DETECTOR, NETWORK])
    regression, detector, network = biases.bias
    np.testing.assert_allclose(regression, found.parts.at - x0)
    np.testing.assert_allclose(network, found.network - x0)
    np.testing.assert_allclose(detector, [[2, 2], *4 * [[0, 0]]])
