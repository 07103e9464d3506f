"""A run that was ended goes on from its checkpoint, and gives byte for byte what one that was not ended gives."""

import shutil
import subprocess

import imageio_ffmpeg
import pytest

from facetrack_cli.core.errors import ExitCode, InputError, OutputError
from facetrack_cli.core.npz import Kind
from facetrack_cli.run_folder.manifest import NAME, VIDEO, read_manifest
from facetrack_cli.runs import clip, finished, record
from facetrack_cli.runs.plan import Job
from facetrack_cli.runs.record import FOLDER
from facetrack_cli.runs.seeds import load_recipes
from facetrack_cli.runs.signals import Stop
from facetrack_cli.start.init_file import read_init
from tests.support.samples import FOLDER as SAMPLES

CLIPS = {"contour_correlation": "textured", "signer": "signing", "adaptive_recognition": "map"}
EVERY = 8  # frames between checkpoints here


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    monkeypatch.setattr(record, "EVERY_FRAMES", EVERY)


def job(recipe, out, *settings, source=None, stop=26, **more):
    gallery = str(SAMPLES / "people.npz") if recipe == "adaptive_recognition" else None
    [made] = load_recipes([(recipe, settings)], gallery)
    at = SAMPLES / f"{CLIPS.get(recipe, 'expressions')}.mp4" if source is None else source
    return Job(at, made, out, stop=stop, **{"video": False, **more})


def run(asked, until=None):
    """Track; interrupted once so many frames are tracked."""
    stop = Stop()

    def report(done, total):
        if until is not None and done >= until:
            stop.code = ExitCode.INTERRUPTED

    done = clip.run(asked, stop, report)
    assert done.failure is None and (done.stopped is None) == (until is None)
    return done


def decoded(video):
    """The frames of a video, their times, and its sound."""
    words = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", video, "-f", "framemd5", "-"]
    return subprocess.run(words, capture_output=True, check=True).stdout


def same(folder, other):
    left = sorted(path.name for path in folder.iterdir())
    assert left == sorted(path.name for path in other.iterdir())
    for name in left:
        if name == VIDEO:
            assert decoded(folder / name) == decoded(other / name)
        elif name != NAME:
            assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    return True


def ended_twice(tmp_path, recipe, *settings, **more):
    """The folders of a run, and of the same interrupted in two places."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    run(job(recipe, whole, *settings, **more))
    run(job(recipe, out, *settings, **more), 11)
    assert (out / FOLDER / "state.npz").is_file()
    assert run(job(recipe, out, *settings, **more), 21).resumed == EVERY
    done = run(job(recipe, out, *settings, **more))
    assert done.resumed == 2 * EVERY and done.frames == 26 and "went on after 16 frames" in done.summary()
    return out, whole


# the second one keeps a frame
@pytest.mark.parametrize("recipe", ["correlation_filter", "contour_correlation", "signer", "adaptive_recognition"])
def test_rows_are_those_of_a_run_that_was_not_ended(tmp_path, recipe):
    out, whole = ended_twice(tmp_path, recipe)
    assert same(out, whole) and read_manifest(out).frames == read_manifest(whole).frames == 26


@pytest.mark.parametrize("threads", [pytest.param(1, marks=pytest.mark.nightly), 2])
def test_so_are_the_frames_of_the_video_and_smoothed_rows(tmp_path, threads, monkeypatch):
    monkeypatch.setattr(finished, "_BLOCK_FRAMES", 5)
    more = {"video": True, "threads": threads, "smooth": True, "formats": ("csv", "json", "jsonl")}
    out, whole = ended_twice(tmp_path, "face", **more)
    assert same(out, whole)


def test_so_are_corrected_tracks(tmp_path):
    init = tmp_path / "corrected.init.yaml"
    text = (SAMPLES / "expressions.init.yaml").read_text()
    corrections = ["{frame: 5, face: {points: {nose: [158, 140]}}}"]
    corrections += ["{frame: 9, face: {points: {mouth_left: [139, 155]}, learn: true}}"]
    init.write_text(text + "corrections:\n" + "".join(f"  - {one}\n" for one in corrections))
    assert len(read_init(init).corrections) == 2
    assert same(*ended_twice(tmp_path, "factorized", init=init))


@pytest.mark.nightly
def test_so_is_what_was_begun_by_a_search(tmp_path):
    assert same(*ended_twice(tmp_path, "factorized", init="haar"))


def test_a_run_that_was_not_interrupted_keeps_no_checkpoint(tmp_path):
    asked = job("factorized", tmp_path / "out", video=True)
    run(asked)
    assert not (asked.out / FOLDER).exists() and run(asked).again


@pytest.mark.parametrize("video, formats", [(False, ("csv", "json")), (True, ("csv", "json")), (True, ("csv",))])
def test_after_the_last_frame_there_is_no_checkpoint(tmp_path, video, formats):
    how = {"stop": 2 * EVERY, "video": video, "formats": formats}
    asked = job("factorized", tmp_path / "out", **how)
    run(job("factorized", tmp_path / "whole", **how))
    run(asked, 2 * EVERY)
    done = run(asked)
    assert done.resumed == EVERY and same(asked.out, tmp_path / "whole")
    assert len(done.paths) == len(formats) + video, "a video that is drawn at the end is one of them"


def test_the_video_of_a_run_that_goes_on_and_fails_shows_what_was_tracked(tmp_path, monkeypatch):
    asked, track = job("factorized", tmp_path / "out", video=True, smooth=True), clip.track
    run(asked, 11)

    def failing(*given, **how):
        for result in track(*given, **how):
            if result.frame.index == 20:
                raise InputError("damaged")
            yield result

    monkeypatch.setattr(clip, "track", failing)
    done = clip.run(asked, Stop())
    assert done.resumed == EVERY and str(done.failure) == "damaged" and done.paths[-1].name == VIDEO
    assert decoded(asked.out / VIDEO).count(b"\n0,") == 20


@pytest.mark.parametrize("how", [{"resume": False}, {"overwrite": True}, {}])
def test_without_resuming_it_begins_at_its_start(interrupted, tmp_path, how):
    out = shutil.copytree(interrupted, tmp_path / "out")
    done = run(job("factorized", out, smooth=True, **how))
    assert done.resumed == (0 if how else EVERY) and "smoothed" in done.summary()


def test_opencvs_trackers_and_a_lag_begin_anew(tmp_path):
    for recipe, more in (("mil", {"box": (140.0, 120.0, 40.0, 40.0)}), ("factorized", {"lag": 3})):
        asked = job(recipe, tmp_path / recipe, video=True, stop=13, **more)
        run(asked, 11)
        assert not (asked.out / FOLDER).exists() and run(asked).resumed == 0


def edit(path, change):
    return lambda out: (out / path).write_bytes(change((out / path).read_bytes()))


CHANGES = {
    "another numpy": lambda out: None,
    "cut short": edit(f"{FOLDER}/state.npz", lambda data: data[:-500]),
    "of something else": edit(f"{FOLDER}/state.npz", lambda data: (SAMPLES / "people.npz").read_bytes()),
    "rows edited": edit("trajectory.csv", lambda data: data.replace(b"init", b"lost")),
    "rows gone": lambda out: (out / "trajectory.csv").unlink(),
}


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """The folder of a run that was interrupted; nobody may change it."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(record, "EVERY_FRAMES", EVERY)
        patched.setattr(finished, "_BLOCK_FRAMES", 5)
        asked = job("factorized", tmp_path_factory.mktemp("interrupted") / "out", smooth=True)
        run(asked, 11)
    return asked.out


@pytest.mark.parametrize("change", CHANGES)
def test_a_checkpoint_that_does_not_fit_is_left_out(interrupted, tmp_path, monkeypatch, change):
    monkeypatch.setattr(finished, "_BLOCK_FRAMES", 5)
    out = shutil.copytree(interrupted, tmp_path / "out")
    CHANGES[change](out)
    if change == "another numpy":
        monkeypatch.setattr(record, "_versions", lambda: {"numpy": "0"})
    done = run(job("factorized", out, smooth=True, overwrite=change == "rows gone"))
    assert done.resumed == 0 and done.frames == 26


def test_a_disk_without_space_for_a_checkpoint_is_no_harm(tmp_path, monkeypatch):
    def full(kind, path, arrays):
        raise OutputError("the disk is full")

    run(job("factorized", tmp_path / "whole", video=True, stop=EVERY + 1))
    monkeypatch.setattr(Kind, "write", full)
    done = run(job("factorized", tmp_path / "out", video=True, stop=EVERY + 1))
    assert not done.warnings and same(tmp_path / "out", tmp_path / "whole")
