"""One image at a time: the rows of `track_frames`, a target that comes late, states, threads, and what is refused."""

import threading

import numpy as np
import pytest

import facetrack_cli as facetrack
from facetrack_cli.video.source import open_source
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"


@pytest.fixture(scope="module")
def images():
    with open_source(CLIP, stop=40) as source:
        return [frame.bgr for frame in source]


def rows(results):
    return [
        (one.frame.index, one.frame.time_s, one.rows.x.tolist(), one.rows.confidence.tolist())
        for one in results
        if one is not None
    ]


@pytest.mark.parametrize(("recipe", "init"), [("factorized", "haar"), ("histogram", (110, 60, 90, 90))])
def test_each_image_gives_the_rows_of_track_frames(recipe, init, images):
    tracker = facetrack.Tracker(recipe, init=init, seed=3)
    results = [tracker.update(one) for one in images]
    whole = rows(facetrack.track_frames(images, recipe, init=init, seed=3))
    found = rows(results)
    assert found == whole[-len(found) :] and len(found) > 20
    assert tracker.start is not None and tracker.start.frame == whole[0][0]


def test_a_face_that_comes_late_is_found_and_time_counts_from_the_first_image(images):
    dark = [np.zeros_like(images[0])] * 260
    tracker = facetrack.Tracker("factorized", init="haar")
    assert [tracker.update(one, i / 50) for i, one in enumerate(dark)] == [None] * 260
    results = [tracker.update(one, (260 + i) / 50) for i, one in enumerate(images)]
    found = [one for one in results if one is not None]
    assert found and found[-1].frame.index == 299 and found[-1].frame.time_s == pytest.approx(299 / 50)


@pytest.mark.parametrize("at", [3, 25])
def test_a_tracker_goes_on_from_its_state(at, images, tmp_path):
    one = facetrack.Tracker("factorized", init="haar", seed=1)
    for image in images[:at]:
        one.update(image)
    one.save(tmp_path / "state.npz")
    other = facetrack.Tracker("factorized", init="haar", seed=1, state=tmp_path / "state.npz")
    both = [[each.update(image) for image in images[at:]] for each in (one, other)]
    assert rows(both[0]) == rows(both[1]) and rows(both[0])
    with pytest.raises(facetrack.InputError, match=r"state\.npz: is of another recipe or seed"):
        facetrack.Tracker("factorized", seed=2, state=tmp_path / "state.npz")
    (tmp_path / "odd.npz").write_bytes(b"odd")
    with pytest.raises(facetrack.InputError, match=r"odd\.npz"):
        facetrack.Tracker("factorized", state=tmp_path / "odd.npz")


def test_trackers_in_threads_do_not_disturb_each_other(images):
    found = {}

    def run(seed):
        tracker = facetrack.Tracker("factorized", init="haar", seed=seed)
        found[seed] = rows([tracker.update(one) for one in images])

    threads = [threading.Thread(target=run, args=(seed,)) for seed in (0, 1, 2)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    for seed, those in found.items():
        tracker = facetrack.Tracker("factorized", init="haar", seed=seed)
        assert rows([tracker.update(one) for one in images]) == those


def test_what_is_no_image_and_no_time_is_refused(images):
    tracker = facetrack.Tracker("histogram", init=(110, 60, 90, 90))
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
    with pytest.raises(
        facetrack.FacetrackError, match=r"state.npz: a tracker of OpenCV, as in mil, does not give its state away"
    ):
        tracker.save(tmp_path / "state.npz")
    assert not any(tmp_path.iterdir())
