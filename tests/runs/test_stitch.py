"""Where two chunks of a clip meet: what counts as agreement, and the names of several faces."""

from __future__ import annotations

import numpy as np
import pytest

from facetrack_cli.runs.stitch import Seam, agreeing, renamed, stitch
from facetrack_cli.trajectory.trajectory import joined, one_part

NAN = np.nan


def box(target, first, stop, x=50.0, side=20.0, status="tracked"):
    frames = np.arange(first, stop)
    same = np.ones(len(frames))
    places = {"x": x * same, "y": 40.0 * same, "w": side * same, "h": side * same}
    return one_part(target, "box", frames, **places, status=[status] * len(frames))


def face(first, stop, dx=0.0, **more):
    points = {"eye_left": (40.0, 40.0), "eye_right": (60.0, 40.0), "nose": (50.0, 50.0), **more}
    frames = np.arange(first, stop)
    parts = []
    for name, (x, y) in points.items():
        same = np.ones(len(frames))
        parts.append(one_part("face", name, frames, x=(x + dx) * same, y=y * same, w=9 * same, h=9 * same))
    return joined(parts)


def test_boxes_agree_where_they_overlap_by_half():
    assert agreeing(box("a", 0, 9), box("a", 5, 12)).tolist() == [True] * 4
    assert agreeing(box("a", 0, 9), box("a", 5, 12, x=56.5)).all()  # 13.5 of 26.5
    assert not agreeing(box("a", 0, 9), box("a", 5, 12, x=57)).any()  # 13 of 27
    assert len(agreeing(box("a", 0, 9), box("a", 9, 12))) == 0


@pytest.mark.parametrize(("dx", "agrees"), [(9.9, True), (-9.9, True), (10.1, False)])
def test_points_agree_within_half_the_distance_between_the_eyes(dx, agrees):
    assert agreeing(face(0, 9), face(3, 12, dx)).tolist() == [agrees] * 6


def test_other_points_agree_within_half_of_their_shape():
    mouth = [one_part("face", name, [0], x=[x], y=[40.0]) for name, x in (("left", 40.0), ("right", 64.0))]
    moved = [one_part("face", name, [0], x=[x], y=[52.5]) for name, x in (("left", 40.0), ("right", 64.0))]
    assert agreeing(joined(mouth), joined(mouth)).all()
    assert not agreeing(joined(mouth), joined(moved)).any()
    one, other = (one_part("face", "nose", [0], x=[x], y=[40.0], w=[20.0], h=[20.0]) for x in (40.0, 49.9))
    assert agreeing(one, other).all()
    assert not agreeing(one, one_part("face", "nose", [0], x=[50.1], y=[40.0])).any()


def test_what_one_of_them_alone_shows_differs_and_what_none_shows_does_not_count():
    hidden = face(0, 9, nose=(NAN, NAN))
    assert not agreeing(hidden, face(0, 9)).any()
    assert agreeing(hidden, hidden).all()
    none = box("a", 0, 9, x=NAN)
    assert len(agreeing(none, none)) == 0


def test_chunks_meet_in_the_middle_of_the_frames_that_both_have():
    met = stitch(face(10, 20), face(14, 40), {"face"}, matched=False)
    assert met == (Seam(17, 1.0, True), {"face": "face"}, frozenset())
    met = stitch(face(10, 20), face(14, 40, dx=30.0), {"face"}, matched=False)
    assert met.seam == Seam(17, 0.0, False)
    assert met.names == {"face": "face"}
    met = stitch(face(10, 20), face(25, 40), {"face"}, matched=False)
    assert met.seam == Seam(25, None, False)


def test_most_of_the_frames_must_agree():
    for wrong, agrees in ((2, True), (3, False)):
        later = joined([box("face", 10, 10 + wrong, x=99.0), box("face", 10 + wrong, 20)])
        met = stitch(box("face", 0, 20), later, {"face"}, matched=False)
        assert met.seam == Seam(15, 1 - wrong / 10, agrees)


def test_faces_take_the_names_of_those_they_agree_with():
    earlier = joined([box("face", 0, 20, x=50), box("face_2", 0, 20, x=150)])
    later = joined([box("face", 10, 30, x=151), box("face_2", 10, 30, x=51), box("face_3", 10, 30, x=250)])
    met = stitch(earlier, later, {"face", "face_2", "face_3"}, matched=True)
    # somebody else was called face_3 before
    assert met.names == {"face": "face_2", "face_2": "face", "face_3": "face_4"}
    assert met.seam.agrees
    assert met.begun == {"face_4"}
    rows = renamed(later, met.names)
    assert [part.x[0] for part in rows.of_target("face")] == [51]
    # one who was lost all the while may have left, one who was not may not
    gone = joined([box("face", 0, 20, x=50), box("face_2", 0, 20, x=150, status="lost")])
    assert stitch(gone, box("face", 10, 30, x=50), {"face", "face_2"}, matched=True).seam.agrees
    assert not stitch(earlier, box("face", 10, 30, x=50), {"face", "face_2"}, matched=True).seam.agrees
    # and after a gap nobody is known again
    assert stitch(earlier, box("face", 40, 50), {"face", "face_2"}, matched=True).names == {"face": "face_3"}
