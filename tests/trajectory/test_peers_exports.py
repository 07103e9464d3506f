"""Exports as other tools read them: motmetrics, got10k, vot-toolkit, pycocotools, pandas, exploface, pympi."""

import json
import os
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from facetrack_cli.cli.app import cli

PEERS = os.environ.get("FACETRACK_PEERS")
pytestmark = pytest.mark.skipif(
    not PEERS, reason="FACETRACK_PEERS names no Python with the packages of tests/peers/requirements.txt"
)
CLIP = "Fräulein #1 & 100%.mp4"
PARTS = ("nose", "mouth_left", "lip & chin")


def rows(target, parts, frames=20):
    """A head that moves right from frame 8 on; the second part is lost in 3 to 5, the last has no place in 7."""
    for frame in range(frames):
        for k, part in enumerate(parts):
            x, y = 60.125 + 30 * k + 2.5 * max(0, frame - 8), 50.25 + 17 * k
            status = "init" if frame == 0 else "lost" if k == 1 and 3 <= frame <= 5 else "tracked"
            place = "," if k == len(parts) - 1 > 0 and frame == 7 else f"{x:.3f},{y:.3f}"
            confidence = 0.125 if status == "lost" else 0.9
            yield f"{frame},{frame / 25:.4f},{target},{part},{place},21.000,11.500,,{confidence},{status},,,,,,\n"


HEADER = "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,particles,ess,identity,identity_prob\n"


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exports")
    (folder / CLIP).touch()
    (folder / "frames").mkdir()
    for frame in range(20):
        cv2.imwrite(str(folder / f"frames/{frame}.png"), np.zeros((240, 320, 3), np.uint8))
    (folder / "track.csv").write_text(HEADER + "".join(rows("face", PARTS)), encoding="utf-8")
    (folder / "two.csv").write_text(HEADER + "".join(rows("face", PARTS)) + "".join(rows("hand", ("box",), 12)))

    def export(name, form, *more):
        result = CliRunner().invoke(cli, ["export", str(folder / name), "--to", form, *more])
        assert result.exit_code == 0, result.output

    for form in ("otb", "got10k", "vot", "dlc", "openface"):
        export("track.csv", form)
    export("two.csv", "dlc")
    export("two.csv", "mot", "-o", str(folder / "track.mot.txt"))
    export("two.csv", "coco", "-o", str(folder / "track.coco.json"), "--media", str(folder / "frames"))
    export("track.csv", "eaf", "--media", str(folder / CLIP))
    script = Path(__file__).parents[1] / "peers/read_exports.py"
    run = subprocess.run([PEERS, script, folder], capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode == 0, run.stderr
    return folder, json.loads(run.stdout)


def face_box(frame, *, last=True):
    """Left, top, width, height from 0 around the windows of the parts; without the last part at frame 7."""
    parts = 3 if last and frame != 7 else 2
    left = 60.125 + 2.5 * max(0, frame - 8) - 10
    return [left, 50.25 - 5.25, 30 * (parts - 1) + 21, 17 * (parts - 1) + 11.5]


def test_motmetrics_reads_both_targets(read):
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


def test_got10k_reads_boxes_from_one(read):
    wanted = [[left + 1, top + 1, w, h] for left, top, w, h in map(face_box, range(20))]
    for form in ("otb", "got10k"):
        assert len(read[1][form]) == 20
        for ours, true in zip(read[1][form], wanted, strict=True):
            assert ours == pytest.approx(true, abs=1e-4)


def test_vot_toolkit_reads_a_region_a_frame(read):
    first, *rest = read[1]["vot"]
    assert first == 1
    for frame, region in enumerate(rest, 1):
        assert region == pytest.approx(face_box(frame), abs=1e-4)


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
    for one in found["annotations"]:
        frame = one["image_id"] - 1
        if one["category_id"] == 2:
            assert "keypoints" not in one
            continue
        assert one["bbox"] == pytest.approx(face_box(frame), abs=1e-3)
        right = 2.5 * max(0, frame - 8)
        second = [90.125 + right, 67.25, 1 if 3 <= frame <= 5 else 2]
        third = [0, 0, 0] if frame == 7 else [120.125 + right, 84.25, 2]
        assert one["keypoints"] == pytest.approx([60.125 + right, 50.25, 2, *second, *third], abs=1e-3)
        assert one["num_keypoints"] == (2 if frame == 7 else 3)


def test_pandas_reads_deeplabcut_s_headers(read):
    found = read[1]["dlc"]
    assert found["names"] == ["scorer", "bodyparts", "coords"]
    assert found["columns"] == [["facetrack", part, c] for part in PARTS for c in ("x", "y", "likelihood")]
    assert found["index"] == list(range(20)) and found["kinds"] == ["float64"]
    assert found["values"][4] == [60.125, 50.25, 0.9, 90.125, 67.25, 0.125, 120.125, 84.25, 0.9]
    assert found["values"][7][6:] == [None, None, None]


def test_pandas_reads_individuals(read):
    found = read[1]["dlc_of_two"]
    assert found["names"] == ["scorer", "individuals", "bodyparts", "coords"]
    assert [column[1:3] for column in found["columns"][::3]] == [
        *(["face", part] for part in PARTS),
        ["hand", "box"],
    ]
    assert found["values"][15][9:] == [None] * 3  # the hand has no rows any more


def test_exploface_reads_openface_s_columns(read):
    found = read[1]["openface"]
    assert found["info"]["number_of_columns"] == 147 and found["info"]["duration"] == pytest.approx(19 / 25)
    rows = found["rows"]
    assert rows["frame"] == list(range(1, 21)) and set(rows["face_id"]) == {0}
    assert rows["success"] == [0 if 3 <= frame <= 5 else 1 for frame in range(20)]
    # nose and mouth_left; the third part is none of the landmarks
    assert {name for name in rows if name[:2] in ("x_", "y_")} == {"x_30", "y_30", "x_48", "y_48"}
    assert rows["x_30"][:2] == [60.125, 60.125] and rows["y_48"][0] == 67.25


def test_pympi_reads_tiers_and_media(read):
    folder, found = read[0], read[1]["eaf"]
    assert found["tiers"]["lost@face"] == [[120, 240, "mouth_left"]]
    (move,) = found["tiers"]["horizontal@face"]
    assert move[2] == "right" and move[0] == pytest.approx(320, abs=120) and move[1] == 800
    assert set(found["tiers"]) == {f"{kind}@face" for kind in ("lost", *found["vocabularies"])}
    assert {one["LINGUISTIC_TYPE_REF"] for one in found["parameters"].values()} == set(found["types"])
    assert found["media"] == [
        {
            "MEDIA_URL": f"file://{(folder / CLIP).as_posix()}",
            "RELATIVE_MEDIA_URL": f"./{CLIP}",
            "MIME_TYPE": "video/mp4",
        }
    ]
    spans = sorted([tier, *span] for tier, rows in found["tiers"].items() for span in rows)
    assert found["properties"]["lastUsedAnnotationId"] == str(len(spans))
    assert found["kept_when_written_again"] == spans
