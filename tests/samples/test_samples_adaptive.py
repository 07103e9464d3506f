"""The clips of changing scale, pose and light, and the gallery: the ground truth is about the face in the images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from facetrack_cli.tracking.start.haar import find_faces
from tests.support.samples import FOLDER, BoxClip, check_files, check_init, likeness, read_boxes, read_rows

FRAMES = {"zoom": 240, "lamp": 250}
PEOPLE = ("collins", "hopper", "ines", "marta", "otto", "viktor")
SHOWN = {"zoom": "hopper", "lamp": "collins"}
SHAPE = (26, 30)  # columns and rows of a patch


@pytest.fixture(scope="module", params=FRAMES)
def clip(request: pytest.FixtureRequest) -> BoxClip:
    return read_boxes(request.param)


def angles(name: str) -> np.ndarray:
    """(T,) of the box, in degrees."""
    return np.array([float(row["angle"]) for row in read_rows(name)])


def crop(clip: BoxClip, t: int, half: int = 24, at: int | None = None) -> np.ndarray:
    """The grey face of frame t, upright and at the size of frame 0, about the middle that its box has in frame `at`."""
    (x, y), s = clip.boxes[t if at is None else at, :2], clip.boxes[t, 2] / clip.boxes[0, 2]
    roll = np.radians(angles(clip.name)[t])
    turn = s * np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    move = np.column_stack([turn, (x, y) - turn @ (half, half)])
    side = 2 * half + 1
    grey = cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY)
    if s > 1:
        grey = cv2.GaussianBlur(grey, (0, 0), 0.5 * np.sqrt(s**2 - 1) + 1e-3)
    return cv2.warpAffine(grey, move, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def patch(picture: np.ndarray, box: tuple[int, ...]) -> np.ndarray:
    """(780,) grey of the box, zero mean, unit variance."""
    x, y, w, h = box
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)[y : y + h, x : x + w].astype(np.float64)
    small = cv2.resize(grey, SHAPE, interpolation=cv2.INTER_AREA)
    return ((small - small.mean()) / small.std()).ravel()


def test_the_files_are_small_and_the_truth_has_a_row_for_each_frame(clip: BoxClip) -> None:
    check_files(clip, FRAMES[clip.name])
    assert {row["status"] for row in read_rows(clip.name)} == {"visible"}


def test_the_init_file_is_the_truth_of_the_first_frame(clip: BoxClip) -> None:
    check_init(clip)
    assert angles(clip.name)[0] == 0


def test_the_init_box_is_what_the_frontal_cascade_finds_in_the_first_frame(clip: BoxClip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    boxes = cascade.detectMultiScale(cv2.cvtColor(clip.pictures[0], cv2.COLOR_BGR2GRAY), 1.05, 5, minSize=(40, 40))
    assert len(boxes) == 1
    x, y, w, h = boxes[0]
    np.testing.assert_allclose((x + (w - 1) / 2, y + (h - 1) / 2, w, h), clip.boxes[0], atol=2)


def test_the_cascade_finds_the_face_where_the_truth_has_it_while_it_is_upright(clip: BoxClip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    frames = np.nonzero(np.abs(angles(clip.name)) < 6)[0][::6]
    off = []
    for t in frames:
        grey = cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY)
        boxes = cascade.detectMultiScale(grey, 1.05, 4, minSize=(30, 30))
        near = [((x + (w - 1) / 2, y + (h - 1) / 2, w) - clip.boxes[t, :3]) / clip.boxes[t, 2] for x, y, w, h in boxes]
        off += [d for d in near if np.abs(d).max() < 0.3][:1]
    assert len(off) > 0.8 * len(frames)
    assert np.abs(np.median(off, axis=0)).max() < 0.05
    assert np.median(np.abs(off), axis=0).max() < 0.08


def test_a_box_that_rests_is_off_the_face_in_much_of_the_clip(clip: BoxClip) -> None:
    """Or the clip could not tell a tracker from a resting box."""
    off = np.abs(clip.boxes[:, :2] - clip.boxes[0, :2]).max(axis=1) / clip.boxes[:, 2]
    assert round(float((off < 0.5).mean()), 2) == {"zoom": 0.30, "lamp": 0.58}[clip.name]


def test_scale_place_and_roll_change_as_much_as_they_should(clip: BoxClip) -> None:
    x, y, w, h = clip.boxes.T
    np.testing.assert_array_equal(w, h)
    scale, roll = w / w[0], angles(clip.name)
    low, high, rolled, fast = {"zoom": (0.6, 2.0, 12.0, 6.0), "lamp": (0.85, 1.25, 5.0, 4.5)}[clip.name]
    assert abs(scale.min() - low) < 0.01 and abs(scale.max() - high) < 0.01
    assert abs(np.abs(roll).max() - rolled) < 0.1 and roll.min() < -3 and roll.max() > 3
    assert 0.6 * fast < np.linalg.norm(np.diff(clip.boxes[:, :2], axis=0), axis=1).max() < fast
    assert np.ptp(x) > 90
    reach = w / 2 * (np.cos(np.radians(roll)) + np.abs(np.sin(np.radians(roll))))
    assert (x - reach).min() > 5 and (x + reach).max() < 315 and (y - reach).min() > 5 and (y + reach).max() < 235


def test_zoom_doubles_and_comes_back_within_fifty_frames() -> None:
    scale = read_boxes("zoom").boxes[:, 2] / 66.0
    assert scale[12] < 1.01 and scale[38] > 1.99 and scale[62] < 1.06
    assert np.abs(np.diff(np.log(scale))).max() > 0.035


def test_the_crop_at_the_truth_looks_like_the_first(clip: BoxClip) -> None:
    first = crop(clip, 0)
    like = np.array([likeness(crop(clip, t), first) for t in range(len(clip.boxes))])
    # lit from one side it looks otherwise
    median, least = {"zoom": (0.87, 0.75), "lamp": (0.78, 0.3)}[clip.name]
    assert np.median(like) > median and like.min() > least
    resting = np.array([likeness(crop(clip, t, at=0), first) for t in range(len(clip.boxes))])
    assert np.median(resting) < np.median(like) - 0.3


def test_the_face_moves_from_frame_to_frame_as_the_truth_says(clip: BoxClip) -> None:
    off = []
    for t in range(len(clip.boxes) - 1):
        score = cv2.matchTemplate(crop(clip, t + 1, 30), crop(clip, t), cv2.TM_CCOEFF_NORMED)
        j, i = np.unravel_index(int(score.argmax()), score.shape)
        off.append((i - 6, j - 6))
    assert (np.abs(off).max(axis=1) <= 1).mean() > 0.97
    assert np.abs(np.mean(off, axis=0)).max() < 0.15


def test_the_lamp_lights_one_side_then_the_other_and_the_exposure_falls_to_two_fifths() -> None:
    clip = read_boxes("lamp")
    faces = np.array([crop(clip, t).astype(float) for t in range(len(clip.boxes))])
    level = faces.mean(axis=(1, 2)) / faces[0].mean()
    assert 0.36 < level.min() < 0.44 and 92 <= level.argmin() <= 113
    # left half to right half, as logarithms, beside the first frame
    side = np.log(faces[:, :, :22].mean(axis=(1, 2)) / faces[:, :, 27:].mean(axis=(1, 2)))
    side -= side[0]
    assert side[40:62].min() > 0.35 and side[148:160].min() > 0.45
    assert side[207:217].max() < -0.4
    assert np.abs(side[[*range(20), *range(96, 110), *range(244, 250)]]).max() < 0.1


@pytest.fixture(scope="module")
def gallery() -> dict[str, list[np.ndarray]]:
    folder = FOLDER / "gallery"
    return {p.name: [cv2.imread(str(f)) for f in sorted(p.glob("*.jpg"))] for p in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def patches(gallery: dict[str, list[np.ndarray]]) -> dict[str, np.ndarray]:
    """(5, 780) of each person, where the cascades find the face."""
    out = {}
    for person, pictures in gallery.items():
        boxes = [find_faces(picture) for picture in pictures]
        assert [len(b) for b in boxes] == [1] * len(pictures), person
        out[person] = np.array([patch(q, tuple(map(int, b[0]))) for q, b in zip(pictures, boxes, strict=True)])
    return out


def test_the_gallery_has_five_small_pictures_of_each_of_six_people(gallery: dict[str, list[np.ndarray]]) -> None:
    assert tuple(gallery) == PEOPLE
    assert all(len(pictures) == 5 for pictures in gallery.values())
    assert {picture.shape for pictures in gallery.values() for picture in pictures} == {(160, 160, 3)}
    assert sum(f.stat().st_size for f in (FOLDER / "gallery").rglob("*.jpg")) < 250_000


def test_pictures_of_one_person_are_more_alike_than_persons_are(patches: dict[str, np.ndarray]) -> None:
    means = {person: p.mean(axis=0) for person, p in patches.items()}
    between = [likeness(means[a], means[b]) for a in PEOPLE for b in PEOPLE if a < b]
    within = {person: np.corrcoef(p)[np.triu_indices(len(p), 1)].mean() for person, p in patches.items()}
    assert max(between) < min(within.values()) - 0.1, (max(between), within)
    for person, own in patches.items():
        for i, one in enumerate(own):
            others = {name: mean for name, mean in means.items() if name != person}
            others[person] = np.delete(own, i, axis=0).mean(axis=0)
            assert max(others, key=lambda name: likeness(one, others[name])) == person, (person, i)


def test_the_clip_shows_who_it_should_but_none_of_the_gallery_s_pictures(
    clip: BoxClip, patches: dict[str, np.ndarray]
) -> None:
    half = round(clip.boxes[0, 2] / 2)
    shown = []
    for t in range(len(clip.boxes)):
        small = cv2.resize(crop(clip, t, half).astype(np.float64), SHAPE, interpolation=cv2.INTER_AREA)
        shown.append(((small - small.mean()) / small.std()).ravel())
    means = {person: p.mean(axis=0) for person, p in patches.items()}
    nearest = [max(means, key=lambda name: likeness(one, means[name])) for one in shown]
    assert nearest.count(SHOWN[clip.name]) > 0.95 * len(nearest)
    alike = np.corrcoef(np.concatenate([patches[SHOWN[clip.name]], shown]))[:5, 5:]
    assert alike.max() < 0.97


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_a_few_frames_are_the_committed_ones(clip: BoxClip) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[samples]'")
    import closeups

    shot = getattr(__import__(clip.name), f"{clip.name}_shot")()
    n = len(shot.scale)
    assert n == len(clip.boxes)
    truth = np.array([closeups.box(shot, t) for t in range(n)])
    np.testing.assert_allclose(truth, np.column_stack([clip.boxes, angles(clip.name)]), atol=0.0051, rtol=0)
    for t in (0, 50, 100):
        closeups.prove(shot, t)
        drawn = closeups.render(shot, t) * shot.light[t]
        assert np.abs(np.clip(drawn, 0, 255) - clip.pictures[t]).mean() < 4


@pytest.mark.nightly
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_the_gallery_is_the_committed_one(gallery: dict[str, list[np.ndarray]]) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[samples]'")
    import people

    assert sorted(people.PEOPLE) == list(PEOPLE)
    for person, pictures in gallery.items():
        assert np.abs(people.picture(person, 1).astype(float) - pictures[1]).mean() < 3
