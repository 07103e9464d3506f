"""The page in a real Chromium without a screen: windows that record what goes wrong in them, and servers for them.

Nothing here waits for a time: `Window.until` looks until a condition holds. The fixtures are known to the tests of the
editor by its conftest.py; they skip where there is no playwright or no Chromium ($FACETRACK_CHROMIUM names one).
"""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from functools import cached_property
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from tests.support.media import number
from tests.support.page_client import fixing, picking

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
QUIET = ("--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync")  # fmt: skip
DESK = {"viewport": {"width": 1280, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
TABLET = {"viewport": {"width": 1024, "height": 768}, "has_touch": True, "is_mobile": True}
AT_MOST_S = 20.0
READY = "open this page: "

# the page asks and sends more often than for users
PREPARE = """
document.addEventListener('securitypolicyviolation', (e) => console.error('CSP: ' + e.violatedDirective));
const wait = window.setTimeout.bind(window);
const sooner = {250: 80, 300: 80, 1000: 250};
window.setTimeout = (call, ms, ...given) => wait(call, sooner[ms] ?? ms, ...given);
performance.setResourceTimingBufferSize(10_000);
"""


class Window:
    """One tab. An error in it that is not among `expected`, patterns, fails the test."""

    def __init__(self, page):
        self.page, self.context = page, page.context
        self.keyboard, self.mouse = page.keyboard, page.mouse
        self.expected, self.errors = [], []
        self.asked, self.answer = [], ""  # what the page asks, to which it is told yes, or this text
        self._fingers = None
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.errors.append(f"uncaught: {error}"))
        page.on("crash", lambda _: self.errors.append("the tab crashed"))
        page.on("dialog", lambda dialog: (self.asked.append(dialog.message), dialog.accept(self.answer)))

    def _console(self, message):
        if message.type in ("error", "warning", "assert"):
            self.errors.append(f"{message.type}: {message.text}")

    def go(self, url):
        self.page.goto(url)
        self.until("!!window.facetrack?.image")
        return self

    def close(self):
        """What went wrong in it."""
        if not self.page.is_closed():
            asked = self.evaluate("performance.getEntriesByType('resource').map((one) => one.name)")
            others = [one for one in asked if urlsplit(one).hostname not in ("127.0.0.1", None)]
            self.errors += [f"requested from another machine: {one}" for one in others]
        self.context.close()
        return [one for one in self.errors if not any(re.search(known, one) for known in self.expected)]

    # what there is

    def evaluate(self, script, given=None):
        """The value of the expression, or of the function of `given`."""
        return self.page.evaluate(script, given)

    def get(self, what):
        """A property of window.facetrack, as in draft.targets.face.box."""
        return self.evaluate(f"window.facetrack.{what}")

    def until(self, script, given=None):
        """The first true value of the expression, or of the function of `given`."""
        return until(lambda: self.evaluate(script, given), script, self.page.wait_for_timeout)

    def until_sent(self):
        """The server has the draft of this window."""
        self.until("window.facetrack.sent")

    def until_shown(self, frame):
        self.until(f"window.facetrack.image.index === {frame} && window.facetrack.frame === {frame}")

    def until_visible(self, element_id):
        self.until(f"!document.getElementById('{element_id}').hidden")

    def until_message(self, start):
        self.until("(start) => document.getElementById('message').textContent.startsWith(start)", start)

    def here(self, name):
        """The element of a data-testid."""
        return self.page.get_by_test_id(name)

    def text(self, name):
        return self.here(name).inner_text()

    def visible(self, name):
        return self.here(name).is_visible()

    def face(self, target="face"):
        return self.get(f"draft.targets.{target}")

    @property
    def size(self):
        return self.evaluate("fetch('api/session').then((got) => got.json())")["size"]

    def on_screen(self, *places):
        """From pixels of the frame to the window's."""
        places = [list(map(float, place)) for place in places]
        return self.evaluate("(places) => places.map((place) => window.facetrack.toScreen(...place))", places)

    def at(self, x, y):
        return tuple(self.on_screen((x, y))[0])

    def scale(self):
        (left, _), (right, _) = self.on_screen((0, 0), (1, 0))
        return right - left

    def image(self, xs, ys):
        """(len(ys), len(xs), 3) BGR of the frame as it is shown, at places of the frame."""
        shown = cv2.imdecode(np.frombuffer(self.here("stage").screenshot(), np.uint8), cv2.IMREAD_COLOR)
        (left, top), scale, box = self.at(0, 0), self.scale(), self.here("stage").bounding_box()
        columns, rows = (left - box["x"] + np.array(xs) * scale).astype(int), top - box["y"] + np.array(ys) * scale
        return shown[rows.astype(int)[:, None], columns].astype(int)

    def number(self):
        """The number in the image: of clips whose frames are `numbered`."""
        width, height = self.size
        return number(self.image((np.arange(16) + 0.5) * width / 16, np.linspace(height * 0.2, height * 0.8, 16)))

    # mouse, keys and fingers

    def click(self, x, y):
        """At a place of the frame."""
        self.mouse.click(*self.at(x, y))

    def click_on(self, name):
        """On the element of a data-testid, once a click reaches it."""
        self.here(name).click()

    def drag(self, *places, drop=True):
        """Press at the first place of the frame, go by the others, and let go at the last."""
        first, *others = self.on_screen(*places)
        self.mouse.move(*first)
        self.mouse.down()
        for place in others:
            self.mouse.move(*place, steps=3)
        if drop:
            self.mouse.up()

    def press(self, *keys):
        for key in keys:
            self.keyboard.press(key)

    def touch(self, kind, *places):
        """`kind` start, move or end; `places` of the frame, one for each finger that is down."""
        self.fingers(kind, *self.on_screen(*places))

    def fingers(self, kind, *places):
        """As `touch`, at places of the window, which stay while the image moves."""
        self._fingers = self._fingers or self.context.new_cdp_session(self.page)
        points = [dict(zip("xy", place, strict=True), id=k) for k, place in enumerate(places)]
        self._fingers.send("Input.dispatchTouchEvent", {"type": f"touch{kind.title()}", "touchPoints": points})

    def tap(self, x, y):
        self.touch("start", (x, y))
        self.touch("end")

    def save(self):
        """Save by the button, agree if the page asks, and end; the messages that are shown then."""
        self.click_on("save")
        if self.get("mode") == "fix":
            self.until("window.facetrack.saves || !document.getElementById('problem').hidden")
            self.click_on("done")
        self.until("window.facetrack.ended || !document.getElementById('problem').hidden")
        assert not self.visible("problem"), self.text("problem")
        return self.text("saved-messages")


def until(look, what, pause=lambda ms: time.sleep(ms / 1000)):
    """The first true value that `look` gives, which is asked less and less often: what it asks takes the processor."""
    ends, ms = time.monotonic() + AT_MOST_S, 20.0
    while not (found := look()):
        assert time.monotonic() < ends, f"waited in vain for {what}"
        pause(ms)
        ms = min(1.2 * ms, 100.0)
    return found


class Windows:
    """Opens windows; at the end they are closed, and what went wrong in any of them fails the test."""

    def __init__(self, browser):
        self.browser, self.open = browser, []

    def __call__(self, url=None, **options):
        context = self.browser.new_context(**{**DESK, **options})
        context.set_default_timeout(AT_MOST_S * 1000)
        page = context.new_page()
        page.add_init_script(PREPARE)
        self.open.append(Window(page))
        return self.open[-1] if url is None else self.open[-1].go(url)

    def close(self):
        errors = [error for window in self.open for error in window.close()]
        assert not errors, "\n".join(errors)


class Command:
    """`facetrack ARGUMENTS` as a process of its own that serves a page."""

    def __init__(self, *arguments):
        path = os.pathsep.join(filter(None, (os.environ.get("PYTHONPATH"), str(Path(__file__).parents[2]))))
        environment = {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "facetrack_cli", *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip

    @cached_property
    def url(self):
        """The page's address, once it is served; `said` are the lines before it, `hint` is the one after it."""
        self.said = []
        while not (line := self.process.stderr.readline()).startswith(READY):
            assert line, self.said
            self.said.append(line)
        self.hint = self.process.stderr.readline()
        return line.removeprefix(READY).strip()

    def ended(self):
        """Exit code, standard output, and what it said after its address."""
        out, err = self.process.communicate(timeout=120)
        return self.process.returncode, out, err

    def kill(self):
        """End it and what it has started at once, as a power loss does."""
        threads = Path(f"/proc/{self.process.pid}/task").iterdir()
        below = [int(pid) for one in threads for pid in (one / "children").read_text().split()]
        self.process.kill()
        self.process.wait()
        for pid in below:
            os.kill(pid, signal.SIGKILL)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture(scope="session")
def browser():
    """One browser for all tests."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as e:
        pytest.skip(f"no playwright to drive a browser ({e}); pip install -e '.[browser]'")
    program = os.environ.get("FACETRACK_CHROMIUM") or next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(PROGRAMS)} is installed, and FACETRACK_CHROMIUM names none")
    root = hasattr(os, "geteuid") and os.geteuid() == 0
    with contextlib.ExitStack() as stack:
        try:
            driver = stack.enter_context(sync_playwright())
            arguments = [*QUIET, *(["--no-sandbox"] if root else [])]
            opened = driver.chromium.launch(executable_path=program, args=arguments)
        except Exception as e:
            pytest.skip(f"{program} cannot be started: {(str(e).splitlines() or [repr(e)])[0]}")
        yield opened
        opened.close()


@pytest.fixture
def served():
    """What a test opens, closed when its windows are gone."""
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.fixture
def windows(browser, served):
    """Opens a window, by default at a desk: windows(url, **options of playwright's new_context)."""
    opener = Windows(browser)
    yield opener
    opener.close()


@pytest.fixture
def command(served):
    """Starts a command that serves a page."""
    return lambda *arguments: served.enter_context(contextlib.closing(Command(*arguments)))


@pytest.fixture
def pick(served):
    """Serves `facetrack init --pick` in this process: pick(clip, out, config, ...) gives its session and its URL."""
    return lambda *where, **more: served.enter_context(picking(*where, **more))


@pytest.fixture
def fix(served):
    """Serves `facetrack fix` in this process: fix(folder) gives its session and its URL."""
    return lambda folder, **more: served.enter_context(fixing(folder, **more))


def go_to(window, frame):
    """Of a run: show the frame, with its rows, ready for keys."""
    window.press("p", "f")
    window.keyboard.type(str(frame))
    window.press("Enter")
    window.until_shown(frame)
    window.until("window.facetrack.rowsRevision !== null")
    window.here("stage").focus()


def idle(window, revision):
    """Wait until so many steps were taken, and their rows are here."""
    window.until(f"window.facetrack.rowsRevision === {revision} && !window.facetrack.busy && !window.facetrack.job")
    assert not window.visible("problem"), window.text("problem")
