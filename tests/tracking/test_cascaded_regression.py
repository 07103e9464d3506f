"""The regression that places nose and mouth: channels against their twin, real faces, covers, and its file."""

import cv2
import numpy as np

from facetrack_cli.trackers.face import image_kernels
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
from facetrack_cli.trackers.face.eyes import load_eyes
from facetrack_cli.trackers.face.stabilized import EYES, Similarity, change_between
from tests.support.samples import TrackClip
from tests.twins import cascaded_regression as naive

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
    everywhere = np.moveaxis(np.mgrid[:26, :31][::-1], 0, 2).reshape(-1, 2).astype(float)
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

    seen, eyes, model = face_channels(next(faces())[0]), load_eyes(), load_regression()
    fit = model.placed_from(seen, model.mean + 1.3)
    np.testing.assert_allclose(fit.at, descended(model.mean + 1.3, model), atol=1e-3)
    odds = [read(seen, at[None], ODDS_SCALE) @ model.odds[:, k] for k, at in enumerate(fit.at - CORNER)]
    np.testing.assert_allclose(fit.odds, odds, atol=1e-3)
    np.testing.assert_array_equal(model.visible(seen, fit.at), fit.odds)
    follows = np.append(fit.at - CORNER - eyes.rest, 1.0) @ eyes.first
    found = descended(eyes.mean + follows.reshape(-1, 2), eyes)
    np.testing.assert_allclose(eyes.corners(seen, fit.at), found, atol=1e-3)


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
