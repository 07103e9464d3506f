"""Which face of a frame is the target: what looks, places, cuts and company add, of faces that somebody has drawn."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.runs.api import track_video
from facetrack_cli.trackers.face import evidence
from facetrack_cli.trackers.face.detectors import Detection, yunet_model
from facetrack_cli.trackers.face.evidence import (
    AWAY,
    BOUND,
    CUT,
    MAX_LOOKS,
    NEAR,
    NEW,
    SHOT,
    SIDE,
    STAYS,
    Sighting,
    View,
    by_looks,
    by_place,
    is_likely,
    kept,
    likeness,
    look_of,
    nearest,
    own_views,
    prior,
    probabilities,
    sighted,
)
from facetrack_cli.trackers.face.stabilized import Similarity
from facetrack_cli.trackers.face.state import FaceState
from facetrack_cli.trackers.face.target import FaceTarget
from facetrack_cli.trackers.people import descriptor
from facetrack_cli.trackers.people.descriptor import SENSES, FaceDescriptor, Picture
from facetrack_cli.trajectory.trajectory import UNSEEN
from tests.support.samples import FOLDER

PASSERBY = FOLDER / "passerby.mp4"
BOX = (40.0, 30.0, 60.0, 60.0)
ELSEWHERE = (140.0, 60.0, 80.0, 80.0)


def portrait(seed):
    """(64, 64, 3) of blobs: another seed is another person."""
    noise = np.random.default_rng(seed).normal(0, 1, (64, 64)).astype(np.float32)
    blobs = cv2.GaussianBlur(noise, (0, 0), 5)
    return np.repeat((120 + 50 * blobs / blobs.std())[..., None], 3, axis=2).clip(0, 255)


def shown(*faces, time_s=0.0, turn=0.0, light=1.0):
    """A frame of 240x180 with a person in each box, turned by an angle."""
    picture = np.full((180, 240, 3), 100, np.float32)
    for (x, y, w, _), seed in faces:
        k, (a, b) = w / 64, (np.cos(turn), np.sin(turn))
        turned = k * np.array([[a, -b], [b, a]])
        middle = np.array([x + (w - 1) / 2, y + (w - 1) / 2])
        to = np.column_stack([turned, middle - turned @ np.full(2, 31.5)])
        picture = cv2.warpAffine(portrait(seed), to, (240, 180), picture, borderMode=cv2.BORDER_TRANSPARENT)
    return Frame(0, time_s, (light * picture).clip(0, 255).round().astype(np.uint8))


def look(box, seed, **how):
    middle = np.array([box[0] + (box[2] - 1) / 2, box[1] + (box[2] - 1) / 2])
    return look_of(Similarity(middle, box[2] / evidence.FACE, how.get("turn", 0.0)).read(shown((box, seed), **how)))


def seen(box, turn=0.0):
    x, y = box[0] + box[2] / 2, box[1] + box[2] / 2
    along = 10 * np.array([np.cos(turn), np.sin(turn)])
    return Detection(box, eyes=((x - along[0], y - along[1]), (x + along[0], y + along[1])))


PICTURE = Picture(np.zeros(0), np.zeros(0), 0.0)
OWN = (View(look(BOX, 1), PICTURE, True),)


def test_a_look_has_no_mean_and_unit_norm_and_does_not_know_the_light():
    one = look(BOX, 1)
    assert one.shape == (SIDE**2,) and one.sum() == pytest.approx(0, abs=1e-9) and one @ one == pytest.approx(1)
    assert one @ look(BOX, 1, light=0.6) > 0.99
    flat = look_of(Frame(0, 0.0, np.full((160, 160, 3), 90, np.uint8)))
    np.testing.assert_array_equal(flat, 0)


def test_a_person_is_alike_at_another_place_and_size_and_roll_and_another_is_not():
    assert likeness(OWN, look(ELSEWHERE, 1, turn=0.5)) > 0.9
    assert all(likeness(OWN, look(ELSEWHERE, seed)) < NEW for seed in range(2, 12))


def test_the_last_looks_are_kept_and_that_of_the_start_stays():
    views = OWN
    for seed in range(2, 12):
        views = kept(views, View(look(BOX, seed), PICTURE, True))
    assert len(views) == MAX_LOOKS and views[0].look is OWN[0].look
    assert views[-1].look @ look(BOX, 11) == pytest.approx(1)


def place(box, turn=0.0):
    return Similarity(np.array([box[0] + (box[2] - 1) / 2, box[1] + (box[2] - 1) / 2]), box[2] / evidence.FACE, turn)


def test_time_runs_from_the_first_sighting_of_a_face():
    first = Sighting(seen(ELSEWHERE, 0.3), 2.0)
    assert first.after(None) == first
    near = (ELSEWHERE[0] + 20, *ELSEWHERE[1:])
    assert Sighting(seen(near), 2.4).after(first).since == 2.0
    assert Sighting(seen(BOX), 2.4).after(first).since == 2.4, "another face: time begins anew"
    looks = first._replace(by_looks=-2.0)
    for odds, mean in ((1.0, -0.5), (4.0, 1.0)):
        looks = Sighting(seen(ELSEWHERE), 2.4, by_looks=odds).after(looks)
        assert looks.by_looks == pytest.approx(mean), "the mean of all views"


def test_a_face_is_followed_at_once_if_it_looks_so_else_if_it_stays_and_never_if_it_is_unlikely():
    face = Sighting(seen(BOX), 1.0, p=0.7, latest=3.0)
    assert face.is_target(shown(time_s=1.0)) and not face._replace(p=0.4).is_target(shown(time_s=9.0))
    waits = face._replace(latest=-3.0)
    assert not waits.is_target(shown(time_s=1.0 + 0.9 * STAYS)) and waits.is_target(shown(time_s=1.0 + STAYS))


def p_of(looks, others=0.0, *, cut=False, company=False, stranger_s=None):
    alone = prior(cut=cut, company=company, stranger_s=stranger_s)
    return probabilities(np.atleast_1d(looks), np.atleast_1d(others), alone)


def test_looks_decide_after_a_cut_or_in_company_and_no_look_denies_the_one_face_of_a_shot():
    for looks in np.linspace(-BOUND, BOUND, 9):
        assert p_of(looks, -AWAY * (looks > -2)) > 0.4
    assert p_of(-BOUND) > 0.5
    assert p_of(-1.0, cut=True) > 0.5 > p_of(-BOUND, cut=True)
    assert p_of(1.0, cut=True, company=True) > 0.5 > p_of(-1.0, company=True)
    assert p_of(-NEAR + 0.1, NEAR, company=True) > 0.5, "it is where it was: that counts as much as the looks"
    assert (p_of(0.0, cut=True), p_of(0.0)) == pytest.approx((1 / (1 + np.exp(-CUT)), 1 / (1 + np.exp(-SHOT))))


def test_who_walks_by_is_not_the_target_and_who_stays_may_be():
    assert p_of(-BOUND, stranger_s=2.0) < 0.2 < 0.5 < p_of(-BOUND, stranger_s=BOUND + 0.1)
    assert p_of(1.0, stranger_s=0.0) > 0.5, "a face that looks like the target is the target at once"
    assert p_of(0.0, stranger_s=60.0) == p_of(0.0) and p_of(0.0, cut=True, stranger_s=0.0) == p_of(0.0, cut=True)


def test_a_face_that_looks_otherwise_from_one_sighting_to_the_next_is_another_one():
    first = Sighting(seen(ELSEWHERE), 2.0, by_looks=-3.0, latest=-3.0)
    same, other = (Sighting(seen(ELSEWHERE), 2.1, by_looks=x, latest=x) for x in (0.5, 1.5))
    assert same.after(first).since == 2.0 and other.after(first) == other


def test_of_several_faces_the_likeliest_is_the_target_and_the_rest_is_nobody():
    p = p_of([2.0, -2.0, 0.5], 0.0, company=True)
    w = np.exp([2.0, -2.0, 0.5])
    np.testing.assert_allclose(p, w / (1 + w.sum()))
    assert len(p_of([], [])) == 0


def test_places_speak_for_a_face_where_the_target_was_and_against_others_while_it_is_covered():
    there = [place(BOX), place(ELSEWHERE), place((*BOX[:2], 2 * BOX[2], 2 * BOX[3]))]
    np.testing.assert_array_equal(by_place(place(BOX), there, covered=False), [NEAR, 0, 0])
    np.testing.assert_array_equal(by_place(place(BOX), there, covered=True), [NEAR, -AWAY, -AWAY])
    assert len(by_place(place(BOX), [], covered=True)) == 0


def test_looks_are_bounded(monkeypatch):
    def pictures(frame, *boxes):
        return [Picture.of(frame, place(box)._replace(scale=box[2])) for box in boxes]

    known = [View(OWN[0].look, picture) for picture in pictures(shown((BOX, 1)), BOX)]

    def like(looks, senses):
        return np.array([[100 * (one.face[0] @ looks[0].face[0] - 0.5) for one in looks]])

    monkeypatch.setattr(evidence, "same_person", like)
    found = by_looks(known, pictures(shown((BOX, 5), (ELSEWHERE, 1)), BOX, ELSEWHERE))
    np.testing.assert_allclose(found, [-BOUND, BOUND])
    assert len(by_looks(known, [])) == 0


@pytest.mark.parametrize(
    ("rest", "others", "model", "said", "asked"),
    [
        (2.0, CUT, True, (), 0),
        (1.5, CUT, True, (-4.2, -3.0), 2),
        (1.5, CUT, True, (-4.2, -4.2), 2),
        (1.5, CUT, True, (1.0, -4.2), 1),
        (-4.3, 0.0, True, (4.4, 0.0), 1),
        (-4.5, 0.0, True, (), 0),
        (0.1, 0.0, False, (), 0),
    ],
)
def test_the_embedding_looks_only_where_it_may_decide(monkeypatch, rest, others, model, said, asked):
    picture, other, face = (Picture.of(shown((BOX, seed)), place(BOX)) for seed in (1, 2, 1))
    views, by_view = [View(OWN[0].look, one) for one in (other, picture)], dict(zip((1, 2), said, strict=False))
    each, taken = {one.plain.face.tobytes(): which for one, which in ((picture, 1), (other, 2))}, []

    def same(looks, senses):
        taken.append(each[looks[0].face.tobytes()])
        return np.array([[0.0, by_view[taken[-1]]]])

    monkeypatch.setattr(evidence, "embedding_model", lambda: Path("a model") if model else None)
    monkeypatch.setattr(descriptor, "embedded", lambda chip: np.zeros(128))
    monkeypatch.setattr(evidence, "nearest", lambda views, faces, senses: np.array([rest]))
    monkeypatch.setattr(evidence, "same_person", same)
    assert is_likely(views, face, others) is (rest + max(said, default=0.0) + others > 0)
    assert taken == [1, 2][:asked], "that is most alike first"


def test_the_embedding_looks_at_a_sighting_where_that_may_now_be_the_target(monkeypatch):
    picture, face = Picture.of(shown((BOX, 1)), place(BOX)), seen(BOX)
    said = {"rest": -3.0, "all": -2.5}
    monkeypatch.setattr(evidence, "embedding_model", lambda: Path("a model"))
    monkeypatch.setattr(evidence, "by_looks", lambda views, faces: np.array([said["all"]]))
    monkeypatch.setattr(evidence, "nearest", lambda views, faces, senses: np.array([said["rest"]]))

    def after(before, time_s):
        [sighting] = sighted([face], [picture], [View(OWN[0].look, picture)], before, shown(time_s=time_s))
        return sighting

    first = after(None, 1.0)
    assert (first.by_looks, first.views) == (-3.0, 0) and np.isnan(first.latest), "it cannot be known by now"
    stays = after(first, 1.0 + STAYS)
    assert (stays.since, stays.by_looks, stays.latest, stays.views) == (1.0, -2.5, -2.5, 1)
    said["rest"] = -2.0
    assert after(first, 1.1)[-3:] == (-2.5, -2.5, 1), "it may be known"
    monkeypatch.setattr(evidence, "embedding_model", lambda: None)
    said["rest"] = said["all"] = -3.0
    assert after(None, 1.0)[-3:] == (-3.0, -3.0, 1), "there is none"


def test_a_skin_between_those_of_two_lights_is_of_somebody_else():
    def of(light, hair=150.0, worn=(0,)):
        each = np.eye(576)[:1], np.array([[light, 137.0, 144]]), np.array([[hair, 129, 135]]), np.eye(36)[[*worn]]
        return FaceDescriptor(*each, np.zeros((1, 0)), np.ones((1, 1)))

    bright, dark, other = of(176), of(142), of(159, hair=60, worn=(1,))
    both, first, last = (nearest(views, [other], SENSES)[0] for views in ([bright, dark], [bright], [dark]))
    assert both == max(first, last) < nearest([bright, dark], [bright, dark], SENSES).min() - 4


def test_views_of_who_walked_by_unnoticed_do_not_count(monkeypatch):
    own, other, small, dark, dusk = (Picture(PICTURE.chip, PICTURE.wide, side) for side in (200, 201, 40, 202, 203))
    alike = {(200, 200), (202, 202), (200, 203), (203, 202)}
    monkeypatch.setattr(evidence, "embedding_model", lambda: Path("a model"))
    monkeypatch.setattr(
        evidence,
        "by_looks",
        lambda views, faces, _: [max(4.0 if (v.picture.side, faces[0].side) in alike else -4.0 for v in views)],
    )

    def owned(*views):
        return [(view.picture.side, view.sure) for view in own_views([View(PICTURE.chip, *view) for view in views])]

    assert owned((own, True), (other, False), (own, False), (small, False)) == [(200, True), (200, True), (40, False)]
    assert owned((own, True), (dusk, False), (dark, False)) == [(200, True), (203, True), (202, True)], (
        "it grows dark by and by"
    )
    assert owned((own, True), (dark, False), (dusk, False)) == [(200, True), (203, True)]
    assert owned() == []


def test_a_face_that_changes_by_and_by_stays_its_own_when_its_first_views_are_gone(monkeypatch):
    def near(views, faces, senses):
        return [4.0 if min(abs(view.picture.side - faces[0].side) for view in views) < 2 else -4.0]

    monkeypatch.setattr(evidence, "embedding_model", lambda: Path("a model"))
    monkeypatch.setattr(evidence, "by_looks", near)
    views = (View(PICTURE.chip, Picture(PICTURE.chip, PICTURE.wide, 200), sure=True),)
    for side in range(201, 215):
        views = kept(views, View(PICTURE.chip, Picture(PICTURE.chip, PICTURE.wide, side)))
    assert [view.picture.side for view in own_views(views)] == [200, 210, 211, 212, 213, 214]


@pytest.mark.parametrize(("odds", "again"), [((0.9, -4.0, -4.0), (0.9, -4.0, -4.0)), ((0.9, -4.0, 1.0), None)])
def test_looks_at_a_face_in_its_place_are_apart_and_the_last_two_decide(monkeypatch, odds, again):
    face, each = Similarity(np.array([80.0, 60.0]), 1.5, 0.0), iter(odds)
    monkeypatch.setattr(evidence, "embedding_model", lambda: Path("a model"))
    monkeypatch.setattr(evidence, "look_of", lambda image: np.zeros(SIDE**2))
    monkeypatch.setattr(evidence, "by_who", lambda views, picture: next(each))
    tracker = SimpleNamespace(_laid_out=lambda similarity, detection: face)
    view = SimpleNamespace(similarity=face, detection=None, image=None)
    state, said = FaceState(*[None] * 9, views=OWN, last_seen=face, shots=None, again=()), []
    for time_s in (1.0, 1.1, 1.25, 1.5):
        state = FaceTarget._looked_again(tracker, state, view, shown(time_s=time_s))
        said.append(state.again)
    assert said == [odds[:1], odds[:1], odds[:2], again]


def test_a_face_of_the_stabilized_image_is_laid_out_in_the_frame():
    head, face = Similarity(np.array([80.0, 60.0]), 0.7, 0.3), seen(BOX, 0.2).similarity
    x = np.random.default_rng(0).uniform(0, 160, (5, 2))
    np.testing.assert_allclose(face.within(head).to_frame(x), head.to_frame(face.to_frame(x)))


@pytest.mark.skipif(yunet_model() is None, reason="needs the extra detect")
@pytest.mark.parametrize("init", ["yunet", Start(48, {"face": TargetStart((90.7, 72.0, 58.7, 58.7))}, "x")])
def test_a_face_that_walks_by_before_the_target_is_not_followed(monkeypatch, init):
    whose, taken = {}, Picture.of

    def of(frame, face):
        picture = taken(frame, face)
        # somebody else walks by from the left, and the face is seen again when he is on the right
        whose[picture.chip.tobytes()] = 72 <= frame.index < 92 or (frame.index < 110 and face.centre[0] > 192)
        return picture

    monkeypatch.setattr(Picture, "of", of)
    monkeypatch.setattr(descriptor, "embedded", lambda chip: 0.6 * np.eye(128)[int(whose[chip.tobytes()])])
    by_walk = {}
    for model in (None, Path("a model")):
        monkeypatch.setattr(evidence, "embedding_model", lambda model=model: model)
        box = track_video(PASSERBY, "face", init=init, start=48, stop=112).find("face", "box")
        rows = [box.row(frame) for frame in range(83, 95)]  # in which somebody else stands before the face
        by_walk[model is None] = np.isin(box.status[rows], UNSEEN).mean()
        back = box.row(108)
        assert abs(box.x[back] - 184) < 8 and box.status[back] == "tracked"
    assert by_walk[True] < 0.5 < 0.7 < by_walk[False]


@pytest.mark.skipif(yunet_model() is None, reason="needs the extra detect")
def test_somebody_else_after_a_cut_whose_points_are_not_seen_is_no_blurred_head(monkeypatch):
    seen, cut = FaceTarget._view, 45

    def view(self, state, head, frame, *, due):
        view = seen(self, state, head, frame, due=due)
        return view._replace(log_odds=0.0) if frame.index >= cut else view

    monkeypatch.setattr(FaceTarget, "_view", view)
    box = track_video(FOLDER / "film.mp4", "face", init="yunet", start=25, stop=47).find("face", "box")
    assert not np.isin(box.status[box.row(cut - 1)], UNSEEN) and np.isin(box.status[box.row(cut)], UNSEEN)
