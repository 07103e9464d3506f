"""Recipes of regions at the command line: what cannot be meant ends in one line that says where and what to do."""

import hashlib
import weakref
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.report.events import history_of
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.reader import read_trajectory
from tests.support.media import write_pictures
from tests.support.moving_head import START, clip, truth
from tests.support.terminal import refusal

ALL = "contour_histogram_correlation"
BOX = ",".join(f"{side:g}" for side in START)
FRAMES = 8
POINTS = (
    "{nose: [120, 90], mouth_left: [110, 100], mouth_right: [130, 100], lip_upper: [120, 98], lip_lower: [120, 103]}"
)


def starts(box="[100, 60, 40, 52]", points=""):
    inside = [f"box: {box}"] * bool(box) + [f"points: {points}"] * bool(points)
    return f"frame: 0\nhead: {{{', '.join(inside)}}}\n"


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Folders of images: `head` and `grey` with boxes to begin with and as ground truth, `points` with points alone."""
    folder = tmp_path_factory.mktemp("clips")
    for name, grey in (("head", False), ("grey", True), ("points", False)):
        write_pictures(folder / name, [frame.bgr for frame in clip(FRAMES, grey=grey)])
    for name in ("head", "grey"):
        (folder / f"{name}.init.yaml").write_text(starts())
        rows = [f"{n},head,box,{x + (w - 1) / 2},{y + (h - 1) / 2},{w},{h},visible"
                for n, (x, y, w, h) in enumerate(truth(FRAMES))]  # fmt: skip
        (folder / f"{name}.truth.csv").write_text("\n".join(["frame,target,part,x,y,w,h,status", *rows]) + "\n")
    (folder / "points.init.yaml").write_text(starts("", POINTS))
    rows = [f"{n},head,nose,120,90,visible" for n in range(FRAMES)]
    (folder / "points.truth.csv").write_text("\n".join(["frame,target,part,x,y,status", *rows]) + "\n")
    return folder


def refused(result, code):
    """The one line of a refusal that left nothing behind."""
    said = refusal(result, code)
    assert list(Path().iterdir()) == []
    return said


def run(facetrack, *args, name="head", config=ALL):
    return facetrack("run", f"IN/{name}", "--config", config, "--no-video", "-q", *args)


# --- where to begin --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("begin", [(), ("--box", BOX)])
def test_colours_on_a_grey_clip_name_the_clip_the_target_and_what_to_do(facetrack, clips, begin):
    said = refused(run(facetrack, *begin, name="grey"), 3)
    assert f"{clips}/grey: {'face' if begin else 'head'}, frame 0: this clip is grey" in said
    assert "use the recipe contour or contour_correlation, or --set likelihood.histogram.value_bins=8" in said


def test_of_two_targets_the_grey_one_is_named(facetrack, clips):
    picture = np.full((120, 160, 3), 128, np.uint8)
    picture[20:80, 10:70] = (40, 60, 220)
    write_pictures(Path("half"), [picture] * 2)
    Path("two.yaml").write_text("frame: 0\nred: {box: [12, 22, 50, 50]}\nwall: {box: [100, 30, 40, 40]}\n")
    code, _, err = facetrack("run", "half", "--init", "two.yaml", "--config", "histogram", "-q", "-o", "o")
    assert code == 3 and "half: wall, frame 0: the box shows no colours" in err
    assert not Path("o").exists()


@pytest.mark.parametrize(
    ("box", "said"),
    [
        ("100,60,1,40", "--box: the box of face is smaller than 6x6 pixels; give a larger one"),
        ("100,60,5.9,6", "smaller than 6x6 pixels"),
        ("0,0,261,200", "the box of face, 261x200 pixels, is larger than the frame of 260x200; make it smaller"),
        ("-400000,-400000,800000,800000", "is larger than the frame of 260x200"),
        ("-31,-31,60,60", "the centre of the box [-31, -31, 60, 60] of face is outside the frame of 260x200 pixels"),
    ],
)
@pytest.mark.parametrize("by", ["--box", "--init"])
def test_a_box_that_cannot_be_followed_is_told_alike_by_option_and_file(facetrack, tmp_path, by, box, said):
    file = tmp_path / "here.yaml"
    file.write_text(starts(f"[{box}]"))
    if by == "--init":
        said = said.replace("--box:", f"{file}:").replace("face", "head")
    told = refused(run(facetrack, by, box if by == "--box" else file), 3)
    assert said in told and "chin" not in told


@pytest.mark.parametrize("box", ["-3,-3,6,6", "0,0,260,200"])
def test_boxes_at_the_border_are_followed(facetrack, box):
    options = ["--set", "likelihood.histogram.value_bins=8", "-o", "-", "--box", box, "--stop", "4"]
    code, out, err = run(facetrack, *options)
    assert (code, err) == (0, "")
    assert len(out.splitlines()) == 5 and "nan" not in out and "inf" not in out


def test_a_box_too_narrow_for_the_reduced_picture_names_the_setting(facetrack):
    options = ["--set", "likelihood.histogram.max_size=16", "--box", "10,10,6,180"]
    said = refused(run(facetrack, *options, config="histogram"), 3)
    assert "the box has no pixel of the image at 1/16 of its size" in said and "likelihood.histogram.max_size" in said


def test_a_batch_says_of_which_clip_it_speaks(facetrack, clips):
    code, _, err = facetrack(
        "run", "IN/head", "IN/grey", "--config", "contour", "--box", "0,0,261,200", "-q", "-o", "o"
    )
    assert code == 5
    told = [line for line in err.splitlines() if "larger than the frame" in line]
    assert [line.split(": --box: ")[0] for line in told] == [
        f"facetrack: error: {clips}/head",
        f"facetrack: error: {clips}/grey",
    ]


# --- what a recipe may say -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "overrides",
    [
        ["motion.position.A=[[1, 1e6], [0, 1]]", "motion.position.B=[[1e6px], [1e6px]]"],
        ["motion.position.A=[[0, 1e6], [-1e-6, 0]]", "target.scale=[0.000001, 100]"],
        ["motion.scale.A=[[1, 1e6], [0, 1]]", "motion.scale.B=[[1e6], [1e6]]", "motion.position.B=[[0], [0]]"],
        ["likelihood.correlation={grid: [64, 1], sigma: 0.001, distance: hausdorff, region: 1e-300}"],
        ["likelihood.histogram={hue_bins: 1, saturation_bins: 1, regions: [64, 64], lambda_h: 1e6, value_bins: 64}"],
        ["likelihood.contour={normals: 4, sigma: 1e6, search: 10, threshold: 1e-300, outlier: 1e-320}"],
        ["filter={type: auxiliary, particles: 1}", "likelihood.correlation=null", "likelihood.histogram=null"],
    ],
)
def test_what_is_allowed_stays_finite_however_far_it_goes(facetrack, overrides):
    options = [word for override in overrides for word in ("--set", override)]
    code, out, err = run(facetrack, *options, "-o", "-")
    assert (code, err) == (0, "")
    rows = [line.split(",") for line in out.splitlines()]
    columns = [rows[0].index(name) for name in ("x", "y", "w", "h", "std_x", "std_y", "ess", "confidence")]
    assert len(rows) == FRAMES + 1
    assert np.isfinite([[float(row[column]) for column in columns] for row in rows[1:]]).all()


def test_correlation_alone_cannot_fail_on_lost(facetrack):
    options = ["--set", "likelihood.histogram=null", "-o", "o"]
    said = refused(run(facetrack, *options, "--fail-on-lost", config="histogram_correlation"), 2)
    assert "--fail-on-lost: histogram_correlation has correlation alone" in said and "give likelihood.contour" in said
    assert run(facetrack, *options, config="histogram_correlation")[0] == 0


# --- points and boxes ------------------------------------------------------------------------------------------------


def test_a_recipe_of_points_on_a_clip_of_boxes_says_what_follows_boxes(facetrack, clips):
    begin = Path("two.yaml")
    begin.write_text("frame: 0\na: {box: [100, 60, 40, 52]}\nb: {box: [20, 130, 40, 40]}\n")
    code, _, err = run(facetrack, "--init", "two.yaml", config="factorized")
    assert code == 3 and "two.yaml: no point for nose, mouth_left" in err
    assert "or follow its box by a recipe of regions, as contour_histogram" in err


def test_a_recipe_of_regions_on_a_clip_of_points_says_what_follows_points(facetrack, clips):
    said = refused(run(facetrack, name="points"), 3)
    assert f"{clips}/points.init.yaml: head has no box, which the recipe follows; add one" in said
    assert "or follow its points, by a recipe such as factorized" in said


def test_boxes_are_not_compared_with_truth_of_points_nor_points_with_truth_of_boxes(facetrack, clips):
    compare = ["compare", "IN/head", "--seeds", "1", "-q", "--no-plots"]
    said = refused(facetrack(*compare, "--truth", "IN/points.truth.csv", "--config", "contour"), 3)
    assert "it has head/nose, the trajectory head/box" in said
    assert "give ground truth of boxes, or track with a recipe of points" in said
    Path("both.yaml").write_text(starts(points=POINTS))
    result = facetrack(*compare, "--init", "both.yaml", "--config", "sir:filter.particles=5")
    assert result[0] == 3
    assert "give ground truth of points, or track by a recipe of regions, as contour_histogram" in result[2]


def test_without_a_start_truth_of_points_says_that_it_has_no_box(facetrack, clips):
    Path("bare").symlink_to(clips / "points")
    options = ["--truth", "IN/points.truth.csv", "--config", "contour", "--seeds", "1", "-q", "--no-plots"]
    code, _, err = facetrack("compare", "bare", *options)
    assert code == 3 and "no frame shows a box of every target" in err
    assert "or take a recipe of points, as factorized" in err


def test_goldens_skip_clips_that_lack_what_a_recipe_follows(facetrack, clips):
    folder = Path("sample")
    folder.mkdir()
    for name, begin in (("boxes", starts() + "hand: {box: [20, 130, 40, 40]}\n"), ("points", starts("", POINTS))):
        (folder / name).symlink_to(clips / "head")
        (folder / f"{name}.init.yaml").write_text(begin)
    code, out, _ = facetrack("regress", folder, "--config", "sir", "--config", "contour", "--update", "--stop", 2, "-q")
    skipped = [line for line in out.splitlines() if "skipped" in line]
    assert code == 0 and len(skipped) == 2
    of_boxes, of_points = sorted(skipped)
    assert "boxes sir: skipped" in of_boxes and "nose" in of_boxes
    assert "points contour: skipped" in of_points and "has no box" in of_points


# --- the same bytes, and no more memory ------------------------------------------------------------------------------


def test_threads_and_processes_do_not_change_a_byte(facetrack):
    config = "contour_histogram_correlation_robust"

    def csv(folder):
        return hashlib.sha256(Path(folder, "trajectory.csv").read_bytes()).hexdigest()

    for threads in (1, 2):
        code, _, err = run(facetrack, "--seed", 7, "--threads", threads, "-o", f"t{threads}", config=config)
        assert code == 0, err
    many = ["IN/head", "IN/grey", "--set", "likelihood.histogram.value_bins=1", "--config", config, "--seed", 7]
    code, _, err = facetrack("run", *many, "--no-video", "-q", "-j", 2, "-o", "many")
    assert code == 5 and "grey: head, frame 0: this clip is grey" in err
    assert csv("t1") == csv("t2") == csv(f"many/head-{config}-likelihood.histogram.value_bins=1")


def test_of_all_frames_the_last_alone_is_kept():
    pictures = []

    kept = [Frame(f.index, f.time_s, f.bgr.copy()) for f in clip(6)]

    def one_by_one():
        while kept:
            frame = kept.pop(0)
            pictures.append(weakref.ref(frame.bgr))
            yield frame
            del frame

    begin = Start(0, {"head": TargetStart(box=START)}, "here")
    for result in track(build_tracker(load_recipe(ALL), begin), one_by_one(), 0):
        del result
        assert sum(picture() is not None for picture in pictures) <= 2


def test_a_clip_of_one_frame_does_not_say_that_its_tracker_is_blind(facetrack):
    assert run(facetrack, "--stop", 1, "-o", "one")[0] == 0
    table = read_trajectory(Path("one"))
    [part] = history_of(table, Clock(table, 25.0)).parts
    assert part.judged and part.last_status == "init"
