"""Golden files: what is written is read back, and what is no golden is refused in a line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from facetrack_cli.core import files
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.evaluation.goldens.goldens import (
    File,
    Golden,
    checksum,
    differences,
    find_goldens,
    golden_path,
    read_golden,
    record,
    write_golden,
)
from facetrack_cli.recipe.files import shipped_recipes
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe, Recipe, completed, to_dict
from tests.evaluation.test_bands import RECORDED

SAMPLES = Path(__file__).parents[2] / "sample_videos"
POINTS_RECIPES = [path.stem for path in shipped_recipes() if load_recipe(str(path)).points]


@pytest.fixture
def golden(tmp_path: Path) -> Golden:
    clip = tmp_path / "clip.mp4"
    clip.write_bytes(b"a clip")
    start = Start(0, {"face": TargetStart((1.0, 2.0, 30.5, 40.0), {"nose": (10.25, 20.0)}, {"nose": (9.0, 7.0)})}, "x")
    return record(RECORDED, clip=clip, recipe="sir", settings=to_dict(load_recipe("sir")), start=start)


def test_a_golden_is_read_as_it_was_written(golden: Golden, tmp_path: Path) -> None:
    path = golden_path(tmp_path, golden.clip.file, "sir")
    assert path == tmp_path / "goldens" / "clip.sir.json"
    write_golden(path, golden)
    back = read_golden(path)
    assert back.model_dump() == golden.model_dump() and back.frames == (0, 100) and back.tested == 4
    assert back.start.targets["face"].points == {"nose": (10.25, 20.0)}
    text = path.read_bytes()
    write_golden(path, back)
    assert path.read_bytes() == text, "the same numbers are the same bytes"
    assert find_goldens(tmp_path) == [path]
    (line,) = [one for one in text.decode().splitlines() if one.startswith('    ["face/nose","x",1,25,')]
    *_, low, high, missing = json.loads(line.rstrip(","))
    assert 105 < low < high < 115 and missing == 0


def test_one_run_is_kept_of_a_tracker_without_chance(golden: Golden, tmp_path: Path) -> None:
    clip = tmp_path / golden.clip.file
    one = record(RECORDED[:1] * 5, clip=clip, recipe="kcf", settings={}, start=golden.start.start_from("x"))
    assert one.seeds == one.tested == 1


def spoil(text: str, how: str) -> str:
    data = json.loads(text)
    if how == "cut":
        return text[:-200]
    if how == "version":
        data["version"] = 1
    elif how == "band":
        data["bands"][0].pop()
    elif how == "part":
        data["bands"][0][0] = "face/chin"
    elif how == "clip":
        data["clip"]["file"] = "../../etc/passwd"
    elif how == "quantity":
        data["bands"][0][1] = "mood"
    return json.dumps(data)


@pytest.mark.parametrize("how", ["cut", "version", "band", "part", "clip", "quantity"])
def test_what_is_no_golden_is_refused_in_a_line(how: str, golden: Golden, tmp_path: Path) -> None:
    path = tmp_path / "goldens" / "a.json"
    write_golden(path, golden)
    path.write_text(spoil(path.read_text(encoding="utf-8"), how), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_golden(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ") and "--update" in message and "\n" not in message


def test_settings_that_differ_are_told() -> None:
    before = to_dict(load_recipe("factorized"))
    after = to_dict(load_recipe("factorized", ["filter.particles=200", "likelihood.floor=-16", "seed=7"]))
    assert differences(before, after) == ["filter.particles 100 -> 200", "likelihood.floor nothing -> -16.0"]
    assert differences(before, {**before, "description": "another"}) == []
    assert differences(before, {**before, "prior": None})[0] == 'prior.type "parzen" -> nothing'


def test_a_checksum_is_of_a_clip_or_of_all_images_of_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for name in ("1.png", "2.png"):
        (folder / name).write_bytes(name.encode())
    one = checksum(folder)
    (folder / "notes.txt").write_text("no image")
    assert checksum(folder) == one
    (folder / "2.png").rename(folder / "3.png")
    assert checksum(folder) != one
    with pytest.raises(InputError, match="cannot be read"):
        checksum(tmp_path / "none.mp4")


def test_a_file_that_cannot_be_replaced_is_left_whole(golden: Golden, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "goldens" / "a.json"
    write_golden(path, golden)
    before = path.read_bytes()

    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "publish", full)
    with pytest.raises(Exception, match="No space left"):
        write_golden(path, golden)
    assert path.read_bytes() == before and [p.name for p in path.parent.iterdir()] == ["a.json"]


# --- those that are shipped ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("clip", ["expressions", "occlusion"])
def test_every_recipe_of_points_has_a_golden_of_each_clip(clip: str) -> None:
    found = {path.name for path in find_goldens(SAMPLES)}
    assert {f"{clip}.{recipe}.json" for recipe in POINTS_RECIPES} <= found


def test_every_recipe_of_a_region_has_a_golden_of_each_head() -> None:
    found = {path.name for path in find_goldens(SAMPLES)}
    regions = [path.stem for path in shipped_recipes() if path.stem.split("_")[0] in ("contour", "histogram")]
    assert len(regions) == 7
    assert {f"{clip}.{recipe}.json" for recipe in regions for clip in ("textured", "turning")} <= found
    assert {"hands.histogram.json", "hands.histogram_correlation.json"} <= found


def test_every_recipe_of_skin_has_a_golden_of_each_clip_that_it_was_made_for() -> None:
    found = {path.name for path in find_goldens(SAMPLES)}
    recipes = {path.stem: load_recipe(str(path)) for path in shipped_recipes()}
    several = [name for name, recipe in recipes.items() if recipe.followed]
    faces = [name for name in recipes if name.split("_")[0] in ("skin", "ncc")]
    assert len(several) == 2 and len(faces) == 4
    assert {f"{clip}.{recipe}.json" for recipe in faces for clip in ("map", "gestures", "passerby")} <= found
    assert {f"signing.{recipe}.json" for recipe in several} <= found


def test_the_recipe_of_any_box_has_a_golden_of_faces_that_are_covered() -> None:
    found = {path.name for path in find_goldens(SAMPLES)}
    assert {"map.correlation_filter.json", "passerby.correlation_filter.json"} <= found


def is_affine(recipe: Recipe) -> bool:
    return isinstance(recipe, ParticleRecipe) and recipe.target.type == "affine"


def test_every_recipe_that_adapts_has_a_golden_of_both_clips_and_of_who_it_is() -> None:
    found = {path.name: path for path in find_goldens(SAMPLES)}
    affine = [path.stem for path in shipped_recipes() if is_affine(load_recipe(str(path)))]
    assert len(affine) == 7
    for clip, who in (("zoom", "hopper"), ("lamp", "collins")):
        assert {f"{clip}.{recipe}.json" for recipe in affine} <= set(found)
        golden = read_golden(found[f"{clip}.adaptive_recognition.json"])
        assert golden.names == {"face": who}
        assert golden.gallery == File(file="people.npz", sha256=checksum(SAMPLES / "people.npz"))


@pytest.mark.parametrize("path", find_goldens(SAMPLES), ids=lambda path: path.stem)
def test_a_shipped_golden_is_of_the_clip_and_the_recipe_that_are_here(path: Path) -> None:
    golden = read_golden(path)
    assert checksum(SAMPLES / golden.clip.file) == golden.clip.sha256, (
        "record again: facetrack regress sample_videos --update"
    )
    assert differences(completed(golden.settings), to_dict(load_recipe(golden.recipe))) == []
    assert golden.seeds in (1, 40)


def test_a_shipped_golden_is_written_as_it_is(tmp_path: Path) -> None:
    for path in find_goldens(SAMPLES):
        write_golden(tmp_path / path.name, read_golden(path))
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_no_golden_knows_where_it_was_made() -> None:
    for path in find_goldens(SAMPLES):
        text = path.read_text(encoding="utf-8")
        assert not [word for word in (str(Path.home()) + "/", str(SAMPLES)) if word in text]


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
