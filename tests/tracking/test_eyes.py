"""The regressions that place eyes, nose and mouth: real faces, lids that shut, covers, channels, and their files."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Frame
from facetrack_cli.trackers.face import image_kernels
from facetrack_cli.trackers.face.cascaded_regression import LEFT, TOP, channels, face_channels, load_regression, read
from facetrack_cli.trackers.face.eyes import CORNERS, POINTS, SMALL, load_eyes, openings
from facetrack_cli.trackers.face.mesh import Iris
from facetrack_cli.trackers.face.stabilized import EYES, Similarity, change_between
from tests.support import moving_face as moving
from tests.support.fake_mesh import _AT, IN_CLIP, head_of
from tests.support.moving_face import Pose
from tests.support.samples import TrackClip
from tests.twins import cascaded_regression as naive

TRUE = np.array([_AT[point] for point in POINTS], float)  # in the stabilized image
POSES = [IN_CLIP, Pose(120, 110, 60), Pose(180, 125, 130, 12), Pose(160, 120, 90, -20)]


def found(pose, change=lambda picture, to_frame: picture):
    """What the regression says of a frame that is changed, and what is in that frame."""
    [frame] = moving.clip([pose])
    head = head_of(pose)
    frame = Frame(0, 0.0, change(frame.bgr.copy(), head.to_frame))
    still = head.read(frame).bgr
    return load_eyes().fit(frame, head, face_channels(still), load_regression().fit(still).at), frame


def test_patches_are_read_as_opencv_reads_them_and_their_channels_are_what_the_plain_twin_says():
    rng = np.random.default_rng(4)
    image = cv2.resize(rng.integers(0, 256, (9, 11), dtype=np.uint8), (60, 50), interpolation=cv2.INTER_CUBIC)
    maps, out = np.array([[0.9, 0.3, -7.3, 2.2], [-1.7, 1.4, 40.0, 9.6]]), np.empty((2, 26, 26), np.uint8)
    image_kernels.warp(image, maps, out)
    for (a, b, u, v), patch in zip(maps, out, strict=True):
        there = warp_affine(image, np.array([[a, -b, u], [b, a, v]]), (26, 26), cv2.BORDER_REPLICATE, inverse=True)
        np.testing.assert_array_equal(patch, there)
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
    image_kernels.warp(image, np.array([[a, b, u, v]]), out := np.empty((1, 12, 12), np.uint8))
    matrix = np.array([[a, -b, u], [b, a, v]])
    there = warp_affine(image, matrix, (12, 12), cv2.BORDER_REPLICATE, inverse=True)
    np.testing.assert_array_equal(out[0], there)


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

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
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
