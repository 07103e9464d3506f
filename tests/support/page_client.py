"""Pages that are served in this process, and requests to them without a browser."""

import contextlib
import http.client
import json
import os
import re
import stat
import time
from _thread import interrupt_main
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple
from urllib.parse import urlsplit
from urllib.request import url2pathname

from facetrack_cli.editor import server
from facetrack_cli.editor.fix_session import FixSession
from facetrack_cli.editor.session import PickSession
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.finished import open_run


@contextlib.contextmanager
def picking(clip, out=None, config=None, **more):
    """The session and the address of `facetrack init --pick`."""
    session = PickSession(clip, load_recipe(config or "face"), out=out, **more)
    with server.serving(session) as page:
        yield session, page.url


@contextlib.contextmanager
def fixing(folder, **more):
    """The session and the address of `facetrack fix`."""
    session = FixSession(open_run(folder), **more)
    with server.serving(session) as page:
        yield session, page.url


class Got(NamedTuple):
    status: int
    headers: Any
    data: bytes

    @property
    def json(self):
        return json.loads(self.data)


class Client:
    """One window: `paths` are below the token, as in api/state; those that begin with / are taken as they are."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self.port, self.base = parts.port, parts.path
        self.connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=60)

    def ask(self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None) -> Got:
        """A `body` is sent as JSON unless it is bytes."""
        data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
        self.connection.request(method, path if path.startswith("/") else self.base + path, data, headers or {})
        answer = self.connection.getresponse()
        return Got(answer.status, answer.headers, answer.read())

    def get(self, path: str, **headers: str) -> Got:
        return self.ask("GET", path, headers=headers)

    def post(self, path: str, /, **body: Any) -> Got:
        return self.ask("POST", f"api/{path}", body)

    def state(self) -> Any:
        return self.get("api/state").json

    def put_draft(self, frame: int, **targets: Any) -> Got:
        return self.post("draft", draft={"frame": frame, "targets": targets})

    def save(self) -> Got:
        return self.post("save")

    def until(self, done, what: str = "the state") -> Any:
        """The state as soon as `done` says so of it."""
        return wait_for(lambda: state if done(state := self.state()) else None, what)

    def close(self) -> None:
        self.connection.close()


def wait_for(look, what: str, at_most_s: float = 60.0) -> Any:
    """The first true value that `look` gives, which is asked less and less often: what it asks takes the processor."""
    ends, pause = time.monotonic() + at_most_s, 0.01
    while not (found := look()):
        assert time.monotonic() < ends, f"waited in vain for {what}"
        time.sleep(pause)
        pause = min(1.2 * pause, 0.1)
    return found


def drive(monkeypatch, home, act):
    """Have the page that the command serves visited by `act`, instead of a browser."""

    def visited(client):
        try:
            act(client)
        except BaseException:
            interrupt_main()  # nobody else ends the command
            raise
        finally:
            client.close()

    def visit(address):
        # everybody may read the command line of a browser: it has no token, but a file of the user's own
        file = Path(url2pathname(urlsplit(address).path))
        assert address.startswith("file://") and file.parent == home
        assert os.name != "posix" or stat.S_IMODE(file.stat().st_mode) == 0o600
        [url] = re.findall(r"url=(http://127\.0\.0\.1:[0-9]+/[^\"]+)", file.read_text())
        assert urlsplit(url).path.strip("/") not in address
        Thread(target=visited, args=(Client(url),)).start()
        return False

    monkeypatch.setattr(Path, "home", lambda: home)
    monkeypatch.setattr(server.webbrowser, "open", visit)
