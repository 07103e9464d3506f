"""Faces for a gallery: whose folders, which face, and how it is read, from small images of the two portraits."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.start.gallery_images import (
    SHIFT,
    STRETCH,
    TURN,
    Reading,
    count,
    find_people,
    moved,
    near,
    off,
    read_faces,
)
from facetrack_cli.trackers.appearance.space import Patches
from facetrack_cli.trackers.face.detectors import find_faces
from tests.support.gallery_faces import face_of, people_folder
from tests.support.media import write_video


def faces_of(folder, **how):
    """What was read, and what was warned of."""
    said = []
    reading = Reading(**how)
    return read_faces(find_people(folder, said.append), reading, said.append), said


def refused(folder, **how):
    with pytest.raises(InputError) as caught:
        faces_of(folder, **how)
    message = str(caught.value)
    assert "\n" not in message and str(folder) in message
    return message


@pytest.fixture
def people(tmp_path):
    return people_folder(tmp_path / "people", 2)


# --- who is there --------------------------------------------------------------------------------------------------


def test_persons_are_folders_and_their_pictures_in_natural_order(people):
    for name in ("10.jpg", "9.png", ".hidden.jpg", "notes.txt", "boxes.csv", "1.init.yaml", "list.json"):
        (people / "collins" / name).touch()
    (people / ".cache").mkdir()
    (people / "readme.md").touch()
    said = []
    collins, hopper = find_people(people, said.append)
    assert (collins.name, hopper.name, said) == ("collins", "hopper", [])
    assert [item.path.name for item in collins.items] == ["1.png", "2.png", "9.png", "10.jpg"]
    assert [item.init and item.init.name for item in collins.items] == ["1.init.yaml", None, None, None]
    assert count([collins, hopper], Reading()) == 6


def test_what_is_no_gallery_is_refused(tmp_path):
    folder = tmp_path / "people"
    assert "no such folder" in refused(folder)
    folder.touch()
    assert "is no folder" in refused(folder)
    folder.unlink()
    folder.mkdir()
    assert "is empty" in refused(folder)
    (folder / "a.jpg").touch()
    assert "no folders" in refused(folder) and str(folder / "anna" / "a.jpg") in refused(folder)
    (folder / "anna").mkdir()
    assert f"{folder / 'anna'}: no image or video" in refused(folder)
    (folder / "anna" / "1.jpg").touch()
    assert "anna is the only person" in refused(folder)
    (folder / "none").mkdir()
    assert "'none'" in refused(folder) and "rename" in refused(folder)


def test_two_folders_of_one_name_are_refused_or_told(people):
    said = []
    (people / "hopper").rename(people / "Collins")
    if not (people / "collins" / "1.png").samefile(people / "Collins" / "1.png"):
        assert len(find_people(people, said.append)) == 2
        assert len(said) == 1 and f"{people / 'Collins'}" in said[0] and "are two persons" in said[0]
    (people / "Collins").rename(people / "Ame\u0301lie ")
    (people / "collins").rename(people / "Am\u00e9lie")
    assert "are both called Am\u00e9lie" in refused(people)
    (people / "Am\u00e9lie").rename(people / "collins")
    assert [one.name for one in find_people(people, said.append)] == ["Am\u00e9lie", "collins"]


def test_a_face_counts_once(people):
    for name in ("collins/9.png", "hopper/9.png"):
        (people / name).write_bytes((people / "collins" / "1.png").read_bytes())
    faces, said = faces_of(people)
    assert faces.used == {"collins": 2, "hopper": 2} and faces.skipped == {"collins": 1, "hopper": 1}
    first = people / "collins" / "1.png"
    assert said[0] == f"{people / 'collins' / '9.png'}: the same face as {first}; skipped"
    assert said[1] == f"{people / 'hopper' / '9.png'}: the same face as {first}, which is collins; skipped"


def test_pictures_beside_the_folders_are_told(people):
    (people / "stray.jpg").touch()
    (people / "hopper" / "empty").mkdir()
    said = []
    find_people(people, said.append)
    assert len(said) == 2 and "stray.jpg" in said[0] and "empty" in said[1]


# --- which face ----------------------------------------------------------------------------------------------------


def test_a_face_is_read_as_the_tracker_reads_one_that_begins_in_its_box(people):
    faces, said = faces_of(people, shape=(15, 13))
    assert said == [] and faces.persons == ("collins", "collins", "hopper", "hopper")
    assert faces.used == {"collins": 2, "hopper": 2} and faces.skipped == {"collins": 0, "hopper": 0}
    picture = cv2.imread(str(people / "collins" / "1.png"))
    x, y, w, h = find_faces(picture)[0]
    patches = Patches(size=(w, h), shape=(15, 13))
    state = np.array([[[x + (w - 1) / 2, y + (h - 1) / 2, 1.0, 0.0, 0.0, 1.0]]])
    expected = patches.read(Frame(0, 0.0, picture), state, patches.factor(state[0]))
    np.testing.assert_allclose(faces.patches[:1], expected, atol=1e-5)


def test_an_init_file_says_where_the_face_is(people):
    path = people / "collins" / "1.png"
    box = find_faces(cv2.imread(str(path)))[0]
    before = faces_of(people)[0].patches
    init = path.with_suffix(".init.yaml")
    init.write_text(f"frame: 0\nbox: {list(box)}\n")
    np.testing.assert_array_equal(faces_of(people)[0].patches, before)
    init.write_text(f"frame: 0\nanna: {{box: {[box[0] + 9, *box[1:]]}}}\n")
    after = faces_of(people)[0].patches
    assert not np.allclose(after[0], before[0]) and (after[1:] == before[1:]).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("frame: 0\na: {box: [40, 40, 60, 60]}\nb: {box: [40, 40, 60, 60]}", "2 targets, a, b"),
        ("frame: 0\nbox: [900, 40, 60, 60]", "outside the frame"),
        ("frame: 0\nbox: [40, 40, 3, 3]", "smaller than"),
        ("frame: 3\nbox: [40, 40, 60, 60]", "is an image; write frame: 0"),
        ("frame: 0\npoints: {nose: [50, 50]}", "no box of face"),
        ("frame: 0\nbocks: [1, 2, 3, 4]", "box"),
        ("", "empty"),
    ],
)
def test_init_files_that_do_not_fit_are_refused(people, text, said):
    (people / "collins" / "1.init.yaml").write_text(text)
    message = refused(people)
    assert said in message and "1.init.yaml" in message


def test_what_shows_no_face_is_skipped_with_a_warning_that_names_it(people):
    rng = np.random.default_rng(0)
    cv2.imwrite(str(people / "collins" / "wall.png"), rng.integers(90, 110, (120, 160, 3), np.uint8))
    (people / "collins" / "broken.jpg").write_text("no image")
    (people / "collins" / "sound.mp3").write_text("no video")
    cv2.imwrite(str(people / "hopper" / "flat.png"), np.full((120, 160, 3), 77, np.uint8))
    (people / "hopper" / "flat.init.yaml").write_text("frame: 0\nbox: [40, 40, 60, 60]\n")
    faces, said = faces_of(people)
    assert faces.used == {"collins": 2, "hopper": 2} and faces.skipped == {"collins": 3, "hopper": 1}
    for name in ("wall.png: no face found", "broken.jpg: ", "sound.mp3: ", "flat.png: nothing to see"):
        assert sum(name in line and "skipped" in line for line in said) == 1, name
    assert len(said) == 4


def test_of_several_faces_the_largest_is_taken_and_said(people):
    small, large = face_of("collins", 0), face_of("hopper", 0)
    small = cv2.resize(small, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    both = np.full((large.shape[0], large.shape[1] + small.shape[1], 3), 128, np.uint8)
    both[:, : large.shape[1]] = large
    both[: small.shape[0], large.shape[1] :] = small
    (people / "hopper" / "2.png").unlink()
    cv2.imwrite(str(people / "hopper" / "2.png"), both)
    alone = faces_of(people_folder(people.parent / "again", 1))[0].patches[1]
    faces, said = faces_of(people)
    assert len(said) == 1 and "2.png: 2 faces; the largest" in said[0] and "2.init.yaml" in said[0]
    assert float(faces.patches[3] @ alone) / alone.size > 0.9


def test_a_person_of_whom_nothing_is_left_is_refused(people):
    for path in (people / "hopper").iterdir():
        path.write_text("no image")
    message = refused(people)
    assert f"{people / 'hopper'}: no face of hopper" in message and "init file" in message


# --- clips ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def clip(people):
    """A clip of hopper: her face, which goes right by a pixel a frame, in the first 12 frames of 20."""
    face = face_of("hopper", 0)
    frames = [np.roll(face, 2 * index, axis=1) if index < 12 else np.full_like(face, 60) for index in range(20)]
    for path in (people / "hopper").iterdir():
        path.unlink()
    write_video(people / "hopper" / "clip.avi", frames=frames, size=(face.shape[1], face.shape[0]))
    folder = people / "hopper" / "stills"
    folder.mkdir()
    for index in range(4):
        cv2.imwrite(str(folder / f"{index}.png"), frames[index])
    return people


@pytest.mark.nightly
def test_frames_of_a_clip_are_spread_between_start_and_stop(clip):
    faces, said = faces_of(clip, frames=3, start=0, stop=12)
    assert said == [] and faces.used == {"collins": 2, "hopper": 6}
    faces, said = faces_of(clip, frames=4)  # frames 2, 7, 12, 17
    assert faces.used["hopper"] == 6 and faces.skipped["hopper"] == 2
    assert len(said) == 1 and "no face found in 2 of 4 frames" in said[0] and "frames 12, 17" in said[0]
    faces, said = faces_of(clip, frames=15, start=2, stop=5)
    assert faces.used["hopper"] == 5 and said == []  # frames 2, 3, 4 of the clip; 2, 3 of the folder


def test_a_clip_that_ends_before_the_start_is_skipped(clip):
    faces, said = faces_of(clip, start=4, stop=8)
    assert faces.used["hopper"] == 4 and faces.skipped["hopper"] == 1
    assert len(said) == 1 and "stills" in said[0] and "past the end" in said[0]


def test_the_init_file_of_a_clip_gives_its_one_face(clip):
    x, y, w, h = find_faces(face_of("hopper", 0))[0]
    (clip / "hopper" / "clip.init.yaml").write_text(f"frame: 5\nbox: [{x + 10}, {y}, {w}, {h}]\n")
    faces, _ = faces_of(clip, frames=3)
    assert faces.used["hopper"] == 1 + 3
    assert float(faces.patches[2] @ faces.patches[3]) / faces.patches[3].size > 0.9
    assert "only frames 0 to 3 are to be used" in refused(clip, stop=4)
    (clip / "hopper" / "clip.init.yaml").write_text("frame: 90\nbox: [30, 30, 60, 60]\n")
    message = refused(clip)
    assert "clip.init.yaml" in message and "past the end" in message


# --- copies and counter-examples -----------------------------------------------------------------------------------


def test_copies_follow_their_picture_and_hardly_differ_from_it(people):
    plain, _ = faces_of(people)
    faces, _ = faces_of(people, jitter=3)
    assert faces.images == (0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3)
    assert faces.persons == ("collins",) * 8 + ("hopper",) * 8
    np.testing.assert_array_equal(faces.patches[::4], plain.patches)
    own = (faces.patches.reshape(4, 4, -1) * faces.patches[::4][:, None]).mean(2)
    assert own[:, 1:].max() < 0.999 and own[:, 1:].min() > 0.7
    assert faces.patches[:1].size * len(faces.negatives) >= 240 * 780 * 0.9
    best = (faces.negatives @ plain.patches.T / 780).max(1)
    assert np.median(best) < 0.4 and best.max() < 0.85
    assert np.isfinite(faces.negatives).all() and faces.negatives.any(1).all()


@given(st.integers(0, 10**6), st.integers(0, 200))
def test_ways_stay_within_what_is_said_and_do_not_depend_on_how_many_are_asked_for(first, number):
    close, away = near(first, number), off(first, number)
    assert close.shape == away.shape == (number, 4)
    assert (np.abs(close[:, :2]) <= SHIFT).all() and (np.abs(close[:, 2]) <= np.log1p(STRETCH)).all()
    assert (np.abs(close[:, 3]) <= np.radians(TURN)).all()
    np.testing.assert_array_equal(near(first, number + 3)[:number], close)
    np.testing.assert_array_equal(off(first, number + 3)[:number], away)
    displaced = np.hypot(away[:, 0], away[:, 1]) >= 0.2 - 1e-9
    resized, turned = np.abs(away[:, 2]) >= 0.4 - 1e-9, np.abs(away[:, 3]) >= np.radians(30.0) - 1e-9
    assert (displaced | resized | turned).all()


def test_a_state_is_moved_by_sides_of_its_box():
    x = np.array([10.0, 20.0, 1.0, 0.0, 0.0, 1.0])
    ways = np.array([[0.1, -0.5, 0.0, 0.0], [0.0, 0.0, np.log(2.0), np.pi / 2]])
    np.testing.assert_allclose(
        moved(x, (0, 0, 40, 50), ways), [[14, -5, 1, 0, 0, 1], [10, 20, 0, -2, 2, 0]], atol=1e-12
    )
