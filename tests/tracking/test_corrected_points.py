"""Corrections of points by a box, beside absent parts, and with parts of one's own."""

from dataclasses import replace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.engine.corrected import is_complete
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from tests.support.results import parts_of
from tests.tracking.test_corrected import PARTS, Clip, given, lines, part, run

REST = PARTS[1:]


@pytest.fixture(scope="module")
def face():
    return Clip("expressions", 26)


@pytest.fixture(scope="module")
def box(face):
    return face.start.targets["face"].box


def statuses(result):
    return [one.status for one in parts_of(result.targets[0])]


def test_a_box_places_what_is_there_and_leaves_out_what_is_absent(face, box):
    put = run("factorized", face, given(15, box=box, absent=("lip_upper",)))
    assert statuses(put[15]) == ["init", "init", "init", "absent", "init"]
    assert [one.status for one in (part(r, "lip_upper") for r in put[15:])] == ["absent"] * 11
    hidden = part(put[15], "lip_upper")
    assert (hidden.x, hidden.y, hidden.w, hidden.h, hidden.confidence) == (None,) * 5 and hidden.by_hand
    whole = run("factorized", face, given(15, box=box))
    for name in ("nose", "lip_lower"):
        assert (part(put[15], name).x, part(put[15], name).y) == (part(whole[15], name).x, part(whole[15], name).y)


def test_a_box_may_stand_out_of_the_picture_with_a_part_that_is_absent(face):
    outside = (-42.0, 100.0, 130.0, 130.0)
    with pytest.raises(InputError, match="would put mouth_left outside the frame"):
        run("factorized", face, given(15, box=outside))
    put = run("factorized", face, given(15, box=outside, absent=("mouth_left",)))
    assert statuses(put[15]) == ["init", "absent", "init", "init", "init"]


def test_a_box_beside_points_says_nothing_of_the_others(face, box):
    """They stay where the tracker sees them, as without the box."""
    nose = {"nose": (160.0, 138.0)}
    assert not is_complete(given(15, box=box, points=nose), PARTS)
    assert is_complete(given(15, box=box), PARTS) and is_complete(given(15, box=box, points=nose), ("box",))
    both, points = (run("factorized", face, given(15, points=nose, **more)) for more in ({"box": box}, {}))
    assert lines(both) == lines(points)
    assert min(part(both[15], name).x for name in REST) > 100


def test_what_a_box_brings_back_can_be_learned_later(face, box):
    put = run(
        "factorized",
        face,
        given(5, absent=("nose",)),
        given(10, box=box),
        given(15, points=face.points(15, REST), learn=True),
    )
    assert statuses(put[9])[0] == "absent" and "absent" not in statuses(put[10])
    for later in (
        given(15, box=box, absent=("lip_upper",), learn=True),
        given(15, points={"nose": (9, 9)}, learn=True),
    ):
        with pytest.raises(InputError, match="cannot be learned while absent"):
            run("factorized", face, given(5, absent=("lip_upper",)), later)


def test_a_single_point_is_learned_anew_by_the_length_of_the_first_frame(face, box):
    start = Start(0, {"face": TargetStart(box=box, points={"nose": face.point(0, "nose")})}, "one.yaml")
    again = given(10, points=face.points(10, ("nose",)), learn=True)
    put = run("sir", face, again, start=start, overrides=("target.parts=[nose]",))
    x, y = face.point(25, "nose")
    assert np.hypot(part(put[25], "nose").x - x, part(put[25], "nose").y - y) < 4
    [target] = build_tracker(load_recipe("sir", ("target.parts=[nose]",)), replace(start, corrections=(again,)))
    assert lines(track((replace(target, first=face.frames[0]),), iter(face.frames[10:]), 0)) == lines(put, 10)


def test_a_box_cannot_place_parts_that_no_cascade_knows(face, box):
    points = {"nose": (160, 140), "chin": (160, 180)}
    start = Start(0, {"face": TargetStart(points=points)}, "own.yaml")
    own = ("target.parts=[nose,chin]",)
    with pytest.raises(InputError, match=r"own.yaml: the correction of face at frame 9: no cascade can place chin"):
        run("factorized_transition", face, given(9, box=box), start=start, overrides=own)
    for fine in (given(9, box=box, absent=True), given(9, box=box, points=points)):
        run("factorized_transition", face, fine, start=start, overrides=own)


def test_points_in_one_place_are_refused(face):
    start = replace(face.start, targets={"face": TargetStart(points=dict.fromkeys(PARTS, (160.0, 140.0)))})
    with pytest.raises(InputError, match="all points of face are in one place; move them apart"):
        run("sir", face, start=start)
    with pytest.raises(InputError, match="all points of face are in one place"):
        run("sir", face, Correction(5, "face", TargetStart(points=start.targets["face"].points), learn=True))
