"""The clips of a head as a box: the ground truth is about the head in the images, and events happen."""

from __future__ import annotations

from itertools import groupby

import cv2
import numpy as np
import pytest

from tests.support.samples import FOLDER, BoxClip, check_init, likeness, read_boxes, read_rows

FRAMES = {"textured": 200, "turning": 220}
INSIDE = 24  # half the side of a patch that lies within the head, in pixels at scale 1


def scale(clip: BoxClip) -> np.ndarray:
    """(T,) of the head, 1 in the first frame."""
    found: np.ndarray = clip.boxes[:, 2] / clip.boxes[0, 2]
    return found


@pytest.fixture(scope="module")
def textured() -> BoxClip:
    return read_boxes("textured")


@pytest.fixture(scope="module")
def turning() -> BoxClip:
    return read_boxes("turning")


@pytest.fixture(params=FRAMES)
def clip(request: pytest.FixtureRequest) -> BoxClip:
    found: BoxClip = request.getfixturevalue(request.param)
    return found


def crop(clip: BoxClip, t: int, half: tuple[int, int] = (32, 36)) -> np.ndarray:
    """The grey head of frame t, without the rim of its box, at scale 1, about the middle of the true box."""
    x, y, s = clip.boxes[t, 0], clip.boxes[t, 1], scale(clip)[t]
    move = np.array([[s, 0, x - s * half[0]], [0, s, y - s * half[1]]])
    size = (2 * half[0] + 1, 2 * half[1] + 1)
    grey = cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY)
    return cv2.warpAffine(grey, move, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def moved_inside(clip: BoxClip, t: int, reach: int = 7) -> np.ndarray:
    """(2,) how far the inside of the head moves from frame t to the next, beyond the ground truth, in pixels."""
    patch = crop(clip, t, (INSIDE, INSIDE))
    score = cv2.matchTemplate(crop(clip, t + 1, (INSIDE + reach, INSIDE + reach)), patch, cv2.TM_CCOEFF_NORMED)
    j, i = np.unravel_index(int(score.argmax()), score.shape)
    return np.array([i - reach, j - reach], dtype=float)


def test_the_files_are_small_and_the_truth_has_a_row_for_each_frame(clip: BoxClip) -> None:
    assert (FOLDER / f"{clip.name}.mp4").stat().st_size < 800_000
    assert clip.pictures.shape == (FRAMES[clip.name], 240, 320, 3)
    rows = read_rows(clip.name)
    expected = [(str(t), f"{t / 25:.2f}", "head", "box") for t in range(FRAMES[clip.name])]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == expected
    assert {r["status"] for r in rows} <= {"visible", "hidden"}


def test_the_box_keeps_its_shape_and_lies_in_the_picture(clip: BoxClip) -> None:
    x, y, w, h = clip.boxes.T
    np.testing.assert_allclose(w / h, w[0] / h[0], rtol=3e-4)
    assert 0.85 <= scale(clip).min() < 0.92 and 1.15 < scale(clip).max() <= 1.25
    assert (x - w / 2).min() > 0 and (x + w / 2).max() < 319 and (y - h / 2).min() > 0 and (y + h / 2).max() < 239
    assert np.ptp(x) > 100


def test_the_init_file_is_the_truth_of_the_first_frame(clip: BoxClip) -> None:
    check_init(clip, "head")
    assert not clip.hidden[0]


def test_the_first_frame_shows_a_face_in_the_middle_of_the_box(clip: BoxClip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    grey = cv2.cvtColor(clip.pictures[0], cv2.COLOR_BGR2GRAY)
    (found,) = cascade.detectMultiScale(grey, 1.05, 12, minSize=(40, 40), maxSize=(100, 100))
    middle = found[:2] + (found[2:] - 1) / 2
    assert np.abs(middle - clip.boxes[0, :2]).max() < 12


def test_the_box_ends_where_the_head_ends_before_the_plain_wall(turning: BoxClip) -> None:
    for t in (0, 6, 12):
        x, y, w, h = turning.boxes[t]
        left, top = round(x - w / 2 - 10), round(y - h / 2 - 10)
        # down to the ears: below them the suit is wider than the head
        part = turning.pictures[t, top : round(y), left : round(x + w / 2 + 10)].astype(float)
        wall = np.median(part[:8].reshape(-1, 3), axis=0)
        differs = np.abs(cv2.GaussianBlur(part, (0, 0), 0.7) - wall).sum(axis=2) > 60
        columns, rows = np.nonzero(differs.any(axis=0))[0], np.nonzero(differs.any(axis=1))[0]
        found = left + columns[0] - 0.5, left + columns[-1] + 0.5, top + rows[0] - 0.5
        assert np.abs(np.array(found) - (x - w / 2, x + w / 2, y - h / 2)).max() < 1.6, t


def test_the_crop_at_the_truth_looks_like_the_first_unless_something_is_before_it(textured: BoxClip) -> None:
    first = crop(textured, 0)
    like = np.array([likeness(crop(textured, t), first) for t in range(len(textured.boxes))])
    free = np.r_[0:110, 152:200]
    assert np.median(like[free]) > 0.85 and like[free].min() > 0.8
    assert like[124:135].max() < 0.8


def test_a_birch_passes_before_a_part_of_the_head(textured: BoxClip) -> None:
    def grey_share(t: int) -> float:
        """Of the crop, what has no colour: the bark, but neither skin nor hair."""
        (x, y), s = textured.boxes[t, :2], scale(textured)[t]
        rows, columns = np.rint([y - 36 * s, y + 36 * s]).astype(int), np.rint([x - 32 * s, x + 32 * s]).astype(int)
        part = textured.pictures[t, slice(*rows), slice(*columns)].astype(int)
        return float((np.ptp(part, axis=2) < 28).mean())

    share = np.array([grey_share(t) for t in range(len(textured.boxes))])
    assert share[np.r_[0:110, 152:200]].max() < 0.1
    assert share[124:135].min() > 0.2 and share.max() < 0.45


def test_no_head_is_ever_more_hidden_than_seen(textured: BoxClip, turning: BoxClip) -> None:
    assert not textured.hidden.any() and not turning.hidden.any()


def test_the_head_moves_from_frame_to_frame_as_the_truth_says(textured: BoxClip) -> None:
    free = [t for t in range(199) if not 112 < t < 150]
    off = np.array([moved_inside(textured, t) for t in free])
    assert np.abs(off).mean() < 0.35
    assert (np.abs(off).max(axis=1) <= 1).mean() > 0.95
    steps = np.linalg.norm(np.diff(textured.boxes[:, :2], axis=0), axis=1)
    assert 6 < steps.max() < 8.5


def test_the_ground_has_edges_everywhere_and_moves_apart_from_the_head(textured: BoxClip) -> None:
    still = 0
    for t in range(0, 199, 6):
        a, b = (cv2.cvtColor(textured.pictures[k], cv2.COLOR_BGR2GRAY)[:44] for k in (t, t + 1))
        edges = np.hypot(cv2.Sobel(a, cv2.CV_32F, 1, 0), cv2.Sobel(a, cv2.CV_32F, 0, 1)) > 60
        # in tiles of the size of an ear, none is plain
        share = cv2.resize(edges.astype(np.float32), (20, 3), interpolation=cv2.INTER_AREA)
        assert np.quantile(share, 0.1) > 0.15
        patch = a[8:36, 20:90] if textured.boxes[t, 0] > 150 else a[8:36, 215:285]
        row = b[:, 10:100] if textured.boxes[t, 0] > 150 else b[:, 205:295]
        score = cv2.matchTemplate(row, patch, cv2.TM_CCOEFF_NORMED)
        j, i = np.unravel_index(int(score.argmax()), score.shape)
        ground = np.array([i - 10, j - 8])
        still += np.abs(ground - np.diff(textured.boxes[t : t + 2, :2], axis=0)[0]).max() < 1
    assert still < 17  # of 34


def test_the_inside_of_the_head_turns_sideways_while_the_box_stays(turning: BoxClip) -> None:
    off = np.array([moved_inside(turning, t) for t in range(219)])
    assert np.abs(off[:, 1]).mean() < 0.3
    assert (off[:, 0] >= 2).sum() > 10 and (off[:, 0] <= -2).sum() > 10
    first = crop(turning, 0)
    like = np.array([likeness(crop(turning, t), first) for t in range(220)])
    # several turns away from what the first frame shows, and back to it in the end
    away = [key for key, _ in groupby(like < 0.5)]
    assert sum(away) >= 4
    assert like[-1] > 0.85


def test_the_camera_jumps_near_frame_60(turning: BoxClip) -> None:
    # the frame of the image on the wall, which moves with the camera alone
    patch = turning.pictures[56, 10:60, 270:310]

    def height(t: int) -> float:
        score = cv2.matchTemplate(turning.pictures[t, :, 180:], patch, cv2.TM_CCOEFF_NORMED)
        return float(np.unravel_index(int(score.argmax()), score.shape)[0])

    wall = np.array([height(t) for t in range(50, 76)])
    assert 25 <= wall[10] - wall[6] <= 30 and 25 <= wall[16] - wall[20] <= 30
    head = turning.boxes[50:76, 1]
    assert 24 < head[10] - head[6] < 31
    np.testing.assert_allclose(np.diff(head), np.diff(wall), atol=1.6)
    steps = np.abs(np.diff(turning.boxes[:, 1]))
    assert steps[np.r_[0:55, 72:219]].max() < 3


def test_the_head_goes_from_the_plain_wall_to_the_books_and_back(turning: BoxClip) -> None:
    def busy(t: int) -> float:
        """The share of pixels with an edge beside and above the head."""
        x, y, w, h = turning.boxes[t]
        left, right, top = round(x - 0.9 * w), round(x + 0.9 * w), round(y - 0.8 * h)
        ring = cv2.cvtColor(turning.pictures[t], cv2.COLOR_BGR2GRAY)[max(top, 0) : round(y), max(left, 0) : right]
        edges = np.hypot(cv2.Sobel(ring, cv2.CV_32F, 1, 0), cv2.Sobel(ring, cv2.CV_32F, 0, 1)) > 60
        edges[:, ring.shape[1] // 4 : -ring.shape[1] // 4] = False
        return float(edges.mean())

    assert max(busy(0), busy(8)) < 0.6 * min(busy(58), busy(70), busy(130), busy(150))


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
@pytest.mark.parametrize(("name", "some"), [("textured", (5, 129)), ("turning", (60, 96))])
def test_rendered_anew_a_few_frames_are_the_committed_ones(
    name: str, some: tuple[int, ...], request: pytest.FixtureRequest
) -> None:
    import heads

    clip: BoxClip = request.getfixturevalue(name)
    stage = getattr(heads, f"{name}_stage")()
    assert len(stage.scale) == len(clip.boxes)
    np.testing.assert_allclose([heads.box(stage, t) for t in range(len(clip.boxes))], clip.boxes, atol=0.0051, rtol=0)
    for t in some:
        drawn = np.clip(heads.render(stage, t) * stage.light[t], 0, 255)
        assert np.abs(drawn - clip.pictures[t]).mean() < 4
    share = np.array([heads.covered(stage, t) for t in (105, 118, 125, 129, 133, 138, 154)])
    assert share[0] == share[-1] == 0
    assert 0.25 < share.max() < 0.35 if name == "textured" else share.max() == 0
