"""OpenFace's CSV: its columns and conventions, and the pose as a table of its own."""

import csv
import io

import cv2
import numpy as np
import pandas as pd
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import MESH, POINTS
from facetrack_cli.trajectory.formats.boxes import NAMED
from facetrack_cli.trajectory.formats.keypoints import COLUMNS, IN_MESH, LANDMARKS, write_openface
from facetrack_cli.trajectory.formats.tables import write_pose
from facetrack_cli.trajectory.head import SHAPE, rotation_of
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.video.source import open_source
from tests.support.samples import FOLDER

NAMES = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


def face(target="face", frames=(4, 5, 7), lost=(), angles=(10.0, -20.0, 5.0), scale=1.5, place=(300.0, 200.0)):
    xy = scale * np.array([SHAPE[n] for n in NAMES]) @ rotation_of(np.radians(np.array(angles)))[:2].T + place
    for k, name in enumerate(NAMES):
        t = len(frames)
        status = ["lost" if (name, frame) in lost else "tracked" for frame in frames]
        known = {"x": np.full(t, xy[k, 0]), "y": np.full(t, xy[k, 1]), "confidence": np.full(t, 0.75)}
        known |= {"std_x": np.ones(t), "std_y": np.ones(t)}
        yield one_part(target, name, frames, time_s=np.array(frames) / 25, status=status, **known)


def read(text):
    return pd.read_csv(io.StringIO(text))


def test_columns_frames_and_landmarks_are_openface_s():
    table = joined([*face(lost={("lip_lower", 5)}), one_part("face", "ear", [4], x=[1.0], y=[2.0])])
    found = read(write_openface(table, (640, 480)))
    assert list(found.columns) == list(COLUMNS) and len(COLUMNS) == 5 + 6 + 136
    assert found["frame"].tolist() == [5, 6, 8] and found["face_id"].tolist() == [0, 0, 0]
    assert found["timestamp"].tolist() == [0.16, 0.2, 0.28] and found["confidence"].tolist() == [0.75] * 3
    assert found["success"].tolist() == [1, 0, 1]
    for name, number in zip(NAMES, (30, 48, 54, 51, 57), strict=True):
        one = table.find("face", name)
        np.testing.assert_allclose(found[f"x_{number}"], one.x, atol=5e-4)
        np.testing.assert_allclose(found[f"y_{number}"], one.y, atol=5e-4)
    assert found.drop(columns=[f"{c}_{n}" for c in "xy" for n in (30, 48, 54, 51, 57)]).filter(
        regex="^[xy]_"
    ).isna().all(axis=None)  # fmt: skip


def test_points_of_a_face_and_of_the_mesh_fill_their_columns():
    def columns(names):
        parts = [one_part("face", name, [0], x=[float(i)], y=[2.0 * i]) for i, name in enumerate(names)]
        found = read(write_openface(joined(parts), None)).iloc[0]
        known = [i for i in range(68) if not np.isnan(found[f"x_{i}"])]
        assert all(found[f"y_{i}"] == 2 * found[f"x_{i}"] for i in known)
        return {i: names[int(found[f"x_{i}"])] for i in known}

    assert {name: number - 1 for name, number in NAMED.items()}.items() <= LANDMARKS.items()
    few = columns(POINTS)
    lids = {f"eye_{side}_{lid}" for side in ("left", "right") for lid in ("upper", "lower")}
    assert {*few.values()} == {*POINTS} - lids
    assert [few[i] for i in (4, 8, 12)] == ["jaw_left", "chin", "jaw_right"]
    assert [few[i] for i in (17, 21, 22, 26)] == [
        "brow_left_outer", "brow_left_inner", "brow_right_inner", "brow_right_outer",
    ]  # fmt: skip
    assert [few[i] for i in (36, 39, 42, 45)] == [
        "eye_left_outer", "eye_left_inner", "eye_right_inner", "eye_right_outer",
    ]  # fmt: skip
    named = {number: name for name, number in MESH.items()}
    all_of_them = columns([named.get(i, f"mesh_{i}") for i in range(468)])
    assert sorted(all_of_them) == list(range(68)) and few.items() <= all_of_them.items()
    assert [all_of_them[i] for i in (0, 16, 37, 41, 67)] == ["mesh_127", "mesh_356", "mesh_160", "mesh_144", "mesh_87"]


def test_the_real_mesh_is_a_face_in_ibug_s_order(mesh_model):
    if not hasattr(cv2.dnn, "readNetFromTFLite"):
        pytest.skip("this OpenCV reads no .tflite")
    with open_source(FOLDER / "expressions.mp4", stop=1) as source:
        [frame] = source
    network = cv2.dnn.readNetFromTFLite(str(mesh_model))
    network.setInput(cv2.dnn.blobFromImage(cv2.resize(frame.bgr[42:222, 71:251], (192, 192)), 1 / 255, swapRB=True))
    mesh = max(network.forward(network.getUnconnectedOutLayersNames()), key=np.size).reshape(468, 3)
    x, y = mesh[list(IN_MESH), :2].T
    for row in ([0, 3, 4, 6, 8, 10, 12, 13, 16], range(17, 27), range(31, 36), range(36, 40), range(42, 46)):
        assert (np.diff(x[[*row]]) > 0).all()
    for row in (range(48, 55), [48, 59, 58, 57, 56, 55, 54], range(60, 65), [60, 67, 66, 65, 64]):
        assert (np.diff(x[[*row]]) > 0).all()
    for row in ([*range(27, 31), 33, 51, 62, 66, 57, 8], [37, 41], [38, 40], [43, 47], [44, 46], range(9), [16, 12, 8]):
        assert (np.diff(y[[*row]]) > 0).all()
    mirrored = [*range(16, -1, -1), *range(26, 16, -1)]
    assert np.ptp(x[:27] + x[mirrored]) < 25  # the head is nearly frontal, and 192 points wide


def test_the_pose_is_seen_by_openface_s_camera():
    width, height, focal = 1280, 720, (500 * 1280 / 640 + 500 * 720 / 480) / 2
    off = np.array([400.0, -150.0])
    found = read(write_openface(joined(face(place=off + np.array([639.5, 359.5]))), (width, height))).iloc[0]
    place = found[["pose_Tx", "pose_Ty", "pose_Tz"]].to_numpy(dtype=float)
    assert place[2] == pytest.approx(focal / 1.5, rel=1e-3)
    np.testing.assert_allclose(focal * place[:2] / place[2], off, rtol=1e-3)
    # what the line of sight sees, seen along the camera's axis
    turned = rotation_of(found[["pose_Rx", "pose_Ry", "pose_Rz"]].to_numpy(dtype=float))
    ahead = turned @ rotation_of(np.radians([10.0, -20.0, 5.0])).T @ [0, 0, 1]
    np.testing.assert_allclose(ahead, place / np.linalg.norm(place), atol=2e-3)
    without = read(write_openface(joined(face()), None)).iloc[0]
    assert np.isnan(without["pose_Tz"])
    np.testing.assert_allclose(
        without[["pose_Rx", "pose_Ry", "pose_Rz"]].to_numpy(float), np.radians([10, -20, 5]), atol=2e-3
    )


def test_faces_have_ids_and_stand_by_frame():
    table = joined([*face("anna", (0, 1)), one_part("hand", "box", [0]), *face("ben", (1, 2))])
    found = read(write_openface(table, None))
    assert found[["frame", "face_id"]].to_numpy().tolist() == [[1, 0], [2, 0], [2, 1], [3, 1]]
    points = [one_part("face", f"point_{i + 1:02d}", [0], x=[float(i)], y=[2.0 * i]) for i in range(68)]
    found = read(write_openface(joined(points), None)).iloc[0]
    assert found[[f"x_{i}" for i in range(68)]].tolist() == list(range(68)) and np.isnan(found["pose_Rx"])
    with pytest.raises(
        InputError, match=r"no part is one of .* landmarks, which are mouth_left, .*, chin, .*, and point_01"
    ):
        write_openface(one_part("hand", "box", [0], x=[1.0], y=[1.0]), None)


def test_a_table_of_poses():
    table = joined([*face(lost={("nose", 5), ("lip_upper", 5)}), one_part("hand", "box", [4, 6])])
    rows = list(csv.DictReader(io.StringIO(write_pose(table))))
    assert [row["frame"] for row in rows] == [*"01234567"] and {row["target"] for row in rows} == {"face"}
    assert [row["frame"] for row in rows if row["pitch"]] == ["4", "7"]
    rows = rows[4:]
    assert [float(rows[0][name]) for name in ("pitch", "yaw", "roll")] == pytest.approx([10, -20, 5], abs=0.1)
    assert 2 < float(rows[0]["std_yaw"]) < 8 and rows[0]["ambiguous"] == "0"
    assert [rows[1][name] for name in ("pitch", "std_roll", "ambiguous")] == ["", "", ""]
    with pytest.raises(InputError, match="a pose needs four parts that are not in a plane, among eye_left"):
        write_pose(one_part("hand", "box", [0], x=[1.0], y=[1.0]))
