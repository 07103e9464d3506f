"""facetrack fix as its users meet it: a finished run is put right in a real browser."""

import csv
import json
import shutil
import threading

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.editor.retrack import Tracking
from facetrack_cli.tracking.start import read_init
from tests.support.browser import DESK, PHONE, SMALL, go_to, idle, until
from tests.support.browser_looks import wrong_looks
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"
STOP, AT = 20, 8
MADE = ("--set", "filter.particles=20", "--stop", str(STOP), "-q", "--no-video")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """The folder of a run, `out`."""
    folder = tmp_path_factory.mktemp("clips")
    assert main(["run", str(CLIP), "-o", str(folder / "out"), *MADE]) == 0
    return folder


@pytest.fixture
def out(clips, tmp_path):
    return shutil.copytree(clips / "out", tmp_path / "out")


def lines(folder):
    """The lines of a run's CSV, by frame and part."""
    head, *rest = (folder / "trajectory.csv").read_text(encoding="utf-8").splitlines()
    return {
        (int(row["frame"]), row["part"]): line for row, line in zip(csv.DictReader([head, *rest]), rest, strict=True)
    }


def place(folder, frame, part):
    with (folder / "trajectory.csv").open(newline="", encoding="utf-8") as file:
        return next(
            (float(row["x"]), float(row["y"]), row["status"])
            for row in csv.DictReader(file)
            if (row["frame"], row["part"]) == (str(frame), part)
        )


def save(window):
    window.here("save").click()
    window.here("confirm-yes").click()
    window.until("window.facetrack.ended || !document.getElementById('problem').hidden")
    assert not window.seen("problem"), window.text("problem")


def test_a_lost_track_is_put_right_and_what_follows_changes_alone(command, windows, out):
    before = lines(out)
    x, y, _ = place(out, AT, "nose")
    running = command("fix", out, "--no-video")
    window = windows(running.url)
    assert window.tell("mode") == "fix"
    go_to(window, AT)
    window.drag((x, y), (x - 12, y - 9), drop=False)
    assert window.seen("magnifier")
    window.mouse.up()
    [moved] = window.face()["points"].values()
    assert np.abs(np.subtract(moved, (x - 12, y - 9))).max() <= 0.6
    window.here("track").click()
    idle(window, 1)
    assert window.tell("draft.targets") == {} and len(window.tell("corrections")) == 1
    assert lines(out) == before, "nothing is written until it is saved"
    save(window)
    said = window.text("saved-messages")
    assert f"{out / 'corrected.init.yaml'}: written" in said and f"{out / 'trajectory.csv'}: written" in said
    code, _ = running.ended()
    assert code == 0

    after = lines(out)
    assert list(after) == list(before)
    assert all((after[key] == before[key]) == (key[0] < AT) for key in after), "all rows from there on, and no other"
    assert place(out, AT, "nose") == (*moved, "init")
    told = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))
    by_hand = [
        (frame["frame"], part["part"])
        for frame in told["frames"]
        for target in frame["targets"]
        for part in target["parts"]
        if part.get("by_hand")
    ]
    assert by_hand == [(AT, "nose")]
    [correction] = read_init(out / "corrected.init.yaml").corrections
    assert (correction.frame, dict(correction.given.points)) == (AT, {"nose": tuple(moved)})


def test_only_the_rows_up_to_the_next_correction_change(fix, windows, out):
    session, url = fix(out)
    window = windows(url)
    for revision, frame in enumerate((14, AT), start=1):
        go_to(window, frame)
        x, y, _ = place(out, frame, "lip_lower")
        window.drag((x, y), (x + 6, y + 4))
        window.press("t")
        idle(window, revision)
        if frame == 14:
            between = rows(window)
    after = rows(window)
    assert [k for k in range(STOP) if after[k] != between[k]] == [*range(AT, 14)]
    assert [(one["frame"], one["target"]) for one in window.tell("corrections")] == [(AT, "face"), (14, "face")]
    # one is removed from the list, and the step is taken back
    window.here("tab-corrections").click()
    window.here("uncorrect-8-face").click()
    idle(window, 3)
    assert rows(window) == between
    window.here("undo").click()
    idle(window, 4)
    assert rows(window) == after and session.first_error is None


def test_what_something_covers_is_not_learned(fix, windows, out):
    session, url = fix(out)
    window = windows(url)
    go_to(window, AT)
    assert not window.seen("learn")
    x, y, _ = place(out, AT, "lip_lower")
    window.drag((x, y), (x + 6, y + 4))
    window.here("learn").uncheck()
    window.press("t")
    idle(window, 1)
    assert [one.learn for one in session.fixer.corrections] == [False]
    go_to(window, 14)
    window.drag(place(out, 14, "nose")[:2], (150, 120))
    assert window.here("learn").is_checked()  # what was said of one correction is not said of the next
    window.press("t")
    idle(window, 2)
    assert [one.learn for one in session.fixer.corrections] == [False, None]
    save(window)
    assert "    learn: false\n" in (out / "corrected.init.yaml").read_text(encoding="utf-8")


def rows(window):
    return window.page.evaluate("fetch('api/rows?first=0&last=99').then((got) => got.json())")["frames"]


def test_by_keys_alone(fix, windows, out):
    _, url = fix(out)
    window = windows(url)
    window.until("window.facetrack.rowsRevision === 0")
    before = lines(out)
    window.press("p", "Home", "PageDown")
    window.until_shown(STOP - 1)
    go_to(window, 11)
    window.press("]")
    part = window.tell("selected.part")
    x, y, _ = place(out, 11, part)
    window.press("ArrowRight", "Shift+ArrowUp", "Alt+ArrowRight")
    assert np.allclose(window.face()["points"][part], (x + 1.25, y - 10), atol=0.011)
    window.press("t")
    idle(window, 1)
    window.press("Control+s")
    window.until("document.getElementById('confirm').open")
    until(lambda: on(window, "confirm-yes"), "the button that agrees", window.page.wait_for_timeout)
    window.press("Enter")
    window.until("window.facetrack.ended")
    after = lines(out)
    assert all((after[key] == before[key]) == (key[0] < 11) for key in after)


def on(window, name):
    """Go on by Tab until an element has the focus."""
    if window.page.evaluate("document.activeElement.dataset.testid") == name:
        return True
    window.press("Tab")
    return False


def test_what_is_not_there_is_absent_until_it_is_back(fix, windows, out):
    _, url = fix(out)
    window = windows(url)
    go_to(window, AT)
    window.here("part-face-lip_upper").click()
    window.press("x")
    assert window.face()["absent"] == ["lip_upper"]
    window.press("t")
    idle(window, 1)
    told = [[cell[6] for cell in frame] for frame in rows(window)]
    assert all(("absent" in one) == (k >= AT) for k, one in enumerate(told))
    go_to(window, 15)
    window.here("absent-face-lip_upper").click()
    x, y, _ = place(out, 15, "lip_upper")
    window.click(x, y)
    window.press("t")
    idle(window, 2)
    told = [[cell[6] for cell in frame] for frame in rows(window)]
    assert [k for k, one in enumerate(told) if "absent" in one] == [*range(AT, 15)]
    for revision in (3, 4):
        window.press("Control+z")
        idle(window, revision)
    assert window.tell("corrections") == [] and not window.tell("canUndo")


def test_a_second_window_sees_what_is_tracked_and_waits(fix, windows, out, monkeypatch):
    session, url = fix(out)
    go, whole = threading.Event(), Tracking.track

    def held(self, *arguments, **options):
        assert go.wait(60)
        return whole(self, *arguments, **options)

    monkeypatch.setattr(Tracking, "track", held)
    one, other = windows(url), windows(url)
    for window in (one, other):
        go_to(window, AT)
    x, y, _ = place(out, AT, "nose")
    one.drag((x, y), (x + 5, y))
    one.until_sent()
    one.here("track").click()
    for window in (one, other):
        window.until("window.facetrack.busy")
        assert window.seen("job")
    before = other.tell("draft")
    other.click(100, 40)
    other.drag((x + 5, y), (x + 9, y))
    assert other.tell("draft") == before
    go.set()
    for window in (one, other):
        idle(window, 1)
    assert one.tell("rows") == other.tell("rows") and len(other.tell("corrections")) == 1
    save(one)
    other.until("window.facetrack.ended")
    assert other.text("saved-messages") == one.text("saved-messages") and session.first_error is None


@pytest.mark.parametrize("screen", [DESK, PHONE, {**SMALL, "color_scheme": "dark"}], ids=["desk", "phone", "small"])
def test_all_is_in_the_window_large_enough_and_legible(fix, windows, out, screen):
    _, url = fix(out)
    window = windows(url, **screen)
    wrong = {}

    def look(face):
        if found := wrong_looks(window, fingers="has_touch" in screen):
            wrong[face] = found

    window.until("window.facetrack.review !== null")
    look("begun")
    for tab in ("parts", "review", "corrections"):
        window.here(f"tab-{tab}").click()
        look(tab)
    window.here("tab-parts").click()
    go_to(window, AT)
    window.here("part-face-nose").click()
    window.press("Shift+ArrowLeft")
    look("moved")
    window.press("Escape", ".")
    window.until_shown(AT + 1)
    look("elsewhere")
    window.here("track").click()
    idle(window, 1)
    window.here("tab-corrections").click()
    look("corrected")
    window.here("help-open").click()
    look("help")
    window.press("Escape")
    window.here("save").click()
    look("asked")
    window.here("confirm-yes").click()
    window.until("window.facetrack.ended")
    look("saved")
    assert wrong == {}
