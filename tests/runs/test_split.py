"""One clip tracked in chunks: where it is cut, what becomes of each chunk, and the rows that are joined of them."""

import itertools
import json
import os
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import FacetrackError, InputError
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.report.make import history_of, key_frames, make_report, reasons
from facetrack_cli.run_folder.manifest import Manifest
from facetrack_cli.runs import batch, plan, split
from facetrack_cli.runs.plan import Job, Split
from facetrack_cli.runs.split import OVERLAP_S, Seam, agreeing, cut_by_length, renamed, stitch
from facetrack_cli.start.init_file import write_init
from facetrack_cli.trajectory.reader import read_header, read_trajectory
from facetrack_cli.trajectory.trajectory import joined, one_part
from facetrack_cli.trajectory.views import Clock
from facetrack_cli.video.source import open_source
from tests.support import media
from tests.support.samples import FOLDER as SAMPLES

CLIP = SAMPLES / "expressions.mp4"  # 275 frames
HIDDEN = range(42, 72)  # frames of dark.mp4 that show nothing
SMALL = 0.5  # of its size, so that faces are found sooner
POINTS = {
    name: (x * SMALL, y * SMALL)
    for name, x, y in (
        ("nose", 159.0, 141.0), ("mouth_left", 138.5, 153.6), ("mouth_right", 180.0, 154.4),
        ("lip_upper", 159.0, 153.6), ("lip_lower", 159.0, 168.6),
    )
}  # fmt: skip
SPLIT = ("--config", "factorized", "--init", "haar", "--split", "24f")
# at 2 frames/s chunks overlap by 10 frames


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """A stretch of expressions.mp4 at 2 frames/s, so that it lasts for 46 s, and the same with a dark stretch."""
    folder = tmp_path_factory.mktemp("clips")
    slow = f"scale={320 * SMALL}:-1,trim=start_frame=96,setpts=12.5*(PTS-STARTPTS)"
    black = f"drawbox=t=fill:color=black:enable='between(n,{HIDDEN[0]},{HIDDEN[-1]})'"
    for name, text in (("slow.mp4", slow), ("dark.mp4", f"{slow},{black}")):
        options = ("-r", "2", "-frames:v", "92", "-c:v", "libx264", "-preset", "veryfast", "-g", "20", "-bf", "2")
        media.ffmpeg("-i", CLIP, "-vf", text, *options, folder / name)
    start = Start(0, {"face": TargetStart(points=POINTS)}, "x", (Correction(60, "face", points=POINTS),))
    write_init(folder / "corrected.yaml", start)
    both = {name: TargetStart(points=POINTS) for name in ("left", "right")}
    write_init(folder / "two.yaml", Start(0, both, "x"))
    return folder


def frames_of(folder):
    text = (folder / "trajectory.json").read_text()
    return [line.rstrip(",") for line in text.splitlines() if line.startswith('{"frame":')]


def header_of(folder):
    return json.loads((folder / "trajectory.json").read_text())


def test_chunks_are_tracked_and_joined(facetrack, clips, monkeypatch):
    searched, search = [], plan.search_start
    monkeypatch.setattr(plan, "search_start", lambda *args, **how: searched.append(1) or search(*args, **how))
    command, out, whole = ("run", "IN/slow.mp4", "--stop", "68", "--no-video", "-o"), Path("out"), Path("whole")
    assert facetrack(*command, "whole", *SPLIT[:4])[0] == 0
    code, _, err = facetrack(*command, "out", *SPLIT)
    assert code == 0 and len(searched) == 4, "for the whole clip, and once for each chunk"
    header = header_of(out)
    assert [chunk["first"] for chunk in header["chunks"]] == [0, 24, 48]
    assert [seam["agrees"] for seam in header["seams"]] == [True] * 2
    assert [seam["frame"] for seam in header["seams"]] == [29, 53]  # the middle of the frames that both have
    assert header["complete"] and header["frames_tracked"] == 68 and header["split"] == {"length": "24f"}
    # the rows are those of the chunks, the first of which is as the whole run
    rows = frames_of(out)
    assert len(rows) == 68 and rows[:29] == frames_of(whole)[:29]
    for chunk, (first, stop) in enumerate([(0, 29), (29, 53), (53, 68)]):
        assert {*rows[first:stop]} <= {*frames_of(out / "chunks" / f"{chunk:05d}")}
    alone, joined = read_trajectory(whole), read_trajectory(out)
    assert np.array_equal(alone.frame, joined.frame) and np.array_equal(alone.time_s, joined.time_s)
    lost = len(np.unique(joined.frame[joined.status == "lost"]))
    assert f"some part called lost in {lost} of 68 frames; begins in frame 0" in err
    assert np.hypot(alone.x - joined.x, alone.y - joined.y).mean() < 2.5
    code, _, err = facetrack(*command, "out", *SPLIT)
    assert code == 0 and "done before" in err


def test_shards_share_the_chunks_and_the_last_joins_them(facetrack, clips):
    command = ("run", "IN/slow.mp4", *SPLIT, "--stop", "46", "--no-video", "-o")
    code, _, err = facetrack(*command, "out", "--shard", "1/2")
    assert code == 0 and "1 of 2 chunks are not done; who ends the last one joins them" in err
    assert not Path("out/run.json").exists()
    said = facetrack("status", "out")[1]
    assert "out: 2 chunks" in said and "1 chunk left" in said and "give the command again" in said
    assert [one["folder"] for one in json.loads(facetrack("status", "out", "--json")[1])["clips"]] == [
        "chunks/00000", "chunks/00001",
    ]  # fmt: skip
    code, _, err = facetrack(*command, "out", "--seed", "3")
    assert code == 2 and "out/chunks/00000/trajectory.json: " in err
    assert facetrack(*command, "out", "--shard", "2/2")[0] == facetrack(*command, "alone", "-j", "2")[0] == 0
    assert frames_of(Path("out")) == frames_of(Path("alone"))
    both = (Path(folder, "trajectory.csv").read_text() for folder in ("out", "alone"))
    assert len({*both}) == 1
    assert facetrack(*command, "out", "--seed", "3", "--overwrite")[0] == 0


def test_what_no_chunk_found_is_missing_and_said(facetrack, clips, no_plot):
    code, _, err = facetrack("run", "IN/dark.mp4", *SPLIT, "-o", "out")
    assert code == 0, err
    out = Path("out")
    header, table = header_of(out), read_trajectory(out)
    first, seam = header["chunks"][2]["first"], header["seams"][1]
    assert not header["complete"] and first in range(HIDDEN[-1] + 1, HIDDEN[-1] + 8)  # it was looked for until then
    assert seam["frame"] == first or (not seam["agrees"] and seam["frame"] > first)
    assert (table.at(seam["frame"]).status == "init").all()
    assert any("two chunks differ" in line or "no rows of frames" in line for line in header["warnings"])
    assert all(line in err for line in header["warnings"])
    # the report has the place as an event, and does not call it corrected
    history = history_of(table, Clock(table, 2.0), read_header(table).seams)
    assert history.corrections == ()
    events = reasons(table, history, "x", 0, 91)
    assert any(kind == "seam" for frame in key_frames(history, events, 0, 91) for kind, *_ in events[frame])
    page = make_report(out).html.decode()
    assert "Two chunks differ" in page
    assert "--split 24f" in page
    with open_source(out / "annotated.mp4") as source:
        assert sum(1 for _ in source) == 92


def test_a_chunk_that_fails_does_not_stop_the_others(facetrack, clips, monkeypatch):
    run = batch.run

    def breaking(job, *others):
        if job.out.name == "00001":
            raise FacetrackError("a fuse blew")
        return run(job, *others)

    command = ("run", "IN/slow.mp4", *SPLIT, "--stop", "68", "--no-video", "-o", "out")
    with monkeypatch.context() as patch:
        patch.setattr(batch, "run", breaking)
        code, _, err = facetrack(*command)
    assert code == 5 and "chunks/00001: " in err
    assert not header_of(Path("out"))["complete"] and header_of(Path("out"))["frames_tracked"] < 68
    code, _, err = facetrack(*command, "--retry-failed")
    assert code == 0 and header_of(Path("out"))["frames_tracked"] == 68, err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--split", "m"), "is no length"),
        (("--split", "8s"), "overlap by 5 s; give --split 10s or more"),
        ((*SPLIT, "--smooth"), "--smooth goes over the whole clip"),
        ((*SPLIT, "-o", "-"), "name one with --out"),
        ((*SPLIT, "IN/dark.mp4"), "--split cuts one clip"),
        ((*SPLIT, "--overwrite", "--shard", "1/2"), "remove the folder before them"),
        ((*SPLIT[4:], "--config", "contour", "--box", "110,80,90,90"), "which no detector finds again"),
        (("--split", "20s", "--init", "IN/corrected.yaml", "--config", "factorized"), "has corrections, which --split"),
        (("--split", "20s", "--init", "IN/two.yaml", "--config", "factorized"), "has 2 targets, and the search takes"),
    ],
)
def test_what_cannot_be_split_is_refused_in_a_line(facetrack, clips, options, said):
    code, _, err = facetrack("run", "IN/slow.mp4", *options, *(() if "-o" in options else ("-o", "out")))
    assert code == 2
    assert said in err.replace("\n", " ")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_search_that_is_stopped_has_not_failed(facetrack, clips, monkeypatch):
    def stopped(job, *others, **more):
        os.kill(os.getpid(), signal.SIGTERM)
        raise InputError("no face found")

    monkeypatch.setattr(Job, "find", stopped)
    code, _, err = facetrack("run", "IN/slow.mp4", *SPLIT, "--stop", "24", "--no-video", "-o", "out")
    assert code == 143 and "terminated before the first frame" in err and "no face" not in err
    assert not Path("out/run.json").exists()


@given(st.integers(0, 200), st.integers(1, 3000), st.floats(5, 60), st.floats(10, 60))
def test_chunks_cover_all_frames_and_overlap(first, count, fps, length):
    chunks = cut_by_length(first, first + count, fps, Split(length, False))
    assert chunks[0][0] == first and chunks[-1][1] == first + count
    for (begin, stop), (after, _) in itertools.pairwise(chunks):
        assert begin < after < stop == after + round(OVERLAP_S * fps)
        assert after - begin == round(length * fps)


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


def mouth(*corners):
    return joined([one_part("face", str(i), [0], x=[x], y=[y]) for i, (x, y) in enumerate(corners)])


BLIND, SAME = face(0, 9, nose=(np.nan, np.nan)), {"face": "face"}


@pytest.mark.parametrize(
    ("ours", "theirs", "agree"),
    [
        # boxes overlap by half
        (box("a", 0, 9), box("a", 5, 12), [True] * 4),
        (box("a", 0, 9), box("a", 5, 12, x=56.5), [True] * 4),  # 13.5 of 26.5
        (box("a", 0, 9), box("a", 5, 12, x=57), [False] * 4),  # 13 of 27
        (box("a", 0, 9), box("a", 9, 12), []),
        # so do those around the windows of points, or around points
        (face(0, 9), face(3, 12, 9.6), [True] * 6),
        (face(0, 9), face(3, 12, -9.6), [True] * 6),
        (face(0, 9), face(3, 12, 9.7), [False] * 6),
        (mouth((40.0, 40.0), (64.0, 40.0)), mouth((48.0, 40.0), (72.0, 40.0)), [True]),
        (mouth((40.0, 40.0), (64.0, 40.0)), mouth((49.0, 40.0), (73.0, 40.0)), [False]),
        # what one of them alone shows differs, and what none shows does not count
        (BLIND, face(0, 9), [False] * 9),
        (BLIND, BLIND, [True] * 9),
        (box("a", 0, 9, x=np.nan), box("a", 0, 9), [False] * 9),
        (box("a", 0, 9, x=np.nan), box("a", 0, 9, x=np.nan), []),
    ],
)
def test_where_two_tracks_agree(ours, theirs, agree):
    assert agreeing(ours, theirs).tolist() == agree


@pytest.mark.parametrize(
    ("everyone", "whole", "ended", "complete"),
    [
        (False, True, {}, True),
        (False, False, {}, False),  # its clip is damaged
        (False, True, {"stopped": "interrupted"}, False),
        (False, True, {"error": "a full disk"}, False),
        (True, True, {"files": {}, "error": "a fuse blew"}, False),  # and no gap tells it
    ],
)
def test_a_clip_is_complete_where_each_of_its_chunks_is(everyone, whole, ended, complete, monkeypatch, tmp_path):
    good = Manifest(frames=60, files={"trajectory.json": None})
    runs = [good, replace(good, **ended)]
    tables = [replace(face(40 * i, 60 + 40 * i), header={"complete": whole or not i}) for i in (0, 1)]
    for i in (0, 1):
        (tmp_path / f"chunks/0000{i}").mkdir(parents=True)
        (tmp_path / f"chunks/0000{i}/trajectory.json").write_text('{"frame":')
    monkeypatch.setattr(split, "read_manifest", lambda folder: runs[int(folder.name)])
    monkeypatch.setattr(split, "read_run", lambda path: tables[int(path.parent.name)])
    job = SimpleNamespace(out=tmp_path, clip=Path("x.mp4"), faces="one", recipe=SimpleNamespace(followed=()))
    survey = split._survey(SimpleNamespace(job=job, everyone=everyone), 0, [(0, 60), (40, None)])
    assert survey.complete is complete and not survey.warnings and len(survey.failed) == bool(ended)


@pytest.mark.parametrize(("status", "begins"), [("tracked", "init"), ("lost", "lost")])
def test_who_begins_at_a_seam_is_marked_where_seen(status, begins, monkeypatch):
    table = joined([box("a", 0, 9, status=status), box("b", 0, 9)])
    monkeypatch.setattr(split, "read_run", lambda path: table)
    rows = split._Part(Path("x"), 3, 6, {"a": "c", "b": "b"}, frozenset({"c"})).rows()
    assert rows.frames.tolist() == [3, 4, 5] and rows.targets == ("c", "b")
    assert rows.find("c", "box").status.tolist() == [begins, status, status]
    assert set(rows.find("b", "box").status) == {"tracked"}


def test_chunks_meet_in_the_middle_of_the_frames_that_both_have():
    assert stitch(face(10, 20), face(14, 40), {"face"}, matched=False) == (Seam(17, 1.0, True), SAME, frozenset())
    assert stitch(face(10, 20), face(14, 40, dx=30.0), {"face"}, matched=False)[:2] == (Seam(17, 0.0, False), SAME)
    assert stitch(face(10, 20), face(25, 40), {"face"}, matched=False)[0] == Seam(25, None, False)
    for wrong, agrees in ((2, True), (3, False)):  # most of the frames must agree
        later = joined([box("face", 10, 10 + wrong, x=99.0), box("face", 10 + wrong, 20)])
        seam, *_ = stitch(box("face", 0, 20), later, {"face"}, matched=False)
        assert seam == Seam(15, 1 - wrong / 10, agrees)


def test_faces_take_the_names_of_those_they_agree_with():
    earlier = joined([box("face", 0, 20, x=50), box("face_2", 0, 20, x=150)])
    later = joined([box("face", 10, 30, x=151), box("face_2", 10, 30, x=51), box("face_3", 10, 30, x=250)])
    seam, names, begun = stitch(earlier, later, {"face", "face_2", "face_3"}, matched=True)
    # somebody else was called face_3 before
    assert names == {"face": "face_2", "face_2": "face", "face_3": "face_4"}
    assert seam.agrees and begun == {"face_4"}
    assert [part.x[0] for part in renamed(later, names).of_target("face")] == [51]
    # one who was lost all the while may have left, one who was not may not
    gone, one = joined([box("face", 0, 20), box("face_2", 0, 20, x=150, status="lost")]), box("face", 10, 30)
    assert stitch(gone, one, {"face", "face_2"}, matched=True)[0].agrees
    assert not stitch(earlier, one, {"face", "face_2"}, matched=True)[0].agrees
    # and after a gap nobody is known again
    assert stitch(earlier, box("face", 40, 50), {"face", "face_2"}, matched=True)[1] == {"face": "face_3"}
