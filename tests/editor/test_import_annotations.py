"""A run that is corrected in CVAT, Label Studio or ELAN, and comes back by facetrack fix --import."""

import json
import re
import shutil
from xml.etree import ElementTree as ET

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor.import_annotations import imported_corrections, renames
from facetrack_cli.run_folder.finished import open_run
from facetrack_cli.trajectory.header import CORRECTED
from facetrack_cli.trajectory.reader import read_trajectory
from tests.support.samples import FOLDER

FRAMES = 10


def facetrack(*words):
    return main([str(word) for word in words])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folders of a run of points and of one of a box, each exported to both tools."""
    folder = tmp_path_factory.mktemp("made")
    few = ["--set", "filter.particles=20", "--stop", FRAMES, "--no-video", "-q", "--format", "csv,json"]
    clip = FOLDER / "expressions.mp4"
    assert facetrack("run", clip, "-o", folder / "points", "--config", "factorized", *few) == 0
    box = ["--config", "histogram", "--box", "115,80,90,110"]
    assert facetrack("run", clip, "-o", folder / "box", *box, *few) == 0
    for name in ("points", "box"):
        for form in ("cvat", "labelstudio"):
            assert facetrack("export", folder / name, "--to", form) == 0
    return folder


@pytest.fixture
def runs(made, tmp_path):
    shutil.copytree(made, tmp_path / "runs")
    return tmp_path / "runs"


def found(run, file):
    opened = open_run(run)
    return imported_corrections(file, opened, opened.rows)


def in_cvat(run, change):
    path = run / "trajectory.cvat.xml"
    tree = ET.parse(path)
    change({(track.get("label"), int(one.get("frame"))): one for track in tree.iter("track") for one in track})
    tree.write(path)
    return path


def in_label_studio(run, change):
    path = run / "trajectory.labelstudio.json"
    tasks = json.loads(path.read_text())
    regions = [one["value"] for one in tasks[0]["annotations"][0]["result"]]
    change({(one["labels"][0], place["frame"] - 1): place for one in regions for place in one["sequence"]})
    path.write_text(json.dumps(tasks))
    return path


@pytest.mark.parametrize("name", ["points", "box"])
def test_what_was_not_touched_is_no_correction(runs, capsys, name):
    before = (runs / name / "trajectory.csv").read_bytes()
    for file in ("trajectory.cvat.xml", "trajectory.labelstudio.json"):
        assert found(runs / name, runs / name / file) == ()
        assert facetrack("fix", runs / name, "--import", runs / name / file) == 0
        assert "is as the run has it; nothing was written" in capsys.readouterr().err
    assert (runs / name / "trajectory.csv").read_bytes() == before


def test_points_that_were_moved_or_hidden_in_cvat(runs):
    def change(shapes):
        shapes["face/nose", 3].set("points", "160.50,141.00")
        shapes["face/lip_upper", 3].set("points", "150.50,151.00")
        for frame in (5, 6, 7):
            shapes["face/mouth_left", frame].set("outside", "1")
        shapes["face/nose", 8].set("keyframe", "0")  # interpolated: nobody has put it there
        shapes["face/nose", 8].set("points", "1,1")

    one, two, three = found(runs / "points", in_cvat(runs / "points", change))
    assert one == Correction(3, "face", TargetStart(points={"nose": (160.0, 140.5), "lip_upper": (150.0, 150.5)}))
    assert two == Correction(5, "face", absent=("mouth_left",))
    row = read_trajectory(runs / "points").find("face", "mouth_left")
    assert (three.frame, three.absent) == (8, ()) and list(three.given.points) == ["mouth_left"]
    assert three.given.points["mouth_left"] == pytest.approx((row.x[8], row.y[8]), abs=0.006)


def test_boxes_that_were_moved_or_switched_off_in_label_studio(runs):
    def change(places):
        places["face", 4] |= {"x": 25.0, "y": 25.0, "width": 25.0, "height": 50.0}
        for frame in (6, 7, 8, 9):
            places["face", frame]["enabled"] = False

    one, two = found(runs / "box", in_label_studio(runs / "box", change))
    width, height = open_run(runs / "box").header.source.size
    assert one.given.box == pytest.approx((width / 4, height / 4, width / 4, height / 2))
    assert (one.frame, two) == (4, Correction(6, "face", absent=True))


def test_what_label_studio_interpolates_is_no_correction(runs):
    path = runs / "box" / "trajectory.labelstudio.json"
    tasks = json.loads(path.read_text())
    value = tasks[0]["annotations"][0]["result"][0]["value"]
    for place in value["sequence"][2:9]:
        place |= {"x": place["x"] + 5, "auto": True}
    value["sequence"][9]["x"] += 5
    path.write_text(json.dumps(tasks))
    (one,) = found(runs / "box", path)
    assert one.frame == 9


@pytest.mark.parametrize("form", ["cvat", "labelstudio"])
@pytest.mark.parametrize("unseen", ["hidden", "beyond the picture"])
def test_rows_that_are_not_seen_come_back_as_no_correction(runs, form, unseen):
    """An annotator has not touched them; Label Studio has no other word for them than not enabled."""
    run, edited = runs / "box", runs / "edited.json"
    doc = json.loads((run / "trajectory.json").read_text())
    for frame in doc["frames"][4:7]:
        part = frame["targets"][0]["parts"][0]
        part |= {"status": "hidden"} if unseen == "hidden" else {"x": -20.0}
    edited.write_text(json.dumps(doc))
    assert facetrack("export", edited, "--to", form, "-o", runs / "there") == 0
    assert imported_corrections(runs / "there", open_run(run), read_trajectory(edited)) == ()


def test_the_box_of_a_head_that_carries_points_is_moved_and_never_absent_alone(tmp_path):
    run, few = tmp_path / "run", ["--set", "filter.particles=20", "--stop", 5, "--no-video", "-q"]
    assert facetrack("run", FOLDER / "expressions.mp4", "-o", run, "--config", "face", *few) == 0
    assert facetrack("export", run, "--to", "cvat") == 0

    def change(shapes):
        shapes["face", 2].set("outside", "1")
        shapes["face", 3].set("xbr", str(float(shapes["face", 3].get("xbr")) + 8))

    (one,) = found(run, in_cvat(run, change))
    left, top, w, h = read_trajectory(run).find("face", "box").boxes[3]
    assert one.frame == 3 and one.absent == () and not one.given.points
    assert one.given.box == pytest.approx((left, top, w + 8, h), abs=0.011)


def test_fix_tracks_again_from_what_was_corrected(runs, capsys):
    run = runs / "points"

    def change(shapes):
        shapes["face/nose", 4].set("points", "158.50,140.50")

    file = in_cvat(run, change)
    before = read_trajectory(run)
    assert facetrack("fix", run, "--import", file, "--no-video", "-q") == 0
    after = read_trajectory(run)
    nose = after.find("face", "nose")
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


def test_what_the_run_does_not_have_is_refused(runs, capsys):
    run = runs / "points"
    file = run / "trajectory.cvat.xml"
    file.write_text(file.read_text().replace('label="face/nose"', 'label="face/chin"'))
    assert facetrack("fix", run, "--import", file) == 3
    assert "face/chin is not in the run, which has face/nose, face/mouth_left" in capsys.readouterr().err

    def first(shapes):
        shapes["face/mouth_left", 0].set("points", "1,1")

    assert facetrack("export", run, "--to", "cvat", "--overwrite") == 0
    assert facetrack("fix", run, "--import", in_cvat(run, first)) == 3
    assert "frame 0 cannot be corrected, in which it begins" in capsys.readouterr().err
    assert facetrack("fix", run, "--import", file, "--init", file) == 2
    assert "--import adds to the run's corrections, --init replaces them" in capsys.readouterr().err


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
        Correction(3, "face", TargetStart(), absent=("nose", "mouth_left")),
        Correction(6, "face", TargetStart(points={"nose": back["nose"], "mouth_left": back["mouth_left"]}), absent=()),
        Correction(8, "face", absent=True),
    )


def test_segments_that_were_moved_in_elan_move_what_is_absent(runs, capsys):
    run = runs / "box"
    own = in_elan(run, ("seen@face", "face", [(0, 160, "seen"), (280, 400, "")]))
    assert facetrack("fix", run, "--import", own, "--no-video", "-q") == 0
    assert [*open_run(run).rows.find("face", "box").status[3:8]] == ["tracked", "absent", "absent", "absent", "init"]
    whole = in_elan(run)
    capsys.readouterr()
    assert found(run, whole) == ()
    # its end moves to frame 8, where it was seen; in frame 6 it has no place, which must be given on the page
    moved = in_elan(run, ("absent@face", "face", [(160, 320, "absent")]))
    box = open_run(run).rows.find("face", "box").boxes[8]
    assert found(run, moved) == (
        Correction(7, "face", absent=True),
        Correction(8, "face", TargetStart(box=tuple(box.round(3).tolist())), absent=()),
    )
    shorter = in_elan(run, ("absent@face", "face", [(160, 240, "absent")]))
    assert facetrack("fix", run, "--import", shorter) == 3
    assert "face/box is there in frame 6, and the run has no place of it; place it there" in capsys.readouterr().err


def test_what_elan_s_file_does_not_have_is_refused(runs, capsys):
    run = runs / "points"
    file = in_elan(run, ("absent@face", "face", [(120, 240, "chin")]))
    assert facetrack("fix", run, "--import", file) == 3
    assert "'chin' is no part; there are nose, mouth_left" in capsys.readouterr().err
    assert facetrack("fix", run, "--import", in_elan(run)) == 3
    assert "has no tier seen or absent of face; add a tier absent@face there" in capsys.readouterr().err


def test_participants_in_elan_are_the_names_of_a_film_s_people(tmp_path):
    names, path = ("person_1", "person_2"), tmp_path / "notes.eaf"
    tier = '<TIER TIER_ID="{}@{}" PARTICIPANT="{}" LINGUISTIC_TYPE_REF="seen"/>'
    tiers = [("seen", "person_1", "Anna"), ("mouth", "person_1", "Anna"), ("seen", "person_2", "person_2")]

    def write(*tiers):
        body = "".join(tier.format(*one) for one in tiers)
        path.write_text(f'<ANNOTATION_DOCUMENT FORMAT="3.0"><TIME_ORDER/>{body}</ANNOTATION_DOCUMENT>')

    write(*tiers, ("gloss", "Zoe", "Zoe"))
    assert renames(path, names, "clip.mp4") == {"person_1": "Anna"}
    write(*tiers, ("blinks", "person_1", "Ben"))
    with pytest.raises(InputError, match="the tiers of person_1 have the participants Anna and Ben; give them one"):
        renames(path, names, "clip.mp4")
