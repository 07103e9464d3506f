"""Golden files: what is written is read back, and what is no golden is refused in a line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.evaluation.goldens.goldens import (
    Golden,
    checksum,
    differences,
    find_goldens,
    golden_path,
    read_golden,
    record,
    write_golden,
)
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe, completed, to_dict
from tests.evaluation.test_bands import RECORDED

SAMPLES = Path(__file__).parents[2] / "sample_videos"


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
