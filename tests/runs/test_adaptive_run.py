"""The recipes of Zhou et al. from clip to files: scale, who it is, goldens, and what is wrong said in one line."""

import json
import re
import shutil
import textwrap
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import ExitCode
from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation.goldens import read_golden
from facetrack_cli.recipe.load import load_recipe, with_gallery
from facetrack_cli.trackers.appearance.gallery import fit_gallery
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.reader import read_trajectory
from tests.support.media import write_pictures
from tests.support.samples import FOLDER, read_pictures
from tests.support.terminal import refusal

BOX = "[78.41, 79.91, 66, 66]"
PEOPLE = FOLDER / "people.npz"

RECOGNITION = (FOLDER.parent / "configs" / "adaptive_recognition.yaml").read_text().partition("seed: 0\n")[2]


def some_gallery(shape=(30, 26), names=("anna", "ben", "cleo")):
    """Of faces that vary slowly over the patch; nobody whom a clip shows."""
    rng = np.random.default_rng(0)
    rows, cols = np.meshgrid(np.linspace(0, np.pi, shape[0]), np.linspace(0, np.pi, shape[1]), indexing="ij")
    waves = np.stack([np.cos(i * rows) * np.cos(j * cols) for i in range(4) for j in range(4) if i + j])
    faces = np.repeat(rng.normal(size=(len(names), 15)), 4, axis=0) + 0.3 * rng.normal(size=(4 * len(names), 15))
    x = faces @ waves.reshape(15, -1) + rng.normal(0.0, 0.05, (4 * len(names), waves[0].size))
    x = (x - x.mean(1, keepdims=True)) / x.std(1, keepdims=True)
    return fit_gallery(x, np.repeat(names, 4).tolist(), shape, negatives=rng.normal(size=(20, waves[0].size)))


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`zoom`, a few frames of a face, and what becomes of it; galleries of two sizes."""
    folder = tmp_path_factory.mktemp("adaptive")
    pictures = list(read_pictures("zoom")[:6])
    write_pictures(folder / "zoom", pictures)
    (folder / "zoom.init.yaml").write_text(f"frame: 0\nbox: {BOX}\n")
    dark = [np.zeros_like(picture) for picture in pictures]
    write_pictures(folder / "fades", [*pictures[:2], *dark[:3]])
    write_pictures(folder / "grey", [np.repeat(picture[..., 1:2], 3, axis=2) for picture in pictures])
    write_pictures(folder / "pair", [np.hstack([one, one[:, ::-1]]) for one in pictures])
    some_gallery().save(folder / "people.npz")
    some_gallery((24, 20)).save(folder / "small.npz")
    return folder


def refused(result, code):
    """What is wrong, without what every line begins with."""
    return refusal(result, code).removeprefix("facetrack: error: ")


def run(facetrack, *args, config="adaptive_recognition", clip="zoom"):
    return facetrack("run", f"IN/{clip}", "--config", config, "--no-video", "-q", *args)


def followed(facetrack, clip, recipe, *more):
    """The finished run, its one box, the overlap with the truth, and the scale beside the true one, both 1 at first."""
    code, _, err = facetrack("run", FOLDER / f"{clip}.mp4", "--config", recipe, "-q", "-o", "out", *more)
    assert (code, err) == (0, "")
    run = read_trajectory(Path("out"))
    (part,) = run.parts
    truth = read_truth(FOLDER / f"{clip}.truth.csv").parts[0].take(part.frame)
    scale = np.sqrt(((part.w / part.w[0]) ** 2 + (part.h / part.h[0]) ** 2) / 2)
    side = np.sqrt(truth.w * truth.h)
    return run, part, iou(part.boxes, truth.boxes), scale, side / side[0]


@pytest.mark.parametrize(
    ("clip", "growth", "alike", "error", "overlap"),
    [("zoom", 3, 0.97, 0.25, 0.78), ("lamp", 1, 0.75, 0.6, 0.75)],  # 3.2, .995, .16, .845; 1.3, .857, .44, .830
)
def test_the_scale_follows_the_truth(facetrack, clip, growth, alike, error, overlap):
    _, _, found, scale, true = followed(facetrack, clip, "adaptive", "--no-video")
    assert true.max() / true.min() > growth, "the clip has something to follow"
    assert np.corrcoef(scale, true)[0, 1] > alike
    off = np.exp(np.abs(np.log(scale / true))) - 1
    assert np.median(off) < 0.13 and off.max() < error
    assert found.mean() > overlap


def test_a_run_writes_who_it_is(facetrack):
    more = ["--gallery", PEOPLE, "--stop", 30]
    run, face, overlap, _, _ = followed(facetrack, "zoom", "adaptive_recognition", *more)
    passed = run.recognised(run.targets[0], "hopper")
    assert passed is not None and passed <= 10  # 2
    later = face.frame >= 10
    assert (face.identity[later] == "hopper").all() and face.identity_prob[later].min() > 0.9
    assert face.identity[0] == "" and (face.identity[1:] != "").all()
    assert overlap.mean() > 0.75 and face.particles[1:].mean() < 80  # .839, 64
    whole = json.loads(Path("out/trajectory.json").read_text())
    assert whole["recipe"]["recognition"]["gallery"].endswith("people.npz")
    targets = [frame["targets"][0] for frame in whole["frames"]]
    first, last = targets[0], targets[-1]
    assert list(first["posterior"].values()) == [pytest.approx(1 / 6, abs=1e-4)] * 6 and "identity" not in first
    assert last["identity"] == "hopper" and sum(last["posterior"].values()) == pytest.approx(1, abs=1e-3)
    assert first["entropy"] == pytest.approx(np.log(6), abs=1e-3) and last["entropy"] < 0.1
    a1, a2, a3, a4, x, y = last["affine"]
    assert last["scale"] == pytest.approx(np.sqrt((a1**2 + a2**2 + a3**2 + a4**2) / 2), abs=1e-3)
    (part,) = last["parts"]
    assert (part["x"], part["y"]) == pytest.approx((x, y), abs=1e-3)
    assert all(0.5 <= target["noise"] <= 2 and target["error"] > 0 for target in targets[1:])


def test_a_golden_holds_who_it_is_and_finds_its_gallery(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Path("clips")
    folder.mkdir()
    for name in ("zoom.mp4", "zoom.init.yaml", "people.npz"):
        shutil.copy(FOLDER / name, folder)

    def regress(*more):
        code = main(["regress", "clips", "-q", *map(str, more)])
        return code, capfd.readouterr().out

    first = ["--update", "--config", "adaptive_recognition", "--stop", 5]
    code, out = regress(*first)
    assert code == ExitCode.BATCH and "not recorded: " in out and "--gallery FILE" in out
    assert regress(*first, "--gallery", "clips/people.npz")[0] == 0
    (path,) = folder.glob("goldens/*.json")
    golden, before = read_golden(path), path.read_bytes()
    assert golden.names == {"face": "hopper"} and golden.gallery == "people.npz"
    assert golden.settings["recognition"]["gallery"] == "people.npz" and str(tmp_path) not in path.read_text()
    code, out = regress()
    assert code == 0 and "the same rows" in out
    assert regress("--update")[0] == 0 and path.read_bytes() == before, "with the gallery that it remembers"
    (folder / "people.npz").unlink()
    code, out = regress()
    assert code == ExitCode.REGRESSION and 'there is no file "clips/people.npz"' in out


RUN = ["run", "IN/zoom"]
BOTH = (RUN, ["compare", "IN/zoom", "--truth", FOLDER / "zoom.truth.csv", "--config", "adaptive"])
KNOWS, MISSING = ["--config", "adaptive_recognition"], ["--gallery", "IN/missing.npz"]
NOT_THERE = [r"missing\.npz", "no such file", "facetrack gallery fit"]
OTHER_SIZE = [r"small\.npz", "24 points high and 20 wide", "30 points high and 26 wide", "fit a gallery of that size"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        *(([*how, *KNOWS, *MISSING], 3, NOT_THERE) for how in (*BOTH, ["regress", "IN/."])),
        *(([*how, *KNOWS, "--gallery", "IN/small.npz"], 2, OTHER_SIZE) for how in BOTH),
        *(([*how, *KNOWS], 2, ["^--gallery is missing: adaptive_rec", "facetrack gallery fit"]) for how in BOTH),
        *(([*how, "--gallery="], 2, ["--gallery is empty"]) for how in ([*RUN, "--config", "adaptive"], BOTH[1])),
        *(
            (
                [*RUN, "--config", name, "--gallery", "IN/people.npz"],
                2,
                [f"^--gallery: {name} follows no affine target"],
            )
            for name in ("factorized", "csrt", "head_hands")
        ),
    ],
)
def test_a_gallery_that_is_not_the_recipes_or_is_not_said(facetrack, words, code, said):
    told = refused(facetrack(*words), code)
    assert all(re.search(part, told) for part in said) and not list(Path().iterdir())


def test_a_gallery_of_any_name_lies_in_the_working_directory_or_beside_the_recipe(facetrack, clips, monkeypatch):
    recipe = Path("recipes/mine.yaml")
    recipe.parent.mkdir()
    shutil.copy(FOLDER.parent / "configs" / "adaptive_recognition.yaml", recipe)
    name = 'a: "q\new.npz'  # whatever YAML makes of it
    shutil.copy(clips / "people.npz", name)
    shutil.copy(clips / "people.npz", "recipes/beside.npz")
    assert run(facetrack, "--stop=2", f"--gallery={name}", "-o", "a", config=recipe)[0] == 0
    assert json.loads(Path("a/trajectory.json").read_text())["recipe"]["recognition"]["gallery"] == name
    # an option does not know of the recipe's folder, a key in the recipe does
    assert "no such file" in refused(run(facetrack, "--gallery=beside.npz", "-o", "b", config=recipe), 3)
    recipe.write_text(recipe.read_text().replace("recognition: {}", "recognition: {gallery: beside.npz}"))
    assert run(facetrack, "--stop=2", "-o", "c", config=recipe)[0] == 0


def test_in_a_comparison_the_gallery_goes_to_the_recipes_that_recognise():
    recipes = [load_recipe(name) for name in ("adaptive", "adaptive_recognition", "histogram")]
    file = str(FOLDER / "zoom.mp4")  # it is not read
    found = with_gallery(recipes, file)
    assert [getattr(one, "recognition", None) is not None for one in found] == [False, True, False]
    assert found[1].recognition.gallery == file
    assert recipes[1].recognition.gallery is None and found[1].name == "adaptive_recognition"
    assert with_gallery([recipes[0], recipes[2]], file)[0].recognition.gallery == file


@pytest.mark.parametrize(
    ("clip", "box"),
    [("grey", "79,80,66,66"), ("zoom", "-15,-15,66,66"), ("zoom", "79,80,6,6"), ("zoom", "0,0,320,240")],
)
def test_clips_and_boxes_of_every_kind(facetrack, clip, box):
    code, out, err = run(facetrack, "--box", box, "-o", "-", config="fixed_template", clip=clip)
    assert code == 0 and out.count("\n") == 7 and "nan" not in out and "inf" not in out
    assert err == "" or err.count("times as wide as high") == 1


def test_a_face_that_is_lost_is_known_still_and_told_by_the_exit_code(facetrack):
    code, out, _ = run(facetrack, "--box=79,80,66,66", "--gallery=IN/people.npz", "-o", "-", clip="fades")
    rows = [line.split(",") for line in out.splitlines()[1:]]
    assert code == 0 and [row[10] for row in rows][-1] == "lost" and rows[-1][-2] == rows[1][-2] != ""
    args = ["--box=79,80,66,66", "--gallery=IN/people.npz", "--fail-on-lost", "-o", "out"]
    assert run(facetrack, *args, clip="fades")[0] == 4


PLAIN = RECOGNITION.replace("recognition: {}\n", "")


@pytest.mark.parametrize(
    ("left", "right", "more", "named"),
    [
        (RECOGNITION, RECOGNITION, "exclusion: {strength: 0.9, reach: 1.0}\n", {"left": True, "right": True}),
        (PLAIN, RECOGNITION, "", {"left": False, "right": True}),
        (PLAIN, PLAIN, "", {"left": True, "right": True}),  # none of them asks for it: all are recognised
    ],
)
def test_of_several_targets_those_recognise_that_are_meant_to(facetrack, left, right, more, named):
    sections = "".join(
        f"  {name}:\n" + textwrap.indent(text, "    ") for name, text in (("left", left), ("right", right))
    )
    Path("several.yaml").write_text(f"type: particle_filters\ndescription: several\ntargets:\n{sections}{more}")
    Path("pair.yaml").write_text(f"frame: 0\nleft: {{box: {BOX}}}\nright: {{box: [494.59, 79.91, 66, 66]}}\n")

    def track(*gallery):
        return run(facetrack, "--init=pair.yaml", *gallery, "-o", "-", config="several.yaml", clip="pair")

    if right == RECOGNITION:
        assert refused(track(), 2).startswith("--gallery is missing")
    told = refused(track("--gallery=IN/small.npz"), 2)
    assert "small.npz" in told and "24 points high" in told
    code, out, err = track("--gallery=IN/people.npz")
    assert (code, err) == (0, "")
    rows = [line.split(",") for line in out.splitlines()[3:]]
    assert {row[2]: bool(row[-2]) for row in rows} == named


@pytest.mark.parametrize("config", ["adaptive_recognition", "adaptive"])
def test_init_says_how_to_go_on(facetrack, config):
    code, _, err = facetrack("init", FOLDER / "zoom.mp4", "--config", config, "-o", "start.yaml")
    assert code == 0 and err.endswith(f"--config {config}" + " --gallery FILE" * (config != "adaptive") + "\n")
