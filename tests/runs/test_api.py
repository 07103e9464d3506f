"""The Python interface: the examples of docs/python.md and README, and what they promise."""

import itertools

import cv2
import numpy as np
import pytest

import facetrack_cli as facetrack
from facetrack_cli.__main__ import main
from facetrack_cli.trajectory.writers import csv_frames
from tests.support.samples import FOLDER
from tests.test_docs import ROOT, blocks

CLIP = FOLDER / "expressions.mp4"
NOISE = np.random.default_rng(1).integers(0, 256, (60, 80, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def images():
    """The first eight frames of a clip, as an array (T, H, W, 3)."""
    from facetrack_cli.video.source import open_source

    with open_source(CLIP, stop=8) as source:
        return np.stack([frame.bgr for frame in source])


def test_every_example_of_the_page_runs(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    (tmp_path / "sample_videos").symlink_to(FOLDER)
    monkeypatch.chdir(tmp_path)
    session = {}
    found = blocks(ROOT / "docs" / "python.md", "python")
    assert len(found) >= 7
    for block in found:
        exec(compile(block, "docs/python.md", "exec"), session)
    assert len(session["trajectory"].frames) == 50 and session["trajectory"].header["complete"]
    assert session["box"].names == (("face", "box"),) and session["hand"].targets == ("hand",)
    assert session["recipe"].filter.particles == 200 and session["recipe"].motion.sigma.root.value == 0.12
    assert session["errors"].mean() < 5
    assert set(session["table"].part) == {part for _, part in session["trajectory"].names}
    assert session["image"].shape == (240, 320, 3) and (tmp_path / "frame.png").stat().st_size > 1000


def test_the_example_of_readme_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    (block,) = blocks(ROOT / "README.md", "python")
    exec(block, {})
    assert capsys.readouterr().out.startswith("49 1")


def test_a_video_gives_the_rows_of_the_command_line(tmp_path):
    assert main(["run", str(CLIP), "--config", "sir", "--stop", "6", "--seed", "4", "--no-video", "-q",
                 "-o", str(tmp_path / "out")]) == 0  # fmt: skip
    found = facetrack.track_video(CLIP, "sir", stop=6, seed=4)
    written = (tmp_path / "out" / "trajectory.csv").read_text().splitlines(keepends=True)
    assert "".join(csv_frames(found)) == "".join(written[1:])
    assert found.header["recipe"]["name"] == "sir" and found.header["seed"] == 4


@pytest.mark.parametrize("wrap", [np.asarray, list, iter, lambda images: (image.copy() for image in images)])
def test_images_of_any_kind_give_the_rows_of_the_video(images, wrap):
    init = FOLDER / "expressions.init.yaml"
    rows = [result.rows for result in facetrack.track_frames(wrap(images), "sir", init=init)]
    expected = facetrack.track_video(CLIP, "sir", init=init, stop=len(images))
    assert len(rows) == len(images)
    for frame, one in enumerate(rows):
        np.testing.assert_array_equal(one.x, expected.at(frame).x)


def test_results_come_as_images_come(images):
    given = []

    def camera():
        for image in images:
            given.append(image)
            yield image

    found = facetrack.track_frames(camera(), "sir", init=FOLDER / "expressions.init.yaml")
    assert [len(given) for _ in itertools.islice(found, 3)] == [1, 2, 3]


def test_a_grey_image_is_tracked_and_drawn(images):
    grey = images.mean(axis=3).astype(np.uint8)
    *_, last = facetrack.track_frames(grey, "ncc", init=(110, 60, 90, 100))
    assert facetrack.draw(last).shape == images[0].shape and last.rows.status[0] in ("tracked", "lost")


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ([np.zeros((8, 8, 3))], r"image 0: is float64 \(8, 8, 3\); give \(height, width, 3\) uint8"),
        ([np.zeros((8, 8, 4), np.uint8)], r"image 0: is uint8 \(8, 8, 4\)"),
        ([NOISE, NOISE[:, 1:]], "image 1: is 79x60, not 80x60 as the first"),
        ([], "there is no frame 0"),
    ],
)
def test_images_that_are_none_are_refused(images, message):
    with pytest.raises(facetrack.InputError, match=message):
        list(facetrack.track_frames(images, "histogram", init=(5, 5, 40, 40)))


def test_mistakes_raise_the_line_of_the_command(tmp_path):
    with pytest.raises(facetrack.InputError, match=r"none\.mp4: "):
        facetrack.track_video(tmp_path / "none.mp4", "sir")
    with pytest.raises(facetrack.RecipeError, match="particle"):
        facetrack.load_recipe("sir", {"filter.particle": 5})
    with pytest.raises(facetrack.InputError, match="neither a file, a box"):
        facetrack.track_video(CLIP, "histogram", init=(1, 2, 3))
    with pytest.raises(facetrack.FacetrackError, match="no_such"):
        facetrack.track_video(CLIP, "no_such")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"faces": "both"}, "faces 'both' is not one of one, all"),
        ({"lag": -1}, "lag -1 is no whole number from 0 on"),
        ({"start": -1}, "start -1 is no whole number"),
        ({"stop": 2.5}, "stop 2.5 is no whole number"),
        ({"fps": 0}, "fps 0 is no rate"),
    ],
)
def test_values_that_the_command_line_refuses(asked, message):
    with pytest.raises(facetrack.FacetrackError, match=message):
        facetrack.track_video(CLIP, "histogram", **asked)


def test_images_and_recordings_take_no_other_values(tmp_path, images):
    with pytest.raises(facetrack.FacetrackError, match=r"lag 1\.5 is no whole number"):
        next(facetrack.track_frames(images, "histogram", init=(5, 5, 40, 40), lag=1.5))
    for about, message in (({"formats": ("xml",)}, "formats: 'xml' is not"), ({"fps": float("nan")}, "fps nan is no")):
        with pytest.raises(facetrack.FacetrackError, match=message), facetrack.Recording(tmp_path / "out", **about):
            pass
    assert not (tmp_path / "out").exists()


def test_only_public_names_are_there():
    assert all(getattr(facetrack, name) is not None for name in facetrack.__all__)
    assert set(facetrack.__all__) < set(dir(facetrack)) and "import_module" not in dir(facetrack)
    with pytest.raises(AttributeError, match="nothing"):
        facetrack.nothing  # noqa: B018


@pytest.mark.parametrize(("recipe", "clip"), [("factorized", CLIP), ("head_hands", FOLDER / "signing.mp4")])
def test_a_recording_is_what_run_writes(tmp_path, recipe, clip):
    from facetrack_cli.video.source import open_source

    begin, images = str(clip.with_suffix(".init.yaml")), tmp_path / "images"
    images.mkdir()
    with open_source(clip, stop=8) as source:
        given = np.stack([frame.bgr for frame in source])
    for i, image in enumerate(given):
        cv2.imwrite(str(images / f"{i}.png"), image)
    assert main(["run", str(images), "--init", begin, "--config", recipe, "-o", str(tmp_path / "run"), "-q"]) == 0
    with facetrack.Recording(tmp_path / "out", recipe, clip=images, fps=25.0) as out:
        for result in facetrack.track_frames(given, recipe, init=begin, fps=25.0):
            out.write(result)
    csv, json = ((tmp_path / "out" / f"trajectory.{form}").read_text() for form in ("csv", "json"))
    assert csv == (tmp_path / "run" / "trajectory.csv").read_text()
    # images do not tell whether the times of their clip vary
    assert json.replace("null", "false") == (tmp_path / "run" / "trajectory.json").read_text().replace("null", "false")
    names = [sorted(path.name for path in (tmp_path / folder).iterdir()) for folder in ("out", "run")]
    assert names[0] == names[1]


@pytest.mark.parametrize("seed", [-1, 2**63, 2**64, 1.5, True, "1"])
def test_a_seed_that_is_none_is_refused_in_one_line_wherever_it_is_given(seed, capsys):
    with pytest.raises(facetrack.RecipeError, match=f"^seed {seed!r} is no whole number from 0 to 9"):
        facetrack.track_video(CLIP, "sir", seed=seed)
    if type(seed) is int:
        assert main(["run", str(CLIP), "--config", "sir", "--seed", str(seed), "-q"]) == 2
        assert f"error: seed {seed} is no whole number from 0" in capsys.readouterr().err


def test_a_fault_of_ours_is_raised_and_not_the_end_of_a_clip(monkeypatch):
    def broken(*_):
        raise AttributeError("ours")

    monkeypatch.setattr("facetrack_cli.engine.target.ParticleTarget.advance", broken)
    with pytest.raises(AttributeError, match="ours"):
        facetrack.track_video(CLIP, "factorized")


def test_a_recording_keeps_what_came_before_an_error(tmp_path, images):
    results = list(facetrack.track_frames(images, "factorized", init=CLIP.with_suffix(".init.yaml")))

    def write():
        with facetrack.Recording(tmp_path / "out", "factorized", video=False) as out:
            for result in results[:5]:
                out.write(result)
            raise ValueError("five")

    with pytest.raises(ValueError, match="five"):
        write()
    kept = facetrack.read_trajectory(tmp_path / "out")
    assert len(kept.frames) == 5 and (kept.header["complete"], kept.header["stopped"]) == (False, "five")
    with pytest.raises(facetrack.FacetrackError, match="exists already"):
        write()
    with pytest.raises(facetrack.InputError, match="has no start"), facetrack.Recording(tmp_path / "x") as out:
        out.write(results[1])
    assert not (tmp_path / "x").exists()
