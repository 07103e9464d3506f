"""Golden files: what is written is read back, what is no golden is refused in a line, and how runs are judged."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.evaluation.goldens import (
    Golden,
    Verdict,
    compared,
    differences,
    find_goldens,
    means,
    read_golden,
    record,
    write_golden,
)
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe, completed, to_dict
from facetrack_cli.runs.seeds import SeedPlan
from facetrack_cli.trajectory.trajectory import Trajectory, joined, one_part

SAMPLES = Path(__file__).parents[2] / "sample_videos"
START = Start(0, {"face": TargetStart((1.0, 2.0, 30.5, 40.0), {"nose": (10.25, 20.0)}, {"nose": (9.0, 7.0)})}, "x")


def run(seed: int, **change: float) -> Trajectory:
    """A made-up run: parts wander about a known path; spread, ess and confidence vary about known levels."""
    rng, t, found = np.random.default_rng(seed), np.arange(101), []
    for k, part in enumerate(("nose", "mouth_left")):
        noise = rng.normal(size=(2, 101))
        std = np.exp(0.3 * rng.normal(size=(2, 101))) * change.get("std", 1.0)
        status = np.where(rng.random(101) < change.get("lost", 0.02), "lost", "tracked")
        x = 100 + 20 * np.sin(t / 20) + noise[0] + change.get("x", 0.0)
        x = x + np.where((t >= 60) & (t < 70), change.get("jump", 0.0), 0.0)
        found.append(
            one_part(
                "face", part, t, x=x, y=80.0 + 10 * k + noise[1], w=np.full(101, 25.0), h=np.full(101, 25.0),
                std_x=std[0], std_y=std[1], ess=np.exp(2 + 0.3 * rng.normal(size=101)), status=status,
                confidence=np.clip(0.8 + 0.1 * rng.normal(size=101), 0, 1) * change.get("confidence", 1.0),
            )
        )  # fmt: skip
    return joined(found, path=Path("made.csv"))


RECORDED = [run(seed) for seed in range(10)]


def golden_in(folder: Path, start: Start = START, runs: list[Trajectory] = RECORDED) -> Golden:
    """A golden of made-up runs of a clip in a folder."""
    clip = folder / "clip.mp4"
    clip.write_bytes(b"a clip")
    return record(folder, SeedPlan("clip.sir", clip, load_recipe("sir"), start, (0,)), runs, None, None)


@pytest.fixture
def golden(tmp_path: Path) -> Golden:
    return golden_in(tmp_path)


def judged(golden: Golden, runs: list[Trajectory], tmp_path: Path) -> list[str]:
    """The lines of what is off in runs of other versions."""
    verdict = compared(Verdict(tmp_path, "clip", "sir"), golden, golden_in(tmp_path, runs=runs), ["numpy"], runs)
    assert verdict.details[-1].startswith("not as recorded: numpy")
    return [] if verdict.status == "ok" else [verdict.message, *verdict.details[:-1]]


def four(first: int, **change: float) -> list[Trajectory]:
    return [run(seed, **change) for seed in range(first, first + 4)]


def test_a_golden_is_read_as_it_was_written(golden: Golden, tmp_path: Path) -> None:
    path = tmp_path / "goldens" / "clip.sir.json"
    write_golden(path, golden)
    back = read_golden(path)
    assert back.model_dump() == golden.model_dump() and back.frames == (0, 100) and back.seeds == 10
    assert back.start.targets["face"].points == {"nose": (10.25, 20.0)}
    text = path.read_bytes()
    write_golden(path, back)
    assert path.read_bytes() == text, "the same numbers are the same bytes"
    assert find_goldens(tmp_path) == [path]
    lines = text.decode().splitlines()
    assert sum(line.startswith("    [") for line in lines) == len(back.rows) == 32, "a row a line"
    assert len(back.checksums) == 4 * 101 and {"numpy", "numba", "machine", "facetrack"} <= back.versions.keys()


def test_a_row_holds_the_place_and_how_far_other_seeds_are(golden: Golden) -> None:
    frame, part, x, y, reach = golden.rows[-1]
    own = [one.find("face", "mouth_left").at(100) for one in RECORDED]
    assert (frame, part) == (100, "face/mouth_left") and (x, y) == pytest.approx((own[0].x[0], own[0].y[0]), abs=1e-3)
    away = [np.hypot(one.x[0] - own[0].x[0], one.y[0] - own[0].y[0]) for one in own]
    assert reach == pytest.approx(max(away), abs=0.01)


def test_a_mean_is_of_its_quantity_after_the_first_frame() -> None:
    nose, mouth = RECORDED[0].parts
    found = means(RECORDED[0], {})
    assert found["face/nose"]["x"] == pytest.approx(nose.x[1:].mean())
    assert found["face/nose"]["unseen"] == (nose.status[1:] == "lost").mean()
    assert found["face/nose"]["std_x"] == pytest.approx(np.exp(np.log(nose.std_x[1:] + 0.05).mean()) - 0.05)
    assert found[""]["confidence"] == pytest.approx((nose.confidence[1:].mean() + mouth.confidence[1:].mean()) / 2)
    assert "identity" not in found[""]


def test_identity_is_the_probability_of_the_recorded_name() -> None:
    rows = one_part(
        "face", "head", np.arange(4), x=np.ones(4), y=np.ones(4), identity=np.array(["", "anna", "ben", "anna"]),
        identity_prob=np.array([np.nan, 0.8, 0.9, 0.6]),
    )  # fmt: skip
    assert means(rows, {"face": "anna"})["face/head"]["identity"] == pytest.approx((0.8 + 0 + 0.6) / 3)


@pytest.mark.parametrize("first", [100, 200, 300, 400])
def test_unseen_seeds_are_within_the_spread(first: int, golden: Golden, tmp_path: Path) -> None:
    assert judged(golden, four(first), tmp_path) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"x": 0.8}, "mean x"),
        ({"std": 1.25}, "mean std_"),
        ({"confidence": 0.85}, "mean confidence"),
        ({"lost": 0.2}, "mean unseen"),
        ({"jump": 25.0}, "px from its golden row of frame 6"),
    ],
)
def test_a_change_is_seen(change: dict[str, float], said: str, golden: Golden, tmp_path: Path) -> None:
    assert any(said in text for text in judged(golden, four(100, **change), tmp_path))


def test_one_seed_that_goes_astray_fails_nothing(golden: Golden, tmp_path: Path) -> None:
    runs = [run(100, x=50.0), *(run(seed) for seed in (101, 102, 103))]
    assert judged(golden, runs, tmp_path) == []


def spoil(text: str, how: str) -> str:
    data = json.loads(text)
    if how == "cut":
        return text[:-200]
    if how == "version":
        data["version"] = 2
    elif how == "row":
        data["rows"][0].pop()
    elif how == "part":
        data["rows"][0][1] = "face/chin"
    elif how == "frame":
        data["rows"][0][0] = 101
    elif how == "clip":
        data["clip"] = "../../etc/passwd"
    return json.dumps(data)


@pytest.mark.parametrize("how", ["cut", "version", "row", "part", "frame", "clip"])
def test_what_is_no_golden_is_refused_in_a_line(how: str, golden: Golden, tmp_path: Path) -> None:
    path = tmp_path / "goldens" / "a.json"
    write_golden(path, golden)
    path.write_text(spoil(path.read_text(encoding="utf-8"), how), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_golden(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ") and "--update" in message and "\n" not in message


def test_what_differs_is_told(tmp_path: Path, golden: Golden) -> None:
    assert differences(golden, load_recipe("sir", ["seed=7"])) == []
    other = load_recipe("sir", ["filter.particles=200", "likelihood.floor=-16"])
    before = golden.settings["filter"]["particles"]
    assert differences(golden, other) == [f"filter.particles {before} -> 200", "likelihood.floor nothing -> -16.0"]
    versions = {**golden.versions, "numpy": "1.0"}
    (line,) = differences(golden.model_copy(update={"versions": versions}), load_recipe("sir"))
    assert line.startswith("numpy 1.0 -> ")
    (line,) = differences(golden.model_copy(update={"files": {"prior.npz": "0" * 64}}), load_recipe("sir"))
    assert line == f"prior.npz {'0' * 40} -> nothing"


# --- shipped goldens -----------------------------------------------------------------------------------------------


def test_every_recipe_has_a_golden_of_each_clip_that_it_is_made_for() -> None:
    wanted = set()
    for recipe in (load_recipe(str(path)) for path in shipped_recipes()):
        kind = recipe.name.split("_")[0]
        clips: tuple[str, ...] = ("expressions", "occlusion") if recipe.points else ()
        if kind in ("contour", "histogram"):
            clips = ("textured", "turning")
        elif kind in ("skin", "ncc"):
            clips = ("map", "gestures", "passerby")
        elif isinstance(recipe, ParticleRecipe) and recipe.target.type == "affine":
            clips = ("zoom", "lamp")
        wanted |= {f"{clip}.{recipe.name}.json" for clip in (*clips, *(["signing"] if recipe.followed else []))}
    assert len(wanted) > 50 and wanted <= {path.name for path in find_goldens(SAMPLES)}


def test_a_folder_without_goldens_has_none_and_no_folder_is_refused(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "occlusion.init.yaml", tmp_path)
    assert find_goldens(tmp_path) == []
    with pytest.raises(InputError, match="there is no such folder"):
        find_goldens(tmp_path / "none")
    with pytest.raises(InputError, match="is no folder"):
        find_goldens(tmp_path / "occlusion.init.yaml")


def test_a_key_that_a_later_version_brought_changes_no_older_golden() -> None:
    now = to_dict(load_recipe("factorized"))
    older = {**now, "confidence": {key: value for key, value in now["confidence"].items() if key != "memory"}}
    assert completed(older) == now
    assert completed({**older, "filter": {"type": "no such"}})["filter"] == {"type": "no such"}
