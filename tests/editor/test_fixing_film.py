"""The points of a film's people are corrected: one track, which takes its place in the film."""

import shutil
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction
from facetrack_cli.editor.fixer import fixing, keep, open_track, save
from facetrack_cli.editor.import_annotations import imported_corrections
from facetrack_cli.run_folder.manifest import read_run
from facetrack_cli.runs.people import people_in, recast
from facetrack_cli.trackers.face.target import FaceTarget
from facetrack_cli.trajectory import people as changes
from facetrack_cli.trajectory.reader import UNSAVED
from tests.support.film_run import film_run


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
