"""The Python interface: the examples of docs/python.md and README, and what they promise; one image at a time."""

import itertools
import os
import shutil
import threading

import av
import cv2
import numpy as np
import pytest

import facetrack_cli as facetrack
from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError, UsageError
from facetrack_cli.core.types import Start
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.trajectory.writers import csv_frames
from facetrack_cli.video.source import open_source
from tests.support import media
from tests.support.damage import raising
from tests.support.samples import FOLDER
from tests.support.sway import names
from tests.test_docs import ROOT, blocks

CLIP = FOLDER / "expressions.mp4"
INIT = CLIP.with_suffix(".init.yaml")
NOISE = np.random.default_rng(1).integers(0, 256, (60, 80, 3), dtype=np.uint8)
BOX = (110, 60, 90, 90)
NOBODY = Start(0, {}, "x")


@pytest.fixture(scope="module")
def images():
    """The first frames of a clip, as an array (T, H, W, 3)."""
    with open_source(CLIP, stop=30) as source:
        return np.stack([frame.bgr for frame in source])


def test_every_example_of_the_page_runs(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    short = shutil.copytree(FOLDER, tmp_path / "sample_videos", copy_function=os.symlink) / CLIP.name
    short.unlink()
    media.ffmpeg("-i", CLIP, "-c", "copy", "-frames:v", "60", short)
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


def test_a_video_gives_the_rows_of_the_command_line(tmp_path):
    few = ["--config", "sir", "--stop", "6", "--seed", "4", "--no-video", "-q"]
    assert main(["run", str(CLIP), *few, "-o", str(tmp_path / "out")]) == 0
    found = facetrack.track_video(CLIP, "sir", stop=6, seed=4)
    written = (tmp_path / "out" / "trajectory.csv").read_text().splitlines(keepends=True)
    assert "".join(csv_frames(found)) == "".join(written[1:])
    assert found.header["recipe"]["name"] == "sir" and found.header["seed"] == 4


def test_images_of_any_kind_give_the_rows_of_the_video_as_they_come(images):
    expected, given = facetrack.track_video(CLIP, "sir", init=INIT, stop=4), []

    def camera():
        for image in images:
            given.append(image)
            yield image

    for kind in (images[:4], list(images[:4]), camera()):
        results = itertools.islice(facetrack.track_frames(kind, "sir", init=INIT), 4)
        for frame, one in enumerate(results):
            np.testing.assert_array_equal(one.rows.x, expected.at(frame).x)
            assert len(given) in (0, frame + 1)
    assert frame == 3


def test_a_grey_image_is_tracked_and_drawn(images):
    grey = images[:8].mean(axis=3).astype(np.uint8)
    *_, last = facetrack.track_frames(grey, "ncc", init=(110, 60, 90, 100))
    assert facetrack.draw(last).shape == images[0].shape and last.rows.status[0] in ("tracked", "lost")


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: facetrack.track_video("none.mp4", "sir"), facetrack.InputError, r"none\.mp4: "),
        (lambda: facetrack.load_recipe("sir", {"filter.particle": 5}), facetrack.RecipeError, "particle"),
        (lambda: track(init=(1, 2, 3)), facetrack.InputError, "neither a file, a box"),
        (lambda: track(faces="both"), facetrack.FacetrackError, "faces 'both' is not one of one, all"),
        (lambda: track(lag=-1), facetrack.FacetrackError, "lag -1 is no whole number from 0 on"),
        (lambda: track(stop=0), facetrack.FacetrackError, "^--stop 0 leaves no frame at all; it is the frame to stop"),
        (lambda: track(init=NOBODY), facetrack.InputError, "^x: has no targets; give one, with a box or points"),
        (lambda: follow([NOISE], init=NOBODY), facetrack.InputError, "^x: has no targets; give one"),
        (lambda: track(fps=0), facetrack.FacetrackError, "fps 0 is no rate"),
        (lambda: follow([np.zeros((8, 8, 3))]), facetrack.InputError, r"image 0: is float64 \(8, 8, 3\); give "),
        (lambda: follow([NOISE, NOISE[:, 1:]]), facetrack.InputError, "image 1: is 79x60, not 80x60 as the first"),
        (lambda: follow([]), facetrack.InputError, "there is no frame 0"),
        (lambda: record(formats=("xml",)), facetrack.FacetrackError, "formats: 'xml' is not"),
        (lambda: record(fps=float("nan")), facetrack.FacetrackError, "fps nan is no"),
    ],
)
def test_mistakes_raise_the_line_of_the_command(call, error, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        call()
    assert names(tmp_path) == []


def track(**asked):
    return facetrack.track_video(CLIP, "histogram", **asked)


def follow(images, init=(5, 5, 40, 40), **asked):
    return list(facetrack.track_frames(images, "histogram", init=init, **asked))


def record(**asked):
    with facetrack.Recording("out", **asked):
        pass


@pytest.mark.parametrize("seed", [-1, 2**63, 2**64, 1.5, True, "1"])
def test_a_seed_that_is_none_is_refused_in_one_line_wherever_it_is_given(seed, capsys):
    with pytest.raises(facetrack.RecipeError, match=f"^seed {seed!r} is no whole number from 0 to 9"):
        facetrack.track_video(CLIP, "sir", seed=seed)
    if type(seed) is int:
        assert main(["run", str(CLIP), "--config", "sir", "--seed", str(seed), "-q"]) == 2
        assert f"error: seed {seed} is no whole number from 0" in capsys.readouterr().err


def test_a_fault_of_ours_is_raised_and_not_the_end_of_a_clip(monkeypatch):
    monkeypatch.setattr("facetrack_cli.engine.target.ParticleTarget.advance", raising(AttributeError("ours")))
    with pytest.raises(AttributeError, match="ours"):
        facetrack.track_video(CLIP, "factorized")


@pytest.mark.parametrize(("recipe", "clip"), [("factorized", CLIP), ("head_hands", FOLDER / "signing.mp4")])
def test_a_recording_is_what_run_writes(tmp_path, recipe, clip):
    init, images = str(clip.with_suffix(".init.yaml")), tmp_path / "images"
    images.mkdir()
    with open_source(clip, stop=8) as source:
        given = [frame.bgr for frame in source]
    for i, image in enumerate(given):
        cv2.imwrite(str(images / f"{i}.png"), image)
    assert main(["run", str(images), "--init", init, "--config", recipe, "-o", str(tmp_path / "run"), "-q"]) == 0
    with facetrack.Recording(tmp_path / "out", recipe, clip=images, fps=25.0) as out:
        for result in facetrack.track_frames(given, recipe, init=init, fps=25.0):
            out.write(result)
    assert names(tmp_path / "out") == names(tmp_path / "run")
    for name in ("trajectory.csv", "trajectory.json"):
        # images do not tell whether the times of their clip vary
        ours, theirs = ((tmp_path / one / name).read_text().replace("null", "false") for one in ("out", "run"))
        assert ours == theirs


def test_a_recording_keeps_what_came_before_an_error(tmp_path, images):
    results = list(facetrack.track_frames(images[:6], "factorized", init=INIT))

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


def rows(results):
    return [
        (one.frame.index, one.frame.time_s, one.rows.x.tolist(), one.rows.confidence.tolist())
        for one in results
        if one is not None
    ]


@pytest.mark.parametrize(("recipe", "init"), [("factorized", "haar"), ("histogram", BOX)])
def test_each_image_gives_the_rows_of_track_frames_also_in_threads(recipe, init, images):
    whole = rows(facetrack.track_frames(images, recipe, init=init, seed=3))
    found = {}

    def run(number):
        tracker = facetrack.Tracker(recipe, init=init, seed=3)
        found[number] = rows([tracker.update(one) for one in images]), tracker.start.frame

    threads = [threading.Thread(target=run, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for results, start in found.values():
        assert results == whole[-len(results) :] and len(results) > 20 and start == whole[0][0]


def test_a_face_that_comes_late_is_found_and_time_counts_from_the_first_image(images):
    tracker, dark = facetrack.Tracker("factorized", init="haar"), np.zeros_like(images[0])
    assert not any(tracker.update(dark, i / 50) for i in range(260))
    found = [one for i, image in enumerate(images, 260) if (one := tracker.update(image, i / 50)) is not None]
    assert found and found[-1].frame.index == 289 and found[-1].frame.time_s == pytest.approx(289 / 50)


@pytest.mark.parametrize("at", [3, 20])
def test_a_tracker_goes_on_from_its_state(at, images, tmp_path):
    one = facetrack.Tracker("factorized", init="haar", seed=1)
    for image in images[:at]:
        one.update(image)
    one.save(tmp_path / "state.npz")
    other = facetrack.Tracker("factorized", init="haar", seed=1, state=tmp_path / "state.npz")
    both = [rows([each.update(image) for image in images[at:]]) for each in (one, other)]
    assert both[0] == both[1] != []
    with pytest.raises(facetrack.InputError, match=r"state\.npz: is of another recipe or seed"):
        facetrack.Tracker("factorized", seed=2, state=tmp_path / "state.npz")
    (tmp_path / "odd.npz").write_bytes(b"odd")
    with pytest.raises(facetrack.InputError, match=r"odd\.npz"):
        facetrack.Tracker("factorized", state=tmp_path / "odd.npz")


def test_what_is_no_image_and_no_time_is_refused(images):
    tracker = facetrack.Tracker("histogram", init=BOX)
    tracker.update(images[0], 1.0)
    for image, time_s, said in (
        (images[1], 1.0, "is not after 1 s"),
        (images[1], float("nan"), "is not after 1 s"),
        (images[1].astype(float), 2.0, "is float64"),
        (images[1][:100], 2.0, "not 320x240 as the first"),
    ):
        with pytest.raises(facetrack.InputError, match=said):
            tracker.update(image, time_s)
    assert tracker.update(images[1], 1.5).frame.index == 1, "what was refused does not count"


def test_a_tracker_of_opencv_has_no_state_to_save(images, tmp_path):
    tracker = facetrack.Tracker("mil", init=(40, 30, 40, 40))
    tracker.update(images[0])
    with pytest.raises(facetrack.FacetrackError, match=r"state.npz: a tracker of OpenCV, as in mil, does not give its"):
        tracker.save(tmp_path / "state.npz")
    assert names(tmp_path) == []


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "out"
    assert main(["run", str(CLIP), "--config", "sir", "--stop", "6", "-q", "-o", str(folder)]) == 0
    return folder


def decoded(data, tmp_path):
    (tmp_path / "video.mp4").write_bytes(data)
    with av.open(tmp_path / "video.mp4") as file:
        return [frame.to_ndarray(format="bgr24") for frame in file.decode(video=0)]


@pytest.mark.parametrize("form", ["otb", "csv-wide", "vot", "mot", "dlc"])
def test_it_is_what_the_command_writes(run, tmp_path, form):
    nose = facetrack.read_trajectory(run).find("face", "nose")
    call = ["export", str(run), "--to", form, "--target", "face/nose", "-o", str(tmp_path / "file")]
    assert main(call) == 0
    assert facetrack.export(nose, form) == (tmp_path / "file").read_text()
    assert facetrack.export(nose, form, tmp_path / "ours") == tmp_path / "ours"
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "file").read_bytes()


def test_elan_is_a_name_of_eaf_and_nothing_is_replaced_unasked(run, tmp_path):
    table = facetrack.read_trajectory(run)
    path = facetrack.export(table, "elan", tmp_path / "clip.eaf")
    assert b"expressions.mp4" in path.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        facetrack.export(table, "eaf", path)
    added = facetrack.export(table, "eaf", path, into=path, overwrite=True)
    assert added.read_bytes().count(b"<HEADER") == 1
    with pytest.raises(UsageError, match=r"eav is no format; there are boris, .*eaf, .*textgrid"):
        facetrack.export(table, "eav")
    with pytest.raises(UsageError, match="drop_lost is not for eaf"):
        facetrack.export(table, "elan", drop_lost=True)


def test_the_video_is_that_of_the_run_or_drawn_from_the_rows(run, tmp_path):
    table = facetrack.read_trajectory(run)
    own = facetrack.annotated_video(table)
    assert own.data == (run / "annotated.mp4").read_bytes()
    assert own._repr_html_().startswith("<video controls") and "data:video/mp4;base64,AAAA" in own._repr_html_()
    in_memory = facetrack.track_video(CLIP, "sir", stop=6, report=lambda done, total: None)
    shots, drawn = decoded(own.data, tmp_path), decoded(facetrack.annotated_video(in_memory).data, tmp_path)
    assert len(shots) == len(drawn) == 6
    # the run's own shows its particles, too
    assert np.mean(np.abs(shots[3].astype(float) - drawn[3])) < 3
    bare = in_memory.take(slice(None), header={})
    with pytest.raises(InputError, match="does not name its clip"):
        facetrack.annotated_video(bare)
    assert len(decoded(facetrack.annotated_video(bare, media=CLIP).data, tmp_path)) == 6


def test_a_plot_of_no_rows_is_refused(run):
    pytest.importorskip("matplotlib")
    with pytest.raises(InputError, match="has no row that could be drawn"):
        facetrack.plot(facetrack.read_trajectory(run).take(slice(0, 0)))


def test_a_dataset_has_a_time_for_each_frame_and_nan_where_nothing_is_known():
    """A nose that is not known in frame 12, and a lip from there on; frame 13 is missing."""
    pytest.importorskip("xarray")
    nose = {"x": [1.0, 2, 4, 6], "y": [5.0] * 4, "confidence": [0.9, 0.9, 0.2, 0.9]}
    lip = {"x": [7.0, 8], "y": [9.0, 9], "confidence": [0.8, 0.7]}
    parts = [
        one_part("face", "nose", [10, 11, 12, 14], time_s=np.array([10, 11, 12, 14]) / 25, **nose),
        one_part("face", "lip", [12, 14], time_s=np.array([12, 14]) / 25, **lip),
    ]
    found = joined(parts, header={"source": {"path": "clip.mp4", "fps": 25.0}}).to_xarray()
    assert found.position.dims == ("time", "space", "keypoints", "individuals")
    assert found.confidence.dims == ("time", "keypoints", "individuals")
    assert found.frame.values.tolist() == [10, 11, 12, 13, 14]
    assert np.allclose(found.time, np.arange(10, 15) / 25)
    nose = found.position.sel(keypoints="nose", individuals="face")
    assert np.allclose(nose.sel(space="x"), [1, 2, 4, np.nan, 6], equal_nan=True)
    lip = found.sel(keypoints="lip", individuals="face")
    assert np.allclose(lip.confidence, [np.nan, np.nan, 0.8, np.nan, 0.7], equal_nan=True)
    assert found.attrs == {"source_software": "facetrack", "ds_type": "poses", "time_unit": "seconds", "fps": 25.0}
    with pytest.raises(InputError, match="no row has a time_s"):
        one_part("face", "nose", [1], x=[1.0], y=[1.0]).to_xarray()
