"""One clip tracked in chunks: where it is cut, what becomes of each chunk, and the rows that are joined of them."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.report.make import make_report
from facetrack_cli.report.story import history_of, key_frames
from facetrack_cli.runs import batch
from facetrack_cli.runs.plan import Split
from facetrack_cli.runs.split import OVERLAP_S, ChunkPlan, Seam, agreeing, cut_by_length, read_plan, renamed, stitch
from facetrack_cli.start.init_file import write_init
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.header import read_header
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.video.source import open_source
from tests.support import media
from tests.support.samples import FOLDER as SAMPLES

CLIP = SAMPLES / "expressions.mp4"  # 275 frames
HIDDEN = range(105, 180)  # frames of dark.mp4 that show nothing
SMALL = 0.625  # of its size, so that faces are found sooner
POINTS = {
    "nose": (159.0 * SMALL, 141.0 * SMALL),
    "mouth_left": (138.5 * SMALL, 153.6 * SMALL),
    "mouth_right": (180.0 * SMALL, 154.4 * SMALL),
    "lip_upper": (159.0 * SMALL, 153.6 * SMALL),
    "lip_lower": (159.0 * SMALL, 168.6 * SMALL),
}
SPLIT = ("--config", "factorized", "--init", "haar", "--split", "75f")
# at 5 frames/s chunks overlap by 25 frames


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """expressions.mp4 at 5 frames/s, so that it lasts for 55 s, and the same with a dark stretch."""
    folder = tmp_path_factory.mktemp("clips")
    slow, dark = f"scale={320 * SMALL}:-1,setpts=5*PTS", f"drawbox=t=fill:color=black:enable='{_dark()}'"
    filters = {"slow.mp4": slow, "dark.mp4": f"{slow},{dark}"}
    for name, text in filters.items():
        options = ("-r", "5", "-c:v", "libx264", "-preset", "veryfast", "-g", "20", "-bf", "2")
        media.ffmpeg("-i", CLIP, "-vf", text, *options, folder / name)
    given = TargetStart(points=POINTS)
    write_init(folder / "corrected.yaml", Start(0, {"face": given}, "x", (Correction(60, "face", given),)))
    return folder


def _dark():
    return f"between(n,{HIDDEN[0]},{HIDDEN[-1]})"


def lines(folder):
    return (folder / "trajectory.csv").read_text().splitlines()


def frames_of(folder):
    return [line for line in (folder / "trajectory.json").read_text().splitlines() if line.startswith('{"frame":')]


def test_chunks_are_tracked_and_joined(facetrack, clips, tmp_path):
    assert facetrack("run", "IN/slow.mp4", *SPLIT[:4], "--no-video", "-o", "whole")[0] == 0
    code, _, err = facetrack("run", "IN/slow.mp4", *SPLIT, "--no-video", "-o", "out")
    assert code == 0, err
    out, work = tmp_path / "work/out", tmp_path / "work"
    header = json.loads((out / "trajectory.json").read_text())
    assert [chunk["first"] for chunk in header["chunks"]] == [0, 60, 120, 180]
    seams = header["seams"]
    assert [seam["agrees"] for seam in seams] == [True] * 3
    assert [seam["frame"] for seam in seams] == [72, 132, 192]  # the middle of the frames that both have
    assert header["complete"] and header["frames_tracked"] == 275
    assert header["split"] == {"length": "75f"}
    # the rows are those of the chunks, the first of which is as the whole run
    rows = frames_of(out)
    assert len(rows) == 275
    assert [line.rstrip(",") for line in rows[:72]] == [line.rstrip(",") for line in frames_of(work / "whole")[:72]]
    for chunk, (first, stop) in enumerate([(0, 72), (72, 132), (132, 192), (192, 275)]):
        there = {line.rstrip(",") for line in frames_of(out / "chunks" / f"{chunk:05d}")}
        assert {line.rstrip(",") for line in rows[first:stop]} <= there
    whole, joined = read_trajectory(work / "whole"), read_trajectory(out)
    assert np.array_equal(whole.frame, joined.frame)
    lost = len(np.unique(joined.frame[joined.status == "lost"]))
    assert f"some part called lost in {lost} of 275 frames; begins in frame 0" in err
    assert np.array_equal(whole.time_s, joined.time_s)
    assert np.hypot(whole.x - joined.x, whole.y - joined.y).mean() < 2.5
    # and again
    code, _, err = facetrack("run", "IN/slow.mp4", *SPLIT, "--no-video", "-o", "out")
    assert code == 0
    assert "done before" in err


def test_shards_share_the_chunks_and_the_last_joins_them(facetrack, clips, tmp_path):
    command = ("run", "IN/slow.mp4", *SPLIT, "--stop", "135", "--no-video", "-o", "out")
    code, _, err = facetrack(*command, "--shard", "1/2")
    assert code == 0
    assert "1 of 2 chunks are not done; who ends the last one joins them" in err
    work = tmp_path / "work"
    assert not (work / "out/run.json").exists()
    assert facetrack(*command, "--shard", "2/2")[0] == 0
    assert facetrack(*command[:-1], "alone", "-j", "2")[0] == 0
    assert lines(work / "out") == lines(work / "alone")
    assert frames_of(work / "out") == frames_of(work / "alone")


def test_what_no_chunk_found_is_missing_and_said(facetrack, clips, tmp_path):
    command = ("run", "IN/dark.mp4", *SPLIT, "-o", "out")
    code, _, err = facetrack(*command)
    assert code == 0, err
    out = tmp_path / "work/out"
    header = json.loads((out / "trajectory.json").read_text())
    assert not header["complete"]
    assert header["chunks"][2]["first"] in range(HIDDEN[-1] + 1, HIDDEN[-1] + 8)  # it was looked for until then
    seam = header["seams"][1]
    table = read_trajectory(out)
    first = header["chunks"][2]["first"]
    assert seam["frame"] == first or (not seam["agrees"] and seam["frame"] > first)
    assert (table.at(seam["frame"]).status == "init").all()
    assert any("two chunks differ" in line or "no rows of frames" in line for line in header["warnings"])
    assert all(line in err for line in header["warnings"])
    # the report has the place as an event, and does not call it corrected
    history = history_of(table, Clock(table, 5.0), read_header(table).seams)
    assert history.corrections == ()
    assert any(event.kind == "seam" for key in key_frames(history, 0, 274) for event in key.events)
    page = make_report(out).html.decode()
    assert "Two chunks differ" in page
    assert "--split 75f" in page
    with open_source(out / "annotated.mp4") as source:
        assert sum(1 for _ in source) == 275


def test_a_chunk_that_fails_does_not_stop_the_others(facetrack, clips, tmp_path, monkeypatch):
    run = batch.run

    def breaking(job, *others):
        if job.out.name == "00001":
            raise FacetrackError("a fuse blew")
        return run(job, *others)

    command = ("run", "IN/slow.mp4", *SPLIT, "--stop", "200", "--no-video", "-o", "out")
    with monkeypatch.context() as patch:
        patch.setattr(batch, "run", breaking)
        code, _, err = facetrack(*command)
    assert code == 5
    assert "chunks/00001: " in err
    header = json.loads((tmp_path / "work/out/trajectory.json").read_text())
    assert not header["complete"]
    assert header["frames_tracked"] < 200
    code, _, err = facetrack(*command, "--retry-failed")
    assert code == 0, err
    assert json.loads((tmp_path / "work/out/trajectory.json").read_text())["frames_tracked"] == 200


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--split", "30"), "give a unit"),
        (("--split", "m"), "is no length"),
        (("--split", "8s"), "overlap by 5 s; give --split 10s or more"),
        (("--split", "40f"), "give --split 50f or more"),
        ((*SPLIT, "--smooth"), "--smooth goes over the whole clip"),
        ((*SPLIT, "--lag", "5"), "--lag goes over the whole clip"),
        ((*SPLIT, "-o", "-"), "name one with --out"),
        ((*SPLIT, "IN/dark.mp4"), "--split cuts one clip"),
        ((*SPLIT, "--overwrite", "--shard", "1/2"), "remove the folder before them"),
        ((*SPLIT[4:], "--config", "contour", "--box", "110,80,90,90"), "which no detector finds again"),
        (("--split", "20s", "--init", "IN/corrected.yaml", "--config", "factorized"), "has corrections, which --split"),
    ],
)
def test_what_cannot_be_split_is_refused_in_a_line(facetrack, clips, options, said):
    code, _, err = facetrack("run", "IN/slow.mp4", *options, *(() if "-o" in options else ("-o", "out")))
    assert code == 2
    assert said in err.replace("\n", " ")


def test_chunks_of_another_split_are_not_mixed(facetrack, clips, tmp_path):
    command = ("run", "IN/slow.mp4", "--stop", "130", "--no-video", "-o", "out", *SPLIT)
    assert facetrack(*command, "--shard", "1/2")[0] == 0
    code, _, err = facetrack(*command, "--seed", "3")
    assert code == 2
    assert "holds chunks of another --split" in err
    assert facetrack(*command, "--seed", "3", "--overwrite")[0] == 0


@given(
    st.integers(0, 200),
    st.integers(1, 3000),
    st.lists(st.floats(0.01, 0.2), min_size=1, max_size=4),
    st.floats(10, 60),
    st.integers(1, 90),
)
def test_chunks_cover_all_frames_and_overlap(first, count, gaps, length, spacing):
    times = np.cumsum(np.resize(gaps, first + count))
    chunks = cut_by_length(first, times, Split(length, False), range(0, len(times), spacing), "clip")
    assert chunks[0][0] == first
    assert chunks[-1][1] == len(times)
    for (begin, stop), (after, _) in itertools.pairwise(chunks):
        assert begin < after < stop
        assert times[stop - 1] < times[after] + OVERLAP_S <= times[min(stop, len(times) - 1)] + 1e-9
        assert length / 2 - 0.21 <= times[after] - times[begin] <= length + 0.21


def test_a_plan_is_read_as_it_was_written(tmp_path):
    start = Start(3, {"face": TargetStart((1.5, 2, 30, 40), {"nose": (3.25, 4.1)})}, "haar", (), "a note")
    ChunkPlan.of("key", start, [(3, 9), (7, None)]).write(tmp_path)
    read = read_plan(tmp_path)
    assert (read.key, read.start, read.cuts) == ("key", start, ((3, 9), (7, None)))


# --- where two chunks meet --------------------------------------------------------------------------------------------


def box(target, first, stop, x=50.0, side=20.0, status="tracked"):
    frames = np.arange(first, stop)
    same = np.ones(len(frames))
    places = {"x": x * same, "y": 40.0 * same, "w": side * same, "h": side * same}
    return one_part(target, "box", frames, **places, status=[status] * len(frames))


def face(first, stop, dx=0.0, **more):
    points = {"eye_left": (40.0, 40.0), "eye_right": (60.0, 40.0), "nose": (50.0, 50.0), **more}
    frames = np.arange(first, stop)
    parts = []
    for name, (x, y) in points.items():
        same = np.ones(len(frames))
        parts.append(one_part("face", name, frames, x=(x + dx) * same, y=y * same, w=9 * same, h=9 * same))
    return joined(parts)


def test_boxes_agree_where_they_overlap_by_half():
    assert agreeing(box("a", 0, 9), box("a", 5, 12)).tolist() == [True] * 4
    assert agreeing(box("a", 0, 9), box("a", 5, 12, x=56.5)).all()  # 13.5 of 26.5
    assert not agreeing(box("a", 0, 9), box("a", 5, 12, x=57)).any()  # 13 of 27
    assert len(agreeing(box("a", 0, 9), box("a", 9, 12))) == 0


@pytest.mark.parametrize(("dx", "agrees"), [(9.9, True), (-9.9, True), (10.1, False)])
def test_points_agree_within_half_the_distance_between_the_eyes(dx, agrees):
    assert agreeing(face(0, 9), face(3, 12, dx)).tolist() == [agrees] * 6


def test_other_points_agree_within_half_of_their_shape():
    mouth = [one_part("face", name, [0], x=[x], y=[40.0]) for name, x in (("left", 40.0), ("right", 64.0))]
    moved = [one_part("face", name, [0], x=[x], y=[52.5]) for name, x in (("left", 40.0), ("right", 64.0))]
    assert agreeing(joined(mouth), joined(mouth)).all()
    assert not agreeing(joined(mouth), joined(moved)).any()
    one, other = (one_part("face", "nose", [0], x=[x], y=[40.0], w=[20.0], h=[20.0]) for x in (40.0, 49.9))
    assert agreeing(one, other).all()
    assert not agreeing(one, one_part("face", "nose", [0], x=[50.1], y=[40.0])).any()


def test_what_one_of_them_alone_shows_differs_and_what_none_shows_does_not_count():
    hidden = face(0, 9, nose=(np.nan, np.nan))
    assert not agreeing(hidden, face(0, 9)).any()
    assert agreeing(hidden, hidden).all()
    none = box("a", 0, 9, x=np.nan)
    assert len(agreeing(none, none)) == 0


def test_chunks_meet_in_the_middle_of_the_frames_that_both_have():
    met = stitch(face(10, 20), face(14, 40), {"face"}, matched=False)
    assert met == (Seam(17, 1.0, True), {"face": "face"}, frozenset())
    met = stitch(face(10, 20), face(14, 40, dx=30.0), {"face"}, matched=False)
    assert met.seam == Seam(17, 0.0, False)
    assert met.names == {"face": "face"}
    met = stitch(face(10, 20), face(25, 40), {"face"}, matched=False)
    assert met.seam == Seam(25, None, False)


def test_most_of_the_frames_must_agree():
    for wrong, agrees in ((2, True), (3, False)):
        later = joined([box("face", 10, 10 + wrong, x=99.0), box("face", 10 + wrong, 20)])
        met = stitch(box("face", 0, 20), later, {"face"}, matched=False)
        assert met.seam == Seam(15, 1 - wrong / 10, agrees)


def test_faces_take_the_names_of_those_they_agree_with():
    earlier = joined([box("face", 0, 20, x=50), box("face_2", 0, 20, x=150)])
    later = joined([box("face", 10, 30, x=151), box("face_2", 10, 30, x=51), box("face_3", 10, 30, x=250)])
    met = stitch(earlier, later, {"face", "face_2", "face_3"}, matched=True)
    # somebody else was called face_3 before
    assert met.names == {"face": "face_2", "face_2": "face", "face_3": "face_4"}
    assert met.seam.agrees
    assert met.begun == {"face_4"}
    rows = renamed(later, met.names)
    assert [part.x[0] for part in rows.of_target("face")] == [51]
    # one who was lost all the while may have left, one who was not may not
    gone = joined([box("face", 0, 20, x=50), box("face_2", 0, 20, x=150, status="lost")])
    assert stitch(gone, box("face", 10, 30, x=50), {"face", "face_2"}, matched=True).seam.agrees
    assert not stitch(earlier, box("face", 10, 30, x=50), {"face", "face_2"}, matched=True).seam.agrees
    # and after a gap nobody is known again
    assert stitch(earlier, box("face", 40, 50), {"face", "face_2"}, matched=True).names == {"face": "face_3"}
