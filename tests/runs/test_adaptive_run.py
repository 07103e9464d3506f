"""Recipes of affine targets and galleries at the command line: what users meet, and what is wrong said in one line."""

import json
import re
import shutil
import textwrap
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.recipe.load import check_recipe, load_recipe, with_gallery
from facetrack_cli.trackers.appearance.gallery_fit import fit_gallery
from tests.support.media import write_pictures
from tests.support.samples import FOLDER, read_pictures
from tests.support.terminal import refusal

BOX = "[78.41, 79.91, 66, 66]"


RECOGNITION = (FOLDER.parent / "configs" / "adaptive_recognition.yaml").read_text().partition("seed: 0\n")[2]


def some_gallery(shape=(30, 26), names=("anna", "ben", "cleo")):
    """Of faces that vary slowly over the patch; nobody whom a clip shows."""
    rng = np.random.default_rng(0)
    rows, cols = np.meshgrid(np.linspace(0, np.pi, shape[0]), np.linspace(0, np.pi, shape[1]), indexing="ij")
    waves = np.stack([np.cos(i * rows) * np.cos(j * cols) for i in range(4) for j in range(4) if i + j])
    faces = np.repeat(rng.normal(size=(len(names), 15)), 4, axis=0) + 0.3 * rng.normal(size=(4 * len(names), 15))
    x = faces @ waves.reshape(15, -1) + rng.normal(0.0, 0.05, (4 * len(names), waves[0].size))
    x = (x - x.mean(1, keepdims=True)) / x.std(1, keepdims=True)
    return fit_gallery(x, np.repeat(names, 4).tolist(), shape)


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`zoom` and `other`, a few frames of a face; galleries, good and bad."""
    folder = tmp_path_factory.mktemp("adaptive")
    pictures = list(read_pictures("zoom")[:6])
    for name in ("zoom", "other"):
        write_pictures(folder / name, pictures)
        (folder / f"{name}.init.yaml").write_text(f"frame: 0\nbox: {BOX}\n")
    dark = [np.zeros_like(picture) for picture in pictures]
    write_pictures(folder / "dark", dark)
    write_pictures(folder / "fades", [*pictures[:2], *dark[:3]])
    write_pictures(folder / "grey", [np.repeat(picture[..., 1:2], 3, axis=2) for picture in pictures])
    write_pictures(folder / "pair", [np.hstack([one, one[:, ::-1]]) for one in pictures])
    gallery = some_gallery()
    gallery.save(folder / "people.npz")
    some_gallery((24, 20)).save(folder / "small.npz")
    arrays = dict(np.load(folder / "people.npz"))
    np.savez(folder / "newer.npz", **{**arrays, "version": np.array(2)})
    np.savez(folder / "pickled.npz", **{**arrays, "names": np.array(["a", "b", "c"], object)})
    whole = (folder / "people.npz").read_bytes()
    (folder / "half.npz").write_bytes(whole[: len(whole) // 2])
    (folder / "empty.npz").touch()
    (folder / "picture.npz").write_bytes(next((folder / "zoom").iterdir()).read_bytes())
    (folder / "folder").mkdir()
    return folder


def refused(result, code):
    """What is wrong, without what every line begins with."""
    return refusal(result, code).removeprefix("facetrack: error: ")


def run(facetrack, *args, config="adaptive_recognition", clip="zoom"):
    return facetrack("run", f"IN/{clip}", "--config", config, "--no-video", "-q", *args)


# --- recipes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("recipe", "keys", "said"),
    [
        ("adaptive", ["motion.noise=null"], "filter.adapt follows motion.noise, which is null"),
        ("adaptive", ["filter.least=5000000", "motion.velocity=null"], "5,000,000 particles of 26x30 points each"),
        ("adaptive", ["filter.particles=5000000", "motion.velocity=null"], "particles of 26x30 points each"),
        ("adaptive", ["target.scale=[1, 1]"], "with 1, the size at the start, between them"),
        ("adaptive", ["likelihood.template=[5, 30]"], "likelihood.template[1] must be at least 6, not 5"),
        ("adaptive", ["likelihood.template=[26]"], "must have 2 items, not 1"),
        ("adaptive", ["likelihood.mixing={w: 0, s: 0, f: 0}"], "likelihood.mixing is all 0"),
        ("adaptive", ["likelihood.sigma.s=0"], "likelihood.sigma.s must be at least 0.001"),
        ("adaptive", ["motion.noise={least: 3, most: 2}"], "motion.noise.most is below least"),
        ("adaptive", ["motion.velocty=null"], 'did you mean "velocity"'),
        ("adaptive", ["target.parts=[nose]"], '"parts" does not belong to target type "affine" but to points'),
        ("adaptive", ["motion.sigma={nose: 1}"], "motion.sigma must be a length above 0"),
        ("adaptive", ["filter={type: factorized, particles: 9}"], "write sir or auxiliary or adaptive"),
        ("adaptive", ["recognition.galery=x"], 'did you mean "gallery"'),
        ("adaptive", ["recognition=people.npz"], "recognition must be a mapping of keys"),
        ("factorized", ["filter={type: adaptive, particles: 9}"], '"adaptive" does not go with target type "points"'),
        ("histogram", ["filter={type: adaptive, particles: 9}"], '"adaptive" does not go with target type "region"'),
        ("skin", ["recognition={}"], 'recognition does not go with target type "region"'),
    ],
)
def test_mistakes_in_a_recipe_of_an_affine_target(recipe, keys, said):
    found = check_recipe(recipe, keys)
    assert len(found) == 1 and said in str(found[0])


# --- --gallery -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "code", "said"),
    [
        ("missing.npz", 3, ["no such file", "facetrack gallery fit"]),
        ("folder", 3, ["is a folder", "facetrack gallery fit"]),
        ("empty.npz", 3, ["no .npz of plain arrays"]),
        ("picture.npz", 3, ["no .npz of plain arrays"]),
        ("half.npz", 3, ["no .npz of plain arrays"]),
        ("pickled.npz", 3, ["no .npz of plain arrays"]),
        ("newer.npz", 3, ["version 2", "reads version 1"]),
        ("small.npz", 2, ["24 points high and 20 wide", "30 points high and 26 wide", "fit a gallery of that size"]),
        ("x" * 300, 3, ["no such file"]),
    ],
)
@pytest.mark.parametrize("how", ["run", "compare", "regress"])
def test_a_file_that_is_no_gallery_of_the_recipe(facetrack, how, file, code, said):
    one = ["--config", "adaptive_recognition"]
    args = {
        "run": ["run", "IN/zoom", *one],
        "compare": ["compare", "IN/zoom", "--truth", FOLDER / "zoom.truth.csv", "--seeds", 2, *one],
        "regress": ["regress", "IN/.", *one],
    }[how]
    if how == "regress" and file == "small.npz":
        return  # a gallery of its own right
    told = refused(facetrack(*args, "--gallery", f"IN/{file}"), code)
    assert all(part in told for part in said) and file[:20] in told
    assert not list(Path().iterdir())


def test_a_shape_prior_is_no_gallery(facetrack):
    prior = FOLDER.parent / "configs" / "mouth_prior.npz"
    assert "mouth_prior.npz: is not a gallery" in refused(run(facetrack, "--gallery", prior), 3)


@pytest.mark.parametrize("how", ["run", "compare"])
def test_who_is_to_be_recognised_must_be_said(facetrack, how):
    more = {"run": [], "compare": ["--truth", FOLDER / "zoom.truth.csv", "--config", "adaptive"]}[how]
    told = refused(facetrack(how, "IN/zoom", "--config", "adaptive_recognition", *more), 2)
    assert told.startswith("--gallery is missing: adaptive_recognition") and "facetrack gallery fit" in told
    assert "--gallery is empty" in refused(
        facetrack(how, "IN/zoom", "--config", "adaptive", *more[:2], "--gallery="), 2
    )


@pytest.mark.parametrize(
    ("config", "said"),
    [("factorized", "follows points"), ("skin", "follows a region"), ("csrt", "one of OpenCV's own trackers"),
     ("head_hands", "follows a cloud and a region")],
)  # fmt: skip
def test_a_recipe_that_cannot_recognise(facetrack, config, said):
    told = refused(run(facetrack, "--gallery", "IN/people.npz", config=config), 2)
    assert told.startswith(f"--gallery: {config}") and said in told and "take adaptive_recognition" in told


NAMES = ["no", "1e3", "null", "~x", "a: b", "[a]", "#x", "it's", 'q"q', "back\\slash", "a b", "é ü", "- a", "{a: b}",
         "&a", "new\nline", "affine", "x,y", "%41"]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_gallery_may_have_any_name(facetrack, clips, name):
    shutil.copy(clips / "people.npz", name)
    code, _, err = run(facetrack, "--stop=2", "--gallery", name, "-o", "out")
    assert (code, err) == (0, "")
    header = json.loads(Path("out/trajectory.json").read_text())
    assert header["recipe"]["recognition"]["gallery"] == name


def test_a_relative_path_is_that_of_the_working_directory(facetrack, clips, monkeypatch):
    recipe = Path("recipes/mine.yaml")
    recipe.parent.mkdir()
    shutil.copy(FOLDER.parent / "configs" / "adaptive_recognition.yaml", recipe)
    shutil.copy(clips / "people.npz", "here.npz")
    shutil.copy(clips / "people.npz", "recipes/beside.npz")
    assert run(facetrack, "--stop=2", "--gallery=here.npz", "-o", "a", config=recipe)[0] == 0
    # an option does not know of the recipe's folder, a key in the recipe does
    assert "no such file" in refused(run(facetrack, "--gallery=beside.npz", "-o", "b", config=recipe), 3)
    recipe.write_text(recipe.read_text().replace("recognition: {}", "recognition: {gallery: beside.npz}"))
    assert run(facetrack, "--stop=2", "-o", "c", config=recipe)[0] == 0


def test_a_gallery_makes_a_recipe_recognise_that_only_tracks(facetrack):
    code, out, err = run(facetrack, "--gallery=IN/people.npz", "-o", "-", config="adaptive")
    assert (code, err) == (0, "")
    rows = [line.split(",") for line in out.splitlines()]
    assert rows[1][-2] == ""  # nothing is known yet
    assert {row[-2] for row in rows[2:]} <= {"anna", "ben", "cleo"}
    code, out, err = run(facetrack, "--gallery=IN/people.npz", "-o", "-", "--format=jsonl")
    frames = [json.loads(line) for line in out.splitlines()][1:-1]
    assert code == 0 and len(frames) == 6
    for frame in frames:
        [target] = frame["targets"] if isinstance(frame["targets"], list) else frame["targets"].values()
        assert set(target["posterior"]) == {"anna", "ben", "cleo"}
        assert sum(target["posterior"].values()) == pytest.approx(1.0, abs=1e-3)


def test_in_a_comparison_the_gallery_goes_to_the_recipes_that_recognise():
    recipes = [load_recipe(name) for name in ("adaptive", "adaptive_recognition", "histogram")]
    file = str(FOLDER / "zoom.mp4")  # it is not read
    found = with_gallery(recipes, file)
    assert [getattr(one, "recognition", None) is not None for one in found] == [False, True, False]
    assert found[1].recognition.gallery == file
    assert recipes[1].recognition.gallery is None and found[1].name == "adaptive_recognition"
    assert with_gallery([recipes[0], recipes[2]], file)[0].recognition.gallery == file


def test_several_clips_are_each_told_who_is_in_them(facetrack):
    code, _, err = facetrack(
        "run",
        "IN/zoom",
        "IN/other",
        "--config",
        "adaptive_recognition",
        "--gallery",
        "IN/people.npz",
        "-j",
        2,
        "-o",
        "out",
    )
    assert code == 0 and not re.search("warning|error", err)
    one, other = (Path(f"out/{name}-adaptive_recognition/trajectory.csv").read_text() for name in ("zoom", "other"))
    assert one == other and "anna" in one + "anna"
    # a mistake in what is common to all clips is said once, before any
    told = refused(
        facetrack("run", "IN/zoom", "IN/other", "--config", "adaptive_recognition", "--gallery=IN/half.npz"), 3
    )
    assert "half.npz" in told


# --- clips ---------------------------------------------------------------------------------------------------------

SEVEN = [path.stem for path in shipped_recipes() if re.match("adaptive|fixed_template", path.stem)]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("config", SEVEN)
def test_clips_and_boxes_of_every_kind(facetrack, config):
    known = ["--gallery=IN/people.npz"] if config == "adaptive_recognition" else []

    def track(clip, box):
        return run(facetrack, "--box", box, "-o", "-", *known, config=config, clip=clip)

    assert len(SEVEN) == 7
    for clip, box in (
        ("grey", "79,80,66,66"),
        ("zoom", "-15,-15,66,66"),
        ("zoom", "79,80,6,6"),
        ("zoom", "0,0,320,240"),
    ):
        code, out, err = track(clip, box)
        assert code == 0 and out.count("\n") == 7 and "nan" not in out and "inf" not in out
        assert err == "" or err.count("times as wide as high") == 1
    assert "one grey level" in refused(track("dark", "79,80,66,66"), 3)
    assert "more than half of the box lies outside" in refused(track("zoom", "-32,-32,66,66"), 3)
    assert "smaller than 6x6" in refused(track("zoom", "79,80,5,66"), 3)
    assert "outside the frame" in refused(track("zoom", "500,80,66,66"), 3)
    assert "larger than the frame" in refused(track("zoom", "0,0,640,240"), 3)


def test_a_face_that_is_lost_is_known_still_and_told_by_the_exit_code(facetrack):
    code, out, _ = run(facetrack, "--box=79,80,66,66", "--gallery=IN/people.npz", "-o", "-", clip="fades")
    rows = [line.split(",") for line in out.splitlines()[1:]]
    assert code == 0 and [row[10] for row in rows][-1] == "lost" and rows[-1][-2] == rows[1][-2] != ""
    args = ["--box=79,80,66,66", "--gallery=IN/people.npz", "--fail-on-lost", "-o", "out"]
    assert run(facetrack, *args, clip="fades")[0] == 4


# --- several targets -----------------------------------------------------------------------------------------------


def several(*targets, more=""):
    """A recipe of these targets, of which each is a recipe's text."""
    sections = "".join(f"  {name}:\n" + textwrap.indent(text, "    ") for name, text in targets)
    Path("several.yaml").write_text(f"type: particle_filters\ndescription: several\ntargets:\n{sections}{more}")
    Path("pair.yaml").write_text(f"frame: 0\nleft: {{box: {BOX}}}\nright: {{box: [494.59, 79.91, 66, 66]}}\n")
    return ["--init", "pair.yaml"]


@pytest.mark.parametrize("more", ["", "exclusion: {strength: 0.9, reach: 1.0}\n"])
def test_two_faces_are_recognised_each_for_itself(facetrack, more):
    start = several(("left", RECOGNITION), ("right", RECOGNITION), more=more)
    assert refused(run(facetrack, *start, config="several.yaml", clip="pair"), 2).startswith("--gallery is missing")
    code, out, err = run(
        facetrack, *start, "--gallery=IN/people.npz", "-o", "-", "--format=jsonl", config="several.yaml", clip="pair"
    )
    assert (code, err) == (0, "")
    header, *frames = [json.loads(line) for line in out.splitlines()][:-1]
    galleries = [one["recognition"]["gallery"] for one in header["recipe"]["targets"].values()]
    assert len(set(galleries)) == 1 and galleries[0].endswith("people.npz")
    assert all(set(target["posterior"]) == {"anna", "ben", "cleo"} for frame in frames for target in frame["targets"])


def test_of_several_targets_those_recognise_that_are_meant_to(facetrack):
    plain = RECOGNITION.replace("recognition: {}\n", "")
    start = several(("left", plain), ("right", RECOGNITION))
    _, out, _ = run(facetrack, *start, "--gallery=IN/people.npz", "-o", "-", config="several.yaml", clip="pair")
    rows = [line.split(",") for line in out.splitlines()[3:]]
    assert {row[2]: bool(row[-2]) for row in rows} == {"left": False, "right": True}
    # none of them asks for it: all are recognised
    start = several(("left", plain), ("right", plain))
    _, out, _ = run(facetrack, *start, "--gallery=IN/people.npz", "-o", "-", config="several.yaml", clip="pair")
    rows = [line.split(",") for line in out.splitlines()[3:]]
    assert {row[2]: bool(row[-2]) for row in rows} == {"left": True, "right": True}
    told = refused(run(facetrack, *start, "--gallery=IN/small.npz", "-o", "-", config="several.yaml", clip="pair"), 2)
    assert "small.npz" in told and "24 points high" in told


def test_points_are_no_target_beside_an_affine_one(facetrack):
    points = (FOLDER.parent / "configs" / "sir.yaml").read_text().partition("seed: 0\n")[2]
    start = several(("left", RECOGNITION), ("right", points))
    told = refused(run(facetrack, *start, "--gallery=IN/people.npz", config="several.yaml", clip="pair"), 2)
    assert "several targets are regions, clouds or affine" in told


@pytest.mark.parametrize("config", ["adaptive_recognition", "adaptive"])
def test_init_says_how_to_go_on(facetrack, config):
    code, _, err = facetrack("init", FOLDER / "zoom.mp4", "--config", config, "-o", "start.yaml")
    assert code == 0 and err.endswith(f"--config {config}" + " --gallery FILE" * (config != "adaptive") + "\n")
