"""facetrack fix without a browser: what the page requests, the command, and what is interrupted."""

import contextlib
import os
import shutil
import signal
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.types import Correction
from facetrack_cli.editor import fixer as saving
from facetrack_cli.editor.fix_session import doubtful, overview
from facetrack_cli.editor.fixer import Fixer
from facetrack_cli.run_folder.manifest import write_rows
from facetrack_cli.runs.finished import open_run
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trajectory.reader import CORRECTED, UNSAVED
from facetrack_cli.trajectory.trajectory import Collector
from tests.support import results
from tests.support.hands_run import hands_run
from tests.support.page_client import Client, fixing
from tests.support.samples import FOLDER
from tests.support.terminal import refusal

CLIP = FOLDER / "expressions.mp4"
INIT = CLIP.with_suffix(".init.yaml").read_text()
STOP = 20
NOSE = {"points": {"nose": [150.0, 130.5]}}
MADE = ("--config", "factorized", "--set", "filter.particles=20", "--stop", str(STOP), "-q")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """The folders of two runs: `out`, of a face, and `hands`."""
    folder = tmp_path_factory.mktemp("clips")
    assert main(["run", str(CLIP), "-o", str(folder / "out"), *MADE, "--no-video"]) == 0
    hands_run(folder / "hands")
    return folder


@pytest.fixture
def out(clips, tmp_path):
    return shutil.copytree(clips / "out", tmp_path / "out")


class Page(Client):
    """A run's page and one window of it."""

    def __init__(self, folder, stack):
        self.session, url = stack.enter_context(fixing(folder))
        super().__init__(url)
        stack.callback(self.close)
        self.fixer, self.frames = self.session.fixer, self.session.frames

    def post(self, path, /, **body):
        """What is answered, once the job that it begins is done."""
        got = super().post(path, **body)
        if got.status == 200:
            self.idle()
        return got

    def track(self, frame, learn=None, **targets):
        """Drag, and have it tracked."""
        assert self.put_draft(frame, **targets).status == 200
        return self.post("track", **(learn or {}))

    def idle(self):
        return self.until(lambda state: state["job"] is None)

    def rows(self, first=0, last=STOP - 1):
        return self.get(f"api/rows?first={first}&last={last}").json["frames"]


@pytest.fixture
def page(out, clips, tmp_path):
    """Opens a run's page: page(name)."""
    with contextlib.ExitStack() as stack:

        def make(name="out"):
            if name != "out":
                shutil.copytree(clips / name, tmp_path / name)
            return Page(tmp_path / name, stack)

        yield make


def test_two_hands_change_their_names_from_a_frame_on_and_a_box_is_confirmed_whole(page):
    one = page("hands")
    before = one.fixer.rows
    assert one.post("exchange", frame=5).status == 200
    after = one.fixer.rows
    for name, other in (("left_hand", "right_hand"), ("right_hand", "left_hand")):
        was, now = before.find(other, "box"), after.find(name, "box")
        np.testing.assert_allclose(now.boxes[5], was.boxes[5], atol=0.02)
        np.testing.assert_array_equal(now.x[:5], before.find(name, "box").x[:5])
        assert np.hypot(now.x[7] - was.x[7], now.y[7] - was.y[7]) < 0.5 * was.w[7]
    assert [(c.frame, c.target) for c in one.fixer.corrections] == [(5, "left_hand"), (5, "right_hand")]
    assert one.post("exchange", frame=0).status == 200 and "frame 0 cannot be corrected" in one.idle()["message"]
    assert one.post("confirm", frame=3, target="left_hand", part="box").status == 200
    assert one.fixer.find(3, "left_hand").confirmed is True
    assert one.fixer.rows.find("left_hand", "box").by_hand.nonzero()[0].tolist() == [3, 5]
    got = page().post("exchange", frame=5)
    assert got.status == 422 and "there are no two hands in frame 5" in got.json["error"]


def test_what_the_page_receives_of_the_run(page, out):
    one = page()
    about = one.get("api/session").json
    assert (about["mode"], about["clip"], about["recipe"], about["learns"]) == ("fix", CLIP.name, "factorized", True)
    assert about["size"] == [320, 240] and about["saves_to"] == str(out) and not about["free"]
    assert about["frames"] == {"first": 0, "last": STOP - 1, "exact": True}
    [required] = about["requirements"]
    assert (required["target"], required["box"], required["points"][0]) == ("face", "optional", "nose")
    assert required["about"]["nose"] == "the tip of the nose"
    assert one.get("api/frame?frame=19").status == 200 and one.get("api/frame?frame=20").status == 422
    got = one.get("api/rows?first=5&last=9999").json
    assert got["first"] == 5 and len(got["frames"]) == STOP - 5 and got["parts"][0] == ["face", "nose"]
    row = results.file_rows(out / "trajectory.csv")[5 * 5]
    assert got["frames"][0][0] == [row.x, row.y, row.w, row.h, None, row.confidence, "tracked", False, None]
    assert [one.get(f"api/rows?first={query}").status for query in ("a&last=9", "1")] == [400, 400]
    found = one.get("api/overview?bins=7").json
    assert (len(found["least"]), found["last"], found["corrections"]) == (7, STOP - 1, [])


def test_what_is_dragged_is_tracked_undone_and_removed(page):
    one = page()
    before = one.rows()
    assert one.track(8, face=NOSE).status == 200
    state = one.state()
    assert (state["rows_revision"], state["can_undo"], state["message"]) == (1, True, None)
    assert state["draft"] == {"frame": 8, "targets": {}}  # it has become a correction
    after = one.rows()
    assert after[:8] == before[:8] and all(new != old for new, old in zip(after[8:], before[8:], strict=True))
    nose, corner = after[8][:2]
    assert (nose[:2], nose[6:8]) == ([150.0, 130.5], ["init", True])
    assert (corner[:2], corner[7]) == (before[8][1][:2], False)
    [correction] = one.get("api/overview").json["corrections"]
    assert (correction["frame"], correction["target"]) == (8, "face")
    assert correction["points"] == {"nose": [150.0, 130.5]} and correction["absent"] == []
    assert one.track(8, face={"absent": ["lip_upper"]}).status == 200  # over what is there
    hidden = one.rows(8, 8)[0]
    assert hidden[0][:2] == [150.0, 130.5] and hidden[3] == [None] * 6 + ["absent", True, None]
    for expected in (after, before):
        assert one.post("undo").status == 200
        assert one.rows() == expected
    assert one.post("undo").status == 422 and not one.state()["can_undo"]
    for said, learn in (({"learn": False}, False), ({}, None)):
        assert one.track(8, said, face=NOSE).status == 200
        assert [c.learn for c in one.fixer.corrections] == [learn], "what something covers is not learned"
    refused = one.track(8, {"learn": "no"}, face=NOSE)
    assert refused.status == 400 and refused.json["error"].startswith("learn:")
    for frame, target, status in ((8, "ben", 422), ("8", "face", 400), (8, "face", 200)):
        assert one.post("remove", frame=frame, target=target).status == status
    assert one.rows() == before and one.get("api/overview").json["corrections"] == []


def test_what_cannot_be_tracked_is_refused_in_one_line(page):
    one = page()
    for targets in ({"face": {}}, {"ben": NOSE}):
        got = one.track(5, **targets)
        assert got.status == 422 and "nothing is corrected in frame 5" in got.json["error"]
    for frame, target, said in (
        (0, NOSE, "frame 0 cannot be corrected, in which it begins"),
        (5, {"points": {"chin": [1, 1]}}, "has chin; what is followed is nose"),
    ):
        assert one.track(frame, face=target).status == 200
        message = one.idle()["message"]
        assert said in message and "\n" not in message
    got = one.put_draft(STOP, face=NOSE)
    assert got.status == 422 and "there is no frame 20; they go from 0 to 19" in got.json["error"]
    assert one.state()["rows_revision"] == 0


def test_while_a_job_runs_nothing_else_is_begun_and_an_error_leaves_all_as_it_was(page, monkeypatch):
    one, go = page(), threading.Event()
    before, read, whole = one.rows(), one.frames.read, Fixer._track
    monkeypatch.setattr(one.fixer, "_read", lambda n: read(n) if n < 12 else read(99_999))
    one.track(8, face=NOSE)
    state = one.state()
    assert "there is no frame 99999" in state["message"] and state["draft"]["frame"] == 8
    assert (state["rows_revision"], state["can_undo"]) == (0, False) and one.rows() == before
    monkeypatch.setattr(one.fixer, "_read", read)
    monkeypatch.setattr(Fixer, "_track", lambda *args: go.wait(60) and whole(*args))
    assert one.ask("POST", "api/track", {}).status == 200
    assert one.state()["job"]["what"] == "tracking face"
    for path in ("track", "undo", "save"):
        assert one.post(path).status == 422
    assert len(one.rows(0, 3)) == 4
    assert one.put_draft(9, face={"points": {"nose": [151, 131]}}).status == 422
    go.set()
    one.idle()
    assert one.state()["draft"] == {"frame": 8, "targets": {}} and one.state()["rows_revision"] == 1


def test_save_writes_the_run_and_goes_on_until_done(page, out):
    one = page()

    def saved(times):
        assert one.save().status == 200
        return one.until(lambda state: state["saves"] == times and not state["job"])

    before = {path.name: path.read_bytes() for path in out.iterdir()}
    one.track(8, face=NOSE)
    assert (out / UNSAVED).is_file()
    assert {p.name: p.read_bytes() for p in out.iterdir() if p.name != UNSAVED} == before
    one.put_draft(9, face=NOSE)
    assert [each.frame for each in read_init(out / UNSAVED).corrections] == [8]
    got = one.save()
    assert got.status == 422 and "what was moved in frame 9 is not tracked yet" in got.json["error"]
    one.put_draft(9)
    state = saved(1)
    assert f"{out / CORRECTED}: written" in state["saved"] and not state["unsaved"] and state["ended"] is None
    assert sorted(path.name for path in out.iterdir()) == [CORRECTED, "run.json", "trajectory.csv", "trajectory.json"]
    first = (out / "trajectory.csv").read_bytes()
    one.track(12, face={"points": {"lip_lower": [160.0, 170.0]}})
    assert one.state()["unsaved"]
    saved(2)
    assert [one.frame for one in read_init(out / CORRECTED).corrections] == [8, 12]
    assert one.post("undo").status == 200 and one.state()["unsaved"], "what was saved can be undone, and saved again"
    saved(3)
    assert (out / "trajectory.csv").read_bytes() == first
    one.track(9, face=NOSE)
    ended = one.post("done") and one.state()["ended"]
    assert f"{out / UNSAVED}: corrections that are not saved" in ended["messages"][-1]
    assert ended["next"] == f"facetrack report {out} --overwrite" and (out / UNSAVED).is_file()
    assert one.post("undo").status == 422


def called_lost(folder, first, stop, part):
    """Have a part called lost in these frames of a run: in its files."""
    run = open_run(folder)
    (folder / "run.json").unlink()  # which says what the files were
    rows, which = run.rows, run.rows.names.index(("face", part))
    these = (rows.which == which) & (rows.frame >= first) & (rows.frame < stop)
    lost = replace(rows, status=np.where(these, "lost", rows.status), confidence=np.where(these, 0.25, rows.confidence))
    for form, (path, _) in run.files.items():
        with path.open("wb") as file:
            write_rows(form, file.write, lost)


def test_what_is_called_lost_and_lies_right_is_confirmed(page, out):
    called_lost(out, 6, 10, "nose")
    one = page()

    def confirm(frame, part="nose", **more):
        assert one.post("confirm", frame=frame, target="face", part=part, **more).status == 200
        return one.fixer.rows.find("face", "nose")

    before = one.fixer.rows
    nose = confirm(7)
    assert nose.status[6:10].tolist() == ["lost", "tracked", "lost", "lost"]
    assert nose.by_hand.nonzero()[0].tolist() == [7] and nose.confidence[7] == 1
    assert one.fixer.rows.x.tolist() == before.x.tolist(), "nothing is tracked again"
    assert confirm(8, stretch=True).status[6:10].tolist() == ["lost", "tracked", "tracked", "tracked"]
    one.post("undo")
    assert [c.frame for c in one.fixer.corrections] == [7]
    confirm(6, stretch=True)
    confirm(7, "lip_upper")
    assert one.get("api/overview").json["corrections"][1]["confirmed"] == ["nose", "lip_upper"]
    one.save()
    one.until(lambda state: state["saves"] == 1 and not state["job"])
    said = read_init(out / CORRECTED).corrections
    assert [(c.frame, c.confirmed) for c in said] == [(6, ("nose",)), (7, ("nose", "lip_upper"))]
    assert "it lies right there, whatever the tracker says" in (out / CORRECTED).read_text()
    again = open_run(out)
    assert again.start.corrections == said
    assert again.rows.find("face", "nose").status[6:10].tolist() == ["tracked", "tracked", "lost", "lost"]
    # what is confirmed is corrected instead, and the other way round refused
    one.track(7, face=NOSE)
    found = one.fixer.find(7, "face")
    assert found.points == {"nose": (150.0, 130.5)} and not found.confirmed
    for part, why in (("lip_upper", "corrected in frame 7 already"), ("ear", "has no place")):
        got = one.post("confirm", frame=7, target="face", part=part)
        assert got.status == 422 and why in got.json["error"]


def test_the_overview_tells_where_a_run_is_least_certain():
    sure = [0.9, 0.9, 0.4, 0.2, 0.9, 0.6, 0.1, None, 0.1, 0.3]
    status = ["init", *["tracked"] * 4, "lost", "tracked", "absent", "tracked", "tracked"]
    collected = Collector()
    for frame, (one, how) in enumerate(zip(sure, status, strict=True)):
        odd = results.part("odd", 1, 1, 1, 1, "absent" if frame in (7, 9) else "tracked")
        parts = results.part("box", 1, 1, 1, 1, how, one), odd
        collected.add(results.result(frame + 5, [results.target("a", parts, 1)]).rows)
    rows = collected.trajectory()
    found = overview(rows, 5, (Correction(8, "a", absent=True),), {"a": 0.5})
    assert (found["first"], found["last"], found["least"]) == (5, 14, [0.9, 0.2, 0.6, 0.1, 0.1])
    assert found["lost"] == [False, False, True, False, False] and found["absent"] == [0, 0, 0, 2, 1]
    assert [(one["frame"], one["absent"]) for one in found["corrections"]] == [(8, True)]
    # frames 2 and 3, 5 and 6 (lost, then doubtful), and the last two, of which the last begins no other
    told = [(one["frame"], one["confidence"], one["status"]) for one in found["doubtful"]]
    assert told == [(11, 0.1, "tracked"), (13, 0.1, "tracked"), (8, 0.2, "tracked")]
    assert {one["part"] for one in found["doubtful"]} == {"box"}
    assert [one["frame"] for one in doubtful(rows, {"a": 0.15})] == [11, 13]
    assert len(overview(rows, 999, (), {"a": 0.5})["least"]) == 10


def test_an_init_file_with_gaps_gives_what_a_run_from_it_gives(facetrack, out):
    Path("c.yaml").write_text(
        f"{INIT}corrections:\n- {{frame: 15, absent: [lip_upper]}}\n- {{frame: 6, points: {{nose: [150, 130]}}}}\n"
        "- {frame: 9, confirmed: true}\n- {frame: 17, points: {mouth_left: [140, 150]}}\n"
    )
    code, said, err = facetrack("fix", out, "--init", "c.yaml")
    assert (code, said) == (0, "") and f"{out / 'trajectory.csv'}: written" in err.splitlines()
    for init in (out / CORRECTED, "c.yaml"):
        assert facetrack("run", CLIP, "--init", init, "-o", "again", *MADE, "--no-video", "--overwrite")[0] == 0
        assert Path("again/trajectory.csv").read_bytes() == (out / "trajectory.csv").read_bytes()
    rows = open_run(out).rows
    assert rows.find("face", "lip_upper").by_hand.nonzero()[0].tolist() == [9, 15, 17]
    assert rows.find("face", "nose").by_hand.nonzero()[0].tolist() == [6, 9]
    code, said, err = facetrack("fix", out, "--init", "c.yaml")
    assert (code, err.splitlines()[-1]) == (0, f"{out}: nothing was corrected, all is as it was")


def test_what_is_wrong_is_said_in_one_line(facetrack, out):
    Path("late.yaml").write_text(f"{INIT}corrections:\n- {{frame: 9, points: {{nose: [950, 130]}}}}\n")
    assert "gone.mp4: no such file" in refusal(facetrack("fix", out, "--clip", "gone.mp4"), 3)
    assert "nose of face at frame 9 at [950, 130] is" in refusal(facetrack("fix", out, "--init", "late.yaml"), 3)
    (out / UNSAVED).write_text("frame: 0\n")
    assert "corrections that were not saved are there" in refusal(facetrack("fix", out, "--init", "late.yaml"), 2)


def test_interrupted_without_a_page_leaves_the_run_as_it_was(facetrack, out, monkeypatch):
    before = {path.name: path.read_bytes() for path in out.iterdir()}

    def interrupting(call):
        return lambda *args, **options: os.kill(os.getpid(), signal.SIGINT) or call(*args, **options)

    Path("c.yaml").write_text(f"{INIT}corrections:\n- {{frame: 9, points: {{nose: [150, 130]}}}}\n")
    with monkeypatch.context() as patch:
        patch.setattr(Fixer, "_track", interrupting(Fixer._track))
        code, _, err = facetrack("fix", out, "--init", "c.yaml")
    assert code == 130 and err.splitlines()[-1] == f"facetrack: interrupted; {out} is as it was"
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    # once files are being written, they are all written
    monkeypatch.setattr(saving, "write_rows", interrupting(saving.write_rows))
    assert facetrack("fix", out, "--init", "c.yaml", "-q")[0] == 0
    assert (out / CORRECTED).is_file()


def test_what_is_not_saved_is_kept_and_gone_on_with(page, out, monkeypatch):
    one, kept = page(), out / UNSAVED
    one.track(8, face=NOSE)
    on = f"all else is as it was; facetrack fix {out} goes on with them"
    assert one.session.left() == f"the corrections are kept in {kept}, {on}"
    with monkeypatch.context() as patch:  # it is stopped before they are tracked
        patch.setattr(Fixer, "apply", lambda *_, **__: (_ for _ in ()).throw(StoppedError))
        stopped = page()
        stopped.idle()
        assert stopped.session.left() == f"the corrections are kept in {kept}, {on}" and kept.is_file()
    again = page()
    state = again.until(lambda state: state["rows_revision"] == 1 and state["job"] is None)
    assert state["message"].startswith("the corrections of the last session, which were not saved, are applied")
    assert again.rows(8, 8)[0][0][:2] == [150.0, 130.5]
    again.post("undo")
    assert again.session.left() == "nothing was written" and not kept.exists()
    kept.write_text(INIT.replace("frame: 0", "frame: 1"))
    last = page()
    assert "run the clip again with it; the page begins without it" in last.state()["message"]
    assert last.session.left() == "nothing was written"
