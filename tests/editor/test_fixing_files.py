"""A run that is corrected: saves that are interrupted, and one track of a film, which takes its place there."""

import contextlib
import errno
import json
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import Correction
from facetrack_cli.editor import fixer as saving
from facetrack_cli.editor.fixer import fixing, keep, open_track, save
from facetrack_cli.editor.import_annotations import imported_corrections
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.lease import NOTE, FolderLease
from facetrack_cli.run_folder.manifest import read_run
from facetrack_cli.runs import finished
from facetrack_cli.runs.finished import open_run, read_files, recipe_of
from facetrack_cli.runs.people import people_in, recast
from facetrack_cli.trackers.face.target import FaceTarget
from facetrack_cli.trajectory import people as changes
from facetrack_cli.trajectory.reader import CORRECTED, UNSAVED
from tests.support.damage import raising
from tests.support.film_run import film_run
from tests.support.leases import abandon
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"
NOSE = Correction(4, "face", points={"nose": (158, 140)})


class Killed(BaseException):
    """Nothing is done after it."""


def put(folder):
    with fixing(open_run(folder)) as (fixer, _):
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

    with fixing(open_run(out)) as (fixer, _), monkeypatch.context() as patch:
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
    before, whole = files_of(out), finished.write_rows
    full = raising(OSError(errno.ENOSPC, "No space left on device"))

    def write(form, *args, **options):
        whole(form, *args, **options)
        if name == f"trajectory.{form}":
            full()

    with fixing(open_run(out)) as (fixer, _), monkeypatch.context() as patch:
        fixer.put([NOSE])
        broken = {CORRECTED: (saving, "as_yaml", full), "annotated.mp4": (finished, "repaint", full)}
        patch.setattr(*broken.get(name, (finished, "write_rows", write)))
        with pytest.raises(OutputError, match=r"the disk is full .* or make it writable, and save again"):
            save(fixer)
        assert files_of(out) == before and fixer.changed
        patch.undo()
        save(fixer)
    assert files_of(out).keys() == before.keys() | {CORRECTED}


def test_what_is_in_the_way_of_a_save_is_refused_before_anything_is_replaced(out, monkeypatch):
    before = files_of(out)
    (out / CORRECTED).mkdir()
    with pytest.raises(OutputError, match=r"corrected.init.yaml: is a folder, where a file is to be"):
        put(out)
    (out / CORRECTED).rmdir()
    (out / CORRECTED).symlink_to(out / "trajectory.csv")
    with pytest.raises(OutputError, match=r"corrected.init.yaml: is a link, and what it leads to is not replaced"):
        put(out)
    (out / CORRECTED).unlink()
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
    older = f"{out}: older than the track: report.html, trajectory.mot.txt; make them anew with --overwrite"
    assert put(out)[-1] == older
    with fixing(open_run(out)) as (fixer, _):
        fixer.remove(4, "face")
        save(fixer)
    after = files_of(out, "report.html", "trajectory.mot.txt")
    assert b"corrections" not in after.pop(CORRECTED)
    # the video is painted anew from the rows, which have three decimals
    assert all(files.pop("annotated.mp4") for files in (before, after))
    runs = [json.loads(files.pop("run.json")) for files in (before, after)]
    assert all(run["files"].pop("annotated.mp4") for run in runs)
    assert after == before and runs[0] == runs[1]


def test_every_recipe_is_read_back_from_the_header_as_it_was(tmp_path):
    def text(recipe):  # with the names of files, wherever these are
        return re.sub(r'"[^"]*/([^"/]+[.](npz|json))"', r'"\1"', json.dumps(to_dict(recipe)))

    for path in shipped_recipes():
        wanted = load_recipe(path.stem)
        header = json.loads(json.dumps({"name": path.stem, **to_dict(wanted)}))
        found = recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
        assert (found.name, text(found)) == (path.stem, text(wanted))


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
        (lambda j: j["init"].update(corrections=[{"frame": 5}]), "init.corrections.0.target is not as facetrack run"),
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


@pytest.mark.parametrize(("form", "change", "said"), [
    ("csv", lambda s: s.replace("\n7,", "\n7,0", 1), None),
    ("jsonl", lambda s: s + "\n", None),
    ("json", lambda s: s[: len(s) // 2], r":\d+: .*was the run cut short"),
    ("json", lambda s: s.replace('"x":', '"x":0', 1), r":\d+: is not JSON: "),
    ("json", lambda s: json.dumps(json.loads(s), indent=1), None),
])  # fmt: skip
def test_a_file_that_was_edited_is_refused(out, form, change, said):
    """By its checksum; without run.json by what no run writes: nothing else tells an edit then."""
    files = {name: out / f"trajectory.{name}" for name in dict.fromkeys(("json", form))}
    before = files[form].read_text(encoding="utf-8")
    changed = change(before)
    assert changed != before
    files[form].write_text(changed, encoding="utf-8", newline="")
    edited = f"{files[form]}: is not as its run wrote it, as run.json beside it says: it was edited"
    with pytest.raises(InputError, match=f"^{re.escape(edited)}"):
        read_files(files)
    (out / "run.json").unlink()
    with pytest.raises(InputError) if said else contextlib.nullcontext() as refused:
        read_files(files)
    assert said is None or re.match(re.escape(str(files[form])) + said, str(refused.value))


def test_what_is_no_run_and_another_clip_are_refused(out, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="file: is no folder; name the folder of a run"):
        open_run(tmp_path / "file")
    (tmp_path / "trajectory.csv").write_text("x")
    with pytest.raises(InputError, match=r"has no trajectory.json, with recipe and clip"):
        open_run(tmp_path)
    with pytest.raises(InputError, match=r"lamp.mp4: is not the clip .*SHA-256 differs.*; name its clip with --clip"):
        open_run(out, FOLDER / "lamp.mp4")


# --- one track of a film


@pytest.fixture
def film(tmp_path_factory, tmp_path):
    return shutil.copytree(film_run(tmp_path_factory), tmp_path / "film")


def moved(run, rows, frame, by=3.0):
    """The nose of the track's person, moved, with all else where it is."""
    nose = rows.find(run.rows.targets[0], "nose").at(frame)
    place = (round(float(nose.x[0]) + by, 2), round(float(nose.y[0]), 2))
    return Correction(frame, run.rows.targets[0], points={"nose": place})


@pytest.fixture
def fixer(film):
    """The second track of the first person."""
    track = [one for one in people_in(film).tracks if one.person == "person_1"][1]
    run = open_track(film, "person_1", track.first + 3)
    assert (run.first, run.last + 1) == (track.first, track.stop)
    with fixing(run) as (one, _):
        yield one


def test_a_track_is_corrected_and_takes_its_place_in_the_film(film, fixer):
    before, run = read_run(film), fixer.run
    at = run.first + 8
    fixer.put([moved(run, fixer.rows, at)])
    fixer.put([Correction(run.first + 2, "person_1", confirmed=("nose",))])
    lines = save(fixer, video=False)
    assert f"{film / 'trajectory.json'}: written" in lines
    after = read_run(film)
    assert after.names == before.names and len(after) == len(before)
    nose, was = after.find("person_1", "nose"), before.find("person_1", "nose")
    differ = nose.frame[nose.x != was.x]
    assert differ.min() == at and differ.max() <= run.last and len(differ) > 5
    assert nose.frame[nose.by_hand].tolist() == [run.first + 2, at]
    np.testing.assert_array_equal(after.find("person_2", "nose").x, before.find("person_2", "nose").x)
    assert people_in(film).corrections == (f"fix person_1@{run.first}f",)
    assert all((film / one.still).is_file() for one in people_in(film).people)
    assert not (film / UNSAVED).exists()
    assert main(["people", str(film)]) == 0, "all else reads it as before"


def test_what_was_corrected_is_known_again_and_goes_with_its_person(film, fixer):
    first = fixer.run.first
    fixer.put([moved(fixer.run, fixer.rows, first + 8)])
    fixer.put([Correction(first + 12, "person_1", absent=True)])
    fixer.put([Correction(first + 2, "person_1", confirmed=("nose",))])
    said = fixer.corrections
    save(fixer, video=False)
    recast(film, [("rename", lambda tracks: changes.rename(tracks, "person_1", "Eileen"))], video=False)
    again = open_track(film, "Eileen", first)
    told = again.start.corrections
    assert [(one.frame, one.confirmed, one.absent) for one in told] == [
        (one.frame, one.confirmed, one.absent) for one in said
    ]
    assert told[1].points == said[1].points and {one.target for one in told} == {"Eileen"}
    with fixing(again) as (other, _):
        other.remove(first + 12, "Eileen")
        assert not (other.rows.status[other.rows.frame > first + 12] == "absent").any()
        save(other, video=False)
    assert [one.frame for one in open_track(film, "Eileen", first).start.corrections] == [first + 2, first + 8]


def test_what_changed_meanwhile_is_not_written_over_and_a_face_not_found_again_as_somebody_else(
    film, fixer, monkeypatch
):
    seen, real = [], FaceTarget.advance
    monkeypatch.setattr(FaceTarget, "advance", lambda self, *rest: (seen.append(self.alone), real(self, *rest))[1])
    fixer.put([moved(fixer.run, fixer.rows, fixer.run.first + 8)])
    assert seen and not any(seen)
    assert keep(fixer) == film / UNSAVED
    recast(film, [("rename", lambda tracks: changes.rename(tracks, "person_1", "Eileen"))], video=False)
    before = (film / "trajectory.json").read_bytes()
    with pytest.raises(InputError, match="who is who was changed meanwhile"):
        save(fixer)
    assert (film / "trajectory.json").read_bytes() == before


def test_who_is_not_there_is_refused(film, capsys):
    with pytest.raises(InputError, match="person_2 is not seen in frame 3"):
        open_track(film, "person_2", 3)
    assert main(["fix", str(film)]) == 3
    said = capsys.readouterr().err
    assert "--person NAME@TIME of facetrack fix" in said and f"facetrack people {film} --page" in said
    assert main(["fix", str(film), "--person", "person_2"]) == 2
    assert main(["fix", str(film), "--person", "person_2@0:00"]) == 3


def test_the_command_applies_a_file_to_a_track(film, tmp_path, capsys):
    run = open_track(film, "person_1", 0)
    init = tmp_path / "c.yaml"
    init.write_text(f"frame: {run.first}\nperson_1:\n  box: {list(run.start.targets['person_1'].box)}\n"
                    f"corrections:\n- frame: 5\n  person_1:\n    confirmed: [nose]\n")  # fmt: skip
    assert main(["fix", str(film), "--person", "person_1@0:00", "--init", str(init), "--no-video"]) == 0
    nose = read_run(film).find("person_1", "nose")
    assert nose.frame[nose.by_hand].tolist() == [5]
    assert "trajectory.json: written" in capsys.readouterr().err


@pytest.mark.parametrize("export", [[], ["--target", "person_1"]])
def test_the_export_of_a_film_comes_back_to_one_track(film, export, capsys):
    second = [one for one in people_in(film).tracks if one.person == "person_1"][1]
    run, file = open_track(film, "person_1", second.first), film / "trajectory.cvat.xml"
    assert main(["export", str(film), "--to", "cvat", *export]) == 0
    assert main(["export", str(film), "--to", "labelstudio", *export]) == 0
    for name in (file, film / "trajectory.labelstudio.json"):
        assert imported_corrections(name, run, run.rows) == ()
    at, tree = run.first + 5, ET.parse(file)
    for track in tree.iter("track"):
        for shape in track:  # every nose moves, in all shots
            if track.get("label").endswith("/nose") and shape.get("frame") in ("5", "50", str(at)):
                shape.set("points", "100.50,90.50")
    tree.write(file)
    (one,) = imported_corrections(file, run, run.rows)
    assert (one.frame, one.target, dict(one.points)) == (at, "person_1", {"nose": (100.0, 90.0)})
    who = ["--person", f"person_1@{at}f", "--import", str(file), "--no-video"]
    assert main(["fix", str(film), *who]) == 0
    nose = read_run(film).find("person_1", "nose")
    assert nose.frame[nose.by_hand].tolist() == [at]
    file.write_text(file.read_text().replace('label="person_', 'label="nobody_'))
    capsys.readouterr()
    assert main(["fix", str(film), *who]) == 3
    assert "has no track of person_1, but of nobody_1" in capsys.readouterr().err


def test_segments_of_elan_are_taken_of_one_person(film, tmp_path, capsys):
    file = tmp_path / "notes.eaf"
    slots = "".join(f'<TIME_SLOT TIME_SLOT_ID="{time}" TIME_VALUE="{time}"/>' for time in (1000, 1400))
    note = (
        '<ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a" TIME_SLOT_REF1="1000" TIME_SLOT_REF2="1400">'
        "<ANNOTATION_VALUE>absent</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>"
    )
    tier = f'<TIER TIER_ID="absent@person_1" PARTICIPANT="person_1" LINGUISTIC_TYPE_REF="any">{note}</TIER>'
    file.write_text(f'<ANNOTATION_DOCUMENT FORMAT="3.0"><TIME_ORDER>{slots}</TIME_ORDER>{tier}</ANNOTATION_DOCUMENT>')
    assert main(["fix", str(film), "--import", str(file)]) == 0
    assert "segments count with --person NAME@TIME" in capsys.readouterr().err
    assert main(["fix", str(film), "--person", "person_1@0:00", "--import", str(file), "--no-video"]) == 0
    nose = read_run(film).find("person_1", "nose")
    assert nose.frame[nose.status == "absent"].tolist() == [*range(25, 35)]
