"""The page's server: on the loopback address alone, and only for who knows the token in its address.

A page of another site cannot ask it: the host that the browser was sent to must be a loopback name, or a name of that
site might lead here (DNS rebinding), and what changes anything must come from this very page.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import re
import secrets
import socketserver
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Final
from urllib.parse import parse_qsl

from facetrack_cli.core.errors import FacetrackError, UsageError
from facetrack_cli.editor.web.routes import Answer, RefusedError, Request, Route
from facetrack_cli.editor.web.session import Session

ADDRESS: Final = "127.0.0.1"
MOST_BODY: Final = 256 * 1024  # bytes: a draft of the most targets and points that may be has fewer
MOST_DRAINED: Final = 4 * 1024 * 1024  # of a body that is refused, so that its sender gets to read why
MOST_FIELDS: Final = 16
IDLE_S: Final = 60.0  # until a connection that asks for nothing is closed
POLL_S: Final = 0.1

KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_HOST = re.compile(r"(?:localhost|127\.0\.0\.1|\[::1\])(?::[0-9]{1,5})?", re.IGNORECASE)
_NUMBER = "([0-9]{1,9})"


@lru_cache(maxsize=1)
def assets() -> Mapping[str, str]:
    """The files of the page in the package, by name, with their kinds: nothing else is ever served."""
    files = resources.files("facetrack_cli.editor.web").joinpath("assets")
    if not files.is_dir():
        return {}
    found = {}
    for file in files.iterdir():
        kind = KINDS.get(os.path.splitext(file.name)[1])  # noqa: PTH122 -- a resource need not be a path
        if kind is not None and file.is_file():
            found[file.name] = kind
    return found


class Server(ThreadingHTTPServer):
    """One session, at `url`. Raises UsageError if the port cannot be had; 0 is any that is free."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 64
    allow_reuse_address = os.name != "nt"  # there it would let two servers share a port

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(32)
        self.table: list[tuple[str, re.Pattern[str], Callable[[Request], Any]]] = [
            (route.method, _pattern(route), route.handler) for route in (*session.shared_routes(), *session.routes())
        ]
        try:
            super().__init__((ADDRESS, port), _Handler)
        except OSError as e:
            reason = e.strerror or str(e)
            raise UsageError(
                f"--port {port}: {reason.lower()}; give another one, or none for any that is free"
            ) from None

    def server_bind(self) -> None:
        socketserver.TCPServer.server_bind(self)  # http.server's asks the network for the name of this machine
        self.server_name, self.server_port = ADDRESS, self.socket.getsockname()[1]

    @property
    def url(self) -> str:
        return f"http://{ADDRESS}:{self.server_port}/{self.token}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """A tab that was closed is nothing; anything else is remembered."""
        error = sys.exc_info()[1]
        if isinstance(error, Exception) and not isinstance(error, OSError):
            self.session.fault(error)


@contextlib.contextmanager
def serving(session: Session, port: int = 0) -> Iterator[Server]:
    """The server of a session at work in threads of its own, for the length of a `with`."""
    with Server(session, port) as server:
        thread = threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()
            session.close()


def _pattern(route: Route) -> re.Pattern[str]:
    return re.compile(_NUMBER.join(re.escape(piece) for piece in route.path.split("{}")))


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "facetrack", ""
    timeout = IDLE_S
    disable_nagle_algorithm = True  # headers and body go out one after the other

    def do_GET(self) -> None:
        self._answer("GET")

    def do_PUT(self) -> None:
        self._answer("PUT")

    def do_POST(self) -> None:
        self._answer("POST")

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What http.server refuses by itself, in our shape."""
        self.close_connection = True
        self._send(Answer({"error": (message or "refused")[:200]}, int(code)))

    def _answer(self, method: str) -> None:
        self._unread = self._length()
        try:
            answer = _packed(self._route(method))
        except RefusedError as e:
            answer = Answer({"error": str(e), **e.more}, e.code)
        except FacetrackError as e:
            answer = Answer({"error": " ".join(str(e).splitlines())}, 422)
        except (ConnectionError, TimeoutError):  # the page has gone
            raise
        except Exception as e:
            self.server.session.fault(e)
            told = f"this is our fault, not yours: {type(e).__name__}: {e}"
            answer = Answer({"error": " ".join(told.splitlines())}, 500)
        self._drain()
        self._send(answer)

    def _route(self, method: str) -> Answer:
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0].strip()):
            raise RefusedError(
                403, "this page is for localhost and 127.0.0.1 alone; open the address that facetrack printed"
            )
        if not self._is_of_the_page(hosts[0].strip().lower()):
            raise RefusedError(403, "asked by a page of another origin")
        path, _, query = self.path.partition("?")
        _, _, rest = path.partition("/")
        token, slash, below = rest.partition("/")
        if not path.startswith("/") or not hmac.compare_digest(token.encode(), self.server.token.encode()):
            raise RefusedError(403, "the address lacks its token; open the whole one that facetrack printed")
        if not slash:
            return Answer(b"", 308, "text/plain", (("Location", f"/{self.server.token}/"),))
        kind = assets().get(below or "index.html")
        if kind is not None:
            if method != "GET":
                raise RefusedError(405, f"{method} is not for this address")
            return Answer(_asset(below or "index.html"), kind=kind)
        return self._api(method, below, query)

    def _is_of_the_page(self, host: str) -> bool:
        """Whether the origin, if one is given, is this page's own, as it is called through a tunnel."""
        origins = [one.strip().lower() for one in self.headers.get_all("Origin", [])]
        # a browser that may not say from where it comes calls that null; no page can forge the other header
        known = origins == ["null"] and self.headers.get_all("Sec-Fetch-Site") == ["same-origin"]
        return not origins or known or origins == [f"http://{host}"]

    def _api(self, method: str, path: str, query: str) -> Answer:
        known = False
        for wanted, pattern, handler in self.server.table:
            found = pattern.fullmatch(path)
            if found is None:
                continue
            known = True
            if wanted == method:
                body = self._body() if method != "GET" else {}
                numbers = tuple(int(number) for number in found.groups())
                answer = handler(Request(numbers, _query(query), body))
                return answer if isinstance(answer, Answer) else Answer(answer)
        if known:
            raise RefusedError(405, f"{method} is not for this address")
        raise RefusedError(404, "there is nothing at this address")

    def _length(self) -> int | None:
        """Bytes of the body that is to come; None if that cannot be told."""
        found = self.headers.get_all("Content-Length", [])
        if self.headers.get("Transfer-Encoding") is not None or len(found) > 1:
            return None
        text = found[0].strip() if found else "0"
        return int(text) if text.isascii() and text.isdigit() and len(text) < 16 else None

    def _body(self) -> dict[str, Any]:
        if self._unread is None:
            raise RefusedError(411, "how long the body is must be said, once")
        if self._unread > MOST_BODY:
            raise RefusedError(413, f"{self._unread} bytes are too many; {MOST_BODY} are taken")
        data = self.rfile.read(self._unread)
        if len(data) < self._unread:
            raise ConnectionResetError
        self._unread = 0
        if not data:  # of what says all in its address
            return {}
        try:
            found = json.loads(data.decode("utf-8"), parse_constant=_refuse_constant)
        except (ValueError, RecursionError):
            raise RefusedError(400, "the body is no JSON") from None
        if not isinstance(found, dict):
            raise RefusedError(400, "the body is no JSON object")
        return found

    def _drain(self) -> None:
        """What nobody has read would be taken for the next request."""
        if self._unread is None or self._unread > MOST_DRAINED:
            self.close_connection = True
            return
        while self._unread:
            piece = self.rfile.read(min(self._unread, 1 << 16))
            if not piece:
                raise ConnectionResetError
            self._unread -= len(piece)

    def _send(self, answer: Answer) -> None:
        body = _packed(answer).body
        self.send_response(answer.code)
        self.send_header("Content-Type", answer.kind)
        self.send_header("Content-Length", str(len(body)))
        for name, value in (*HEADERS.items(), *answer.headers):
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)


def _packed(answer: Answer) -> Answer:
    """With its JSON as bytes."""
    if isinstance(answer.body, bytes):
        return answer
    return answer._replace(body=json.dumps(answer.body, separators=(",", ":"), allow_nan=False).encode())


def _query(text: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(text, keep_blank_values=True, max_num_fields=MOST_FIELDS)
    except ValueError:
        raise RefusedError(400, f"more than {MOST_FIELDS} fields after the ?") from None
    if len(dict(pairs)) < len(pairs):
        raise RefusedError(400, "a field after the ? is given twice")
    return dict(pairs)


def _asset(name: str) -> bytes:
    return resources.files("facetrack_cli.editor.web").joinpath("assets", name).read_bytes()


def _refuse_constant(name: str) -> None:
    raise ValueError(name)
