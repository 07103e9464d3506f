"""Recipes of skin and of several targets at the command line: what users, pipelines and batches meet."""

import csv
import json
from pathlib import Path

import cv2
import pytest

from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.init_file import read_init
from tests.support.media import write_pictures
from tests.support.samples import FOLDER, read_pictures
from tests.support.terminal import refusal

ALL = ["head", "left_hand", "right_hand"]
HEAD, LEFT, RIGHT = "[135, 44, 50, 50]", "[82, 138, 48, 57]", "[188, 131, 50, 60]"
FEW = [f"--set=targets.{name}.filter.particles=200" for name in ALL]


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`sign` as it is, `grey`, `dark` beyond Kovac's rules; `late`: hands from 2 on, `gone`: in 0, `bare`: none."""
    folder = tmp_path_factory.mktemp("clips")
    pictures = list(read_pictures("signing")[:8])
    bare = [picture.copy() for picture in pictures]
    for picture in bare:
        picture[115:] = (40, 30, 25)
    write_pictures(folder / "sign", pictures)
    grey = [cv2.cvtColor(cv2.cvtColor(p, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR) for p in pictures]
    write_pictures(folder / "grey", grey)
    write_pictures(folder / "dark", [(p * (0.25, 0.26, 0.3)).astype("uint8") for p in pictures])
    write_pictures(folder / "late", bare[:2] + pictures[2:])
    write_pictures(folder / "bare", bare[:3])
    write_pictures(folder / "gone", pictures[:1] + bare[1:6])
    (folder / "dark.truth.csv").write_text((FOLDER / "signing.truth.csv").read_text())
    (folder / "dark.init.yaml").write_text((FOLDER / "signing.init.yaml").read_text())
    return folder


def run(facetrack, *args, name="sign", config="head_hands"):
    few = FEW if config.startswith("head") else []
    return facetrack("run", f"IN/{name}", "--config", config, *few, "--no-video", "-q", *args)


def init(**boxes):
    """An init file of these boxes, or of points where they begin with a brace."""
    lines = [f"{name}: {{{'points' if at[0] == '{' else 'box'}: {at}}}" for name, at in boxes.items()]
    Path("here.yaml").write_text("\n".join(["frame: 0", *lines]) + "\n")
    return ["--init", "here.yaml"]


def rows(text):
    """The rows of the first frame by their target: left, top, width, height."""
    first = [row for row in csv.DictReader(text.splitlines()) if row["status"] == "init"]
    numbers = {row["target"]: [float(row[key]) for key in "xywh"] for row in first}
    return {name: [x - (w - 1) / 2, y - (h - 1) / 2, w, h] for name, (x, y, w, h) in numbers.items()}


@pytest.mark.parametrize(
    ("config", "begin"),
    [
        ("head_hands", ["--init", "haar"]),
        ("head_hands_cloud", ["--box", "135,44,50,50"]),
        ("head_hands", {"head": HEAD}),
        ("head_hands_cloud", {"head": HEAD, "right_hand": RIGHT}),
    ],
)
def test_hands_that_nobody_placed_are_found(facetrack, config, begin):
    code, out, err = run(facetrack, *(init(**begin) if isinstance(begin, dict) else begin), "-o", "-", config=config)
    assert (code, err) == (0, "")
    found = rows(out)
    assert list(found) == ALL
    assert found["left_hand"][0] < found["head"][0] < found["right_hand"][0]
    if "right_hand" in begin:
        assert found["right_hand"] == pytest.approx([188, 131, 50, 60]), "what the file says is kept"


BOTH = {"left_hand": LEFT, "right_hand": RIGHT}


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (BOTH, "add one, as in head: {box: [x, y, w, h]}, or look for a face with"),
        ({"head": HEAD, "left_hand": "{nose: [90, 160]}", "right_hand": RIGHT}, "left_hand has no box"),
        ({"head": "[-500, 44, 50, 50]"}, "here.yaml: the centre of the box [-500, 44, 50, 50] of head is outside"),
    ],
)
def test_a_start_that_does_not_do_is_told_in_one_line(facetrack, begin, said):
    assert said in refusal(run(facetrack, *init(**begin)), 3)


@pytest.mark.parametrize("override", ["targets.right_hand=null", "exclusion=null", "targets.foot=null"])
def test_boxes_at_the_border_large_and_tiny_ones_are_followed(facetrack, override):
    """Whatever the recipe leaves out, which is passed over in the init file."""
    options = init(head="[0, 0, 320, 240]", left_hand="[-20, 138, 48, 57]", right_hand="[290, 200, 6, 6]")
    few = FEW[:2] if "hand" in override else FEW
    words = ["run", "IN/sign", "--config", "head_hands", *few, "--set", override, *options, "--no-video", "-q"]
    code, out, err = facetrack(*words, "-o", "-")
    assert (code, err) == (0, "") and list(rows(out)) == ALL[: len(few)] and len(out.splitlines()) == 1 + len(few) * 8
    assert "nan" not in out and "inf" not in out


def test_a_grey_clip_is_refused_by_its_name_and_with_a_remedy(facetrack, clips):
    said = refusal(run(facetrack, "--box", "135,44,50,50", name="grey", config="skin_ncc"), 3)
    assert f"{clips}/grey: " in said and "of the face's box have a colour" in said and "as ncc" in said


def test_lost_hands_have_their_exit_code_and_a_face_is_looked_for_until_hands_show_too(facetrack):
    lost = [*init(head=HEAD, **BOTH), "--set", "targets.left_hand.confidence.patience=1", "--fail-on-lost"]
    assert run(facetrack, *lost, "-o", "-")[0] == 0 and run(facetrack, *lost, "-o", "-", name="gone")[0] == 4
    code, out, err = run(facetrack, "-o", "-", name="late")
    assert (code, err) == (0, "")
    assert out.splitlines()[1].startswith("2,") and list(rows(out)) == ALL
    said = refusal(run(facetrack, name="bare"), 3)
    assert "frame 0 shows no region of skin beside the head" in said and said.endswith("; no frame to 2 shows more")


def test_a_fallback_is_told_once_and_kept(facetrack):
    code, _, err = facetrack("run", "IN/dark", "--config", "head_hands", *FEW, "--no-video", "-o", "o")
    assert code == 0 and err.count("Kovac") == 1 and "facetrack: warning: head: Kovac's rules find skin in only" in err
    assert [w.partition(": ")[0] for w in json.loads(Path("o/trajectory.json").read_text())["warnings"]] == ["head"]
    code, _, err = facetrack("run", "IN/dark", "--config", "skin", "--init", "haar", "--no-video", "-o", "p")
    assert "facetrack: warning: Kovac" in err, "one target needs no name"
    both = ["--seeds", 2, "--stop", 4, "--no-plots", *FEW]
    code, _, err = facetrack("compare", "IN/dark", "--config", "head_hands", "--partial", *both, "-o", "c")
    assert code == 0 and err.count("Kovac") == 1
    [recipe] = json.loads(Path("c/compare.json").read_text())["recipes"]
    assert len(recipe["warnings"]) == 1 and "Kovac" in recipe["warnings"][0]


def test_of_a_batch_each_line_names_its_clip_once_and_what_worked_is_kept(facetrack, clips):
    options = ["--config", "head_hands", *FEW, "--seed", 3, "--no-video"]
    code, _, err = facetrack("run", "IN/dark", "IN/sign", "IN/bare", *options, "-j", 2, "-o", "many")
    assert code == 5 and "1 of 3 inputs failed" in err
    [failure] = [line for line in err.splitlines() if line.startswith("facetrack: error: ")]
    assert failure.count(f"{clips}/bare") == 1
    [warning] = [line for line in err.splitlines() if line.startswith("facetrack: warning: ")]
    assert warning.startswith(f"facetrack: warning: {clips}/dark: head: Kovac")
    folders = {path.name.partition("-")[0]: path for path in Path("many").iterdir() if path.is_dir()}
    assert sorted(folders) == ["bare", "dark", "sign"] and len(list(folders["bare"].iterdir())) == 1
    assert facetrack("run", "IN/sign", *options, "--threads", 2, "-o", "alone", "-q")[0] == 0
    alone, among = (Path(folder, "trajectory.csv").read_bytes() for folder in ("alone", folders["sign"]))
    assert alone == among


@pytest.mark.parametrize("config", ["head_hands", "skin_ncc_robust", "factorized"])
def test_init_writes_what_a_recipe_begins_with(facetrack, config):
    code, _, err = facetrack("init", "IN/sign", "--config", config, "-o", "begin.yaml", "--preview", "look.png")
    assert code == 0, err
    targets = read_init(Path("begin.yaml")).targets
    assert list(targets) == (list(load_recipe(config).followed) or ["face"])
    assert bool(next(iter(targets.values())).points) == (config == "factorized")
    assert cv2.imread("look.png") is not None
