"""Random numbers of corrections, on an image that stands still: whoever draws the same goes the same way."""

from dataclasses import replace

import pytest

from facetrack_cli.core.types import Frame, Start
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from tests.support.results import parts_of
from tests.tracking.test_corrected import PARTS, Clip, given

CLIP = Clip("expressions", 1)
AT = CLIP.points(0)


@pytest.fixture(scope="module")
def ways():
    """Of each target and frame, the places of two targets that begin alike, and are corrected alike."""
    one = CLIP.start.targets["face"]
    start = Start(0, {"anna": one, "ben": one}, "two.yaml")

    def follow(*corrections):
        recipe = load_recipe("factorized_transition", ("filter.particles=12",))
        still = (Frame(i, i / 25, CLIP.frames[0].bgr) for i in range(16))
        tracker = build_tracker(recipe, replace(start, corrections=corrections))
        found = {"anna": [], "ben": []}
        for result in track(tracker, still, 0):
            for target in result.targets:
                found[target.rows.target].append([(part.x, part.y) for part in parts_of(target)])
        return found

    return follow


def test_targets_that_are_put_right_together_go_their_own_ways(ways):
    found = ways(given(4, "anna", points=AT), given(4, "ben", points=AT))
    assert found["anna"][4] == found["ben"][4]
    assert all(a != b for a, b in zip(found["anna"][5:], found["ben"][5:], strict=True))


def test_a_second_correction_draws_other_numbers_than_the_first(ways):
    found = ways(given(4, "anna", points=AT), given(10, "anna", points=AT))["anna"]
    assert found[4] == found[10]
    assert all(a != b for a, b in zip(found[5:10], found[11:], strict=True))


@pytest.mark.parametrize("frame", [1, 2])
def test_no_correction_draws_the_numbers_of_another_target(ways, frame):
    """The second target's stream is called by its place, 1, a correction's by its frame as well."""
    found = ways(given(frame, "anna", points=AT))
    assert found["anna"][frame] == found["ben"][0]
    assert found["anna"][frame + 1] != found["ben"][1]


@pytest.mark.parametrize("learn", [None, True, False])
def test_windows_stay_as_the_start_has_them(learn):
    """Though the points, by which lengths are measured, are put further apart."""
    left, top = AT["nose"]
    wide = {name: (left + 1.5 * (x - left), top + 1.5 * (y - top)) for name, (x, y) in AT.items()}
    start = replace(CLIP.start, corrections=(given(2, points=wide, learn=learn),))
    still = (Frame(i, i / 25, CLIP.frames[0].bgr) for i in range(5))
    results = list(track(build_tracker(load_recipe("sir", ("filter.particles=5",)), start), still, 0))
    sides = [[(part.w, part.h) for part in parts_of(result.targets[0])] for result in results]
    assert all(one == sides[0] for one in sides) and len(sides[0]) == len(PARTS)
