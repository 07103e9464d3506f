"""The cast of a film on a page: what its server does, and the page in a real browser."""

import json
import os
import shutil
import signal

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import ExitCode
from facetrack_cli.editor.fix_session import CastSession
from facetrack_cli.editor.server import serving
from facetrack_cli.trajectory.people import read_people
from facetrack_cli.trajectory.reader import read_trajectory
from tests.support.film_run import film_run
from tests.support.page_client import Client, drive


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The sample film: Collins, a cut, Hopper, a cut, both, and so on. The last track of Hopper is in doubt."""
    out = shutil.copytree(film_run(tmp_path_factory), tmp_path_factory.mktemp("cast") / "out")
    people = json.loads((out / "people.json").read_text())
    doubt = [one for one in people["tracks"] if one["person"] == "person_2"][-1]
    doubt |= {"doubt": True, "p": 0.6, "other": None, "p_other": 0.4}
    (out / "people.json").write_text(json.dumps(people))
    return out


@pytest.fixture
def page(ran, tmp_path):
    """(folder, session, address) of a page that is served."""
    folder = shutil.copytree(ran, tmp_path / "out")
    session = CastSession(folder, video=False)
    with serving(session) as server:
        yield folder, session, server.url


@pytest.fixture
def client(page):
    one = Client(page[2])
    yield one
    one.close()


def names(state):
    return [one["name"] for one in state["people"]]


def test_the_cast_is_changed_undone_and_saved(page, client):
    folder, _, _ = page
    before = (folder / "trajectory.csv").read_bytes()
    assert b"cast.js" in client.get("").data
    state = client.state()
    assert names(state) == ["person_1", "person_2"] and state["cuts"][:4] == [45, 90, 140, 190]
    assert names(client.post("rename", name="person_1", to="Eileen").json) == ["Eileen", "person_2"]
    assert names(client.post("split", name="Eileen", frame=80).json) == ["Eileen", "person_2", "person_1"]
    got = client.post("merge", name="person_1", to="person_2")
    assert got.status == 422 and "both seen in frame 9" in got.json["error"]
    assert names(client.post("merge", name="person_1", to="Eileen").json) == ["Eileen", "person_2"]
    undone = client.post("undo").json
    assert names(undone) == ["Eileen", "person_2", "person_1"] and len(undone["changes"]) == 2
    assert (folder / "trajectory.csv").read_bytes() == before
    assert client.save().status == 200
    state = client.until(lambda state: state["message"])
    assert state["message"] == f"{folder}: 2 changes saved" and not state["changes"] and state["ended"] is None
    assert read_trajectory(folder / "trajectory.json").targets == ("Eileen", "person_2", "person_1")
    assert read_people(folder).corrections == ("rename person_1=Eileen", "split Eileen@80f")
    assert names(client.post("rename", name="person_1", to="Ann").json) == ["Eileen", "person_2", "Ann"]
    client.save()
    client.until(lambda state: not state["changes"] and not state["job"])
    ended = client.post("done")
    assert ended.json["ended"] == {"messages": [f"{folder}: 3 changes saved"], "next": f"facetrack people {folder}"}
    assert read_people(folder).corrections[2:] == ("rename person_1=Ann",)
    assert client.post("rename", name="Eileen", to="x").status == 422


def test_a_doubt_is_settled_and_a_name_that_is_none_refused(client):
    state = client.state()
    [doubt], track = state["doubts"], state["tracks"][0]
    still = f"api/still?first={track['first']}&stop={track['stop']}&person="
    got = client.get(still + track["person"])
    assert cv2.imdecode(np.frombuffer(got.data, np.uint8), 1).shape == (240, 240, 3)
    assert client.get(f"{still}nobody").status == 422
    assert client.get("api/frame?frame=50&reduce=4").headers["Content-Type"] == "image/jpeg"
    frame = doubt["first"]
    new = client.post("give", name="person_2", frame=frame).json
    assert not new["doubts"] and names(new) == ["person_1", "person_2", "person_3"]
    client.post("undo")
    same = client.post("give", name="person_2", to="person_2", frame=frame).json
    assert not same["doubts"] and names(same) == ["person_1", "person_2"]
    for frame, to, message in ((10, None, "is not seen in frame 10"), (100, "person_1", "seen in frame")):
        got = client.post("give", name="person_2", to=to, frame=frame)
        assert got.status == 422 and message in got.json["error"]
    for name in ("a\0b", "../x", "a/b", "", "\u202eb", "x" * 101):
        got = client.post("rename", name="person_1", to=name)
        assert (got.status == 422 and "is no name" in got.json["error"]) or "has 101 letters" in got.json["error"]
        to, frame = {"to": "person_2"}, {"frame": 1}
        for what, more in {"merge": to, "give": to | frame, "split": frame, "rename": to}.items():
            got = client.post(what, name=name, **more)
            assert got.status == 422 and "internal" not in got.json["error"]
    assert names(client.state()) == ["person_1", "person_2"]


@pytest.mark.parametrize("more", ["--rename person_1=A", "--merge person_2=person_1", "--save x.npz", "--csv"])
def test_the_page_goes_with_no_correction_of_the_command_line(ran, capsys, more):
    assert main(["people", str(ran), "--page", *more.split()]) == ExitCode.USAGE
    assert "--page corrects on the page alone" in capsys.readouterr().err


def test_interrupted_the_page_says_what_is_not_saved(ran, tmp_path, monkeypatch, capsys):
    def act(client):
        client.post("rename", name="person_1", to="Ann")
        os.kill(os.getpid(), signal.SIGINT)

    drive(monkeypatch, tmp_path, act)
    assert main(["people", str(ran), "--page", "--open"]) == ExitCode.INTERRUPTED
    assert "interrupted; nothing was written; not saved: rename person_1=Ann" in capsys.readouterr().err


def test_the_page_in_a_browser(page, windows):
    _, session, url = page
    window = windows()
    window.expected = ["422"]
    view = window.page
    view.set_default_timeout(10_000)
    view.goto(url)
    view.wait_for_selector("#people li")

    def card(name):
        return f'#people li[data-name="{name}"]'

    view.fill(f"{card('person_1')} input", "Eileen")
    view.press(f"{card('person_1')} input", "Enter")
    view.wait_for_selector(card("Eileen"))
    window.until("[...document.querySelectorAll('#people img')].every((one) => one.naturalWidth)")
    view.drag_and_drop(f"{card('person_2')} img", card("Eileen"))
    view.wait_for_selector('#message:has-text("both seen")')
    view.click('#timeline .row[data-name="person_2"] svg', position={"x": 300, "y": 8})
    view.wait_for_selector("#moment:not([hidden])")
    view.keyboard.press("2")  # the doubt: somebody new
    view.wait_for_selector(card("person_1"))
    view.keyboard.press("u")
    view.wait_for_selector(card("person_1"), state="detached")
    assert [words for (words, _), _ in session._steps] == ["rename person_1=Eileen"]
    view.keyboard.press("s")
    view.wait_for_selector('#message:has-text("1 change saved")')
