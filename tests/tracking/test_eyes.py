"""What places the points of a face, by regressions and by the network: real faces, shut lids, covers; sensors."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from facetrack_cli.core.face_points import MESH, POINTS
from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Frame, Planes
from facetrack_cli.trackers.face import eyes, image_kernels
from facetrack_cli.trackers.face.cascaded_regression import (
    CORNER,
    LEFT,
    ODDS_SCALE,
    TOP,
    channels,
    face_channels,
    load_regression,
    read,
)
from facetrack_cli.trackers.face.detectors import Detection
from facetrack_cli.trackers.face.eyes import CORNERS, SMALL, load_eyes, openings
from facetrack_cli.trackers.face.landmark_filters import DETECTOR, FADES, NETWORK, REGRESSION
from facetrack_cli.trackers.face.landmark_sensors import LandmarkSensors
from facetrack_cli.trackers.face.mesh import COUNT, CROPS, NAMES, Iris, Mesh
from facetrack_cli.trackers.face.stabilized import EYES, Similarity, change_between
from facetrack_cli.video.decode import _to_bt601
from tests.support import moving_face as moving
from tests.support.fake_mesh import _AT, IN_CLIP, FakeMesh, head_of
from tests.support.moving_face import PARTS, Pose
from tests.support.samples import TrackClip
from tests.twins import cascaded_regression as naive

TRUE = np.array([_AT[point] for point in eyes.POINTS], float)  # in the stabilized image
POSES = [IN_CLIP, Pose(120, 110, 60), Pose(180, 125, 130, 12), Pose(160, 120, 90, -20)]


def found(pose, change=lambda picture, to_frame: picture):
    """What the regression says of a frame that is changed, and what is in that frame."""
    [frame] = moving.clip([pose])
    head = head_of(pose)
    frame = Frame(0, 0.0, change(frame.bgr.copy(), head.to_frame))
    still = head.read(frame).bgr
    return load_eyes().fit(frame, head, face_channels(still), load_regression().fit(still).at), frame


NO_MATRIX = np.empty((0, 3))


def shown(image, views, side, matrix=NO_MATRIX, rows=None, tints=None):
    out = np.empty((len(views), rows or side, side), np.uint8)
    image_kernels.see(image, *(tints or (image, image)), (0, 0, 1), (0, 0, 2), views, 0.0, matrix, out)
    return out


def by_opencv(image, view, side, step=1.0, off=0.0):
    """The view of an image whose pixels are `step` of the frame, of which the first is at `off`."""
    u, v, a, b = view
    matrix = np.array([[a, -b, (u - off) / step], [b, a, (v - off) / step]])
    return warp_affine(image, matrix, (side, side), cv2.BORDER_REPLICATE, inverse=True)


def test_patches_are_read_as_opencv_reads_them_and_their_channels_are_what_the_plain_twin_says():
    rng = np.random.default_rng(4)
    image = cv2.resize(rng.integers(0, 256, (9, 11), dtype=np.uint8), (60, 50), interpolation=cv2.INTER_CUBIC)
    views = np.array([[-7.3, 2.2, 0.9, 0.3], [40.0, 9.6, -1.7, 1.4]])
    out = shown(image, views, 26)
    for view, patch in zip(views, out, strict=True):
        np.testing.assert_array_equal(patch, by_opencv(image, view, 26))
    places = np.array([[3.0, 4.0], [25.0, 0.0], [11.4, 19.6]])
    read, (one, other) = np.empty((2, 28), np.float32), out.tolist()
    image_kernels.read_eyes(out, places, read)
    for phi, levels in zip(read, (one, [row[::-1] for row in other]), strict=True):
        plain = naive.read(naive.patch_channels(levels), places.tolist(), 1.0, grid=1)
        np.testing.assert_allclose(phi, plain, atol=1e-3)


@pytest.mark.parametrize("height, width", [(1, 1), (1, 9), (9, 1), (2, 2), (9, 11)])
def test_patches_beyond_a_small_image_are_read_as_opencv_reads_them(height, width):
    rng = np.random.default_rng(height * width)
    image, (a, b, u, v) = rng.integers(0, 256, (height, width), dtype=np.uint8), rng.normal(0, 2, 4)
    np.testing.assert_array_equal(shown(image, np.array([[u, v, a, b]]), 12)[0], by_opencv(image, (u, v, a, b), 12))


@pytest.mark.parametrize("matrix", [None, _to_bt601(1), _to_bt601(9)])
def test_planes_are_seen_as_opencv_warps_each_and_then_joins_them(matrix):
    rng = np.random.default_rng(8)
    y, u, v = (rng.integers(0, 256, (side, side), dtype=np.uint8) for side in (40, 20, 20))
    views, ours = np.array([[5.2, -3.1, 0.9, 0.3], [11.0, 9.6, 1.2, -0.2]]), NO_MATRIX if matrix is None else matrix
    joined, lit = (shown(y, views, 24, ours, rows, (u, v)) for rows in (36, 24))
    for view, all_, of_y in zip(views, joined, lit, strict=True):
        # a tint lies in the middle of two by two pixels, of the view as of the frame
        (a, b), (at, top) = view[2:], view[:2]
        tint = at + 0.5 * (a - b), top + 0.5 * (a + b), a, b
        warped = Planes(by_opencv(y, view, 24), *(by_opencv(one, tint, 12, 2.0, 0.5) for one in (u, v)), matrix)
        np.testing.assert_array_equal(all_, warped.joined())
        np.testing.assert_array_equal(of_y, warped.lit)


def squeezed(picture, to_frame, to=0.15):
    """Both eyes with what is between their lids that much lower: skin is pulled down."""
    height, width = picture.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for i in (0, 4):
        lids, ends = to_frame(TRUE[i + 2 : i + 4]), to_frame(TRUE[i : i + 2])
        half = 0.75 * abs(ends[1, 0] - ends[0, 0])
        inside = np.clip((half - abs(x - ends[:, 0].mean())) / (0.3 * half), 0, 1)
        low, up = lids[1, 1] + 1, lids[0, 1] - 1
        above = low - y  # of the lower lid
        open_ = low - up
        source = np.where(above < to * open_, above / to, open_ + (above - to * open_) * 1.0)
        reach = np.clip(2 - above / open_, 0, 1)  # and back to the brow
        moved = np.where((above > 0) & (above < 2 * open_), low - (reach * source + (1 - reach) * above), y)
        y = np.where(inside > 0, inside * moved + (1 - inside) * y, y).astype(np.float32)
    return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize("pose", POSES)
def test_eyes_are_found_wherever_the_face_is(pose):
    (at, odds), _ = found(pose)
    assert (np.hypot(*(at - TRUE).T) / EYES).max() < 0.12
    assert np.all(odds > 1)
    assert np.all(openings(at) > 0.28) and np.all(openings(at) < 0.52), "they are open"


@pytest.mark.parametrize("pose", POSES)
def test_eyes_that_shut_are_followed_in_the_frame(pose):
    before, after = openings(found(pose)[0].at), openings(found(pose, squeezed)[0].at)
    assert np.all(after < 0.6 * before)
    np.testing.assert_allclose(found(pose, squeezed)[0].at[CORNERS], TRUE[CORNERS], atol=0.12 * EYES)


def test_an_eye_that_a_board_covers_is_likely_not_seen_and_the_other_is():
    def covered(picture, to_frame):
        x, y = np.round(to_frame(TRUE[:2].mean(axis=0))).astype(int)
        cells = np.random.default_rng(2).integers(20, 230, (4, 6, 3)).astype(np.uint8)
        picture[y - 12 : y + 12, x - 18 : x + 18] = cv2.resize(cells, (36, 24), interpolation=cv2.INTER_NEAREST)
        return picture

    odds = found(IN_CLIP, covered)[0].odds
    assert np.all(odds[:4] < 0) and np.all(odds[4:] > 0)


def test_eyes_that_are_too_small_are_not_seen():
    small = Pose(120, 110, 0.8 * SMALL * IN_CLIP.side / (head_of(IN_CLIP).scale * EYES))
    assert np.all(found(small)[0].odds < 0)


def test_the_network_for_an_eye_places_lids_and_iris(iris_model):
    iris = Iris(iris_model)
    for pose in POSES:
        _, frame = found(pose)
        lids, irises = iris.measure(frame, head_of(pose), TRUE[CORNERS])
        assert (np.hypot(*(lids - TRUE).T) / EYES).max() < 0.12
        middles = TRUE[CORNERS].reshape(2, 2, 2).mean(axis=1)
        assert (np.hypot(*(irises - middles).T) / EYES).max() < 0.15
    _, frame = found(IN_CLIP, squeezed)
    assert np.all(openings(iris.measure(frame, head_of(IN_CLIP), TRUE[CORNERS])[0]) < 0.7 * openings(TRUE))


# --- nose and mouth

CLIPS = {name: TrackClip(name, 50) for name in ("expressions", "occlusion")}  # in which all parts are visible


def rest_shape():
    """The mean shape (K, 2) in the stabilized image."""
    return load_regression().mean + np.array([LEFT, TOP])


def laid(at, rng):
    """The stabilized image whose parts are at `at` (K, 2) in the frame, as far off as a head is."""
    rest = rest_shape()
    a, b = at - at.mean(axis=0), rest - rest.mean(axis=0)
    scale, turn = np.sqrt((a**2).sum() / (b**2).sum()), change_between(at, rest)[0]
    lies = Similarity(np.zeros(2), scale * np.exp(rng.normal(0, 0.07)), turn + rng.normal(0, 0.05))
    off = rng.normal(0, 0.07 * EYES * scale, 2)
    return lies._replace(centre=at.mean(axis=0) + off - lies.to_frame(rest.mean(axis=0)))


def faces(seed=0, every=7):
    """Stabilized images (160, 160, 3) of real people, and the true places of their parts."""
    rng = np.random.default_rng(seed)
    for clip in CLIPS.values():
        for frame in clip.frames[::every]:
            at = np.array([(row.x, row.y) for row in (clip.truth[frame.index, part] for part in PARTS)])
            lies = laid(at, rng)
            yield lies.read(frame).bgr, lies.to_stabilized(at)


def test_the_channels_and_how_they_are_read_are_what_the_plain_twin_says():
    rng = np.random.default_rng(3)
    noise = rng.integers(0, 256, (7, 8, 3)).astype(np.uint8)
    image = cv2.resize(noise, (31, 26), interpolation=cv2.INTER_CUBIC)
    image[4:9, 20:27] = 0  # flat, and as dark as can be
    seen, plain = channels(image), naive.channels(image.tolist())
    everywhere = np.stack(np.mgrid[:26, :31][::-1], axis=-1, dtype=float).reshape(-1, 2)
    found = image_kernels.read(seen, everywhere, np.zeros((1, 2))).reshape(26, 31, -1)
    np.testing.assert_allclose(found, np.moveaxis(plain, 0, 2), atol=1e-3)
    x = np.array([[12.2, 9.9], [-40.0, 70.0], [30.4, 0.2]])
    for scale in (1.6, 0.8):
        np.testing.assert_allclose(read(seen, x, scale), naive.read(plain, x.tolist(), scale), atol=1e-3)


def test_points_and_eyes_are_placed_and_weighed_as_the_equations_say():
    def descended(x, model):
        for scale, stage in zip(model.scales, model.stages, strict=True):
            x = x + (read(seen, x, scale) @ stage).reshape(-1, 2)
        return x + CORNER

    seen, both, model = face_channels(next(faces())[0]), load_eyes(), load_regression()
    fit = model.placed_from(seen, model.mean + 1.3)
    np.testing.assert_allclose(fit.at, descended(model.mean + 1.3, model), atol=1e-3)
    odds = [read(seen, at[None], ODDS_SCALE) @ model.odds[:, k] for k, at in enumerate(fit.at - CORNER)]
    np.testing.assert_allclose(fit.odds, odds, atol=1e-3)
    np.testing.assert_array_equal(model.visible(seen, fit.at), fit.odds)
    follows = np.append(fit.at - CORNER - both.rest, 1.0) @ both.first
    found = descended(both.mean + follows.reshape(-1, 2), both)
    np.testing.assert_allclose(both.corners(seen, fit.at), found, atol=1e-3)


def test_it_finds_the_points_of_real_faces_from_the_mean_shape():
    model = load_regression()
    assert model.parts == PARTS
    off, before = [], []
    for still, true in faces():
        off.append(np.hypot(*(model.fit(still).at - true).T))
        before.append(np.hypot(*(rest_shape() - true).T))
    off, before = np.array(off) / EYES, np.array(before) / EYES
    assert off.mean() < 0.08 and off.max() < 0.25
    assert off.mean() < 0.6 * before.mean()


def test_what_is_free_is_likely_visible_and_what_a_board_covers_is_not():
    rng, model, free, covered = np.random.default_rng(2), load_regression(), [], []
    for still, true in faces(every=3):
        free.append(model.fit(still).odds)
        x, y = np.round(true[1:].mean(axis=0)).astype(int)  # the middle of the mouth
        still = still.copy()
        board = rng.integers(20, 230, (4, 6, 3)).astype(np.uint8)
        still[y - 18 : y + 32, x - 40 : x + 40] = cv2.resize(board, (80, 50), interpolation=cv2.INTER_NEAREST)
        covered.append(model.fit(still).odds[1:])
    assert np.mean(np.array(free) > 0) > 0.9 and np.median(free) > 1.5
    assert np.mean(np.array(covered) < 0) > 0.9 and np.median(covered) < -2


# --- the landmark network, and sensors with and without it

CORE = [NAMES[part] for part in PARTS]


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
