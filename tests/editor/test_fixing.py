"""Putting runs right: what is tracked again is what a whole run from the corrected init file gives."""

import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor import history
from facetrack_cli.editor import save as saving
from facetrack_cli.editor.history import Fixer, corrections_of
from facetrack_cli.editor.save import keep, save
from facetrack_cli.recipe.files import shipped_recipes
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.finished import check_size, open_run, recipe_of
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.tracking.start.detectors import detector
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.writers import csv_frames, json_frames
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support.results import rows_of as objects_of
from tests.support.samples import FOLDER

STOP = 24
FEW = ["--set", "filter.particles=20"]
PLACES = {"nose": 141, "mouth_left": 154, "mouth_right": 154, "lip_upper": 153, "lip_lower": 169}
ACROSS = {"nose": 160, "mouth_left": 139, "mouth_right": 181, "lip_upper": 160, "lip_lower": 160}


def of_target(rows, frame, target):
    return choose(rows.at(frame), target)


def begins(left):
    """Points of a face so many pixels to the left of where it is."""
    return "{points: {" + ", ".join(f"{part}: [{ACROSS[part] - left}, {y}]" for part, y in PLACES.items()) + "}}"


TWO = f"frame: 2\nanna: {begins(0)}\nben: {begins(10)}\n"
FORMS = ("csv", "json", "jsonl")


def run(out, clip, *args, forms="csv,json,jsonl", video=False):
    words = ["run", clip, "-o", out, "--format", forms, "-q", *args, *([] if video else ["--no-video"])]
    assert main([str(word) for word in words]) == 0
    return out


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    (folder / "two.yaml").write_text(TWO)
    face, part = FOLDER / "expressions.mp4", ["--stop", STOP]
    run(folder / "face", face, "--config", "factorized", *FEW, *part, video=True)
    run(folder / "searched", face, "--config", "face", "--init", detector().name, *FEW, *part)
    run(folder / "two", face, "--init", folder / "two.yaml", "--config", "factorized_transition", *FEW, *part)
    run(folder / "box", FOLDER / "textured.mp4", "--config", "contour_histogram_correlation", *FEW, *part)
    run(folder / "affine", FOLDER / "zoom.mp4", "--config", "adaptive_velocity", *FEW, *part)
    few = [word for t in ("head", "left_hand", "right_hand") for word in ("--set", f"targets.{t}.filter.particles=60")]
    run(folder / "hands", FOLDER / "signing.mp4", "--config", "head_hands", *few, *part)
    return folder


class Fixed:
    """A copy of a run, and what puts it right."""

    def __init__(self, run, folder):
        shutil.copytree(run, folder)
        self.folder = folder
        self.run = open_run(folder)
        with open_source(self.run.clip, fps=self.run.fps, stop=self.run.last + 1) as source:
            self.frames = list(source)
        self.read = []
        self.fixer = Fixer(self.run, self._frame)

    def _frame(self, index):
        self.read.append(index)
        return self.frames[index]

    def files(self):
        return {path.name: path.read_bytes() for path in sorted(self.folder.iterdir())}

    def again(self, out, *args, **more):
        """What a run from the corrected init file gives."""
        recipe = self.folder / "recipe.json"
        recipe.write_text(json.dumps({k: v for k, v in self.run.rows.header["recipe"].items() if k != "name"}))
        init = ["--config", recipe, "--init", self.folder / CORRECTED, "--stop", self.run.last + 1]
        return run(out, self.run.clip, *init, *args, **more)

    def close(self):
        self.fixer.close()


@pytest.fixture
def fixed(runs, tmp_path):
    made = []

    def make(name):
        made.append(Fixed(runs / name, tmp_path / name))
        return made[-1]

    yield make
    for one in made:
        one.close()


def points(target, frame, **given):
    return Correction(frame, target, TargetStart(points=given))


def now(fixer, frame, target):
    """The rows of a target in one frame."""
    return objects_of(of_target(fixer.rows, frame, target))


def rows_of(folder, where):
    """The lines of the CSV for which `where(frame, target)`."""
    lines = (folder / "trajectory.csv").read_text().splitlines()[1:]
    return [line for line in lines if where(int(line.split(",")[0]), line.split(",")[2])]


def frames_of(folder, form):
    lines = (folder / f"trajectory.{form}").read_text().splitlines()
    return [line.rstrip(",") for line in lines if line.startswith(('{"frame"', '{"type":"frame"'))]


# --- the same rows as a whole run ------------------------------------------------------------------------------------


def box(target, frame, *sides):
    return Correction(frame, target, TargetStart(box=tuple(map(float, sides))))


NOSE = points("face", 8, nose=(150.0, 130.5))
CASES = {
    "face": [NOSE, Correction(15, "face", absent=("lip_upper",)), points("face", 19, lip_upper=(161.0, 152.0))],
    "searched": [NOSE],
    "two": [
        points("ben", 9, nose=(158.25, 140.0)),
        points("anna", 14, mouth_left=(141.0, 155.0)),
        points("ben", 15, nose=(155.0, 139.0)),
    ],
    "box": [
        box("head", 7, 120, 60, 70, 76),
        Correction(12, "head", absent=True),
        box("head", 18, 125.5, 60, 74, 80),
    ],
    "affine": [box("face", 6, 120, 90, 66, 66), box("face", 13, 126, 84, 70, 70)],
}


@pytest.mark.parametrize(("name", "backwards"), [*((name, False) for name in CASES), ("face", True), ("two", True)])
def test_what_fix_writes_is_what_a_run_from_the_corrected_init_file_writes(fixed, tmp_path, name, backwards):
    """Byte by byte, in whatever order the corrections were made."""
    one = fixed(name)
    for correction in sorted(CASES[name], key=lambda c: c.frame, reverse=backwards):
        one.fixer.put([correction])
    save(one.fixer)
    again = one.again(tmp_path / "again")
    for form in FORMS:
        assert frames_of(one.folder, form) == frames_of(again, form)
    assert (one.folder / "trajectory.csv").read_bytes() == (again / "trajectory.csv").read_bytes()
    ours, theirs = (json.loads((folder / "trajectory.json").read_text()) for folder in (one.folder, again))
    assert list(ours["lost_frames"].items()) == list(theirs["lost_frames"].items())
    assert ours["init"]["corrections"] == theirs["init"]["corrections"]
    whole = json.loads((one.folder / "trajectory.jsonl").read_text().splitlines()[-1])
    assert whole["lost_frames"] == ours["lost_frames"] and whole["type"] == "footer"


def test_rows_before_a_correction_and_of_other_targets_stay_to_the_byte(fixed, runs):
    one = fixed("two")
    one.fixer.put([points("ben", 9, nose=(158.0, 140.0))])
    one.fixer.put([points("ben", 16, nose=(157.0, 141.0))])
    # only the frames from the correction on, and the first, which has taught what the parts look like
    assert one.read == [2, *range(9, STOP), *range(16, STOP)]
    save(one.fixer)

    def others(frame, target):
        return target == "anna" or frame < 9

    def bens(frame, target):
        return not others(frame, target)

    assert rows_of(one.folder, others) == rows_of(runs / "two", others)
    changed = zip(rows_of(one.folder, bens), rows_of(runs / "two", bens), strict=True)
    assert sum(new != old for new, old in changed) > 70
    parts = [part for row in _objects(one.folder, 9, "ben") for part in row["parts"]]
    assert [part["part"] for part in parts if part.get("by_hand")] == ["nose"]
    assert [part["status"] for part in parts if part.get("by_hand")] == ["init"]
    assert not [part for f in (8, 10) for part in _objects(one.folder, f, "ben")[0]["parts"] if "by_hand" in part]
    read_trajectory(one.folder / "trajectory.json")


def _objects(folder, frame, target):
    [found] = [one for one in json.loads((folder / "trajectory.json").read_text())["frames"] if one["frame"] == frame]
    return [one for one in found["targets"] if one["target"] == target]


def test_what_is_not_given_stays_where_the_rows_have_it(fixed):
    one = fixed("face")
    before = {part.part: (part.x, part.y) for part in now(one.fixer, 8, "face") if part.part != "box"}
    one.fixer.put([NOSE])
    [done] = one.fixer.corrections
    assert done.given.points == {"nose": (150.0, 130.5)}
    assert done.kept == {part: at for part, at in before.items() if part != "nose"}
    after = {part.part: (part.x, part.y) for part in now(one.fixer, 8, "face") if part.part != "box"}
    assert after == {**before, "nose": (150.0, 130.5)}
    one.fixer.put([Correction(12, "face", absent=("nose", "lip_lower"))])
    one.fixer.put([points("face", 16, nose=(150.0, 130.0))])
    assert one.fixer.find(16, "face").absent == ("lip_lower",)
    assert [part.status for part in now(one.fixer, 20, "face")].count("absent") == 1


def test_only_the_corrected_target_changes_where_targets_keep_off_each_other(fixed, runs):
    one = fixed("hands")
    assert one.run.recipe.exclusion is not None
    one.fixer.put([box("left_hand", 10, 95, 120, 40, 46)])
    save(one.fixer)

    def others(frame, target):
        return target != "left_hand" or frame < 10

    assert rows_of(one.folder, others) == rows_of(runs / "hands", others)
    assert rows_of(one.folder, lambda f, t: f == 10 and t == "left_hand") != rows_of(
        runs / "hands", lambda f, t: f == 10 and t == "left_hand"
    )


# --- undo, remove, stop, errors --------------------------------------------------------------------------------------


def text_of(fixer):
    """All rows, in the bytes of each form."""
    return [*csv_frames(fixer.rows), *json_frames(fixer.rows)]


def test_undo_gives_back_the_very_bytes(fixed):
    one = fixed("face")
    assert not one.fixer.can_undo and not one.fixer.changed
    was = [text_of(one.fixer)]
    for correction in (NOSE, points("face", 16, nose=(151.0, 131.0)), points("face", 4, nose=(159.0, 140.0))):
        one.fixer.put([correction])
        was.append(text_of(one.fixer))
    one.fixer.remove(16, "face")
    read = len(one.read)
    for expected in reversed(was):
        one.fixer.undo()
        assert text_of(one.fixer) == expected
    assert len(one.read) == read and not one.fixer.can_undo and not one.fixer.changed
    before = one.files()
    assert save(one.fixer) == [f"{one.folder}: nothing was corrected, all is as it was"]
    assert one.files() == before


def test_a_correction_that_is_taken_away_leaves_the_one_before_it(fixed):
    one = fixed("face")
    plain = text_of(one.fixer)
    one.fixer.put([NOSE])
    with_one = text_of(one.fixer)
    one.fixer.put([points("face", 16, nose=(151.0, 131.0))])
    one.read.clear()
    one.fixer.remove(16, "face")
    assert text_of(one.fixer) == with_one and one.read == []
    one.fixer.remove(8, "face")
    assert text_of(one.fixer) == plain and one.read == [] and not one.fixer.changed
    with pytest.raises(InputError, match="no correction at frame 8"):
        one.fixer.remove(8, "face")


def test_a_corrected_run_can_be_put_right_again(fixed, runs, tmp_path):
    """Also by taking away a correction that its files were made with."""
    one = fixed("face")
    one.fixer.put([NOSE])
    one.fixer.put([points("face", 16, nose=(151.0, 131.0))])
    save(one.fixer)
    two = Fixed(one.folder, tmp_path / "second")
    assert two.fixer.corrections == one.fixer.corrections
    two.fixer.remove(8, "face")
    save(two.fixer)

    def early(frame, _):
        return frame < 16

    assert rows_of(two.folder, early) == rows_of(runs / "face", early)
    assert rows_of(two.folder, lambda f, _: f >= 16) == rows_of(one.folder, lambda f, _: f >= 16)
    two.close()


def test_what_is_stopped_or_fails_leaves_the_rows_as_they_were(fixed):
    one = fixed("face")
    one.fixer.put([NOSE])
    before, corrections = text_of(one.fixer), one.fixer.corrections
    asked = []
    with pytest.raises(StoppedError):
        one.fixer.put([points("face", 12, nose=(150.0, 130.0))], stop=lambda: len(asked) > 4 or asked.append(1))
    del one.frames[20:]
    with pytest.raises(IndexError):
        one.fixer.put([points("face", 12, nose=(150.0, 130.0))])
    with pytest.raises(InputError, match=r"frame 99 cannot be corrected; the run can be from 1 to 23"):
        one.fixer.put([points("face", 99, nose=(150.0, 130.0))])
    with pytest.raises(InputError, match="in which it begins"):
        one.fixer.put([points("face", 0, nose=(150.0, 130.0))])
    with pytest.raises(InputError, match="there is no ben in the run; it has face"):
        one.fixer.put([points("ben", 9, nose=(150.0, 130.0))])
    with pytest.raises(InputError, match="outside"):
        one.fixer.put([points("face", 9, nose=(950.0, 130.0))])
    assert (text_of(one.fixer), one.fixer.corrections) == (before, corrections)


def test_a_clip_with_other_times_is_refused(fixed):
    one = fixed("face")
    one.frames[12] = replace(one.frames[12], time_s=9.0)
    with pytest.raises(InputError, match=r"frame 12 is at 9.0000 s, and in the run at 0.4800 s"):
        one.fixer.put([NOSE])


@pytest.mark.parametrize("name", ["trajectory.jsonl", CORRECTED, "annotated.mp4"])
def test_a_save_that_fails_leaves_the_folder_as_it_was(fixed, monkeypatch, name):
    one = fixed("face")
    one.fixer.put([NOSE])
    before = one.files()

    def full(path, *_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    if name == CORRECTED:
        monkeypatch.setattr(saving, "as_yaml", full)
    elif name == "annotated.mp4":
        monkeypatch.setattr(saving, "repaint", lambda *_, **__: full(None))
    else:
        whole = saving.write_rows

        def write(form, *args, **options):
            whole(form, *args, **options)
            if name == f"trajectory.{form}":
                full(None)

        monkeypatch.setattr(saving, "write_rows", write)
    with pytest.raises(OutputError, match=r"No space left on device; free some space, and save again"):
        save(one.fixer)
    assert one.files() == before and one.fixer.changed
    monkeypatch.undo()
    save(one.fixer)
    assert one.files().keys() == before.keys() | {CORRECTED}


def test_the_video_is_painted_as_a_run_from_the_corrected_init_file_paints_it(fixed, tmp_path, monkeypatch):
    """Without the particles: what is by hand is marked, and no trail leads there."""
    painted, write = [], VideoWriter.write
    monkeypatch.setattr(Overlay, "_cloud", lambda *_: None)
    monkeypatch.setattr(VideoWriter, "write", lambda self, image, at: (painted.append(image), write(self, image, at)))
    one = fixed("face")
    one.fixer.put([NOSE])
    save(one.fixer)
    one.again(tmp_path / "again", video=True)
    apart = [float(cv2.absdiff(a, b)[30:].mean()) for a, b in zip(painted[:STOP], painted[STOP:], strict=True)]
    # rows do not tell how ellipses lean, nor of a turned box more than their decimals
    assert max(apart) < 0.1 and sorted(apart)[STOP * 3 // 4] < 0.03


def test_without_video_the_old_one_stays_and_says_so(fixed):
    one = fixed("face")
    before = one.files()["annotated.mp4"]
    one.fixer.put([NOSE])
    said = save(one.fixer, video=False)
    assert one.files()["annotated.mp4"] == before and "left as it was" in said[-1]


# --- init files ------------------------------------------------------------------------------------------------------


def test_an_init_file_with_gaps_gives_what_a_run_from_it_gives(fixed, tmp_path):
    one = fixed("face")
    init = tmp_path / "c.yaml"
    init.write_text(
        (FOLDER / "expressions.init.yaml").read_text() + "corrections:\n- {frame: 15, absent: [lip_upper]}\n"
        "- {frame: 8, points: {nose: [150, 130.5]}}\n- {frame: 19, points: {mouth_left: [140, 150]}}\n"
    )
    one.fixer.apply(corrections_of(init, one.run))
    save(one.fixer)
    whole = run(tmp_path / "whole", one.run.clip, "--config", "factorized", "--init", init, *FEW, "--stop", STOP)
    assert (one.folder / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    assert len(one.fixer._past) == 1


def test_an_init_file_that_begins_elsewhere_is_refused(fixed, tmp_path):
    one, init = fixed("two"), tmp_path / "i.yaml"
    init.write_text(TWO.replace("frame: 2", "frame: 3"))
    with pytest.raises(InputError, match="begins at frame 3, and the run at 2"):
        corrections_of(init, one.run)
    init.write_text(TWO.replace("[150, 141]", "[151, 141]"))
    with pytest.raises(InputError, match="ben does not begin where it does in the run"):
        corrections_of(init, one.run)


def test_what_is_not_saved_is_kept_for_the_next_time(fixed):
    one = fixed("face")
    assert keep(one.fixer) is None
    one.fixer.put([NOSE])
    path = keep(one.fixer)
    assert path == one.folder / UNSAVED
    assert corrections_of(path, one.run) == one.fixer.corrections
    save(one.fixer)
    assert not path.exists()


def test_what_is_dragged_goes_over_what_its_frame_has():
    def merged(frame, target, box, points, absent, before, parts):
        return history.merged(Correction(frame, target, TargetStart(box, points), absent=absent), before, parts)

    parts = ("a", "b", "c")
    old = Correction(5, "t", TargetStart(points={"a": (1, 1)}), kept={"b": (2, 2)}, absent=("c",))
    new = merged(5, "t", None, {"b": (3, 3)}, (), old, parts)
    assert (new.given.points, new.kept, new.absent) == ({"a": (1, 1), "b": (3, 3)}, {}, ("c",))
    new = merged(5, "t", None, {"c": (3, 3)}, ("a",), old, parts)
    assert (new.given.points, new.kept, new.absent) == ({"c": (3, 3)}, {"b": (2, 2)}, ("a",))
    assert merged(5, "t", None, {}, ("a", "b"), old, parts).absent is True
    assert merged(5, "t", None, {}, True, old, parts) == Correction(5, "t", absent=True)
    assert merged(5, "t", (1, 2, 9, 9), {}, (), None, ("box",)) == Correction(5, "t", TargetStart(box=(1, 2, 9, 9)))
    assert merged(5, "t", None, {}, ("box",), None, ("box",)).absent is True
    assert merged(5, "t", (1, 2, 9, 9), {}, ("box",), None, ("box",)) == Correction(5, "t", absent=True)
    # of points, a box alone places those that are there; beside points it says nothing
    new = merged(5, "t", (1, 2, 9, 9), {}, ("a",), old, parts)
    assert new == Correction(5, "t", TargetStart(box=(1, 2, 9, 9)), absent=("a",))
    assert merged(5, "t", (1, 2, 9, 9), {"b": (3, 3)}, (), old, parts).given.points == {"a": (1, 1), "b": (3, 3)}
    assert merged(5, "t", None, {}, ("b",), old, parts).kept == {}
    gone = Correction(5, "t", absent=True)
    assert merged(5, "t", None, {"b": (3, 3)}, (), gone, parts).absent == ("a", "c")
    unlearned = replace(old, learn=False)
    assert merged(5, "t", None, {"b": (3, 3)}, (), unlearned, parts).learn is False
    assert merged(5, "t", None, {}, ("a", "b"), unlearned, parts) == gone  # an init file refuses learn: beside it


# --- other clips, other folders --------------------------------------------------------------------------------------


def test_every_recipe_is_read_back_from_the_header_as_it_was(tmp_path):
    for path in shipped_recipes():
        wanted = to_dict(load_recipe(path.stem))
        header = json.loads(json.dumps({"name": path.stem, **wanted}))
        found = recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
        assert found.name == path.stem
        got = to_dict(found)
        for mine, theirs in zip(
            (got, *got.get("targets", {}).values()), (wanted, *wanted.get("targets", {}).values()), strict=True
        ):
            for section, key in (("prior", "file"), ("confidence", "calibration")):
                if (theirs.get(section) or {}).get(key):
                    assert Path(mine[section].pop(key)).samefile(path.parent / theirs[section].pop(key))
        assert got == wanted


def test_files_that_a_recipe_names_are_found_again_or_missed_in_one_line(tmp_path):
    shipped = load_recipe("factorized")
    header = {"name": "mine", **to_dict(shipped)}
    header["prior"]["file"] = "my.npz"
    with pytest.raises(InputError, match=r'its recipe names the file "my.npz", which is in none of') as missed:
        recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
    assert "\n" not in str(missed.value)
    shutil.copy(shipped.path.parent / "mouth_prior.npz", tmp_path / "my.npz")
    found = recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
    assert found.prior.file == str(tmp_path / "my.npz") and header["prior"]["file"] == "my.npz"
    header["confidence"]["calibration"] = "my.json"
    with pytest.raises(InputError, match=r'its recipe names the file "my.json", which is in none of'):
        recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
    (tmp_path / "my.json").touch()
    found = recipe_of(tmp_path / "trajectory.json", header, [tmp_path])
    assert found.confidence.calibration == str(tmp_path / "my.json")
    header["filter"]["particles"] = "many"
    with pytest.raises(InputError, match=r"does not know its recipe \(filter"):
        recipe_of(tmp_path / "trajectory.json", header, [tmp_path])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda j: j["source"].update(path="gone.mp4"), "gone.mp4: is not there, and the run in"),
        (lambda j: j["init"].update(frame=1), "its rows begin with frame 0, its start with 1"),
        (lambda j: j["init"]["targets"].update(ben=j["init"]["targets"]["face"]), "its recipe follows face/nose, face"),
        (
            lambda j: j["init"].update(corrections=[{"frame": 5, "target": "ben"}]),
            "init.corrections is not as facetrack run writes",
        ),
        (
            lambda j: j["init"].update(corrections=[{"frame": 5}]),
            "init.corrections.0.target is not as facetrack run writes it",
        ),
        (lambda j: j["init"]["targets"]["face"].pop("points"), "its start and its recipe do not go together"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(runs, tmp_path, change, said):
    lines = (runs / "face" / "trajectory.jsonl").read_text().splitlines()
    head, foot = json.loads(lines[0]), json.loads(lines[-1])
    both = {**head, **foot}
    change(both)
    head, foot = ({key: both[key] for key in one} for one in (head, foot))
    dumps = [json.dumps({**one, "type": kind}) for one, kind in ((head, "header"), (foot, "footer"))]
    dumps[1] = '{"type":"footer",' + dumps[1][1:].replace(', "type": "footer"', "").replace('"type": "footer", ', "")
    (tmp_path / "trajectory.jsonl").write_text("\n".join([dumps[0], *lines[1:-1], dumps[1]]) + "\n")
    with pytest.raises(InputError) as refused:
        open_run(tmp_path)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_a_folder_without_json_and_a_clip_of_another_size_are_refused(fixed, tmp_path):
    (tmp_path / "trajectory.csv").write_text("x")
    with pytest.raises(InputError, match=r"has trajectory.csv alone"):
        open_run(tmp_path)
    one = fixed("face")
    with pytest.raises(InputError, match="is 64x48, not 320x240 pixels as in the run; name its clip with --clip"):
        check_size(one.run, (64, 48))
    with pytest.raises(InputError, match=r"lamp.mp4: is not the clip .*SHA-256 differs.*; name its clip with --clip"):
        open_run(one.folder, FOLDER / "lamp.mp4")
