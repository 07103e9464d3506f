"""Tables for spreadsheets, data frames, notebooks, OpenFace's readers; events as subtitles, TextGrid, BORIS project."""

import csv
import io
import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from itertools import groupby, pairwise
from xml.etree import ElementTree

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Rectangle

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.face_points import GROUPS, MESH, POINTS
from facetrack_cli.core.numbers import csv_text
from facetrack_cli.report.figures import page
from facetrack_cli.trajectory.formats.boxes import NAMED
from facetrack_cli.trajectory.formats.tables import (
    EVENT_COLUMNS,
    IN_MESH,
    LANDMARKS,
    OPENFACE,
    Clip,
    write_boris,
    write_csv_wide,
    write_dlc,
    write_events,
    write_measures,
    write_openface,
    write_pose,
    write_subtitles,
    write_textgrid,
)
from facetrack_cli.trajectory.head import SHAPE, rotation_of
from facetrack_cli.trajectory.measures import FaceEvent
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.video.source import open_source
from tests.support.face_shape import moving_face
from tests.support.samples import FOLDER


def part(target, name, frames, *, lost=()):
    rng, t = np.random.default_rng(0), len(frames)
    return one_part(
        target, name, frames, time_s=np.array(frames) / 25, x=np.round(rng.uniform(0, 640, t), 3),
        y=np.round(rng.uniform(0, 480, t), 3), w=np.full(t, 20.5), h=np.full(t, 10.0), particles=np.full(t, 200.0),
        confidence=np.round(rng.uniform(0, 1, t), 4), status=["lost" if f in lost else "tracked" for f in frames],
    )  # fmt: skip


def read(text):
    return list(csv.DictReader(io.StringIO(text.removeprefix("\ufeff"))))


def test_a_row_a_frame_with_the_parts_side_by_side():
    made = part("face", "nose", [3, 4, 6], lost=[4])
    table = joined([made, part("head", "box", [4, 5])])
    found = read(write_csv_wide(table))
    numbers = pd.read_csv(io.StringIO(write_csv_wide(table)), index_col="frame").loc[made.frame]
    for name in ("x", "y", "w", "h", "confidence", "status"):
        np.testing.assert_array_equal(numbers[f"face_nose_{name}"], getattr(made, name))
    assert [row["frame"] for row in found] == [*"0123456"], "readers count rows"
    assert list(found[0]) == [
        "frame", "time_s", *(f"face_nose_{c}" for c in ("x", "y", "w", "h", "confidence", "status")),
        *(f"head_{c}" for c in ("x", "y", "w", "h", "confidence", "status")),
    ]  # fmt: skip
    assert [row["face_nose_status"] for row in found] == ["", "", "", "tracked", "lost", "", "tracked"]
    assert found[3]["head_x"] == "" and found[5]["face_nose_x"] == "" and found[4]["time_s"] == "0.1600000"
    assert write_csv_wide(table).startswith("frame,"), "a mark of the byte order is for other alphabets"
    text = write_csv_wide(joined([part("Fräulein", "nose", [0]), part("a,b", 'c"d', [0])]))
    assert text.startswith("\ufeff") and {"Fräulein_nose_x", 'a,b_c"d_x'} <= set(read(text)[0])


def test_no_table_has_a_text_that_a_spreadsheet_takes_for_a_formula():
    names = ["=1+1", "+1+1", "-1+1", "@SUM(A1)", " =1+1", '=HYPERLINK("x","y")']
    for name in names:
        rows = joined([part(name, one, [0, 1]) for one in ("nose", name)])
        for text in (write_csv_wide(rows), write_dlc(rows), write_dlc(rows, scorer=name), csv_text([name], [[name]])):
            cells = [cell for line in csv.reader(io.StringIO(text.removeprefix("\ufeff"))) for cell in line]
            assert f"_{name}" in "".join(cells) and not any(cell.strip()[:1] in {*"=+@"} for cell in cells)
    assert csv_text(["a", "b", "c"], [["-1.5", -2, "-"], ["+1e3", None, "-nan"]]) == "a,b,c\n-1.5,-2,_-\n+1e3,,-nan\n"


def timed(time_s, frames=None, **header):
    """The times of a table with these rounded times."""
    frames = np.arange(len(time_s)) if frames is None else frames
    one = one_part("face", "nose", frames, time_s=np.round(time_s, 4), x=np.ones(len(time_s)), y=np.ones(len(time_s)))
    found = read(write_csv_wide(replace(one, header=header)))
    assert [row["frame"] for row in found] == [str(n) for n in range(frames[-1] + 1)]
    return np.array([float(row["time_s"]) for row in found])


@pytest.mark.parametrize("fps", [12.5, 15, 24 / 1.001, 24, 25, 30 / 1.001, 30, 50, 60 / 1.001, 60, 120, 240, 17.3])
@pytest.mark.parametrize(("first", "begins"), [(0, 0.0), (7, 0.0), (0, 1.2)])
def test_a_constant_rate_is_one_to_readers(fps, first, begins):
    frames = np.arange(first, first + 100)
    found = timed(begins + frames / fps, frames)
    np.testing.assert_allclose(found, begins + np.arange(first + 100) / fps, atol=1.5e-4)
    steps = np.diff(found)
    assert np.allclose(steps, steps[0]), "as kineticstoolkit's get_sample_rate asks"
    np.testing.assert_allclose(1 / steps.mean(), fps, rtol=1e-5)
    told = timed(np.round(np.arange(300) / fps, 3), source={"fps": fps}, variable_fps=False)
    np.testing.assert_allclose(told, np.arange(300) / fps, atol=1e-6, err_msg="whole milliseconds of a container")


def test_a_variable_rate_is_kept_frames_without_rows_lie_between_and_few_rows_or_none_tell_times():
    found = timed([0.08, 0.12, 0.5, 0.54, 1.5], np.array([2, 3, 5, 6, 9]), source={"fps": 25.0}, variable_fps=True)
    np.testing.assert_allclose(found[[2, 3, 5, 6, 9]], [0.08, 0.12, 0.5, 0.54, 1.5])
    np.testing.assert_allclose(found[[4, 7, 8]], [0.31, 0.86, 1.18])
    assert (np.diff(found) > 0).all()
    np.testing.assert_allclose(timed([0.12], np.array([3]), source={"fps": 25.0}), [0, 0.04, 0.08, 0.12])
    one = one_part("face", "nose", [0, 2], x=[1.0, 2.0], y=[1.0, 2.0])
    assert [row["time_s"] for row in read(write_csv_wide(one))] == ["", "", ""]
    with pytest.raises(InputError, match="frame 10000000 is too far on for a row a frame"):
        write_csv_wide(one_part("face", "nose", [0, 10**7], x=[1.0, 2.0], y=[1.0, 2.0]))


def test_pose_and_measures_have_a_row_a_frame_too():
    face = moving_face(12, noise=0.3, std=0.3)
    late = replace(face, frame=face.frame + 4, time_s=face.time_s + 4 / 25)
    late = late.take(late.frame != 9)
    for write, rows in ((write_pose, late), (write_measures, [Clip("", late)])):
        found = read(write(rows))
        assert [row["frame"] for row in found] == [str(n) for n in range(16)]
        assert [row["time_s"] for row in found] == [f"{n / 25:.7f}" for n in range(16)]
        name = "pitch" if write is write_pose else "mouth_opening"
        assert [n for n, row in enumerate(found) if not row[name]] == [0, 1, 2, 3, 9]
    lost = turned_face(lost={("nose", 5), ("lip_upper", 5)})
    rows = read(write_pose(joined([*lost, one_part("hand", "box", [4, 6])])))
    assert {row["target"] for row in rows} == {"face"}
    assert [row["frame"] for row in rows if row["pitch"]] == ["4", "7"] and rows[5]["ambiguous"] == ""
    assert [float(rows[4][name]) for name in ("pitch", "yaw", "roll")] == pytest.approx([10, -20, 5], abs=0.1)
    assert 2 < float(rows[4]["std_yaw"]) < 8 and rows[4]["ambiguous"] == "0"
    with pytest.raises(InputError, match="a pose needs four parts that are not in a plane, among eye_left"):
        write_pose(one_part("hand", "box", [0], x=[1.0], y=[1.0]))


def seen(name, n, seen):
    x, confidence = np.full(n, 5.0), np.linspace(0, 1, n)
    status = np.where(np.arange(n) < seen, "tracked", "lost")
    return one_part(name, "nose", np.arange(n), x=x, y=x, confidence=confidence, status=status)


def test_a_row_for_each_target_with_what_is_seen_and_its_confidence():
    page = joined([seen("Ann", 40, 30), seen("<b>&", 20, 20)])._repr_html_()
    assert re.findall(r"<td>([^<]*)</td><td>(\d+)</td><td>(\d+)</td><td>(\d+%)</td>", page) == [
        ("Ann", "1", "40", "75%"), ("&lt;b&gt;&amp;", "1", "20", "100%"),
    ]  # fmt: skip
    for line in re.findall(r"<svg.*?</svg>", page):
        points = ElementTree.fromstring(line)[0].attrib["points"].split()
        assert len(points) in (40, 20) and points[0].endswith(",23.0") and points[-1].endswith(",1.0")
    assert "<td>p0</td><td>1</td><td>0</td><td></td>" in joined([seen("p0", 2, 2)]).take(slice(0, 0))._repr_html_()
    assert "<td>1</td><td>100%" in one_part("face", "box", [3], x=[1.0], y=[2.0])._repr_html_()


T = np.arange(250)
WRITTEN = datetime(2024, 1, 1, tzinfo=UTC)
NAMES = ("nose", *GROUPS["eyes"], "mouth_left", "mouth_right", "lip_upper", "lip_lower")
OPEN, SHUT = 0.3 * ((T >= 100) & (T < 140)), (T % 80 >= 40) & (T % 80 < 44)


@cache
def face(name="face"):
    """A mouth that is open from 4 to 5.6 s, and three blinks."""
    table = moving_face(250, noise=0.3, names=NAMES, open=OPEN, shut=SHUT)
    return joined([part.renamed(name, part.part) for part in table.parts])


def test_the_table_has_a_row_for_each_event():
    rows = read(write_events([Clip("a.mp4", face()), Clip("b.mp4", face("Anna"))]))
    assert tuple(rows[0]) == EVENT_COLUMNS and len(rows) == 8
    [row] = [row for row in rows if row["clip"] == "b.mp4" and row["tier"] == "mouth"]
    assert (row["person"], row["value"]) == ("Anna", "open")
    assert (row["begin_s"], row["end_s"], row["first_frame"], row["last_frame"]) == ("4.0", "5.6", "100", "139")
    assert 4 <= float(row["peak_s"]) <= 5.6 and 0.7 < float(row["probability"]) <= 1


def test_subtitles_are_to_the_millisecond_and_leave_out_what_has_no_extent():
    table = face()
    srt, vtt = write_subtitles(table, "srt"), write_subtitles(table, "vtt")
    assert srt.startswith("1\n00:00:01,600 --> 00:00:01,760\nblinks: blink\n\n2\n")
    assert vtt.startswith("WEBVTT\n\n1\n00:00:01.600 --> 00:00:01.760\nblinks: blink\n\n2\n")
    events = [
        FaceEvent(3661.00049, "a<b", "mouth", "open", 3661.1, 3661.2996, 1, 2, 0.9),
        FaceEvent(1.0001, "a<b", "mouth", "open", 1.0001, 1.0002, 1, 1, 0.9),
    ]
    table = joined([one_part("a<b", "nose", [0]), one_part("other", "nose", [0])])
    table.__dict__["events"] = events
    assert write_subtitles(table, "srt") == "1\n01:01:01,000 --> 01:01:01,300\na<b: mouth: open\n"
    assert write_subtitles(table, "vtt") == "WEBVTT\n\n1\n01:01:01.000 --> 01:01:01.300\na&lt;b: mouth: open\n"


def read_textgrid(text):
    """Of each tier its intervals, as Praat's long format has them."""
    found = {}
    for tier in text.split("    item [")[1:]:
        name = re.search(r'name = "(.*)"\n', tier)[1].replace('""', '"')
        rows = re.findall(r'xmin = (\S+)\n +xmax = (\S+)\n +text = "(.*)"', tier)
        assert int(re.search(r"intervals: size = (\d+)", tier)[1]) == len(rows)
        found[name] = [(float(a), float(b), value.replace('""', '"')) for a, b, value in rows]
    return found


def test_a_textgrid_covers_the_whole_time_with_intervals():
    text = write_textgrid(face('O"Brien'))
    found = read_textgrid(text)
    assert {f'{tier}@O"Brien' for tier in ("mouth", "smile", "blinks", "dips")} <= {*found}
    assert found['mouth@O"Brien'] == [(0, 4, ""), (4, 5.6, "open"), (5.6, 10, "")]
    assert found['smile@O"Brien'] == [(0, 10, "")]
    assert [value for *_, value in found['blinks@O"Brien']] == ["", "blink"] * 3 + [""]
    for rows in found.values():
        assert all(one[1] == other[0] for one, other in pairwise(rows)) and (rows[0][0], rows[-1][1]) == (0, 10)
    assert re.search(r"^xmax = 10\.000000\n", text, re.MULTILINE)
    bare = joined([face().find("face", "nose")])
    with pytest.raises(InputError, match="has no points or hands that tell an event"):
        write_textgrid(bare)


def test_a_boris_project_pairs_begins_and_ends_of_declared_subjects():
    table = joined([*face().parts, *face("Anna").parts])
    project = json.loads(write_boris([Clip("a.mp4", table), Clip("a.mp4", table)], written=WRITTEN))
    assert list(project["observations"]) == ["a.mp4", "a.mp4 (2)"] and project["project_format_version"] == "7.0"
    subjects = {one["name"] for one in project["subjects_conf"].values()}
    codes = {one["code"]: one["modifiers"]["0"]["values"] for one in project["behaviors_conf"].values()}
    assert subjects == {"face", "Anna"} and codes == {"blinks": ["blink"], "mouth": ["open"]}
    for observation in project["observations"].values():
        rows = observation["events"]
        assert len(rows) == 2 * len(table.events) and all(one[0] <= other[0] for one, other in pairwise(rows))
        for (who, code, value), each in groupby(sorted(rows, key=lambda row: row[1:4]), key=lambda row: row[1:4]):
            times = [row[0] for row in each]
            assert len(times) % 2 == 0 and who in subjects and value in codes[code]


def test_a_folder_of_runs_is_one_file_with_a_column_of_clips(tmp_path, capsys):
    for name, table in (("one", face()), ("two", face("Anna"))):
        (tmp_path / name).mkdir()
        table.to_pandas().to_csv(tmp_path / name / "trajectory.csv", index=False)
    (tmp_path / "worse").mkdir()
    (tmp_path / "worse" / "trajectory.csv").write_text("frame\n")
    for form in ("events", "measures", "boris"):
        assert main(["export", str(tmp_path), "--to", form]) == 0
        assert re.search("worse.*it is left out", capsys.readouterr().err)
    events = read((tmp_path / f"{tmp_path.name}.events.csv").read_text())
    assert [(row["clip"], row["person"]) for row in events] == [("one", "face")] * 4 + [("two", "Anna")] * 4
    measures = read((tmp_path / f"{tmp_path.name}.measures.csv").read_text())
    assert list(measures[0])[:4] == ["clip", "frame", "time_s", "target"]
    assert [(row["clip"], row["target"]) for row in measures] == [("one", "face")] * 250 + [("two", "Anna")] * 250
    assert len(json.loads((tmp_path / f"{tmp_path.name}.boris").read_text())["observations"]) == 2
    assert main(["export", str(tmp_path), "--to", "srt"]) == 2
    assert "name that of one run" in capsys.readouterr().err


def test_measures_and_events_are_data_frames():
    table = face()
    events, measures = table.to_pandas("events"), table.to_pandas("measures")
    assert list(events.columns) == list(FaceEvent._fields) and len(events) == len(table.events)
    opening = measures[measures.measure == "mouth_opening"]
    np.testing.assert_array_equal(opening.value, table.measures["face"]["mouth_opening"].value)
    assert {"target", "unit", "frame", "time_s", "std", "noise"} <= {*measures.columns}
    with pytest.raises(UsageError, match="'people' is no table"):
        table.to_pandas("people")
    assert table.take(table.frame < 0).to_pandas("events").empty


def test_a_plot_of_measures_has_a_panel_each_and_bars_of_events():
    figure = page.measures_figure(face(), ["mouth_opening", "open", "blink"])
    assert len(figure.axes) == 2  # of the opening, and of what tells a blink
    assert [text.get_text() for text in figure.axes[0].get_legend().texts] == ["face"]
    assert [sum(isinstance(one, Rectangle) for one in axes.patches) for axes in figure.axes] == [1, 3]
    cut = face().take((face().frame < 40) | (face().frame > 60))
    (line, *_) = page.measures_figure(cut, ["mouth_opening"]).axes[0].lines
    assert np.isnan(line.get_ydata()).sum() == 1, "a line ends where nobody is seen"
    with pytest.raises(UsageError, match="has no ears; choose among mouth_opening"):
        page.measures_figure(face(), ["ears"])
    with pytest.raises(UsageError, match="has no ''; choose among mouth_opening"):  # as of a comma at the end
        page.measures_figure(face(), ["mouth_opening", ""])


FIVE = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


def turned_face(target="face", frames=(4, 5, 7), lost=(), angles=(10.0, -20.0, 5.0), scale=1.5, place=(300.0, 200.0)):
    xy = scale * np.array([SHAPE[n] for n in FIVE]) @ rotation_of(np.radians(np.array(angles)))[:2].T + place
    for k, name in enumerate(FIVE):
        t = len(frames)
        status = ["lost" if (name, frame) in lost else "tracked" for frame in frames]
        known = {"x": np.full(t, xy[k, 0]), "y": np.full(t, xy[k, 1]), "confidence": np.full(t, 0.75)}
        known |= {"std_x": np.ones(t), "std_y": np.ones(t)}
        yield one_part(target, name, frames, time_s=np.array(frames) / 25, status=status, **known)


def framed(text):
    return pd.read_csv(io.StringIO(text))


def test_columns_frames_and_landmarks_are_openface_s():
    table = joined([*turned_face(lost={("lip_lower", 5)}), one_part("face", "ear", [4], x=[1.0], y=[2.0])])
    found = framed(write_openface(table, (640, 480)))
    assert list(found.columns) == list(OPENFACE) and len(OPENFACE) == 5 + 6 + 136
    assert found["frame"].tolist() == [5, 6, 8] and found["face_id"].tolist() == [0, 0, 0]
    assert found["timestamp"].tolist() == [0.16, 0.2, 0.28] and found["confidence"].tolist() == [0.75] * 3
    assert found["success"].tolist() == [1, 0, 1]
    for name, number in zip(FIVE, (30, 48, 54, 51, 57), strict=True):
        one = table.find("face", name)
        np.testing.assert_allclose(found[f"x_{number}"], one.x, atol=5e-4)
        np.testing.assert_allclose(found[f"y_{number}"], one.y, atol=5e-4)
    others = found.drop(columns=[f"{c}_{n}" for c in "xy" for n in (30, 48, 54, 51, 57)]).filter(regex="^[xy]_")
    assert others.isna().all(axis=None)
    table = joined([*turned_face("anna", (0, 1)), one_part("hand", "box", [0]), *turned_face("ben", (1, 2))])
    ids = framed(write_openface(table, None))[["frame", "face_id"]].to_numpy().tolist()
    assert ids == [[1, 0], [2, 0], [2, 1], [3, 1]]
    points = [one_part("face", f"point_{i + 1:02d}", [0], x=[float(i)], y=[2.0 * i]) for i in range(68)]
    found = framed(write_openface(joined(points), None)).iloc[0]
    assert found[[f"x_{i}" for i in range(68)]].tolist() == list(range(68)) and np.isnan(found["pose_Rx"])
    said = r"no part is one of .* landmarks, which are mouth_left, .*, chin, .*, and point_01"
    with pytest.raises(InputError, match=said):
        write_openface(one_part("hand", "box", [0], x=[1.0], y=[1.0]), None)


def test_points_of_a_face_and_of_the_mesh_fill_their_columns():
    def columns(names):
        parts = [one_part("face", name, [0], x=[float(i)], y=[2.0 * i]) for i, name in enumerate(names)]
        found = framed(write_openface(joined(parts), None)).iloc[0]
        known = [i for i in range(68) if not np.isnan(found[f"x_{i}"])]
        assert all(found[f"y_{i}"] == 2 * found[f"x_{i}"] for i in known)
        return {i: names[int(found[f"x_{i}"])] for i in known}

    assert {name: number - 1 for name, number in NAMED.items()}.items() <= LANDMARKS.items()
    few = columns(POINTS)
    lids = {f"eye_{side}_{lid}" for side in ("left", "right") for lid in ("upper", "lower")}
    assert {*few.values()} == {*POINTS} - lids
    assert [few[i] for i in (4, 8, 12)] == ["jaw_left", "chin", "jaw_right"]
    ends = [f"brow_{end}" for end in ("left_outer", "left_inner", "right_inner", "right_outer")]
    assert [few[i] for i in (17, 21, 22, 26)] == ends
    assert [few[i] for i in (36, 39, 42, 45)] == [end.replace("brow", "eye") for end in ends]
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
    rows = [0, 3, 4, 6, 8, 10, 12, 13, 16], range(17, 27), range(31, 36), range(36, 40), range(42, 46)
    for row in (*rows, range(48, 55), [48, 59, 58, 57, 56, 55, 54], range(60, 65), [60, 67, 66, 65, 64]):
        assert (np.diff(x[[*row]]) > 0).all()
    for row in ([*range(27, 31), 33, 51, 62, 66, 57, 8], [37, 41], [38, 40], [43, 47], [44, 46], range(9), [16, 12, 8]):
        assert (np.diff(y[[*row]]) > 0).all()
    mirrored = [*range(16, -1, -1), *range(26, 16, -1)]
    assert np.ptp(x[:27] + x[mirrored]) < 25  # the head is nearly frontal, and 192 points wide


def test_the_pose_is_seen_by_openface_s_camera():
    width, height, focal = 1280, 720, (500 * 1280 / 640 + 500 * 720 / 480) / 2
    off = np.array([400.0, -150.0])
    found = framed(write_openface(joined(turned_face(place=off + np.array([639.5, 359.5]))), (width, height))).iloc[0]
    place = found[["pose_Tx", "pose_Ty", "pose_Tz"]].to_numpy(dtype=float)
    assert place[2] == pytest.approx(focal / 1.5, rel=1e-3)
    np.testing.assert_allclose(focal * place[:2] / place[2], off, rtol=1e-3)
    # what the line of sight sees, seen along the camera's axis
    turned = rotation_of(found[["pose_Rx", "pose_Ry", "pose_Rz"]].to_numpy(dtype=float))
    ahead = turned @ rotation_of(np.radians([10.0, -20.0, 5.0])).T @ [0, 0, 1]
    np.testing.assert_allclose(ahead, place / np.linalg.norm(place), atol=2e-3)
    without = framed(write_openface(joined(turned_face()), None)).iloc[0]
    assert np.isnan(without["pose_Tz"])
    angles = without[["pose_Rx", "pose_Ry", "pose_Rz"]].to_numpy(float)
    np.testing.assert_allclose(angles, np.radians([10, -20, 5]), atol=2e-3)
