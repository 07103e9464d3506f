"""The page's server: on the loopback address alone, and only for those who know the token in its address. A page of
another site cannot use it: the host must be a loopback name, since a name of that site may resolve to this machine (DNS
rebinding), and requests with an origin must come from this very page."""

import contextlib
import hmac
import json
import os
import re
import secrets
import socketserver
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs

from pydantic import TypeAdapter, ValidationError

from facetrack_cli.core.errors import FacetrackError, UsageError, flat
from facetrack_cli.editor.session import Answer, Page

ADDRESS: Final = "127.0.0.1"
MAX_BODY_BYTES: Final = 1024 * 1024  # the largest draft has fewer, and so has a piece of a file that is dropped
IDLE_S: Final = 60.0  # until a connection without requests is closed
POLL_S: Final = 0.1
PIECE_BYTES: Final = 1 << 20  # of a video that are sent at a time, at most
KINDS: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
HEAD: Final = b"""<head>
    <meta charset="utf-8">
    <meta name="viewport" content="width=device-width, initial-scale=1, viewport-fit=cover">
    <meta name="color-scheme" content="dark light">
    <meta name="robots" content="noindex">
    <link rel="icon" href="data:,">
    <link rel="stylesheet" href="style.css">"""
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
_RANGE = re.compile(r"bytes=(?=.*[0-9])([0-9]{0,15})-([0-9]{0,15})")
_BODY = TypeAdapter(dict[str, Any])


@lru_cache(maxsize=1)
def assets() -> Mapping[str, Answer]:
    """The files of the page by name; no other file is ever served."""
    return {
        file.name: Answer(file.read_bytes().replace(b"<head>", HEAD), kind=f"{KINDS[file.suffix]}; charset=utf-8")
        for file in Path(__file__).with_name("assets").iterdir()
        if file.suffix in KINDS
    }


class Server(ThreadingHTTPServer):
    """One page, at `url`, and those that are opened from it below. UsageError if the port is taken; 0 is any free."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 64
    allow_reuse_address = os.name != "nt"  # on Windows it would let two servers share a port

    def __init__(self, session: Page, port: int = 0) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(32)
        try:
            super().__init__((ADDRESS, port), _Handler)
        except OSError as e:
            reason = (e.strerror or str(e)).lower()
            raise UsageError(f"--port {port}: {reason}; give another one, or none for any free port") from None

    def server_bind(self) -> None:
        socketserver.TCPServer.server_bind(self)  # that of http.server asks the network for this machine's name
        self.server_name, self.server_port = ADDRESS, self.socket.getsockname()[1]

    @property
    def url(self) -> str:
        return f"http://{ADDRESS}:{self.server_port}/{self.token}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Record an error, but not that a tab was closed."""
        error = sys.exc_info()[1]
        if isinstance(error, Exception) and not isinstance(error, OSError):
            self.session.record(error)


@contextlib.contextmanager
def serving(session: Page, port: int = 0) -> Iterator[Server]:
    """The server of a session, running in its own threads within the `with`; then the session is closed."""
    with contextlib.closing(session), Server(session, port) as server:
        thread = threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def run_page(
    session: Page, stop: Callable[[], bool], say: Callable[[str], None], *, port: int = 0, browse: bool = False
) -> None:
    """Serve the page until it has ended or `stop` says so, and its job is done; `port` as of Server."""
    with serving(session, port) as server:
        at = server.server_port
        say(f"open this page: {server.url}")
        say(f"from another machine: ssh -L {at}:127.0.0.1:{at} HOST, then open the same address there; Ctrl-C ends it")
        with _redirect(server.url) if browse else contextlib.nullcontext() as file:
            if file is not None:  # in a thread, since a browser of the terminal returns only when it is closed
                threading.Thread(target=_browse, args=(file.as_uri(), say), daemon=True).start()
            while not (session.over() or stop()):
                time.sleep(POLL_S)
    if session.fault is not None:
        say(f"facetrack: warning: while the page was open: {session.fault}")


@contextlib.contextmanager
def _redirect(url: str) -> Iterator[Path]:
    """A file of this user's alone that leads to the page: everybody may read the command line of a browser.

    It is in the home folder, since browsers in a sandbox see neither the temporary folder nor hidden ones.
    """
    home = Path.home()
    folder = home if os.access(home, os.W_OK) else None
    kind: Any = {"prefix": "facetrack-page-", "suffix": ".html", "dir": folder, "encoding": "utf-8"}
    with tempfile.NamedTemporaryFile("w", delete=False, **kind) as file:  # mode 0600
        file.write(f'<meta http-equiv="refresh" content="0;url={url}">\n')
    try:
        yield Path(file.name)
    finally:
        Path(file.name).unlink(missing_ok=True)


def _browse(url: str, say: Callable[[str], None]) -> None:
    if not webbrowser.open(url):
        say("no browser can be opened from here; open the page yourself")


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "facetrack", ""
    timeout = IDLE_S
    disable_nagle_algorithm = True  # headers and body are sent one after the other

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def end_headers(self) -> None:
        for header in HEADERS.items():
            self.send_header(*header)
        super().end_headers()

    def do_GET(self) -> None:
        self._page = self.server.session
        try:
            answer = _encoded(self._route())
        except ValidationError as e:
            first = e.errors(include_url=False)[0]
            answer = _refusal(400, ": ".join(filter(None, [".".join(map(str, first["loc"])), first["msg"]])))
        except FacetrackError as e:
            answer = _refusal(422, str(e))
        except (ConnectionError, TimeoutError):  # the page has gone
            raise
        except Exception as e:
            if self._page.stopping.is_set():  # what it needs is closed
                raise ConnectionAbortedError from e
            answer = _refusal(500, self.server.session.record(e))
        if isinstance(answer.body, Path):
            answer = _of_file(answer, self.headers.get("Range", ""))
        self.send_response(answer.code)
        headers = {"Content-Type": answer.kind, "Content-Length": str(len(answer.body)), **answer.headers}
        for header in headers.items():
            self.send_header(*header)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(answer.body)

    do_PUT = do_POST = do_GET  # noqa: N815

    def _route(self) -> Any:
        lengths = self.headers.get_all("Content-Length", ["0"])
        known = len(lengths) == 1 and "Transfer-Encoding" not in self.headers
        if not (known and re.fullmatch("[0-9]{1,15}", text := lengths[0].strip())):
            self.close_connection = True
            return _refusal(411, "the length of the body must be given, once")
        if (length := int(text)) > MAX_BODY_BYTES:
            self.close_connection = True
            return _refusal(413, f"{length} bytes are too many; at most {MAX_BODY_BYTES} are accepted")
        data = self.rfile.read(length)  # in any case, or it would be taken for the next request
        if len(data) != length:
            raise ConnectionResetError
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0].strip()):
            only = "this page is for localhost and 127.0.0.1 alone"
            return _refusal(403, f"{only}; open the address that facetrack printed")
        origins = [origin.strip().lower() for origin in self.headers.get_all("Origin", [])]
        # a browser that hides the origin sends null; no page can forge the other header
        hidden = origins == ["null"] and self.headers.get_all("Sec-Fetch-Site") == ["same-origin"]
        if not hidden and origins not in ([], [f"http://{hosts[0].strip().lower()}"]):  # also through a tunnel
            return _refusal(403, "requested by a page of another origin")
        path, _, query = self.path.partition("?")
        begin, token, below = (*path.split("/", 2), "", "")[:3]
        known = hmac.compare_digest(token.encode(), self.server.token.encode())
        if begin or not known or path.count("/") < 2:
            return _refusal(403, "the address lacks its token; open the whole address that facetrack printed")
        self._page, below = self.server.session.page_at(below)
        asset = assets().get(below or self._page.index)
        if asset is not None and self.command == "GET":
            return asset
        name = re.fullmatch("api/([a-z]+)", below)
        handler = name and self._page.handler(f"{self.command.lower()}_{name[1]}")
        if not handler:
            return _refusal(404, "there is nothing at this address")
        fields: dict[str, Any] = parse_qs(query, keep_blank_values=True)
        given = {name: values[0] if len(values) == 1 else values for name, values in fields.items()}
        if self.command != "GET":
            given |= {"data": data} if self.command == "PUT" else _BODY.validate_json(data or b"{}")
        return handler(**given)


def _of_file(answer: Answer, asked: str) -> Answer:
    """The bytes of a file, or some of those that are asked for: a browser goes to any time of a video only so."""
    try:
        with answer.body.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            match = _RANGE.fullmatch(asked)
            begin, end = match.groups() if match else ("0", "")
            first = int(begin) if begin else max(size - int(end), 0)
            stop = min(int(end) + 1, size) if begin and end else size
            if match and first >= stop:
                return Answer(b"", 416, headers={"Content-Range": f"bytes */{size}"})
            file.seek(first)
            data = file.read(min(stop - first, PIECE_BYTES) if match else size)
    except OSError as e:
        return _refusal(404, f"{answer.body}: {e.strerror or e}")
    part = {"Content-Range": f"bytes {first}-{first + len(data) - 1}/{size}"} if match else {}
    headers = {**answer.headers, "Accept-Ranges": "bytes", **part}
    return answer._replace(body=data, code=206 if match else answer.code, headers=headers)


def _encoded(answer: Any) -> Answer:
    """What a handler returned, its JSON as bytes."""
    whole: Answer = answer if isinstance(answer, Answer) else Answer(answer)
    if isinstance(whole.body, bytes | Path):
        return whole
    return whole._replace(body=json.dumps(whole.body, separators=(",", ":"), allow_nan=False).encode())


def _refusal(code: int, reason: str) -> Answer:
    return _encoded(Answer({"error": flat(reason)}, code))
