"""The files of a run that is corrected: they hold the same rows, and nothing but the rows changes."""

import contextlib
import itertools
import json
import re
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import digest
from facetrack_cli.core.types import Correction
from facetrack_cli.editor.history import Store, Track
from facetrack_cli.editor.web.fix_session import doubtful, overview
from facetrack_cli.run_folder.finished import STATUS, read_files, write_rows
from facetrack_cli.run_folder.manifest import NAME, File, Manifest
from facetrack_cli.trajectory.trajectory import COLUMNS, Collector
from facetrack_cli.trajectory.writers import FORMATS, WRITERS, RunSummary, as_written, summary_of
from tests.support.results import part, result, target
from tests.support.sinks import Alone

PARTS = {"anna": ("nose", "lip"), "ben": ("box",)}
FIRST, FRAMES = 3, 24
WHO = ("", 'Zoë, "the\nsecond"', "Bo")  # what must be quoted, takes several bytes, and breaks lines


def said(name, frame, seed):
    """What a tracker might say of a target; the same for the same seed."""
    rng = np.random.default_rng([frame, seed, len(name)])
    parts = []
    for one in PARTS[name]:
        status = STATUS[rng.integers(4)]
        gone = status == "absent"
        x, y, w, h = (float("nan") if gone else float(v) for v in rng.uniform((-5, -5, 0, 0), 2000))
        sure = None if gone or name == "ben" else float(rng.random())
        cov = None if gone or rng.random() < 0.2 else (float(rng.random()), 0.5, 2.0)
        parts.append(part(one, x, y, w, h, status, sure, cov, by_hand=bool(rng.random() < 0.1)))
    who = WHO[rng.integers(3)] if name == "ben" else ""
    return target(
        name, parts, None if rng.random() < 0.3 else 50, identity=who or None, reported=reported(rng, name, seed)
    )


def reported(rng, name, seed):
    """The diagnostics of a target: in some tracks of fewer kinds, and in some frames of none."""
    if name != "ben" or rng.random() < 0.2:
        return None
    known = {"scale": float(rng.uniform(0.5, 2)), "posterior": {"Zoë": 0.25, "Bo": 0.75}, "entropy": 0.1}
    if seed % 2:
        known |= {
            "affine": rng.uniform(-50, 50, 6).tolist(),
            "error": 0.12345,
            "posterior": {"Ida": float(rng.random())},
        }
    return known if seed % 3 else {"scale": known["scale"]}


def write(folder, seeds, corrections=(), forms=FORMATS):
    """The files of a run; `seeds(target, frame)` says which results are its."""
    lost = {}
    init = {"from": "ünit.yaml", "frame": FIRST, "targets": {t: {"points": {}} for t in PARTS}}
    if corrections:
        init["corrections"] = list(corrections)
    header = {"source": {"path": "c.mp4", "size": [9, 9], "fps": 25.0}, "recipe": {"init": 1}, "seed": 0, "init": init}
    writers = [WRITERS[form](Alone(folder / f"trajectory.{form}"), header) for form in forms]
    for frame in range(FIRST, FIRST + FRAMES):
        found = result(frame, [said(name, frame, seeds(name, frame)) for name in PARTS])
        for writer in writers:
            writer.write(found.rows)
        for one in found.rows.parts:
            if one.status[0] == "lost":
                lost[one.name] = lost.get(one.name, 0) + 1
    for writer in writers:
        writer.close(RunSummary(warnings=('wärning: "lost_frames"',), lost_frames=lost, variable_fps=False))
    return {form: folder / f"trajectory.{form}" for form in forms}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return write(folder, lambda target, frame: 0)


def pieces_of():
    """Where some targets were tracked again, by whom: (target, first frame, seed), the last of which wins."""
    return st.lists(
        st.tuples(st.sampled_from(list(PARTS)), st.integers(FIRST + 1, FIRST + FRAMES - 1), st.integers(1, 9)),
        max_size=6,
        unique_by=lambda one: one[:2],
    )


@given(
    st.integers(0, 5),
    pieces_of(),
    st.sampled_from([FORMATS, ("json",), ("jsonl",), ("csv", "jsonl")]),
)
@settings(max_examples=settings().max_examples // 5)
def test_what_is_spliced_is_what_a_run_would_have_written(seed, pieces, forms):
    """Every byte, with as many pieces as there may be; so what is beside them is as it was."""
    with (
        tempfile.TemporaryDirectory() as one,
        tempfile.TemporaryDirectory() as other,
        contextlib.ExitStack() as stack,
    ):
        files = write(Path(one), lambda target, frame: seed, forms=forms)
        store = stack.enter_context(contextlib.closing(Store(read_files(files))))
        tracks = {name: [Track(name, None, FIRST, FIRST + FRAMES)] for name in PARTS}
        for name, first, number in sorted(pieces, key=lambda one: one[1]):
            collected = Collector()
            for frame in range(first, FIRST + FRAMES):
                collected.add(result(frame, [said(name, frame, number)]).rows)
            at = store.add(as_written(collected.trajectory()))
            tracks[name].append(Track(name, Correction(first, name, absent=True), first, FIRST + FRAMES, at))
        rows = store.spliced(tracks)

        def seeds(target, frame):
            return max(((f, s) for t, f, s in pieces if t == target and f <= frame), default=(0, seed))[1]

        made = [Correction(f, t, absent=True) for t, f, _ in pieces]
        expected = write(Path(other), seeds, [{"frame": f, "target": t, "absent": True} for t, f, _ in pieces], forms)
        for form in forms:
            written = bytearray()
            write_rows(form, written.extend, rows, made)
            assert written == expected[form].read_bytes()
        again = read_files(expected)
        assert rows.names == again.names
        for name in (*COLUMNS[:2], *COLUMNS[4:], "by_hand"):
            np.testing.assert_array_equal(getattr(rows, name), getattr(again, name))
        assert list(summary_of(rows).lost_frames.items()) == list(again.header["lost_frames"].items())
        for name, found in again.diagnostics.items():
            ours = rows.diagnostics[name]
            assert [_known(each) for each in ours.records()] == [_known(each) for each in found.records()]
            assert ours.frame.tolist() == found.frame.tolist()


def _known(record):
    """What is not nan of what was reported in a frame."""
    lists = {name: {k: v for k, v in value.items() if v == v} if isinstance(value, dict) else value
             for name, value in record.items()}  # fmt: skip
    return {name: value for name, value in lists.items() if value != {} and not np.isnan(_numbers(value)).any()}


def _numbers(value):
    return np.array(list(value.values()) if isinstance(value, dict) else value, float)


def test_the_rows_tell_of_the_run(run):
    rows = read_files(run)
    assert (rows.frames[0], rows.frames[-1], len(rows.frames)) == (FIRST, FIRST + FRAMES - 1, FRAMES)
    assert {name: tuple(one.part for one in rows.of_target(name)) for name in rows.targets} == PARTS
    assert rows.path == run["json"] and rows.find("anna", "lip").time_s[5] == 0.32
    assert np.isnan(rows.find("ben", "box").confidence).all()
    assert rows.header["init"]["from"] == "ünit.yaml" and rows.header["complete"] is True
    for forms in itertools.combinations(FORMATS, 2):
        if forms[0] != "csv":
            assert json.dumps(read_files({form: run[form] for form in forms}).header) == json.dumps(rows.header)
    alone = read_files({form: run[form] for form in ("csv", "jsonl")})
    assert {**alone.header, "type": None} == {**rows.header, "type": None} and alone.path == run["jsonl"]


NOT_OURS = ": is not as facetrack run writes it, was it edited?"
EDITED = ": is not as its run wrote it, as run.json beside it says: it was edited"
CHANGES = [
    ("csv", lambda s: s.replace("\n7,", "\n7,0", 1), None),
    ("csv", lambda s: s[: s.index("\n26,")] + "\n", None),
    ("csv", lambda s: s.replace("frame,time_s", "frame,time", 1), None),
    ("csv", lambda s: s + "27,1,anna,nose,1,1\n", None),
    ("jsonl", lambda s: s.replace('"frame":9,', '"frame":8,'), None),
    ("jsonl", lambda s: s + "\n", None),
    ("json", lambda s: re.sub(r'{"frame":9,.*\n', "", s), ": frame 10 follows frame 8"),
    ("json", lambda s: s[: len(s) // 2], r":\d+: .*was the run cut short"),
    ("json", lambda s: s.replace('"target":"ben"', '"target":"bea"', 2), ": frame 5 has no row of bea/box"),
    ("json", lambda s: s.replace('"part":"lip"', '"part":"lap"', 1), ": frame 4 has no row of anna/lap"),
    ("json", lambda s: s.replace('"x":', '"x": ', 1), None),
    ("json", lambda s: s.replace('"x":', '"x":0', 1), r":\d+: is not JSON: "),
    ("json", lambda s: re.sub(r'("x":\d+\.\d\d)(\d)', r"\g<1>\g<2>0", s, count=1), None),
    ("json", lambda s: s.replace('"status":"lost"', '"status":"gone"', 1), NOT_OURS),
    ("json", lambda s: s.replace("\n", "\r\n"), None),
    ("json", lambda s: json.dumps(json.loads(s), indent=1), None),
    ("json", lambda s: s.replace('"lost_frames"', '"lost"'), NOT_OURS),
    ("json", lambda s: s.replace('\n"init":', '\n"begins":'), NOT_OURS),
]


@pytest.mark.parametrize(("form", "change", "said"), CHANGES)
def test_a_file_that_was_edited_is_refused(run, tmp_path, form, change, said):
    """By its checksum; without run.json by what no run writes: nothing else tells an edit then."""
    files = {name: tmp_path / f"trajectory.{name}" for name in dict.fromkeys(("json", form))}
    for name, path in files.items():
        shutil.copy(run[name], path)
    known = Manifest(files={path.name: File(path.stat().st_size, digest([path])) for path in files.values()})
    (tmp_path / NAME).write_text(json.dumps(known.record()))
    before = files[form].read_text(encoding="utf-8")
    changed = change(before)
    assert changed != before
    files[form].write_text(changed, encoding="utf-8", newline="")
    with pytest.raises(InputError, match=f"^{re.escape(str(files[form]) + EDITED)}"):
        read_files(files)
    (tmp_path / NAME).unlink()
    with pytest.raises(InputError) if said else contextlib.nullcontext() as refused:
        read_files(files)
    assert said is None or re.match(re.escape(str(files[form])) + said, str(refused.value))


def test_the_overview_tells_where_a_run_is_least_certain():
    sure = [0.9, 0.9, 0.4, 0.2, 0.9, 0.6, 0.1, None, 0.1, 0.3]
    status = ["init", *["tracked"] * 4, "lost", "tracked", "absent", "tracked", "tracked"]
    collected = Collector()
    for frame, (one, how) in enumerate(zip(sure, status, strict=True)):
        parts = part("box", 1, 1, 1, 1, how, one), part("odd", 1, 1, 1, 1, "tracked")
        collected.add(result(frame + 5, [target("a", parts, 1)]).rows)
    rows = collected.trajectory()
    found = overview(rows, 5, (Correction(8, "a", absent=True),), lost_below={"a": 0.5})
    assert (found["first"], found["last"], found["bins"]) == (5, 14, 5)
    first, second = found["parts"]
    assert first["least"] == [0.9, 0.2, 0.6, 0.1, 0.1] and second["least"] == [None] * 5
    assert first["lost"] == [0, 0, 0.5, 0, 0] and first["absent"] == [0, 0, 0, 0.5, 0]
    assert found["corrections"] == [{"frame": 8, "target": "a", "parts": [], "absent": True}]
    # frames 2 and 3, 5 and 6 (lost, then doubtful), and the last two, of which the last begins no other
    told = [(one["frame"], one["confidence"], one["status"]) for one in found["doubtful"]]
    assert told == [(11, 0.1, "tracked"), (13, 0.1, "tracked"), (8, 0.2, "tracked")]
    assert {one["part"] for one in found["doubtful"]} == {"box"}
    assert [one["frame"] for one in doubtful(rows, {"a": 0.15})] == [11, 13]
    assert overview(rows, 999, lost_below={"a": 0.5})["bins"] == 10
    json.dumps(found)
