"""A run that is corrected in CVAT, Label Studio or ELAN, and comes back by facetrack fix --import."""

import json
import re
import shutil
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction
from facetrack_cli.editor.import_annotations import imported_corrections, renames
from facetrack_cli.runs.finished import open_run
from facetrack_cli.trajectory.reader import CORRECTED, read_trajectory
from tests.support.samples import FOLDER

FRAMES = 10


def facetrack(*words):
    return main([str(word) for word in words])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folders of runs of points, of a box, and of a face with both, each exported to both tools."""
    folder = tmp_path_factory.mktemp("made")
    few = ["--set", "filter.particles=20", "--stop", FRAMES, "--no-video", "-q", "--format", "csv,json"]
    boxed = ["--config", "histogram", "--box", "115,80,90,110"]
    for name, how in (("points", ["--config", "factorized"]), ("box", boxed), ("face", ["--config", "face"])):
        assert facetrack("run", FOLDER / "expressions.mp4", "-o", folder / name, *how, *few) == 0
        for form in ("cvat", "labelstudio"):
            assert facetrack("export", folder / name, "--to", form) == 0
    return folder


@pytest.fixture
def runs(made, tmp_path):
    return shutil.copytree(made, tmp_path / "runs")


def found(run, file):
    opened = open_run(run)
    return imported_corrections(file, opened, opened.rows)


def in_cvat(run, **change):
    """Attributes of shapes are set: LABEL_FRAME, `__` for a slash."""
    path = run / "trajectory.cvat.xml"
    tree = ET.parse(path)
    shapes = {(track.get("label"), int(one.get("frame"))): one for track in tree.iter("track") for one in track}
    for name, attributes in change.items():
        label, frame = name.rsplit("_", 1)
        for key, value in attributes.items():
            shapes[label.replace("__", "/"), int(frame)].set(key, value)
    tree.write(path)
    return path


def in_label_studio(run, change):
    path = run / "trajectory.labelstudio.json"
    tasks = json.loads(path.read_text())
    regions = [one["value"] for one in tasks[0]["annotations"][0]["result"]]
    change({(one["labels"][0], place["frame"] - 1): place for one in regions for place in one["sequence"]})
    path.write_text(json.dumps(tasks))
    return path


def test_points_that_were_moved_or_hidden_in_cvat(runs):
    hidden = {f"face__mouth_left_{frame}": {"outside": "1"} for frame in (5, 6, 7)}
    interpolated = {"keyframe": "0", "points": "1,1"}  # nobody has put it there
    moved = {"face__nose_3": {"points": "160.50,141.00"}, "face__lip_upper_3": {"points": "150.50,151.00"}}
    file = in_cvat(runs / "points", **moved, **hidden, face__nose_8=interpolated)
    assert found(runs / "points", runs / "points" / "trajectory.labelstudio.json") == ()
    one, two, three = found(runs / "points", file)
    assert one == Correction(3, "face", points={"nose": (160.0, 140.5), "lip_upper": (150.0, 150.5)})
    assert two == Correction(5, "face", absent=("mouth_left",))
    row = read_trajectory(runs / "points").find("face", "mouth_left")
    assert (three.frame, three.absent) == (8, ()) and list(three.points) == ["mouth_left"]
    assert three.points["mouth_left"] == pytest.approx((row.x[8], row.y[8]), abs=0.006)


def test_the_box_of_a_head_that_carries_points_is_moved_and_never_absent_alone(runs):
    left, top, w, h = read_trajectory(runs / "face").find("face", "box").boxes[3]
    far = ET.parse(runs / "face" / "trajectory.cvat.xml").find("track[@label='face']/box[@frame='3']").get("xbr")
    moved = {"face_2": {"outside": "1"}, "face_3": {"xbr": str(float(far) + 8)}}
    (one,) = found(runs / "face", in_cvat(runs / "face", **moved))
    assert one.frame == 3 and one.absent == () and not one.points
    assert one.box == pytest.approx((left, top, w + 8, h), abs=0.011)


def test_parts_that_no_correction_places_are_left_out_by_name(runs, capsys):
    run = runs / "face"
    eye, nose = "face__eye_left_outer", "face__nose"
    file = in_cvat(run, **{f"{eye}_3": {"points": "120.50,120.50"}, f"{nose}_4": {"points": "160.50,141.00"}})
    assert facetrack("fix", run, "--import", file, "--no-video") == 0
    said = capsys.readouterr().err
    assert f"warning: {file}: face/eye_left_outer: no correction places this; left out" in said
    assert "1 correction, in frames 4" in said
    assert facetrack("export", run, "--to", "cvat", "--overwrite") == 0
    before = (run / "trajectory.csv").read_bytes()
    assert facetrack("fix", run, "--import", in_cvat(run, **{f"{eye}_3": {"outside": "1"}})) == 0
    said = capsys.readouterr().err
    assert "face/eye_left_outer: no correction" in said and "is otherwise as the run has it; nothing was" in said
    assert (run / "trajectory.csv").read_bytes() == before


@pytest.mark.parametrize("form", ["cvat", "elan"])
def test_a_whole_face_is_absent_with_the_parts_that_no_correction_places(runs, form):
    run, notes = runs / "face", []
    names = open_run(run).parts["face"]
    if form == "cvat":
        labels = ["face" if part == "box" else f"face__{part}" for part in names]
        file = in_cvat(run, **{f"{label}_{frame}": {"outside": "1"} for label in labels for frame in (5, 6)})
    else:
        file = in_elan(run, ("absent@face", "face", [(200, 280, "absent")]))
    opened = open_run(run)
    eye = (opened.rows.frame == 5) & (opened.rows.which == names.index("eye_left_outer"))
    rows = replace(opened.rows, status=np.where(eye, "lost", opened.rows.status))
    gone, back = imported_corrections(file, opened, rows, notes.append)
    assert gone == Correction(5, "face", absent=True) and back.frame == 7 and not notes
    assert set(back.points) == {"nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower"}
    if form == "elan":
        file = in_elan(run, ("absent@face", "face", [(200, 280, "eye_left_outer")]))
        assert imported_corrections(file, opened, opened.rows, notes.append) == () and len(notes) == 1


def test_boxes_that_were_moved_or_switched_off_in_label_studio(runs):
    def change(places):
        places["face", 2] |= {"x": places["face", 2]["x"] + 5, "auto": True}  # interpolated
        places["face", 4] |= {"x": 25.0, "y": 25.0, "width": 25.0, "height": 50.0}
        for frame in (6, 7, 8, 9):
            places["face", frame]["enabled"] = False

    one, two = found(runs / "box", in_label_studio(runs / "box", change))
    width, height = open_run(runs / "box").header.source.size
    assert one.box == pytest.approx((width / 4, height / 4, width / 4, height / 2))
    assert (one.frame, two) == (4, Correction(6, "face", absent=True))


@pytest.mark.parametrize("form", ["cvat", "labelstudio"])
@pytest.mark.parametrize("unseen", [{"status": "hidden"}, {"x": -20.0}, {}], ids=["hidden", "beyond it", "seen"])
def test_rows_that_nobody_touched_come_back_as_no_correction_seen_or_not(runs, form, unseen):
    """Label Studio has no other word for rows that are not seen than not enabled."""
    run, edited = runs / "box", runs / "edited.json"
    doc = json.loads((run / "trajectory.json").read_text())
    for frame in doc["frames"][4:7]:
        frame["targets"][0]["parts"][0] |= unseen
    edited.write_text(json.dumps(doc))
    assert facetrack("export", edited, "--to", form, "-o", runs / "there") == 0
    assert imported_corrections(runs / "there", open_run(run), read_trajectory(edited)) == ()


def test_fix_tracks_again_from_what_was_corrected(runs, capsys):
    run = runs / "points"
    file, before = in_cvat(run, face__nose_4={"points": "158.50,140.50"}), read_trajectory(run)
    assert facetrack("fix", run, "--import", file, "--no-video", "-q") == 0
    nose = read_trajectory(run).find("face", "nose")
    assert nose.by_hand.tolist() == [n == 4 for n in range(FRAMES)] and (nose.x[4], nose.y[4]) == (158, 140)
    assert before.find("face", "nose").x[:4].tolist() == nose.x[:4].tolist()
    said = (run / CORRECTED).read_text()
    assert re.search(r"frame: 4\s+face:\s+points: {nose: \[158, 140\]}", said), said
    # what is corrected next is added
    assert facetrack("export", run, "--to", "labelstudio", "--overwrite") == 0

    def more(places):
        places["face/nose", 7]["x"] += 2.0

    assert facetrack("fix", run, "--import", in_label_studio(run, more), "--no-video") == 0
    assert "1 correction, in frames 7; export the run again before" in capsys.readouterr().err
    assert [one.frame for one in open_run(run).start.corrections] == [4, 7]


def in_elan(run, *tiers):
    """The run's .eaf with tiers of its own added: name, participant, annotations (begin, end in ms, text)."""
    path = run / "trajectory.eaf"
    assert facetrack("export", run, "--to", "elan", "--overwrite") == 0
    tree = ET.parse(path)
    root = tree.getroot()
    for n, (name, participant, notes) in enumerate(tiers):
        for old in [one for one in root.iter("TIER") if one.get("TIER_ID") == name]:
            root.remove(old)
        tier = ET.Element("TIER", TIER_ID=name, PARTICIPANT=participant, LINGUISTIC_TYPE_REF="any")
        root.insert(2, tier)
        for k, (begin, end, text) in enumerate(notes):
            for side, time in ("b", begin), ("e", end):
                slot = {"TIME_SLOT_ID": f"own{n}{side}{k}", "TIME_VALUE": str(time)}
                ET.SubElement(root.find("TIME_ORDER"), "TIME_SLOT", slot)
            ends = {"TIME_SLOT_REF1": f"own{n}b{k}", "TIME_SLOT_REF2": f"own{n}e{k}"}
            one = ET.SubElement(ET.SubElement(tier, "ANNOTATION"), "ALIGNABLE_ANNOTATION", ends)
            ET.SubElement(one, "ANNOTATION_VALUE").text = text
    tree.write(path)
    return path


def test_segments_in_elan_say_when_a_target_or_its_parts_are_absent(runs):
    run = runs / "points"
    # 25 frames a second: a frame is absent if its middle is in the segment
    notes = [(115, 245, "mouth_left, nose"), (310, 400, "absent")]
    file = in_elan(run, ("absent@face", "", notes), ("gloss@face", "face", [(0, 400, "HOUSE")]))
    rows = open_run(run).rows
    back = {part: (rows.find("face", part).x[6], rows.find("face", part).y[6]) for part in ("mouth_left", "nose")}
    assert found(run, file) == (
        Correction(3, "face", absent=("nose", "mouth_left")),
        Correction(6, "face", points={"nose": back["nose"], "mouth_left": back["mouth_left"]}, absent=()),
        Correction(8, "face", absent=True),
    )


def test_segments_that_were_moved_in_elan_move_what_is_absent(runs, capsys):
    run = runs / "box"
    own = in_elan(run, ("seen@face", "face", [(0, 160, "seen"), (280, 400, "")]))
    assert facetrack("fix", run, "--import", own, "--no-video", "-q") == 0
    assert [*open_run(run).rows.find("face", "box").status[3:8]] == ["tracked", "absent", "absent", "absent", "init"]
    assert found(run, in_elan(run)) == ()
    # its end moves to frame 8, where it was seen; in frame 6 it has no place, which must be given on the page
    moved = in_elan(run, ("absent@face", "face", [(160, 320, "absent")]))
    box = open_run(run).rows.find("face", "box").boxes[8]
    assert found(run, moved) == (
        Correction(7, "face", absent=True),
        Correction(8, "face", box=tuple(box.round(3).tolist()), absent=()),
    )
    shorter = in_elan(run, ("absent@face", "face", [(160, 240, "absent")]))
    assert facetrack("fix", run, "--import", shorter) == 3
    assert "face/box is there in frame 6, and the run has no place of it; place it there" in capsys.readouterr().err


def test_what_the_run_does_not_have_is_refused(runs, capsys):
    run = runs / "points"

    def refused(file, said, *more, code=3):
        assert facetrack("fix", run, "--import", file, *more) == code
        assert said in capsys.readouterr().err

    refused(in_cvat(run, face__mouth_left_0={"points": "1,1"}), "frame 0 cannot be corrected, in which it begins")
    file = run / "trajectory.cvat.xml"
    file.write_text(file.read_text().replace('label="face/nose"', 'label="face/chin"'))
    refused(file, "face/chin is not in the run, which has face/nose, face/mouth_left")
    refused(run / "nope.xml", "No such file or directory; name a file of CVAT, Label Studio or ELAN")
    refused(file, "--import adds to the run's corrections, --init replaces them", "--init", file, code=2)
    chin = in_elan(run, ("absent@face", "face", [(120, 240, "chin")]))
    refused(chin, "'chin' is no part; there are nose, mouth_left")
    refused(in_elan(run), "has no tier seen or absent of face; add a tier absent@face there")


def test_participants_in_elan_are_the_names_of_a_film_s_people(tmp_path):
    names, path = ("person_1", "person_2"), tmp_path / "notes.eaf"
    tier = '<TIER TIER_ID="{}@{}" PARTICIPANT="{}" LINGUISTIC_TYPE_REF="seen"/>'
    tiers = [("seen", "person_1", "Anna"), ("mouth", "person_1", "Anna"), ("seen", "person_2", "person_2")]

    def renamed(*more):
        body = "".join(tier.format(*one) for one in (*tiers, *more))
        path.write_text(f'<ANNOTATION_DOCUMENT FORMAT="3.0"><TIME_ORDER/>{body}</ANNOTATION_DOCUMENT>')
        return renames(path, names, "clip.mp4")

    assert renamed(("gloss", "Zoe", "Zoe")) == {"person_1": "Anna"}
    with pytest.raises(InputError, match="the tiers of person_1 have the participants Anna and Ben; give them one"):
        renamed(("blinks", "person_1", "Ben"))
