"""OpenCV's trackers beside ours. CSRT, KCF and MOSSE are tested where the contrib wheel is installed."""

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers import opencv
from tests.support.results import parts_of

NAMES = ["mil", "csrt", "kcf", "mosse"]
THERE = [name for name in NAMES if opencv.find(name) is not None]
SIZE = (160, 120)


def frames(count, step=(1.5, 0.5)):
    """A textured square of 32 pixels that moves by `step` a frame over a dim ground."""
    random = np.random.default_rng(1)
    square = random.integers(80, 255, (32, 32, 3), dtype=np.uint8)
    ground = random.integers(0, 60, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    for i in range(count):
        picture = ground.copy()
        left, top = round(30 + step[0] * i), round(40 + step[1] * i)
        picture[top : top + 32, left : left + 32] = square
        yield Frame(i, i / 25, picture)


def run(name, pictures, box=(30.0, 40.0, 32.0, 32.0), seed=0, target="face"):
    start = Start(0, {target: TargetStart(box=box)}, "clip.init.yaml")
    return [result.targets[0] for result in track(build_tracker(load_recipe(name), start), iter(pictures), seed)]


@pytest.mark.parametrize("name", THERE)
def test_a_box_is_followed_and_what_it_cannot_tell_is_left_out(name):
    results = run(name, frames(20, step=(1.0, 0.5)), (29.5, 40.0, 32.0, 32.0), target="head")
    first, last = parts_of(results[0])[0], parts_of(results[-1])[0]
    assert (first.status, last.status) == ("init", "tracked")
    assert (first.x, first.y, first.w, first.h) == (45.5, 55.5, 32, 32), "a square between pixels stays a square"
    assert abs(last.x - (45.5 + 19)) < 7 and abs(last.y - (55.5 + 9.5)) < 7
    assert (last.target, last.part, last.particles) == ("head", "box", None)
    assert (last.confidence, last.cov, last.ess) == (None, None, None) and results[-1].cloud.shape == (0, 1, 2)


def test_mil_gives_the_same_track_for_the_same_seed_also_beside_another():
    def places(results):
        return [(one.rows.x[0], one.rows.y[0]) for one in results]

    pictures = list(frames(6, step=(4.0, 2.0)))
    alone = [places(run("mil", pictures, seed=seed)) for seed in (1, 2)]
    assert alone[0] != alone[1]
    tracker = build_tracker(load_recipe("mil"), Start(0, {"face": TargetStart(box=(30.0, 40.0, 32.0, 32.0))}, "x"))
    both = zip(*(track(tracker, iter(pictures), seed) for seed in (1, 2)), strict=True)
    assert [places(each) for each in zip(*both, strict=True)] == alone


class _Stub:
    """A tracker that follows for a frame, loses its target, and fails."""

    def __init__(self):
        self.answers = [(True, (31, 41, 32, 32)), (False, (0, 0, 0, 0)), (True, (5, 5, 0, 10)), None]

    def init(self, image, box):
        pass

    def update(self, image):
        answer = self.answers.pop(0)
        if answer is None:
            raise opencv.cv2.error("no samples")
        return answer


def test_a_lost_box_stays_where_it_was(monkeypatch):
    monkeypatch.setattr(opencv, "find", lambda tracker: _Stub)
    parts = [parts_of(target)[0] for target in run("kcf", frames(5))]
    assert [part.status for part in parts] == ["init", "tracked", "lost", "lost", "lost"]
    assert {(part.x, part.y, part.w, part.h) for part in parts[1:]} == {(46.5, 56.5, 32, 32)}


def test_a_box_that_is_too_small_or_outside_is_refused():
    for box in [(10.0, 10.0, 5.0, 40.0), (155.0, 10.0, 30.0, 30.0), (-40.0, 10.0, 41.0, 30.0)]:
        with pytest.raises(InputError, match=r"clip.init.yaml: the box of face covers less than 6x6 pixels"):
            run("mil", frames(2), box)


def test_a_tracker_that_this_opencv_lacks_is_named_with_the_remedy(monkeypatch):
    monkeypatch.delattr(opencv.cv2, "TrackerKCF_create", raising=False)
    start = Start(0, {"face": TargetStart(box=(1.0, 1.0, 9.0, 9.0))}, "x")
    with pytest.raises(RecipeError, match=r"kcf.yaml:\d+:\d+: .*no KCF tracker; .*opencv-contrib-python-headless"):
        build_tracker(load_recipe("kcf"), start)
