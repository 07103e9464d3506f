"""--log-format json: an object a line on standard error; NO_COLOR."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import LOG_FORMAT, log_line
from facetrack_cli.recipe.load import find_recipe, read_recipe
from facetrack_cli.runs import progress as module
from facetrack_cli.runs.progress import progress
from tests.support.media import write_video
from tests.support.samples import FOLDER


@pytest.fixture(autouse=True)
def plain_afterwards(monkeypatch):
    monkeypatch.setenv(LOG_FORMAT, "")  # so that what main() sets ends with the test


def objects(text):
    return [json.loads(line) for line in text.splitlines()]


def test_a_run_says_objects(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(module, "EVERY_JSON_S", 0.0)
    clip = FOLDER / "expressions.mp4"
    words = f"run {clip} --config mil --box 110,60,100,100 --stop 5 --no-video -o {tmp_path / 'out'}".split(" ")
    assert main(["--log-format", "json", *words]) == 0
    out, err = capfd.readouterr()
    said = objects(err)
    assert out == "" and {one["level"] for one in said} == {"info"}
    assert all(one["clip"] == clip.name for one in said) and all("time" in one for one in said)
    steps = [one for one in said if one["message"] == "progress"]
    assert {one["unit"] for one in steps} == {"frames"} and all(one["frames_per_s"] > 0 for one in steps)
    done = [one["done"] for one in steps]
    assert done == sorted(done) and done[-1] == 5
    assert any("5 frames" in one["message"] for one in said)
    assert main(["--log-format", "text", *words, "--overwrite"]) == 0
    assert not capfd.readouterr().err.startswith("{")


def test_lines_of_several_clips_say_which(tmp_path, capfd):
    clips = [tmp_path / name for name in ("a.mp4", "b.mp4", "bad.mp4")]
    for clip in clips:
        clip.write_bytes(b"x" if clip.stem == "bad" else (FOLDER / "map.mp4").read_bytes())
    words = ["run", *map(str, clips), "-j", "2", "--box", "100,60,80,80", "--config", "sir", "--no-video"]
    set_ = ["--stop", "3", "--set", "target.parts=[nose]", "--set", "filter.particles=5"]
    assert main(["--log-format", "json", *words, *set_, "-o", str(tmp_path / "out")]) == 5
    said = objects(capfd.readouterr().err)
    for clip in clips:
        assert {one.get("clip") for one in said if clip.name in one["message"]} == {clip.name}
    of_all = [one["message"] for one in said if "clip" not in one and one["message"] != "progress"]
    assert of_all == ["1 of 3 inputs failed"]


def test_the_search_for_a_face_and_errors_are_objects(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(module, "EVERY_JSON_S", 0.0)
    write_video(tmp_path / "nobody.mp4", frames=[np.full((96, 96, 3), 90, np.uint8)] * 12)
    assert main(["--log-format", "json", "run", str(tmp_path / "nobody.mp4"), "-o", str(tmp_path / "out")]) == 3
    *steps, said = objects(capfd.readouterr().err)
    assert {one["message"] for one in steps} == {"progress, looking for a face"} and said["level"] == "error"
    assert [one["done"] for one in steps] == [*range(1, 13)] and {one["total"] for one in steps} == {12}
    assert main(["--log-format", "json", "run", str(tmp_path / "none\nhere.mp4")]) == 3
    (said,) = objects(capfd.readouterr().err)
    assert said["level"] == "error" and "none" in said["message"] and "facetrack" not in said["message"][:9]
    recipe = tmp_path / "r.yaml"
    recipe.write_text(read_recipe(find_recipe("sir")).text.replace("seed: 0", "seed: -1"), encoding="utf-8")
    assert main(["--log-format", "json", "run", str(FOLDER / "map.mp4"), "--config", str(recipe)]) == 2
    (said,) = objects(capfd.readouterr().err)
    assert "seed: Input should be greater than or equal to 0, not -1" in said["message"]


def test_lines_have_their_level_and_quiet_is_quiet(monkeypatch, capfd):
    monkeypatch.setenv(LOG_FORMAT, "json")
    for line, level, message in (
        ("facetrack: warning: a: b", "warning", "a: b"),
        ("facetrack: interrupted", "info", "interrupted"),
        ("a \udce4\nb", "info", "a"),
    ):
        said = json.loads(log_line(line, clip=None, done=1))
        assert said["level"] == level and said["message"].startswith(message) and said["done"] == 1
        assert "clip" not in said
    with progress(quiet=True) as shown:
        shown.begin("[1/3] a.mp4")
        shown.update(1, 2)
        shown.say("hello")
        shown.error("facetrack: error: bad")
    (said,) = objects(capfd.readouterr().err)
    assert (said["level"], said["clip"]) == ("error", "a.mp4")


def test_a_rate_is_of_the_frames_since_a_task_began(monkeypatch, capfd):
    clock = SimpleNamespace(monotonic=iter(np.arange(0.0, 99.0)).__next__)
    monkeypatch.setenv(LOG_FORMAT, "json")
    monkeypatch.setattr(module, "EVERY_JSON_S", 0.0)
    monkeypatch.setattr(module, "time", clock)
    with progress(quiet=False) as shown:
        shown.begin("a.mp4")
        for done in (5001, 5002):  # it goes on
            shown.update(done, 6000)
        shown.looked(1, 90, "painting")
        shown.looked(1, 2, "checksum of the clip", "MB")
        shown.begin("3 clips", "clips", 3)
        shown.update(1, 3)
    said = [(one["message"], one.get("frames_per_s")) for one in objects(capfd.readouterr().err)]
    # each line takes a second more, to see whether it is due
    assert said[:2] == [("progress", 1.0), ("progress", 0.7)] and said[2] == ("progress, painting", 0.5)
    assert said[3:] == [("progress, checksum of the clip", None), ("progress", None)]
