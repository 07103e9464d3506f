"""Skin: Kovac's rules and the Gaussian as printed, where the rules fail, regions of hands, and clouds of pixels."""

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker, hand_regions
from facetrack_cli.trackers.skin import likelihoods
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.likelihoods import (
    LEAST_SHARE,
    MIN_VARIANCE,
    kovac,
    learn_skin,
    skin_map,
)
from tests.support.parts import skin_cloud
from tests.support.results import rows_of
from tests.twins import skin as naive

FACE = (50.0, 40.0, 60.0, 70.0)
# sRGB; the first is known to Kovac's rules, the others are not
USUAL, DARK, PALE = (205, 150, 125), (52, 36, 30), (188, 180, 176)
GREY_WALL, WARM_WALL, BLUE_WALL = (120, 122, 124), (190, 130, 95), (60, 90, 160)


def portrait(skin, wall, *, fill=1.0, noise=4.0, height=150, width=170):
    """A face that fills the ellipse in FACE, or `fill` of its axes, with eyes and mouth, before a wall; BGR."""
    rng = np.random.default_rng(0)
    picture = np.empty((height, width, 3))
    picture[:] = wall[::-1]
    y, x = np.mgrid[:height, :width]
    u, v = (x - 79.5) / (30 * fill), (y - 74.5) / (35 * fill)
    picture[u**2 + v**2 <= 1] = skin[::-1]
    light = 1 + 0.1 * np.cos(np.minimum(np.hypot(u, v), 1) * np.pi / 2)
    for eye in (-0.4, 0.4):
        picture[((u - eye) / 0.18) ** 2 + ((v + 0.25) / 0.1) ** 2 <= 1] = (40, 35, 35)
    picture[(u / 0.35) ** 2 + ((v - 0.5) / 0.09) ** 2 <= 1] = (0.75 * np.array(skin[::-1])) * (1, 0.9, 1.1)
    picture = picture * light[..., None] + rng.normal(0, noise, (height, width, 1))
    return Frame(0, 0.0, np.clip(np.rint(picture), 0, 255).astype(np.uint8))


def mean_p(frame, model):
    """Mean p in the face, and in all that is outside of its box."""
    p = skin_map(frame.bgr, model.table) / 255
    y, x = np.mgrid[: p.shape[0], : p.shape[1]]
    face = ((x - 79.5) / 30) ** 2 + ((y - 74.5) / 35) ** 2 <= 0.9
    outside = (x < 50) | (x >= 110) | (y < 40) | (y >= 110)
    return p[face].mean(), p[outside].mean()


# --- kernels and their twins


# edges to a quarter of a pixel, where pixels begin and end among them, and far outside
edges = st.integers(-20, 60).map(lambda q: q / 4) | st.floats(-3, 12) | st.sampled_from([-1e12, 1e12])


@settings(max_examples=12)
@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 5),
    width=st.integers(1, 6),
    boxes=st.lists(st.tuples(*4 * [edges]), min_size=1, max_size=4),
)
def test_sums_over_boxes_count_parts_of_pixels_by_their_area(seed, height, width, boxes):
    values = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    boxes = np.sort(np.array(boxes).reshape(-1, 2, 2), axis=1).reshape(-1, 4)
    seen = kernel.box_sums(cv2.integral(values, sdepth=cv2.CV_64F), np.ascontiguousarray(boxes.T) + 0.5)
    np.testing.assert_allclose(seen, [naive.area_sum(values, *box) for box in boxes], atol=1e-6)


# --- the model as printed


def test_kovacs_rules_are_those_of_the_paper_at_every_threshold():
    levels = [20, 21, 40, 41, 95, 96, 110, 111, 112, 170, 171, 210, 211, 220, 221, 226, 255]
    bgr = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).astype(np.uint8)
    bgr = bgr.reshape(len(levels), -1, 3)
    expected = [[naive.kovac(*map(int, pixel)) for pixel in row] for row in bgr]
    assert 100 < np.sum(expected) < 0.5 * np.size(expected)
    np.testing.assert_array_equal(kovac(bgr), expected)


def test_the_gaussian_is_that_of_the_pixels_that_pass():
    frame = portrait(USUAL, BLUE_WALL)
    model = learn_skin(frame, FACE)
    region = frame.bgr[40:110, 50:110]
    passed = [pixel for row in region for pixel in row if naive.kovac(*map(int, pixel))]
    colours = np.array([naive.rounded(*map(int, pixel))[1:] for pixel in passed])
    np.testing.assert_allclose(model.mean, colours.mean(axis=0))
    ours, exact = np.linalg.eigvalsh(model.cov), np.linalg.eigvalsh(np.cov(colours.T, bias=True))
    np.testing.assert_allclose(ours, np.maximum(exact, MIN_VARIANCE))

    near = [(cb, cr) for cb in range(90, 130, 7) for cr in range(120, 170, 7)]
    expected = [255 * naive.probability(colour, model.mean, model.cov) for colour in near]
    np.testing.assert_allclose([model.table[colour] for colour in near], expected, atol=0.5 + 1e-9)
    assert np.unravel_index(model.table.argmax(), (256, 256)) == tuple(np.rint(model.mean))
    assert model.notes == () and not model.fallback


# --- where the rules fail


@pytest.mark.parametrize("skin", [DARK, PALE], ids=["dark", "pale"])
@pytest.mark.parametrize("wall", [GREY_WALL, WARM_WALL, BLUE_WALL], ids=["grey", "warm", "blue"])
def test_dark_and_pale_faces_are_learned_from_the_box_and_the_user_is_told(skin, wall):
    frame = portrait(skin, wall)
    model = learn_skin(frame, FACE)
    assert model.fallback and model.share < 0.1
    [note] = model.notes
    assert note.startswith(f"Kovac's rules find skin in only {model.share:.0%} of the face, so its colour was")
    face, outside = mean_p(frame, model)
    assert face > 0.5
    if (skin, wall) != (PALE, GREY_WALL):
        assert outside < 0.1


def test_a_warm_wall_in_the_corners_does_not_pass_for_a_dark_face(monkeypatch):
    """Around a dark face that fills little of the box only the wall passes; learned from, it would be all the skin."""
    frame = portrait(DARK, WARM_WALL, fill=0.85)
    box_share = kovac(frame.bgr[40:110, 50:110]).mean()
    assert box_share > LEAST_SHARE  # by the whole box the rules would seem to fit
    model = learn_skin(frame, FACE)
    assert model.fallback and model.share < LEAST_SHARE
    face, outside = mean_p(frame, model)
    monkeypatch.setattr(likelihoods, "LEAST_SHARE", 0)
    as_printed = learn_skin(frame, FACE)
    assert not as_printed.fallback
    wrong_face, wrong_outside = mean_p(frame, as_printed)
    assert face > outside and wrong_face < wrong_outside


# --- wild input


@given(
    seed=st.integers(0, 50),
    box=st.tuples(st.floats(-40, 60), st.floats(-40, 60), st.floats(0.01, 1e9), st.floats(0.01, 1e9)),
    flat=st.booleans(),
)
def test_any_box_of_any_picture_gives_a_model_or_says_that_it_is_not_in_the_picture(seed, box, flat):
    bgr = np.random.default_rng(seed).integers(0, 256, (17, 23, 3), dtype=np.uint8)
    if flat:
        bgr[:] = bgr[0, 0]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            model = learn_skin(Frame(3, 0.0, bgr), box)
            assert not flat or np.abs(model.mean - 128).max() > 3
    except InputError as error:
        outside = box[0] >= 22.5 or box[1] >= 16.5 or box[0] + box[2] <= 0.5 or box[1] + box[3] <= 0.5
        what = "23x17" if outside else "have a colour"
        assert "frame 3" in str(error) and what in str(error)
        return
    assert np.isfinite(model.mean).all() and np.linalg.eigvalsh(model.cov).min() >= MIN_VARIANCE - 1e-6
    assert model.table.max() > 200 and 0 <= model.share <= 1


# --- where hands begin: regions of skin apart from the face

HANDS_FACE = (130.0, 40.0, 50.0, 60.0)
# centre and half axes
LEFT_HAND = 70, 180, 18, 20


def signer(*hands, skin=USUAL, width=320, zoom=1):
    """A face with forehead, ears and neck, and hands, before a cloth of blue."""
    picture = np.full((240, width, 3), (150, 90, 60), np.uint8)
    for x, y, a, b in [(155, 67, 27, 42), *hands]:
        cv2.ellipse(picture, (x, y), (a, b), 0, 0, 360, skin[::-1], -1)
    cv2.rectangle(picture, (143, 95), (167, 128), skin[::-1], -1)
    for eye in (144, 166):
        cv2.ellipse(picture, (eye, 58), (5, 3), 0, 0, 360, (40, 35, 35), -1)
    noise = np.random.default_rng(0).normal(0, 3, (240, width, 1))
    picture = np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)
    return Frame(0, 0.0, cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_LINEAR))


def hands_in(frame, count, face=HANDS_FACE):
    return hand_regions(frame, face, learn_skin(frame, face), count)


def assert_at(box, shape, zoom=1):
    """The box is that of the ellipse, to 4 pixels of the image before it was enlarged."""
    x, y, a, b = shape
    np.testing.assert_allclose(np.array(box) / zoom, (x - a, y - b, 2 * a + 1, 2 * b + 1), atol=4)


def test_neither_face_nor_neck_nor_specks_nor_walls_are_hands():
    assert hands_in(signer(), 2) == []
    assert hands_in(signer(*[(40 + 60 * i, 200, 3, 3) for i in range(5)]), 5) == []
    frame = signer(LEFT_HAND)
    frame.bgr[:, 200:] = USUAL[::-1]
    (left,) = hands_in(frame, 2)
    assert_at(left, LEFT_HAND)
    # skin out of reach is somebody else's
    [near] = hands_in(signer((110, 180, 15, 20), (700, 180, 18, 22), width=800), 2)
    assert_at(near, (110, 180, 15, 20))


@pytest.mark.parametrize("face", [HANDS_FACE, (-30, -20, 60, 60), (10, 10, 1, 1), (-500, -500, 2000, 2000)])
def test_boxes_are_within_the_picture_whatever_the_face(face):
    boxes = hands_in(signer((0, 200, 20, 20), (319, 239, 25, 30)), 2, face)
    assert all(x >= 0 and y >= 0 and x + w <= 320 and y + h <= 240 and w > 0 and h > 0 for x, y, w, h in boxes)
    assert face != HANDS_FACE or len(boxes) == 2
    for size in ((1, 1), (2, 500), (700, 3)):
        frame = Frame(0, 0.0, np.full((*size, 3), USUAL[::-1], np.uint8))
        assert len(hands_in(frame, 2, (0, 0, 2, 2))) <= 2


# --- clouds, and several targets in the whole engine, on made-up clips whose ground truth is known

SKIN, WALL = (120, 150, 205), (150, 120, 90)
HEAD, LEFT, RIGHT = (130.0, 60.0, 22.0, 28.0), (60.0, 140.0, 14.0, 14.0), (200.0, 140.0, 14.0, 14.0)


def picture(*ellipses, noise=None, skin=SKIN):
    """Ellipses (centre x, y, half axes) of skin before a wall, 200x260, with eyes and mouth in the first one."""
    out = np.full((200, 260, 3), WALL, np.uint8)
    for x, y, a, b in ellipses:
        cv2.ellipse(out, (round(x), round(y)), (round(a), round(b)), 0, 0, 360, skin, -1, cv2.LINE_AA)
    if ellipses:
        x, y, a, b = ellipses[0]
        for dx, dy in ((-0.4, -0.25), (0.4, -0.25), (0, 0.45)):
            eye = round(x + dx * a), round(y + dy * b)
            cv2.ellipse(out, eye, (round(a / 5), round(b / 10)), 0, 0, 360, (40, 40, 60), -1, cv2.LINE_AA)
    if noise is not None:
        out = np.clip(out + noise.normal(0, 6, out.shape), 0, 255).astype(np.uint8)
    return out


def box(ellipse):
    x, y, a, b = ellipse
    return x - a + 0.5, y - b + 0.5, 2 * a, 2 * b


def frames(paths, seed=1):
    rng = np.random.default_rng(seed)
    return [Frame(i, i / 25, picture(*ellipses, noise=rng)) for i, ellipses in enumerate(paths)]


def start(*ellipses):
    return Start(0, {name: TargetStart(box=box(one)) for name, one in zip(ALL, ellipses, strict=True)}, "x")


def run(config, clip, begin, seed=0, overrides=()):
    return list(track(build_tracker(load_recipe(config, overrides), begin), iter(clip), seed))


def places(results):
    """(T, targets, 4): x, y, w, h."""
    return np.array([[(p.x, p.y, p.w, p.h) for p in rows_of(r.rows)] for r in results])


def moved(ellipse, dx, dy):
    return ellipse[0] + dx, ellipse[1] + dy, *ellipse[2:]


def swing(count=24):
    """A head that nods and two hands that move fast, apart from each other."""
    fast, slow = np.arange(count) / 3, np.arange(count) / 4
    return [(moved(HEAD, 10 * np.sin(t / 6), 4 * np.sin(s)), moved(LEFT, 25 * np.sin(f), 20 * np.cos(s) - 20),
             moved(RIGHT, 25 * np.sin(s), 20 * np.cos(f) - 20))
            for t, (f, s) in enumerate(zip(fast, slow, strict=True))]  # fmt: skip


ALL = ("head", "left_hand", "right_hand")


@pytest.mark.parametrize("config", ["head_hands", "head_hands_cloud"])
def test_head_and_hands_are_followed_and_keep_their_names(config):
    clip = swing()
    results = run(config, frames(clip), start(HEAD, LEFT, RIGHT))
    true = np.array([[ellipse[:2] for ellipse in row] for row in clip])
    found = places(results)
    assert [target.rows.target for target in results[0].targets] == list(ALL)
    off = np.hypot(*np.moveaxis(found[..., :2] - true, 2, 0))
    assert off.mean(axis=0).max() < 6 and np.quantile(off, 0.95) < 14
    assert {p.status for p in rows_of(results[0].rows)} == {"init"}
    assert all(p.status == "tracked" for r in results[1:] for p in rows_of(r.rows))


def test_hands_that_meet_the_face_do_not_take_it_and_go_on_their_way():
    """Without exclusion, the cloud of a hand that passes over the face would stay on it."""
    across = [(HEAD, (70 + 4.0 * t, 62.0, 14.0, 14.0), RIGHT) for t in range(30)]
    begin, ways = start(*across[0]), ((), ["exclusion=null"])
    kept, lost = (places(run("head_hands", frames(across), begin, 0, more))[-1, 1, 0] for more in ways)
    assert abs(kept - across[-1][1][0]) < 8 and abs(lost - HEAD[0]) < 20


@pytest.mark.parametrize(("config", "zoom"), [("head_hands", 1), ("head_hands_cloud", 4)])
def test_a_target_that_keeps_off_none_does_not_change_by_what_is_tracked_beside_it(config, zoom):
    """Nor by which parts of a frame others have asked for before: at the larger size they are reduced."""
    clip = [cv2.resize(frame.bgr, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_LINEAR) for frame in frames(swing(3))]
    at = {name: tuple(zoom * v for v in box(e)) for name, e in zip(ALL, (HEAD, LEFT, RIGHT), strict=True)}

    def followed(*names):
        begin = Start(0, {name: TargetStart(box=at[name]) for name in names}, "x")
        left_out = [f"targets.{name}=null" for name in ALL if name not in names]
        return run(config, [Frame(i, 0.0, bgr) for i, bgr in enumerate(clip)], begin, 2, ["exclusion=null", *left_out])

    together, pair = followed(*ALL), followed("head", "left_hand")
    alone = followed("head")
    for seen, by, target in ((together, alone, 0), (together, pair, 0), (together, pair, 1)):
        for one, other in zip(seen, by, strict=True):
            np.testing.assert_array_equal(one.targets[target].cloud, other.targets[target].cloud)


def test_particles_are_pixels_of_the_reduced_picture():
    share = np.random.default_rng(2).uniform(0.6, 1, (200, 260, 1))  # skin and cloth mixed pixel by pixel
    bgr = np.round(share * np.array(SKIN) + (1 - share) * np.array(WALL)).astype(np.uint8)
    teacher = Frame(0, 0.0, picture(HEAD))
    small = cv2.cvtColor(cv2.resize(bgr, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2YCrCb)
    model = skin_cloud((50.0, 60.0), box(HEAD), max_size=32)
    learned = model.init(teacher, None)
    x = np.random.default_rng(0).uniform((0, 0), (259, 199), (300, 1, 2))
    # the pixels 2 i and 2 i + 1 are one
    column, row = np.floor((x[:, 0] + 0.5) / 2).astype(int).T
    p = learned.table[small[row, column, 2], small[row, column, 1]] / 255
    assert np.ptp(p) > 0.3 and (p < model.settings.floor).any()
    found = np.exp(model.score(learned, Frame(1, 0.0, bgr), x, x))[:, 0]
    np.testing.assert_allclose(found, np.maximum(p, model.settings.floor))
