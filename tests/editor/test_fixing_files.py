"""The files of a run that is corrected: they hold the same rows, nothing but the rows changes, and a save that is
interrupted leaves the run as it was, or as it was to be.
"""

import contextlib
import errno
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

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import digest
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor import save as saving
from facetrack_cli.editor.history import Fixer, Store, Track
from facetrack_cli.editor.save import keep, save
from facetrack_cli.editor.web.fix_session import doubtful, overview
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.finished import STATUS, check_size, open_run, read_files, recipe_of, write_rows
from facetrack_cli.run_folder.lease import NOTE, FolderLease
from facetrack_cli.run_folder.manifest import NAME, File, Manifest
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from facetrack_cli.trajectory.trajectory import COLUMNS, Collector
from facetrack_cli.trajectory.writers import FORMATS, WRITERS, RunSummary, as_written, summary_of
from facetrack_cli.video.seek import Frames
from tests.support.leases import abandon
from tests.support.results import part, result, target
from tests.support.samples import FOLDER
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


@given(
    st.integers(0, 5),
    # where some targets were tracked again, by whom: (target, first frame, seed), the last of which wins
    st.lists(
        st.tuples(st.sampled_from(list(PARTS)), st.integers(FIRST + 1, FIRST + FRAMES - 1), st.integers(1, 9)),
        max_size=6,
        unique_by=lambda one: one[:2],
    ),
    st.sampled_from([FORMATS, ("json",), ("jsonl",), ("csv", "jsonl")]),
)
@settings(max_examples=settings().max_examples // 5)
def test_what_is_spliced_is_what_a_run_would_have_written(seed, pieces, forms):
    """Every byte, with as many pieces as there may be; so what is beside them is as it was."""
    with contextlib.ExitStack() as stack:
        one, other = (stack.enter_context(tempfile.TemporaryDirectory()) for _ in range(2))
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
    found = overview(rows, 5, (Correction(8, "a", absent=True),), {"a": 0.5})
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
    assert overview(rows, 999, (), {"a": 0.5})["bins"] == 10
    json.dumps(found)


# --- a save that is interrupted, or refused --------------------------------------------------------------------------

CLIP = FOLDER / "expressions.mp4"
NOSE = Correction(4, "face", TargetStart(points={"nose": (158, 140)}))


class Killed(BaseException):
    """Nothing is done after it."""


@contextlib.contextmanager
def fixing(folder):
    opened = open_run(folder)
    with Frames(opened.clip) as frames, contextlib.closing(Fixer(opened, frames.read)) as fixer:
        yield fixer


def put(folder):
    with fixing(folder) as fixer:
        fixer.put([NOSE])
        return save(fixer)


def files_of(folder, *left_out):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in left_out}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a run, and its files once they are corrected, without the video."""
    folder = tmp_path_factory.mktemp("made")
    few = ["--set", "filter.particles=20", "--stop", "8", "-q", "--format", "csv,json,jsonl"]
    assert main(["run", str(CLIP), "--config", "factorized", "-o", str(folder / "out"), *few]) == 0
    put(shutil.copytree(folder / "out", folder / "after"))
    return folder / "out", files_of(folder / "after", "annotated.mp4")


@pytest.fixture
def out(made, tmp_path):
    return shutil.copytree(made[0], tmp_path / "out")


@pytest.mark.parametrize("moment", [0, 1, 3, 5])
def test_a_save_that_is_killed_is_finished_by_who_opens_the_run_next(made, out, monkeypatch, moment):
    """Before the files are listed in the note of the lock, and at files that take over."""
    before, after, done = files_of(out), made[1], []
    replace = Path.replace

    def kill(*_):
        raise Killed

    def torn(self, to):
        if to.name != NOTE:
            if len(done) == moment - 1:
                raise Killed
            done.append(self)
        return replace(self, to)

    with fixing(out) as fixer, monkeypatch.context() as patch:
        fixer.put([NOSE])
        keep(fixer)
        patch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
        patch.setattr(Path, "replace", torn)
        patch.setattr(FolderLease, "__exit__", lambda lease, *_: abandon(lease))
        if moment == 0:
            patch.setattr(FolderLease, "prepare", kill)
        with pytest.raises(Killed):
            save(fixer)
    whole = moment > 0
    assert [one.frame for one in open_run(out).start.corrections] == ([4] if whole else [])
    assert (out / UNSAVED).exists() != whole
    if not whole:
        assert {name: files_of(out)[name] for name in before} == before
        put(out)
    assert files_of(out, "annotated.mp4") == after


@pytest.mark.parametrize("name", ["trajectory.jsonl", CORRECTED, "annotated.mp4"])
def test_a_save_that_fails_leaves_the_folder_as_it_was(out, monkeypatch, name):
    before, whole = files_of(out), saving.write_rows

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    def write(form, *args, **options):
        whole(form, *args, **options)
        if name == f"trajectory.{form}":
            full()

    with fixing(out) as fixer, monkeypatch.context() as patch:
        fixer.put([NOSE])
        broken = {CORRECTED: ("as_yaml", full), "annotated.mp4": ("repaint", full)}
        patch.setattr(saving, *broken.get(name, ("write_rows", write)))
        with pytest.raises(OutputError, match=r"No space left on device; free some space, and save again"):
            save(fixer)
        assert files_of(out) == before and fixer.changed
        patch.undo()
        save(fixer)
    assert files_of(out).keys() == before.keys() | {CORRECTED}


@pytest.mark.parametrize("name", ["trajectory.csv", "trajectory.json", "annotated.mp4", CORRECTED, "run.json"])
def test_links_in_the_folder_of_a_run_are_refused(out, tmp_path, name):
    kept = tmp_path / "elsewhere"
    kept.write_bytes((out / name).read_bytes() if (out / name).exists() else b"mine")
    (out / name).unlink(missing_ok=True)
    (out / name).symlink_to(kept)
    before = files_of(out)
    with pytest.raises(OutputError, match=f"{name}: is a link, and what it leads to is not replaced"):
        put(out)
    assert files_of(out) == before and (out / name).is_symlink()


def test_what_is_in_the_way_of_a_save_is_refused_before_anything_is_replaced(out, monkeypatch):
    before = files_of(out)
    (out / CORRECTED).mkdir()
    with pytest.raises(OutputError, match=r"corrected.init.yaml: is a folder, where a file is to be"):
        put(out)
    (out / CORRECTED).rmdir()
    assert files_of(out) == before

    def slow(start, clip, real=saving.as_yaml):
        (out / "trajectory.csv").write_text("another run")
        return real(start, clip)

    monkeypatch.setattr(saving, "as_yaml", slow)
    with pytest.raises(OutputError, match=r"trajectory.csv: was written by somebody else since it was opened"):
        put(out)
    assert files_of(out) == {**before, "trajectory.csv": b"another run"}


def test_where_nothing_is_corrected_any_more_the_files_do_not_speak_of_corrections(out):
    before = files_of(out)
    for name in ("report.html", "trajectory.mot.txt"):
        (out / name).write_text("x")
    older = (
        f"{out}: older than the track: report.html, trajectory.mot.txt; make anew: facetrack report {out} --overwrite"
    )
    assert put(out)[-1] == f"{older}, facetrack export --to FORMAT {out} --overwrite"
    with fixing(out) as fixer:
        fixer.remove(4, "face")
        save(fixer)
    after = files_of(out, "report.html", "trajectory.mot.txt")
    assert b"corrections" not in after.pop(CORRECTED)
    # the video is painted anew from the rows, which have three decimals
    assert all(files.pop("annotated.mp4") for files in (before, after))
    runs = [json.loads(files.pop("run.json")) for files in (before, after)]
    assert all(run["files"].pop("annotated.mp4") for run in runs)
    assert after == before and runs[0] == runs[1]


# --- runs as they are opened -----------------------------------------------------------------------------------------


def test_every_recipe_is_read_back_from_the_header_as_it_was(tmp_path):
    for path in shipped_recipes():
        wanted = to_dict(load_recipe(path.stem))
        header = json.loads(json.dumps({"name": path.stem, **wanted}))
        found = recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
        assert found.name == path.stem
        got = to_dict(found)
        both = zip((got, *got.get("targets", {}).values()), (wanted, *wanted.get("targets", {}).values()), strict=True)
        for (mine, theirs), (section, key) in itertools.product(
            both, (("prior", "file"), ("confidence", "calibration"))
        ):
            if (theirs.get(section) or {}).get(key):
                assert Path(mine[section].pop(key)).samefile(path.parent / theirs[section].pop(key))
        assert got == wanted


def test_files_that_a_recipe_names_are_found_again_or_missed_in_one_line(tmp_path):
    shipped = load_recipe("factorized")
    header = {"name": "mine", **to_dict(shipped)}

    def read():
        return recipe_of(tmp_path / "trajectory.json", header, [tmp_path])

    for section, key, name in (("prior", "file", "my.npz"), ("confidence", "calibration", "my.json")):
        header[section][key] = name
        with pytest.raises(InputError, match=rf'its recipe names the file "{name}", which is in none of') as missed:
            read()
        assert "\n" not in str(missed.value)
        shutil.copy(shipped.path.parent / "mouth_prior.npz", tmp_path / name)
        assert getattr(getattr(read(), section), key) == str(tmp_path / name) and header[section][key] == name
    header["filter"]["particles"] = "many"
    with pytest.raises(InputError, match=r"does not know its recipe \(filter"):
        read()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda j: j["source"].update(path="gone.mp4"), "gone.mp4: is not there, and the run in"),
        (lambda j: j["init"].update(frame=1), "its rows begin with frame 0, its start with 1"),
        (lambda j: j["init"]["targets"].update(ben=j["init"]["targets"]["face"]), "its recipe follows face/nose, face"),
        (lambda j: j["init"].update(corrections=[{"frame": 5, "target": "ben"}]), "init.corrections is not as facetr"),
        (lambda j: j["init"].update(corrections=[{"frame": 5}]), "init.corrections.0.target is not as facetrack run"),
        (lambda j: j["init"]["targets"]["face"].pop("points"), "its start and its recipe do not go together"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(made, tmp_path, change, said):
    whole = json.loads((made[0] / "trajectory.json").read_text())
    change(whole)
    frames = "".join(f"\n{json.dumps(one, separators=(',', ':'))}," for one in whole.pop("frames"))
    text = json.dumps(whole)
    (tmp_path / "trajectory.json").write_text(f'{text[:-1]}, "frames":[{frames[:-1]}\n]}}\n')
    with pytest.raises(InputError) as refused:
        open_run(tmp_path)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_what_is_no_run_and_a_clip_of_another_size_are_refused(out, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="file: is a file; name the folder of a run"):
        open_run(tmp_path / "file")
    (tmp_path / "trajectory.csv").write_text("x")
    with pytest.raises(InputError, match=r"has trajectory.csv alone"):
        open_run(tmp_path)
    with pytest.raises(InputError, match="is 64x48, not 320x240 pixels as in the run; name its clip with --clip"):
        check_size(open_run(out), (64, 48))
    with pytest.raises(InputError, match=r"lamp.mp4: is not the clip .*SHA-256 differs.*; name its clip with --clip"):
        open_run(out, FOLDER / "lamp.mp4")
