"""The recipe `signer`: two hands in one posterior, absent until they appear, on drawn clips whose truth is known."""

import math
from functools import cache

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.types import Correction, Frame, Start, TargetStart
from facetrack_cli.engine.loop import Footprint, track
from facetrack_cli.engine.protocols import Belief, Linear
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.hands import evidence
from facetrack_cli.trackers.hands import target as joint
from facetrack_cli.trackers.hands.evidence import shift_between
from facetrack_cli.trackers.hands.hand_kernels import weigh
from facetrack_cli.trackers.smoothed import renamed_hands
from facetrack_cli.trajectory.trajectory import Trajectory, successive

SKIN, HAND, SHELF = (120, 150, 205), (105, 140, 210), (115, 148, 206)  # blue, green, red
FACE = (140.0, 40.0, 40.0, 40.0)  # left, top, width, height
HEAD = Footprint(np.array([159.5, 59.5]), np.array([20.0, 20.0]))
SETTINGS = load_recipe("signer").hands
BODY = joint.Face(np.array([4.0, 1.0]), 1.0)  # the face in the evidence below, 16 pixels a size
COV, DOUBT = np.eye(2)[None], np.zeros(1, bool)
STAY = Linear(COV, np.zeros((1, 2)), COV)


@cache
def person():
    """Somebody before a wall with a shelf of the colour of skin."""
    rng = np.random.default_rng(3)
    image = np.full((240, 320, 3), (150, 140, 130), np.uint8)
    image[..., :] = np.clip(image + rng.integers(-6, 7, image.shape), 0, 255).astype(np.uint8)
    cv2.rectangle(image, (110, 100), (210, 239), (60, 40, 35), -1)
    cv2.rectangle(image, (20, 90), (60, 130), SHELF, -1)
    cv2.ellipse(image, (160, 60), (15, 20), 0, 0, 360, SKIN, -1)
    for x in (153, 167):
        cv2.circle(image, (x, 55), 2, (40, 40, 40), -1)
    cv2.ellipse(image, (160, 70), (5, 2), 0, 0, 360, (80, 80, 150), -1)
    return image


def drawn(index, hands=(), *, grey=False):
    """`hands` are the middles of discs, or of ellipses with the angle of their long axis in degrees."""
    image = person().copy()
    for x, y, *angle in hands:
        half = (22, 8) if angle else (14, 14)
        cv2.ellipse(image, (round(x), round(y)), half, angle[0] if angle else 0, 0, 360, HAND, -1)
    if grey:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    return Frame(index, index / 25, image)


def rows_of(frames, start=None, seed=0) -> Trajectory:
    start = start or Start(0, {"head": TargetStart(FACE)}, "x")
    results = list(track(build_tracker(load_recipe("signer"), start), iter(frames), seed))
    return successive([one.rows for one in results])


def rising(index):
    """Left and right hand: below the picture until frame 10, then up, then still before the chest."""
    y = 262 - 9 * min(max(index - 10, 0), 12)
    return (115.0, float(y)), (205.0, float(y))


@pytest.fixture(scope="module")
def risen() -> Trajectory:
    return rows_of(drawn(i, rising(i)) for i in range(40))


def test_hands_are_absent_until_they_appear_and_then_followed_by_their_names(risen):
    """A shelf of the colour of skin is never a hand."""
    for name, side in (("left_hand", 0), ("right_hand", 1)):
        one = risen.find(name, "box")
        assert not ((abs(one.x - 40) < 25) & (abs(one.y - 110) < 25)).any()
        assert {*one.status[:8]} == {"absent"} and np.isnan(one.x[:8]).all() and np.isnan(one.confidence[:8]).all()
        assert {*one.status[28:]} == {"tracked"}
        for i in range(24, 40):
            assert math.dist((one.x[i], one.y[i]), rising(i)[side]) < 10
        assert (abs(one.w[28:] - 28) < 8).all() and (abs(one.h[28:] - 28) < 8).all()  # of a disc of 29 pixels
    alone = rows_of(drawn(i) for i in range(12))
    assert {*alone.find(HANDS[0], "box").status, *alone.find(HANDS[1], "box").status} <= {"absent", "lost"}


def test_a_hand_that_leaves_the_picture_is_absent_again():
    rows = rows_of(drawn(i, rising(i if i < 26 else max(48 - i, 0))) for i in range(54))
    for name in HANDS:
        assert rows.find(name, "box").status[[25, 53]].tolist() == ["tracked", "absent"]


def test_a_given_hand_begins_there_and_the_other_one_when_it_appears():
    start = Start(0, {"head": TargetStart(FACE), "right_hand": TargetStart((191.0, 146.0, 29.0, 29.0))}, "x")
    rows = rows_of((drawn(i, ((205.0, 160.0), rising(i)[0])) for i in range(30)), start)
    right, left = rows.find("right_hand", "box"), rows.find("left_hand", "box")
    assert right.status[0] == "init" and (np.hypot(right.x - 205, right.y - 160) < 10).all()
    assert left.status[0] == "absent" and left.status[29] == "tracked"


def test_corrections_place_a_hand_and_say_that_it_is_absent():
    given = TargetStart((101.0, 140.0, 29.0, 29.0))
    there = Correction(12, "left_hand", given.box), Correction(20, "left_hand", absent=True)
    start = Start(0, {"head": TargetStart(FACE)}, "x", there)
    frames = [drawn(i, ((115.0, 154.0),) if i >= 12 else ()) for i in range(26)]
    rows = rows_of(frames, start)
    left, right = rows.find("left_hand", "box"), rows.find("right_hand", "box")
    assert left.status[12] == "init" and left.x[12] == pytest.approx(115, abs=3)
    assert {*left.status[13:20]} == {"tracked"} and {*left.status[20:]} == {"absent"}
    assert left.corrected[12] and left.corrected[20] and left.corrected.sum() == 2
    assert not right.corrected.any()


MEETING = (160.0, 130.0)


def meeting(index, side):
    """Left and right hand: together in frames 10 to 12, and from frame 22 on each on the other (1) or own side (-1)."""
    to = side if index > 11 else -1
    away = 40 * min(max(abs(index - 11) - 1, 0) / 9, 1)
    return [(MEETING[0] + sign * to * away, MEETING[1], -sign * 60) for sign in (1, -1)]


@pytest.mark.parametrize("side", [1, -1])
def test_forearms_say_which_hand_is_which_after_a_crossing_and_after_a_touch(side):
    given = {
        name: TargetStart((x - 14, y - 14, 29, 29)) for name, (x, y, _) in zip(HANDS, meeting(0, side), strict=True)
    }
    start = Start(0, {"head": TargetStart(FACE), **given}, "x")
    rows = rows_of((drawn(i, meeting(i, side)) for i in range(36)), start)
    for name, sign in zip(HANDS, (1, -1), strict=True):
        one = rows.find(name, "box")
        assert (np.hypot(one.x - MEETING[0] - sign * side * 40, one.y - MEETING[1])[28:] < 14).all()


def test_smoothing_exchanges_names_that_later_frames_deny():
    rows = rows_of(drawn(i, rising(i)) for i in range(24))
    left, right = (rows.find(name, "box") for name in HANDS)
    seen = np.isfinite(left.x) & np.isfinite(right.x)
    beliefs = {}
    for one in (left, right):
        whole = np.array([0.55 if i < 20 else 1.0 for i in range(24)])
        beliefs[one.target] = [
            (Belief(np.array([[x, y]]), COV, STAY, DOUBT, np.array([p, 1.0 if i == 20 else 0.0])),)
            if np.isfinite(x) else ()
            for i, (x, y, p) in enumerate(zip(one.x, one.y, whole, strict=True))
        ]  # fmt: skip
    after, known = renamed_hands(rows, {"head": [()] * 24, **beliefs})
    changed = after.find("left_hand", "box")
    assert seen[18:].all()
    assert (changed.x[18:20] == right.x[18:20]).all() and (changed.x[20:] == left.x[20:]).all()
    assert (after.find("right_hand", "box").x[18:20] == left.x[18:20]).all()
    assert known["left_hand"][19] == beliefs["right_hand"][19] and known["left_hand"][20] == beliefs["left_hand"][20]
    assert after.find("head", "box").x.tolist() == rows.find("head", "box").x.tolist()


def test_an_init_file_corrects_hands_that_it_does_not_begin_with(tmp_path):
    file = tmp_path / "c.yaml"
    text = "frame: 0\n{}: {{box: [140, 40, 40, 40]}}\ncorrections:\n  - {{frame: 4, left_hand: {{absent: true}}}}\n"
    file.write_text(text.format("head"))
    start = read_init(file)
    assert start.corrections == (Correction(4, "left_hand", absent=True),)
    assert rows_of((drawn(i) for i in range(6)), start).find("left_hand", "box").corrected[4]
    file.write_text(text.format("face"))
    with pytest.raises(InputError, match="corrects left_hand, which the recipe does not follow: it follows face;"):
        build_tracker(load_recipe("correlation_filter"), read_init(file))


def test_a_grey_clip_is_refused_in_one_line():
    with pytest.raises(InputError, match="the face has no colour") as refused:
        rows_of(drawn(i, grey=True) for i in range(3))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("radius", "off", "corners"), [(3.25, 1e-5, [(0, 0), (21, 24)]), (6.5, 0.03, [])])
def test_disc_means_are_those_of_a_plain_loop(radius, off, corners):
    e, reach = cv2.GaussianBlur(np.random.default_rng(0).random((22, 25)).astype(np.float32), (0, 0), 0.7), 7
    for row, column in ((0, 7), (5, 6), (8, 2), *corners):
        y, x = np.mgrid[row - reach : row + reach + 1, column - reach : column + reach + 1]
        weight = np.clip(radius + 0.5 - np.hypot(x - column, y - row), 0, 1)
        inside = (y >= 0) & (y < 22) & (x >= 0) & (x < 25)
        total = (weight * inside * e[y.clip(0, 21), x.clip(0, 24)]).sum() / weight.sum()
        expected = total / max((weight * inside).sum() / weight.sum(), 0.35)
        assert joint.disc_means(e, radius)[row, column] == pytest.approx(expected, abs=off)


def log_likelihood(x, seen, parted, maps, scale):
    out, of = np.zeros(len(x)), (SETTINGS.radius, SETTINGS.evidence, SETTINGS.skin)
    weigh(x, seen, parted, *maps, BODY.at, BODY.size, scale, *of, out)
    return out


def likelihood(blobs, at, *, line=None, parted=True):
    """log p of two hands at places in sizes, where `blobs` are discs of skin."""
    scale, e = 16.0, np.zeros((96, 128), np.float32)
    for x, y in blobs:
        cv2.circle(e, (round(x * scale), round(y * scale)), 6, 1.0, -1)
    if line is not None:
        cv2.line(e, *(tuple(round(v * scale) for v in place) for place in line), 1.0, 6)
    share = joint.disc_means(e, SETTINGS.radius * scale)
    fit = SETTINGS.evidence * (share - SETTINGS.skin)
    x = np.zeros((1, 2, 4))
    x[0, :, :2] = at
    seen, parted = np.ones((1, 2), bool), np.array([parted])
    return float(log_likelihood(x, seen, parted, (fit, share, e), scale)[0])


def test_the_likelihood_of_two_hands():
    """Greatest with a hand at each place; two places of one bare arm, or near each other and never apart, are one."""
    two = ((3.0, 3.0), (5.0, 3.5))
    best = likelihood(two, two)
    assert best == likelihood(two, two[::-1]) > max(likelihood(two, (one, one)) for one in two)
    for off in ((0.3, 0), (0, 0.3), (-0.3, 0), (0, -0.3)):
        assert best > likelihood(two, (np.add(two[0], off), two[1]))
    far = ((3.0, 4.5), (3.8, 3.0))
    assert likelihood(far, far) > SETTINGS.evidence > likelihood(far, far, line=far)
    near = ((3.0, 3.5), (3.85, 3.5))
    assert likelihood(near, near, line=near) > likelihood(near, near, line=near, parted=False) + 10
    assert likelihood(near, near) == likelihood(near, near, parted=False)  # no skin between
    arm, nobody = ((2.6, 4.6), (4.0, 2.6)), (9.0, 9.0)
    end, *middle = (likelihood(arm[1:], (at, nobody), line=arm) for at in (arm[1], (3.3, 3.6), (3.2, 3.7)))
    assert end > max(middle) + 1


def test_a_hand_leaps_to_more_skin_but_not_along_its_arm():
    settings = SETTINGS.model_copy(update={"appears": 0.0, "proposed": 0.3, "particles": 2000})
    scale, face, ends = 16.0, BODY, []
    for arm in (0.0, 0.6):
        e = np.zeros((96, 128), np.float32)
        cv2.line(e, (48, 24), (48, 64), arm, 6)
        cv2.circle(e, (48, 24), 6, 0.45, -1)
        cv2.circle(e, (48, 64), 6, 1.0, -1)
        rng = np.random.default_rng(2)
        cloud = joint.begin(rng, settings, face, np.array([[3.0, 1.5], [np.nan, np.nan]]))
        for _ in range(6):
            cloud, belief = joint.step(rng, settings, cloud, evidence.Seen(e, 0 * e), scale, face)
        ends.append(float(belief.at[0, 1]))
    assert ends == pytest.approx([4.0, 1.6], abs=0.2)


def test_an_arm_that_leaves_the_picture_is_no_hand_in_it():
    def present(y, skin, seen=1.0, face=BODY):
        at, spread, form = np.array([[3.0, y], [5.0, y]]), np.zeros((2, 2, 2)), np.zeros((2, 3))
        belief = joint.Belief(np.full(2, seen), at, spread, np.ones(2), 1.0, np.full(2, skin), form)
        return joint.in_picture(joint.cues(belief, face, 4.6))[0]

    assert present(2.5, 0.6) > 0.95 and present(2.5, 0.6, seen=0.0) < 0.1
    assert present(4.5, 0.3) < 0.4 < 0.8 < present(2.5, 0.3)
    raised = joint.Face(np.array([4.0, 0.1]), 1.0)
    assert present(4.5, 0.5, face=raised) > 0.95  # where hands hang


def test_one_step_has_the_posterior_of_a_grid():
    """p(x_1 | y_1) of one hand that is seen, with the other one never seen, by sums over a grid."""
    settings = SETTINGS.model_copy(update={"particles": 40_000, "appears": 0.0, "vanishes": 0.0})
    scale, face = 16.0, BODY
    e = np.zeros((96, 128), np.float32)
    cv2.circle(e, (52, 50), 6, 0.6, -1)
    given = np.array([[3.1, 3.0], [np.nan, np.nan]])
    rng = np.random.default_rng(5)
    cloud = joint.begin(rng, settings, face, given)
    _, belief = joint.step(rng, settings, cloud, evidence.Seen(e, 0 * e), scale, face)
    rows, columns = np.mgrid[0:96, 0:128]
    places = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    off = np.sum((places / scale - given[0]) ** 2, axis=1)
    prior = np.zeros(len(places))
    for sigma, share in zip(settings.steps, settings.shares, strict=True):
        var = sigma**2 + joint.START**2
        prior += share * np.exp(-0.5 * off / var) / var
    x = np.zeros((len(places), 2, 4))
    x[:, 0, :2] = places / scale
    share = joint.disc_means(e, settings.radius * scale)
    fit, _, _ = joint.fitted(settings, share, scale, face)
    only = np.tile([True, False], (len(places), 1))
    log_p = np.log(prior) + log_likelihood(x, only, only[:, 1], (fit, share, e), scale)
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    assert belief.seen.tolist() == pytest.approx([1, 0])
    assert belief.at[0] == pytest.approx(p @ places / scale, abs=0.02)


def test_evidence_is_what_is_new_and_of_this_skin():
    scene, first = evidence.begin(drawn(0), HEAD)
    assert first.evidence.max() < 0.5 and scene.factor == 2
    scene, (e, _) = evidence.look(scene, drawn(1, ((160.0, 160.0),)), HEAD)
    assert e[80, 80] > 0.8 and e[55, 20] < 0.05  # the hand, and the shelf
    _, (e, _) = evidence.look(scene, drawn(2, ((160.0, 66.0),)), HEAD)  # before mouth and chin
    assert e[33, 80] > 0.5
    assert e[33, 80] > 5 * evidence.look(scene, drawn(2), HEAD)[1].evidence[33, 80]


@pytest.mark.parametrize(
    "at", [(159.5, 59.5), (4.0, 3.0), (-60.0, 90.0), (200.0, -90.0), (318.0, 237.0), (500.0, 60.0)]
)
def test_what_the_head_covers_is_that_of_the_whole_frame(at):
    scene, _ = evidence.begin(drawn(0), HEAD)
    _, seen = evidence.look(scene, drawn(1), Footprint(np.array(at), HEAD.half))
    to = evidence._map(evidence.to_map(np.array(at), scene.factor), scene.side, scene.side)
    inner = np.pad(np.ones(np.subtract(scene.face.shape[:2], 2), np.float32), 1)
    soft = cv2.GaussianBlur(inner, (0, 0), 1.0, borderType=cv2.BORDER_CONSTANT)
    covered = cv2.warpAffine(soft, to, (160, 120))
    side = 2 * round(evidence.REACHES * scene.side) + 1
    expected = cv2.dilate(covered, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    np.testing.assert_allclose(seen.face, expected, atol=0.06)


@pytest.mark.parametrize("light", [(0.8, 0.98, 1.1), (1.1, 1.1, 1.1)])
def test_a_camera_that_sets_its_light_anew_shows_no_hand(light):
    def lit(index, hands=()):
        share = min(index / 5, 1.0)
        image = drawn(index, hands).bgr * (1 + share * (np.array(light) - 1))
        return Frame(index, index / 25, np.clip(np.rint(image), 0, 255).astype(np.uint8))

    scene, _ = evidence.begin(lit(0), HEAD)
    for index in range(1, 12):
        scene, seen = evidence.look(scene, lit(index), HEAD)
        assert seen.evidence.max() < 0.5
    _, seen = evidence.look(scene, lit(12, ((160.0, 160.0),)), HEAD)
    assert seen.evidence[80, 80] > 0.8


def test_a_head_that_is_restless_without_hands_needs_more_to_be_covered():
    """Each frame its light comes from elsewhere: that is no hand, and a hand is still seen."""

    def restless(index, hands=()):
        image = drawn(index, hands).bgr.astype(np.float32)
        image[30:95, 130:190] += 18 * np.sin(index * 1.7) * np.linspace(-1, 1, 60)[None, :, None]
        return Frame(index, index / 25, np.clip(image, 0, 255).astype(np.uint8))

    scene, _ = evidence.begin(restless(0), HEAD)
    calm, shown = scene.unrest, []
    for index in range(1, 30):
        scene, seen = evidence.look(scene, restless(index), HEAD)
        shown.append(seen.evidence[22:40, 70:90].mean())
    assert scene.unrest > 1.5 * calm and max(shown[-10:]) < 0.2
    assert evidence.look(scene, restless(30, ((160.0, 66.0),)), HEAD)[1].evidence[33, 80] > 0.8


def test_the_face_whose_hands_move_is_the_signer(tmp_path):
    """A large person who keeps still, and a small one in the corner who signs."""
    for index in range(30):
        frame = np.full((360, 640, 3), (150, 140, 130), np.uint8)
        frame[:, :320] = cv2.resize(drawn(0).bgr, (480, 360))[:, 80:400]
        move = rising(index) if index < 24 else [(x, y + 12 * math.sin(index)) for x, y in rising(index)]
        frame[180:, 400:] = cv2.resize(drawn(index, move).bgr, (240, 180), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(tmp_path / f"{index:03}.png"), frame)
    large, small = (130.0, 60.0, 60.0, 60.0), (505.0, 210.0, 30.0, 30.0)
    recipe = load_recipe("signer")
    begin = ClipRequest(tmp_path)
    both = Start(0, {"head": TargetStart(large), "face_2": TargetStart(small)}, "yunet", note="begins, and 1 more")
    chosen = begin._signer(recipe, both)
    assert chosen.targets == {"head": TargetStart(small)}
    assert "30 pixels wide, whose hands move most, by yunet; passed over: 1 more" in chosen.note
    alone = Start(0, {"head": TargetStart(large)}, "yunet")
    assert begin._signer(recipe, alone) == alone


def test_presence_and_place_are_two_numbers(risen):
    """A hand on its way up is fast: its place is less sure than that it is there."""
    told, one = risen.diagnostics["left_hand"], risen.find("left_hand", "box")
    assert (told.get("present")[:8] < 0.1).all() and (told.get("present")[28:] > 0.85).all()
    fast = [i for i in range(14, 22) if np.isfinite(one.x[i])]
    assert fast and all(told.get("present")[i] > 0.8 > one.confidence[i] for i in fast[1:-1])
    assert (told.get("named")[28:] > 0.9).all() and (told.get("named") >= 0.5).all()


def parts(size, x, y, seed=0):
    """Two parts of one texture, the second of which sees it moved by (x, y)."""
    width, height = size
    rng = np.random.default_rng(seed)
    whole = cv2.GaussianBlur(rng.random((height + 20, width + 20), np.float32) * 255, (0, 0), 1.5)
    return whole[10 : 10 + height, 10 : 10 + width].copy(), whole[10 - y : 10 - y + height, 10 - x : 10 - x + width]


@pytest.mark.parametrize("size", [(240, 135), (45, 80), (81, 75), (25, 27), (160, 120), (64, 120)])
def test_equal_images_are_not_shifted_and_moved_ones_by_their_motion(size):
    same, _ = parts(size, 0, 0)
    shift, sure = shift_between(same, same.copy())
    assert shift == pytest.approx([0, 0], abs=1e-3) and sure > 0.95
    for x, y in ((2, -1), (-3, 2), (0, 4)):
        before, after = parts(size, x, y)
        kept = before.copy()
        shift, sure = shift_between(before, after)
        assert shift == pytest.approx([x, y], abs=0.1) and sure > 0.6
        assert (before == kept).all()
