"""From a start to the targets that a recipe names, and hands that nobody placed."""

from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import read_init
from facetrack_cli.start.search import search_start
from facetrack_cli.video.source import open_source
from tests.tracking.test_skin import HEAD, LEFT, RIGHT, box, picture

SAMPLES = Path(__file__).parents[2] / "sample_videos"
ALL = ("head", "left_hand", "right_hand")
FRAME = Frame(0, 0.0, picture(HEAD, LEFT, RIGHT))


def start(**boxes):
    return Start(0, {name: TargetStart(box=one) for name, one in boxes.items()}, "clip.init.yaml")


SPECK = (24.0, 60.0, 11.0, 11.0)  # leftmost, and the smallest
BOTH, OTHER = {"left_hand": LEFT, "right_hand": RIGHT}, {"right_hand": RIGHT}
FOUND = [  # boxes of the start; what else is in the image; the hands that are found
    *(({name: box(HEAD)}, (LEFT, RIGHT), BOTH) for name in ("face", "head", "somebody")),
    ({"face": box(HEAD), "right_hand": box(LEFT)}, (LEFT, RIGHT), {"left_hand": RIGHT}),
    ({"face": box(HEAD)}, (LEFT, RIGHT, SPECK), BOTH),  # the largest ones
    ({"face": box(HEAD), "left_hand": (120.0, 150.0, 28.0, 28.0)}, (RIGHT, SPECK), OTHER),  # where no skin is
    # boxes that are larger or smaller than the hand within them
    *(({"face": box(HEAD), "left_hand": one}, (LEFT, RIGHT), OTHER)
      for one in ((20.0, 100.0, 85.0, 85.0), (57.0, 137.0, 7.0, 7.0))),
]  # fmt: skip


@pytest.mark.parametrize(("given", "others", "found"), FOUND)
def test_the_first_target_is_the_head_and_hands_that_nobody_placed_are_found_from_left_to_right(given, others, found):
    targets = name_targets(start(**given), ALL, Frame(0, 0.0, picture(HEAD, *others))).targets
    assert targets["head"].box == box(HEAD)
    assert all(targets[name].box == given[name] for name in ALL[1:] if name in given)
    for name, hand in found.items():
        assert iou(np.array([targets[name].box]), np.array([box(hand)]))[0] > 0.7


def test_too_few_regions_of_skin_are_told_with_what_to_do():
    frame = Frame(7, 0.0, picture(HEAD, LEFT))
    with pytest.raises(InputError) as caught:
        name_targets(Start(7, {"face": TargetStart(box=box(HEAD))}, "haar"), ALL, frame, clip="a.mp4")
    assert str(caught.value).startswith(
        "a.mp4: frame 7 shows one region of skin beside the head, to begin left_hand and"
    )
    assert "init file" in str(caught.value) and "--set targets.right_hand=null" in str(caught.value)
    with pytest.raises(InputError, match="shows no region of skin"):
        name_targets(start(head=box(HEAD)), ALL, Frame(0, 0.0, picture(HEAD)))


NO_HEAD = "has no box of head, which the recipe begins with"
REFUSED = [
    (start(head=box(HEAD), foot=box(LEFT)), "has foot, which the recipe does not know; it follows head, left_hand"),
    (start(left_hand=box(LEFT)), NO_HEAD),
    (start(left_hand=box(LEFT), right_hand=box(RIGHT)), NO_HEAD),
    (Start(0, {"head": TargetStart(points={"nose": (1.0, 2.0)})}, "x"), NO_HEAD),
]


@pytest.mark.parametrize(("begin", "said"), REFUSED)
def test_targets_that_the_recipe_does_not_know_and_starts_without_a_head_are_refused(begin, said):
    with pytest.raises(InputError, match=said):
        name_targets(begin, ALL, FRAME)


def test_in_a_clip_head_and_hands_are_found_where_the_truth_has_them():
    path = SAMPLES / "signing.mp4"
    true = read_init(path.with_suffix(".init.yaml")).targets
    with open_source(path) as source:
        found = search_start(source, (), complete=lambda frame, start: name_targets(start, ALL, frame))
    assert found.frame == 0
    for name, target in found.targets.items():
        middle = [np.array(one.box[:2]) + np.array(one.box[2:]) / 2 for one in (target, true[name])]
        assert np.abs(middle[0] - middle[1]).max() < 0.3 * true[name].box[2], name


def test_a_grey_clip_is_refused_at_its_first_face_and_not_searched_to_its_end():
    looked = []

    def grey(source):
        for frame in source:
            looked.append(frame.index)
            level = frame.bgr.mean(axis=2, keepdims=True).astype(np.uint8)
            yield Frame(frame.index, frame.time_s, np.ascontiguousarray(level.repeat(3, axis=2)))

    with open_source(SAMPLES / "signing.mp4") as source, pytest.raises(InputError, match="have a colour"):
        search_start(grey(source), (), complete=lambda frame, start: name_targets(start, ALL, frame))
    assert looked == [0]
