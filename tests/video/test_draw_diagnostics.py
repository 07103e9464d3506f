"""The overlay of a tracker that adapts: parallelograms, names in doubt, and images in the corners."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from facetrack_cli.core.types import Array, Frame, Image
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.video.overlay.labels import Insets, Rect, Shown, adaptation
from facetrack_cli.video.overlay.marks import Font
from facetrack_cli.video.overlay.overlay import Overlay
from tests.support import results
from tests.support.results import target
from tests.video.test_draw import around, part, result, touched

Pictures = tuple[tuple[str, Image], ...]
SIZES = [(320, 240), (1280, 720), (3840, 2160), (240, 320)]
# two halves, so that up and down, left and right can be told
S: Image = np.repeat(np.array([[40, 250]], np.uint8), 30, axis=0).repeat(13, axis=1)
PICTURES = (("S", S), ("W", np.full((30, 26), 90, np.uint8)))


def quad(*corners: tuple[float, float]) -> Array:
    return np.array(corners, np.float64)


def named(who: str | None, sure: float | None, insets: Pictures = (), at: tuple[int, int] = (200, 150)) -> FrameResult:
    one = target("face", [part("box", *at, w=60, h=60, cov=None)], 77, None, who, sure, insets=insets)
    return results.result(Frame(0, 0.0, np.full((240, 320, 3), 128, np.uint8)), [one])


# --- windows ---


def test_a_part_with_corners_is_drawn_as_its_parallelogram() -> None:
    corners = quad((60, 60), (140, 90), (150, 150), (70, 120))
    one = part("box", 105, 105, w=85, h=61, cov=(0, 0, 0), corners=corners)
    drawn = touched(Overlay((200, 200)).draw(result((200, 200), one, spread=0.0)))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        for share in (0.1, 0.5, 0.9):
            assert around(drawn, *(a + share * (b - a)), 1).any()
    assert not around(drawn, 147, 75, 2).any(), "nothing is left of the box around it"
    assert not around(drawn, 105 - 42, 105 + 30, 3).any()


# --- names ---


def above(shown: FrameResult) -> Image:
    """What is drawn above the window at (200, 150)."""
    return Overlay((320, 240)).draw(shown)[90:118, 130:270]


def test_a_name_that_is_in_doubt_is_pale_and_has_a_question_mark() -> None:
    sure, unsure, plain = (above(named("anna", p)) for p in (0.93, 0.43, None))
    assert (touched(sure).any(axis=0).sum()) < touched(unsure).any(axis=0).sum(), "one sign more"
    colours = [int(np.ptp(image.astype(int), axis=2).max()) for image in (sure, unsure, plain)]
    assert colours[0] > 100 and colours[2] > 100, "in the target's colour"
    assert colours[1] < 40, "grey"
    assert not touched(above(named(None, None))).any()


# --- images in the corners ---


def where(image: Image) -> list[tuple[int, int]]:
    """The quarters of the image in which anything differs from the grey ground: (row, column), 0 or 1."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    drawn = touched(image)
    return [(r, c) for r in (0, 1) for c in (0, 1) if drawn[r * height :, c * width :][:height, :width].any()]


def insets(size: tuple[int, int]) -> Insets:
    return Insets(size, 20, 1, Font(8))


def lay(them: Insets, size: tuple[int, int], windows: list[Rect], *names: str) -> tuple[Image, list[Rect]]:
    image = np.full((size[1], size[0], 3), 128, np.uint8)
    shown = [Shown(name, PICTURES, (255, 0, 0)) for name in names or ("face",)]
    return image, them.draw(image, shown, windows)


@pytest.mark.parametrize("size", SIZES)
def test_pictures_stand_in_a_corner_legibly_and_in_their_order(size: tuple[int, int]) -> None:
    image, (box,) = lay(insets(size), size, [])
    x0, y0, x1, y1 = map(int, box)
    assert x0 >= 0 and y1 <= size[1] and not touched(image[: y0 - 1]).any() and not touched(image[:, x1 + 1 :]).any()
    assert y1 - y0 >= 36 and 0.1 * size[1] <= y1 - y0 <= 0.3 * size[1] and x1 - x0 <= 0.45 * size[0]
    row = image[(3 * y0 + 5 * y1) // 8, x0:x1, 0].astype(int)  # below the names
    quarter = (x1 - x0) // 8
    assert abs(row[quarter] - 40) < 12 and abs(row[3 * quarter] - 250) < 12, "S"
    assert abs(row[6 * quarter] - 90) < 3, "W"


def test_they_go_where_no_window_is_and_stay_there() -> None:
    size = (320, 240)
    them = insets(size)
    _, (first,) = lay(them, size, [])
    assert first[0] < 10 and first[3] > 230, "lower left, if all is free"
    left = (0.0, 150.0, 100.0, 240.0)
    places = [lay(them, size, [left])[1][0] for _ in range(40)]
    moves = [i for i, (a, b) in enumerate(itertools.pairwise(places)) if a != b]
    assert len(moves) == 1, "it moves once"
    assert not (places[-1][0] < left[2] and places[-1][3] > left[1])
    assert all(lay(them, size, [])[1] == [places[-1]] for _ in range(40)), "and not back for nothing"


def test_a_window_that_shakes_at_a_border_does_not_chase_them() -> None:
    size = (320, 240)
    them = insets(size)
    places = []
    for i in range(200):
        reach = 88.0 if i % 2 else 80.0
        places.append(lay(them, size, [(0.0, 150.0, reach, 240.0), (230.0, 150.0, 320.0, 240.0)])[1][0])
    assert sum(a != b for a, b in itertools.pairwise(places)) <= 1


def test_where_no_corner_is_free_it_stays() -> None:
    size = (320, 240)
    them = insets(size)
    rng = np.random.default_rng(0)
    places = []
    for _ in range(100):
        x, y = rng.normal(scale=2, size=2)
        places.append(lay(them, size, [(x, y, 320 + x, 240 + y)])[1][0])
    assert len(set(places)) == 1


def test_targets_have_a_corner_each_and_of_many_the_first_ones() -> None:
    image, places = lay(insets((640, 480)), (640, 480), [], "a", "b", "c", "d", "e")
    assert len(set(places)) == 4 and where(image) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert all(a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1] for a in places for b in places if a != b)


@pytest.mark.parametrize(
    "picture",
    [np.zeros((0, 5), np.uint8), np.zeros((30, 26), np.float32), np.zeros((5, 5, 3), np.uint8), np.zeros(9, np.uint8)],
)  # fmt: skip
def test_what_is_no_picture_is_left_out(picture: Image) -> None:
    image = np.full((240, 320, 3), 128, np.uint8)
    assert insets((320, 240)).draw(image, [Shown("face", (("x", picture),), (0, 0, 255))], []) == []
    assert not touched(image).any()


@pytest.mark.parametrize("size", [(1, 1), (33, 21), (60, 50), (2000, 30), (30, 2000)])
def test_small_frames_have_no_room_and_none_is_too_small(size: tuple[int, int]) -> None:
    image, places = lay(Insets(size, 0, 1, Font(7)), size, [])
    assert len(places) <= 1 and image.shape == (size[1], size[0], 3)
    many = [Shown("face", PICTURES * 9, (0, 0, 255))]
    assert all(box[2] <= size[0] for box in Insets(size, 0, 1, Font(7)).draw(image, many, []))


def test_the_overlay_draws_them_and_keeps_labels_off() -> None:
    bare, shown = named("anna", 0.9), named("anna", 0.9, insets=PICTURES)
    plain, with_them = (Overlay((320, 240)).draw(one) for one in (bare, shown))
    changed = (plain != with_them).any(axis=2)
    assert changed[200:, :100].any() and not changed[:180].any() and not changed[:, 120:].any()
    Overlay((320, 240)).draw(named("anna", 0.9, insets=PICTURES, at=(40, 236)))


# --- the bar ---


def test_the_bar_tells_of_one_target_that_adapts() -> None:
    def said(*reported: dict[str, float] | None) -> dict[str, str]:
        parts = [part("box", 200, 150)]
        return adaptation(
            results.result(3, [target(f"t{i}", parts, 77, reported=one) for i, one in enumerate(reported)]).rows
        )

    assert said({"scale": 1.234, "noise": 1.5}) == {"scale": "size 123%"}
    assert said({"scale": 1.234}) == {"scale": "size 123%"}
    assert said({"scale": 1.234, "noise": 1.5}, {"scale": 1.234, "noise": 1.5}) == {}
    assert said() == said(None) == said({}) == said({"noise": 1.0}) == said({"scale": float("nan")}) == {}


@pytest.mark.parametrize("width", [60, 160, 240, 640, 1280])
def test_it_stands_in_the_bar_where_there_is_room(width: int) -> None:
    def draw(reported: dict[str, float]) -> Image:
        one = results.part("box", 20.0, 40.0, 20.0, 20.0, "tracked", 0.9)
        frame = Frame(3, 0.12, np.full((60, width, 3), 128, np.uint8))
        shown = results.result(frame, [target("face", [one], 77, reported=reported)])
        return Overlay((width, 60), title="adaptive").draw(shown)

    other = (draw({}) != draw({"scale": 1.0, "noise": 1.0})).any(axis=(0, 2))
    assert other.any() == (width > 320)
