"""Skin by rules and a Gaussian, where hands begin, clouds of pixels, and faces by skin and a template."""

import warnings
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker, hand_regions
from facetrack_cli.trackers.skin import likelihoods
from facetrack_cli.trackers.skin import likelihoods as matching
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.likelihoods import (
    LEAST_SHARE,
    MIN_NCC,
    MIN_VARIANCE,
    kovac,
    learn_skin,
    skin_map,
)
from facetrack_cli.trackers.skin.settings import SkinNccSettings
from tests.support.images import frame, grey, states
from tests.support.parts import pattern, skin_cloud, skin_cue, skin_ncc
from tests.support.results import rows_of
from tests.support.samples import TrackClip
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


# --- faces by skin and template: rho, NCC and the score

SIZE, TRUTH = FACE[2:], (79.5, 74.5)


@cache
def scene():
    return portrait(USUAL, BLUE_WALL, height=170, width=260).bgr


def learned(bgr, centre=TRUTH, size=SIZE, **options):
    likelihood = skin_ncc(size, **options)
    return likelihood, likelihood.init(frame(bgr), states(centre)[0])


@pytest.mark.parametrize(("max_size", "inner"), [(None, 1.0), (36, 0.7)])
def test_rho_is_that_of_the_twin(max_size, inner):
    likelihood, known = learned(scene(), skin=skin_cue(inner=inner, max_size=max_size), ncc=None)
    rows = [(*TRUTH, 1.0), (90.2, 77.7, 1.3), (5.0, 160.0, 0.8), (-300.0, 20.0, 1.0)]
    found = likelihood.rho(known, frame(scene()), states(rows))
    factor = 1 if max_size is None else 2
    reduced = cv2.resize(scene(), (260 // factor, 170 // factor), interpolation=cv2.INTER_AREA)
    codes = cv2.cvtColor(reduced, cv2.COLOR_BGR2YCrCb)
    skin = known.table[codes[..., 2], codes[..., 1]] / 255.0
    for (cx, cy, s), value in zip(rows, found, strict=True):
        centre = ((c - (factor - 1) / 2) / factor for c in (cx, cy))
        boxes = naive.regions(*centre, s, *(inner * side / factor for side in SIZE))
        assert value == pytest.approx(naive.rho(skin, *boxes), abs=1e-6)
    if inner == 1.0:
        assert found[0] < -0.3, "a face is skin among little skin"
    assert found[3] == 0.0, "beyond the image nothing is skin"


@pytest.mark.parametrize("cost", ["printed", "shifted", "product"])
@pytest.mark.parametrize("cues", ["both", "skin", "ncc"])
@pytest.mark.parametrize("mean", ["keep", "remove"])
def test_score_is_equation_11(cost, mean, cues):
    skin, ncc = skin_cue() if cues != "ncc" else None, pattern(mean, exponent=2.0) if cues != "skin" else None
    likelihood, known = learned(scene(), skin=skin, ncc=ncc, cost=cost, sigma=0.3)
    x = states([TRUTH, (110, 80), (60, 40), (300, 400)])
    f = frame(scene())
    rho = likelihood.rho(known, f, x) if skin else 0.0
    match = matching.correlate(known.template, f, x)[0 if mean == "keep" else 1] if ncc else 1.0
    good, divisor = np.maximum(match, 0) ** 2, np.maximum(match, MIN_NCC) ** 2
    v = {"printed": rho / divisor, "shifted": (1 + rho) / divisor, "product": rho * good}[cost]
    if cues == "ncc":
        v = good
    assert known.k == pytest.approx(v[0])
    np.testing.assert_allclose(likelihood.score(known, f, x)[:, 0], -((v[0] - v) ** 2) / (2 * 0.3**2), rtol=1e-9)


def test_beyond_the_picture_there_is_neither_skin_nor_pattern():
    likelihood, known = learned(scene())
    x = states([(-500, 80), (1e7, 1e7), (101.5, -60)])
    assert (likelihood.rho(known, frame(scene()), x) == 0).all()
    for found in matching.correlate(known.template, frame(scene()), x):
        assert (found == 0).all()
    np.testing.assert_array_equal(likelihood.distances(known, frame(scene()), x), 1.0)
    # half a box beyond the border is compared as black
    cut = scene()[:, :100].copy()
    black = np.concatenate([cut, np.zeros((170, 160, 3), np.uint8)], axis=1)
    here, there = (
        matching.correlate(known.template, frame(one), states([TRUTH, (95.2, 70.7)])) for one in (cut, black)
    )
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_a_start_outside_of_the_picture_is_refused():
    for cues in ({}, {"skin": None}, {"ncc": None}):
        for place in ((-40, 50), (50, 1000), (np.nan, 50)):
            with pytest.raises(InputError, match=r"not in the image|outside the image"):
                learned(scene(), place, **cues)
        assert learned(scene(), (-10, 5), **cues)[1].k is not None
    with pytest.raises(ValueError, match="neither skin nor ncc"):
        SkinNccSettings(type="skin_ncc", sigma=0.1)


def test_what_the_start_lacks_is_told():
    assert learned(scene())[1].notes == ()
    assert len(learned(scene()[..., ::-1].copy())[1].notes) == 1, "no pixel has the colour of skin"
    grey_face = np.repeat(scene().mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    with pytest.raises(InputError, match="only 0% of the face's box have a colour"):
        learned(grey_face)
    assert learned(grey_face, skin=None)[1].notes == ()
    flat = np.full((170, 260, 3), (120, 150, 205), np.uint8)
    assert any("pattern" in note for note in learned(flat)[1].notes)
    assert learned(flat, skin=None, ncc=pattern("remove"))[1].k == 0


@pytest.mark.parametrize(
    ("cost", "mean", "second", "holds"),
    [
        ("printed", "keep", False, False), ("shifted", "keep", False, True), ("shifted", "keep", True, False),
        ("shifted", "remove", True, True), ("product", "keep", True, False), ("product", "remove", True, True),
    ],
)  # fmt: skip
def test_the_readings_of_equation_11_on_a_darker_noisy_face(cost, mean, second, holds):
    """Whether the peak stays on a real face, also beside a `second` patch of skin: what docs/decisions.md says."""
    clip = TrackClip("expressions", 1)
    left, top, w, h = clip.start.targets["face"].box
    bgr, x, y = clip.frames[0].bgr, left + (w - 1) / 2, top + (h - 1) / 2
    likelihood, known = learned(bgr, (x, y), (w, h), ncc=pattern(mean), cost=cost)
    shown = bgr.copy()
    if second:
        skin = bgr[round(y) - 20 : round(y) + 20, round(x) - 20 : round(x) + 20].mean(axis=(0, 1))
        beside = round(x + (1.15 * w if x + 1.6 * w < bgr.shape[1] else -1.15 * w)), round(y)
        cv2.ellipse(shown, beside, (round(w / 2), round(h / 2)), 0, 0, 360, skin.tolist(), -1)
    worse = np.clip(0.85 * shown + np.random.default_rng(0).normal(0, 6, bgr.shape), 0, 255).astype(np.uint8)
    steps = [2.0 * np.arange(-int(0.75 * side), int(0.75 * side) + 1) for side in (w, h)]
    off = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    away = float(np.hypot(*off[likelihood.score(known, frame(worse), states(off + np.array([x, y])))[:, 0].argmax()]))
    assert away <= 2.0 if holds else away > 5.0


unit = st.floats(-12, 40, width=32)
step = st.one_of(st.just(1.0), st.floats(0.25, 4.0, width=32))


@settings(max_examples=12)
@given(
    picture=st.tuples(st.integers(1, 20), st.integers(1, 24), st.integers(0, 99)),
    template=st.tuples(st.integers(1, 6), st.integers(1, 7)),
    boxes=st.lists(st.tuples(unit, unit, step), min_size=1, max_size=3),
)
def test_kernels_do_what_their_twins_do(picture, template, boxes):
    rng = np.random.default_rng(picture[2])
    values = rng.integers(0, 256, picture[:2], dtype=np.uint8)
    weights = rng.normal(0, 30, template).astype(np.float32)
    th, tw = template
    found = kernel.moments_direct(values, weights, np.array(boxes).T.copy())
    for n, (u, v, s) in enumerate(boxes):
        assert found[0, n] * th * tw == pytest.approx(naive.cross(values, weights, u, v, s), rel=1e-4, abs=0.5)
        there = naive.patch(values, u, v, s, th, tw)
        assert found[1, n] == pytest.approx(np.var(there), rel=1e-4, abs=0.05)


@given(
    boxes=st.lists(
        st.tuples(st.floats(-90, 150), st.floats(-90, 150), st.sampled_from([1.0, 1.0, 0.5, 3.0, 0.01, -1.0, np.nan])),
        min_size=1, max_size=5,
    ),
    size=st.tuples(st.floats(4, 36), st.floats(4, 36)),
    picture=st.tuples(st.integers(20, 60), st.integers(20, 60)),
    most=st.sampled_from([8, None]),
)  # fmt: skip
@example(boxes=[(9.75, 3.0, 1.0)], size=(4.0, 4.0), picture=(20, 20), most=None)
def test_ncc_with_means_is_that_of_area_means_wherever_boxes_lie(boxes, size, picture, most):
    values = grey(np.random.default_rng(1).integers(0, 256, picture))
    template = matching.learn_template(values, size, states((picture[1] / 2, picture[0] / 2))[0], most)
    found = matching.correlate(template, values, states(boxes))[0]
    factor, (th, tw) = template.factor, template.centred.shape
    height, width = (side // factor for side in picture)
    seen = values.grey(factor, (0, 0, picture[1] - 1, picture[0] - 1))[0][:height, :width]
    centred, mean, variance = template.centred, template.mean, template.variance
    for n, (cx, cy, s) in enumerate(boxes):
        u = (cx - (factor - 1) / 2) / factor + s * (template.offset[0] - (tw - 1) / 2)
        v = (cy - (factor - 1) / 2) / factor + s * (template.offset[1] - (th - 1) / 2)
        edges, area = (u - s / 2, v - s / 2, u + s * (tw - 0.5), v + s * (th - 0.5)), s * s * tw * th
        square = naive.area_sum(seen, *edges, power=2) if s * min(th, tw) >= 1 else 0
        if square > 0:
            cross = naive.cross(seen, centred, u, v, s) / centred.size + mean * naive.area_sum(seen, *edges) / area
            expected = np.clip(cross / np.sqrt((variance + mean**2) * square / area), -1, 1)
            assert found[n] == pytest.approx(expected, abs=1e-3)
        else:
            assert found[n] == 0


@pytest.mark.parametrize("dense", [False, True])
def test_ncc_is_equation_10_between_pixels(dense, monkeypatch):
    monkeypatch.setattr(matching, "DENSE", 0.0 if dense else np.inf)
    values = np.random.default_rng(3).integers(0, 256, (60, 70))
    template = matching.learn_template(grey(values), (12.0, 9.0), states((30.5, 25.0))[0], None)
    # the last two over a border
    corners = [(25.0, 21.0), (25.5, 21.5), (26.3, 20.9), (20.0, 30.7), (25.01, 21.99), (-4.4, 10.2), (63.7, 54.6)]
    if not dense:
        corners += [(20.3, 18.8, 1.3), (12.6, 30.1, 0.7)]
    boxes = [(*corner, *(() if len(corner) == 3 else (1.0,))) for corner in corners]
    found = matching.correlate(template, grey(values), states([(u + 5.5 * s, v + 4 * s, s) for u, v, s in boxes]))
    for n, (u, v, s) in enumerate(boxes):
        seen = naive.patch(values, u, v, s, 9, 12)
        assert found[1][n] == pytest.approx(naive.ncc(template.centred + template.mean, seen, remove=True), abs=1e-5)
    whole = naive.patch(values, 25.0, 21.0, 1.0, 9, 12)
    assert found[0][0] == pytest.approx(naive.ncc(template.centred + template.mean, whole, remove=False), abs=1e-5)
