"""facetrack app in a real Chromium, at a desk and on a phone."""

import csv
import io
import os
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.editor import app_session
from facetrack_cli.editor.app_session import AppSession
from facetrack_cli.editor.server import serving
from facetrack_cli.run_folder.manifest import read_manifest
from tests.support.browser import DESK, PHONE
from tests.support.samples import cut

SCREENS = {"desk": DESK, "phone": PHONE}
WIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
SMALL = """[...document.querySelectorAll('button, select, input, a')].filter((one) => one.checkVisibility())
.map((one) => [one.dataset.testid ?? one.id, one.getBoundingClientRect()])
.filter(([, box]) => box.width > 1 && (box.height < 30 || box.right > innerWidth + 1 || box.left < -1))
.map(([name]) => name)"""
STATES = "[...document.querySelectorAll('#clips li')].map((one) => one.dataset.state)"
LOOKED = "document.querySelectorAll('#clips select[data-testid^=what]:not([disabled])').length"


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Two small clips, as somebody has them on a disk."""
    folder = tmp_path_factory.mktemp("clips")
    return [cut(name, 20, folder / f"{name}.mp4") for name in ("expressions", "gestures")]


@pytest.fixture
def open_app(served, windows):
    """Serves a project in this process, and shows it: open_app(folder, screen) gives its session and a window."""

    def show(folder, screen="desk"):
        session = AppSession(folder)
        url = served.enter_context(serving(session)).url
        window = windows(**SCREENS[screen])
        window.page.goto(url)
        window.until("document.body.classList.contains('ready')")
        return session, window

    return show


def drop(window, paths):
    """Let files fall onto the page."""
    window.evaluate(
        """(files) => {
          const data = new DataTransfer();
          for (const [name, bytes] of files) data.items.add(new File([new Uint8Array(bytes)], name));
          for (const kind of ["dragenter", "drop"])
            document.body.dispatchEvent(new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}));
        }""",
        [[path.name, list(path.read_bytes())] for path in paths],
    )


def until_states(window, *wanted, at_most_s=240):
    for _ in range(at_most_s * 20):
        if window.evaluate(STATES) == list(wanted):
            return
        window.page.wait_for_timeout(50)
    raise AssertionError((window.evaluate(STATES), window.evaluate("document.getElementById('clips').innerText")))


def exported(window, menu, program):
    """The name and the bytes of what the browser saves."""
    with window.page.expect_download() as download:
        window.page.select_option(f"[data-testid={menu}]", program)
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


def look_at(window):
    window.click_on("look-1")
    window.until(
        "document.querySelectorAll('#curves svg').length > 4 && document.getElementById('movie').readyState > 1"
    )
    assert window.evaluate(WIDE) <= 0 and window.evaluate(SMALL) == []


def test_from_clips_dropped_to_an_excel_table_and_an_elan_file(open_app, clips, tmp_path):
    session, window = open_app(tmp_path / "study")
    assert window.visible("drop") and not window.visible("work")
    drop(window, clips)
    window.until(f"{LOOKED} === 2")
    assert [window.here(f"what-{k}").input_value() for k in (1, 2)] == ["face", "signer"] and not session.paused
    window.until("[...document.querySelectorAll('#clips img')].every((one) => one.naturalWidth > 1)")
    window.page.select_option("[data-testid=what-2]", "face")
    window.click_on("run-all")
    until_states(window, "done", "done")
    window.until("document.getElementById('overall-text').textContent === '2 of 2 clips done'")
    assert window.evaluate(WIDE) <= 0 and window.evaluate(SMALL) == []

    name, data = exported(window, "export-all", "measures")
    table = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"))))
    assert name == "study.measures.csv" and data.startswith(b"\xef\xbb\xbf")
    assert {row["clip"] for row in table} == {path.name for path in clips} and len(table) == 40
    name, data = exported(window, "export-1", "eaf")
    assert name == "expressions.eaf" and ET.fromstring(data).tag == "ANNOTATION_DOCUMENT"

    look_at(window)
    box = window.page.locator("#curves svg").first.bounding_box()
    window.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    window.until("Math.abs(document.getElementById('movie').currentTime - 0.38) < 0.1")
    window.press("Escape")
    window.until("!document.getElementById('list-view').hidden")

    # correct, save, and back to the list
    window.page.click("[data-testid=correct-1]")
    window.page.wait_for_url("**/fix-1/")
    window.until("!!window.facetrack?.image && window.facetrack.rowsRevision !== null")
    window.press(".", ".", "]")
    window.until_shown(2)
    window.press("y")
    window.until("window.facetrack.rowsRevision === 1 && !window.facetrack.busy")
    window.click_on("save")
    window.until("window.facetrack.saves === 1")
    assert window.get("ended") is False
    window.click_on("done")
    window.until("window.facetrack.ended")
    window.page.click("[data-testid=saved-home]")
    window.page.wait_for_load_state()
    window.until("document.body.classList.contains('home') && document.querySelectorAll('#clips li').length === 2")
    folder = session.run_of(session.find(1))
    assert "confirmed" in (folder / "corrected.init.yaml").read_text()


def test_a_box_is_drawn_on_the_picture(open_app, clips, tmp_path):
    session, window = open_app(tmp_path / "study")
    window.page.fill("[data-testid=path]", str(clips[0].parent))
    window.press("Enter")
    window.until(f"{LOOKED} === 2")
    window.page.select_option("[data-testid=what-1]", "box")
    window.until("document.querySelector('#clips li').dataset.state === 'needs box'")
    window.page.click("[data-testid=start-1]")
    window.page.wait_for_url("**/start-1/")
    window.until("!!window.facetrack?.image")
    window.drag((95, 60), (215, 190))
    window.click_on("save")
    window.until("window.facetrack.ended")
    window.page.click("[data-testid=saved-home]")
    window.page.wait_for_load_state()
    window.until("document.querySelector('#clips li')?.dataset.state === 'ready'")
    window.click_on("run-1")
    until_states(window, "done", "ready")
    assert read_manifest(session.run_of(session.find(1))).complete
    session.post_want([2], True)
    session.post_pause(True)
    until_states(window, "done", "paused")
    assert window.text("pause") == "Go on"
    window.click_on("quit")
    window.until("!!document.querySelector('.ended')")


@pytest.mark.parametrize("screen", SCREENS)
def test_fifty_clips_are_in_the_list(open_app, clips, tmp_path, monkeypatch, screen):
    monkeypatch.setattr(app_session, "likely_in", lambda frames: "face")
    folder = tmp_path / "clips"
    folder.mkdir()
    for k in range(50):
        os.link(clips[0], folder / f"session {k:02} of somebody with a rather long name, camera {'AB'[k % 2]}.mp4")
    session, window = open_app(tmp_path / "study", screen)
    window.page.fill("[data-testid=path]", str(folder))
    window.press("Enter")
    window.until(f"{LOOKED} === 50")
    assert window.evaluate(WIDE) <= 0 and window.evaluate(SMALL) == []
    window.page.select_option("[data-testid=same]", "everybody")
    window.until("[...document.querySelectorAll('#clips li > select')].every((one) => one.value === 'everybody')")
    assert window.text("run-all") == "Track all 50"
    window.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    assert window.page.locator("[data-testid=run-all]").is_visible(), "what is for all stays in the window"
    assert window.page.locator("[data-testid=run-all]").bounding_box()["y"] >= 0
    window.here("what-50").focus()
    window.press("Tab")
    assert window.evaluate("document.activeElement.dataset.testid") == "run-50", "all is reached by keys"
    if screen == "phone":  # and what a run looks like there
        clip = session.find(1)
        clip.what = "face"
        out = session.run_of(clip)
        few = ["--config", "face", "--set", "filter.particles=20", "--stop", "6", "-q"]
        assert main(["run", str(folder / session.place(clip).name), "-o", str(out), *few]) == 0
        window.until(f"{STATES}[0] === 'done'")
        look_at(window)


def test_without_a_server_it_says_so(open_app, tmp_path):
    _, window = open_app(tmp_path / "study")
    window.expected = ["ERR_FAILED", "Failed to load"]
    window.page.route("**/api/state", lambda route: route.abort())
    window.until_visible("offline")
