"""Events as a table, as subtitles and as a project of BORIS, of one clip and of a folder of runs."""

import csv
import io
import json
import re
from datetime import UTC, datetime
from functools import cache
from itertools import groupby, pairwise

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.face_points import GROUPS
from facetrack_cli.report import figures as plots
from facetrack_cli.trajectory.analysis.face_events import FaceEvent
from facetrack_cli.trajectory.formats.events import COLUMNS, write_boris, write_events, write_subtitles, write_textgrid
from facetrack_cli.trajectory.formats.tables import Clip
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face

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
    rows = list(csv.DictReader(io.StringIO(write_events([Clip("a.mp4", face()), Clip("b.mp4", face("Anna"))]))))
    assert tuple(rows[0]) == COLUMNS and len(rows) == 8
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
    events = list(csv.DictReader(io.StringIO((tmp_path / f"{tmp_path.name}.events.csv").read_text())))
    assert [(row["clip"], row["person"]) for row in events] == [("one", "face")] * 4 + [("two", "Anna")] * 4
    measures = list(csv.DictReader(io.StringIO((tmp_path / f"{tmp_path.name}.measures.csv").read_text())))
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
    figure = plots.measures_figure(face(), ["mouth_opening", "open", "blink"])
    assert len(figure.axes) == 2  # of the opening, and of what tells a blink
    assert [sum(isinstance(one, Rectangle) for one in axes.patches) for axes in figure.axes] == [1, 3]
    assert figure.axes[-1].get_xlabel() == "seconds"
    with pytest.raises(UsageError, match="has no ears; choose among mouth_opening"):
        plots.measures_figure(face(), ["ears"])
