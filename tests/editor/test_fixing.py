"""Corrections of runs: what is tracked again is what a whole run from the corrected init file gives."""

import contextlib
import errno
import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.types import Correction
from facetrack_cli.editor.fix_session import overview
from facetrack_cli.editor.fixer import Fixer, corrections_of, keep, merged, save
from facetrack_cli.runs.finished import open_run
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trajectory.reader import CORRECTED, UNSAVED, read_trajectory
from facetrack_cli.trajectory.views import choose
from facetrack_cli.trajectory.writers import csv_frames, json_frames
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support.damage import raising
from tests.support.hands_run import FEW as HANDS
from tests.support.hands_run import hands_run
from tests.support.page_client import fixing
from tests.support.results import rows_of as objects_of
from tests.support.samples import FOLDER

STOP = 24
CLIP = FOLDER / "expressions.mp4"
INIT = CLIP.with_suffix(".init.yaml").read_text()
FEW = ["--set", "filter.particles=20"]
PLACES = {"nose": 141, "mouth_left": 154, "mouth_right": 154, "lip_upper": 153, "lip_lower": 169}
ACROSS = {"nose": 160, "mouth_left": 139, "mouth_right": 181, "lip_upper": 160, "lip_lower": 160}
FORMS = ("csv", "json", "jsonl")


def begins(left):
    """Points of a face so many pixels to the left of where it is."""
    return "{points: {" + ", ".join(f"{part}: [{ACROSS[part] - left}, {y}]" for part, y in PLACES.items()) + "}}"


TWO = f"frame: 2\nanna: {begins(0)}\nben: {begins(10)}\n"
LATE = INIT + "corrections:\n- {frame: 5, points: {nose: [158, 140]}}\n- {frame: 31, points: {nose: [150, 140]}}\n"


def run(out, clip, *args, video=False):
    words = ["run", clip, "-o", out, "--format", ",".join(FORMS), "-q", *args, *([] if video else ["--no-video"])]
    assert main([str(word) for word in words]) == 0
    return out


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """`late` corrects frame 5, and frame 31, to which the run does not come."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "two.yaml").write_text(TWO)
    (folder / "late.yaml").write_text(LATE)
    part = ["--stop", STOP, *FEW]
    run(folder / "face", CLIP, "--config", "factorized", *part, video=True)
    run(folder / "searched", CLIP, "--config", "face", "--init", detector().name, *part)
    run(folder / "two", CLIP, "--init", folder / "two.yaml", "--config", "factorized_transition", *part)
    run(folder / "box", FOLDER / "textured.mp4", "--config", "contour_histogram_correlation", *part)
    run(folder / "affine", FOLDER / "zoom.mp4", "--config", "adaptive_velocity", *part)
    run(folder / "late", CLIP, "--init", folder / "late.yaml", "--stop", 12, *FEW)
    return folder


class Fixed:
    """A copy of a run, and what puts it right."""

    def __init__(self, run, folder):
        self.folder = shutil.copytree(run, folder)
        self.run = open_run(folder)
        with open_source(self.run.clip, fps=self.run.fps, stop=self.run.last + 1) as source:
            self.frames = list(source)
        self.read = []
        self.fixer = Fixer(self.run, lambda index: self.read.append(index) or self.frames[index])

    def put(self, *corrections):
        for one in corrections:
            self.fixer.put([one])

    def again(self, out, *args, **more):
        """What a run from the corrected init file gives."""
        recipe = self.folder / "recipe.json"
        recipe.write_text(json.dumps({k: v for k, v in self.run.rows.header["recipe"].items() if k != "name"}))
        init = ["--config", recipe, "--init", self.folder / CORRECTED, "--stop", self.run.last + 1]
        return run(out, self.run.clip, *init, *args, **more)

    def text(self):
        """All rows, in the bytes of each form."""
        return [*csv_frames(self.fixer.rows), *json_frames(self.fixer.rows)]

    def frames_corrected(self):
        return [one.frame for one in self.fixer.corrections]


@pytest.fixture
def fixed(runs, tmp_path):
    with contextlib.ExitStack() as stack:

        def make(name, folder=None):
            one = Fixed(runs / name if folder is None else folder, tmp_path / f"{name}-fixed")
            stack.callback(one.fixer.close)
            return one

        yield make


def points(target, frame, **given):
    return Correction(frame, target, points=given)


def box(target, frame, *sides):
    return Correction(frame, target, box=tuple(map(float, sides)))


def nose(frame, x, y):
    return points("face", frame, nose=(x, y))


def now(fixer, frame, target):
    """The rows of a target in one frame."""
    return objects_of(choose(fixer.rows.at(frame), target))


def rows_of(folder, first=0, stop=STOP):
    """The lines of the CSV of these frames."""
    lines = (folder / "trajectory.csv").read_text().splitlines()[1:]
    return [line for line in lines if first <= int(line.split(",")[0]) < stop]


def frames_of(folder, form):
    lines = (folder / f"trajectory.{form}").read_text().splitlines()
    return [line.rstrip(",") for line in lines if line.startswith(('{"frame"', '{"type":"frame"'))]


# --- the same rows as a whole run ------------------------------------------------------------------------------------

NOSE = nose(8, 150.0, 130.5)
CASES = {
    "face": [NOSE, Correction(15, "face", absent=("lip_upper",)), points("face", 19, lip_upper=(161.0, 152.0))],
    "searched": [NOSE],
    "two": [points("ben", 9, nose=(158.25, 140.0)), points("anna", 14, mouth_left=(141.0, 155.0)),
            points("ben", 15, nose=(155.0, 139.0))],
    "box": [box("head", 7, 120, 60, 70, 76), Correction(12, "head", absent=True),
            box("head", 18, 125.5, 60, 74, 80)],
    "affine": [box("face", 6, 120, 90, 66, 66), box("face", 13, 126, 84, 70, 70)],
}  # fmt: skip


@pytest.mark.parametrize(("name", "backwards"), [*((name, False) for name in CASES), ("face", True)])
def test_what_fix_writes_is_what_a_run_from_the_corrected_init_file_writes(fixed, tmp_path, name, backwards):
    """Byte by byte, in whatever order the corrections were made."""
    one = fixed(name)
    one.put(*sorted(CASES[name], key=lambda c: c.frame, reverse=backwards))
    save(one.fixer)
    again = one.again(tmp_path / "again")
    for form in FORMS[1:]:
        assert frames_of(one.folder, form) == frames_of(again, form)
    assert (one.folder / "trajectory.csv").read_bytes() == (again / "trajectory.csv").read_bytes()
    ours, theirs = (json.loads((folder / "trajectory.json").read_text()) for folder in (one.folder, again))
    assert list(ours["lost_frames"].items()) == list(theirs["lost_frames"].items())
    assert ours["init"]["corrections"] == theirs["init"]["corrections"]
    whole = json.loads((one.folder / "trajectory.jsonl").read_text().splitlines()[-1])
    assert whole["lost_frames"] == ours["lost_frames"] and whole["type"] == "footer"


def test_rows_before_a_correction_and_of_other_targets_stay_to_the_byte(fixed, runs):
    one = fixed("two")
    one.put(points("ben", 9, nose=(158.0, 140.0)), points("ben", 16, nose=(157.0, 141.0)))
    # only the frames from the correction on, and the first, which has taught what the parts look like
    assert one.read == [2, *range(9, STOP), *range(16, STOP)]
    save(one.fixer)

    pairs = zip(rows_of(one.folder), rows_of(runs / "two"), strict=True)
    changed = [new.split(",")[:3:2] for new, old in pairs if new != old]
    assert len(changed) > 70 and all(target == "ben" and int(frame) >= 9 for frame, target in changed)
    frames = json.loads((one.folder / "trajectory.json").read_text())["frames"]
    hand = [(frame["frame"], target["target"], part["part"], part["status"]) for frame in frames
            for target in frame["targets"] for part in target["parts"] if part.get("by_hand")]  # fmt: skip
    assert hand == [(9, "ben", "nose", "init"), (16, "ben", "nose", "init")]


def test_what_is_not_given_stays_where_the_rows_have_it(fixed):
    one = fixed("face")

    def places():
        return {part.part: (part.x, part.y) for part in now(one.fixer, 8, "face") if part.part != "box"}

    before = places()
    one.put(NOSE)
    [done] = one.fixer.corrections
    assert done.points == {"nose": (150.0, 130.5)}
    assert done.kept == {part: at for part, at in before.items() if part != "nose"}
    assert places() == {**before, "nose": (150.0, 130.5)}
    one.put(Correction(12, "face", absent=("nose", "lip_lower")), nose(16, 150.0, 130.0))
    assert one.fixer.find(16, "face").absent == ("lip_lower",)
    assert [part.status for part in now(one.fixer, 20, "face")].count("absent") == 1


def test_a_part_beyond_the_border_is_kept_there(tmp_path):
    """The init file is read again, and the run corrected a second time; of images, of which a face leaves the last."""
    shots, out = tmp_path / "shots", tmp_path / "out"
    shots.mkdir()
    with open_source(CLIP, stop=12) as source:
        for frame in source:
            left = 120 + 3 * frame.index
            cv2.imwrite(str(shots / f"{frame.index:02}.png"), frame.bgr[90:200, left : left + 120])
    places = "nose: [40, 51], mouth_left: [19, 64], mouth_right: [61, 64], lip_upper: [40, 63], lip_lower: [40, 79]"
    (tmp_path / "shots.init.yaml").write_text(f"frame: 0\nface:\n  points: {{{places}}}\n")
    run(out, shots, *FEW)
    for turn, (frame, x) in enumerate(((11, 6), (10, 9))):
        with contextlib.closing(Fixed(out, tmp_path / f"copy{turn}").fixer) as fixer:
            fixer.put([nose(frame, x, 50)])
            save(fixer)
        if turn == 0:
            shutil.copytree(tmp_path / "copy0", out, dirs_exist_ok=True)
            assert open_run(out).start.corrections[0].kept["mouth_left"][0] < -0.5
            run(tmp_path / "again", shots, "--init", out / CORRECTED, *FEW)
            ours, theirs = ((folder / "trajectory.csv").read_bytes() for folder in (out, tmp_path / "again"))
            assert ours == theirs


def test_the_video_is_painted_as_a_run_from_the_corrected_init_file_paints_it(fixed, tmp_path, monkeypatch):
    """What is by hand is marked, and no trail leads there."""
    painted, write = [], VideoWriter.write
    one = fixed("face")
    two = fixed("copy", one.folder)
    before = (two.folder / "annotated.mp4").read_bytes()
    two.put(NOSE)
    said = save(two.fixer, video=False)
    assert (two.folder / "annotated.mp4").read_bytes() == before and "left as it was" in said[-1]
    monkeypatch.setattr(VideoWriter, "write", lambda self, image, at: (painted.append(image), write(self, image, at)))
    one.put(NOSE)
    save(one.fixer)
    one.again(tmp_path / "again", video=True)
    # the bar has the title of each recipe
    assert all(np.array_equal(a[30:], b[30:]) for a, b in zip(painted[:STOP], painted[STOP:], strict=True))


# --- undo, remove, stop, errors --------------------------------------------------------------------------------------


def test_undo_and_remove_give_back_the_very_bytes(fixed, runs):
    one = fixed("face")
    assert not one.fixer.can_undo and not one.fixer.changed
    was = [one.text()]
    for correction in (NOSE, nose(16, 151.0, 131.0), nose(4, 159.0, 140.0)):
        one.put(correction)
        was.append(one.text())
    one.read.clear()
    one.fixer.undo()
    one.fixer.remove(16, "face")
    assert one.text() == was[1], "the one before it is left"
    one.fixer.remove(8, "face")
    assert one.text() == was[0] and not one.fixer.changed
    with pytest.raises(InputError, match="no correction at frame 8"):
        one.fixer.remove(8, "face")
    for expected in (was[1], was[2], was[1], was[0]):
        one.fixer.undo()
        assert one.text() == expected
    assert one.read == [] and not one.fixer.can_undo and not one.fixer.changed
    assert save(one.fixer) == [f"{one.folder}: nothing was corrected, all is as it was"]


def test_a_corrected_run_can_be_put_right_again(fixed, runs, tmp_path):
    """Also by taking away a correction that its files were made with."""
    one = fixed("face")
    assert keep(one.fixer) is None
    one.put(NOSE, nose(16, 151.0, 131.0))
    path = keep(one.fixer)  # for the next time
    assert path == one.folder / UNSAVED and corrections_of(path, one.run) == one.fixer.corrections
    save(one.fixer)
    assert not path.exists()
    two = fixed("second", one.folder)
    assert two.fixer.corrections == one.fixer.corrections
    two.fixer.remove(8, "face")
    save(two.fixer)

    assert rows_of(two.folder, stop=16) == rows_of(runs / "face", stop=16)
    assert rows_of(two.folder, 16) == rows_of(one.folder, 16)


def test_what_is_stopped_or_fails_leaves_the_rows_as_they_were(fixed):
    one = fixed("face")
    one.put(NOSE)
    before, corrections, asked = one.text(), one.fixer.corrections, []
    with pytest.raises(StoppedError):
        one.fixer.put([nose(12, 150.0, 130.0)], stop=lambda: len(asked) > 4 or asked.append(1))
    for correction, said in (
        (nose(99, 150.0, 130.0), r"frame 99 cannot be corrected; the run can be from 1 to 23"),
        (nose(0, 150.0, 130.0), "in which it begins"),
        (points("ben", 9, nose=(150.0, 130.0)), "there is no ben in the run; it has face"),
        (nose(9, 950.0, 130.0), "outside"),
    ):
        with pytest.raises(InputError, match=said):
            one.put(correction)
    del one.frames[20:]
    with pytest.raises(IndexError):
        one.put(nose(12, 150.0, 130.0))
    assert (one.text(), one.fixer.corrections) == (before, corrections)


def test_a_frame_has_one_correction_and_a_full_disk_leaves_the_rows_as_they_were(fixed, monkeypatch):
    one = fixed("late")
    one.put(*(nose(8, x, 140) for x in (157, 159, 159)))
    given = [(c.frame, c.points) for c in one.fixer.corrections]
    assert given == [(5, {"nose": (158, 140)}), (8, {"nose": (159, 140)}), (31, {"nose": (150, 140)})]
    before = one.text()
    full = raising(OSError(errno.ENOSPC, "No space left on device"))
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        patch.setattr(tempfile, "TemporaryDirectory", full)
        for fails in (lambda: one.put(nose(9, 159, 140)), lambda: Fixer(one.run, one.frames.__getitem__)):
            with pytest.raises(OutputError, match="temporary files: the disk is full"):
                fails()
    assert one.text() == before and one.frames_corrected() == [5, 8, 31]
    one.put(nose(9, 159, 140))
    assert one.text() != before
    one.fixer.undo()
    assert one.text() == before
    one.fixer.undo()
    one.fixer.undo()
    assert not one.fixer.can_undo and not one.fixer.changed, "the same again was no step"


# --- init files ------------------------------------------------------------------------------------------------------


def test_a_correction_past_the_end_is_kept_for_a_longer_run(fixed, tmp_path):
    one = fixed("late")
    one.put(nose(8, 159, 140))
    said = save(one.fixer)
    assert said[-1] == f"{one.folder / CORRECTED}: the correction of face at frame 31 is past the end, frame 11"
    assert [c.frame for c in read_init(one.folder / CORRECTED).corrections] == [5, 8, 31]
    again = run(tmp_path / "again", CLIP, "--init", one.folder / CORRECTED, "--stop", 12, *FEW)
    assert (one.folder / "trajectory.csv").read_bytes() == (again / "trajectory.csv").read_bytes()
    shown = overview(one.fixer.rows, 3, one.fixer.corrections, {"face": 0.5})["corrections"]
    assert [c["frame"] for c in shown] == [5, 8]
    one.fixer.remove(31, "face")
    assert one.fixer.changed and one.frames_corrected() == [5, 8]
    with pytest.raises(InputError, match="frame 31 cannot be corrected; the run can be from 1 to 11"):
        one.put(nose(31, 159, 140))


def test_the_init_file_of_the_run_itself_changes_nothing(fixed):
    """Though it leaves open where the other points were: the rows say that."""
    one = fixed("late")
    kept = one.run.start.corrections[0]
    assert set(one.fixer.corrections[0].kept) == {"mouth_left", "mouth_right", "lip_upper", "lip_lower"}
    one.fixer.apply(one.run.start.corrections)
    assert not one.fixer.changed and "nothing was corrected" in save(one.fixer)[0]
    # a frame is tracked once more, to see where the parts are that a new correction leaves open; rows before it stay
    one.fixer.apply((nose(5, 159, 140),))
    assert one.read == [*range(6), 0, *range(5, 12)]
    recorded, corrected = ([*csv_frames(rows.between(0, 5))] for rows in (one.run.rows, one.fixer.rows))
    assert corrected == recorded
    assert kept.points != one.fixer.corrections[0].points and one.fixer.find(5, "face").kept["lip_lower"][1] > 160
    one.fixer.apply(())
    assert one.fixer.changed and one.fixer.corrections == ()
    one.fixer.undo()
    one.fixer.undo()
    assert not one.fixer.can_undo, "all of a file is one step"


def test_an_init_file_that_begins_elsewhere_is_refused(fixed, tmp_path):
    one, init = fixed("two"), tmp_path / "i.yaml"
    for change, said in ((("frame: 2", "frame: 3"), "anna does not begin where it does in the run"),
                         (("[150, 141]", "[151, 141]"), "ben does not begin where it does in the run")):  # fmt: skip
        init.write_text(TWO.replace(*change))
        with pytest.raises(InputError, match=said):
            corrections_of(init, one.run)


def test_an_init_file_means_the_targets_that_a_run_takes_it_for(tmp_path):
    """A face alone is the head, and hands that it does not speak of are where they were found."""
    init = tmp_path / "i.yaml"
    start = "frame: 0\n{}: {{box: [128, 40, 64, 76]}}\ncorrections:\n- {{frame: 2, {}: {{absent: true}}}}\n"
    init.write_text(start.format("face", "face"))
    opened = open_run(hands_run(tmp_path / "out", 4, "--init", init))
    for called in ("face", "head", "somebody"):
        init.write_text(start.format(called, called))
        assert corrections_of(init, opened) == (Correction(2, "head", absent=True),)
    init.write_text(start.format("left_hand", "left_hand"))
    with pytest.raises(InputError, match="left_hand does not begin where it does in the run"):
        corrections_of(init, opened)


def test_what_is_dragged_goes_over_what_its_frame_has():
    parts, gone = ("a", "b", "c"), Correction(5, "t", absent=True)
    old = Correction(5, "t", points={"a": (1, 1)}, kept={"b": (2, 2)}, absent=("c",))
    whole = Correction(5, "t", box=(1, 2, 9, 9))

    def together(box, points, absent, before=old, parts=parts):
        return merged(Correction(5, "t", box, points, absent=absent), before, parts)

    for given, expected in (
        ((None, {"b": (3, 3)}, ()), ({"a": (1, 1), "b": (3, 3)}, {}, ("c",))),
        ((None, {"c": (3, 3)}, ("a",)), ({"c": (3, 3)}, {"b": (2, 2)}, ("a",))),
        ((None, {}, ("b",)), ({"a": (1, 1)}, {}, ("b", "c"))),
        ((None, {"b": (3, 3)}, (), gone), ({"b": (3, 3)}, {}, ("a", "c"))),
        (((1, 2, 9, 9), {"b": (3, 3)}, ()), ({"a": (1, 1), "b": (3, 3)}, {}, ("c",))),  # beside points it says nothing
    ):
        new = together(*given)
        assert (new.points, new.kept, new.absent) == expected, given
    for given, expected in (
        ((None, {}, ("a", "b")), gone),
        ((None, {}, True), gone),
        (((1, 2, 9, 9), {}, (), None, ("box",)), whole),
        ((None, {}, ("box",), None, ("box",)), gone),
        (((1, 2, 9, 9), {}, ("box",), None, ("box",)), gone),
        (((1, 2, 9, 9), {}, ("a",)), replace(whole, absent=("a",))),  # of points, it places those that are there
        ((None, {}, ("a", "b"), replace(old, learn=False)), gone),  # an init file refuses learn: beside it
    ):
        assert together(*given) == expected, given
    assert together(None, {"b": (3, 3)}, (), replace(old, learn=False)).learn is False


# --- what is tracked again -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [("signer",), ("signer", "--smooth"), ("head_hands", *HANDS)])
def test_hands_are_tracked_again_as_a_whole(how, tmp_path, monkeypatch):
    """They are one filter's, or exclude each other, and smoothing needs all frames: a run with corrections is saved."""
    monkeypatch.chdir(tmp_path)
    asked = ["run", str(FOLDER / "signing.mp4"), "--config", *how, "--stop", "14", "--no-video", "-q", "-o"]
    assert main([*asked, "out"]) == 0
    start = (FOLDER / "signing.init.yaml").read_text()
    Path("one.yaml").write_text(f"{start}corrections:\n- frame: 6\n  right_hand: {{box: [200, 110, 50, 56]}}\n")
    assert main(["fix", "out", "--init", "one.yaml"]) == 0
    assert main([*asked, "again", "--init", "out/corrected.init.yaml"]) == 0
    saved, whole = (read_trajectory(Path(name)) for name in ("out", "again"))
    for ours, theirs in zip(saved.parts, whole.parts, strict=True):
        assert ours.part == theirs.part
        np.testing.assert_array_equal(ours.x, theirs.x)
        np.testing.assert_array_equal(ours.confidence, theirs.confidence)
    assert saved.find("right_hand", "box").x[6] == pytest.approx(224.5, abs=2)
    with fixing(Path("out")) as (session, _):
        assert session.get_session()["again"]
        session.fixer.put([Correction(9, "right_hand", absent=True)])
        save(session.fixer)
        left, files = (rows.find("left_hand", "box") for rows in (session.fixer.rows, read_trajectory(Path("out"))))
        np.testing.assert_array_equal(left.x, files.x, "the page shows what is saved")
