"""The clip of a signer: complete, small, true to its images, and as hard as it says."""

from __future__ import annotations

from itertools import groupby

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.support.samples import FOLDER, BoxClip, chroma, read_boxes, read_rows

TARGETS = ("head", "left_hand", "right_hand")
BEFORE_CHEST, BEFORE_FACE = (46, 61, 111, 121), (149, 169, 220, 235)  # the last frame before the hands change sides


@pytest.fixture(scope="module")
def clip() -> BoxClip:
    return read_boxes("signing", len(TARGETS))


def overlaps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) what share of the boxes b (T, 4) the boxes a (T, 4) cover."""
    low = np.maximum(a[:, :2] - a[:, 2:] / 2, b[:, :2] - b[:, 2:] / 2)
    high = np.minimum(a[:, :2] + a[:, 2:] / 2, b[:, :2] + b[:, 2:] / 2)
    share: np.ndarray = np.clip(high - low, 0, None).prod(axis=1) / b[:, 2:].prod(axis=1)
    return share


def test_the_files_are_small_and_the_truth_has_a_row_for_each_frame_and_target(clip: BoxClip) -> None:
    assert (FOLDER / "signing.mp4").stat().st_size < 620_000
    assert clip.pictures.shape == (250, 240, 320, 3)
    rows = read_rows("signing")
    expected = [(str(t), f"{t / 25:.2f}", target, "box") for t in range(250) for target in TARGETS]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == expected
    assert {r["status"] for r in rows} == {"visible", "hidden"}


def test_the_init_file_is_the_truth_of_the_first_frame(clip: BoxClip) -> None:
    init = YAML(typ="safe").load((FOLDER / "signing.init.yaml").read_text(encoding="utf-8"))
    assert init.pop("frame") == 0 and tuple(init) == TARGETS
    for target, (x, y, w, h) in zip(TARGETS, clip.boxes[0], strict=True):
        np.testing.assert_allclose(init[target]["box"], (x - (w - 1) / 2, y - (h - 1) / 2, w, h), atol=0.0051)
    assert not clip.hidden[0].any()
    assert clip.boxes[0, 1, 0] < clip.boxes[0, 0, 0] < clip.boxes[0, 2, 0]


def test_the_boxes_lie_in_the_picture_and_keep_their_shape(clip: BoxClip) -> None:
    low, high = clip.boxes[..., :2] - clip.boxes[..., 2:] / 2, clip.boxes[..., :2] + clip.boxes[..., 2:] / 2
    assert low.min() > 0 and high[..., 0].max() < 319 and high[..., 1].max() < 239
    np.testing.assert_allclose(clip.boxes[:, 0, 2], clip.boxes[:, 0, 3])
    np.testing.assert_allclose(clip.boxes[:, 1:, 2] / clip.boxes[:, 1:, 3], 60 / 72, atol=3e-4)
    assert clip.boxes[:, 0, 2].min() > 45 and clip.boxes[:, 0, 2].max() < 55


def test_the_hands_are_fast_and_the_head_is_not(clip: BoxClip) -> None:
    steps = np.linalg.norm(np.diff(clip.boxes[..., :2], axis=0), axis=2)
    assert 10 < steps[:, 1:].max() <= 12 and np.median(steps[:, 1:]) > 4
    assert steps[:, 0].max() < 3
    # erratic: at a speed that counts, the way turns by more than a right angle many times
    for way in np.diff(clip.boxes[:, 1:, :2], axis=0).transpose(1, 0, 2):
        turns = (way[3:] * way[:-3]).sum(axis=1) < 0
        assert sum(1 for turned, _ in groupby(turns) if turned) > 12


def test_the_hands_cross_before_the_chest_twice_and_then_before_the_face_twice(clip: BoxClip) -> None:
    head, left, right = clip.boxes.transpose(1, 0, 2)
    side = np.sign(left[:, 0] - right[:, 0])
    # each time over and back
    assert tuple(np.flatnonzero(np.diff(side))) == (*BEFORE_CHEST, *BEFORE_FACE)
    assert side[0] == side[-1] == -1
    for t in BEFORE_CHEST:
        assert overlaps(left, right)[t : t + 2].max() > 0.5
        assert overlaps(left, head)[t] == overlaps(right, head)[t] == 0
    for t in BEFORE_FACE:
        assert t > 125
        assert overlaps(left, head)[t] > 0.5 and overlaps(right, head)[t] > 0.5


def test_the_right_hand_passes_over_the_face_alone_before_that(clip: BoxClip) -> None:
    head, left, right = clip.boxes[:130].transpose(1, 0, 2)
    over = overlaps(right, head)
    assert overlaps(left, head).max() == 0
    inside = over > 0.3
    offset = (right[:, 0] - head[:, 0])[inside]
    assert over.max() > 0.8 and offset.min() < -15 and offset.max() > 15


def test_the_head_is_hidden_four_times_and_a_hand_at_crossings_only(clip: BoxClip) -> None:
    runs = [(bool(key), len(list(run))) for key, run in groupby(clip.hidden[:, 0])]
    assert [n for key, n in runs if key] and all(3 <= n <= 12 for key, n in runs if key)
    assert sum(key for key, _ in runs) == 4
    hands = np.flatnonzero(clip.hidden[:, 1:].any(axis=1))
    assert len(hands) and all(min(abs(t - c) for c in (*BEFORE_CHEST, *BEFORE_FACE)) <= 5 for t in hands)
    # the left hand is in front first, the right one later
    assert not clip.hidden[:131, 1].any() and not clip.hidden[131:, 2].any()


def test_hands_and_face_have_the_same_colour_and_clothes_and_ground_another(clip: BoxClip) -> None:
    for t in (0, 30, 190, 249):
        head, left, right = clip.boxes[t]
        face = chroma(clip.pictures[t], head[0], head[1] + 4, 21)
        for x, y, *_ in (left, right):
            assert np.abs(chroma(clip.pictures[t], x, y + 8, 13) - face).max() < 5
        for x, y in ((20, 20), (300, 60), (160, 225)):
            assert np.abs(chroma(clip.pictures[t], x, y, 15) - face).max() > 10


def test_the_frontal_cascade_finds_the_face_where_the_box_says(clip: BoxClip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    for t in (0, 2, 4, 30, 76, 128, 195):
        found = cascade.detectMultiScale(cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY), 1.05, 5, minSize=(40, 40))
        assert len(found) == 1, f"frame {t}"
        x, y, w, h = found[0]
        box = np.array([[x + (w - 1) / 2, y + (h - 1) / 2, w, h]])
        assert overlaps(box, clip.boxes[t : t + 1, 0])[0] > 0.8, f"frame {t}"
        assert overlaps(clip.boxes[t : t + 1, 0], box)[0] > 0.75, f"frame {t}"


def test_the_picture_moves_as_the_truth_says(clip: BoxClip) -> None:
    errors = []
    for t in range(len(clip.boxes) - 1):
        for i in (1, 2):
            others = [j for j in range(3) if j != i]
            if any(overlaps(clip.boxes[t : t + 2, j], clip.boxes[t : t + 2, i]).max() > 0 for j in others):
                continue
            # the back of the hand, a little below the middle of the box
            (x, y), (to_x, to_y) = clip.boxes[t, i, :2] + (0, 8), clip.boxes[t + 1, i, :2] + (0, 8)
            patch = cv2.getRectSubPix(clip.pictures[t], (17, 17), (float(x), float(y)))
            about = cv2.getRectSubPix(clip.pictures[t + 1], (29, 29), (float(to_x), float(to_y)))
            at = np.unravel_index(int((score := cv2.matchTemplate(about, patch, cv2.TM_SQDIFF)).argmin()), score.shape)
            errors.append(np.hypot(at[0] - 6, at[1] - 6))
    assert len(errors) > 200
    assert np.mean(np.array(errors) <= 1.5) > 0.95


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_a_few_frames_are_the_committed_ones(clip: BoxClip) -> None:
    import person_hands
    import signing
    from person import prove_face

    scene = signing.scene()
    for t, (head, left, right) in enumerate(clip.boxes):
        np.testing.assert_allclose(head, scene.box(t), atol=0.0051, rtol=0)
        for pose, box in zip(scene.poses(t), (left, right), strict=True):
            np.testing.assert_allclose(box, person_hands.hand_box(pose), atol=0.0051, rtol=0)
    for t in (20, 149):
        picture, layers = person_hands.render(scene, t)
        drawn = np.clip(picture * signing.LIGHT, 0, 255)
        assert np.abs(drawn - clip.pictures[t]).mean() < 3
        prove_face(scene.who, scene.place(t)[1], scene.box(t))
        for pose, layer in zip(scene.poses(t), layers, strict=True):
            person_hands.prove_hand(pose, layer, person_hands.hand_box(pose))
        shares = person_hands.hand_covered(layers, int(scene.front[t]))
        assert [share > 0.5 for share in shares] == list(clip.hidden[t, 1:])
        assert (person_hands.face_covered(scene.box(t), layers)[2] > 0.5) == clip.hidden[t, 0]
