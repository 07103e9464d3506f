"""facetrack fix in a real browser, on runs that lose their targets: at a cut in the clip everything moves away."""

import shutil

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.face.detectors import PARTS
from tests.support.browser import TABLET, go_to, idle
from tests.support.browser_looks import wrong_looks
from tests.support.hands_run import hands_run
from tests.support.media import write_pictures
from tests.support.samples import FOLDER, read_pictures, read_rows

CUT, FRAMES = 8, 24
AWAY = {"turning": (-60, 40), "expressions": (40, -30)}
CONFIDENCE, STATUS, BY_HAND = 5, 6, 7  # of a cell in api/rows
HEAD = ["--config", "contour_histogram_correlation", "--set", "filter.particles=100"]
FACE = ["--config", "factorized", "--set", "filter.particles=40"]
TABLE = """() => {
  const slider = document.getElementById("frame-slider");
  const show = (frame) => {
    slider.value = frame;
    slider.dispatchEvent(new Event("input"));
  };
  const shown = window.facetrack.frame;
  const found = [];
  for (let frame = 0; frame <= Number(slider.max); frame++) {
    show(frame);
    found.push(window.facetrack.rows);
  }
  show(shown);
  return found;
}"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """`head` and `face`: runs of clips with a cut, `turning` and `expressions`."""
    folder = tmp_path_factory.mktemp("made")
    for out, name, recipe in (("head", "turning", HEAD), ("face", "expressions", FACE)):
        frames = read_pictures(name)[:FRAMES]
        dx, dy = AWAY[name]
        frames[CUT:] = np.roll(frames[CUT:], (dy, dx), (1, 2))
        clip, init = write_pictures(folder / name, frames), FOLDER / f"{name}.init.yaml"
        arguments = ["run", clip, "--init", init, "-o", folder / out, *recipe, "--no-video", "-q"]
        assert main([str(one) for one in arguments]) == 0
    return folder


@pytest.fixture
def page(made, tmp_path, fix, windows):
    """Opens a copy of a run: its folder, its session, its URL and a window."""

    def make(name="face"):
        folder = shutil.copytree(made / name, tmp_path / name)
        session, url = fix(folder)
        return folder, session, url, windows(url)

    return make


def truth(name, frame):
    """{part: (x, y)} in a clip with a cut."""
    away = AWAY[name] if frame >= CUT else (0, 0)
    rows = (row for row in read_rows(name) if row["frame"] == str(frame))
    return {row["part"]: (float(row["x"]) + away[0], float(row["y"]) + away[1]) for row in rows}


def table(window):
    """The cells of all frames as the page has them; the frame that is shown stays."""
    window.until("window.facetrack.rowsRevision !== null")
    shown, found = window.get("frame"), window.evaluate(TABLE)
    assert None not in found and window.get("frame") == shown
    return found


def move(window, part, by, target="face"):
    """Drag a point from where it is, in the frame that is shown; where it should be now."""
    drafted = window.get("draft.targets").get(target, {"points": {}})["points"]
    x, y = drafted.get(part) or window.get("rows")[PARTS.index(part)][:2]
    window.drag((x, y), (x + by[0], y + by[1]))
    return x + by[0], y + by[1]


def track(window, revision):
    window.press("t")
    idle(window, revision)


def test_one_key_exchanges_the_names_of_hands(fix, windows, tmp_path):
    window = windows(fix(hands_run(tmp_path / "out"))[1])
    before = table(window)
    go_to(window, 5)
    window.press("e")
    window.until_message("The hands are exchanged from frame 5 on.")
    left, right = table(window)[5][1:]  # after the head
    np.testing.assert_allclose([left[:2], right[:2]], [cell[:2] for cell in before[5][:0:-1]], atol=0.02)


def test_a_lost_head_is_corrected_with_the_mouse(page):
    folder, _, _, window = page("head")
    [worst, *_] = window.get("review")
    window.until_shown(worst)
    assert worst > CUT and window.get("highlighted") == {"target": "head", "part": "box"}, "the worst frame is shown"
    window.press("Home")
    window.click_on("tab-review")
    window.click_on(f"review-{worst}")
    window.until_shown(worst)
    assert window.get("rows")[0][CONFIDENCE] < 0.5
    was = table(window)
    assert {row[0][STATUS] for row in was[CUT + 4 :]} == {"lost"}

    go_to(window, CUT)  # back to where it was lost
    x, y, w, h = window.get("rows")[0][:4]
    there = truth("turning", CUT)["box"]
    assert np.hypot(x - there[0], y - there[1]) > 40
    window.drag((x, y), there)
    left, top, width, height = window.face("head")["box"]
    middle = left + (width - 1) / 2, top + (height - 1) / 2
    assert np.abs(np.subtract(middle, there)).max() <= 1 and np.allclose((width, height), (w, h), atol=0.011)
    window.click_on("track")
    idle(window, 1)
    assert window.text("message").startswith(f"Tracked from frame {CUT}") and not window.face("head")
    now = table(window)
    assert now[:CUT] == was[:CUT] and [k for k, [cell] in enumerate(now) if cell[BY_HAND]] == [CUT]
    assert now[CUT][0][STATUS] == "init" and {row[0][STATUS] for row in now[CUT + 1 :]} == {"tracked"}
    messages = window.save()
    assert all(f"{folder / name}: written" in messages for name in ("trajectory.csv", "corrected.init.yaml"))
    assert [one.frame for one in read_init(folder / "corrected.init.yaml").corrections] == [CUT]


def test_what_is_dragged_or_absent_is_tracked_undone_and_removed(page):
    _, session, _, window = page()
    go_to(window, 12)
    was, drafts = table(window), [window.get("draft")]
    for by in [(12, -9), (-5, 2)]:
        at = move(window, "nose", by)
        assert np.abs(np.subtract(window.face()["points"]["nose"], at)).max() <= 0.6
        drafts.append(window.get("draft"))
    for one in (1, 0):
        window.press("Control+z")
        assert window.get("draft") == drafts[one]
    assert window.here("undo").is_disabled()
    window.press("Control+Shift+z", "Control+y")
    track(window, 1)
    late = table(window)

    go_to(window, 3)  # an earlier one reaches to the next correction
    window.press("[")  # from nothing to the last part, which is the box of all points
    window.press("]", "]")
    assert window.get("selected.part") == "mouth_left"
    window.press("x")
    assert window.face() == {"box": None, "points": {}, "absent": ["mouth_left"]}
    assert "absent" in window.text("part-face-mouth_left") and "absent" not in window.text("part-face-nose")
    window.press("x", "Shift+X")
    assert window.face()["absent"] is True
    window.click_on("absent-face")
    assert window.get("draft.targets") == {} and window.text("absent-face") == "Set absent"
    window.click_on("absent-face")
    track(window, 2)
    both = table(window)
    assert {cell[STATUS] for row in both[3:12] for cell in row} == {"absent"}
    assert [k for k in range(FRAMES) if both[k] != late[k]] == [*range(3, 12)]

    go_to(window, 5)
    window.click_on("tab-parts")
    for part in PARTS[:2]:
        window.click_on(f"part-face-{part}")
        assert window.get("current") == {"target": "face", "part": part}
        window.click(*truth("expressions", 5)[part])
    track(window, 3)
    assert [cell[STATUS] for cell in table(window)[6]] == ["tracked"] * 2 + ["absent"] * 3
    window.press("Control+z")
    idle(window, 4)
    assert table(window) == both and window.text("message") == "Undone: 2 corrections now."
    window.click_on("tab-corrections")
    assert "absent" in window.text("correction-3-face")
    window.click_on("uncorrect-12-face")
    idle(window, 5)
    assert [one["frame"] for one in window.get("corrections")] == [3]
    for revision, rows in ((6, both), (7, late), (8, was)):
        window.click_on("undo")
        idle(window, revision)
        assert table(window) == rows
    assert window.here("undo").is_disabled() and not window.get("canUndo") and session.fault is None


def test_the_timeline_leads_to_frames_and_keys_to_what_is_corrected(page):
    *_, window = page()
    for revision, frame in enumerate((18, 5), 1):
        go_to(window, frame)
        move(window, "nose", (6, 4))
        track(window, revision)
    box = window.here("timeline").bounding_box()

    def place(frame):
        return box["x"] + 8 + frame / (FRAMES - 1) * (box["width"] - 16), box["y"] + box["height"] / 2

    for frame in (0, FRAMES - 1, 9):
        window.mouse.click(*place(frame))
        window.until_shown(frame)
    window.mouse.move(*place(3))
    window.mouse.down()
    for frame in (4, 7, 14):
        window.mouse.move(*place(frame))
        assert window.get("frame") == frame
    window.mouse.up()
    window.until_shown(14)
    for key, frame in (("c", 18), ("Shift+C", 5)):
        window.press(key)
        assert window.get("frame") == frame


def through(window):
    """Has the page show each of its states; their names."""
    window.until("window.facetrack.review !== null")
    yield "begun"
    for tab in ("parts", "review", "corrections"):
        window.click_on(f"tab-{tab}")
        yield tab
    window.click_on("tab-parts")
    go_to(window, 5)
    window.click_on("part-face-nose")
    window.press("Shift+ArrowLeft")
    yield "moved"
    window.press("Escape", ".")
    window.until_shown(6)
    yield "elsewhere"
    window.click_on("track")
    idle(window, 1)
    window.click_on("tab-corrections")
    yield "corrected"
    window.click_on("tab-parts")
    go_to(window, FRAMES - 1)
    window.click_on("part-face-nose")
    window.until("!document.getElementById('confirm-row').hidden")
    yield "lost"
    window.click_on("help-open")
    yield "help"
    window.press("Escape")
    window.click_on("save")
    window.until("window.facetrack.saves")
    yield "saved"
    window.click_on("done")
    window.until("window.facetrack.ended")
    yield "done"


def test_all_is_in_the_window_large_enough_and_legible(made, fix, windows, tmp_path):
    window = windows(fix(shutil.copytree(made / "face", tmp_path / "face"))[1], **TABLET)
    assert [(face, *one) for face in through(window) for one in wrong_looks(window, TABLET)] == []
