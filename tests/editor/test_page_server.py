"""The page's server: who may ask it, what it refuses, and that nobody who goes away does any harm."""

import json
import math
import os
import socket
import threading
from fractions import Fraction
from importlib import resources

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.editor.web import server as server_module
from facetrack_cli.editor.web import session as session_module
from facetrack_cli.editor.web.draft import Draft, DraftTarget
from facetrack_cli.editor.web.routes import Answer, RefusedError, Route
from facetrack_cli.editor.web.server import ADDRESS, HEADERS, MOST_BODY, MOST_DRAINED, Server, assets, serving
from facetrack_cli.editor.web.session import Session
from tests.support.page_client import Client, wait_for

LARGE = b"\xff" * 40_000_000  # more than the buffers of any connection hold


class Frames:
    size, fps, count, exact = (64, 48), Fraction(25), 12, True


class Pictures:
    def jpeg(self, index, reduce):
        if index == 7:
            raise InputError("clip: frame 7 cannot be decoded; convert it")
        return LARGE if reduce == 8 else b"%d/%d" % (index, reduce)

    def crop(self, index, x, y, w, h):
        return b"%d:%d,%d,%d,%d" % (index, x, y, w, h)


class Plain(Session):
    mode = "pick"

    def __init__(self):
        super().__init__(
            clip="clip.mp4", recipe=None, frames=Frames(), pictures=Pictures(), saves_to="clip.init.yaml", wants=[],
            free=True, draft=Draft(0),
        )  # fmt: skip
        self.go = threading.Event()
        self.fails = None

    def proposals(self, index):
        return {"frame": index}

    def save(self, draft):
        self.begin("saving", 2, self._work, of=draft)

    def _work(self, report):
        report(1, 2)
        assert self.go.wait(60)
        if self.fails is not None:
            raise self.fails
        self.end(["a: written"], "facetrack run a")

    def routes(self):
        return (
            Route("GET", "api/odd/{}/{}", lambda request: list(request.numbers)),
            Route("POST", "api/boom", self.boom),
            Route("POST", "api/nan", lambda request: {"x": math.nan}),
            Route("POST", "api/input", lambda request: Answer(self.refuse(), 200)),
        )

    def boom(self, request):
        raise ZeroDivisionError("two\nlines")

    def refuse(self):
        raise InputError("clip.mp4: gone")


@pytest.fixture
def session(monkeypatch):
    monkeypatch.setattr(server_module, "POLL_S", 0.005)  # the tests are many
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
    one = Client(server.url)
    yield one
    one.close()


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


# --- the token -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "path",
    ["/", "", "/wrong/", "/wrong", "/{short}/", "/{token}x/", "/{swapped}/", "/{token}%2f", "/%00/", "/é/", "/{short}",
     "/api/state"],
)  # fmt: skip
@pytest.mark.parametrize("method", ["GET", "PUT", "POST"])
def test_who_does_not_know_the_token_gets_nothing(server, client, path, method):
    told = path.format(token=server.token, short=server.token[:-1], swapped=server.token.swapcase())
    got = raw(server, f"{method} {told or '*'} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n".encode())
    assert got.startswith(b"HTTP/1.1 403 ") and server.token.encode() not in got
    assert b'"error":"the address lacks its token' in got


def test_a_token_is_long_and_new_each_time(session):
    with Server(session) as one, Server(session) as other:
        assert one.token != other.token and len(one.token) >= 32
        assert one.url == f"http://127.0.0.1:{one.server_port}/{one.token}/"


def test_the_address_without_its_last_slash_leads_to_the_page(server, client):
    got = client.get(f"/{server.token}")
    assert (got.status, got.headers["Location"]) == (308, f"/{server.token}/")


@pytest.mark.parametrize(
    "path",
    [
        "../../etc/passwd", "%2e%2e/%2e%2e/etc/passwd", "..%2f..%2fetc%2fpasswd", "/etc/passwd", "%2fetc%2fpasswd",
        "..\\..\\etc", "assets/../server.py", "server.py", "../server.py", "__init__.py", "style.css/", "%00", "?x",
        "api", "api/", "api/state/", "api/frame/1.png", "api/frame/-1.jpg", "api/frame/1", "api/frame/99999999999.jpg",
        "api/frame/%31.jpg", "api/frame/1.5.jpg", "api/frame/\xb2.jpg", "api/frame/12.jpg", "api/frame/7.jpg",
        "api/proposals/12", "api/crop/12.png?x=0&y=0&w=8&h=8", "api/crop/1.png?x=64&y=0&w=8&h=8", "API/state",
    ],
)  # fmt: skip
def test_a_path_outside_is_refused(server, path):
    told = f"GET /TOKEN/{path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode("latin-1")
    if path == "?x":
        told = told.replace(b"/?x", b"/x?x")
    got = raw(server, told)
    assert got.startswith(b"HTTP/1.1 404 ") and b"root:" not in got
    assert json.loads(got.partition(b"\r\n\r\n")[2])["error"]


# --- where it listens, and whom it believes --------------------------------------------------------------------------


def test_it_listens_on_the_loopback_address_alone(server):
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


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "localhost@evil.example", "evil.example:80",
     "127.0.0.1:80:80", "localhost:x", "0.0.0.0", "192.0.2.2", "[::]", "", "localhost/", "127.1",
     "localhost\r\nHost: a"],
)  # fmt: skip
def test_another_host_is_refused(server, host):
    got = raw(server, f"GET /TOKEN/api/state HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    assert got.startswith(b"HTTP/1.1 403 ") and b"revision" not in got


def test_no_host_is_refused(server):
    assert raw(server, b"GET /TOKEN/api/state HTTP/1.0\r\n\r\n").startswith(b"HTTP/1.1 403 ")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:80", "127.0.0.1:9999", "[::1]:1", "localhost:65535"])
def test_a_tunnel_may_change_the_port(client, host):
    own = {"Host": host, "Origin": f"http://{host}"}
    assert client.get("api/state", Host=host).status == 200
    body = {"base": 0, "draft": {"frame": 1, "targets": {}}}
    assert client.ask("PUT", "api/draft", body, own).status == 200


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "", "https://localhost:1", "http://localhost:2", "http://localhost", "file://"],
)
def test_another_origin_changes_nothing(client, origin):
    headers = {"Host": "localhost:1", "Origin": origin}
    body = {"base": 0, "draft": {"frame": 1, "targets": {}}}
    assert client.ask("PUT", "api/draft", body, headers).status == 403
    assert client.ask("POST", "api/save", {"base": 0}, headers).status == 403
    state = client.get("api/state").json
    assert (state["revision"], state["job"]) == (0, None)


def test_an_origin_that_the_browser_hides_is_known_by_its_other_word(client):
    headers = {"Origin": "null", "Sec-Fetch-Site": "same-site"}
    body = {"base": 0, "draft": {"frame": 1, "targets": {}}}
    assert client.ask("PUT", "api/draft", body, headers).status == 403
    assert client.ask("PUT", "api/draft", body, {**headers, "Sec-Fetch-Site": "same-origin"}).status == 200
    evil = {"Origin": "http://evil.example", "Sec-Fetch-Site": "same-origin"}
    assert client.ask("PUT", "api/draft", body, evil).status == 403


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [("GET", "api/state", 200), ("GET", "api/frame/1.jpg", 200), ("GET", "nothing", 404), ("GET", "/", 403),
     ("PUT", "api/draft", 400), ("PUT", "api/state", 405), ("POST", "api/boom", 500), ("DELETE", "api/state", 501)],
)  # fmt: skip
def test_every_answer_has_the_headers(client, method, path, status):
    got = client.ask(method, path, {})
    assert got.status == status
    assert {name: got.headers[name] for name in HEADERS} == HEADERS
    assert got.headers["Cache-Control"] == "no-store" and got.headers["X-Content-Type-Options"] == "nosniff"
    assert "default-src 'self'" in got.headers["Content-Security-Policy"]
    assert "Access-Control-Allow-Origin" not in got.headers and "Python" not in got.headers["Server"]


def test_a_port_that_is_taken_is_a_usage_error(server, session):
    with pytest.raises(UsageError, match=rf"--port {server.server_port}: address already in use; give another"):
        Server(session, server.server_port)


# --- what it serves --------------------------------------------------------------------------------------------------


def test_the_files_of_the_page_are_served_and_no_others(client):
    folder = resources.files("facetrack_cli.editor.web").joinpath("assets")
    assert "index.html" in assets() and set(assets()) <= {file.name for file in folder.iterdir()}
    for name, kind in assets().items():
        got = client.get(name)
        assert (got.status, got.headers["Content-Type"], got.data) == (200, kind, (folder / name).read_bytes())
        assert client.ask("PUT", name, {}).status == 405
    assert client.get("").data == (folder / "index.html").read_bytes()


def test_pictures(client):
    got = client.get("api/frame/3.jpg?reduce=4")
    assert (got.status, got.headers["Content-Type"], got.data) == (200, "image/jpeg", b"3/4")
    assert client.get("api/frame/3.jpg").data == b"3/1"
    got = client.get("api/crop/2.png?x=-3&y=5&w=20&h=9")
    assert (got.status, got.headers["Content-Type"], got.data) == (200, "image/png", b"2:-3,5,20,9")
    assert client.get("api/frame/7.jpg").json == {"error": "clip: frame 7 cannot be decoded; convert it"}


@pytest.mark.parametrize(
    "query",
    ["reduce=3", "reduce=0", "reduce=-2", "reduce=16", "reduce=", "reduce=x", "reduce=1e1", "reduce=nan",
     "reduce=%C2%B2", "reduce=" + "9" * 300, "reduce=1&reduce=2", "&".join(f"a{k}=1" for k in range(40))],
)  # fmt: skip
def test_numbers_of_a_frame_are_checked(client, query):
    got = client.get(f"api/frame/3.jpg?{query}")
    assert got.status == 400 and len(got.json["error"].splitlines()) == 1


@pytest.mark.parametrize(
    "query",
    ["", "x=0&y=0&w=8", "x=0&y=0&w=0&h=8", "x=0&y=0&w=5000&h=8", "x=0.5&y=0&w=8&h=8", f"x={10**12}&y=0&w=8&h=8"],
)
def test_numbers_of_a_crop_are_checked(client, query):
    assert client.get(f"api/crop/3.png?{query}").status == 400


def test_a_session_has_routes_of_its_own(client):
    assert client.get("api/odd/3/14").json == [3, 14]
    assert client.ask("POST", "api/odd/3/14", {}).status == 405


def test_what_is_told_of_the_session(client):
    frames = {"first": 0, "last": 11, "exact": True}
    assert client.get("api/session").json == {
        "mode": "pick", "clip": "clip.mp4", "recipe": None, "size": [64, 48], "fps": 25.0, "frames": frames,
        "wants": [], "free": True, "saves_to": "clip.init.yaml",
    }  # fmt: skip
    assert client.get("api/state").json == {
        "revision": 0, "draft": {"frame": 0, "targets": {}}, "rows_revision": 0, "job": None, "can_undo": False,
        "ended": None, "frames": frames, "message": None,
    }  # fmt: skip


# --- what it is sent -------------------------------------------------------------------------------------------------


def test_a_body_that_is_too_large_is_refused(client, server):
    got = client.ask("PUT", "api/draft", b" " * (MOST_BODY + 1))
    assert got.status == 413 and str(MOST_BODY) in got.json["error"]
    assert client.get("api/state").status == 200, "the connection goes on with the next request"
    head = f"PUT /TOKEN/api/draft HTTP/1.1\r\nHost: localhost\r\nContent-Length: {MOST_DRAINED + 1}\r\n\r\n"
    assert raw(server, head.encode(), end=False).startswith(b"HTTP/1.1 413 "), "without waiting for all of it"


@pytest.mark.parametrize(
    "length", ["Content-Length: -5", "Content-Length: x", "Content-Length: 2\r\nContent-Length: 3",
               "Transfer-Encoding: chunked", f"Content-Length: {'9' * 30}", "Content-Length: \xb2"],
)  # fmt: skip
def test_a_body_of_unknown_length_is_refused(server, length):
    head = f"PUT /TOKEN/api/draft HTTP/1.1\r\nHost: localhost\r\n{length}\r\n\r\n{{}}GET / HTTP/1.1\r\n\r\n"
    got = raw(server, head.encode("latin-1"))
    assert got.startswith(b"HTTP/1.1 411 ") and got.count(b"HTTP/1.1") == 1, "what follows is no request"


@pytest.mark.parametrize(
    "body", [b"", b" ", b"{", b"[1]", b"null", b'"a"', b"\xff\xfe", b'{"base": NaN}', b'{"base": -Infinity}',
             b"[" * 200_000, b'{"base": ' + b"9" * 10_000 + b"}"],
)  # fmt: skip
def test_a_body_that_is_no_json_object_is_refused(client, body):
    assert client.ask("PUT", "api/draft", body).status == 400
    assert client.ask("POST", "api/save", body).status == 400


@pytest.mark.parametrize(
    "draft",
    [
        None, [], {"frame": -1, "targets": {}}, {"frame": 1.5, "targets": {}}, {"frame": True, "targets": {}},
        {"frame": 0},
        {"frame": 10**30, "targets": {}}, {"frame": 0, "targets": []}, {"frame": 0, "targets": {}, "more": 1},
        {"frame": 0, "targets": {"face": []}}, {"frame": 0, "targets": {"a b": {}}}, {"frame": 0, "targets": {"": {}}},
        {"frame": 0, "targets": {"\ud800": {}}}, {"frame": 0, "targets": {f"t{k}": {} for k in range(21)}},
        *({"frame": 0, "targets": {"face": face}} for face in (
            {"box": [1, 2, 3]}, {"box": [1, 2, 0, 4]}, {"box": [1, 2, 3, -4]}, {"box": [1, 2, 3, True]},
            {"box": "1234"},
            {"box": [1e300, 2, 3, 4]}, {"box": [10**400, 2, 3, 4]}, {"box": [1e999, 2, 3, 4]}, {"size": 1},
            {"points": {"nose": [1]}}, {"points": {"nose": [1, None]}}, {"points": [1]}, {"points": {"": [1, 2]}},
            {"points": {"nose": [-1e7, 2]}}, {"points": {f"p{k}": [1, 2] for k in range(501)}},
            {"absent": "nose"}, {"absent": [1]}, {"absent": ["a/b"]}, {"absent": {}},
        )),
    ],
)  # fmt: skip
def test_what_is_no_draft_is_refused_in_one_line(client, draft):
    got = client.ask("PUT", "api/draft", {"base": 0, "draft": draft})
    assert got.status == 400 and len(got.json["error"].splitlines()) == 1
    assert client.get("api/state").json["revision"] == 0


def test_a_draft_comes_back_as_it_was(client, session):
    face = {"box": [1.25, -2, 30, 40], "points": {"nose": [3, 4.125]}, "absent": ["lip"]}
    targets = {"face": face, "hand": {"absent": True}, "other": {}}
    assert client.put_draft(5, **targets).json == {"revision": 1}
    nothing = {"box": None, "points": {}, "absent": []}
    expected = {"face": face, "hand": {**nothing, "absent": True}, "other": nothing}
    assert client.get("api/state").json["draft"] == {"frame": 5, "targets": expected}
    assert session.draft.targets["face"] == DraftTarget((1.25, -2, 30, 40), {"nose": (3, 4.125)}, ("lip",))


numbers = st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from([0, -1, 1e400, 10**6])
plain = st.none() | st.booleans() | numbers | st.text(max_size=5)
anything = st.recursive(
    plain, lambda one: st.lists(one, max_size=5) | st.dictionaries(st.text(max_size=8), one, max_size=4)
)
target = st.fixed_dictionaries(
    {},
    optional={
        "box": st.lists(numbers, min_size=4, max_size=4) | anything,
        "points": st.dictionaries(st.sampled_from(["nose", "lip_upper", "", "\ud800"]), st.lists(numbers, max_size=3)),
        "absent": st.booleans() | st.lists(st.sampled_from(["nose", "/"])) | anything,
    },
)
drafts = st.fixed_dictionaries(
    {
        "frame": st.integers(-2, 20) | plain,
        "targets": st.dictionaries(st.sampled_from(["face", "a b"]), target | anything),
    }
)


@pytest.fixture(scope="module")
def fuzzed():
    session = Plain()
    with serving(session) as server:
        client = Client(server.url)
        yield client, session
        client.close()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(drafts | anything, st.integers(-1, 3) | plain)
def test_no_draft_is_too_odd(fuzzed, draft, base):
    client, session = fuzzed
    got = client.ask("PUT", "api/draft", {"base": base, "draft": draft})
    assert got.status in (200, 400, 409), got
    assert session.first_fault is None
    assert client.get("api/state").json["revision"] == session.revision


# --- two windows -----------------------------------------------------------------------------------------------------


def test_the_slower_window_gets_the_whole_state(server, client):
    other = Client(server.url)
    assert client.put_draft(1, face={"box": [1, 2, 3, 4]}).status == 200
    got = other.put_draft(2, base=0)
    assert got.status == 409 and "another window" in got.json["error"]
    assert got.json["revision"] == 1 and got.json["draft"]["frame"] == 1
    got = other.save(base=0)
    assert got.status == 409 and got.json["job"] is None
    assert other.put_draft(2, base=1).json == {"revision": 2}
    for base in (None, "1", 1.0, True):
        assert other.ask("POST", "api/save", {"base": base}).status == 400
    other.close()


def test_saving_is_one_job_and_then_all_is_over(client, session):
    assert client.put_draft(3).status == 200
    got = client.save()
    assert got.status == 202 and got.json["job"]["what"] == "saving"
    client.until(lambda state: state["job"] == {"what": "saving", "done": 1, "total": 2})
    assert client.save().json["error"] == "busy: saving; wait for its end"
    got = client.put_draft(4)
    assert got.status == 409 and got.json["draft"]["frame"] == 3, "what is being saved stands"
    session.go.set()
    state = client.until(lambda state: state["ended"] and not state["job"])
    assert state["ended"] == {"said": ["a: written"], "next": "facetrack run a"}
    assert client.put_draft(4).status == 409 and client.save().status == 409


@pytest.mark.parametrize("error", [InputError("a: full\ndisk"), ZeroDivisionError("a: full disk")])
def test_a_job_that_fails_says_so_and_may_be_tried_again(client, session, error):
    session.fails = error
    session.go.set()
    assert client.save().status == 202
    state = client.until(lambda state: state["message"])
    assert "a: full disk" in state["message"] and state["job"] is None and state["ended"] is None
    assert (session.first_fault is error) == isinstance(error, ZeroDivisionError)
    session.fails = None
    assert client.save().status == 202
    assert client.until(lambda state: state["ended"])["message"] is None


def test_a_draft_that_changed_while_it_was_checked_is_not_saved(session):
    before = session.draft
    session.change(Draft(1))
    with pytest.raises(RefusedError) as refused:
        session.save(before)
    assert refused.value.code == 409 and refused.value.more["draft"]["frame"] == 1


def test_it_stays_until_the_page_has_heard_of_the_end(session, monkeypatch):
    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    clock = Clock()
    monkeypatch.setattr(session_module, "time", clock)
    assert not session.over()
    clock.now = 200.0
    session.told_state()
    session.end(["a"], None)
    assert not session.over()
    clock.now = 204.9
    assert not session.over(), "nobody has asked yet"
    clock.now = 205.0
    assert session.over(), "and nobody will"
    clock.now = 201.0
    session.told_state()
    clock.now = 202.9
    assert not session.over(), "another window may ask"
    clock.now = 203.0
    assert session.over()


# --- who goes away, and what goes wrong ------------------------------------------------------------------------------


def test_a_tab_that_is_closed_in_the_middle_of_a_frame_is_nothing(server, client, session, capfd):
    threads = threading.active_count()
    for _ in range(3):
        link = socket.create_connection((ADDRESS, server.server_port), timeout=60)
        link.sendall(f"GET /{server.token}/api/frame/1.jpg?reduce=8 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert link.recv(100).startswith(b"HTTP/1.1 200 ")
        link.close()
    for data in (
        b"PUT /TOKEN/api/draft HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{",
        b"GET /TOK",
        b"\0\1",
    ):
        raw(server, data)
    wait_for(lambda: threading.active_count() <= threads, "the threads of those connections")
    assert client.get("api/state").status == 200
    assert session.first_fault is None
    assert capfd.readouterr() == ("", "")


def test_an_error_of_ours_is_one_line_and_remembered(client, session, capfd):
    got = client.ask("POST", "api/boom", {})
    assert got.status == 500 and got.json["error"] == "this is our fault, not yours: ZeroDivisionError: two lines"
    assert isinstance(session.first_fault, ZeroDivisionError)
    assert client.ask("POST", "api/nan", {}).status == 500, "what is no JSON is not sent"
    assert isinstance(session.first_fault, ZeroDivisionError), "the first one is kept"
    assert client.ask("POST", "api/input", {}).status == 422
    assert client.get("api/state").status == 200
    assert capfd.readouterr() == ("", "")
