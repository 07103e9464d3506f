"""The regression that places eyes: a real face in many poses, lids that shut, covers, small faces, and its file."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Frame, Planes
from facetrack_cli.trackers.face import image_kernels
from facetrack_cli.trackers.face.cascaded_regression import face_channels, load_regression
from facetrack_cli.trackers.face.eyes import CORNERS, POINTS, SMALL, load_eyes, openings
from facetrack_cli.trackers.face.mesh import Iris
from facetrack_cli.trackers.face.stabilized import EYES
from facetrack_cli.video.decode import _to_bt601
from tests.support import moving_face as moving
from tests.support.fake_mesh import _AT, IN_CLIP, head_of
from tests.support.moving_face import Pose
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
