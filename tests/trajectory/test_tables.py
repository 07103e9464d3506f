"""Tables for spreadsheets and data frames, read back by csv and pandas."""

import csv
import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.numbers import csv_text
from facetrack_cli.trajectory.formats.keypoints import write_dlc
from facetrack_cli.trajectory.formats.tables import Clip, write_csv_wide, write_measures, write_pose
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face


def part(target, name, frames, *, seed=0, lost=()):
    rng, t = np.random.default_rng(seed), len(frames)
    return one_part(
        target, name, frames, time_s=np.array(frames) / 25, x=np.round(rng.uniform(0, 640, t), 3),
        y=np.round(rng.uniform(0, 480, t), 3), w=np.full(t, 20.5), h=np.full(t, 10.0), particles=np.full(t, 200.0),
        confidence=np.round(rng.uniform(0, 1, t), 4), status=["lost" if f in lost else "tracked" for f in frames],
    )  # fmt: skip


def read(text):
    return list(csv.DictReader(io.StringIO(text.removeprefix("\ufeff"))))


def test_a_row_a_frame_with_the_parts_side_by_side():
    table = joined([part("face", "nose", [3, 4, 6], lost=[4]), part("head", "box", [4, 5])])
    found = read(write_csv_wide(table))
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


@settings(max_examples=30)
@given(st.integers(1, 4), st.integers(1, 9), st.integers(0, 2**32))
def test_every_number_of_a_wide_table_comes_back(parts, frames, seed):
    made = [part("face", f"p{k}", range(k, k + frames), seed=seed + k) for k in range(parts)]
    found = pd.read_csv(io.StringIO(write_csv_wide(joined(made))), index_col="frame")
    for one in made:
        rows = found.loc[one.frame]
        for name in ("x", "y", "w", "h", "confidence", "status"):
            np.testing.assert_array_equal(rows[f"face_{one.part}_{name}"], getattr(one, name))


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


def test_whole_milliseconds_of_a_container_are_the_constant_rate_that_the_header_tells():
    told = {"source": {"fps": 30 / 1.001}, "variable_fps": False}
    found = timed(np.round(np.arange(300) * 1.001 / 30, 3), **told)
    np.testing.assert_allclose(found, np.arange(300) * 1.001 / 30, atol=1e-6)


def test_a_variable_rate_is_kept_and_frames_without_rows_lie_between():
    found = timed([0.08, 0.12, 0.5, 0.54, 1.5], np.array([2, 3, 5, 6, 9]), source={"fps": 25.0}, variable_fps=True)
    np.testing.assert_allclose(found[[2, 3, 5, 6, 9]], [0.08, 0.12, 0.5, 0.54, 1.5])
    np.testing.assert_allclose(found[[4, 7, 8]], [0.31, 0.86, 1.18])
    assert (np.diff(found) > 0).all()


def test_times_that_few_rows_or_none_tell():
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


# --- as a notebook shows it ---


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
    many = joined([seen(f"p{i}", 2, 2) for i in range(30)])._repr_html_()
    assert many.count("<svg") == 20 and "and 10 more" in many, "the first are shown"
    assert "<td>1</td><td>100%" in one_part("face", "box", [3], x=[1.0], y=[2.0])._repr_html_()
