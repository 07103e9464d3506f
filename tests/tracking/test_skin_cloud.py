"""Clouds of skin pixels and several targets in the whole engine, on made-up clips whose ground truth is known."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from tests.support.parts import skin_cloud
from tests.support.results import rows_of

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


def start(*names):
    known = {"head": HEAD, "left_hand": LEFT, "right_hand": RIGHT}
    return Start(0, {name: TargetStart(box=box(known[name])) for name in names}, "clip.init.yaml")


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
    results = run(config, frames(clip), start(*ALL))
    true = np.array([[ellipse[:2] for ellipse in row] for row in clip])
    found = places(results)
    assert [target.rows.target for target in results[0].targets] == list(ALL)
    off = np.hypot(*np.moveaxis(found[..., :2] - true, 2, 0))
    assert off.mean(axis=0).max() < 6 and np.quantile(off, 0.95) < 14
    assert {p.status for p in rows_of(results[0].rows)} == {"init"}
    assert all(p.status == "tracked" for r in results[1:] for p in rows_of(r.rows))


def test_the_size_of_a_cloud_is_that_of_the_skin():
    """Four standard deviations a side are exact of an ellipse that is evenly filled."""
    still = [(HEAD, LEFT, RIGHT)] * 16
    found = places(run("head_hands_cloud", frames(still), start(*ALL)))
    np.testing.assert_allclose(found[0, :, 2:], [[44, 56], [28, 28], [28, 28]])
    np.testing.assert_allclose(found[6:, :, 2:].mean(axis=0), [[44, 56], [28, 28], [28, 28]], rtol=0.15)


def test_hands_that_meet_the_face_do_not_take_it_and_go_on_their_way():
    """Without exclusion, the cloud of a hand that passes over the face would stay on it."""
    across = [(HEAD, (70 + 4.0 * t, 62.0, 14.0, 14.0), RIGHT) for t in range(30)]
    begin = Start(0, {name: TargetStart(box=box(e)) for name, e in zip(ALL, across[0], strict=True)}, "x")
    kept, lost = (
        places(run("head_hands", frames(across), begin, 0, more))[-1, 1, 0] for more in ((), ["exclusion=null"])
    )
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
