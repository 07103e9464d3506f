"""Runs that are corrected though they are unusual; what is tracked again; and saves that are interrupted."""

import contextlib
import errno
import gc
import json
import pickle
import shutil
import tempfile
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor import save as saving
from facetrack_cli.editor.history import Fixer, Task, corrections_of, recorded_footprint, spans_of
from facetrack_cli.editor.save import keep, save
from facetrack_cli.editor.web.fix_session import overview
from facetrack_cli.run_folder.finished import open_run
from facetrack_cli.run_folder.lease import NOTE, FolderLease
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from facetrack_cli.trajectory.writers import csv_frames
from facetrack_cli.video.seek import Frames
from facetrack_cli.video.source import open_source
from tests.support.hands_run import FEW as OF_HANDS
from tests.support.leases import abandon
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"
FEW = ["--set", "filter.particles=20", "--no-video", "-q"]


def run(*words):
    assert main(["run", *map(str, words), *FEW]) == 0


@contextlib.contextmanager
def fixing(folder):
    opened = open_run(folder)
    with (
        Frames(opened.clip, fps=opened.fps) as frames,
        contextlib.closing(Fixer(opened, frames.read)) as fixer,
    ):
        yield fixer


def put(folder, *corrections):
    """Have these corrections, one after the other, and save."""
    with fixing(folder) as fixer:
        for one in corrections:
            fixer.put([one])
        return save(fixer)


def nose(frame, x, y):
    return Correction(frame, "face", TargetStart(points={"nose": (x, y)}))


@pytest.fixture(scope="module")
def leaving(tmp_path_factory):
    """A folder of images in which a face leaves the image to the left, and where it begins."""
    folder = tmp_path_factory.mktemp("leaving")
    pictures = folder / "shots"
    pictures.mkdir()
    with open_source(FOLDER / "expressions.mp4", stop=12) as source:
        for frame in source:
            left = 120 + 3 * frame.index
            cv2.imwrite(str(pictures / f"{frame.index:02}.png"), frame.bgr[90:200, left : left + 120])
    places = "nose: [40, 51], mouth_left: [19, 64], mouth_right: [61, 64], lip_upper: [40, 63], lip_lower: [40, 79]"
    (folder / "shots.init.yaml").write_text(f"frame: 0\nface:\n  points: {{{places}}}\n")
    return pictures


def test_a_part_beyond_the_border_is_kept_there(leaving, tmp_path):
    """The init file is read again, and the run corrected a second time."""
    run(leaving, "-o", tmp_path / "out")
    put(tmp_path / "out", nose(11, 6, 50))
    with fixing(tmp_path / "out") as fixer:
        opened = fixer.run
        assert opened.start.corrections[0].kept["mouth_left"][0] < -0.5
    run(leaving, "-o", tmp_path / "again", "--init", tmp_path / "out" / CORRECTED)
    ours, theirs = ((tmp_path / folder / "trajectory.csv").read_bytes() for folder in ("out", "again"))
    assert ours == theirs
    put(tmp_path / "out", nose(10, 9, 50))


# --- init files that say more, or less -------------------------------------------------------------------------------

INIT = (FOLDER / "expressions.init.yaml").read_text()
LATE = INIT + "corrections:\n- {frame: 5, points: {nose: [158, 140]}}\n- {frame: 31, points: {nose: [150, 140]}}\n"


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A run whose init file corrects frame 5, and frame 31, to which the run does not come."""
    folder = tmp_path_factory.mktemp("short")
    (folder / "late.yaml").write_text(LATE)
    words = ["--init", folder / "late.yaml", "--stop", "12", "--format", "csv,json,jsonl"]
    run(CLIP, "-o", folder / "out", *words)
    return folder / "out"


def copied(run, folder):
    shutil.copytree(run, folder)
    return folder


def test_a_correction_past_the_end_is_kept_for_a_longer_run(short, tmp_path):
    out = copied(short, tmp_path / "out")
    said = put(out, nose(8, 159, 140))
    assert said[-1] == f"{out / CORRECTED}: the correction of face at frame 31 is past the end, frame 11"
    assert [one.frame for one in read_init(out / CORRECTED).corrections] == [5, 8, 31]
    run(CLIP, "-o", tmp_path / "again", "--init", out / CORRECTED, "--stop", "12")
    assert (out / "trajectory.csv").read_bytes() == (tmp_path / "again" / "trajectory.csv").read_bytes()
    with fixing(out) as fixer:
        assert [
            one["frame"] for one in overview(fixer.rows, 3, fixer.corrections, lost_below={"face": 0.5})["corrections"]
        ] == [5, 8]
        fixer.remove(31, "face")
        assert fixer.changed and [one.frame for one in fixer.corrections] == [5, 8]
        with pytest.raises(InputError, match="frame 31 cannot be corrected; the run can be from 1 to 11"):
            fixer.put([nose(31, 159, 140)])


def test_the_init_file_of_the_run_itself_changes_nothing(short, tmp_path):
    """Though it leaves open where the other points were: the rows say that."""
    out = copied(short, tmp_path / "out")
    with fixing(out) as fixer:
        assert set(fixer.corrections[0].kept) == {"mouth_left", "mouth_right", "lip_upper", "lip_lower"}
        fixer.apply(fixer.run.start.corrections)
        assert not fixer.changed and "nothing was corrected" in save(fixer)[0]
        fixer.apply(())
        assert fixer.changed and fixer.corrections == ()


def test_rows_before_a_correction_stay_though_its_frame_is_tracked_once_more(short, tmp_path):
    """To see where the parts are that the new one leaves open."""
    with fixing(copied(short, tmp_path / "out")) as fixer:
        fixer.apply((nose(5, 159, 140),))
        assert [(track.first, track.place is None) for track in fixer._step.tracks["face"]] == [(0, True), (5, False)]
        recorded, now = ([*csv_frames(rows.between(0, 5))] for rows in (fixer.run.rows, fixer.rows))
        assert now == recorded
        kept = fixer.run.start.corrections[0]
        assert kept.given != fixer.corrections[0].given and fixer.find(5, "face").kept["lip_lower"][1] > 160


def signing(out, *words):
    """A run of head and hands."""
    given = ["run", FOLDER / "signing.mp4", "-o", out, "--config", "head_hands", "--no-video", "-q", *OF_HANDS, *words]
    assert main([str(word) for word in given]) == 0


@pytest.mark.parametrize("called", ["face", "head", "somebody"])
def test_an_init_file_means_the_targets_that_a_run_takes_it_for(tmp_path, called):
    """A face alone is the head, and hands that it does not speak of are where they were found."""
    init = tmp_path / "i.yaml"
    init.write_text(f"frame: 0\n{called}: {{box: [128, 40, 64, 76]}}\n")
    signing(tmp_path / "out", "--init", init, "--stop", "4")
    init.write_text(init.read_text() + f"corrections:\n- {{frame: 2, {called}: {{absent: true}}}}\n")
    with fixing(tmp_path / "out") as fixer:
        assert corrections_of(init, fixer.run) == (Correction(2, "head", absent=True),)
        hands = "corrections:\n- {frame: 2, left_hand: {absent: true}}\n"
        init.write_text(f"frame: 0\nleft_hand: {{box: [1, 40, 64, 76]}}\n{hands}")
        with pytest.raises(InputError, match="left_hand does not begin where it does in the run"):
            corrections_of(init, fixer.run)


@pytest.mark.nightly
def test_steps_that_can_be_taken_back_hold_nothing_of_every_frame(short, tmp_path):
    """The overview is asked for after each of them, and there may be a thousand."""
    with fixing(copied(short, tmp_path / "out")) as fixer:
        for frame in (8, 9, 10):
            before = fixer.rows
            overview(before, 5, lost_below={"face": 0.5})
            fixer.put([nose(frame, 159, 140)])
        gone = weakref.ref(fixer.rows)
        assert len(fixer._past) == 3 and len(pickle.dumps(fixer._past)) < 5_000  # rows of 12 frames are 15,000 bytes
        assert len(pickle.dumps(before)) > 10_000
        fixer.undo()
        gc.collect()
        assert gone() is None  # it lies in the temporary file
        assert [*csv_frames(fixer.rows)] == [*csv_frames(before)] != [*csv_frames(fixer.run.rows)]


def test_a_frame_that_is_corrected_again_has_one_correction_and_the_same_again_is_no_step(short, tmp_path):
    with fixing(copied(short, tmp_path / "out")) as fixer:
        for x in (159, 157, 157):
            fixer.put([nose(8, x, 140)])
        assert [(one.frame, one.given.points) for one in fixer.corrections[:2]] == [
            (5, {"nose": (158, 140)}),
            (8, {"nose": (157, 140)}),
        ]
        assert len(fixer.corrections) == 3
        fixer.undo()
        fixer.undo()
        assert not fixer.can_undo and not fixer.changed


# --- folders that are not as a run left them --------------------------------------------------------------------------


def test_a_file_is_no_run(tmp_path):
    (tmp_path / "out").write_text("x")
    with pytest.raises(InputError, match="out: is a file; name the folder of a run"):
        open_run(tmp_path / "out")


def test_without_any_place_for_a_while_it_is_said_so(short, tmp_path, monkeypatch):
    out = copied(short, tmp_path / "out")
    nowhere = FileNotFoundError(errno.ENOENT, "No usable temporary directory found")
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: (_ for _ in ()).throw(nowhere))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: (_ for _ in ()).throw(nowhere))
    with pytest.raises(OutputError, match="No usable temporary directory found; set TMPDIR to a folder"):
        put(out)


def test_a_disk_that_is_full_for_a_while_leaves_the_rows_as_they_were(short, tmp_path):
    with fixing(copied(short, tmp_path / "out")) as fixer:
        fixer.put([nose(8, 159, 140)])
        before, file = [*csv_frames(fixer.rows)], fixer._store._file

        class Full:
            """It takes some bytes, and no more."""

            def __init__(self):
                self.left = 1000

            def write(self, data):
                if not self.left:
                    raise OSError(errno.ENOSPC, "No space left on device")
                self.left -= (written := file.write(data[: self.left]))
                return written

            def __getattr__(self, name):
                return getattr(file, name)

        fixer._store._file = Full()
        with pytest.raises(OutputError, match="No space left on device; free some space, or set TMPDIR"):
            fixer.put([nose(9, 159, 140)])
        assert [*csv_frames(fixer.rows)] == before and [one.frame for one in fixer.corrections] == [5, 8, 31]
        fixer._store._file = file
        fixer.put([nose(9, 159, 140)])
        assert [*csv_frames(fixer.rows)][:9] == before[:9] and [*csv_frames(fixer.rows)] != before
        fixer.undo()
        assert [*csv_frames(fixer.rows)] == before


def test_a_report_that_is_there_is_said_to_be_of_before(short, tmp_path):
    out = copied(short, tmp_path / "out")
    (out / "report.html").write_text("x")
    (out / "trajectory.mot.txt").write_text("x")
    said = (
        f"{out}: older than the track: report.html, trajectory.mot.txt; make anew: facetrack report {out} --overwrite"
    )
    assert put(out, nose(8, 159, 140))[-1] == f"{said}, facetrack export --to FORMAT {out} --overwrite"
    assert (out / "report.html").read_text() == "x"


# --- what is tracked again ---


def test_frames_that_several_tasks_want_are_read_once():
    def frames(*wanted):
        return spans_of([Task("a", None, first, stop) for first, stop in wanted])

    assert frames((5, 20), (6, 10)) == frames((6, 10), (5, 20)) == [(5, 20)]
    assert frames((5, 8), (8, 10)) == frames((5, 9), (7, 10)) == [(5, 10)]
    assert frames((9, 12), (1, 3), (1, 2)) == [(1, 3), (9, 12)]
    assert frames() == []


@pytest.fixture(scope="module")
def hands(tmp_path_factory):
    out = tmp_path_factory.mktemp("hands") / "out"
    signing(out, "--stop", "9")
    return out


def test_targets_that_are_tracked_together_see_each_other_as_they_are_now(hands, monkeypatch):
    with fixing(hands) as fixer:
        seen = {}

        class Spy(Fixer):
            def _footprints(self, live, now, index):
                seen[index, live.task.target] = footprints = super()._footprints(live, now, index)
                return footprints

        monkeypatch.setattr(fixer, "__class__", Spy)
        left, right = (95.0, 120.0, 40.0, 46.0), (180.0, 110.0, 44.0, 50.0)
        given = {"left_hand": left, "right_hand": right}
        fixer.put([Correction(4, name, TargetStart(box=box)) for name, box in given.items()])

        def place(frame, name):
            one = fixer.rows.at(frame).find(name, "box")
            return pytest.approx([one.x[0], one.y[0]], abs=6e-4)

        # the first of them is known in this frame, the second where it is expected from the one before
        for frame in (5, 8):
            head, first = seen[frame, "right_hand"]
            assert first.centre.tolist() == place(frame, "left_hand")
            assert head.centre.tolist() == place(frame, "head")
        assert seen[4, "right_hand"][1].centre.tolist() == [left[0] + 19.5, left[1] + 22.5]
        recorded = fixer.run.rows.at(3).find("right_hand", "box")
        assert seen[4, "left_hand"][1].centre.tolist() == [recorded.x[0], recorded.y[0]]  # which has not begun
        ahead = seen[5, "left_hand"][1]
        assert ahead.centre.tolist() == [right[0] + 21.5, right[1] + 24.5] and ahead.half.tolist() == [22, 25]


def test_what_is_recorded_of_points_and_of_what_is_gone_covers_nothing(hands, tmp_path):
    run(CLIP, "-o", tmp_path / "out", "--stop", "4")
    with fixing(tmp_path / "out") as fixer:
        assert recorded_footprint(fixer.rows, 2, "face") is None
    with fixing(hands) as fixer:
        assert np.isfinite(recorded_footprint(fixer.rows, 5, "head").centre).all()
        fixer.put([Correction(4, "head", absent=True)])
        assert recorded_footprint(fixer.rows, 5, "head") is None


# --- a save that is interrupted: the run is as it was, or as it was to be ---


class Killed(BaseException):
    """Nothing is done after it."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a run, and its files once they are corrected."""
    folder = tmp_path_factory.mktemp("made")
    words = [
        "run",
        CLIP,
        "--config",
        "factorized",
        "-o",
        folder / "out",
        "--set",
        "filter.particles=20",
        "--stop",
        "8",
        "-q",
    ]
    assert main([str(word) for word in [*words, "--format", "csv,json,jsonl"]]) == 0
    shutil.copytree(folder / "out", folder / "after")
    put(folder / "after", nose(4, 158, 140))
    return folder / "out", files_of(folder / "after")


@pytest.fixture
def out(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "out")
    return tmp_path / "out"


def files_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "annotated.mp4"}


@pytest.mark.parametrize("moment", [0, 1, 3, 5])
def test_a_save_that_is_killed_is_finished_by_who_opens_the_run_next(made, out, monkeypatch, moment):
    """Before the files are listed in the note of the lock, and at files that take over."""
    before, after, done = files_of(out), made[1], []
    replace = Path.replace

    def kill(*_):
        raise Killed

    def torn(self, to):
        if to.name == NOTE:
            return replace(self, to)
        if len(done) == moment - 1:
            raise Killed
        done.append(self)
        return replace(self, to)

    with fixing(out) as fixer, monkeypatch.context() as patch:
        fixer.put([nose(4, 158, 140)])
        keep(fixer)
        patch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
        patch.setattr(Path, "replace", torn)
        patch.setattr(FolderLease, "__exit__", lambda lease, *_: abandon(lease))
        if moment == 0:
            patch.setattr(FolderLease, "prepare", kill)
        with pytest.raises(Killed):
            save(fixer)
    whole = moment > 0
    opened = open_run(out)
    assert [one.frame for one in opened.start.corrections] == ([4] if whole else [])
    assert (out / UNSAVED).exists() != whole
    if not whole:
        assert {name: files_of(out)[name] for name in before} == before
        put(out, nose(4, 158, 140))
    found = files_of(out)
    assert {name: found.pop(name) for name in after} == after
    assert not found


@pytest.mark.parametrize("name", ["trajectory.csv", "trajectory.json", "annotated.mp4", CORRECTED, "run.json"])
def test_links_in_the_folder_of_a_run_are_refused(out, tmp_path, name):
    kept = tmp_path / "elsewhere"
    kept.write_bytes((out / name).read_bytes() if (out / name).exists() else b"mine")
    (out / name).unlink(missing_ok=True)
    (out / name).symlink_to(kept)
    before = files_of(out)
    with pytest.raises(OutputError, match=f"{name}: is a link, and what it leads to is not replaced"):
        put(out, nose(4, 158, 140))
    assert files_of(out) == before and (out / name).is_symlink()


def test_a_folder_in_the_place_of_the_init_file_is_refused_before_anything_is_replaced(out):
    before = files_of(out)
    (out / CORRECTED).mkdir()
    with pytest.raises(OutputError, match=r"corrected.init.yaml: is a folder, where a file is to be"):
        put(out, nose(4, 158, 140))
    (out / CORRECTED).rmdir()
    assert files_of(out) == before


def test_a_run_that_is_made_anew_while_it_is_saved_is_not_replaced(out, monkeypatch):
    def slow(start, clip, real=saving.as_yaml):
        (out / "trajectory.csv").write_text("another run")
        return real(start, clip)

    monkeypatch.setattr(saving, "as_yaml", slow)
    before = files_of(out)
    with pytest.raises(OutputError, match=r"trajectory.csv: was written by somebody else since it was opened"):
        put(out, nose(4, 158, 140))
    assert files_of(out) == {**before, "trajectory.csv": b"another run"}


def test_where_nothing_is_corrected_any_more_the_files_do_not_speak_of_corrections(made, out):
    before = files_of(out)
    put(out, nose(4, 158, 140))
    with fixing(out) as fixer:
        fixer.remove(4, "face")
        save(fixer)
    after = files_of(out)
    assert b"corrections" not in after.pop(CORRECTED)
    # the video is painted anew from the rows, which have three decimals
    runs = [json.loads(files.pop("run.json")) for files in (before, after)]
    videos = [run["files"].pop("annotated.mp4") for run in runs]
    assert after == before and runs[0] == runs[1] and all(videos)
