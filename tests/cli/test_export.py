"""facetrack export: each format read back, what it says of lost rows, and what it refuses."""

import csv
import json
import time
from collections import namedtuple
from itertools import pairwise
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from facetrack_cli.cli.app import cli
from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.face_points import LINES, POINTS
from facetrack_cli.trajectory.formats import EXPORTS
from facetrack_cli.trajectory.formats.tables import write_dlc_h5
from facetrack_cli.trajectory.trajectory import COLUMNS, joined, one_part
from facetrack_cli.trajectory.views import enclose
from facetrack_cli.trajectory.writers import SCHEMA

FORMS = ("csv-wide", "openface", "mot", "otb", "got10k", "vot", "coco", "dlc", "eaf", "cvat", "labelstudio")
Row = namedtuple("Row", COLUMNS, defaults=[None] * (len(COLUMNS) - 6))


def rows(target="face", parts=("nose", "lip_upper"), frames=range(6), lost=(3, 4), size=(20.0, 10.0), **more):
    for frame in frames:
        for k, part in enumerate(parts):
            gone = k == 1 and frame in lost
            x, y = 100.25 + 30 * k + frame, 80.5 + 20 * k
            status = "init" if frame == 0 else "lost" if gone else "tracked"
            known = {"w": size[0], "h": size[1], "confidence": 0.1 if gone else 0.9, "status": status, **more}
            yield Row(frame, frame / 25, target, part, x, y, **known)


@pytest.fixture
def track(tmp_path):
    """Writes rows as trajectory.csv, or .json with a header, and gives the path."""

    def write(*groups, header=None):
        given = [row for group in (groups or (rows(),)) for row in group]
        path = tmp_path / "trajectory.csv"
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *given])
        if header is None:
            return path
        frames = {}
        for one in given:
            about = {k: v for k, v in one._asdict().items() if v not in (None, "") and k not in ("frame", "time_s")}
            frame = frames.setdefault(one.frame, {"frame": one.frame, "time_s": one.time_s, "targets": []})
            frame["targets"].append({"target": about.pop("target"), "parts": [about]})
        path.unlink()
        path = path.with_suffix(".json")
        path.write_text(json.dumps({"schema": SCHEMA, **header, "frames": list(frames.values())}))
        return path

    return write


def export(*args):
    result = CliRunner().invoke(cli, ["export", *map(str, args)])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result


def refused(*args, code):
    """The one line of an error, through the program's own handler."""
    error = CliRunner().invoke(cli, ["export", *map(str, args)]).exception
    assert isinstance(error, FacetrackError) and error.exit_code == code and "\n" not in str(error), repr(error)
    return str(error)


SOURCE = {"source": {"path": "clip.mp4", "size": [640, 480], "fps": 25.0}, "recipe": {"name": "sir"}}


def test_the_enclosing_box_touches_what_it_encloses(track):
    rng = np.random.default_rng(0)
    places = [dict(zip("xywh", rng.uniform(1, 99, (4, 50)), strict=True)) for _ in range(3)]
    made = [one_part("t", f"p{k}", np.arange(50), **place) for k, place in enumerate(places)]
    windows, found = np.stack([one.boxes for one in made]), enclose(made).boxes
    np.testing.assert_allclose(found[:, :2], windows[:, :, :2].min(axis=0))
    np.testing.assert_allclose(found[:, :2] + found[:, 2:], (windows[:, :, :2] + windows[:, :, 2:]).max(axis=0))
    for box, ltwh in (("windows", [91.75, 77, 50, 30]), ("points", [101.25, 81.5, 31, 21])):  # which count from 1
        lines = export(track(), "--to", "otb", "--box", box, "-o", "-").stdout.splitlines()
        assert len(lines) == 6 and [float(v) for v in lines[0].split(",")] == pytest.approx(ltwh)


def test_statuses_and_confidence_of_a_target_sum_up_its_parts():
    def one(name, status, confidence):
        t = len(status)
        return one_part("t", name, np.arange(t), x=np.ones(t), y=np.ones(t), w=np.ones(t), h=np.ones(t), status=status,
                      confidence=confidence)  # fmt: skip

    found = enclose([
        one("a", ["init", "lost", "lost", "", "visible"], [1, 0.2, 0.2, np.nan, np.nan]),
        one("b", ["init", "lost", "tracked", "", "hidden"], [1, 0.4, 0.8, np.nan, 0.5]),
    ])  # fmt: skip
    assert found.status.tolist() == ["init", "lost", "tracked", "", "visible"]
    np.testing.assert_allclose(found.confidence, [1, 0.3, 0.5, np.nan, 0.5])


def test_coco_says_lost_by_visibility(track):
    """The box of a face is no keypoint, and encloses windows, or points alone."""
    path = track(rows(parts=("nose", "lip_upper", "box")), rows("hand", ("box",), frames=(0, 1)), header=SOURCE)
    points = export(path, "--to", "coco", "--box", "points", "-o", "-").stdout
    assert json.loads(points)["annotations"][0]["bbox"] == [100.25, 80.5, 31, 21]
    export(path, "--to", "coco")
    found = json.loads(path.with_name("trajectory.coco.json").read_text())
    face, hand = found["categories"]
    assert face["keypoints"] == ["nose", "lip_upper"] and face["skeleton"] == [[1, 2]] and "keypoints" not in hand
    assert found["images"][3] == {"id": 4, "file_name": "clip/000003.png", "width": 640, "height": 480, "frame_id": 3}
    by_image = {(one["image_id"], one["category_id"]): one for one in found["annotations"]}
    assert sorted(one["id"] for one in found["annotations"]) == list(range(1, 9))
    lost = by_image[4, 1]
    assert lost["keypoints"] == [103.25, 80.5, 2, 133.25, 100.5, 1] and lost["num_keypoints"] == 2
    assert lost["bbox"] == [93.75, 76, 80, 50] and lost["area"] == 4000 and lost["score"] == pytest.approx(1.9 / 3)
    assert by_image[3, 1]["keypoints"][5] == 2
    assert by_image[1, 2]["track_id"] == 2


def test_a_face_of_all_points_with_lost_and_absent_rows(track):
    gone = [Row(6, 0.24, "face", part, status="absent" if part == "chin" else "tracked", x=x, y=x, w=9, h=9)
            for x, part in enumerate(POINTS)]  # fmt: skip
    chin = POINTS.index("chin")
    gone[chin] = gone[chin]._replace(x=None, y=None)
    path = track(rows(parts=POINTS), gone, header={**SOURCE, "source": {**SOURCE["source"], "size": [1000, 800]}})
    export(path, "--to", "coco")
    found = json.loads(path.with_name("trajectory.coco.json").read_text())
    [face] = found["categories"]
    assert tuple(face["keypoints"]) == POINTS and len(face["keypoints"]) == 28
    lines = {frozenset(face["keypoints"][end - 1] for end in edge) for edge in face["skeleton"]}
    assert lines == {frozenset(edge) for line in LINES for edge in pairwise(line)} | {frozenset(("nose", "lip_upper"))}
    assert len(face["skeleton"]) == len(lines) == 25
    by_image = {one["image_id"]: one for one in found["annotations"]}
    assert by_image[4]["keypoints"][2::3] == [2, 1, *[2] * 26]
    assert by_image[7]["keypoints"][3 * chin : 3 * chin + 3] == [0, 0, 0] and by_image[7]["num_keypoints"] == 27
    table = export(path, "--to", "dlc", "-o", "-").stdout.splitlines()
    assert table[3 + 6].split(",")[1 + 3 * chin : 4 + 3 * chin] == ["", "", ""], "what is absent has no place"


def test_what_is_beyond_the_picture_is_not_seen(track):
    small = {**SOURCE, "source": {**SOURCE["source"], "size": [104, 480]}}
    path = track(header=small)  # nose and lip move right from 100.25, 130.25

    def text(form, *more):
        return export(path, "--to", form, "-o", "-", *more).stdout

    flags = [one["keypoints"][2::3] for one in json.loads(text("coco"))["annotations"]]
    assert flags == [[2, 1]] * 3 + [[1, 1]] * 3
    faces = track(rows(parts=("nose", "mouth_left"), lost=()), header=small)
    assert [row["success"] for row in csv.DictReader(text("openface").splitlines())] == ["0"] * 6, faces
    nose = ET.fromstring(text("cvat", "--target", "face/nose"))
    assert [one.get("occluded") for one in nose.iter("points")] == [*"000111"]
    (task,) = json.loads(text("labelstudio", "--target", "face/nose"))
    shown = [one["enabled"] for one in task["annotations"][0]["result"][0]["value"]["sequence"]]
    assert shown == [True] * 3 + [False] * 3
    assert [line.split(",")[8] for line in text("mot", "--target", "face/nose").splitlines()] == [*"111000"]
    assert "hidden" not in text("csv-wide"), "the rows as they are"


def test_coco_names_the_images_of_a_folder(track, tmp_path):
    folder = tmp_path / "img"
    folder.mkdir()
    for n in range(1, 13):
        cv2.imwrite(str(folder / f"{n}.png"), np.zeros((48, 64, 3), np.uint8))
    to = ("--to", "coco", "--media", folder, "-o", "-")
    images = json.loads(export(track(), *to).stdout)["images"]
    assert [[one["file_name"], one["width"], one["height"]] for one in images[:2]] == [
        ["1.png", 64, 48], ["2.png", 64, 48],
    ]  # fmt: skip
    other = track(header={"source": {"path": str(folder), "size": [640, 480]}})
    assert "64x48, but the track is of a clip of 640x480" in refused(other, *to, code=3)
    assert "has 12 images, and the track a frame 13" in refused(track(rows(frames=range(10, 14))), *to, code=3)


def test_deeplabcut_s_header_rows(track):
    path = track(header=SOURCE)
    export(path, "--to", "dlc")
    lines = list(csv.reader(path.with_name("trajectory.dlc.csv").read_text().splitlines()))
    assert lines[:3] == [
        ["scorer", *["facetrack-sir"] * 6],
        ["bodyparts", *["nose"] * 3, *["lip_upper"] * 3],
        ["coords", *["x", "y", "likelihood"] * 2],
    ]
    assert lines[3 + 4] == ["4", "104.250", "80.500", "0.9000", "134.250", "100.500", "0.1000"]
    export(track(rows(), rows("hand", ("box",))), "--to", "dlc", "--overwrite")
    lines = list(csv.reader(path.with_name("trajectory.dlc.csv").read_text().splitlines()))
    assert lines[1] == ["individuals", *["face"] * 9, *["hand"] * 9], "each has all parts"
    assert lines[2] == ["bodyparts", *[part for part in ("nose", "lip_upper", "box") for _ in range(3)] * 2]
    assert [line[0] for line in lines[:4]] == ["scorer", "individuals", "bodyparts", "coords"]
    assert lines[4][7:] == ["", "", ""] * 3 + ["100.250", "80.500", "0.9000"]


def test_deeplabcut_s_rows_are_all_frames_and_its_hdf5_holds_the_same(track):
    tables = pytest.importorskip("tables", reason="PyTables is not installed")
    path = track(rows(frames=(2, 3, 6)), rows("hand", ("box",), frames=(4,)))
    for form in ("dlc", "dlc-h5"):
        export(path, "--to", form)
    text = pd.read_csv(path.with_name("trajectory.dlc.csv"), header=[0, 1, 2, 3], index_col=0)
    file = path.with_name("trajectory.dlc.h5")
    found = pd.read_hdf(file, key="df_with_missing")
    assert found.index.tolist() == text.index.tolist() == list(range(7))
    assert found.columns.names == ["scorer", "individuals", "bodyparts", "coords"]
    assert found.columns.tolist() == text.columns.tolist()
    np.testing.assert_array_equal(found.to_numpy(), text.to_numpy())
    known = found["facetrack"].xs("x", axis=1, level="coords").notna().sum()
    assert known.to_dict() == {("face", "nose"): 3, ("face", "lip_upper"): 3, ("face", "box"): 0,
                               ("hand", "nose"): 0, ("hand", "lip_upper"): 0, ("hand", "box"): 1}  # fmt: skip
    with tables.open_file(file) as opened:  # DeepLabCut's pandas, before 3, looks for the version that made the file
        assert opened.root.df_with_missing._v_attrs.pandas_version == "0.15.2"
    before = file.read_bytes()
    time.sleep(1.1)  # the resolution of the times that HDF5 keeps
    export(path, "--to", "dlc-h5", "--overwrite")
    assert file.read_bytes() == before
    one = track(rows(parts=("nose",)))
    export(one, "--to", "dlc-h5", "--overwrite", "--drop-lost")
    assert pd.read_hdf(file).columns.names == ["scorer", "bodyparts", "coords"]
    wide = joined([one_part(t, f"p{k}", [0], x=[1.0], y=[1.0]) for t in "ab" for k in range(480)])
    with pytest.raises(InputError, match="no room for the names of 2880 columns; choose a target"):
        write_dlc_h5(wide)


def test_dropped_lost_rows_are_not_known(track):
    path = track(rows(parts=("box", "box2"), lost=(3, 4)), header=SOURCE)

    def text(form):
        return export(path, "--to", form, "--drop-lost", "--target", "face/box2", "-o", "-").stdout

    assert [line.split(",")[0] for line in text("mot").splitlines()] == ["1", "2", "3", "6"]
    assert text("otb").splitlines()[3] == "nan,nan,nan,nan"
    assert text("got10k").splitlines()[3] == "0,0,0,0", "which its toolkit averages"
    assert text("vot").splitlines()[3:5] == ["2", "2"]
    assert text("dlc").splitlines()[3 + 3] == "3,,,"
    assert len(json.loads(text("coco"))["annotations"]) == 4


def test_a_folder_its_json_and_the_clip_beside_it(track, tmp_path):
    clip = tmp_path / "clip.mp4"
    clip.touch()
    path = track(header={"source": {"path": "clip.mp4"}})
    result = export(tmp_path, "--to", "eaf")
    assert "warning" not in result.stderr
    (media,) = ET.parse(path.with_name("trajectory.eaf")).getroot().iter("MEDIA_DESCRIPTOR")
    assert media.get("RELATIVE_MEDIA_URL") == "./clip.mp4" and media.get("MEDIA_URL") == f"file://{clip}"
    clip.unlink()
    assert "clip.mp4 is not there; ELAN will ask for it" in export(tmp_path, "--to", "eaf", "--overwrite").stderr


@pytest.mark.parametrize("form", FORMS)
def test_every_format_goes_to_standard_output_and_beside_the_trajectory(track, tmp_path, form):
    path = track(header=SOURCE)
    assert form in export("--help").stdout
    text = export(path, "--to", form, "-o", "-").stdout
    assert text.endswith("\n") and list(tmp_path.iterdir()) == [path]
    export(path, "--to", form)
    (written,) = set(tmp_path.iterdir()) - {path}
    assert written.name == f"trajectory.{EXPORTS[form].ending}"
    if form != "eaf":  # which holds the time of writing
        assert written.read_text() == text
    before = written.read_bytes()
    assert "exists already" in refused(path, "--to", form, code=2)
    export(path, "--to", form, "--overwrite", "--target", "face/nose")
    assert written.read_bytes() != before


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (["--to", "otb", "--target", "hand"], 2, "has no 'hand'; choose among face, face/nose, face/lip_upper"),
        (["--to", "eaf", "--media", "nowhere.mp4"], 3, "nowhere.mp4: no such file; correct --media"),
        (["--to", "eaf", "--drop-lost"], 2, "--drop-lost is not for eaf"),
        (["--to", "eaf"], 3, "trajectory.csv: does not name its video"),
        (["--to", "coco"], 3, "trajectory.csv: does not say how large and how fast its frames are"),
        (["--to", "mot", "-o", ""], 2, "--out is empty"),
        (["--to", "dlc-h5", "-o", "-"], 2, "dlc-h5 is not text"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(track, args, code, said):
    assert said in refused(track(), *args, code=code)


def test_tables_that_a_format_has_no_room_for(track, tmp_path):
    clip = tmp_path / "clip.mp4"
    clip.touch()
    bare = [*rows(size=(None, None))]
    for group, to, said in (
        (bare, ("mot",), "face/nose: frame 0 has no w and h; enclose the points with --box points"),
        ((row._replace(x=None, y=None) for row in rows()), ("dlc",), "no row has a place"),
        ((row._replace(time_s=None) for row in rows()), ("eaf", "--media", clip), "frame 0 has no time_s"),
    ):
        path = track(group)
        assert f"{path}: {said}" in refused(path, "--to", *to, code=3)
    export(track(bare), "--to", "mot", "--box", "points")
    two = track(rows(), rows("hand", ("box",)))
    for to, said in (
        (("otb",), "otb holds one target; choose with --target among face, hand"),
        (("dlc", "-o", two, "--overwrite"), "is read here, and would be replaced"),
        (("dlc", "-o", tmp_path), "is a folder"),
        (("dlc", "-o", tmp_path / "no/such/file.csv"), "there is no folder"),
    ):
        assert said in refused(two, "--to", *to, code=2)
    folder = track(header={"source": {"path": str(tmp_path)}})
    assert "is a folder of images, which ELAN cannot play" in refused(folder, "--to", "eaf", code=3)
