"""The page's server: who may use it, what it refuses, and that a connection that breaks does no harm."""

import contextlib
import json
import math
import os
import socket
import threading
from fractions import Fraction
from importlib import resources
from itertools import product
from typing import Literal

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import Frame
from facetrack_cli.editor.server import ADDRESS, HEAD, HEADERS, MAX_BODY_BYTES, Server, assets, serving
from facetrack_cli.editor.session import Answer, Draft, DraftTarget, Session, jpeg
from tests.support.page_client import Client, wait_for

LARGE = b"\xff" * 40_000_000  # more than the buffers of any connection hold
EMPTY = {"frame": 0, "targets": {}}
SIZE = (83, 46)  # divisible by none of the reductions but 2, and that only its height


class Frames:
    """Twelve frames that JPEG keeps; the one numbered 7 is broken."""

    size, fps, count, exact = SIZE, Fraction(25), 12, True

    def read(self, index):
        if index == 7 or index >= self.count:
            raise InputError(f"clip: frame {index} cannot be decoded; convert it")
        y, x = np.mgrid[: SIZE[1], : SIZE[0]]
        return Frame(index, index / 25, np.dstack([2 * x, 3 * y + 10 * index, x + y]).astype(np.uint8))


class Plain(Session):
    mode = "pick"

    def __init__(self):
        about = {"clip": "clip.mp4", "recipe": None, "requirements": [], "free": True, "saves_to": "clip.init.yaml"}
        super().__init__(Frames(), Draft(0, {}), about)
        self.go = threading.Event()
        self.fails = None

    def post_save(self):
        return self.start_job("saving", self._work)

    def _work(self, report):
        report(1, 2)
        assert self.go.wait(60)
        if self.fails is not None:
            raise self.fails
        self.end(["a: written"], "facetrack run a")

    def get_frame(self, frame: int, reduce: Literal["1", "2", "4", "8"] = "1"):
        return Answer(LARGE, kind="image/jpeg") if reduce == "8" else super().get_frame(frame, reduce)

    def get_odd(self, one: int, other: int):
        return [one, other]

    def post_boom(self):
        raise ZeroDivisionError("two\nlines")

    def post_nan(self):
        return {"x": math.nan}

    def post_input(self):
        raise InputError("clip.mp4: gone")


@pytest.fixture
def session():
    one = Plain()
    yield one
    one.go.set()


@pytest.fixture
def server(session):
    with serving(session) as one:
        yield one
        session.go.set()


@pytest.fixture
def client(server):
    with contextlib.closing(Client(server.url)) as one:
        yield one


def raw(server, data, *, end=True):
    """What the server answers to these bytes until it closes the connection."""
    with socket.create_connection((ADDRESS, server.server_port), timeout=60) as link:
        link.sendall(data.replace(b"TOKEN", server.token.encode()))
        if end:
            link.shutdown(socket.SHUT_WR)
        answer = b""
        while piece := link.recv(65536):
            answer += piece
        return answer


def get(server, path, head="Host: localhost", method="GET", http="HTTP/1.1"):
    return raw(server, f"{method} {path} {http}\r\n{head}\r\n\r\n".encode("latin-1"))


# --- who may use it --------------------------------------------------------------------------------------------------


def test_a_request_without_the_token_gets_nothing(server):
    token = server.token
    paths = ["/", "*", "/wrong/", "/wrong", f"/{token[:-1]}/", f"/{token}x/", f"/{token.swapcase()}/", f"/{token}%2f",
             "/%00/", "/\xe9/", f"/{token[:-1]}", "/api/state"]  # fmt: skip
    for path, method in product(paths, ("GET", "PUT", "POST")):
        got = get(server, path, "Host: localhost\r\nContent-Length: 0", method)
        assert got.startswith(b"HTTP/1.1 403 ") and token.encode() not in got, (method, path)
        assert b'"error":"the address lacks its token' in got


def test_a_path_outside_is_refused(server):
    for path in [
        "../../etc/passwd", "%2e%2e/%2e%2e/etc/passwd", "..%2f..%2fetc%2fpasswd", "/etc/passwd", "%2fetc%2fpasswd",
        "..\\..\\etc", "assets/../server.py", "server.py", "../server.py", "__init__.py", "style.css/", "%00", "x?x",
        "api", "api/", "api/state/", "api/frame/1", "api/State", "api/get_state", "api/handler", "API/state",
    ]:  # fmt: skip
        got = get(server, f"/TOKEN/{path}")
        assert got.startswith(b"HTTP/1.1 404 ") and b"root:" not in got, path
        assert json.loads(got.partition(b"\r\n\r\n")[2])["error"]


def test_it_listens_on_the_loopback_address_alone(server, session):
    assert server.socket.getsockname()[0] == "127.0.0.1" and server.socket.family == socket.AF_INET
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:  # which address of ours would reach another machine
        try:
            link.connect(("192.0.2.1", 9))  # sends nothing
            others = {link.getsockname()[0]} - {"127.0.0.1"}
        except OSError:  # no network at all
            others = set()
    if os.uname().sysname == "Linux":
        others.add("127.0.0.2")
    for address in others:
        with pytest.raises(OSError):
            socket.create_connection((address, server.server_port), timeout=5)
    with pytest.raises(UsageError, match=rf"--port {server.server_port}: address already in use; give another"):
        Server(session, server.server_port)


def test_another_host_or_origin_is_refused(server, client):
    for host in ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "localhost@evil.example",
                 "evil.example:80", "127.0.0.1:80:80", "localhost:x", "0.0.0.0", "192.0.2.2", "[::]", "", "localhost/",
                 "127.1", "localhost\r\nHost: a"]:  # fmt: skip
        got = get(server, "/TOKEN/api/state", f"Host: {host}")
        assert got.startswith(b"HTTP/1.1 403 ") and b"job" not in got, host
    assert get(server, "/TOKEN/api/state", "", http="HTTP/1.0").startswith(b"HTTP/1.1 403 "), "no host at all"
    for origin in ["http://evil.example", "null", "", "https://localhost:1", "http://localhost:2", "http://localhost",
                   "file://"]:  # fmt: skip
        headers = {"Host": "localhost:1", "Origin": origin}
        assert client.ask("POST", "api/draft", {"draft": EMPTY}, headers).status == 403, origin
        assert client.ask("POST", "api/save", {}, headers).status == 403
        assert client.state()["job"] is None


def test_a_tunnel_may_change_the_port_and_a_browser_hide_the_origin(client):
    for host in ["localhost", "LOCALHOST:80", "127.0.0.1:9999", "[::1]:1", "localhost:65535"]:
        assert client.get("api/state", Host=host).status == 200
        own = {"Host": host, "Origin": f"http://{host}"}
        assert client.ask("POST", "api/draft", {"draft": EMPTY}, own).status == 200
    for origin, site, status in [("null", "same-site", 403), ("http://evil.example", "same-origin", 403),
                                 ("null", "same-origin", 200)]:  # fmt: skip
        headers = {"Origin": origin, "Sec-Fetch-Site": site}
        assert client.ask("POST", "api/draft", {"draft": EMPTY}, headers).status == status


def test_every_answer_has_the_headers(client):
    for method, path, status in [
        ("GET", "api/state", 200), ("GET", "api/frame?frame=1", 200), ("GET", "nothing", 404), ("GET", "/", 403),
        ("POST", "api/draft", 400), ("PUT", "api/state", 404), ("POST", "api/boom", 500), ("DELETE", "api/state", 501),
    ]:  # fmt: skip
        got = client.ask(method, path, {})
        assert got.status == status, path
        assert {name: got.headers[name] for name in HEADERS} == HEADERS
        assert got.headers["Cache-Control"] == "no-store" and got.headers["X-Content-Type-Options"] == "nosniff"
        assert got.headers["Content-Security-Policy"].startswith("default-src 'self'; img-src 'self' blob: data:; obj")
        assert "Access-Control-Allow-Origin" not in got.headers and "Python" not in got.headers["Server"]


# --- what it serves --------------------------------------------------------------------------------------------------


def test_the_files_of_the_page_are_served_and_no_others(client):
    folder = resources.files("facetrack_cli.editor").joinpath("assets")
    assert set(assets()) == {file.name for file in folder.iterdir()}
    for name, asset in assets().items():
        got, data = client.get(name), (folder / name).read_bytes().replace(b"<head>", HEAD)
        assert (got.status, got.headers["Content-Type"], got.data) == (200, asset.kind, data)
        assert client.ask("PUT", name, {}).status == 404
    assert client.get("").data == client.get("index.html").data
    assert client.get("api/odd?one=3&other=14").json == [3, 14] and client.ask("POST", "api/odd", {}).status == 404


def decode(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def test_a_jpeg_is_the_whole_frame_reduced_by_area_means(client):
    whole, grey = Frames().read(2).bgr.astype(float), np.array([0.114, 0.587, 0.299])  # JPEG keeps less of the colours
    for reduce in (1, 2, 4, 8):
        data = jpeg(Frames(), 2, reduce)
        assert data.startswith(b"\xff\xd8\xff")
        width, height = -(-SIZE[0] // reduce), -(-SIZE[1] // reduce)
        assert decode(data).shape == (height, width, 3)
        # a pixel of it is the mean of the part of the frame that it covers when it is stretched over it
        fine = np.repeat(np.repeat(whole @ grey, height, axis=0), width, axis=1)
        expected = fine.reshape(height, SIZE[1], width, SIZE[0]).mean(axis=(1, 3))
        assert np.abs(decode(data) @ grey - expected).max() < 4.0
    got = client.get("api/frame?frame=2&reduce=4")
    assert (got.status, got.headers["Content-Type"], got.data) == (200, "image/jpeg", jpeg(Frames(), 2, 4))
    assert client.get("api/frame?frame=7").json == {"error": "clip: frame 7 cannot be decoded; convert it"}
    for query in ["reduce=3", "reduce=", "reduce=x", "reduce=" + "9" * 300, "reduce=1&reduce=2", "a=1"]:
        got = client.get(f"api/frame?frame=3&{query}")
        assert got.status == 400 and len(got.json["error"].splitlines()) == 1, query


# --- what it is sent -------------------------------------------------------------------------------------------------


def test_a_body_of_unknown_or_great_length_is_refused(server, client):
    assert client.ask("POST", "api/draft", b" " * MAX_BODY_BYTES).status == 400
    head = f"POST /TOKEN/api/draft HTTP/1.1\r\nHost: localhost\r\nContent-Length: {MAX_BODY_BYTES + 1}\r\n\r\n"
    assert raw(server, head.encode(), end=False).startswith(b"HTTP/1.1 413 "), "without waiting for all of it"
    for length in ["Content-Length: -5", "Content-Length: x", "Content-Length: 2\r\nContent-Length: 3",
                   "Transfer-Encoding: chunked", f"Content-Length: {'9' * 30}", "Content-Length: \xb2"]:  # fmt: skip
        body = f"Host: localhost\r\n{length}\r\n\r\n{{}}GET / HTTP/1.1"
        got = get(server, "/TOKEN/api/draft", body, "POST")
        assert got.startswith(b"HTTP/1.1 411 ") and got.count(b"HTTP/1.1") == 1, "what follows is no request"


def test_a_body_that_is_no_draft_is_refused_in_one_line(client):
    for body in [b"", b" ", b"{", b"[1]", b"null", b'"a"', b"\xff\xfe", b'{"draft": NaN}', b"[" * 200_000,
                 b'{"draft": ' + b"9" * 10_000 + b"}"]:  # fmt: skip
        assert client.ask("POST", "api/draft", body).status == 400, body[:20]
    targets = [
        {"box": [1, 2, 3]}, {"box": [1, 2, 0, 4]}, {"box": [1, 2, 3, True]}, {"box": "1234"},
        {"box": [1e300, 2, 3, 4]}, {"box": [10**400, 2, 3, 4]}, {"box": [math.nan, 2, 3, 4]}, {"size": 1},
        {"points": {"nose": [1, None]}}, {"points": [1]}, {"points": {"": [1, 2]}}, {"points": {"nose": [-1e7, 2]}},
        {"absent": "nose"}, {"absent": ["a/b"]},
        {"absent": ["nose\n"]},
    ]  # fmt: skip
    for draft in [
        None, {"frame": -1, "targets": {}}, {"frame": True, "targets": {}}, {"frame": 0},
        {"frame": 10**30, "targets": {}}, {"frame": 0, "targets": {}, "more": 1},
        {"frame": 0, "targets": {"\ud800": {}}},
        *({"frame": 0, "targets": {"face": target}} for target in targets),
    ]:  # fmt: skip
        got = client.ask("POST", "api/draft", {"draft": draft})
        assert got.status == 400 and len(got.json["error"].splitlines()) == 1, draft
        assert client.state()["draft"] == EMPTY


def test_a_draft_comes_back_as_it_was(client, session):
    face = {"box": [1.25, -2, 30, 40], "points": {"nose": [3, 4.125]}, "absent": ["lip"]}
    targets = {"face": face, "hand": {"absent": True}, "other": {}}
    assert client.put_draft(5, **targets).status == 200
    nothing = {"box": None, "points": {}, "absent": []}
    expected = {"face": face, "hand": {**nothing, "absent": True}, "other": nothing}
    assert client.state()["draft"] == {"frame": 5, "targets": expected}
    assert session.draft.targets["face"] == DraftTarget((1.25, -2, 30, 40), {"nose": (3, 4.125)}, ("lip",))
    got = client.put_draft(12, **targets)
    assert got.status == 422 and got.json["error"] == "there is no frame 12; they go from 0 to 11"


# --- jobs ----------------------------------------------------------------------------------------------------------


def test_saving_is_one_job_and_then_the_session_ends(client, session):
    assert client.put_draft(3).status == 200
    assert client.save().status == 200
    client.until(lambda state: state["job"] == {"what": "saving", "done": 1, "total": 2})
    assert client.save().json["error"] == "busy: saving; wait until it has finished"
    assert client.put_draft(4).status == 422, "what is being saved stands"
    assert client.state()["draft"]["frame"] == 3
    session.go.set()
    state = client.until(lambda state: state["ended"] and not state["job"])
    assert state["ended"] == {"messages": ["a: written"], "next": "facetrack run a"}
    assert client.put_draft(4).status == 422 and client.save().status == 422


@pytest.mark.parametrize("error", [InputError("a: full\ndisk"), ZeroDivisionError("a: full disk")])
def test_a_job_that_fails_says_so_and_may_be_tried_again(client, session, error):
    session.fails = error
    session.go.set()
    assert client.save().status == 200
    state = client.until(lambda state: state["message"])
    assert "a: full disk" in state["message"] and state["job"] is None and state["ended"] is None
    assert (session.fault is not None) == isinstance(error, ZeroDivisionError)
    session.fails = None
    assert client.save().status == 200
    assert client.until(lambda state: state["ended"])["message"] is None


# --- who goes away, and what goes wrong ------------------------------------------------------------------------------


def test_a_tab_that_is_closed_in_the_middle_of_a_frame_is_nothing(server, client, session, capfd):
    threads = threading.active_count()
    for _ in range(3):
        link = socket.create_connection((ADDRESS, server.server_port), timeout=60)
        link.sendall(f"GET /{server.token}/api/frame?frame=1&reduce=8 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert link.recv(100).startswith(b"HTTP/1.1 200 ")
        link.close()
    half = b"POST /TOKEN/api/draft HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{"
    for data in (half, b"GET /TOK", b"\0\1"):
        raw(server, data)
    wait_for(lambda: threading.active_count() <= threads, "the threads of those connections")
    assert client.get("api/state").status == 200
    assert session.fault is None and capfd.readouterr() == ("", "")


def test_an_internal_error_is_one_line_and_remembered(client, session, capfd):
    got = client.ask("POST", "api/boom", {})
    assert got.status == 500 and got.json["error"] == "internal error; please report it: ZeroDivisionError: two lines"
    assert client.ask("POST", "api/nan", {}).status == 500, "NaN is no JSON, and is not sent"
    assert "ZeroDivisionError" in session.fault, "the first one is kept"
    assert client.ask("POST", "api/input", {}).status == 422
    assert client.get("api/state").status == 200
    session.stopping.set()
    session.fault = None
    with pytest.raises(ConnectionError):  # a request that meets the end gets no answer
        client.ask("POST", "api/boom", {})
    assert session.fault is None and capfd.readouterr() == ("", "")
