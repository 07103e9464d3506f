"""The clip of gestures before a face: complete, small, true to its images, and the passes are those it tells of."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby, pairwise

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.support.samples import FOLDER, BoxClip, chroma, read_boxes, read_rows

# first and last frame in which more than 2 % of the face's box is covered
PASSES = ((25, 32), (63, 78), (112, 120), (143, 152), (170, 187), (205, 208), (237, 248))


@pytest.fixture(scope="module")
def clip() -> BoxClip:
    return read_boxes("gestures")


def face(clip: BoxClip, t: int) -> np.ndarray:
    """(48, 48) grey face of frame t, cut out and made of one size."""
    x, y, w, h = clip.boxes[t]
    to = np.array([[48 / w, 0, 23.5 - x * 48 / w], [0, 48 / h, 23.5 - y * 48 / h]])
    return cv2.warpAffine(cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY), to, (48, 48))


def alike(clip: BoxClip) -> np.ndarray:
    """(T,) how well each frame's face correlates with the first one's, -1..1, where the ground truth says it is."""
    first = face(clip, 0)[3:-3, 3:-3]
    return np.array([
        cv2.matchTemplate(face(clip, t), first, cv2.TM_CCOEFF_NORMED).max() for t in range(len(clip.boxes))
    ])  # fmt: skip


def test_the_files_are_small_and_the_truth_has_a_row_for_each_frame(clip: BoxClip) -> None:
    assert (FOLDER / "gestures.mp4").stat().st_size < 620_000
    assert clip.pictures.shape == (260, 240, 320, 3)
    rows = read_rows("gestures")
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == [
        (str(t), f"{t / 25:.2f}", "face", "box") for t in range(260)
    ]
    assert {r["status"] for r in rows} == {"visible", "hidden"}


def test_the_init_file_is_the_truth_of_the_first_frame(clip: BoxClip) -> None:
    init = YAML(typ="safe").load((FOLDER / "gestures.init.yaml").read_text(encoding="utf-8"))
    assert init.pop("frame") == 0 and tuple(init) == ("face",)
    x, y, w, h = clip.boxes[0]
    np.testing.assert_allclose(init["face"]["box"], (x - (w - 1) / 2, y - (h - 1) / 2, w, h), atol=0.0051)
    assert not clip.hidden[0]


def test_the_box_is_a_square_in_the_picture_that_moves_and_grows_a_little(clip: BoxClip) -> None:
    low, high = clip.boxes[:, :2] - clip.boxes[:, 2:] / 2, clip.boxes[:, :2] + clip.boxes[:, 2:] / 2
    assert low.min() > 0 and high[:, 0].max() < 319 and high[:, 1].max() < 239
    np.testing.assert_array_equal(clip.boxes[:, 2], clip.boxes[:, 3])
    assert clip.boxes[:, 2].min() > 55 and clip.boxes[:, 2].max() < 70
    assert np.ptp(clip.boxes[:, 2]) > 5 and np.ptp(clip.boxes[:, 0]) > 15
    off = np.abs(clip.boxes[:, 0] - clip.boxes[0, 0]) / clip.boxes[:, 2]
    assert (off > 0.25).mean() > 0.6, "or a box that rests would be as good as a tracker"
    assert np.linalg.norm(np.diff(clip.boxes[:, :2], axis=0), axis=1).max() < 4


def test_the_face_is_hidden_when_both_hands_are_before_it_and_by_one_once(clip: BoxClip) -> None:
    starts = np.cumsum([0, *(len(list(run)) for _, run in groupby(clip.hidden))])
    runs = [(a, b - 1) for a, b in pairwise(starts) if clip.hidden[a]]
    within = [next(i for i, (first, last) in enumerate(PASSES) if first < a and b < last) for a, b in runs]
    assert within == [1, 4, 6]
    assert 8 < runs[1][1] - runs[1][0] < 18


def test_the_face_looks_as_in_the_first_frame_but_for_the_passes(clip: BoxClip) -> None:
    score = alike(clip)
    during = np.zeros(len(score), dtype=bool)
    for first, last in PASSES:
        assert 4 <= last - first + 1 <= 20
        during[first - 3 : last + 4] = True
        assert score[first : last + 1].min() < 0.75
    # a talking mouth and brows that rise leave most of it as it is
    assert score[~during].min() > 0.85
    both = slice(PASSES[4][0], PASSES[4][1])
    assert score[both].min() < 0.25


def test_the_frontal_cascade_finds_the_face_where_the_box_says(clip: BoxClip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    for t in (0, 2, 4, 45, 100, 130, 225):
        found = cascade.detectMultiScale(cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY), 1.05, 5, minSize=(50, 50))
        assert len(found) == 1, f"frame {t}"
        x, y, w, h = (float(v) for v in found[0])
        middle = np.array([x + (w - 1) / 2, y + (h - 1) / 2])
        assert np.linalg.norm(middle - clip.boxes[t, :2]) < 5 and 0.85 < w / clip.boxes[t, 2] < 1.15, f"frame {t}"


def test_the_hands_have_the_colour_of_the_face(clip: BoxClip) -> None:
    first = clip.pictures[0]
    x, y, w, _ = clip.boxes[0]
    skin = chroma(first, x, y + 0.08 * w, 25)
    for at in ((84, 200), (236, 206)):
        assert np.abs(chroma(first, *at, 15) - skin).max() < 5
    for at in ((20, 20), (300, 60), (160, 225)):
        assert np.abs(chroma(first, *at, 15) - skin).max() > 10


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_a_few_frames_are_the_committed_ones(clip: BoxClip) -> None:
    import gestures
    import person_hands
    from person import prove_face

    scene = gestures.scene()
    for t, box in enumerate(clip.boxes):
        np.testing.assert_allclose(box, scene.box(t), atol=0.0051, rtol=0)
    # the hands rest in this frame, so that fewer moments show the same
    picture, layers = person_hands.render(replace(scene, shots=3), 178)
    assert np.abs(np.clip(picture * gestures.LIGHT, 0, 255) - clip.pictures[178]).mean() < 3
    assert person_hands.face_covered(scene.box(178), layers)[2] > 0.95
    prove_face(scene.who, scene.place(178)[1], scene.box(178))
    # both ends of the fastest pass, and which hands are before the face in the middle of each
    for t, covered in ((204, False), (205, True), (209, False)):
        assert (person_hands.face_covered(scene.box(t), scene.layers(t))[2] > 0.02) == covered
    for (first, last), hands in zip(PASSES, ((0,), (1,), (0,), (1,), (0, 1), (0,), (0, 1)), strict=True):
        middle = (first + last) // 2
        shares = person_hands.face_covered(scene.box(middle), scene.layers(middle))
        assert tuple(i for i in (0, 1) if shares[i] > 0.1) == hands
        assert (shares[2] > 0.5) == clip.hidden[middle]
