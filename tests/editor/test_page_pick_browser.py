"""facetrack init --pick as its users meet it: a start is chosen in a real browser, by mouse and by keys."""

import re
import threading

import numpy as np
import pytest

from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.editor.web import session as session_module
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.face.detectors import PARTS
from tests.support.browser import until
from tests.support.media import write_pictures, write_video
from tests.support.samples import FOLDER, read_pictures

CLIP = FOLDER / "expressions.mp4"
BOX = [112, 79, 98, 98]
POINTS = {"nose": (160.3, 138.4), "mouth_left": (137.6, 153.8), "mouth_right": (180.2, 156.2),
          "lip_upper": (159, 153.6), "lip_lower": (158.2, 167.1)}  # fmt: skip
HANDS = {"head": [135, 44, 50, 50], "left_hand": [82, 138, 48, 57], "right_hand": [188, 131, 50, 60]}
NOBODY = np.full((240, 320, 3), 90, np.uint8)
BEGUN = Start(0, {"face": TargetStart((112, 79, 98, 98), {"nose": (160.0, 138.0)})}, "a file")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`face`: nobody, then a face; `sign`: somebody who signs, with two hands; `numbered`: 200 frames that can be read;
    `grain`: no two pixels beside each other are alike."""
    folder = tmp_path_factory.mktemp("clips")
    write_pictures(folder / "face", [NOBODY, *read_pictures("expressions")[:2]])
    write_pictures(folder / "sign", read_pictures("signing")[:2])
    write_video(folder / "numbered.mp4", frames=200, options=("-g", "25"))
    grain = np.random.default_rng(1).integers(0, 256, (2, 240, 320, 3), np.uint8)
    write_pictures(folder / "grain", grain)
    return folder


def corners(box):
    """The pixels in two corners of a box."""
    left, top, width, height = box
    return (left, top), (left + width - 1, top + height - 1)


def near(points, others, within):
    assert set(points) == set(others)
    for part, at in points.items():
        assert np.abs(np.subtract(at, others[part])).max() <= within, part


# --- by the mouse ----------------------------------------------------------------------------------------------------


def test_a_box_and_five_points_are_picked_and_saved(command, windows, tmp_path):
    saved = tmp_path / "a.init.yaml"
    running = command("init", CLIP, "--pick", "-o", saved)
    window = windows(running.url)
    assert (window.text("clip-name"), window.text("progress")) == (CLIP.name, "0 of 5")
    window.drag(*corners(BOX))
    for part, at in POINTS.items():
        assert window.get("current") == {"target": "face", "part": part}
        window.click(*at)
    assert window.get("current") is None and window.text("progress") == "6 of 6"
    near(window.face()["points"], POINTS, 0.6)
    assert window.save() == f"{saved}: written"
    assert window.text("next-command") == f"facetrack run {CLIP} --init {saved}"
    start = read_init(saved)
    face = start.targets["face"]
    assert (start.frame, list(start.targets), list(face.box)) == (0, ["face"], BOX)
    near(face.points, POINTS, 0.6)
    code, _, err = running.ended()
    assert code == 0 and not running.said and f"{saved}: written" in err


@pytest.mark.nightly
def test_a_point_is_dragged_under_the_magnifier(clips, pick, windows):
    session, url = pick(clips / "grain", begun=BEGUN)
    window = windows(url)
    truth = session.frames.read(0).bgr.astype(int)
    at = (160, 138)
    for goal in [(0, 1), (319, 239), (319, 0), (0, 239), (163.5, 141.25)]:
        window.drag(at, goal, drop=False)
        assert window.visible("magnifier") and window.get("draft.targets.face.points.nose") == list(goal)
        box = window.here("magnifier").bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= 1280, goal
        assert box["y"] >= 0 and box["y"] + box["height"] <= 800, goal
        x, y = window.at(*goal)
        assert not (box["x"] <= x <= box["x"] + box["width"] and box["y"] <= y <= box["y"] + box["height"]), goal
        until(lambda goal=goal: magnified(window, truth, goal), f"the exact pixels around {goal}")
        window.mouse.up()
        window.until("document.getElementById('magnifier').hidden")
        at = goal
    window.until_sent()
    assert session.draft.targets["face"].points == {"nose": (163.5, 141.25)}
    assert session.draft.targets["face"].box == BEGUN.targets["face"].box


def magnified(window, truth, at):
    """Whether the magnifier shows the exact pixels around a place, larger than the window does."""
    side = window.evaluate("document.getElementById('magnifier').width")
    row = side * (5 if at[1] < truth.shape[0] / 2 else 3) // 8  # one that is within the frame
    line = window.pixels("magnifier", [(x + 0.5, row) for x in range(side)])
    edges = np.flatnonzero((line[1:] != line[:-1]).any(axis=1))
    steps = np.diff(edges)
    times = int(np.bincount(steps).argmax()) if len(steps) else 0
    if not times > window.scale():
        return False
    # the middles of pixels beside the cross hair, and above the text
    reach = int(side / 2 / times - 1)
    places = [(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach // 2) if abs(i) > 1 and abs(j) > 1]
    centre = np.round(at)
    shown, expected = [], []
    for i, j in places:
        x, y = int(centre[0] + i), int(centre[1] + j)
        if 0 <= x < truth.shape[1] and 0 <= y < truth.shape[0]:
            shown.append((side / 2 + (x - at[0]) * times, side / 2 + (y - at[1]) * times))
            expected.append(truth[y, x])
    assert len(shown) > 3
    return np.array_equal(window.pixels("magnifier", shown), expected)


def test_arrows_nudge_by_exact_steps(clips, pick, windows):
    session, url = pick(clips / "face", frame=1, begun=BEGUN)
    window = windows(url)
    window.click(160, 138)
    for key, step in [("ArrowRight", (1, 0)), ("Shift+ArrowDown", (0, 10)), ("Alt+ArrowLeft", (-0.25, 0)),
                      ("Alt+ArrowUp", (0, -0.25)), ("Shift+ArrowLeft", (-10, 0)), ("ArrowUp", (0, -1))]:  # fmt: skip
        before = window.face()
        window.press(key)
        assert window.face() == {**before, "points": {"nose": list(np.add(before["points"]["nose"], step))}}
    window.click_on("part-face-box")
    for key, step in [("Shift+ArrowRight", (10, 0, 0, 0)), ("Alt+ArrowUp", (0, -0.25, 0, 0)),
                      ("Control+ArrowLeft", (0, 0, -1, 0)), ("Control+Shift+ArrowDown", (0, 0, 0, 10))]:  # fmt: skip
        before = window.face()
        window.press(key)
        assert window.face() == {**before, "box": list(np.add(before["box"], step))}
    assert window.get("frame") == session.draft.frame, "no arrow went through the clip, or back in the history"


def test_a_proposal_is_taken_corrected_and_saved(clips, pick, windows, tmp_path):
    _, url = pick(clips / "face", tmp_path / "a.yaml", frame=1)
    window = windows(url)
    window.until("window.facetrack.proposals.length")
    [left, top, width, _] = window.get("proposals")[0]["targets"]["face"]["box"]

    def dashed():
        edge = window.image(np.arange(left, left + width), [top - 0.5])
        return (edge > 170).all(axis=-1).any()  # hair is darker; a line between pixels is no purer white

    until(dashed, "the box of the proposal", window.page.wait_for_timeout)
    window.click_on("take-image-0")
    assert window.text("progress") == "6 of 6"
    taken = window.face()
    near(taken["points"], POINTS, 6)
    nose = taken["points"]["nose"]
    window.drag(nose, (nose[0] + 5, nose[1] - 3))
    window.save()
    face = read_init(tmp_path / "a.yaml").targets["face"]
    assert np.allclose(face.points["nose"], np.add(nose, (5, -3)), atol=0.3)
    taken["points"]["nose"] = face.points["nose"]
    assert list(face.box) == taken["box"]
    near(face.points, taken["points"], 0)


def test_every_change_is_undone_and_redone(clips, pick, windows):
    session, url = pick(clips / "face", frame=1)
    window = windows(url)
    right, bottom = 209, 176
    actions = [
        lambda: window.drag((112, 79), (right, bottom)),
        lambda: window.click(160, 138),
        lambda: window.click(137, 154),
        lambda: window.drag((160, 138), (150, 130)),
        lambda: window.press("Shift+ArrowUp"),
        lambda: window.click_on("part-face-box") or window.drag((right + 0.5, bottom + 0.5), (190, 150)),
        lambda: window.click_on("clear-face-mouth_left"),
        lambda: window.click_on("take-0"),
        lambda: window.press(".") or window.until_shown(2) or window.press("b"),
        lambda: add(window, "hand"),
        lambda: window.click_on("remove-face"),
    ]
    drafts = [window.get("draft")]
    for action in actions:
        action()
        drafts.append(window.get("draft"))
        assert drafts[-1] != drafts[-2]
    assert drafts[-1] == {"frame": 2, "targets": {"hand": {"box": None, "points": {}, "absent": []}}}
    for draft in reversed(drafts[:-1]):
        assert window.here("undo").is_enabled()
        window.press("Control+z")
        assert window.get("draft")["targets"] == draft["targets"]
    assert window.here("undo").is_disabled() and window.text("progress") == "0 of 5"
    window.until_sent()
    assert session.draft.empty
    for draft in drafts[1:]:
        window.click_on("redo")
        assert window.get("draft") == draft
    assert window.here("redo").is_disabled()
    window.until_sent()
    assert session.draft.to_json() == drafts[-1]


def add(window, name):
    window.click_on("add-target")
    window.here("name-field").fill(name)
    window.press("Enter")


# --- by keys alone ---------------------------------------------------------------------------------------------------


def test_by_keys_alone(clips, pick, windows, tmp_path):
    _, url = pick(clips / "face", tmp_path / "a.yaml")
    window = windows(url)
    window.press("ArrowRight")
    window.until_shown(1)
    # by hand: the box in the list, and the parts that follow
    window.press("l", "ArrowUp", "Enter", "ArrowLeft", "Shift+ArrowDown", "Control+ArrowRight")
    left, top, width, height = window.face()["box"]
    middle = [left + (width - 1) / 2, top + (height - 1) / 2]
    expected = {}
    for k, part in enumerate(PARTS):
        window.press("Enter", *["ArrowDown"] * k, "Shift+ArrowRight")
        expected[part] = tuple(np.add(middle, (10, k)))
        assert window.get("selected.part") == part
    assert window.text("progress") == "6 of 6"
    window.press("Enter", "Enter", "Space", "Escape", "Enter")
    assert window.get("ended") is False and not list(tmp_path.iterdir()), "Enter never saves"
    near(window.face()["points"], expected, 0)
    # one mark again, another one away and back
    window.press("l", "ArrowDown", "Enter", "Alt+ArrowLeft", "]", "Delete")
    first, second, *_ = PARTS
    assert window.get("current.part") == second and second not in window.face()["points"]
    window.press("Control+z", "Control+s")
    window.until("window.facetrack.ended")
    start = read_init(tmp_path / "a.yaml")
    expected[first] = tuple(np.add(expected[first], (-0.25, 0)))
    assert start.frame == 1 and start.targets["face"].box == (left, top, width, height)
    near(start.targets["face"].points, expected, 0.01)


def test_every_control_is_reached_by_tab_and_has_a_name(clips, pick, windows):
    _, url = pick(clips / "face", frame=1)
    window = windows(url)
    window.until("window.facetrack.proposals.length")
    reached = []
    where = "(document.activeElement.dataset.slot ? 'a part' : document.activeElement.dataset.testid) ?? 'BODY'"
    while (now := window.press("Tab") or window.evaluate(where)) not in reached and now != "BODY":
        reached.append(now)
    there = {"help-open", "stage", "zoom-out", "zoom-fit", "zoom-in", "following", "frame-slider", "frame-number",
             "previous", "take-0", "rename-face", "remove-face", "a part", "add-target", "save"}  # fmt: skip
    assert set(reached) >= there
    nameless = """[...document.querySelectorAll('button, input, canvas')].filter((one) => one.checkVisibility()
      && !(one.ariaLabel || one.innerText?.trim() || one.labels?.length)).map((one) => one.outerHTML)"""
    assert window.evaluate(nameless) == []


# --- through the clip ------------------------------------------------------------------------------------------------


def test_slider_and_keys_show_the_right_frame(clips, pick, windows):
    _, url = pick(clips / "numbered.mp4")
    window = windows(url)
    for key, frame in [("ArrowRight", 1), ("Shift+ArrowRight", 26), (".", 27), ("PageDown", 52), ("ArrowLeft", 51),
                       (",", 50), ("End", 199), ("PageUp", 174), ("Home", 0), ("ArrowLeft", 0)]:  # fmt: skip
        window.press(key)
        window.until_shown(frame)
        until(lambda frame=frame: window.number() == frame, f"frame {frame}")
    window.press("f")
    window.keyboard.type("137")
    window.press("Enter")
    window.until_shown(137)
    until(lambda: window.number() == 137, "frame 137")
    # the field does not swallow what is typed next
    assert window.evaluate("document.activeElement.id") == "stage"
    window.click_on("previous")
    window.until_shown(136)
    box = window.here("frame-slider").bounding_box()
    for share in (0.1, 0.9, 0.5):
        window.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
        shown = int(window.here("frame-slider").input_value())
        assert abs(shown - share * 199) < 5
        window.until_shown(shown)
        until(lambda shown=shown: window.number() == shown, f"frame {shown}")
        assert window.here("frame-number").input_value() == str(shown)
    assert window.get("draft.frame") == shown, "without marks, a start would be in this frame"


@pytest.mark.nightly
def test_fast_dragging_requests_few_frames_and_ends_with_the_right_one(clips, pick, windows, monkeypatch):
    _, url = pick(clips / "numbered.mp4")
    go, jpeg = threading.Event(), session_module.jpeg

    def held(frames, index, reduce):
        assert index == 0 or go.wait(60), "only the first image arrives before `go`"
        return jpeg(frames, index, reduce)

    monkeypatch.setattr(session_module, "jpeg", held)
    window = windows(url)
    box = window.here("frame-slider").bounding_box()
    middle = box["y"] + box["height"] / 2
    window.mouse.move(box["x"] + 12, middle)
    window.mouse.down()
    passed = set()
    for share in [*np.linspace(0.05, 0.95, 40), *np.linspace(0.95, 0.4, 20)]:
        window.mouse.move(box["x"] + share * box["width"], middle)
        passed.add(window.get("frame"))
    window.mouse.up()
    frame = window.get("frame")
    assert len(passed) > 30 and 60 < frame < 100 and window.get("image.index") == 0
    x, y = window.at(32, 24)
    window.mouse.click(x, y)
    assert window.get("draft.targets") == {}, "nothing can be placed in an image that is not there"
    go.set()
    window.until_shown(frame)
    until(lambda: window.number() == frame, f"frame {frame}")
    requested = [int(found[1]) for one in window.requests() if (found := re.search(r"/frame/(\d+)\.jpg", one))]
    on_the_way = [one for one in requested if one and abs(one - frame) > 2]
    assert frame in requested and len(on_the_way) <= 4, "one at a time, and only the latest"
    window.mouse.click(x, y)
    assert len(window.get("draft.targets.face.points")) == 1


def test_marks_stay_with_their_frame_until_one_begins_elsewhere(clips, pick, windows, tmp_path):
    _, url = pick(clips / "face", tmp_path / "a.yaml", frame=1, begun=BEGUN)
    window = windows(url)
    window.until_message("taken from a file")
    before = window.get("draft")
    window.click_on("following")
    window.until_shown(2)
    assert window.visible("elsewhere")
    window.click(137, 154)
    window.drag((160, 138), (150, 130))
    window.click_on("part-face-lip_upper")
    window.press("Enter", "Delete")
    assert window.get("draft") == before and "start is in frame 1" in window.text("message")
    window.press("g")
    window.until_shown(1)
    assert not window.visible("elsewhere")
    window.press("Escape", ".")
    window.until_shown(2)
    window.click_on("begin-here")
    assert window.get("draft") == {**before, "frame": 2} and not window.visible("elsewhere")
    window.press("Control+z")
    window.until_shown(1)
    assert window.get("draft") == before
    window.press("Control+y")
    window.until_shown(2)
    for part, at in list(POINTS.items())[1:]:
        window.click_on(f"part-face-{part}")
        window.click(*at)
    window.save()
    start = read_init(tmp_path / "a.yaml")
    assert start.frame == 2 and start.targets["face"].points["nose"] == (160, 138)


# --- several targets, and none with points ---------------------------------------------------------------------------


def test_head_and_hands_with_their_boxes(clips, pick, windows, tmp_path):
    _, url = pick(clips / "sign", tmp_path / "a.yaml", "head_hands")
    window = windows(url)
    assert not window.visible("add-target") and not window.visible("rename-head")
    window.click_on("take-0")
    assert set(window.get("draft.targets")) == set(HANDS) and window.text("progress") == "3 of 3"
    window.press("Control+z")
    for name, box in HANDS.items():
        assert window.get("current") == {"target": name, "part": "box"}
        window.drag(*corners(box))
    # the right hand a little larger, by its lower right handle
    left, top, width, height = HANDS["right_hand"]
    edge = left + width - 0.5, top + height - 0.5
    window.drag(edge, (edge[0] + 6, edge[1] + 4))
    window.save()
    saved = {name: list(one.box) for name, one in read_init(tmp_path / "a.yaml").targets.items()}
    assert saved == {**HANDS, "right_hand": [left, top, width + 6, height + 4]}


def test_targets_are_renamed_added_and_removed(clips, pick, windows, tmp_path):
    _, url = pick(clips / "face", tmp_path / "a.yaml", "contour_histogram", frame=1)
    window = windows(url)
    window.drag(*corners(BOX))
    window.click_on("rename-face")
    for name, why in [("points", "a key of init files"), ("1st", "letters, digits"), ("a/b", "letters, digits")]:
        window.here("name-field").fill(name)
        window.press("Enter")
        assert why in window.text("message") and list(window.get("draft.targets")) == ["face"]
    window.here("name-field").fill("somebody")
    window.press("Enter")
    assert window.face("somebody")["box"] == BOX and list(window.get("draft.targets")) == ["somebody"]
    for name in ("hand", "ball"):
        add(window, name)
        window.drag(*corners([20, 20, 40, 50]) if name == "hand" else corners([250, 180, 30, 30]))
    add(window, "hand")
    assert "There is already a target hand" in window.text("message")
    window.press("Escape")
    window.click_on("remove-ball")
    assert list(window.get("draft.targets")) == ["somebody", "hand"] and not window.visible("target-ball")
    window.save()
    saved = {name: list(one.box) for name, one in read_init(tmp_path / "a.yaml").targets.items()}
    assert saved == {"somebody": BOX, "hand": [20, 20, 40, 50]}


# --- more than one window, and none ----------------------------------------------------------------------------------


@pytest.mark.nightly
def test_a_command_that_was_stopped_is_reported(command, windows, tmp_path):
    running = command("init", CLIP, "--pick", "-o", tmp_path / "a.init.yaml")
    window = windows(running.url)
    window.expected = ["net::ERR_"]  # of any kind, by what the process was about to send
    window.click(160, 138)
    window.until_sent()
    running.process.terminate()
    code, _, err = running.ended()
    assert code == 143 and not running.said and "a.init.unsaved.yaml" in err
    window.until("window.facetrack.offline")
    assert window.visible("offline") and "No answer" in window.text("offline")
    window.click(137, 154)
    window.click_on("save")
    window.until_message("Not saved")
    assert len(window.face()["points"]) == 2, "the marks stay in the window"
