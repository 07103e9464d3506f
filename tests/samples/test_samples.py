"""The committed sample clips: complete, small, and true to their images."""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.support.samples import FOLDER, read_pictures, read_rows

CLIPS = ("expressions", "occlusion")
PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
HEADER = "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,particles,ess,identity,identity_prob"


class Clip(NamedTuple):
    """pictures (T, H, W, 3) BGR; ground truth (T, 5, 2) pixels; hidden (T, 5)."""

    name: str
    pictures: np.ndarray
    truth: np.ndarray
    hidden: np.ndarray


@pytest.fixture(scope="module", params=CLIPS)
def clip(request: pytest.FixtureRequest) -> Clip:
    name = request.param
    rows = read_rows(name)
    truth = np.array([[float(r["x"]), float(r["y"])] for r in rows]).reshape(-1, 5, 2)
    hidden = np.array([r["status"] == "hidden" for r in rows]).reshape(-1, 5)
    return Clip(name, read_pictures(name), truth, hidden)


def test_the_files_are_small_and_of_one_size(clip: Clip) -> None:
    assert (FOLDER / f"{clip.name}.mp4").stat().st_size < 1_000_000
    assert clip.pictures.shape[1:] == (240, 320, 3)
    assert 150 <= len(clip.pictures) <= 300
    video = cv2.VideoCapture(str(FOLDER / f"{clip.name}.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == 25
    video.release()


def test_the_truth_has_a_row_for_each_frame_and_part(clip: Clip) -> None:
    text = (FOLDER / f"{clip.name}.truth.csv").read_text(encoding="utf-8")
    assert text.splitlines()[0] == HEADER
    rows = read_rows(clip.name)
    expected = [(str(t), f"{t / 25:.2f}", "face", part) for t in range(len(clip.pictures)) for part in PARTS]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in rows] == expected
    assert {r["status"] for r in rows} <= {"visible", "hidden"}
    # the windows of 25 x 25 pixels lie in the image throughout
    assert clip.truth.min() > 12 and clip.truth[..., 0].max() < 307 and clip.truth[..., 1].max() < 227


def test_the_parts_move_but_do_not_jump(clip: Clip) -> None:
    steps = np.linalg.norm(np.diff(clip.truth, axis=0), axis=2)
    assert 2.5 < steps.max() < 6
    assert (np.ptp(clip.truth, axis=0) > 15).all()


def test_the_init_file_is_the_truth_of_the_first_frame(clip: Clip) -> None:
    init = YAML(typ="safe").load((FOLDER / f"{clip.name}.init.yaml").read_text(encoding="utf-8"))
    assert init["frame"] == 0
    points = init["face"]["points"]
    assert tuple(points) == PARTS
    np.testing.assert_array_equal(np.array(list(points.values())), clip.truth[0])
    left, top, width, height = init["face"]["box"]
    assert (clip.truth[0] > (left, top)).all() and (clip.truth[0] < (left + width, top + height)).all()
    assert not clip.hidden[0].any()


def test_the_frontal_cascade_finds_the_face_in_the_first_frames(clip: Clip) -> None:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")
    for t in range(5):
        boxes = cascade.detectMultiScale(cv2.cvtColor(clip.pictures[t], cv2.COLOR_BGR2GRAY), 1.1, 5, minSize=(60, 60))
        inside = [(clip.truth[t] > (x, y)).all() and (clip.truth[t] < (x + w, y + h)).all() for x, y, w, h in boxes]
        assert any(inside), f"frame {t}: {boxes}"


def test_expressions_are_held_and_the_light_changes_by_40_percent() -> None:
    rows = read_rows("expressions")
    truth = np.array([[float(r["x"]), float(r["y"])] for r in rows]).reshape(-1, 5, 2)
    width = np.linalg.norm(truth[:, 2] - truth[:, 1], axis=1)
    opening = np.linalg.norm(truth[:, 4] - truth[:, 3], axis=1)

    def longest(flags: np.ndarray) -> int:
        return max((len(list(run)) for flag, run in groupby(flags) if flag), default=0)

    assert longest(width > 1.04 * width[0]) > 25
    assert longest(opening > 1.5 * opening[0]) > 25
    assert longest(width < 0.75 * width[0]) > 25
    assert not any(r["status"] == "hidden" for r in rows)
    video = cv2.VideoCapture(str(FOLDER / "expressions.mp4"))
    skin = []
    for x, y in truth[:, 0].round().astype(int):
        picture = video.read()[1]
        skin.append(picture[y - 6 : y + 7, x - 6 : x + 7].mean())
    video.release()
    light = np.array(skin) / skin[0]
    assert 0.5 < light.min() < 0.66 and 1.34 < light.max() < 1.5


def test_a_lip_and_a_corner_are_hidden_for_more_than_40_frames_twice() -> None:
    hidden = np.array([r["status"] == "hidden" for r in read_rows("occlusion")]).reshape(-1, 5)
    runs = [(key, len(list(run))) for key, run in groupby(tuple(row) for row in hidden)]
    long = [dict(zip(PARTS, key, strict=True)) for key, n in runs if any(key) and n > 40]
    assert len(long) == 2
    assert [part for part in PARTS if long[0][part]] == ["mouth_left", "lip_lower"]
    assert [part for part in PARTS if long[1][part]] == ["mouth_right", "lip_upper"]
    shown_between = [n for key, n in runs if not any(key)]
    assert len(shown_between) == 3 and shown_between[0] > 30 and min(shown_between[1:]) > 40


def found(picture: np.ndarray, patch: np.ndarray, about: np.ndarray, reach: int) -> np.ndarray:
    """Where the patch (centred on a pixel) matches best within `reach` pixels of `about`, to a fraction of a pixel."""
    half = patch.shape[0] // 2
    x0, y0 = (np.rint(about).astype(int) - half - reach).tolist()
    size = patch.shape[0] + 2 * reach
    score = cv2.matchTemplate(picture[y0 : y0 + size, x0 : x0 + size], patch, cv2.TM_CCOEFF_NORMED)
    j, i = np.unravel_index(int(score.argmax()), score.shape)

    def peak(line: np.ndarray, k: int) -> float:
        if not 0 < k < len(line) - 1:
            return float(k)
        a, b, c = (float(v) for v in line[k - 1 : k + 2])
        return k + 0.5 * (a - c) / (a - 2 * b + c)

    return np.array([x0 + half + peak(score[j], int(i)), y0 + half + peak(score[:, i], int(j))])


def patch_at(picture: np.ndarray, at: np.ndarray, half: int) -> np.ndarray:
    """The (2 half + 1) square patch centred on the point `at`, which may lie between pixels."""
    return cv2.getRectSubPix(picture, (2 * half + 1, 2 * half + 1), tuple(float(v) for v in at))


def test_the_picture_moves_from_frame_to_frame_as_the_truth_says(clip: Clip) -> None:
    for k, part in enumerate(PARTS):
        errors = []
        for t in range(len(clip.truth) - 1):
            # near a book's edge the patch is more book than face
            near = clip.hidden[max(0, t - 3) : t + 5].any()
            if near or np.linalg.norm(clip.truth[t + 1, 3] - clip.truth[t + 1, 4]) > 30:
                continue
            patch = patch_at(clip.pictures[t], clip.truth[t, k], 7)
            errors.append(found(clip.pictures[t + 1], patch, clip.truth[t + 1, k], 6) - clip.truth[t + 1, k])
        length = np.linalg.norm(errors, axis=1)
        assert np.median(length) < 0.4, part
        # the lips' patches are torn as the mouth opens
        assert np.quantile(length, 0.9) < (2.0 if part.startswith("lip") else 0.8), part


def test_the_nose_of_the_first_frame_is_found_at_the_truth_to_the_end(clip: Clip) -> None:
    patch = patch_at(clip.pictures[0], clip.truth[0, 0], 12)
    errors = [found(p, patch, at, 8) - at for p, at in zip(clip.pictures, clip.truth[:, 0], strict=True)]
    assert np.median(np.linalg.norm(errors, axis=1)) < 1.0
    assert np.quantile(np.linalg.norm(errors, axis=1), 0.9) < 2.0


@pytest.mark.nightly
@pytest.mark.parametrize("name", CLIPS)
@pytest.mark.usefixtures("sample_scripts")
def test_rendered_anew_a_few_frames_are_the_committed_ones(name: str) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[samples]'")
    import render
    from occluders import cover
    from scenes import SCENES

    scene = SCENES[name]()
    rows = read_rows(name)
    video = cv2.VideoCapture(str(FOLDER / f"{name}.mp4"))
    for t, m in enumerate(scene.moments):
        picture = video.read()[1]
        where = render.truth(scene.portrait, m)
        for row, part in zip(rows[5 * t : 5 * t + 5], PARTS, strict=True):
            assert np.allclose(where[part], (float(row["x"]), float(row["y"])), atol=0.0051, rtol=0)
        if t % 60 == 30:
            drawn = render.face(scene.portrait, m)[0]
            for held in scene.objects:
                drawn = cover(drawn, held, t)[0]
            drawn = np.clip(drawn * scene.portrait.exposure * m.light, 0, 255)
            assert np.abs(drawn - picture).mean() < 4
    video.release()
    assert len(rows) == 5 * len(scene.moments)
