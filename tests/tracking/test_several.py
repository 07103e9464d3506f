"""Several targets in one run: whose turn it is, what each is told of the others, and what others explain."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame, Particles, Start, TargetStart
from facetrack_cli.engine.loop import Footprint, track
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import BoxSpace, FirstOrder, evenly
from facetrack_cli.engine.target import ParticleState, ParticleTarget
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ExclusionSettings
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.skin.likelihoods import CloudSpace, log_weights
from tests.support.parts import sir
from tests.support.results import target

PICTURE, SIZE = np.zeros((20, 30, 3), np.uint8), (12.0, 8.0)


def frames(count):
    return (Frame(i, i / 25, PICTURE) for i in range(count))


@dataclass(frozen=True)
class Turn:
    """A target whose state is the number of its frame; it keeps what it is told and what it draws."""

    name: str
    told: list

    def begin(self, rng, frame):
        return 0, self._result()

    def advance(self, rng, state, frame, footprints):
        assert state == frame.index - 1
        self.told.append(
            (self.name, [(one.centre, one.half) for one in footprints if one.target == one.centre], rng.random())
        )
        return frame.index, self._result()

    def footprint(self, state, *, ahead):
        return Footprint(self.name, state + 0.5 * ahead)

    def _result(self):
        return target(self.name, [])


def turns(*names, seed=0):
    told = []
    list(track(tuple(Turn(name, told) for name in names), frames(3), seed))
    return told


def test_who_came_before_is_known_and_the_others_are_expected():
    footprints = [(name, seen) for name, seen, _ in turns("a", "b", "c")]
    assert footprints == [
        ("a", [("b", 0.5), ("c", 0.5)]), ("b", [("a", 1), ("c", 0.5)]), ("c", [("a", 1), ("b", 1)]),
        ("a", [("b", 1.5), ("c", 1.5)]), ("b", [("a", 2), ("c", 1.5)]), ("c", [("a", 2), ("b", 2)]),
    ]  # fmt: skip


def test_each_target_draws_numbers_of_its_own_and_the_first_one_the_seeds():
    one, two = turns("a", seed=7), turns("a", "b", seed=7)
    drawn = {name: [value for who, _, value in two if who == name] for name in "ab"}
    assert drawn["a"] == [value for _, _, value in one] == np.random.default_rng(7).random(2).tolist()
    assert len({*drawn["a"], *drawn["b"]}) == 4


class Still(Likelihood):
    """A likelihood of which only `learn` and `distances` say anything: where they were asked."""

    def learn(self, learned, frame, state, particles):
        return (*learned, state[0, 0])

    def score(self, learned, frame, x, parents):
        return np.zeros(x.shape[:2])

    def distances(self, learned, frame, x):
        return np.zeros(x.shape[:2])


def moving(space):
    stay, none = np.eye(2), np.zeros((2, 1))
    motion = FirstOrder((np.array([[1.0, 1.0], [0.0, 1.0]]), none), (stay, none), 0.1, 10.0)
    x0 = np.array([[10.0, 20.0, 1.5, 3.0, -2.0, 0.0]])
    return ParticleTarget("a", ("box",), space, x0, 4, motion, Still(), None, sir(), None)


@pytest.mark.parametrize(("space", "half"), [(BoxSpace(SIZE), (9.0, 6.0)), (CloudSpace(SIZE), (4.0, 2.0))])
def test_what_a_target_covers_is_its_box_where_it_is_or_will_be(space, half):
    one = moving(space)
    particles = Particles(np.repeat(one.x0[None], 4, axis=0), np.full(4, -np.log(4)))
    state = ParticleState(particles, evenly(one.x0, np.array([[8.0, 4.0]])), (), None)
    now, next_ = (one.footprint(state, ahead=ahead) for ahead in (False, True))
    np.testing.assert_allclose([now.centre, next_.centre], [(10, 20), (13, 18)])
    np.testing.assert_allclose([now.half, next_.half], [half, half])


def test_notes_of_the_start_are_said_in_the_first_frame_alone():
    class Noted(Still):
        notes = ("one", "two")

        def init(self, frame, x0):
            return self

        def learn(self, learned, frame, state, particles):
            return learned

    tracker = (replace(moving(CloudSpace(SIZE)), likelihood=Noted()),)
    assert [result.notes for result in track(tracker, frames(3), 0)] == [("one", "two"), (), ()]


ALL = ("head", "left_hand", "right_hand")
BOXES = {"head": (100.0, 40.0, 40.0, 50.0), "left_hand": (30.0, 120.0, 24.0, 28.0), "right_hand": (180, 120, 20, 30)}


def built(config, *overrides, names=ALL):
    start = Start(0, {name: TargetStart(box=BOXES[name]) for name in names}, "x")
    return build_tracker(load_recipe(config, overrides), start)


def settings(target):
    return target.exclusion and target.exclusion.args[0]


def test_targets_are_built_in_the_recipes_order_and_the_first_keep_off_none():
    tracker = built("head_hands", "exclusion.strength=0.3", "exclusion.reach=2", names=ALL[::-1])
    assert tuple(target.name for target in tracker) == ALL
    exclusion = ExclusionSettings(strength=0.3, reach=2.0, first=("head",))
    assert [settings(target) for target in tracker] == [None, exclusion, exclusion]
    everyone = built("head_hands", "exclusion.first=[]")
    assert all(settings(target) == ExclusionSettings(strength=0.9, reach=1.0) for target in everyone)
    assert all(target.exclusion is None for target in built("head_hands", "exclusion=null"))


HEAD = Footprint(np.array([50.0, 40.0]), np.array([10.0, 20.0]))
POINT = Footprint(np.array([5.0, 5.0]), np.zeros(2))
EDGE = 1 - 0.9 * np.exp(-0.5)
LEFT = [  # strength, reach, footprints, a place, and what is left of its weight
    (0.9, 1.0, (HEAD,), (50, 40), 0.1),
    (0.9, 1.0, (HEAD,), (120, 40), 1.0),
    (0.9, 1.0, (), (50, 40), 1.0),
    *((0.9, 1.0, (HEAD,), place, EDGE) for place in ((60, 40), (50, 60))),
    (0.9, 2.0, (HEAD,), (70, 40), EDGE),
    (0.9, 1.0, (POINT,), (5, 5), 0.1),
    (0.9, 1.0, (POINT,), (8, 5), 1.0),
]


def left(place, strength=0.9, reach=1.0, footprints=(HEAD,)):
    settings = ExclusionSettings(strength=strength, reach=reach)
    return np.exp(log_weights(settings, np.array([[place]], float), footprints)[0, 0])


@pytest.mark.parametrize(("strength", "reach", "footprints", "place", "share"), LEFT)
def test_the_outline_of_another_target_is_an_ellipse_that_reach_widens(strength, reach, footprints, place, share):
    assert left(place, strength, reach, footprints) == pytest.approx(share)


@given(strength=st.floats(0, 1), reach=st.floats(0.01, 10), place=st.tuples(*[st.floats(-1e7, 1e7)] * 2))
def test_weights_are_finite_and_between_what_is_left_and_all(strength, reach, place):
    assert max(1 - strength, 1e-12) * (1 - 1e-9) <= left(place, strength, reach) <= 1
