"""facetrack gallery: faces read from folders of small images, files, words, refusals, and the figure."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.start.gallery_images import SHIFT, STRETCH, TURN, Reading, count, find_people, moved, near, off
from facetrack_cli.start.gallery_images import read_faces as read_all
from facetrack_cli.trackers.appearance.appearance import Patches
from facetrack_cli.trackers.appearance.gallery import load_gallery
from facetrack_cli.trackers.face.detectors import Haar
from tests.support.media import write_video

pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")


NAMES = ("collins", "hopper")


@cache
def _portrait(name):
    """(H, W, 3) BGR, some 160 pixels wide, the face in its middle."""
    if name == "collins":
        data = pytest.importorskip("skimage.data", reason="needs the extra: pip install -e '.[samples]'")
        picture, (left, top, right, bottom) = data.astronaut()[:, :, ::-1], (130, 0, 320, 230)
    else:
        cbook = pytest.importorskip("matplotlib.cbook")
        picture = cv2.imread(str(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)))
        left, top, right, bottom = 90, 10, 420, 420
    part = picture[top:bottom, left:right]
    zoom = 160 / part.shape[1]
    return cv2.resize(np.ascontiguousarray(part), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)


def face_of(name, number):
    """An image of the portrait: the light comes from another side in each, and it tilts a little."""
    picture = _portrait(name).astype(np.float32)
    height, width = picture.shape[:2]
    light = 1 + 0.35 * np.sin(1.7 * number) * np.linspace(-1, 1, width)[:, None]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 4 * np.sin(number), 1.0)
    lit = cv2.warpAffine(picture, turn, (width, height), borderMode=cv2.BORDER_REPLICATE) * light
    return np.clip(lit, 0, 255).astype(np.uint8)


def people_folder(folder, pictures):
    """A folder of both persons, with so many images each."""
    for name in NAMES:
        (folder / name).mkdir(parents=True)
        for number in range(pictures):
            cv2.imwrite(str(folder / name / f"{number + 1}.png"), face_of(name, number))
    return folder


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`IN`: people/ with two persons of three images each, single/ with one image each."""
    folder = tmp_path_factory.mktemp("galleries")
    people_folder(folder / "people", 3)
    people_folder(folder / "single", 1)
    return folder


def names_here():
    return sorted(path.name for path in Path().iterdir())


def test_fit_and_show_and_what_is_there_is_not_replaced(facetrack):
    code, out, err = facetrack("gallery", "fit", "IN/people", "-o", "own.npz", "--jitter", "1")
    assert (code, out) == (0, "")
    gallery = load_gallery(Path("own.npz"))
    assert gallery.names == NAMES and gallery.counts == (3, 3) and gallery.shape == (30, 26)
    lines = err[err.index("person") :].splitlines()
    table = ["person used skipped", "collins 3 0", "hopper 3 0"]
    assert [" ".join(line.split()) for line in lines[:3]] == table
    assert lines[3:] == [*gallery.summary(), "own.npz: 2 persons, 6 images"]
    for begin in ("intra-personal: ", "p_f is half of its most, 0.5, at a log density of ", "strangers: below a log "):
        assert any(line.startswith(begin) for line in lines)

    code, out, err = facetrack("gallery", "show", "own.npz")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "own.npz: 2 persons, 6 images", "template: 26 points across, 30 down; boxes: 1.00 times as wide as high",
        *gallery.summary(),
        "   1 collins: 3 images", "   2 hopper: 3 images",
    ]  # fmt: skip
    assert names_here() == ["own.npz"]
    before = Path("own.npz").read_bytes()
    fit = ("gallery", "fit", "IN/people", "-o", "own.npz", "-q", "--jitter", "0", "--template", "13x15")
    code, _, err = facetrack(*fit)
    assert code == 2 and "own.npz" in err and "--overwrite" in err and Path("own.npz").read_bytes() == before
    assert facetrack(*fit, "--overwrite")[0] == 0
    assert load_gallery(Path("own.npz")).shape == (15, 13), "the template is width by height"


def test_a_single_picture_each_is_told_and_without_copies_refused(facetrack, clips):
    code, _, err = facetrack("gallery", "fit", "IN/single", "--jitter", "0")
    assert code == 3 and f"{clips}/single: " in err and "cannot be learned" in err and "--jitter" in err
    assert err.count("\n") == 1 and names_here() == []
    code, _, err = facetrack("gallery", "fit", "IN/single", "--jitter", "1")
    note = [line for line in err.splitlines() if line.startswith("note: ")]
    assert code == 0 and len(note) == 1 and "collins, hopper" in note[0] and "cannot be learned" in note[0]
    assert note[0] in facetrack("gallery", "show")[1].splitlines()


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["IN/absent"], 3, "No such file or directory"),
        (["IN/people", "-o", "no/own.npz"], 2, "no folder no"),
        (["IN/people", "--template", "30"], 2, "26x30"),
        (["IN/people", "--template", "3x900"], 2, "from 6 to 128"),
        (["IN/people/collins"], 3, "has no folders of two people"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(facetrack, arguments, code, said):
    found, out, err = facetrack("gallery", "fit", *arguments)
    assert found == code and said in err and err.count("\n") == 1 and out == "" and names_here() == []


def faces_of(folder, **how):
    """What was read, and what was warned of."""
    said = []
    reading = Reading(**how)
    return read_all(find_people(folder, said.append), reading, said.append), said


def refused(folder, **how):
    with pytest.raises(InputError) as caught:
        faces_of(folder, **how)
    message = str(caught.value)
    assert "\n" not in message and str(folder) in message
    return message


@pytest.fixture
def people(tmp_path):
    return people_folder(tmp_path / "people", 2)


def test_persons_are_folders_and_their_pictures_in_natural_order(people):
    for name in ("10.jpg", "9.png", ".hidden.jpg", "notes.txt", "boxes.csv", "1.init.yaml", "list.json"):
        (people / "collins" / name).touch()
    (people / ".cache").mkdir()
    (people / "readme.md").touch()
    said = []
    collins, hopper = find_people(people, said.append)
    assert (collins.name, hopper.name, said) == ("collins", "hopper", [])
    assert [item.name for item in collins.items] == ["1.png", "2.png", "9.png", "10.jpg"]
    assert count([collins, hopper], Reading()) == 6


def test_what_is_no_gallery_is_refused(tmp_path):
    folder = tmp_path / "people"
    assert "No such file" in refused(folder)
    folder.mkdir()
    assert "has no folders of two people" in refused(folder)
    (folder / "anna").mkdir()
    assert f"{folder / 'anna'}: no image or video" in refused(folder)
    (folder / "anna" / "1.jpg").touch()
    (folder / "none").mkdir()
    assert "'none'" in refused(folder) and "rename" in refused(folder)


def test_two_folders_of_one_name_and_a_person_of_whom_nothing_is_left_are_refused(people):
    (people / "hopper").rename(people / "Ame\u0301lie ")
    (people / "collins").rename(people / "Am\u00e9lie")
    assert "are both called Am\u00e9lie" in refused(people)
    (people / "Am\u00e9lie").rename(people / "collins")
    assert [one.name for one in find_people(people, print)] == ["Am\u00e9lie", "collins"]
    for path in (people / "collins").iterdir():
        path.write_text("no image")
    message = refused(people)
    assert f"{people / 'collins'}: no face of collins" in message and "init file" in message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("frame: 0\na: {box: [40, 40, 60, 60]}\nb: {box: [40, 40, 60, 60]}", "is not of one box"),
        ("frame: 0\nbox: [900, 40, 60, 60]", "outside the frame"),
        ("frame: 3\nbox: [40, 40, 60, 60]", "starts at frame 3, which is not used"),
        ("frame: 0\npoints: {nose: [50, 50]}", "is not of one box"),
    ],
)
def test_init_files_that_do_not_fit_are_refused(people, text, said):
    (people / "collins" / "1.init.yaml").write_text(text)
    message = refused(people)
    assert said in message and "1.init.yaml" in message


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
    assert (np.abs(close) <= (SHIFT, SHIFT, np.log1p(STRETCH), np.radians(TURN))).all()
    np.testing.assert_array_equal(near(first, number + 3)[:number], close)
    np.testing.assert_array_equal(off(first, number + 3)[:number], away)
    displaced = np.hypot(away[:, 0], away[:, 1]) >= 0.2 - 1e-9
    resized, turned = np.abs(away[:, 2]) >= 0.4 - 1e-9, np.abs(away[:, 3]) >= np.radians(30.0) - 1e-9
    assert (displaced | resized | turned).all()
    x, ways = np.array([10.0, 20, 1, 0, 0, 1]), np.array([[0.1, -0.5, 0, 0], [0, 0, np.log(2.0), np.pi / 2]])
    expected = [[14, -5, 1, 0, 0, 1], [10, 20, 0, -2, 2, 0]]  # by sides of the box
    np.testing.assert_allclose(moved(x, (0, 0, 40, 50), ways), expected, atol=1e-12)


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """What is read of a folder that has everything odd: its faces, what was said, and the folder."""
    folder = people_folder(tmp_path_factory.mktemp("odd") / "people", 2)
    (folder / "stray.jpg").touch()
    (folder / "hopper" / "empty").mkdir()
    rng = np.random.default_rng(0)
    cv2.imwrite(str(folder / "collins" / "wall.png"), rng.integers(90, 110, (120, 160, 3), np.uint8))
    (folder / "collins" / "broken.jpg").write_text("no image")
    (folder / "collins" / "sound.mp3").write_text("no video")
    cv2.imwrite(str(folder / "hopper" / "flat.png"), np.full((120, 160, 3), 77, np.uint8))
    (folder / "hopper" / "flat.init.yaml").write_text("frame: 0\nbox: [40, 40, 60, 60]\n")
    for name in ("collins/9.png", "hopper/9.png"):
        (folder / name).write_bytes((folder / "collins" / "1.png").read_bytes())
    box = Haar().find(Frame(0, 0.0, face_of("hopper", 0)))[0].box
    (folder / "hopper" / "1.init.yaml").write_text(f"frame: 0\nanna: {{box: {[box[0] + 9, *box[1:]]}}}\n")
    return *faces_of(folder), folder


def test_what_shows_no_face_or_one_again_is_skipped_with_a_warning_that_names_it(read):
    faces, said, folder = read
    assert faces.used == {"collins": 2, "hopper": 2} and faces.skipped == {"collins": 4, "hopper": 2}
    first = folder / "collins" / "1.png"
    for name in NAMES:
        assert f"{folder / name / '9.png'}: the same face as {first}, which is collins; skipped" in said
    for name in ("wall.png: no face found", "broken.jpg: ", "sound.mp3: ", "flat.png: nothing to see"):
        assert sum(name in line and "skipped" in line for line in said) == 1, name
    assert sum("stray.jpg" in line for line in said) == sum("empty" in line for line in said) == 1
    assert len(said) == 8


def test_a_face_is_read_as_the_tracker_reads_one_that_begins_in_its_box(read):
    faces, _, folder = read
    assert faces.persons == ("collins", "collins", "hopper", "hopper")
    for index, name, right in ((0, "collins", 0), (2, "hopper", 9)):  # an init file moved the second
        picture = cv2.imread(str(folder / name / "1.png"))
        x, y, w, h = Haar().find(Frame(0, 0.0, picture))[0].box
        patches = Patches(size=(w, h))
        state = np.array([[[x + right + (w - 1) / 2, y + (h - 1) / 2, 1.0, 0.0, 0.0, 1.0]]])
        expected = patches.read(Frame(0, 0.0, picture), state, patches.factor(state[0]))[0]
        assert float(faces.patches[index] @ expected) / expected.size > 0.999


@pytest.fixture
def clip(tmp_path):
    """A clip of hopper: her face, which goes right by two pixels a frame, in the first 6 frames of 8; stills of it."""
    folder, face = people_folder(tmp_path / "people", 2), face_of("hopper", 0)
    frames = [np.roll(face, 2 * index, axis=1) if index < 6 else np.full_like(face, 60) for index in range(8)]
    for path in (folder / "hopper").iterdir():
        path.unlink()
    write_video(folder / "hopper" / "clip.avi", frames=frames, size=(face.shape[1], face.shape[0]))
    (folder / "hopper" / "stills").mkdir()
    for index in range(3):
        cv2.imwrite(str(folder / "hopper" / "stills" / f"{index}.png"), frames[index])
    return folder


def test_frames_of_a_clip_are_spread_between_start_and_stop_or_the_one_of_its_init_file(clip):
    faces, said = faces_of(clip, frames=4)  # frames 1, 3, 5, 7 of the clip, 0 to 2 of the folder
    assert faces.used["hopper"] == 6 and faces.skipped["hopper"] == 1
    assert len(said) == 1 and "clip.avi: frame 7: no face found" in said[0]
    faces, said = faces_of(clip, start=3, stop=5)
    assert faces.used["hopper"] == 2 and faces.skipped["hopper"] == 1
    assert len(said) == 1 and "stills" in said[0] and "past the end" in said[0]
    x, y, w, h = Haar().find(Frame(0, 0.0, face_of("hopper", 0)))[0].box
    init = clip / "hopper" / "clip.init.yaml"
    init.write_text(f"frame: 5\nbox: [{x + 10}, {y}, {w}, {h}]\n")
    assert faces_of(clip, frames=2)[0].used["hopper"] == 1 + 2, "an init file gives the one face of a clip"
    assert "starts at frame 5, which is not used" in refused(clip, stop=4)
