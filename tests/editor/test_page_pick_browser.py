"""facetrack init --pick in a real browser: a start is chosen by mouse, keys and fingers; how the page looks."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.face.detectors import PARTS
from tests.support.browser import DESK, TABLET, until
from tests.support.browser_looks import wrong_looks
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
    `large`: a 4K frame."""
    folder = tmp_path_factory.mktemp("clips")
    write_pictures(folder / "face", [NOBODY, *read_pictures("expressions")[:2]])
    write_pictures(folder / "sign", read_pictures("signing")[:2])
    write_video(folder / "numbered.mp4", frames=200, options=("-g", "25"))
    grain = np.random.default_rng(1).integers(0, 256, (216, 384, 3), np.uint8)
    write_pictures(folder / "large", [cv2.resize(grain, (3840, 2160), interpolation=cv2.INTER_NEAREST)])
    return folder


@pytest.fixture
def page(pick, windows):
    """Opens a page: its session, and a window."""

    def make(*where, screen=DESK, **more):
        session, url = pick(*where, **more)
        return session, windows(url, **screen)

    return make


def corners(box):
    """The pixels in two corners of a box."""
    left, top, width, height = box
    return (left, top), (left + width - 1, top + height - 1)


def near(points, others, within):
    assert set(points) == set(others)
    for part, at in points.items():
        assert np.abs(np.subtract(at, others[part])).max() <= within, part


# --- by the mouse ----------------------------------------------------------------------------------------------------


def test_a_box_and_five_points_are_picked_and_saved(pick, windows, tmp_path):
    saved = tmp_path / "a.init.yaml"
    window = windows(pick(CLIP, saved, next_=f"facetrack run {CLIP} --init {saved}")[1])
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


def test_a_proposal_is_taken_corrected_and_saved(clips, page, tmp_path):
    _, window = page(clips / "face", tmp_path / "a.yaml", frame=1)
    window.until("window.facetrack.proposals.length")
    [left, top, width, _] = window.get("proposals")[0]["targets"]["face"]["box"]

    def dashed():
        edge = window.image(np.arange(left, left + width), [top - 0.5])
        return (edge > 170).all(axis=-1).any()  # hair is darker; a line between pixels is no purer white

    until(dashed, "the box of the proposal", window.page.wait_for_timeout)
    window.click_on("take-0")
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


def test_every_change_is_undone_and_redone(clips, page):
    session, window = page(clips / "face", frame=1)
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
        lambda: name(window, "rename-face", "somebody"),
        lambda: name(window, "add-target", "hand"),
        lambda: window.click_on("remove-somebody"),
    ]
    drafts = [window.get("draft")]
    for action in actions:
        action()
        drafts.append(window.get("draft"))
        assert drafts[-1] != drafts[-2]
    assert drafts[-1] == {"frame": 2, "targets": {"hand": {"box": None, "points": {}, "absent": []}}}
    assert not window.visible("target-somebody")
    for taken, why in [("1st", "letters, digits"), ("a/b", "letters, digits"), ("hand", "is already a target hand")]:
        name(window, "add-target", taken)
        assert why in window.text("message")
    assert window.get("draft") == drafts[-1]
    for draft in reversed(drafts[:-1]):
        assert window.here("undo").is_enabled()
        window.press("Control+z")
        assert window.get("draft")["targets"] == draft["targets"]
    assert window.here("undo").is_disabled() and window.text("progress") == "0 of 5"
    window.until_sent()
    assert not session.draft.placed()
    for draft in drafts[1:]:
        window.click_on("redo")
        assert window.get("draft") == draft
    assert window.here("redo").is_disabled()
    window.until_sent()
    assert session.get_state()["draft"] == drafts[-1]


def name(window, button, text):
    window.answer = text
    window.click_on(button)


# --- by keys alone, and through the clip -----------------------------------------------------------------------------


def test_by_keys_alone(clips, page, tmp_path):
    _, window = page(clips / "face", tmp_path / "a.yaml")
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
    # at once: what is saved is what is shown, though it is not sent yet
    press = "(key) => document.dispatchEvent(new KeyboardEvent('keydown', {key, ctrlKey: true}))"
    window.evaluate(f"['z', 's'].map({press})")
    window.until("window.facetrack.ended")
    start = read_init(tmp_path / "a.yaml")
    expected[first] = tuple(np.add(expected[first], (-0.25, 0)))
    assert start.frame == 1 and start.targets["face"].box == (left, top, width, height)
    near(start.targets["face"].points, expected, 0.01)


def test_every_control_is_reached_by_tab_and_has_a_name(clips, page):
    _, window = page(clips / "face", frame=1)
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


def test_slider_and_keys_show_the_right_frame(clips, page):
    _, window = page(clips / "numbered.mp4")
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


def test_marks_stay_with_their_frame_until_one_begins_elsewhere(clips, page, tmp_path):
    _, window = page(clips / "face", tmp_path / "a.yaml", frame=1, previous=BEGUN)
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


# --- several targets -------------------------------------------------------------------------------------------------


def test_head_and_hands_with_their_boxes(clips, page, tmp_path):
    _, window = page(clips / "sign", tmp_path / "a.yaml", "head_hands")
    assert not window.visible("add-target") and not window.visible("rename-head")
    window.click_on("take-0")
    assert set(window.get("draft.targets")) == set(HANDS) and window.text("progress") == "3 of 3"
    window.press("Control+z")
    for name, box in HANDS.items():
        assert window.get("current") == {"target": name, "part": "box"}
        window.drag(*corners(box))
    window.save()
    assert {name: list(one.box) for name, one in read_init(tmp_path / "a.yaml").targets.items()} == HANDS


# --- fingers, large frames and small faces ---------------------------------------------------------------------------


def test_the_marks_of_a_small_face_do_not_hide_it(clips, page, tmp_path):
    points = {part: (1900 + (x - 160) / 3, 1000 + (y - 138) / 3) for part, (x, y) in POINTS.items()}
    begun = Start(0, {"face": TargetStart((1880, 980, 40, 40), points)}, "a file")
    _, window = page(clips / "large", tmp_path / "a.yaml", "factorized", previous=begun)
    assert window.get("zoom") > 5, "they could not be told apart"
    apart = window.on_screen(points["mouth_left"], points["mouth_right"])
    assert apart[1][0] - apart[0][0] > 60
    window.press("0")
    assert window.get("zoom") == 1 and window.scale() < 0.5
    window.press("z")
    assert window.get("zoom") > 5
    window.click_on("zoom-fit")
    assert window.get("zoom") == 1
    window.click_on("zoom-fit")
    assert window.get("zoom") > 5


def test_fingers_draw_place_move_and_zoom(clips, page, tmp_path):
    _, window = page(clips / "face", tmp_path / "a.yaml", "factorized", frame=1, screen=TABLET)
    window.here("part-face-box").tap()
    window.touch("start", (112, 79))
    window.touch("move", (150, 100))
    window.touch("move", (209, 176))
    window.touch("end")
    assert np.abs(np.subtract(window.face()["box"], (112, 79, 98, 98))).max() <= 1
    # a finger that stays down moves the point, and does not cover the magnifier
    window.touch("start", (170, 120))
    window.touch("move", (165, 130))
    window.touch("move", POINTS["nose"])
    box, (x, y) = window.here("magnifier").bounding_box(), window.at(*POINTS["nose"])
    assert box["x"] >= 0 and box["x"] + box["width"] <= 1024 and box["y"] >= 0 and box["y"] + box["height"] <= 768
    assert min(abs(x - box["x"]), abs(x - box["x"] - box["width"])) > 40 or y - box["y"] - box["height"] > 40
    window.touch("end")
    assert not window.visible("magnifier") or window.until("document.getElementById('magnifier').hidden")
    for part, at in list(POINTS.items())[1:]:
        assert window.get("current.part") == part
        window.tap(*at)
    before = window.face()
    assert window.get("current") is None
    assert max(np.abs(np.subtract(before["points"][part], at)).max() for part, at in POINTS.items()) <= 0.6

    (left, y), (right, _) = window.at(140, 130), window.at(180, 130)
    window.fingers("start", (left, y), (right, y))
    for k in range(1, 5):
        window.fingers("move", (left - 5 * k, y), (right + 5 * k, y))
    window.fingers("end")
    assert 1.3 < window.get("zoom") < 2.5 and window.face() == before, "two fingers zoom, and mark nothing"
    nose = before["points"]["nose"]
    window.touch("start", nose)
    window.touch("move", (nose[0] + 2, nose[1]))
    window.touch("move", (nose[0] + 10, nose[1] - 5))
    window.touch("end")
    assert np.abs(np.subtract(window.face()["points"]["nose"], (nose[0] + 10, nose[1] - 5))).max() <= 0.6
    window.click_on("zoom-fit")
    assert window.get("zoom") == 1
    window.save()
    assert set(read_init(tmp_path / "a.yaml").targets["face"].points) == set(POINTS)


# --- how it looks ----------------------------------------------------------------------------------------------------


def through(window):
    """Has the page show each of its states; their names."""
    window.until("window.facetrack.proposals.length")
    yield "proposed"
    window.click_on("part-face-nose")
    window.press("Enter", "Control+s")
    window.until_visible("problem")
    yield "missing"
    window.press("Escape", ".")
    window.until_shown(2)
    window.press("b", ",")
    window.until_shown(1)
    yield "elsewhere"
    window.click_on("go-back")
    window.until_shown(2)
    window.click_on("help-open")
    yield "help"
    window.press("Escape")
    for k, part in enumerate(list(POINTS)[1:]):
        window.click_on(f"part-face-{part}")
        window.press("Enter", "Shift+ArrowLeft", *["Shift+ArrowDown"] * k)
    yield "all there"
    window.save()
    yield "saved"
    window.click_on("saved-close")
    yield "over"


@pytest.mark.parametrize("screen", [DESK, TABLET], ids=["mouse", "fingers"])
def test_all_is_in_the_window_large_enough_and_legible(clips, page, tmp_path, screen):
    _, window = page(clips / "face", tmp_path / "a.yaml", frame=1, screen=screen)
    window.expected = ["422"]
    found = [(face, *one) for face in through(window) for one in wrong_looks(window, screen)]
    assert found == []
