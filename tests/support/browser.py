"""The page in a real Chromium without a screen: windows that tell what went wrong in them, and servers for them.

Nothing here waits for a time: `Window.until` looks until a condition holds. The fixtures are known to the tests of the
editor by its conftest.py; they skip where there is no playwright or no Chromium ($FACETRACK_CHROMIUM names one).
"""

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from facetrack_cli.editor.files.run_folder import open_run
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.web.fix_session import FixSession
from facetrack_cli.editor.web.pick_session import PickSession
from facetrack_cli.editor.web.server import serving
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.video.seek import Frames
from tests.support.media import number

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
QUIET = ("--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync")  # fmt: skip
DESK = {"viewport": {"width": 1280, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
SMALL = {"viewport": {"width": 320, "height": 568}, "has_touch": True, "is_mobile": True}
AT_MOST_S = 20.0
READY = "open this page: "

WATCH = "document.addEventListener('securitypolicyviolation', (e) => console.error('CSP: ' + e.violatedDirective))"
# from a copy, since a canvas that is read often is drawn differently
PIXELS = """([id, places]) => {
  const canvas = document.getElementById(id);
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", {willReadFrequently: true});
  copy.drawImage(canvas, 0, 0);
  const {data} = copy.getImageData(0, 0, canvas.width, canvas.height);
  return places.map(([x, y]) => [2, 1, 0].map((c) => data[4 * (Math.floor(y) * canvas.width + Math.floor(x)) + c]));
}"""


class Window:
    """One tab in a browser of its own. What is not among `expected`, patterns of what may go wrong, fails the test."""

    def __init__(self, browser, options):
        self.context = browser.new_context(**{**DESK, **options})
        self.context.set_default_timeout(AT_MOST_S * 1000)
        self.page = self.context.new_page()
        self.keyboard, self.mouse = self.page.keyboard, self.page.mouse
        self.expected, self.wrong, self.asked = [], [], []
        self.size = self._fingers = None
        self.page.add_init_script(WATCH)
        self.page.on("console", self._heard)
        self.page.on("pageerror", lambda error: self.wrong.append(f"uncaught: {error}"))
        self.page.on("crash", lambda _: self.wrong.append("the tab crashed"))
        self.page.on("request", self._request)

    def _heard(self, message):
        if message.type in ("error", "warning", "assert"):
            self.wrong.append(f"{message.type}: {message.text}")

    def _request(self, request):
        parts = urlsplit(request.url)
        self.asked.append(request.url.partition("/api/")[2])
        if parts.scheme not in ("data", "blob") and parts.hostname != "127.0.0.1":
            self.wrong.append(f"asked another machine: {request.url}")

    def go(self, url):
        self.page.goto(url)
        self.until("!!window.facetrack?.image")
        self.size = self.page.evaluate("fetch('api/session').then((got) => got.json())")["size"]
        return self

    def close(self):
        self.context.close()
        return [one for one in self.wrong if not any(re.search(known, one) for known in self.expected)]

    # what there is

    def tell(self, what):
        """A property of window.facetrack, as in draft.targets.face.box."""
        return self.page.evaluate(f"window.facetrack.{what}")

    def until(self, script, given=None):
        """What the script, or the function, gives as soon as it is true."""
        try:
            return until(lambda: self.page.evaluate(script, given), script, self.page.wait_for_timeout)
        except AssertionError as e:
            raise AssertionError(f"{e}; the page says {self.said()}, and went wrong: {self.wrong}") from None

    def until_sent(self):
        """The server has what is marked here."""
        self.until("window.facetrack.sent")

    def until_shown(self, frame):
        self.until(f"window.facetrack.image.index === {frame} && window.facetrack.frame === {frame}")

    def here(self, name):
        """The element of a data-testid."""
        return self.page.get_by_test_id(name)

    def text(self, name):
        return self.here(name).inner_text()

    def seen(self, name):
        return self.here(name).is_visible()

    def said(self):
        """All that the page has to say: of a file, of what is lacking, of the last deed."""
        return [self.text(name) for name in ("offline", "problem", "message") if self.seen(name) and self.text(name)]

    def face(self, target="face"):
        return self.tell(f"draft.targets.{target}")

    def at(self, x, y):
        """From pixels of the picture to the window's."""
        return tuple(self.page.evaluate("([x, y]) => window.facetrack.toScreen(x, y)", [x, y]))

    def scale(self):
        return self.at(1, 0)[0] - self.at(0, 0)[0]

    def pixels(self, canvas, places):
        """(n, 3) BGR of a canvas at places in its own pixels."""
        return np.array(self.page.evaluate(PIXELS, [canvas, [list(map(float, one)) for one in places]]), int)

    def picture(self, xs, ys):
        """(len(ys), len(xs), 3) BGR of the picture as it is shown, at places of the picture."""
        corner, box, scale = self.at(0, 0), self.here("stage").bounding_box(), self.scale()
        ratio = self.page.evaluate("devicePixelRatio")
        left, top = corner[0] - box["x"], corner[1] - box["y"]
        places = [((left + x * scale) * ratio, (top + y * scale) * ratio) for y in ys for x in xs]
        return self.pixels("stage", places).reshape(len(ys), len(xs), 3)

    def number(self):
        """Which frame the picture says it is: of clips whose frames are `numbered`."""
        width, height = self.size
        return number(self.picture((np.arange(16) + 0.5) * width / 16, np.linspace(height * 0.2, height * 0.8, 16)))

    # mouse, keys and fingers

    def click(self, x, y):
        self.mouse.click(*self.at(x, y))

    def drag(self, *places, drop=True):
        """Press at the first place of the picture, go by the others, and let go at the last."""
        first, *others = (self.at(*place) for place in places)
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
        """`kind` start, move or end; `places` of the picture, one for each finger that is down."""
        self.fingers(kind, *(self.at(*place) for place in places))

    def fingers(self, kind, *places):
        """As `touch`, at places of the window, which stay while the picture moves."""
        self._fingers = self._fingers or self.context.new_cdp_session(self.page)
        points = [dict(zip("xy", place, strict=True), id=k) for k, place in enumerate(places)]
        self._fingers.send("Input.dispatchTouchEvent", {"type": f"touch{kind.title()}", "touchPoints": points})

    def tap(self, x, y):
        self.touch("start", (x, y))
        self.touch("end")

    def save(self):
        """Save by the button, and wait until the page says that all is over."""
        self.here("save").click()
        self.until("window.facetrack.ended || !document.getElementById('problem').hidden")
        assert not self.seen("problem"), self.text("problem")
        return self.text("saved-messages")


def until(look, what, pause=lambda ms: time.sleep(ms / 1000)):
    """The first true value that `look` gives."""
    ends = time.monotonic() + AT_MOST_S
    while not (found := look()):
        assert time.monotonic() < ends, f"waited in vain for {what}"
        pause(10)
    return found


class Windows:
    """Opens windows, and closes them all with a word about what went wrong in them."""

    def __init__(self, browser):
        self.browser, self.open = browser, []

    def __call__(self, url=None, **options):
        self.open.append(Window(self.browser, options))
        return self.open[-1] if url is None else self.open[-1].go(url)

    def close(self):
        wrong = [one for window in self.open for one in window.close()]
        self.open = []
        assert not wrong, "\n".join(wrong)


class Command:
    """`facetrack ARGUMENTS` as a process of its own that serves a page at `url`."""

    def __init__(self, *arguments):
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "facetrack_cli", *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip
        first = self.process.stderr.readline()
        assert first.startswith(READY), first + self.process.stderr.read()
        self.url = first.removeprefix(READY).strip()

    def ended(self):
        """Exit code and what it said after its address."""
        _, err = self.process.communicate(timeout=120)
        return self.process.returncode, err

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture(scope="session")
def chromium():
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
            browser = driver.chromium.launch(executable_path=program, args=arguments)
        except Exception as e:
            pytest.skip(f"{program} cannot be started: {(str(e).splitlines() or [repr(e)])[0]}")
        yield browser
        browser.close()


@pytest.fixture
def served():
    """What a test opens, closed when its windows are gone."""
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.fixture
def windows(chromium, served):
    """Opens a window, by default at a desk: windows(url, **options of playwright's new_context)."""
    opener = Windows(chromium)
    yield opener
    opener.close()


@pytest.fixture
def command(served):
    """Starts a command that serves a page."""
    return lambda *arguments: served.enter_context(contextlib.closing(Command(*arguments)))


@pytest.fixture
def pick(served):
    """Serves `facetrack init --pick` in this process: pick(clip, out, config, ...) gives its session and its URL."""

    def serve(clip, out=None, config=None, **more):
        recipe = None if config is None else load_recipe(config)
        frames = served.enter_context(Frames(clip))
        session = PickSession(clip, frames, out=out, recipe=recipe, **more)
        return session, served.enter_context(serving(session)).url

    return serve


@pytest.fixture
def fix(served):
    """Serves `facetrack fix` in this process: fix(folder) gives its session and its URL."""

    def serve(folder, **more):
        run = open_run(folder)
        served.callback(run.index.close)
        frames = served.enter_context(Frames(run.clip))
        fixer = Fixer(run, frames.read)
        served.callback(fixer.close)
        session = FixSession(fixer, frames, **more)
        return session, served.enter_context(serving(session)).url

    return serve


def go_to(window, frame):
    """Of a run that is put right: show the frame, with its rows, ready for keys."""
    window.press("p", "f")
    window.keyboard.type(str(frame))
    window.press("Enter")
    window.until_shown(frame)
    window.until("window.facetrack.rowsRevision !== null")
    window.here("stage").focus()


def idle(window, revision):
    """Wait until so many steps were taken, and their rows are here."""
    window.until(f"window.facetrack.rowsRevision === {revision} && !window.facetrack.busy && !window.facetrack.job")
    assert not window.seen("problem"), window.text("problem")
