"""What holds for every shipped recipe: equal seeds give equal rows, and frames that show nothing are survived."""

import numpy as np
import pytest

from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import OpenCvRecipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers import opencv
from facetrack_cli.trajectory.writers import csv_frames
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


def text(rows):
    return [line for one in rows for line in csv_frames(one)]


@pytest.mark.parametrize("name", RECIPES)
def test_the_same_seed_gives_the_same_rows_and_another_does_not(name, clip):
    one, two, other = (text(rows_of(name, clip, clip.frames, seed)) for seed in (3, 3, 4))
    assert one == two
    assert (one == other) == (isinstance(load_recipe(name), OpenCvRecipe) and name != "mil")


def begun(rows):
    """The statuses of what the start has: nobody places the eyes of a face."""
    return rows.status[[not part.startswith("eye") for _, part in rows.names]]


@pytest.mark.parametrize("name", RECIPES)
@pytest.mark.parametrize("level", [0, 128])
def test_flat_frames_are_survived_and_everything_is_lost(name, level, clip):
    flat = [Frame(i, i / 25, np.full_like(clip.frames[0].bgr, level)) for i in range(1, 10)]
    rows = rows_of(name, clip, [clip.frames[0], *flat])
    assert len(rows) == 10 and {*begun(rows[0])} == {"init"}
    assert all(np.isfinite([one.x, one.y])[:, ~one.vanished].all() for one in rows)
    for one in rows[1:]:
        known = one.confidence[np.isfinite(one.confidence)]
        assert ((known >= 0) & (known <= 1)).all()
        assert (one.std_x[np.isfinite(one.std_x)] >= 0).all()
    if not isinstance(load_recipe(name), OpenCvRecipe):  # these hardly ever say so
        assert {*rows[-1].status[~rows[-1].vanished]} == {"lost"}


@pytest.mark.parametrize("name", RECIPES)
def test_a_first_frame_alone_gives_its_rows_and_none_gives_none(name, clip):
    [rows] = rows_of(name, clip, clip.frames[:1])
    assert {*begun(rows)} == {"init"} and rows_of(name, clip, []) == []
