"""The overlay: what is drawn where, in what form, on any result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from facetrack_cli.core.face_points import GROUPS, LINES, POINTS
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.trajectory.trajectory import FrameResult, Status, recorded
from facetrack_cli.video.overlay import PALETTE, Font, Overlay, Shape, StatusBar, _name, plain, summary
from tests.support import results
from tests.support.face_shape import SHAPE, moving_face
from tests.support.results import target

Part = dict[str, Any]  # as tests.support.results has it
SIZES = [(128, 96), (320, 240), (1280, 720), (240, 320), (33, 21)]
AT = {
    "nose": (0.5, 0.4), "mouth_left": (0.4, 0.6), "mouth_right": (0.6, 0.6), "lip_upper": (0.5, 0.55),
    "lip_lower": (0.5, 0.7),
}  # fmt: skip


def part(name: str = "nose", x: float = 50, y: float = 50, **other: object) -> Part:
    values: Part = {"w": 13.0, "h": 13.0, "status": "tracked", "confidence": 0.9, "cov": (1.0, 0.2, 1.0)}
    return results.part(name, x, y, ess=50.0, **{**values, **other})


def result(size: tuple[int, int], *parts: Part, index: int = 0, ground: int = 128, name: str = "face") -> FrameResult:
    picture = np.full((size[1], size[0], 3), ground, np.uint8)
    return results.result(Frame(index, index / 25, picture), [target(name, parts, 40)])


def face(size: tuple[int, int], index: int = 0, lost: tuple[str, ...] = (), ground: int = 128) -> FrameResult:
    window = {side: 13 * min(size) / 240 for side in "wh"}
    status = {name: "lost" if name in lost else "tracked" for name in AT}
    places = {name: (x * size[0] + 0.5 * index, y * size[1]) for name, (x, y) in AT.items()}
    parts = [part(name, *at, **window, status=status[name]) for name, at in places.items()]
    return result(size, *parts, index=index, ground=ground)


def touched(image: Image, ground: int = 128) -> np.ndarray:
    return (image != ground).any(axis=2)


def drawn(size: tuple[int, int], *parts: Part, **more: Any) -> Image:
    return Overlay(size).draw(result(size, *parts, **more))


def around(mask: np.ndarray, x: float, y: float, reach: float) -> np.ndarray:
    return mask[max(0, int(y - reach)) : int(y + reach) + 2, max(0, int(x - reach)) : int(x + reach) + 2]


@pytest.mark.parametrize("size", SIZES)
def test_each_part_is_drawn_on_a_new_picture_and_nothing_far_from_them(size: tuple[int, int]) -> None:
    overlay = Overlay(size, title="factorized")
    for index in range(3):
        shown = face(size, index)
        before = shown.frame.bgr.copy()
        image = overlay.draw(shown)
        assert image.shape == before.shape and image.dtype == np.uint8
        assert not np.shares_memory(image, shown.frame.bgr)
        assert np.array_equal(shown.frame.bgr, before)
        assert (image != before).any()
    mask = touched(Overlay(size).draw(face(size)))
    if size[0] > 33:
        assert all(around(mask, x * size[0], y * size[1], 4).any() for x, y in AT.values())
        assert not mask[int(0.85 * size[1]) :].any()
        assert not mask[int(0.3 * size[1]) :, : int(0.2 * size[0])].any()


def test_the_window_stands_where_the_part_says_to_a_fraction_of_a_pixel() -> None:
    for x in (100.0, 100.5):
        image = drawn((200, 200), part("nose", x, 100.0, w=41.0, h=41.0, cov=(0, 0, 0)))
        row = np.abs(image[112].astype(float) - 128).sum(axis=1)  # crosses both sides, clear of mark and label
        assert float((row * np.arange(200)).sum() / row.sum()) == pytest.approx(x, abs=0.15)


@pytest.mark.parametrize("width", [7, 13, 26, 60])
def test_lost_differs_from_tracked_in_form_not_in_colour_alone(width: int) -> None:
    def ink(status: Status) -> np.ndarray:
        image = drawn((200, 200), part("n", 100.0, 100.0, w=width, h=width, status=status, cov=(0, 0, 0)))
        return np.abs(image.astype(int) - 128).max(axis=2)[50:150, 50:150] > 60  # coloured, in whatever colour

    tracked, lost, init = ink("tracked"), ink("lost"), ink("init")
    for a, b in ((tracked, lost), (init, lost), (tracked, init)):
        share = (a != b).sum() / max(a.sum(), b.sum())
        # seven pixels have no room for a mark, but for the cross of what is lost
        assert share >= (0.15 if width > 7 or b is lost else 0.05), share


def test_trails_follow_and_fade_and_are_forgotten() -> None:
    size = (320, 240)
    overlay = Overlay(size, fps=25.0, trail_s=1.0)
    for index in range(26):
        image = overlay.draw(result(size, part("nose", 100.0 + 4 * index, 120.0, w=9.0, h=9.0), index=index))
    strength = np.abs(image.astype(int) - 128).max(axis=2)[117:124].max(axis=0)
    assert strength[186:188].max() > strength[106:110].max() > 0  # new is stronger than old
    for index in range(26, 70):  # at rest for longer than the trail lasts
        image = overlay.draw(result(size, part("nose", 200.0, 120.0, w=9.0, h=9.0), index=index))
    assert not touched(image)[100:140, :180].any()
    overlay = Overlay(size, fps=240.0)
    for index in range(120):
        step = result(size, part("a", 50.0, 60.0), index=index, name=f"target{index // 50}")
        step.frame.time_s = index / 240
        overlay.draw(step)
        assert len(overlay._past) == 1 and len(next(iter(overlay._past.values()))) <= 40, "memory is bounded"


def test_a_part_that_was_lost_leaves_a_broken_trail_in_another_colour() -> None:
    size = (320, 240)

    def trail(status: Status) -> Image:
        overlay = Overlay(size)
        for index in range(20):
            image = overlay.draw(result(size, part("n", 60.0 + 8 * index, 120.0, status=status), index=index))
        return image[116:125, 130:190].astype(int)

    tracked, lost = trail("tracked"), trail("lost")
    assert (tracked[..., 0] - tracked[..., 2]).max() > 60 and (lost[..., 2] - lost[..., 0]).max() > 60
    assert touched(tracked).any(axis=0).all() and not touched(lost).any(axis=0).all()


def test_the_ellipse_shows_the_covariance() -> None:
    def ellipse(cov: tuple[float, float, float]) -> np.ndarray:
        return touched(drawn((200, 200), part("n", 100.0, 100.0, cov=cov)))

    wide, tall, leaning = (ellipse(cov) for cov in ((400.0, 0.0, 25.0), (25.0, 0.0, 400.0), (300.0, 280.0, 300.0)))
    assert wide[100, 138:143].any() and not wide[138:143, 100].any()
    assert tall[138:143, 100].any() and not tall[100, 138:143].any()
    assert leaning[120:, 120:].sum() > 5 and not leaning[120:, :80].any()
    assert not ellipse((0.0, 0.0, 0.0))[100, 120:].any()


@pytest.mark.parametrize(("size", "least"), [((320, 240), 8), ((3840, 2160), 40), ((128, 96), 7)])
def test_the_status_bar_can_be_read(size: tuple[int, int], least: int) -> None:
    overlay = Overlay(size)
    bar = overlay._bar
    assert bar is not None and bar.height <= 0.14 * size[1] and least <= bar._font.cap <= 1.25 * least
    strip = overlay.draw(result(size, part("nose", size[0] / 2, size[1] / 2), ground=255))[: bar.height].astype(int)
    assert strip.min() < 80 and strip.max() > 220, "light on dark, whatever is below"


def test_text_outside_ascii_and_over_the_edge() -> None:
    assert plain("Ünïcode_µ") == "Unicode_?" and plain("a\nb") == "a?b" and plain("factorized") == "factorized"
    font, whole = Font(20), np.zeros((60, 90, 3), np.uint8)
    font.write(whole, "HH", 20, 40, (255, 255, 255))
    ys, xs = np.nonzero(whole[..., 0])
    assert (ys.min(), ys.max()) == (20, 39) and 20 <= xs.min() < xs.max() < 20 + font.width("HH")
    for left, base in ((-9, 40), (75, 40), (20, 8), (20, 75), (200, 40), (20, 200), (-200, 40)):
        image = np.zeros_like(whole)
        font.write(image, "HH", left, base, (255, 255, 255))
        moved = np.zeros_like(whole)
        across, down = left - 20, base - 40
        there = [slice(max(d, 0), max(n + min(d, 0), 0)) for d, n in ((down, 60), (across, 90))]
        back = [slice(max(-d, 0), max(n - max(d, 0), 0)) for d, n in ((down, 60), (across, 90))]
        moved[tuple(there)] = whole[tuple(back)]
        assert np.array_equal(image, moved), "cut off at the border"


def test_what_the_bar_says() -> None:
    good, gone_, hidden = part("nose"), part("lip_upper", status="lost"), part("lip_upper", status="hidden")
    whole, hand = [gone_, part("thumb", status="lost")], part("box", status="init", by_hand=True)
    for said, targets in (
        (("tracked", "tracked"), {"face": [good]}),
        (("init", "init"), {"face": [part(status="init")]}),
        (("lost", "lost 1/2"), {"face": [good, gone_]}),
        (("lost", "lost 1/3"), {"face": [good, gone_], "other": [good]}),
        (("lost", "lost 3/4"), {"face": [good, gone_], "hand": whole}),
        (("hidden", "hidden 1/2"), {"face": [good, hidden]}),
        (("lost", "lost 1/3"), {"face": [good, gone_, hidden]}),
        (("lost", "no target"), {}),
        (("tracked", "absent 1/2"), {"face": [part("lip"), gone()]}),
        (("absent", "absent"), {"face": [gone(), gone("lip")]}),
        (("lost", "lost 1/2"), {"face": [gone_, gone()]}),
        (("init", "absent 1/2"), {"face": [part("lip", status="init"), gone()]}),
        (("init", "by hand 1/2"), {"face": [good], "hand": [hand]}),
    ):
        rows = results.result(0, [target(name, parts, 1) for name, parts in targets.items()]).rows
        assert summary(rows) == said


@pytest.mark.parametrize("width", [48, 128, 320, 1000])
@pytest.mark.parametrize("lost", [(), tuple(AT)[:3]])
def test_the_bar_drops_what_has_no_room(width: int, lost: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    bar, places = StatusBar(width, 8, 1, "factorized_transition"), list[tuple[int, int]]()
    real = Font.write

    def noted(font: Font, image: Image, text: str, left: int, *more: Any) -> None:
        places.append((left, left + font.width(text)))
        real(font, image, text, left, *more)

    monkeypatch.setattr(Font, "write", noted)
    image = np.zeros((60, width, 3), np.uint8)
    bar.draw(image, face((320, 240), index=1234567, lost=lost))
    assert not image[bar.height :].any() and len(places) == (5 if width == 1000 else len(places))
    assert places and all(a >= 0 and b <= width for a, b in places)
    assert all(a[1] < b[0] for a, b in pairwise(sorted(places)))


ODD = [
    part("", -1e12, 1e12, w=0.0, h=5000.0, cov=(1e12, -1e12, 1e12), status="lost", angle=-720.0),
    part("a\nb", 0.0, -1e4, w=5000.0, h=0.0, cov=(0.0, 1e12, 0.0), status="init", angle=33.0),
    part("ü" * 12, 150.0, 100.0, w=3.0, h=3.0, cov=(1e-9, 1.0, 4.0), confidence=0.0),
    part("box", 100.0, 1e4, w=40.0, h=30.0, cov=None, confidence=None, angle=None),
]


@pytest.mark.parametrize("size", [(1, 1), (400, 2), (47, 300), (400, 300)])
@pytest.mark.parametrize("fps", [0.01, 25, 1000])
def test_no_result_makes_it_raise(size: tuple[int, int], fps: float) -> None:
    overlay = Overlay(size, fps=fps, title="a\u0301 \x1b title" * 3)
    every = [target("", ODD, 40, None, "Ann\n", 0.0), target("one", ODD[2:3], 1, None, "", 1.0), target("none", [], 0)]
    for index, time_s in enumerate((0.0, 1e6, 3.0, 3.0)):
        for of in (every, every[1:], every[:1], every[2:], []):
            picture = np.full((size[1], size[0], 3), 77, np.uint8)
            image = overlay.draw(results.result(Frame(index, time_s, picture), of))
            assert image.shape == picture.shape and (picture == 77).all()


def gone(name: str = "nose", **other: object) -> Part:
    nowhere: Part = dict.fromkeys("xywh", float("nan"))
    return part(name, **{**nowhere, "cov": None, "confidence": None, "status": "absent", **other})


def test_an_absent_part_is_not_drawn_and_neither_is_its_name() -> None:
    size = (640, 480)
    shown = part("lip_lower", 420.0, 300.0, w=80.0, h=80.0)
    alone = result(size, shown)
    both = results.result(alone.frame, [target("face", [shown, gone()], 40)])
    ours, without = Overlay(size).draw(both), Overlay(size).draw(alone)
    bar = Overlay(size)._bar
    assert bar is not None
    assert np.array_equal(ours[bar.height :], without[bar.height :])
    assert not np.array_equal(ours[: bar.height], without[: bar.height]), "the bar tells"


def test_a_trail_leads_neither_to_a_place_given_by_hand_nor_past_an_absence() -> None:
    size = (320, 240)

    def trail(*parts: Part) -> np.ndarray:
        overlay = Overlay(size)
        pictures = [overlay.draw(result(size, one, index=i)) for i, one in enumerate(parts)]
        return touched(pictures[-1])[100:140, 100:200]  # between the two places

    here, there = part(x=60.0, y=120.0, cov=None), part(x=240.0, y=120.0, cov=None)
    assert trail(here, there).any()
    assert not trail(here, {**there, "status": "init", "by_hand": True}).any()
    assert not trail(here, gone(), there).any()


def test_what_a_correction_gave_has_a_filled_diamond() -> None:
    size = (320, 240)

    def middle(**other: object) -> np.ndarray:
        given = part(x=160.0, y=120.0, w=61.0, h=61.0, cov=None, status="init", **other)
        return drawn(size, given)[120, 160]

    assert (middle() == 128).all() and not (middle(by_hand=True) == 128).all()


def test_parts_have_colours_of_their_own_and_names_without_underscores() -> None:
    """Those of the plots, in their order; of several targets each has one."""
    face = [part("nose"), part("mouth_left"), part("box", w=80.0, h=80.0)]
    shape = Shape(target("face", face), None, 1.0, 999.0)
    assert shape.colours == [*PALETTE[:3]] and shape.colour == PALETTE[2]
    hand = Shape(target("left_hand", face), 1, 1.0, 999.0)
    assert hand.colours == [PALETTE[1]] * 3
    assert _name(hand, named=True) == ("left hand", PALETTE[1]) and not _name(hand, named=False)[0]


def of_face(size: tuple[int, int], names: Sequence[str], lost: Sequence[str] = ()) -> Image:
    """A face of these points, each 0.3 of the height between its eyes, as it is drawn on grey."""
    table = moving_face(1, unit=0.3 * size[1], place=(size[0] / 2, 0.35 * size[1]), names=names)
    status = np.array(["lost" if part in lost else "tracked" for _, part in table.names])
    frame = Frame(0, 0.0, np.full((size[1], size[0], 3), 128, np.uint8))
    return Overlay(size).draw(FrameResult(frame, recorded(0, replace(table, status=status))))


def test_lips_are_a_thin_closed_line_and_grey_beside_what_is_lost() -> None:
    mouth = ("mouth_left", "mouth_right", "lip_upper", "lip_lower")
    size = (320, 240)
    drawn, gone = of_face(size, mouth), of_face(size, mouth, lost=("lip_upper",))
    for k, (a, b) in enumerate(zip(("mouth_left", "lip_upper", "mouth_right", "lip_lower"), LINES[0][1:], strict=True)):
        (x, y), (u, v) = SHAPE[a], SHAPE[b]
        at = round(160 + 72 * (x + u) / 2), round(84 + 72 * (y + v) / 2)
        spot, other = (around(image, *at, 1).reshape(-1, 3).astype(int) for image in (drawn, gone))
        assert np.ptp(spot, axis=1).max() > 60, "in colour"
        assert (np.ptp(other, axis=1).max() < 30) == (k < 2), "grey, of the two lines that end in what is lost"
    inside = drawn[round(84 + 72 * 1.1) : round(84 + 72 * 1.15), 150:158]
    assert (inside == 128).all(), "the mouth is seen"
    assert not around(touched(of_face(size, mouth[1:])), 145, 159, 3).any(), "no line to a part that is not there"


def test_many_points_have_lines_and_at_most_tiny_dots() -> None:
    few, many = (touched(of_face((640, 480), names)) for names in (("nose", *GROUPS["mouth"]), POINTS))
    assert many[100:400, 200:440].mean() < 0.06
    for name in ("eye_left_upper", "brow_right_middle", "chin"):
        x, y = 320 + 144 * SHAPE[name][0], 168 + 144 * SHAPE[name][1]
        assert around(many, x, y, 1).any() and not around(few, x, y, 1).any()
        assert around(many, x, y, 6).mean() < 0.35
    nose = around(many, 320, 168 + 144 * 0.55, 4)
    assert 1 <= nose.sum() <= 16


def named(who: str | None, sure: float | None, y: float = 150) -> Image:
    """A box around (200, y) with a name."""
    one = target("face", [part("box", 200, y, w=60, h=60, cov=None)], 77, None, who, sure)
    return Overlay((320, 240)).draw(results.result(Frame(0, 0.0, np.full((240, 320, 3), 128, np.uint8)), [one]))


def test_a_part_with_corners_is_drawn_as_its_parallelogram() -> None:
    corners = np.array([(60, 60), (140, 90), (150, 150), (70, 120)], np.float64)
    one = part("box", 105, 105, w=85, h=61, cov=(0, 0, 0), corners=corners)
    mask = touched(drawn((200, 200), one))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        for share in (0.1, 0.5, 0.9):
            assert around(mask, *(a + share * (b - a)), 1).any()
    assert not around(mask, 147, 75, 2).any(), "nothing is left of the box around it"
    assert not around(mask, 105 - 42, 105 + 30, 3).any()
    leaning = touched(drawn((200, 200), part("box", 100, 100, w=101, h=41, cov=(0, 0, 0), angle=30.0)))
    for x, y in ((-50, -20), (50, -20), (50, 20), (-50, 20)):  # clockwise: its right end is lower
        there = (x + 1j * y) * np.exp(1j * np.pi / 6)
        assert around(leaning, 100 + there.real, 100 + there.imag, 1).any()
        assert not around(leaning, 100 + there.real, 100 - there.imag, 1).any()


def test_a_name_stands_beside_its_target_and_one_in_doubt_is_pale_and_has_a_question_mark() -> None:
    sure, unsure, plain = (named("anna", p)[90:118, 130:270] for p in (0.93, 0.43, None))
    assert touched(plain).any(axis=0).sum() < touched(sure).any(axis=0).sum(), "how sure it is"
    assert touched(sure).any(axis=0).sum() < touched(unsure).any(axis=0).sum(), "one sign more"
    colours = [int(np.ptp(image.astype(int), axis=2).max()) for image in (sure, unsure, plain)]
    assert colours[0] > 100 and colours[2] > 100, "in the target's colour"
    assert colours[1] < 40, "grey"
    assert not touched(named(None, None)[90:118, 130:270]).any()
    # at the top there is no room above: below, then
    assert touched(named("anna", None, y=40)).sum() > touched(named(None, None, y=40)).sum() + 40
