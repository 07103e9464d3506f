"""Who is who in a film: tracks, their log odds, and what excludes."""

import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.trackers.face.detectors import Detection
from facetrack_cli.trackers.face.stabilized import Similarity
from facetrack_cli.trackers.people import descriptor
from facetrack_cli.trackers.people.descriptor import (
    SENSES,
    SURE,
    UNKNOWN,
    VIEWS,
    Describer,
    FaceDescriptor,
    TrackSummary,
    View,
    cast_of,
    clusters,
    load_people,
    same_person,
    save_people,
)


def unit(seed, size):
    x = np.random.default_rng(seed).normal(size=size)
    return x / np.linalg.norm(x)


def looks(person, seed=0, views=VIEWS, spread=0.02, embedded=True, worth=1.0):
    """Views of a person, which differ a little."""
    rng = np.random.default_rng(1000 * person + seed)
    face = np.array([unit(person, 576) + spread * rng.normal(size=576) for _ in range(views)])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    skin = np.tile([120.0, 140 + 8 * person, 140], (views, 1)) + rng.normal(0, 0.5, (views, 3))
    worn = np.tile(np.roll([0.6, 0.4, *[0.0] * 34], 3 * person), (views, 1))
    embedding = np.array([0.6 * unit(person + 50, 128) + 0.02 * rng.normal(size=128) for _ in range(views)])
    embedding = embedding if embedded else np.zeros((views, 0))
    return FaceDescriptor(face, skin, skin - 60, worn, embedding, np.full((views, 1), worth))


def track(name, person, first, stop, at=(0.0, 0.0), shot=None, **more):
    box = (*at, 50.0, 50.0)
    return TrackSummary(name, first, stop, box, box, first if shot is None else shot, looks(person, first, **more))


def slow_odds(a, b):
    """The sum of what each sense says, bounded, one pair of tracks after another."""
    worth = min(a.worth.mean(), b.worth.mean())
    total = 0.0
    for key in ("face", "embedding"):
        (at, own, by), against, speaks_for = SENSES[key]
        far = sorted(float(np.linalg.norm(x - y)) for x in getattr(a, key) for y in getattr(b, key))
        far = np.mean(far[: len(far) // 8])  # the smallest eighth of the distances
        total += np.clip(worth * (at + own * worth + by * far), -against, speaks_for)
    (at, *by), against, speaks_for = SENSES["colour"]
    ends = [[np.median(getattr(one, key), axis=0) for key in ("skin", "hair", "worn")] for one in (a, b)]
    far = [np.linalg.norm((x - y) * [0.4, 1, 1]) for x, y in zip(ends[0][:2], ends[1][:2], strict=True)]
    far.append(0.5 * np.sum((ends[0][2] - ends[1][2]) ** 2 / (ends[0][2] + ends[1][2] + 1e-9)))
    return total + np.clip(at + np.dot(by, np.exp(-np.array([far[0], *far]) / descriptor._NEAR)), -against, speaks_for)


def test_log_odds_are_those_of_the_slow_twin():
    all_ = [looks(1), looks(1, 5, worth=0.3), looks(2), looks(3, worth=0.6)]
    odds = same_person(all_)
    for i, one in enumerate(all_):
        for j, other in enumerate(all_):
            if i != j:
                assert odds[i, j] == pytest.approx(slow_odds(one, other), abs=0.01)


@pytest.mark.parametrize("embedded", [True, False])
def test_tracks_of_one_person_are_told_from_those_of_others(embedded):
    odds = same_person([looks(1, 1, embedded=embedded), looks(1, 2, embedded=embedded), looks(2, embedded=embedded)])
    assert odds[0, 1] > 2 and odds[0, 2] < -2 and odds[1, 2] < -2
    assert np.array_equal(odds, odds.T)
    few = same_person([looks(1, 1, views=1), looks(1, 2), looks(2, views=3)])
    assert few[0, 1] > 0 > few[0, 2]


def test_senses_that_are_not_asked_do_not_look():
    both, alone = (descriptor.distances([looks(1), looks(2)], senses) for senses in (SENSES, ("embedding",)))
    assert [*both] == [*SENSES] and [*alone] == ["embedding"]
    assert np.array_equal(both["embedding"], alone["embedding"])


def test_a_face_that_cannot_be_told_again_is_nobody_unless_it_goes_on_in_its_place():
    clear, blurred = track("a", 1, 0, 40), track("b", 2, 60, 90, at=(300.0, 0.0), worth=0.02)
    cast = cast_of([clear, blurred, track("c", 3, 100, 140, at=(600.0, 0.0))])
    assert cast.person.tolist() == [0, UNKNOWN, 1]
    [doubt] = [one for one in cast.doubts if one.track == 1]
    assert cast.p[1] < SURE and doubt.p < SURE
    both = cast_of([clear, track("b", 2, 40, 90, worth=0.02, shot=0)])
    assert both.person.tolist() == [0, 0]
    two = cast_of([blurred, blurred._replace(name="d", first=200, stop=240, shot=200)])
    assert two.person.tolist() == [UNKNOWN, UNKNOWN], "two blurred heads are not one person"


def says(monkeypatch, *odds):
    """Let the senses say this of a pair of tracks."""
    monkeypatch.setattr(descriptor, "_senses", lambda looks: np.array([[[0.0, one], [one, 0.0]] for one in odds]))


def test_one_sense_alone_does_not_part_a_face_from_itself_over_a_cut(monkeypatch):
    first, then = near = [track("a", 1, 0, 40), track("b", 1, 42, 90, at=(5.0, 0.0))]
    others = [then._replace(begins=box) for box in ((300.0, 0.0, 50.0, 50.0), (0.0, 0.0, 90.0, 90.0))]
    says(monkeypatch, 1.0, -3.3, 0.5)  # she weeps, and embeddings do not know her
    found = cast_of(near)
    assert found.person.tolist() == [0, 0] and (found.p < 0.95).all()
    for other in (*others, then._replace(first=70)):  # elsewhere, larger, later
        assert cast_of([first, other]).person.tolist() == [0, 1]
    says(monkeypatch, -1.5, -3.3, 0.5)
    assert cast_of(near).person.tolist() == [0, 1], "two senses do"


def test_people_are_counted_as_they_come_and_two_faces_of_one_frame_are_two_people():
    tracks = [track(str(i), person, 50 * i, 50 * i + 40) for i, person in enumerate((2, 1, 2, 1))]
    cast = cast_of(tracks)
    assert cast.person.tolist() == [0, 1, 0, 1] and (cast.p > 0.9).all() and not cast.doubts
    for first, expected in ((39, [0, 1]), (40, [0, 0])):
        assert cast_of([track("a", 1, 0, 40), track("b", 1, first, 90)]).person.tolist() == expected


def test_a_track_that_goes_on_in_its_place_is_the_same_sooner(monkeypatch):
    says(monkeypatch, -1.0)
    near = [track("a", 1, 0, 40, shot=1), track("b", 1, 50, 90, at=(10, 0), shot=1)]
    assert cast_of(near).person.tolist() == [0, 0]
    assert cast_of([near[0], near[1]._replace(shot=2)]).person.tolist() == [0, 1]
    assert cast_of([near[0], near[1]._replace(begins=(300.0, 0.0, 50.0, 50.0))]).person.tolist() == [0, 1]


def test_what_is_in_doubt_says_whom_else_it_may_be(monkeypatch):
    odds = np.array([[0.0, -6, 1.0], [-6, 0, 0.6], [1.0, 0.6, 0]])
    monkeypatch.setattr(descriptor, "_senses", lambda looks: odds[None])
    cast = cast_of([track("a", 1, 0, 40), track("b", 2, 60, 90), track("c", 1, 120, 140)])
    assert cast.person.tolist() == [0, 1, 0]
    whole = np.exp([1.0, 0.6, 0.0])
    [doubt] = [one for one in cast.doubts if one.track == 2]
    assert cast.p[2] == pytest.approx(whole[0] / whole.sum()) and doubt.other == 1
    assert doubt.p == pytest.approx(whole[1] / whole.sum())


@pytest.mark.parametrize("embedded", [True, False])
def test_known_people_have_the_first_numbers_whoever_comes_first(embedded):
    tracks = [track("a", 3, 0, 40, embedded=embedded), track("b", 2, 50, 90, embedded=embedded)]
    cast = cast_of(tracks, [looks(1, 7), looks(2, 7), looks(4, 7)])
    assert cast.person.tolist() == [3, 1] and (cast.p > 0.8).all()
    assert len(cast_of([], [looks(1)]).person) == 0


def test_known_people_are_read_as_they_were_saved(tmp_path):
    people = {"Ann": looks(1), "Bob": looks(2, views=3)}
    save_people(tmp_path / "people.npz", people)
    found = load_people(tmp_path / "people.npz")
    assert list(found) == ["Ann", "Bob"]
    for name, key in itertools.product(people, FaceDescriptor._fields):
        np.testing.assert_array_equal(getattr(people[name], key), getattr(found[name], key))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"which": np.zeros(3, "<i8")}, "do not belong together"),
        ({"names": np.array(["Ann", "Ann"])}, "do not belong together"),
        ({"face": np.zeros((11, 100))}, "another size"),
        ({"skin": np.array(["x"] * 11)}, "skin"),
    ],
)
def test_a_file_of_other_arrays_is_refused(tmp_path, change, message):
    save_people(tmp_path / "people.npz", {"Ann": looks(1), "Bob": looks(2, views=3)})
    with np.load(tmp_path / "people.npz") as held:
        arrays = {**held, **change}
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(InputError, match=message):
        load_people(tmp_path / "other.npz")


class Sees:
    """A detector that gives a face in the middle of what it measures one score after another; of 0 it sees none."""

    name = "scores"

    def __init__(self, *scores):
        self.scores = iter(scores)

    def measure(self, image, box):
        score = next(self.scores)
        return Detection(box, score=score) if score else None


def reader_of(*scores, blur=0.0):
    rng = np.random.default_rng(0)
    large, fine = (cv2.resize(rng.random((n, n, 3)), (200, 200), interpolation=cv2.INTER_CUBIC) for n in (6, 60))
    image = np.clip(160 * large + 80 * fine, 0, 255).astype(np.uint8)
    image = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    reader = Describer(Sees(*scores))
    for k in range(len(scores)):
        reader.see(Frame(k, k / 25, image), View(k, Similarity(np.array([100.0, 100.0]), 90.0), 1.0))
    return reader


def test_a_fist_is_no_face_and_a_face_that_turns_away_is_one():
    for scores, face in (((0.92,) * 3, True), ((0.9, 0.88, 0, 0), True), ((0, 0.78, 0, 0), False), ((0.0,) * 2, False)):
        assert reader_of(*scores).is_face == face


def test_a_blurred_view_and_one_that_the_detector_is_unsure_of_are_worth_less():
    whole, unsure, none = (reader_of(score).looks().worth.item() for score in (0.95, 0.8, 0.0))
    assert whole > 0.5 and 0 < unsure < 0.5 * whole and none == 0
    assert reader_of(0.95, blur=4.0).looks().worth.item() < 0.5 * whole


def test_a_face_is_embedded_the_same_each_time_and_another_otherwise():
    one, other = np.random.default_rng(0).integers(0, 256, (2, descriptor.CHIP_PX, descriptor.CHIP_PX, 3), np.uint8)
    embedded = descriptor.embedded.__wrapped__  # which the other tests ask once for each face
    found = [embedded(chip) for chip in (one, one, other)]
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0].shape == ((0,) if descriptor.embedding_model() is None else (128,))
    assert not found[0].size or np.abs(found[0] - found[2]).max() > 0.01


def test_the_better_view_of_two_is_embedded_once_and_stands_for_both(monkeypatch):
    seen = []
    monkeypatch.setattr(descriptor, "embedded", lambda chip: seen.append(0) or np.full(128, len(seen), float))
    scores = (0.88, 0.95, 0.0, 0.76, 0.9, 0.89, 0.88, 0.89)
    reader = reader_of(*scores)
    assert reader.looks(1).embedding[:, 0].tolist() == [1] * 8 and len(seen) == 1  # the best view alone
    first, again = reader.looks(), reader.looks()
    assert len(seen) == 3 and (first.embedding == again.embedding).all()
    assert first.embedding[:, 0].tolist() == [1, 1, 1, 2, 2, 2, 3, 3]  # no view of the second pair is any good
    monkeypatch.setattr(descriptor, "embedded", lambda chip: np.zeros(0))
    assert reader_of(*scores).looks().embedding.shape == (8, 0)


def slow_clusters(odds, apart):
    """Average linkage by its definition."""
    groups = [[i] for i in range(len(odds))]
    while True:
        pairs = [
            (np.mean([odds[i, j] for i in a for j in b]), -x, -y)
            for x, a in enumerate(groups)
            for y, b in enumerate(groups)
            if x < y and not any(apart[i, j] for i in a for j in b)
        ]
        if not pairs or max(pairs)[0] <= 0:
            return {frozenset(one) for one in groups}
        _, x, y = max(pairs)
        groups[-x] += groups[-y]
        del groups[-y]


@given(st.integers(0, 10_000), st.integers(2, 9))
def test_clusters_are_those_of_the_slow_twin_and_hold_no_two_that_are_apart(seed, count):
    rng = np.random.default_rng(seed)
    odds, apart = rng.normal(size=(count, count)), rng.random((count, count)) < 0.2
    odds, apart = odds + odds.T, apart | apart.T
    np.fill_diagonal(apart, False)
    label = clusters(odds, apart)
    assert {frozenset(np.flatnonzero(label == one).tolist()) for one in set(label.tolist())} == slow_clusters(
        odds, apart
    )
