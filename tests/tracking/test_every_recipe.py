"""Every shipped recipe on sample clips: seeds, flat frames, accuracy, starts; trackers of OpenCV beside ours."""

import itertools

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import OpenCvRecipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers import opencv
from facetrack_cli.trajectory.writers import csv_frames
from tests.support.results import parts_of
from tests.support.samples import FOLDER, TrackClip

RECIPES = [path.stem for path in shipped_recipes()]
HANDS = {"left_hand": TargetStart((30.0, 150.0, 40.0, 50.0)), "right_hand": TargetStart((240.0, 150.0, 40.0, 50.0))}
FEW = {"filter.particles": 30, "recognition.gallery": str(FOLDER / "people.npz")}


def recipe_of(name):
    """A recipe with few particles, and a gallery where it needs one."""
    recipe = load_recipe(name)
    if isinstance(recipe, OpenCvRecipe):
        if opencv.find(recipe.tracker) is None:
            pytest.skip("this build of OpenCV has no such tracker")
        return recipe
    if recipe.followed:
        return load_recipe(name, {f"targets.{target}.filter.particles": 60 for target in recipe.filters})
    return load_recipe(name, {key: value for key, value in FEW.items() if "gallery" not in key or "recog" in name})


@pytest.fixture(scope="module")
def clip():
    return TrackClip("expressions", 8)


def rows_of(name, clip, frames, seed=0):
    """Each frame's rows."""
    recipe, face = recipe_of(name), clip.start.targets["face"]
    start = Start(0, {"head": face, **HANDS} if recipe.followed else {"face": face}, "x")
    return [result.rows for result in track(build_tracker(recipe, start), iter(frames), seed)]


@pytest.mark.parametrize("name", RECIPES)
def test_the_same_seed_gives_the_same_rows_and_another_does_not(name, clip):
    runs = (rows_of(name, clip, clip.frames[:4], seed) for seed in (3, 3, 4))
    one, two, other = ([line for rows in run for line in csv_frames(rows)] for run in runs)
    assert one == two
    assert (one == other) == (isinstance(load_recipe(name), OpenCvRecipe) and name != "mil")


@pytest.mark.parametrize(("name", "level"), [*zip(RECIPES, itertools.cycle([0, 128]), strict=False)])
def test_flat_frames_are_survived_and_everything_is_lost(name, level, clip):
    flat = [Frame(i, i / 25, np.full_like(clip.frames[0].bgr, level)) for i in range(1, 10)]
    rows = rows_of(name, clip, [clip.frames[0], *flat])
    begun = rows[0].status[[not part.startswith("eye") for _, part in rows[0].names]]  # nobody places the eyes
    assert len(rows) == 10 and {*begun} == {"init"}
    assert all(np.isfinite([one.x, one.y])[:, ~one.vanished].all() for one in rows)
    for one in rows[1:]:
        known = one.confidence[np.isfinite(one.confidence)]
        assert ((known >= 0) & (known <= 1)).all()
        assert (one.std_x[np.isfinite(one.std_x)] >= 0).all()
    if not isinstance(load_recipe(name), OpenCvRecipe):  # these hardly ever say so
        assert {*rows[-1].status[~rows[-1].vanished]} == {"lost"}


class Clip(TrackClip):
    """Up to a frame, with ground truth and visibility (T, K) in the recipe's order."""

    def __init__(self, name, stop):
        super().__init__(name, stop)
        rows = self.truth
        parts = load_recipe("factorized").target.parts
        truth = [[rows[f.index, part] for part in parts] for f in self.frames]
        self.truth = np.array([[(row.x, row.y) for row in line] for line in truth])
        self.visible = np.array([[row.status == "visible" for row in line] for line in truth])


@pytest.fixture(scope="module")
def expressions():
    return Clip("expressions", 60)


def run(config, clip, seed=0):
    return list(track(build_tracker(load_recipe(config), clip.start), iter(clip.frames), seed))


def errors(results, clip):
    """Of nose, mouth and lips: a face has rows of its box and eyes, too."""
    places = np.array([[(p.x, p.y) for p in parts_of(result.targets[0])[:5]] for result in results])
    return np.hypot(*np.moveaxis(places - clip.truth, 2, 0))


@pytest.mark.parametrize("config", [name for name in RECIPES if load_recipe(name).points])
def test_every_recipe_follows_the_face_of_a_sample_clip(config, expressions):
    results = run(config, expressions)
    assert {p.status for p in parts_of(results[0].targets[0])[:5]} == {"init"}
    off = errors(results, expressions)
    # bounds from the measured tables, with room; the filters over the joint state are the ones that wander
    assert off.mean() < {"sir": 8.0, "auxiliary_prior": 5.5}.get(config, 3.0)
    assert off[:, 0].mean() < 4.0
    for result in results[1:]:
        for part in parts_of(result.targets[0])[:6]:
            assert part.status in ("tracked", "lost")
            assert 0.0 <= part.confidence <= 1.0
            assert part.cov[0] >= 0
            assert part.cov[0] * part.cov[2] >= part.cov[1] ** 2 * (1 - 1e-9)
            assert 1 - 1e-9 <= part.ess <= part.particles + 1e-6


def test_covered_parts_are_called_lost_and_found_again():
    occlusion = Clip("occlusion", 130)
    results = run("factorized_robust", occlusion)
    lost = np.array([[p.status == "lost" for p in parts_of(r.targets[0])] for r in results])
    covered = slice(60, 100)
    hidden = ~occlusion.visible[covered]
    assert hidden.any()
    assert lost[covered][hidden].mean() > 0.9
    assert lost[:45].mean() < 0.02
    assert lost[115:].mean() < 0.05
    assert errors(results, occlusion)[115:].mean() < 3.0


def test_lengths_scale_with_the_target_and_windows_of_the_init_file_win():
    points = load_recipe("factorized").target.parts
    small = {part: (10.0 * i, 5.0 * (i % 2)) for i, part in enumerate(points)}
    large = {part: (4 * x, 4 * y) for part, (x, y) in small.items()}

    def built(*overrides, **more):
        [target] = build_tracker(load_recipe("factorized", overrides), Start(0, {"face": TargetStart(**more)}, "x"))
        return target

    a, b = built(points=small), built(points=large, windows={"nose": (31.0, 17.0)})
    np.testing.assert_allclose(b.motion.sigma, 4 * a.motion.sigma)
    np.testing.assert_allclose(b.likelihood.context.placed.windows[1:], 4 * a.likelihood.context.placed.windows[1:])
    np.testing.assert_allclose(b.likelihood.context.placed.windows[0], [31, 17])
    np.testing.assert_allclose(built("motion.sigma=3px", points=large).motion.sigma, 3.0)


# --- trackers of OpenCV; all but MIL where the contrib wheel is installed

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


def run_box(name, pictures, box=(30.0, 40.0, 32.0, 32.0), seed=0, target="face"):
    start = Start(0, {target: TargetStart(box=box)}, "clip.init.yaml")
    return [result.targets[0] for result in track(build_tracker(load_recipe(name), start), iter(pictures), seed)]


@pytest.mark.parametrize("name", THERE)
def test_a_box_is_followed_and_what_it_cannot_tell_is_left_out(name):
    results = run_box(name, frames(20, step=(1.0, 0.5)), (29.5, 40.0, 32.0, 32.0), target="head")
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
    alone = [places(run_box("mil", pictures, seed=seed)) for seed in (1, 2)]
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
    parts = [parts_of(target)[0] for target in run_box("kcf", frames(5))]
    assert [part.status for part in parts] == ["init", "tracked", "lost", "lost", "lost"]
    assert {(part.x, part.y, part.w, part.h) for part in parts[1:]} == {(46.5, 56.5, 32, 32)}


def test_a_box_that_is_too_small_or_outside_is_refused():
    for box in [(10.0, 10.0, 5.0, 40.0), (155.0, 10.0, 30.0, 30.0), (-40.0, 10.0, 41.0, 30.0)]:
        with pytest.raises(InputError, match=r"clip.init.yaml: the box of face covers less than 6x6 pixels"):
            run_box("mil", frames(2), box)


def test_a_tracker_that_this_opencv_lacks_is_named_with_the_remedy(monkeypatch):
    monkeypatch.delattr(opencv.cv2, "TrackerKCF_create", raising=False)
    start = Start(0, {"face": TargetStart(box=(1.0, 1.0, 9.0, 9.0))}, "x")
    with pytest.raises(RecipeError, match=r"kcf.yaml:\d+:\d+: .*no KCF tracker; .*opencv-contrib-python-headless"):
        build_tracker(load_recipe("kcf"), start)
