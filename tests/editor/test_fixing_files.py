"""The files of a run that is put right: what they hold where, and that nothing but the rows changes."""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import FileSink
from facetrack_cli.core.types import Correction, Frame, PartResult, Result, TargetResult, Told
from facetrack_cli.editor.files.rows import Rows, recorded
from facetrack_cli.editor.files.run_index import STATUS, UNKNOWN
from facetrack_cli.editor.files.run_reader import read_index
from facetrack_cli.editor.files.tracks import Recorder, Store
from facetrack_cli.editor.overview import doubtful, overview
from facetrack_cli.trajectory.writers import FORMATS, WRITERS, Footer

PARTS = {"anna": ("nose", "lip"), "ben": ("box",)}
FIRST, FRAMES = 3, 24
WHO = ("", 'Zoë, "the\nsecond"', "Bo")  # what must be quoted, takes several bytes, and breaks lines
_STILL = np.zeros((1, 1, 3), np.uint8)


def result(target, frame, seed):
    """What a tracker might say; the same for the same seed."""
    rng = np.random.default_rng([frame, seed, len(target)])
    parts = []
    for name in PARTS[target]:
        status = STATUS[rng.integers(4)]
        gone = status == "absent"
        x, y, w, h = (float("nan") if gone else float(v) for v in rng.uniform(-5, 2000, 4))
        sure = None if gone or target == "ben" else float(rng.random())
        cov = None if gone or rng.random() < 0.2 else (float(rng.random()), 0.0, 2.0)
        parts.append(PartResult(name, x, y, w, h, status, sure, cov, by_hand=bool(rng.random() < 0.1)))
    told = Told(scale=1.5, posterior={"Zoë": 0.25, "Bo": 0.75}, entropy=0.1) if target == "ben" else None
    who = WHO[rng.integers(3)] if target == "ben" else ""
    return TargetResult(
        target, tuple(parts), None if rng.random() < 0.3 else 50, np.empty((0, 1, 2)), who or None, told=told
    )


def write(folder, seeds, corrections=(), forms=FORMATS):
    """The files of a run; `seeds(target, frame)` says which results are its."""
    lost = {}
    init = {"from": "ünit.yaml", "frame": FIRST, "targets": {t: {"points": {}} for t in PARTS}}
    if corrections:
        init["corrections"] = list(corrections)
    header = {"source": {"path": "c.mp4", "size": [9, 9], "fps": 25.0}, "recipe": {"init": 1}, "seed": 0, "init": init}
    writers = [WRITERS[form](FileSink(folder / f"trajectory.{form}"), header) for form in forms]
    for frame in range(FIRST, FIRST + FRAMES):
        found = tuple(result(target, frame, seeds(target, frame)) for target in PARTS)
        for writer in writers:
            writer.write(Result(Frame(frame, frame / 25, _STILL), found))
        for one in found:
            for part in one.parts:
                if part.status == "lost":
                    lost[f"{one.name}/{part.name}"] = lost.get(f"{one.name}/{part.name}", 0) + 1
    for writer in writers:
        writer.close(Footer(True, None, ('wärning: "lost_frames"',), lost, False))
    return {form: folder / f"trajectory.{form}" for form in forms}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return write(folder, lambda target, frame: 0)


def pieces_of():
    """Where some targets were tracked anew, by whom: (target, first frame, seed), the last of which wins."""
    return st.lists(
        st.tuples(st.sampled_from(list(PARTS)), st.integers(FIRST + 1, FIRST + FRAMES - 1), st.integers(1, 9)),
        max_size=6,
        unique_by=lambda one: one[:2],
    )


@given(pieces_of(), st.sampled_from([FORMATS, ("json",), ("jsonl",), ("csv", "jsonl")]))
@settings(max_examples=25, deadline=None)
def test_what_is_spliced_is_what_a_run_would_have_written(pieces, forms):
    """Every byte, with as many pieces as there may be; so what is beside them is as it was."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        files = write(Path(one), lambda target, frame: 0, forms=forms)
        index, store = read_index(files), Store()
        begins = {name: [None] for name in PARTS}
        tracks = recorded(index, begins)
        for target, first, seed in sorted(pieces, key=lambda one: one[1]):
            recorder = Recorder(store, target, Correction(first, target), first)
            for frame in range(first, FIRST + FRAMES):
                recorder.add(Frame(frame, frame / 25, _STILL), result(target, frame, seed))
            tracks[target].append(recorder.track())
        rows = Rows(index, tracks)

        def seeds(target, frame):
            return max(((f, s) for t, f, s in pieces if t == target and f <= frame), default=(0, 0))[1]

        corrections = [{"frame": f, "target": t} for t, f, _ in pieces]
        expected = write(Path(other), seeds, corrections, forms)
        init = {**index.header["init"], **({"corrections": corrections} if corrections else {})}
        for book in index.books:
            out = Path(one) / "new"
            with out.open("wb") as file:
                rows.write(book, file, init)
            assert out.read_bytes() == expected[book.form].read_bytes()
        again = read_index(expected)
        np.testing.assert_array_equal(rows.status, again.status)
        np.testing.assert_array_equal(rows.confidence, again.confidence)
        assert rows.lost_frames() == again.footer["lost_frames"]
        for frame in (FIRST, FIRST + 11, FIRST + FRAMES - 1):
            assert rows.targets(frame) == Rows(again, recorded(again, begins)).targets(frame)
        store.close()
        index.close()
        again.close()


def test_the_index_tells_of_the_run(run):
    index = read_index(run)
    assert (index.first, index.last, len(index)) == (FIRST, FIRST + FRAMES - 1, FRAMES)
    assert dict(index.parts) == PARTS and index.main.form == "json"
    assert index.columns("ben") == slice(2, 3) and index.time_of(5) == 0.32
    assert set(index.confidence[:, 2].tolist()) == {UNKNOWN}
    assert index.header["init"]["from"] == "ünit.yaml" and index.footer["complete"] is True
    for row in (0, 7, FRAMES - 1):
        texts = {book.form: [book.text(row, k) for k in range(2)] for book in index.books}
        assert texts["json"] == texts["jsonl"]
        assert json.loads(texts["json"][1])["target"] == "ben"
        assert texts["csv"][0].startswith(f"{FIRST + row},".encode()) and texts["csv"][0].count(b"anna") == 2
    index.close()


@pytest.mark.parametrize(
    ("form", "change", "said"),
    [
        (
            "csv",
            lambda s: s.replace("\n7,", "\n7,0", 1),
            "differs from trajectory.json in frame 7; remove the one that is wrong",
        ),
        ("csv", lambda s: s[: s.index("\n26,")] + "\n", "trajectory.csv:"),
        ("csv", lambda s: s + "27,1,anna,nose,1,1\n", "goes on after the last frame of trajectory.json"),
        ("csv", lambda s: s.replace("frame,time_s", "frame,time", 1), "has other columns"),
        (
            "jsonl",
            lambda s: s.replace('"frame":9,', '"frame":8,'),
            "trajectory.jsonl:8: differs from trajectory.json in",
        ),
        ("json", lambda s: s.replace('{"frame":9,', '{"frame":10,'), "frame 10 follows frame 8"),
        ("json", lambda s: s[: len(s) // 2], "ends before the run does, was it cut short?"),
        ("json", lambda s: s.replace('"target":"ben"', '"target":"bea"', 2), "has not the same targets"),
        ("json", lambda s: json.dumps(json.loads(s), indent=1), "is not as facetrack run writes it"),
        ("json", lambda s: s.replace('"status":"lost"', '"status":"gone"', 1), "is not as facetrack run writes it"),
        ("json", lambda s: s.replace('"lost_frames"', '"lost"'), "is not as facetrack run writes it"),
    ],
)
def test_files_that_are_not_a_whole_run_are_refused_with_their_line(run, tmp_path, form, change, said):
    files = {name: tmp_path / f"trajectory.{name}" for name in dict.fromkeys(("json", form))}
    for name, path in files.items():
        shutil.copy(run[name], path)
    text = files[form].read_text(encoding="utf-8")
    changed = change(text)
    assert changed != text
    files[form].write_text(changed, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_index(files)
    line = str(refused.value)
    assert said in line and line.startswith(f"{files[form]}") and "\n" not in line


def test_the_overview_tells_where_a_run_is_least_certain(tmp_path):
    sure = [0.9, 0.9, 0.4, 0.2, 0.9, 0.6, 0.1, None, 0.1, 0.3]
    status = ["init", *["tracked"] * 4, "lost", "tracked", "absent", "tracked", "tracked"]
    header = {"init": {}, "source": {}}
    writer = WRITERS["json"](FileSink(tmp_path / "t.json"), header)
    for frame, (one, how) in enumerate(zip(sure, status, strict=True)):
        parts = PartResult("box", 1, 1, 1, 1, how, one), PartResult("odd", 1, 1, 1, 1, "tracked")
        writer.write(Result(Frame(frame + 5, 0.0, _STILL), (TargetResult("a", parts, 1, np.empty((0, 2, 2))),)))
    writer.close(Footer())
    index = read_index({"json": tmp_path / "t.json"})
    rows = Rows(index, recorded(index, {"a": [None]}))
    found = overview(rows, 5, (Correction(8, "a", absent=True),))
    assert (found["first"], found["last"], found["bins"]) == (5, 14, 5)
    first, second = found["parts"]
    assert first["least"] == [0.9, 0.2, 0.6, 0.1, 0.1] and second["least"] == [None] * 5
    assert first["lost"] == [0, 0, 0.5, 0, 0] and first["absent"] == [0, 0, 0, 0.5, 0]
    assert found["corrections"] == [{"frame": 8, "target": "a", "parts": [], "absent": True}]
    # frames 2 and 3, 5 and 6 (lost, then doubtful), and the last two, of which the last begins no other
    told = [(one["frame"], one["confidence"], one["status"]) for one in found["doubtful"]]
    assert told == [(11, 0.1, "tracked"), (13, 0.1, "tracked"), (8, 0.2, "tracked")]
    assert {one["part"] for one in found["doubtful"]} == {"box"}
    assert [one["frame"] for one in doubtful(rows, 0.15)] == [11, 13]
    assert overview(rows, 999)["bins"] == 10
    index.close()
