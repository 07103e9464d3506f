"""The clips of a face that is covered: the ground truth is about the face in the images, and events happen."""

from __future__ import annotations

from itertools import groupby

import cv2
import numpy as np
import pytest

from tests.support.samples import BoxClip, check_files, check_init, likeness, read_boxes

FRAMES = {"map": 250, "passerby": 240}
# spans of frames in which more than half of the face is covered, and frames in which all of it is
HIDDEN = {"map": ((40, 72), (120, 144), (196, 233)), "passerby": ((71, 93), (192, 198))}
WHOLLY = {"map": ((46, 66), (124, 141), (204, 229)), "passerby": ((81, 85), (195, 195))}
MODULES = {"map": "faces_map", "passerby": "faces_passerby"}
SKIN = np.array([147.0, 110.0])  # Cr, Cb of the face


def bare(clip: BoxClip) -> list[int]:
    """Frames in which nothing is before the face, and in the next one neither."""
    away = 14 if clip.name == "map" else 18
    return [t for t in range(len(clip.boxes) - 1) if all(t < a - away or t > b + away for a, b in HIDDEN[clip.name])]


@pytest.fixture(scope="module", params=FRAMES)
def clip(request: pytest.FixtureRequest) -> BoxClip:
    return read_boxes(request.param)


def crop(clip: BoxClip, t: int, half: int = 20) -> np.ndarray:
    """The grey face of frame t at the size of frame 0, about the middle of its box."""
    (x, y), s = clip.boxes[t, :2], clip.boxes[t, 2] / clip.boxes[0, 2]
    move = np.array([[s, 0, x - s * half], [0, s, y - s * half]])
    grey = cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY)
    side = 2 * half + 1
    return cv2.warpAffine(grey, move, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def skin(picture: np.ndarray) -> np.ndarray:
    """(H, W) where the colours are near those of the face."""
    chroma = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_BGR2YCrCb), (0, 0), 1.0).astype(float)
    return np.asarray((np.abs(chroma[..., 1:] - SKIN).max(axis=2) < 9) & (chroma[..., 0] > 80))


def within(clip: BoxClip, t: int, grow: float = 1.0) -> np.ndarray:
    """(H, W) where the box of frame t is, made larger by `grow`."""
    y, x = np.mgrid[:240, :320]
    bx, by, w, h = clip.boxes[t]
    return np.asarray((np.abs(x - bx) < grow * w / 2) & (np.abs(y - by) < grow * h / 2))


def test_the_files_are_small_and_the_truth_has_a_row_for_each_frame(clip: BoxClip) -> None:
    check_files(clip, FRAMES[clip.name])


def test_the_init_file_is_the_truth_of_the_first_frame(clip: BoxClip) -> None:
    check_init(clip)


def test_a_box_that_rests_is_off_the_face_in_much_of_the_clip(clip: BoxClip) -> None:
    """Or the clip could not tell a tracker from a resting box."""
    off = np.abs(clip.boxes[:, :2] - clip.boxes[0, :2]).max(axis=1) / clip.boxes[:, 2]
    assert (off > 0.5).mean() > 0.35 and (off > 0.25).mean() > 0.6


def test_the_box_is_a_square_of_a_small_face_and_does_not_jump(clip: BoxClip) -> None:
    x, y, w, h = clip.boxes.T
    np.testing.assert_array_equal(w, h)
    assert w.min() > 54 and w.max() < 62
    assert (x - w / 2).min() > 40 and (x + w / 2).max() < 280 and (y - h / 2).min() > 30 and (y + h / 2).max() < 160
    steps = np.linalg.norm(np.diff(clip.boxes[:, :2], axis=0), axis=1)
    low, high = (6, 9) if clip.name == "map" else (3, 5)
    assert low < steps.max() < high


def test_the_frontal_cascade_finds_the_face_in_the_box_while_it_is_bare(clip: BoxClip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    found, off = 0, []
    frames = bare(clip)[::5]
    for t in frames:
        grey = cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY)
        boxes = cascade.detectMultiScale(grey, 1.05, 5, minSize=(44, 44), maxSize=(76, 76))
        near = [(bx + (bw - 1) / 2, by + (bh - 1) / 2, bw) - clip.boxes[t, :3] for bx, by, bw, bh in boxes]
        near = [d for d in near if np.abs(d).max() < 15]
        found += bool(near)
        off += near[:1]
    assert frames[0] == 0 and found > 0.9 * len(frames)
    assert np.abs(np.median(off, axis=0)).max() < 3
    assert np.median(np.abs(off), axis=0).max() < 5


def test_the_crop_at_the_truth_looks_like_the_first_unless_something_is_before_it(clip: BoxClip) -> None:
    first = crop(clip, 0)
    like = np.array([likeness(crop(clip, t), first) for t in range(len(clip.boxes))])
    # the mouth opens and shuts
    assert np.median(like[bare(clip)]) > 0.75 and like[bare(clip)].min() > 0.55
    for a, b in WHOLLY[clip.name]:
        assert like[a : b + 1].max() < 0.35


def test_the_face_moves_from_frame_to_frame_as_the_truth_says(clip: BoxClip) -> None:
    off = []
    for t in bare(clip):
        score = cv2.matchTemplate(crop(clip, t + 1, 26), crop(clip, t), cv2.TM_CCOEFF_NORMED)
        j, i = np.unravel_index(int(score.argmax()), score.shape)
        off.append((i - 6, j - 6))
    assert len(off) > 60
    assert (np.abs(off).max(axis=1) <= 1).mean() > 0.97
    assert np.abs(np.mean(off, axis=0)).max() < 0.15


def test_it_is_hidden_when_something_covers_it_and_only_then(clip: BoxClip) -> None:
    runs, first = [], 0
    for key, run in groupby(clip.hidden):
        last = first + len(list(run)) - 1
        runs += [(first, last)] if key else []
        first = last + 1
    assert tuple(runs) == HIDDEN[clip.name]


def test_the_wall_has_other_colours_than_skin(clip: BoxClip) -> None:
    share = skin(clip.pictures[0])
    assert share[within(clip, 0)].mean() > 0.4
    assert share[:30].mean() < 0.01 and share[:160, :70].mean() < 0.01 and share[:160, 250:].mean() < 0.01


def test_behind_the_map_there_is_no_skin_but_two_hands_beside_it() -> None:
    clip = read_boxes("map")
    boxes = clip.boxes
    for a, b in WHOLLY["map"]:
        for t in range(a, b + 1, 4):
            is_skin = skin(clip.pictures[t])
            assert is_skin[within(clip, t, 0.9)].mean() < 0.15, t
            x = round(boxes[t, 0])
            # each hand, within two widths of the face
            near = is_skin & within(clip, t, 3.2)
            assert near[:, : x - 26].sum() > 900 and near[:, x + 26 :].sum() > 900, t
    # and the hands never leave the image: what is skin beside the face
    beside = [(skin(p) & ~within(clip, t, 1.7)).sum() for t, p in enumerate(clip.pictures)]
    assert min(beside) > 1000


def test_the_map_comes_from_below_from_the_left_and_from_the_right() -> None:
    clip = read_boxes("map")
    pictures = clip.pictures

    def pale(t: int) -> tuple[float, float]:
        """The middle of what is nearly white, the paper: from the face's middle along x, in the image along y."""
        paper = (pictures[t].min(axis=2) > 165) & (np.ptp(pictures[t].astype(int), axis=2) < 40)
        y, x = np.nonzero(cv2.erode(paper.astype(np.uint8), np.ones((2, 2), np.uint8)))
        return float(np.median(x) - clip.boxes[t, 0]), float(np.median(y))

    below, left, right = pale(30), pale(115), pale(186)
    assert below[1] > 180 and abs(below[0]) < 35
    assert left[0] < -70 and left[1] < 130
    assert right[0] > 60 and right[1] < 130
    # quickly from the left, slowly from the right
    assert pale(122)[0] - pale(118)[0] > 40 and pale(190)[0] - pale(194)[0] < 30


def test_who_passes_has_a_face_of_about_the_same_size_and_colour() -> None:
    clip = read_boxes("passerby")
    pictures = clip.pictures
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    seen = []
    for t in (46, 50, 56, 60, 100, 103, 106):
        boxes = cascade.detectMultiScale(cv2.cvtColor(pictures[t], cv2.COLOR_BGR2GRAY), 1.05, 4, minSize=(44, 44))
        for x, y, w, h in boxes:
            if abs(x + w / 2 - clip.boxes[t, 0]) > 45 and w < 90:
                part = pictures[t, y + h // 2 : y + 3 * h // 4, x + w // 4 : x + 3 * w // 4]
                seen.append((w, *cv2.cvtColor(part, cv2.COLOR_BGR2YCrCb).reshape(-1, 3).mean(axis=0)[1:]))
    assert len(seen) >= 3
    side, cr, cb = np.median(seen, axis=0)
    assert 55 < side < 78
    assert np.abs(np.array([cr, cb]) - SKIN).max() < 7


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_a_few_frames_are_the_committed_ones(clip: BoxClip) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[samples]'")
    import faces

    module = __import__(MODULES[clip.name])
    scene = getattr(module, f"{clip.name}_scene")()
    stage = scene.stage
    assert len(stage.scale) == len(clip.boxes)
    boxes = [faces.face_box(stage, t) for t in range(len(clip.boxes))]
    np.testing.assert_allclose(boxes, clip.boxes, atol=0.0051, rtol=0)
    (first, last), *_ = HIDDEN[clip.name]
    whole = WHOLLY[clip.name][1][0]
    for t, least, most in ((5, 0.0, 0.0), (first - 1, 0.2, 0.5), (first, 0.5, 0.8), (whole, 0.95, 1.0)):
        before = scene.things(t)
        assert least <= faces.covered(boxes[t], before) <= most, t
        if t in (5, whole):
            drawn = faces.draw(stage, t, before, module.SOFT, module.DARK) * stage.light[t]
            assert np.abs(np.clip(drawn, 0, 255) - clip.pictures[t]).mean() < 4
    assert faces.covered(boxes[last + 1], scene.things(last + 1)) < 0.5
