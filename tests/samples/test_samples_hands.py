"""The clip of two hands: complete, small, true to its images, and as hard as it says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.support.samples import FOLDER, BoxClip, read_boxes, read_rows

TARGETS = ("left_hand", "right_hand")
CROSSINGS = (106, 150, 205, 235)  # the last frame before the hands change sides


@pytest.fixture(scope="module")
def clip() -> BoxClip:
    video = cv2.VideoCapture(str(FOLDER / "hands.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == 25
    video.release()
    return read_boxes("hands", len(TARGETS))


def overlap(boxes: np.ndarray) -> np.ndarray:
    """(T,) intersection over union of the two boxes (T, 2, 4)."""
    low, high = boxes[..., :2] - boxes[..., 2:] / 2, boxes[..., :2] + boxes[..., 2:] / 2
    both = np.clip(high.min(axis=1) - low.max(axis=1), 0, None).prod(axis=1)
    return both / (boxes[..., 2:].prod(axis=2).sum(axis=1) - both)


def colours(picture: np.ndarray, x: float, y: float, w: float, h: float) -> np.ndarray:
    """The hue-saturation histogram of the box about (x, y), 8 x 8 bins, of sum 1."""
    left, top = round(x - w / 2), round(y - h / 2)
    part = cv2.cvtColor(picture[top : top + round(h), left : left + round(w)], cv2.COLOR_BGR2HSV)
    counts = cv2.calcHist([part], [0, 1], None, [8, 8], [0, 180, 0, 256])
    return counts / counts.sum()


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Bhattacharyya's distance: 0 the same, 1 nothing in common."""
    return float(np.sqrt(max(0.0, 1.0 - np.sqrt(a * b).sum())))


def test_the_files_are_small_and_the_truth_has_a_row_for_each_frame_and_hand(clip: BoxClip) -> None:
    assert (FOLDER / "hands.mp4").stat().st_size < 620_000
    assert clip.pictures.shape == (250, 240, 320, 3)
    rows = read_rows("hands")
    expected = [(str(t), f"{t / 25:.2f}", target, "box") for t in range(250) for target in TARGETS]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == expected
    assert {r["status"] for r in rows} == {"visible", "hidden"}


def test_the_init_file_is_the_truth_of_the_first_frame(clip: BoxClip) -> None:
    init = YAML(typ="safe").load((FOLDER / "hands.init.yaml").read_text(encoding="utf-8"))
    assert init.pop("frame") == 0 and tuple(init) == TARGETS
    for target, (x, y, w, h) in zip(TARGETS, clip.boxes[0], strict=True):
        np.testing.assert_allclose(init[target]["box"], (x - (w - 1) / 2, y - (h - 1) / 2, w, h), atol=0.0051)
    assert not clip.hidden[0].any()


def test_the_boxes_lie_in_the_picture_keep_their_shape_and_do_not_jump(clip: BoxClip) -> None:
    low, high = clip.boxes[..., :2] - clip.boxes[..., 2:] / 2, clip.boxes[..., :2] + clip.boxes[..., 2:] / 2
    assert low.min() > 0 and high[..., 0].max() < 319 and high[..., 1].max() < 239
    np.testing.assert_allclose(clip.boxes[..., 2] / clip.boxes[..., 3], 56 / 64, atol=3e-4)
    scale = clip.boxes[..., 2] / 56
    assert 0.85 < scale.min() < 0.92 and 1.1 < scale.max() < 1.2
    assert np.abs(np.diff(scale, axis=0)).max() < 0.03
    steps = np.linalg.norm(np.diff(clip.boxes[..., :2], axis=0), axis=2)
    assert 8 < steps.max() < 10 and np.median(steps) < 5


def test_the_hands_cross_four_times_and_each_is_hidden_at_some(clip: BoxClip) -> None:
    side = np.sign(clip.boxes[:, 0, 0] - clip.boxes[:, 1, 0])
    assert tuple(np.flatnonzero(np.diff(side))) == CROSSINGS
    assert side[0] == side[-1] == -1
    over = overlap(clip.boxes)
    for t in CROSSINGS:
        assert over[t : t + 2].max() > 0.25
    # they also meet without crossing
    assert 0.01 < over[170:190].max() < 0.4
    hidden = np.flatnonzero(clip.hidden.any(axis=1))
    assert all(min(abs(t - c) for c in CROSSINGS) <= 4 for t in hidden)
    assert not clip.hidden.all(axis=1).any()
    # the right hand is under the left one at first, and over it later
    assert clip.hidden[:164, 1].any() and clip.hidden[164:, 0].any()
    assert not clip.hidden[:164, 0].any() and not clip.hidden[164:, 1].any()


def test_they_wave_to_the_same_side_at_once(clip: BoxClip) -> None:
    left, right = np.diff(clip.boxes[52:88, :, 0], axis=0).T
    assert np.corrcoef(left, right)[0, 1] > 0.8


def test_the_hands_have_the_same_colours_and_most_of_the_ground_has_others(clip: BoxClip) -> None:
    picture = clip.pictures[0]
    palms = [colours(picture, x, y + 8, 24, 24) for x, y, *_ in clip.boxes[0]]
    assert apart(*palms) < 0.25
    away = [
        min(apart(palm, colours(picture, x, y, 24, 24)) for palm in palms)
        for y in range(12, 228, 16)
        for x in range(12, 308, 16)
        if (np.abs(clip.boxes[0, :, :2] - (x, y)) > (48, 52)).any(axis=1).all()
    ]
    assert len(away) > 100
    assert np.median(away) > 0.6
    # and some of it similar ones
    assert 0.25 < min(away) < 0.5
    whole = [colours(picture, *box) for box in clip.boxes[0]]
    bare = [colours(picture, x, y, 56, 64) for x, y in ((160, 40), (160, 190), (290, 150), (30, 205))]
    assert apart(*whole) < min(apart(hand, ground) for hand in whole for ground in bare)


def test_the_picture_moves_as_the_truth_says(clip: BoxClip) -> None:
    errors = []
    for t, apart_x in enumerate(np.abs(clip.boxes[:-1, 0, 0] - clip.boxes[:-1, 1, 0])):
        for i in range(2):
            if apart_x < 85 or clip.hidden[t : t + 2].any():
                continue
            # the back of the hand, a little below the middle of the box
            (x, y), (to_x, to_y) = clip.boxes[t, i, :2] + (0, 8), clip.boxes[t + 1, i, :2] + (0, 8)
            patch = cv2.getRectSubPix(clip.pictures[t], (17, 17), (float(x), float(y)))
            about = cv2.getRectSubPix(clip.pictures[t + 1], (29, 29), (float(to_x), float(to_y)))
            score = cv2.matchTemplate(about, patch, cv2.TM_SQDIFF)
            at = np.unravel_index(int(score.argmin()), score.shape)
            errors.append(np.hypot(at[0] - 6, at[1] - 6))
    assert len(errors) > 250
    assert np.mean(np.array(errors) <= 1) > 0.97


def test_the_camera_moves(clip: BoxClip) -> None:
    # a print on the desk that no hand covers in these frames, found again elsewhere
    first = clip.pictures[0][160:200, 150:180]
    shifts = []
    for t in (0, 26, 52, 84):
        score = cv2.matchTemplate(clip.pictures[t][120:239, 90:240], first, cv2.TM_CCOEFF_NORMED)
        assert score.max() > 0.6
        shifts.append(np.unravel_index(int(score.argmax()), score.shape))
    assert np.ptp(np.array(shifts), axis=0).max() > 20


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_a_few_frames_are_the_committed_ones(clip: BoxClip) -> None:
    import hands
    from hands_model import BOX

    moments, ground, movable, skin = hands.moments(), hands.desk(), hands.things(), hands.skin()
    assert len(moments) == len(clip.pictures)
    for t, m in enumerate(moments):
        for pose, box in zip(m.hands, clip.boxes[t], strict=True):
            expected = (pose.x, pose.y, BOX[0] * pose.scale, BOX[1] * pose.scale)
            np.testing.assert_allclose(box, expected, atol=0.0051, rtol=0)
    proof = hands.Proof(skin)
    for t in (20, 107, 205):
        picture, layers = hands.compose(moments[t], ground, movable, skin)
        assert np.abs(np.clip(picture, 0, 255) - clip.pictures[t]).mean() < 5
        for pose, layer in zip(moments[t].hands, layers, strict=True):
            proof.hold(pose, layer)
        shares = hands.covered(moments[t], layers)
        assert [share > 0.5 for share in shares] == list(clip.hidden[t])
