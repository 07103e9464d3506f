"""How the page looks and feels in a real browser: fingers, small windows, contrast, large and rotated clips; and that
it runs and requests nothing but its own files."""

import http.server
import threading

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.start.init_file import read_init
from tests.support.browser import DESK, PHONE, SMALL, until
from tests.support.browser_looks import wrong_looks
from tests.support.media import rotated, write_pictures, write_video
from tests.support.samples import read_pictures

POINTS = {"nose": (160, 138), "mouth_left": (138, 154), "mouth_right": (180, 156), "lip_upper": (159, 154),
          "lip_lower": (158, 167)}  # fmt: skip
BEGUN = Start(0, {"face": TargetStart((112, 79, 98, 98), {"nose": (160.0, 138.0)})}, "a file")
QUARTERS = np.kron(np.array([[[0, 0, 250], [0, 250, 0]], [[250, 0, 0], [250, 250, 250]]], np.uint8),
                   np.ones((24, 32, 1), np.uint8))  # fmt: skip
TABLET = {"viewport": {"width": 820, "height": 1180}, "has_touch": True}


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`face`: three frames of a face; `large`: a 4K frame; `turned.mp4`: four colours, to be shown turned."""
    folder = tmp_path_factory.mktemp("clips")
    write_pictures(folder / "face", read_pictures("expressions")[:3])
    grain = np.random.default_rng(1).integers(0, 256, (216, 384, 3), np.uint8)
    write_pictures(folder / "large", [cv2.resize(grain, (3840, 2160), interpolation=cv2.INTER_NEAREST)])
    rotated(write_video(folder / "lying.mp4", frames=[QUARTERS] * 3), folder / "turned.mp4", 90)
    return folder


# --- small faces ---


def test_the_marks_of_a_small_face_do_not_hide_it(clips, pick, windows, tmp_path):
    points = {part: (1900 + (x - 160) / 3, 1000 + (y - 138) / 3) for part, (x, y) in POINTS.items()}
    begun = Start(0, {"face": TargetStart((1880, 980, 40, 40), points)}, "a file")
    _, url = pick(clips / "large", tmp_path / "a.yaml", "factorized", begun=begun)
    window = windows(url)
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


# --- fingers ---------------------------------------------------------------------------------------------------------


def test_fingers_draw_place_move_and_zoom(clips, pick, windows, tmp_path):
    _, url = pick(clips / "face", tmp_path / "a.yaml", "factorized")
    window = windows(url, **PHONE)
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
    assert box["x"] >= 0 and box["x"] + box["width"] <= 390 and box["y"] >= 0 and box["y"] + box["height"] <= 844
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


# --- layout and contrast --------------------------------------------------------------------


def through(window):
    """Has the page show each of its states; their names."""
    window.until("window.facetrack.proposals.length")
    yield "proposed"
    window.click_on("part-face-nose")
    window.press("Enter", "Control+s")
    window.until_visible("problem")
    yield "missing"
    window.press("Escape", ".")
    window.until_shown(1)
    window.press("b", ",")
    window.until_shown(0)
    yield "elsewhere"
    window.click_on("go-back")
    window.until_shown(1)
    window.click_on("rename-face")
    yield "renaming"
    window.here("name-field").press("Escape")
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


@pytest.mark.parametrize("screens", [[DESK], [PHONE, SMALL, TABLET]], ids=["mouse", "fingers"])
def test_all_is_in_the_window_large_enough_and_legible(clips, pick, windows, tmp_path, screens):
    _, url = pick(clips / "face", tmp_path / "a.yaml")
    window = windows(url, **screens[0])
    window.expected = ["422"]
    found = [(face, *one) for face in through(window) for one in wrong_looks(window, screens)]
    assert found == []


# --- clips -----------------------------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_reduced_motion_is_respected(clips, pick, windows):
    _, url = pick(clips / "face", begun=BEGUN)
    window = windows(url)
    window.press(".")
    window.until_shown(1)
    for motion, moves in [("no-preference", True), ("reduce", False)]:
        window.page.emulate_media(reduced_motion=motion)
        window.evaluate("document.getElementById('elsewhere').classList.remove('flash')")
        window.press("Enter")
        assert window.evaluate("document.getElementById('elsewhere').classList.contains('flash')")
        names = "document.getAnimations().map((one) => one.animationName ?? one.transitionProperty)"
        # the flash is short: whether there is one at all
        style = "getComputedStyle(document.getElementById('elsewhere')).animationName"
        assert (window.evaluate(style) != "none") == moves
        window.evaluate("document.getElementById('view').classList.add('loading')")
        assert bool(window.evaluate(names)) == moves


def test_a_rotated_clip_is_upright(clips, pick, windows, tmp_path):
    session, url = pick(clips / "turned.mp4", tmp_path / "a.yaml", "contour_histogram")
    window = windows(url)
    assert session.frames.size == (48, 64) and window.size == [48, 64]
    shown = window.image([12, 36], [16, 48])
    assert np.abs(shown - np.rot90(QUARTERS)[16::32, 12::24].astype(int)).max() < 60
    window.drag((10, 30), (33, 61))
    window.save()
    assert read_init(tmp_path / "a.yaml").targets["face"].box == (10, 30, 24, 32)


def test_a_4k_frame_is_sent_as_small_as_it_is_shown(clips, pick, windows):
    session, url = pick(clips / "large")
    window = windows(url)
    window.until("!window.facetrack.proposals.length")
    frames = [one.partition("/frame/")[2] for one in window.requests() if "/frame/" in one]
    assert frames == ["0.jpg?reduce=4"] and window.scale() < 0.26
    # the magnifier has the exact pixels all the same; each of the grains is ten by ten of them
    window.mouse.move(*window.at(1003, 998))
    truth = session.frames.read(0).bgr
    side = window.evaluate("document.getElementById('magnifier').width")

    def magnified():
        """Whether the upper left and right show the exact pixels, eight times as large."""
        pointed = window.evaluate("(at) => window.facetrack.toImage(...at)", list(window.at(1003, 998)))
        places = np.array([(0.2, 0.2), (0.8, 0.2)]) * side
        spots = np.round(pointed + (places - side / 2) / 8).astype(int)
        return np.array_equal(window.pixels("magnifier", places), [truth[spot[1], spot[0]] for spot in spots])

    until(magnified, "the exact pixels", window.page.wait_for_timeout)
    window.mouse.wheel(0, -1500)
    window.until("window.facetrack.image.reduce === 1")
    window.click(1003, 998)
    assert np.abs(np.subtract(window.face()["points"]["nose"], (1003, 998))).max() <= 0.6


# --- nothing from another server --------------------------------------------------------------------------------------


def test_nothing_but_the_page_itself_is_run_or_requested(clips, pick, windows):
    """Without its content security policy, a part of the page could be made to do this."""
    requested = []

    class Other(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            requested.append(self.path)
            self.send_response(200)
            self.send_header("Access-Control-Allow-Origin", "*")
            self.end_headers()

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Other) as other:
        other.block_on_close = False  # a browser may connect ahead, and say nothing
        thread = threading.Thread(target=other.serve_forever, args=(0.01,))
        thread.start()
        try:
            _, url = pick(clips / "face")
            window = windows(url)
            assert window.evaluate("performance.getEntriesByType('resource').length") > 10
            window.expected = ["CSP: ", "Content Security Policy", "violates the following", "script-src"]
            at = f"http://127.0.0.1:{other.server_port}"
            window.evaluate(
                # later, since what runs here at once is not under the policy
                """(at) => void setTimeout(() => {
                  const put = (name, what) => document.body.append(Object.assign(document.createElement(name), what));
                  put("script", {textContent: "window.ran = 'inline'"});
                  put("script", {src: `${at}/script`});
                  put("img", {src: `${at}/img`});
                  put("iframe", {src: `${at}/iframe`});
                  put("style", {textContent: "#save {display: none}"});
                  put("div", {innerHTML: "<p id=styled style='display: none' onclick='window.ran = 1'>p</p>"});
                  fetch(`${at}/fetch`).catch(() => { window.refused = true; });
                  styled.click();
                  try { new Function("window.ran = 'eval'")(); } catch { window.evaluated = false; }
                })""",
                at,
            )
            window.until("window.refused && window.evaluated === false")
            kinds = {"script-src-elem", "script-src-attr", "script-src", "style-src-elem", "style-src-attr", "img-src",
                     "frame-src", "connect-src"}  # fmt: skip
            until(
                lambda: {one.rpartition("CSP: ")[2] for one in window.errors} >= kinds,
                "what the policy refuses",
                window.page.wait_for_timeout,
            )
            assert window.evaluate("window.ran === undefined && styled.checkVisibility()")
            assert window.visible("save")
            window.evaluate("styled.click()")
            assert window.evaluate("window.ran === undefined")
        finally:
            other.shutdown()
            thread.join()
    assert requested == []
