"""Recipes over many seeds: the same numbers however they are shared out, and a start where one can be had."""

import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.errors import ExitCode, InputError, RecipeError
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs import seeds, workers
from facetrack_cli.runs.clip import run
from facetrack_cli.runs.plan import ClipRequest, Job, truth_start
from facetrack_cli.runs.seeds import SeedPlan, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import joined, one_part

SAMPLES = Path(__file__).parents[2] / "sample_videos"
CLIP = SAMPLES / "expressions.mp4"


def plan(config="factorized", seeds=(0, 1), stop=10, overrides=(), clip=CLIP):
    recipe = load_recipe(config, overrides)
    return SeedPlan(config, clip, recipe, ClipRequest(CLIP).find(recipe), tuple(seeds), stop=stop)


def assert_same(a, b):
    assert a.seed == b.seed
    for one, other in zip(a.trajectory.parts, b.trajectory.parts, strict=True):
        assert one.name == other.name
        for column in ("frame", "x", "y", "w", "confidence", "std_x", "ess", "status"):
            np.testing.assert_array_equal(getattr(one, column), getattr(other, column))


def runs_of(one):
    [ended] = run_plans([one])
    return ended.runs


def test_a_run_is_the_one_that_facetrack_run_writes(tmp_path):
    [ours] = runs_of(plan(seeds=(3,)))
    outcome = run(Job(CLIP, load_recipe("factorized", ["seed=3"]), tmp_path / "out", video=False, stop=10), Stop())
    written = read_trajectory(tmp_path / "out" / "trajectory.csv")
    assert outcome.frames == 10 and ours.frames_per_s > 0
    for one, other in zip(ours.trajectory.parts, written.parts, strict=True):
        np.testing.assert_array_equal(one.frame, other.frame)
        np.testing.assert_allclose(one.x, other.x, atol=5.1e-4)
        np.testing.assert_allclose(one.ess, other.ess, atol=5.1e-2)
        np.testing.assert_array_equal(one.status, other.status)


def test_seeds_differ_and_do_not_disturb_each_other():
    together = runs_of(plan(seeds=(0, 1)))
    assert [one.seed for one in together] == [0, 1]
    assert not np.array_equal(together[0].trajectory.parts[0].x, together[1].trajectory.parts[0].x)
    for one in together:
        assert_same(one, *runs_of(plan(seeds=(one.seed,))))


def test_processes_change_nothing_but_the_time():
    plans = [plan(), plan("independent", (5,), overrides=["filter.particles=50"])]
    told, alone = [], []
    shared = run_plans(plans, 2, None, lambda *done: told.append(done))
    for one, other in zip(run_plans(plans, 1, None, lambda *done: alone.append(done)), list(shared), strict=True):
        for mine, theirs in zip(one.runs, other.runs, strict=True):
            assert_same(mine, theirs)
    assert told and {total for _, total in told} == {30} and max(done for done, _ in told) <= 30
    assert alone[:10] == [(2 * n, 30) for n in range(1, 11)], "frames of all seeds are counted"


def test_a_plan_that_cannot_run_says_why_and_the_others_go_on(tmp_path):
    start = Start(0, {"face": TargetStart(points={"nose": (3.0, 4.0)})}, "clip.init.yaml")
    good = plan(seeds=(0,))
    plans = [
        SeedPlan("bad", CLIP, load_recipe("factorized"), start, (0, 1)),
        good,
        good._replace(clip=tmp_path / "none.mp4"),
        good._replace(start=Start(9999, good.start.targets, "late.yaml"), stop=None),
        plan(seeds=(0,), overrides=["prior.file=none.npz"]),
    ]
    ended = list(run_plans(plans, 2))
    assert [(len(one.runs), one.error is None) for one in ended] == [(0, False), (1, True)] + 3 * [(0, False)]
    assert ended[0].plan.label == "bad" and "clip.init.yaml: no point for mouth_left" in str(ended[0].error)
    assert "none.mp4" in str(ended[2].error) and isinstance(ended[3].error, InputError)
    assert isinstance(ended[4].error, RecipeError) and "none.npz" in str(ended[4].error)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_wish_to_stop_ends_it(workers):
    stop = Stop()

    def report(done, total):
        if done >= 4:
            stop.code = ExitCode.INTERRUPTED

    assert list(run_plans([plan(stop=200), plan(stop=200)], workers, stop, report)) == []


WORK = seeds._work


def _ends_itself(task, stop, report):
    label = task[0].label
    if label.startswith("late"):
        while not all(Path(label.partition(" ")[2], f"{i}").exists() for i in range(3)):
            time.sleep(0.05)
    if label == "dead":
        time.sleep(1)
    if label.startswith(("late", "dead")):
        os._exit(9)
    found = WORK(task, stop, report)
    Path(label).touch()
    return found


class _PlugInError(Exception):
    def __init__(self, what, where):
        super().__init__(f"{what} in {where}")  # of which a pickle gives one argument


def _refuses(task, stop, report):
    if task == "bad":
        raise _PlugInError("no weights", "a frame")
    return task


def test_an_error_that_cannot_be_put_together_again_costs_its_own_task_alone():
    ended = dict(workers.side_by_side(["bad", "one", "two"], _refuses, 2, Stop()))
    assert isinstance(ended[0], Exception) and (ended[1], ended[2]) == ("one", "two")


def test_a_process_that_ends_costs_no_result_that_is_there(monkeypatch, tmp_path):
    monkeypatch.setattr(seeds, "_work", _ends_itself)
    one, dead = plan(seeds=(0,)), plan()._replace(label="dead")
    alive = [one._replace(label=str(tmp_path / str(i))) for i in range(3)]
    ended = list(run_plans([*alive, dead._replace(label=f"late {tmp_path}")], 2))
    assert [len(one.runs) for one in ended] == [1, 1, 1, 0]
    assert "its process ended with code 9" in str(ended[-1].error)

    stop = Stop()
    monkeypatch.setattr(workers, "LOOK_S", 0.1)
    signalled = threading.Timer(0.2, lambda: setattr(stop, "code", ExitCode.TERMINATED))

    def report(done, total):
        if not signalled.is_alive() and not signalled.finished.is_set():
            signalled.start()

    assert list(run_plans([dead, dead], 2, stop, report)) == [], "a signal comes first"


def truth(part, status="visible", target="face", **more):
    made = one_part(target, part, [4, 5], x=[10.0, 11.0], y=[20.0, 21.0], status=[status, "visible"], **more)
    return joined([made], path=Path("t.csv"))


def test_the_truth_starts_at_its_first_frame_with_all_that_is_followed_visible():
    table = joined([truth("nose"), truth("chin", "hidden")], path=Path("t.csv"))
    start = truth_start(table, ("nose", "chin"))
    assert (start.frame, start.origin) == (5, "t.csv")
    assert start.targets["face"].points == {"nose": (11.0, 21.0), "chin": (11.0, 21.0)}
    with pytest.raises(InputError, match=r"t.csv: no frame shows nose, ear of every target"):
        truth_start(table, ("nose", "ear"))
    start = truth_start(truth("box", target="", w=[5.0, 5.0], h=[3.0, 3.0]), ())
    assert start.frame == 4 and start.targets["face"].box == (8.0, 19.0, 5.0, 3.0), "a box is given by its corner"
    with pytest.raises(InputError, match="no frame shows a box"):
        truth_start(truth("box"), ())


def test_the_init_file_beside_the_clip_goes_before_the_truth(tmp_path):
    known, recipe = read_trajectory(SAMPLES / "expressions.truth.csv"), load_recipe("factorized")
    alone = tmp_path / "clip.mp4"
    alone.symlink_to(CLIP)
    for request, table, origin in (
        (ClipRequest(CLIP), known, str(CLIP.with_suffix(".init.yaml"))),
        (ClipRequest(alone), known, str(known.path)),
        (ClipRequest(alone), None, detector().name),
        (ClipRequest(alone, init="haar"), None, "haar"),
        (ClipRequest(alone, box=(106.0, 74.0, 106.0, 106.0)), known, "--box"),
    ):
        start = request.find(recipe, table)
        assert start.origin == origin and {*start.targets["face"].points} == {*recipe.points}
