"""people.json: who is in a film, corrections of that, and rows under names."""

import json

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.people import (
    People,
    ShotRecord,
    TrackRecord,
    merge,
    people_of,
    read_people,
    rename,
    split,
    under_names,
)
from facetrack_cli.trajectory.reader import PEOPLE
from facetrack_cli.trajectory.trajectory import build
from facetrack_cli.trajectory.views import Clock


def track(person, first, stop, **more):
    return TrackRecord(person=person, first=first, stop=stop, p=0.8, **more)


DOUBT = track("a", 60, 80, doubt=True, other="b", p_other=0.2)
TRACKS = [track("a", 0, 50), track("b", 20, 60), DOUBT, track("c", 90, 95, doubt=True, given=True)]
SHOTS = [ShotRecord(first=0, stop=60), ShotRecord(first=60, stop=None)]


def film():
    return people_of(Clock(None, 25.0), SHOTS, TRACKS, {"a": "people/a.jpg"}, {"c"})


def spans(tracks):
    return sorted((one.person, one.first, one.stop) for one in tracks)


def test_people_have_intervals_and_seconds_and_their_file_comes_back(tmp_path):
    people = film()
    assert people.names == ("a", "b", "c") and [one.photograph for one in people.people] == [False, False, True]
    assert people.people[0].intervals == ((0, 50), (60, 80)) and people.people[0].seconds == 2.8
    assert people.seconds_together() == {("a", "b"): 1.2}
    assert [one.first for one in people.doubts] == [60]
    assert read_people(tmp_path) is None
    (tmp_path / PEOPLE).write_bytes(people.text())
    assert read_people(tmp_path) == people == read_people(tmp_path / PEOPLE)
    broken = json.loads(people.text())
    broken["people"][0]["p"] = 2
    (tmp_path / PEOPLE).write_text(json.dumps(broken))
    with pytest.raises(InputError, match=r"people.json: people"):
        read_people(tmp_path)
    with pytest.raises(ValueError, match="version"):
        People.model_validate_json(people.text().replace(b'"version": 1', b'"version": 2'))


def test_corrections():
    tracks = film().tracks
    assert spans(merge(tracks, "c", "b")) == [("a", 0, 50), ("a", 60, 80), ("b", 20, 60), ("b", 90, 95)]
    assert spans(rename(tracks, "b", "Björk")) == [("Björk", 20, 60), ("a", 0, 50), ("a", 60, 80), ("c", 90, 95)]
    parts = split(tracks, "a", 70)
    assert spans(parts) == [("a", 0, 50), ("a", 60, 70), ("b", 20, 60), ("c", 90, 95), ("person_1", 70, 80)]
    assert {one.target for one in parts if one.person == "person_1"} == {"a"}
    again = people_of(Clock(None, 25.0), SHOTS, merge(parts, "person_1", "a"), {})
    assert again.people[0].intervals == ((0, 50), (60, 80)) and all(
        one.given for one in again.tracks if one.first == 70
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: merge(t, "a", "b"), "a and b are both seen in frame 20"),
        (lambda t: merge(t, "a", "a"), "that is one person already"),
        (lambda t: merge(t, "x", "a"), "there is no x; there are a, b, c"),
        (lambda t: rename(t, "a", "b"), "b is there; --merge a=b makes them one person"),
        (lambda t: rename(t, "a", "x/y"), "is no name"),
        (lambda t: rename(t, "a", "x@y=z"), "has = or @, by which options end a name"),
        (lambda t: split(t, "a", 0), "a is seen in frames 0 to 49, 60 to 79"),
        (lambda t: split(t, "a", 200), "give a frame between the first and the last"),
    ],
)
def test_what_cannot_be_is_refused(change, said):
    with pytest.raises(UsageError, match=said.replace("(", r"\(")):
        change(film().tracks)


def test_rows_go_to_the_people_of_their_tracks():
    frame = np.r_[0:50, 60:80, 20:60]
    which = np.r_[np.zeros(70, int), np.ones(40, int)]
    rows = build([("t1", "box"), ("t2", "box")], which, frame, x=np.arange(110.0))
    named = under_names(rows, [track("a", 0, 50, of="t1"), track("b", 20, 60, of="t2"), track("b", 60, 70, of="t1")])
    assert named.targets == ("a", "b")
    a, b = named.parts
    assert np.array_equal(a.frame, np.arange(50)) and np.array_equal(b.frame, np.arange(20, 70))
    assert np.array_equal(b.x, [*range(70, 110), *range(50, 60)])


def test_seconds_are_those_of_the_rows_and_not_of_a_rate():
    # 25 frames/s, then a third as many, after sound that begins 1.2 s before
    times = 1.2 + np.array([*(np.arange(50) / 25), *(2 + np.arange(40) * 0.12)])
    frame = np.array([*range(10, 60), *range(70, 90)])
    rows = build([("a", "box")], np.zeros(len(frame), int), frame, time_s=times[frame])
    clock = Clock(rows, 25.0)
    people = people_of(clock, SHOTS, [track("a", 10, 60), track("a", 70, 90), track("b", 55, 60)], {})
    one = people.people[0]
    assert one.times[0] == pytest.approx((times[10], times[60])) and one.times[1][0] == pytest.approx(times[70])
    assert one.seconds == pytest.approx(times[60] - times[10] + times[89] + 0.04 - times[70], abs=1e-3)
    assert people.seconds_together() == {("a", "b"): pytest.approx(0.6)}
    assert [clock.frame(clock.at(n)) for n in range(90)] == list(range(90))
    assert clock.frame(5.0) == int(np.argmin(np.abs(times - 5.0)))
    back = build([("a", "box")], np.zeros(3, int), np.arange(3), time_s=[3.0, 1.0, 2.0])
    assert people_of(Clock(back, 25.0), SHOTS, [track("a", 0, 2)], {}).people[0].seconds == 0, "times that go back"
    assert Clock(None, 25.0).frame(4.0) == 100 and clock.at(0) == pytest.approx(1.2)
