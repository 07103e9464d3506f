"""How the page looks and feels in a real browser: fingers, small windows, contrast, large and rotated clips; and that
nothing but the page itself has a say in it."""

import http.server
import threading

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.tracking.start import read_init
from tests.support.browser import DESK, PHONE, SMALL, Windows, until
from tests.support.browser_looks import wrong_looks
from tests.support.media import rotated, write_pictures, write_video
from tests.support.samples import read_pictures

POINTS = {"nose": (160, 138), "mouth_left": (138, 154), "mouth_right": (180, 156), "lip_upper": (159, 154),
          "lip_lower": (158, 167)}  # fmt: skip
BEGUN = Start(0, {"face": TargetStart((112, 79, 98, 98), {"nose": (160.0, 138.0)})}, "a file")
QUARTERS = np.kron(np.array([[[0, 0, 250], [0, 250, 0]], [[250, 0, 0], [250, 250, 250]]], np.uint8),
                   np.ones((24, 32, 1), np.uint8))  # fmt: skip
DARK, LIGHT = {"color_scheme": "dark"}, {"color_scheme": "light"}
TABLET = {"viewport": {"width": 820, "height": 1180}, "has_touch": True}


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`face`: three frames of a face; `large`: a 4K picture; `turned.mp4`: four colours, to be shown turned."""
    folder = tmp_path_factory.mktemp("clips")
    write_pictures(folder / "face", read_pictures("expressions")[:3])
    grain = np.random.default_rng(1).integers(0, 256, (216, 384, 3), np.uint8)
    write_pictures(folder / "large", [cv2.resize(grain, (3840, 2160), interpolation=cv2.INTER_NEAREST)])
    rotated(write_video(folder / "lying.mp4", frames=[QUARTERS] * 3), folder / "turned.mp4", 90)
    return folder


# --- fingers ---------------------------------------------------------------------------------------------------------


def test_fingers_draw_place_lead_and_zoom(clips, pick, windows, tmp_path):
    _, url = pick(clips / "face", tmp_path / "a.yaml", "factorized")
    window = windows(url, **PHONE)
    window.here("part-face-box").tap()
    window.touch("start", (112, 79))
    window.touch("move", (150, 100))
    window.touch("move", (209, 176))
    window.touch("end")
    assert np.abs(np.subtract(window.face()["box"], (112, 79, 98, 98))).max() <= 1
    # a finger that stays down leads the point, and does not cover what it sees
    window.touch("start", (170, 120))
    window.touch("move", (165, 130))
    window.touch("move", POINTS["nose"])
    box, (x, y) = window.here("magnifier").bounding_box(), window.at(*POINTS["nose"])
    assert box["x"] >= 0 and box["x"] + box["width"] <= 390 and box["y"] >= 0 and box["y"] + box["height"] <= 844
    assert min(abs(x - box["x"]), abs(x - box["x"] - box["width"])) > 40 or y - box["y"] - box["height"] > 40
    window.touch("end")
    assert not window.seen("magnifier") or window.until("document.getElementById('magnifier').hidden")
    for part, at in list(POINTS.items())[1:]:
        assert window.tell("current.part") == part
        window.tap(*at)
    before = window.face()
    assert window.tell("current") is None
    assert max(np.abs(np.subtract(before["points"][part], at)).max() for part, at in POINTS.items()) <= 0.6

    (left, y), (right, _) = window.at(140, 130), window.at(180, 130)
    window.fingers("start", (left, y), (right, y))
    for k in range(1, 5):
        window.fingers("move", (left - 5 * k, y), (right + 5 * k, y))
    window.fingers("end")
    assert 1.3 < window.tell("zoom") < 2.5 and window.face() == before, "two fingers zoom, and mark nothing"
    nose = before["points"]["nose"]
    window.touch("start", nose)
    window.touch("move", (nose[0] + 2, nose[1]))
    window.touch("move", (nose[0] + 10, nose[1] - 5))
    window.touch("end")
    assert np.abs(np.subtract(window.face()["points"]["nose"], (nose[0] + 10, nose[1] - 5))).max() <= 0.6
    window.here("zoom-fit").click()
    assert window.tell("zoom") == 1
    window.save()
    assert set(read_init(tmp_path / "a.yaml").targets["face"].points) == set(POINTS)


def test_a_second_finger_takes_back_what_the_first_began(clips, pick, windows):
    _, url = pick(clips / "face", begun=BEGUN)
    window = windows(url, **PHONE)
    before = window.tell("draft")
    window.touch("start", (137, 154))
    assert window.tell("draft") != before
    window.touch("start", (137, 154), (200, 60))
    assert window.tell("draft") == before
    window.touch("end")
    assert window.tell("draft") == before and window.here("undo").is_disabled()


# --- what there is room for, and what can be read --------------------------------------------------------------------


def through(window):
    """Have the page show each of its faces, and say which."""
    window.until("window.facetrack.proposals.length")
    yield "proposed"
    window.here("part-face-nose").click()
    window.press("Enter", "Control+s")
    window.until("!document.getElementById('problem').hidden")
    yield "lacking"
    window.press("Escape", ".")
    window.until_shown(1)
    window.press("b", ",")
    window.until_shown(0)
    yield "elsewhere"
    window.here("go-back").click()
    window.until_shown(1)
    window.here("rename-face").click()
    yield "renaming"
    window.here("name-field").press("Escape")
    window.here("help-open").click()
    yield "help"
    window.press("Escape")
    for k, part in enumerate(list(POINTS)[1:]):
        window.here(f"part-face-{part}").click()
        window.press("Enter", "Shift+ArrowLeft", *["Shift+ArrowDown"] * k)
    yield "all there"
    window.save()
    yield "saved"
    window.here("saved-close").click()
    yield "over"


SCREENS = {"dark": {**DESK, **DARK}, "light": {**DESK, **LIGHT}, "phone": {**PHONE, **DARK},
           "small": {**SMALL, **LIGHT}, "tablet": {**TABLET, **DARK}}  # fmt: skip


@pytest.mark.parametrize("screen", SCREENS.values(), ids=SCREENS)
def test_all_is_in_the_window_large_enough_and_legible(clips, pick, windows, tmp_path, screen):
    _, url = pick(clips / "face", tmp_path / "a.yaml")
    window = windows(url, **screen)
    window.expected = ["422"]
    wrong = {}
    for face in through(window):
        found = wrong_looks(window, fingers="has_touch" in screen)
        if found:
            wrong[face] = found
    assert wrong == {}


def test_nothing_moves_for_those_who_do_not_want_it(clips, pick, windows):
    _, url = pick(clips / "face", begun=BEGUN)
    for motion, moves in [("no-preference", True), ("reduce", False)]:
        window = windows(url, reduced_motion=motion)
        window.press(".")
        window.until_shown(1)
        window.press("Enter")
        assert window.page.evaluate("document.getElementById('elsewhere').classList.contains('flash')")
        names = "document.getAnimations().map((one) => one.animationName ?? one.transitionProperty)"
        # the flash is short, so what is asked is whether there is one at all
        style = "getComputedStyle(document.getElementById('elsewhere')).animationName"
        assert (window.page.evaluate(style) != "none") == moves
        window.page.evaluate("document.getElementById('view').classList.add('waits')")
        assert bool(window.page.evaluate(names)) == moves


# --- clips -----------------------------------------------------------------------------------------------------------


def test_a_rotated_clip_is_upright(clips, pick, windows, tmp_path):
    session, url = pick(clips / "turned.mp4", tmp_path / "a.yaml", "contour_histogram")
    window = windows(url)
    assert session.frames.size == (48, 64) and window.size == [48, 64]
    shown = window.picture([12, 36], [16, 48])
    assert np.abs(shown - np.rot90(QUARTERS)[16::32, 12::24].astype(int)).max() < 60
    window.drag((10, 30), (33, 61))
    window.save()
    assert read_init(tmp_path / "a.yaml").targets["face"].box == (10, 30, 24, 32)


def test_a_4k_picture_comes_as_small_as_it_is_shown(clips, pick, windows):
    session, url = pick(clips / "large")
    window = windows(url)
    window.until("!window.facetrack.proposals.length")
    frames = [one for one in window.asked if one.startswith("frame/")]
    assert frames == ["frame/0.jpg?reduce=4"] and window.scale() < 0.26
    # the magnifier has the picture's own pixels all the same, each of the grains ten by ten of them
    window.mouse.move(*window.at(1003, 998))
    truth = session.frames.read(0).bgr
    side = window.page.evaluate("document.getElementById('magnifier').width")

    def magnified():
        """Whether what is seen to the upper left and right is what is there, eight times as large."""
        pointed = window.page.evaluate("(at) => window.facetrack.toImage(...at)", list(window.at(1003, 998)))
        places = np.array([(0.2, 0.2), (0.8, 0.2)]) * side
        spots = np.round(pointed + (places - side / 2) / 8).astype(int)
        return np.array_equal(window.pixels("magnifier", places), [truth[spot[1], spot[0]] for spot in spots])

    until(magnified, "the very pixels", window.page.wait_for_timeout)
    window.mouse.wheel(0, -1500)
    window.until("window.facetrack.image.reduce === 1")
    window.click(1003, 998)
    assert np.abs(np.subtract(window.face()["points"]["nose"], (1003, 998))).max() <= 0.6


# --- nothing from anywhere else --------------------------------------------------------------------------------------


def test_nothing_but_the_page_itself_is_run_or_asked(clips, pick, windows):
    """What a part of the page could be made to do, were it not for the policy that it is served with."""
    asked = []

    class Other(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
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
            assert window.page.evaluate("performance.getEntriesByType('resource').length") > 10
            window.expected = ["CSP: ", "Content Security Policy", "violates the following", "script-src"]
            at = f"http://127.0.0.1:{other.server_port}"
            window.page.evaluate(
                # later, since what is asked from here at once is above the policy
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
                lambda: {one.rpartition("CSP: ")[2] for one in window.wrong} >= kinds,
                "what the policy refuses",
                window.page.wait_for_timeout,
            )
            assert window.page.evaluate("window.ran === undefined && styled.checkVisibility()") and window.seen("save")
            window.page.evaluate("styled.click()")
            assert window.page.evaluate("window.ran === undefined")
        finally:
            other.shutdown()
            thread.join()
    assert asked == []


def test_what_goes_wrong_in_a_window_fails_its_test(chromium, clips, pick):
    _, url = pick(clips / "face")
    for deed, said in [("console.error('so')", "error: so"), ("console.warn('so')", "warning: so"),
                       ("setTimeout(() => { throw new Error('so') })", "uncaught: so"),
                       ("setTimeout(() => document.body.setAttribute('style', 'color: red'))", "CSP: style-src-attr"),
                       ("fetch('api/nothing')", "404")]:  # fmt: skip
        opener = Windows(chromium)
        window = opener(url)
        window.page.evaluate(deed)
        until(
            lambda window=window, said=said: any(said in one for one in window.wrong),
            deed,
            window.page.wait_for_timeout,
        )
        with pytest.raises(AssertionError, match=said):
            opener.close()
