"""What reads a trajectory in which somebody corrected what was tracked: tables, measures, exports, plots, reports."""

import json
import math
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.evaluation.accuracy import measure_confidence, measure_coverage, measure_lost, measure_points
from facetrack_cli.evaluation.rows import match
from facetrack_cli.evaluation.summary import evaluate
from facetrack_cli.report.figures import page
from facetrack_cli.report.figures import style as plot_style
from facetrack_cli.report.make import command, history_of, key_frames, reasons, recipe_yaml
from facetrack_cli.start.init_file import as_yaml
from facetrack_cli.trajectory.formats.boxes import write_mot, write_otb, write_vot
from facetrack_cli.trajectory.formats.tables import write_coco, write_dlc
from facetrack_cli.trajectory.reader import read_header, read_trajectory
from facetrack_cli.trajectory.trajectory import one_part
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.trajectory.writers import WRITERS, RunSummary
from tests.evaluation.test_match import rows, statuses
from tests.support import results
from tests.support.sinks import Alone

SAMPLE = Path(__file__).parents[2] / "sample_videos" / "occlusion.mp4"
NAN = math.nan
# frame 3: lip is lost; 5: it is absent, said by hand; 8: it is given again, and nose is kept; 10: both are absent
CORRECTIONS = [
    {"frame": 5, "target": "face", "absent": ["lip"]},
    {"frame": 8, "target": "face", "points": {"lip": [30, 20]}, "kept": {"nose": [10, 20]}, "learn": True},
    {"frame": 10, "target": "face", "absent": True},
]
HEADER = {
    "source": {"path": "clip.mp4", "size": [64, 48], "fps": 25.0},
    "recipe": {"name": "mine", "description": "x"},
    "seed": 0,
    "init": {
        "from": "haar",
        "frame": 0,
        "targets": {"face": {"points": {"nose": [10, 20], "lip": [30, 20]}}},
        "corrections": CORRECTIONS,
    },
}


def result(index):
    lip = "absent" if index in (5, 6, 7) or index >= 10 else "lost" if index in (3, 4) else "tracked"
    said = {"nose": "absent" if index >= 10 else "tracked", "lip": lip}
    by_hand = {"nose": index == 10, "lip": index in (5, 8, 10)}
    if index in (0, 8):
        said = {"nose": "init" if index == 0 else "tracked", "lip": "init"}
    parts = []
    for name, x in (("nose", 10.0), ("lip", 30.0)):
        place = (None,) * 4 if said[name] == "absent" else (x + 0.5 * index, 20.0, 8.0, 6.0)
        known = {} if said[name] == "absent" else {"confidence": 0.8, "cov": (1.0, 0.0, 1.0), "ess": 9.0}
        parts.append(results.part(name, *place, said[name], **known, by_hand=by_hand[name]))
    gone = all(status == "absent" for status in said.values())
    return results.result(index, [results.target("face", parts, None if gone else 10)]).rows


@pytest.fixture
def table(tmp_path):
    writer = WRITERS["json"](Alone(tmp_path / "trajectory.json"), HEADER)
    for index in range(13):
        writer.write(result(index))
    writer.close(RunSummary())
    return read_trajectory(tmp_path / "trajectory.json")


# --- measures ----------------------------------------------------------------------------------------------------


def corrected(letters):
    """Statuses of ours: i init, t tracked, l lost, a absent."""
    return ["absent" if one == "a" else statuses(one)[0] for one in letters]


def test_an_absent_row_is_a_miss_where_the_truth_is_visible_and_no_error_elsewhere():
    part = rows([0, NAN, NAN, NAN, 1], "vvhav", ours=corrected("iaaat"))
    found = measure_points([part])
    assert (found.rows, found.missing, found.hidden_rows) == (2, 1, 0)
    assert found.failure_rate == pytest.approx(1 / 3)
    found = measure_lost([rows([0, 0, NAN, NAN, 0, 0], "vvhhvv", ours=corrected("ittaat"))])
    assert (found.rows, found.covered, found.called) == (3, 1, 0), "neither called lost nor missed"


def test_a_place_given_by_hand_is_no_merit_but_in_the_first_frame():
    part = rows([0, 6, 0, 6], "vvvv", ours=corrected("itit"))
    assert part.later.tolist() == [False, False, True, False]
    found = measure_points([part])
    assert found.rows == 3 and found.mean_px == 4
    part = replace(part, confidence=np.array([1.0, 0.2, 1.0, 0.2]), std=np.ones((4, 2)))
    assert [measure([part]).rows for measure in (measure_lost, measure_confidence, measure_coverage)] == [2, 2, 2]


def boxes(status, x, frames=6, **more):
    """A target of 20 by 20 pixels."""
    full = np.full(frames, 20.0)
    return one_part("hand", "box", range(frames), x=x, y=np.full(frames, 50.0), w=full, h=full, status=status, **more)


def test_boxes_given_later_are_left_out_and_absent_ones_miss_where_there_is_something_to_see():
    x = np.full(6, 50.0)
    seen = ["visible", "visible", "hidden", "hidden", "visible", "visible"]
    theirs = replace(boxes(seen, x), path=Path("truth.csv"))
    gone = [NAN if letter == "a" else 50.0 for letter in "iaatit"]
    ours = boxes(corrected("iaatit"), gone)
    ours = replace(ours, w=np.where(np.isnan(ours.x), NAN, 20.0), h=np.where(np.isnan(ours.x), NAN, 20.0))
    found = evaluate(match(replace(ours, path=Path("t.json")), theirs, partial=False, select=None))
    measured = found.parts[0]
    assert (measured.boxes.rows, measured.boxes.missing) == (3, 1), "frame 4 was given by hand"
    assert measured.boxes.ao == pytest.approx(0.5), "one of two after the first"
    assert (measured.boxes.hidden_rows, measured.boxes.hidden_overlap) == (1, 1.0), "to call it absent is no miss"


def test_a_trajectory_with_absent_rows_may_be_measured_and_be_truth(table):
    other = replace(table, x=table.x + 1, header={}, path=Path("checked.csv"))
    found = evaluate(match(table, other, partial=False, select=None))
    assert found.counts["absent"] == 9 and found.all.points.mean_px == pytest.approx(1.0)


# --- exports -----------------------------------------------------------------------------------------------------


def test_what_is_absent_has_no_row_or_no_place_in_other_formats(table):
    lip = table.parts[1]
    assert [int(line.split(",")[0]) - 1 for line in write_mot([lip]).splitlines()] == [0, 1, 2, 3, 4, 8, 9]
    assert write_vot(lip).splitlines()[5] == "2"
    assert write_otb(lip).splitlines()[5] == "nan,nan,nan,nan"
    assert write_dlc(table).splitlines()[3 + 5] == "5,12.500,20.000,0.8000,,,"
    annotations = json.loads(write_coco(table, (64, 48), "{}.png".format, "windows"))["annotations"]
    frames = {one["image_id"] - 1: one for one in annotations}
    assert sorted(frames) == list(range(10)), "nothing where all is absent"
    assert frames[5]["keypoints"][3:6] == [0, 0, 0] and frames[5]["num_keypoints"] == 1


# --- plots and reports -------------------------------------------------------------------------------------------


def test_the_plots_shade_what_is_absent_and_mark_what_was_corrected(table):
    pytest.importorskip("matplotlib", reason="needs the extra: pip install -e '.[plot]'")
    figure = page.page_figure(table)
    labels = [text.get_text() for text in figure.axes[0].get_legend().texts]
    assert {"absent", "corrected by hand"} <= set(labels)
    marks = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "^"]
    assert [line.get_xdata().tolist() for line in marks] == [[5, 8, 10]]
    plain = table.between(0, 5)
    assert not {"absent", "corrected by hand"} & {
        t.get_text() for t in page.page_figure(plain).axes[0].get_legend().texts
    }
    assert plot_style.render(figure).startswith(b"\x89PNG")


def test_a_report_says_what_was_corrected(table):
    history = history_of(table, Clock(table, 25.0))
    assert history.corrections == (5, 8, 10)
    nose, lip = history.parts
    assert [(span.first, span.last) for span in lip.absent] == [(5, 7), (10, 12)]
    assert sum(span.frames for span in nose.absent) == 3
    assert [(span.first, span.last, span.back, span.by_hand) for span in lip.lost] == [(3, 4, None, True)]
    assert (history.ending("lost"), history.ending("absent")) == ([], ["nose", "lip"])
    events = reasons(table, history, "x", 0, 12)
    kinds = {frame: [kind for kind, *_ in events[frame]] for frame in key_frames(history, events, 0, 12)}
    assert kinds == {
        0: ["start"], 1: ["worst"], 3: ["lost"], 5: ["corrected"], 8: ["corrected"], 10: ["corrected"], 12: ["end"]
    }  # fmt: skip


START = """frame: 0
face:
  points:
    {nose: [171.32, 128.93], mouth_left: [149.43, 153.19], mouth_right: [194.57, 152.28],
     lip_upper: [170.86, 149.45], lip_lower: [171.32, 160.40]}
corrections:
- {frame: 3, face: {absent: [mouth_left]}}
- {frame: 6, face: {points: {mouth_left: [149.4, 153.2]}}}
- {frame: 8, face: {absent: true}}
"""


def test_a_run_with_corrections_is_reported_and_repeated(tmp_path, monkeypatch, no_plot):
    monkeypatch.chdir(tmp_path)
    Path("start.yaml").write_text(START)
    options = ["--config", "factorized", "--set", "filter.particles=15", "--no-video", "-q"]
    assert main(["run", str(SAMPLE), "--init", "start.yaml", *options, "--stop", "10", "-o", "run"]) == 0
    assert main(["report", "run"]) == 0
    page = Path("run/report.html").read_text()
    for said in (
        "<dd>3 frames<small>5 marked as absent", "by hand in frames 3, 6 and 8",
        "<strong>Corrected by hand</strong> mouth_left absent", "absent: [mouth_left]", 'class="absent"',
    ):  # fmt: skip
        assert said in page, said
    table = read_trajectory(Path("run"))
    header = read_header(table)
    words = shlex.split(command(header, int(table.frames[-1])))
    Path(words[words.index("--init") + 1]).write_text(as_yaml(header.init.start, header.clip_name))
    Path(words[words.index("--config") + 1]).write_text(recipe_yaml(header.recipe))
    assert main([*words[1:], "--no-video", "-q"]) == 0
    assert Path("again/trajectory.csv").read_bytes() == Path("run/trajectory.csv").read_bytes()
    for form in ("mot", "coco", "dlc", "eaf"):
        assert main(["export", "run", "--to", form, "-o", f"x.{form}"]) == 0
    assert 'TIER_ID="absent@face"' in Path("x.eaf").read_text()
    assert main(["eval", "run", "--truth", str(SAMPLE.with_suffix(".truth.csv")), "--partial"]) == 0
