import math
import re

import numpy as np
import pytest

from facetrack_cli import track_frames
from facetrack_cli.core.errors import RecipeError
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.recipe.load import in_frames, load_recipe
from facetrack_cli.recipe.model import KINDS, to_dict

TIMES = {
    "confidence.patience": "120 ms",
    "confidence.memory": "2s",
    "likelihood.rate": "2s",
    "likelihood.every": "80ms",
}


def settings(fps, overrides=TIMES):
    recipe = in_frames(load_recipe("correlation_filter", overrides), fps)
    return recipe.confidence, recipe.likelihood


@pytest.mark.parametrize(
    ("fps", "expected"), [(25, (3, 50, 2)), (50, (6, 100, 4)), (120, (14, 240, 10)), (1, (1, 2, 1))]
)
def test_times_become_frames_by_the_rate_of_the_clip(fps, expected):
    confidence, likelihood = settings(fps)
    assert (confidence.patience, confidence.memory, likelihood.every) == expected
    assert (1 - likelihood.rate) ** (2 * fps) == pytest.approx(1 / math.e)  # what is left after 2 s


def test_a_recipe_without_times_is_the_same_at_any_rate():
    recipe = load_recipe("face")
    assert in_frames(recipe, 120) is recipe


def test_times_stay_times_where_a_recipe_is_written_and_read_again():
    written = to_dict(load_recipe("correlation_filter", TIMES))
    assert written["confidence"]["patience"] == "120ms" and written["likelihood"]["rate"] == "2s"
    assert to_dict(KINDS[written["type"]].model_validate(written)) == written


def test_each_target_has_its_times():
    recipe = load_recipe("head_hands", {"targets.head.confidence.memory": "1s"})
    assert in_frames(recipe, 50).targets["head"].confidence.memory == 50


@pytest.mark.parametrize("given", ["1 m", "s", "-1s", "0s", "1e9s", "nan s", "50", "1px"])
def test_what_is_no_time_is_refused_with_its_place(given):
    wanted = (
        r"--set confidence.memory=.*: .*must be a whole number of frames, or a time .* as in 1s or 40ms, not the text"
    )
    with pytest.raises(RecipeError, match=wanted):
        load_recipe("factorized", {"confidence.memory": given})


def test_a_time_beyond_the_bounds_of_its_setting_is_refused_once_the_rate_is_known(tmp_path):
    path = tmp_path / "own.yaml"
    text = (load_recipe("correlation_filter").path).read_text()
    path.write_text(re.sub(r"(?m)^( +)type: correlation_filter$", r"\g<0>\n\1every: 300 ms", text))
    recipe = load_recipe(str(path))
    assert in_frames(recipe, 30).likelihood.every == 9
    with pytest.raises(
        RecipeError, match=r"own.yaml:\d+:\d+: likelihood.every must be at most 10, not 15, which is 300 ms at"
    ):
        in_frames(recipe, 50)
    opened = type(recipe).model_validate(to_dict(recipe), context={"path": path, "root": None})
    with pytest.raises(RecipeError, match=r"own.yaml: likelihood.*less than or equal to 10, at 50 frames per second"):
        in_frames(opened, 50)


def test_frames_doubled_at_twice_the_rate_are_lost_after_the_same_time():
    image = np.random.default_rng(0).integers(0, 255, (80, 80, 3), np.uint8)
    clip = [image] * 5 + [np.zeros_like(image)] * 30
    start = Start(0, {"face": TargetStart(points={"nose": (40.0, 40.0)}, box=(20.0, 20.0, 40.0, 40.0))}, "test")

    def lost_at(overrides, repeat, fps):
        recipe = load_recipe("sir", {"target.parts": ["nose"], "filter.particles": 20, **overrides})
        images = [one for one in clip for _ in range(repeat)]
        found = track_frames(images, recipe, init=start, fps=fps)
        return next(one.frame.time_s for one in found if "lost" in one.targets[0].rows.status)

    for_time = {"confidence.patience": "400ms", "confidence.memory": None}
    assert lost_at(for_time, 2, 50) == pytest.approx(lost_at(for_time, 1, 25), abs=1 / 49)
    in_count = {**for_time, "confidence.patience": 10}
    assert lost_at(in_count, 2, 50) < lost_at(in_count, 1, 25) - 0.15
