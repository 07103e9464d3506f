"""Exports as other tools read them, each with the packages of a list in tests/peers/.

requirements.txt: motmetrics, TrackEval, got10k, vot-toolkit, pycocotools, pandas with PyTables, exploface, Kinetics
Toolkit, pympi, corflow, speach, elan-data. annotation.txt: datumaro, which reads CVAT's XML, and Label Studio's SDK.
pose.txt: movement and keypoint-moseq.
"""

import json
import os
import site
import subprocess
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from facetrack_cli import export
from facetrack_cli.trajectory.formats.annotation import write_cvat, write_labelstudio
from facetrack_cli.trajectory.formats.boxes import write_mot
from facetrack_cli.trajectory.formats.tables import write_dlc, write_dlc_h5, write_textgrid
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.trajectory.test_annotation_tools import SIZE, table
from tests.trajectory.test_tables import face, read_textgrid


def peer(variable, packages):
    """The Python that a variable names, which has the packages of a list in tests/peers/; the mark of its tests."""
    python = os.environ.get(variable)
    return python, pytest.mark.skipif(not python, reason=f"{variable} names no Python with tests/peers/{packages}")


PEERS, exports = peer("FACETRACK_PEERS", "requirements.txt")
TOOLS, annotation = peer("FACETRACK_ANNOTATION_PEERS", "annotation.txt")
POSES, poses = peer("FACETRACK_POSE_PEERS", "pose.txt")


def read_by(python, script, *arguments):
    """What a script of tests/peers/ says at its end."""
    call = [python, Path(__file__).parents[1] / "peers" / script, *arguments]
    run = subprocess.run(call, capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


CLIP = "Fräulein #1 & 100%.mp4"
PARTS = ("nose", "mouth_left", "lip & chin")


def head(target, parts, frames=20):
    """A head that moves right from frame 8 on; the second part is lost in 3 to 5, the last has no place in 7."""
    t = np.arange(frames)
    for k, part in enumerate(parts):
        lost = (k == 1) & (t >= 3) & (t <= 5)
        x = np.where((t == 7) & (k == len(parts) - 1 > 0), np.nan, 60.125 + 30 * k + 2.5 * np.maximum(0, t - 8))
        about = {"w": np.full(frames, 21.0), "h": np.full(frames, 11.5), "confidence": np.where(lost, 0.125, 0.9)}
        status = np.where(t == 0, "init", np.where(lost, "lost", "tracked"))
        yield one_part(target, part, t, time_s=t / 25, x=x, y=x * 0 + 50.25 + 17 * k, status=status, **about)


def box(target, frame, left, rate, lost):
    """One that goes right by a pixel a frame."""
    t = len(frame)
    place = {"x": left + frame.astype(float), "y": np.full(t, 80.0), "w": np.full(t, 40.0), "h": np.full(t, 50.0)}
    status = np.where(np.isin(frame, lost), "lost", "tracked")
    return one_part(target, "box", frame, time_s=frame / rate, **place, confidence=np.full(t, 0.9), status=status)


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exports")
    clip = folder / CLIP
    clip.touch()
    (folder / "frames").mkdir()
    for frame in range(20):
        cv2.imwrite(str(folder / f"frames/{frame}.png"), np.zeros((240, 320, 3), np.uint8))
    track = joined(head("face", PARTS))
    two = joined([*track.parts, *head("hand", ("box",), 12)])
    same = box("1", np.arange(20), 100, 25, (8, 9))
    gone = np.isin(track.frame, (5, 6)) & (track.status == "tracked")
    dropped = replace(track, status=np.where(gone, "lost", track.status))
    for rows, form, name, more in (
        *((track, form, f"track.{form}.txt", {}) for form in ("otb", "got10k", "vot")),
        (track, "dlc", "track.dlc.csv", {}),
        (track, "dlc-h5", "track.dlc.h5", {}),
        (track, "openface", "track.openface.csv", {}),
        (two, "dlc", "two.dlc.csv", {}),
        (two, "dlc-h5", "two.dlc.h5", {}),
        # a head that comes late, at 29.97 frames/s, and is lost for a while
        (box("head", np.arange(12, 120), 90, 30 / 1.001, range(30, 35)), "csv-wide", "track.wide.csv", {}),
        (replace(same, status=np.where(same.unseen, "hidden", "visible")), "mot", "truth.mot.txt", {}),
        (same, "mot", "same.mot.txt", {}),
        (dropped, "got10k", "dropped.got10k.txt", {"drop_lost": True}),
        (joined([*head("O'Brien", PARTS, 60), *head("hand", ("box",), 60)]), "eaf", "quoted.eaf", {"media": clip}),
        (two, "mot", "track.mot.txt", {}),
        (two, "coco", "track.coco.json", {"media": folder / "frames"}),
        (track, "eaf", "track.eaf", {"media": clip}),
        (track, "eaf", "session.eaf", {"media": clip, "into": folder / "track.eaf"}),
    ):
        export(rows, form, folder / name, **more)
    (folder / "face.TextGrid").write_text(write_textgrid(face('O"Brien')), encoding="utf-8")
    return folder, read_by(PEERS, "read_exports.py", folder)


def face_box(frame, *, last=True):
    """Left, top, width, height from 0 around the windows of the parts; without the last part at frame 7."""
    parts = 3 if last and frame != 7 else 2
    left = 60.125 + 2.5 * max(0, frame - 8) - 10
    return [left, 50.25 - 5.25, 30 * (parts - 1) + 21, 17 * (parts - 1) + 11.5]


@exports
def test_motmetrics_and_trackeval_read_results_and_ground_truth(read):
    found = read[1]["mot"]
    assert [row[:2] for row in found if row[1] == 1] == [[frame + 1, 1] for frame in range(20)]
    assert [row[:2] for row in found if row[1] == 2] == [[frame + 1, 2] for frame in range(12)]
    for frame, ident, *ltwh, confidence in found:
        if ident == 1:
            # motmetrics takes 1 off the left and top edges again
            assert ltwh == pytest.approx(face_box(frame - 1), abs=1e-4)
            lost = 4 <= frame <= 6
            assert confidence == pytest.approx((0.9 * 2 + 0.125) / 3 if lost else 0.9, abs=1e-4)
        else:
            assert ltwh[2:] == [21, 11.5]
    assert read[1]["mot_truth"] == [
        [frame + 1, 1, 100 + frame - 19.5 - 0, 55.5, 40, 50, 1, 1, 0 if frame in (8, 9) else 1] for frame in range(20)
    ]
    assert read[1]["track_eval"] == {"GT_Dets": 20, "GT_IDs": 1, "Dets": 20, "IDF1": 1, "HOTA": 1}


@exports
def test_got10k_and_vot_toolkit_read_regions(read):
    # of 19 rows after the first two are lost, and in 3 to 5 the lost part is left out of the box
    assert 0.6 < read[1]["average_overlap"] <= 17 / 19
    wanted = [[left + 1, top + 1, w, h] for left, top, w, h in map(face_box, range(20))]
    for form in ("otb", "got10k"):
        assert len(read[1][form]) == 20
        for ours, true in zip(read[1][form], wanted, strict=True):
            assert ours == pytest.approx(true, abs=1e-4)
    first, *rest = read[1]["vot"]
    assert first == 1
    for frame, region in enumerate(rest, 1):
        assert region == pytest.approx(face_box(frame), abs=1e-4)


@exports
def test_pycocotools_loads_truth_and_results(read):
    found = read[1]["coco"]
    assert found["images"] == [
        {"id": frame + 1, "frame_id": frame, "width": 320, "height": 240, "file_name": f"{frame}.png"}
        for frame in range(20)
    ]
    face, hand = found["categories"]
    assert (face["name"], face["keypoints"], hand["name"]) == ("face", list(PARTS), "hand")
    assert "keypoints" not in hand
    assert found["results"] == len(found["annotations"]) == 32 and len(found["of_first_category"]) == 20
    assert found["mask_pixels"] == pytest.approx(81 * 45.5, rel=0.02)
    boxes = [one["bbox"] for one in found["annotations"] if one["category_id"] == 1]
    assert np.array(boxes) == pytest.approx(np.array([face_box(frame) for frame in range(20)]), abs=1e-3)


@exports
def test_pandas_reads_deeplabcut_s_headers_and_individuals(read):
    found = read[1]["dlc"]
    assert found["names"] == ["scorer", "bodyparts", "coords"]
    assert found["columns"] == [["facetrack", part, c] for part in PARTS for c in ("x", "y", "likelihood")]
    assert found["index"] == list(range(20)) and found["kinds"] == ["float64"]
    assert found["values"][4] == [60.125, 50.25, 0.9, 90.125, 67.25, 0.125, 120.125, 84.25, 0.9]
    assert np.isnan(found["values"][7][6:]).all()
    found = read[1]["dlc_of_two"]
    assert found["names"] == ["scorer", "individuals", "bodyparts", "coords"]
    assert np.isnan(found["values"][3][9:21]).all() and found["values"][3][21:] == [60.125, 50.25, 0.9]
    for form in ("dlc", "dlc_of_two"):
        np.testing.assert_equal(read[1][form.replace("dlc", "dlc_h5")], read[1][form])


@exports
def test_kinetics_toolkit_sees_a_constant_rate_from_frame_0(read):
    found = read[1]["wide"]
    assert found["rate"] == pytest.approx(30 / 1.001, rel=1e-6)
    assert found["times"] == pytest.approx([frame * 1.001 / 30 for frame in range(120)], abs=1e-6)


@exports
def test_exploface_reads_openface_s_columns(read):
    found = read[1]["openface"]
    assert found["info"]["number_of_columns"] == 147 and found["info"]["duration"] == pytest.approx(19 / 25)
    rows = found["rows"]
    assert rows["frame"] == list(range(1, 21)) and set(rows["face_id"]) == {0}
    assert rows["success"] == [0 if 3 <= frame <= 5 else 1 for frame in range(20)]
    # nose and mouth_left; the third part is none of the landmarks
    assert {name for name in rows if name[:2] in ("x_", "y_")} == {"x_30", "y_30", "x_48", "y_48"}
    assert rows["x_30"][:2] == [60.125, 60.125] and rows["y_48"][0] == 67.25


@exports
def test_pympi_reads_tiers_and_media(read):
    folder, found = read[0], read[1]["eaf"]
    assert found["tiers"]["lost@face"] == [[120, 240, "mouth_left"]]
    (move,) = found["tiers"]["horizontal@face"]
    assert move[2] == "right" and move[0] == pytest.approx(320, abs=120) and move[1] == 800
    assert set(found["tiers"]) == {f"{kind}@face" for kind in ("lost", *found["vocabularies"])}
    assert found["media"][0]["MEDIA_URL"] == f"file://{(folder / CLIP).as_posix()}"
    spans = sorted([tier, *span] for tier, rows in found["tiers"].items() for span in rows)
    assert found["properties"]["lastUsedAnnotationId"] == str(len(spans))
    assert found["kept_when_written_again"] == spans
    once, twice = found, read[1]["session"]  # to which the same tiers were added
    assert set(twice["tiers"]) == {f"{name}{more}" for name in once["tiers"] for more in ("", "-2")}
    for name, rows in once["tiers"].items():
        assert twice["tiers"][name] == twice["tiers"][f"{name}-2"] == rows
        assert twice["parameters"][name] == once["parameters"][name]


@exports
def test_readers_of_elan_find_a_name_with_an_apostrophe_and_all_tiers_have_the_bounds_of_the_file(read):
    found = read[1]["other_eaf"]
    lost = "lost@O\u2019Brien"
    assert [list(map(str, row)) for row in found["elan_data"][lost]] == [["120", "240", "mouth_left"]]
    assert found["speach"][lost] == [[0.12, 0.24, "mouth_left", None]]
    assert set(found["elan_data"]) == set(found["speach"]) == set(found["corflow"])
    move = next(name for name in found["speach"] if name.startswith("horizontal@O"))
    assert {one[3] for one in found["speach"][move]} == {"cveid_horizontal_right"}
    times = [time for spans in found["speach"].values() for span in spans for time in span[:2]]
    assert {tuple(tier[:2]) for tier in found["corflow"].values()} == {(min(times), max(times))}
    assert found["links"]["quoted"] == found["links"]["corflow"] == found["links"]["speach"] > 0


@exports
def test_pympi_reads_a_textgrid(read):
    found = read[1]["textgrid"]
    ours = read_textgrid(write_textgrid(face('O"Brien')))
    assert {name.replace('""', '"') for name in found} == {*ours}
    assert sorted(map(len, found.values())) == sorted(map(len, ours.values()))
    assert next(rows for name, rows in found.items() if name.startswith("mouth"))[1] == [4, 5.6, "open"]


def truth():
    place = {"x": 60.5 + np.arange(6), "y": np.full(6, 40.0), "w": np.full(6, 20.0), "h": np.full(6, 30.0)}
    return one_part("head", "box", range(6), **place, status=["visible", "visible", "hidden", *["visible"] * 3])


@pytest.fixture(scope="module")
def annotations(tmp_path_factory):
    folder = tmp_path_factory.mktemp("annotations")
    (folder / "cvat").mkdir()
    (folder / "cvat/annotations.xml").write_text(write_cvat(table(), SIZE, "c.mp4"), encoding="utf-8")
    (folder / "track.labelstudio.json").write_text(write_labelstudio(table(), SIZE, 25.0, "c.mp4"), encoding="utf-8")
    (folder / "mot/gt").mkdir(parents=True)
    (folder / "mot/gt/gt.txt").write_text(write_mot([truth()]))
    return read_by(TOOLS, "read_annotations.py", folder)


@annotation
def test_datumaro_reads_every_track_and_frame_and_what_is_visible(annotations):
    found, made = annotations["cvat"], table()
    assert found["labels"] == ["face/nose", "face/lip", "hand"]
    assert sorted(map(int, found["frames"])) == list(range(2, 8))
    hand = made.find("hand", "box")
    for frame, shapes in found["frames"].items():
        by_label = {one["label"]: one for one in shapes}
        one, nose = made.find("face", "nose").at(int(frame)), by_label["face/nose"]
        assert (nose["kind"], nose["keyframe"]) == ("points", True)
        assert (nose["outside"], nose["occluded"]) == (one.status[0] == "absent", one.status[0] == "lost")
        if not nose["outside"]:
            assert nose["points"] == pytest.approx([one.x[0] + 0.5, one.y[0] + 0.5], abs=0.006)
        if (at := hand.row(int(frame))) is not None:
            left, top, w, h = hand.boxes[at]
            assert by_label["hand"]["points"] == pytest.approx([left, top, left + w, top + h], abs=0.006)
    boxes = [annotations["mot"][str(frame + 1)][0] for frame in range(6)]
    assert [one["occluded"] for one in boxes] == [False, False, True, False, False, False]
    assert [one["ignored"] for one in boxes] == [False] * 6 and {one["track_id"] for one in boxes} == {1}
    # datumaro leaves the pixels as they are in the file, where they count from 1
    assert [one["box"] for one in boxes] == (truth().boxes + np.array([1, 1, 0, 0])).tolist()


@annotation
def test_label_studio_s_sdk_has_nothing_to_interpolate(annotations):
    (task,) = json.loads(write_labelstudio(table(), SIZE, 25.0, "c.mp4"))
    assert annotations["label_studio"] == task["annotations"][0]["result"]


POINTS = ("nose", "chin")


def one(target, part, frames):
    frames, own = np.array(frames), len(target) + 100 * POINTS.index(part)
    return one_part(target, part, frames, x=frames + own + 0.5, y=frames + own + 0.25, confidence=1 - frames / 400)


@poses
@pytest.mark.parametrize("ending", ["csv", "h5"])
def test_people_who_come_and_go_are_read_when_they_are_there(tmp_path, ending):
    """Anna from 3 s to 10.12 s, Ben, who has no chin, for a while; nobody between 5 and 6 s."""
    there = {("Anna", "nose"): [*range(75, 125), *range(150, 254)], ("Anna", "chin"): [*range(75, 125)],
             ("Ben", "nose"): [*range(100, 120)]}  # fmt: skip
    table = joined([one(*name, frames) for name, frames in there.items()])
    path = tmp_path / f"clip.{ending}"
    path.write_bytes(write_dlc_h5(table) if ending == "h5" else write_dlc(table).encode())
    found = read_by(POSES, "read_poses.py", path)[str(path)]
    wanted = np.full((254, 2, 2, 3), np.nan)
    for (target, part), frames in there.items():
        own = one(target, part, frames)
        place = np.stack([own.x, own.y, own.confidence], axis=1)
        wanted[frames, ["Anna", "Ben"].index(target), POINTS.index(part)] = place
    seen = found["movement"]
    assert (seen["individuals"], seen["keypoints"]) == (["Anna", "Ben"], list(POINTS))
    assert seen["time"] == pytest.approx(np.arange(254) / 25)
    for k, target in enumerate(("Anna", "Ben")):
        moseq = np.array(found["moseq"][target], dtype=float)
        np.testing.assert_allclose(np.array(seen["values"], dtype=float)[:, k], wanted[:, k], atol=6e-5)
        np.testing.assert_allclose(moseq, wanted[:, k], atol=6e-5)


@poses
def test_movement_reads_filters_and_saves_the_dataset(tmp_path):
    lines = ["frame,time_s,target,part,x,y,w,h,angle,confidence,status"]
    lines += [f"{t},{t / 25},face,nose,{10 + 2 * t},50,,,,{0.2 if t == 3 else 0.9},tracked" for t in range(8)]
    lines += [f"{t},{t / 25},face,lip,{20 + 2 * t},60,,,,0.9,tracked" for t in range(2, 8)]
    (tmp_path / "trajectory.csv").write_text("\n".join(lines) + "\n")
    ours = [str(Path(__file__).parents[2]), *site.getsitepackages(), str(Path(av.__file__).parents[1])]
    read = read_by(POSES, "read_dataset.py", tmp_path / "trajectory.csv", *ours)
    assert read["dims"] == {"time": 8, "space": 2, "keypoints": 2, "individuals": 1}
    assert read["missing"] == 2 + 4, "x and y of the doubtful nose, and of the lip before it is there"
    assert read["filled"] == [10 + 2 * t for t in range(8)]
    assert read["speed"] == pytest.approx([50.0] * 8) and read["same"] and read["times"]
