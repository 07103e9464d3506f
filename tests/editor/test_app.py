"""facetrack app without a browser: the list, the queue of runs, what its server refuses, and what a kill leaves."""

import os

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.editor import app_session as app_module
from facetrack_cli.editor import session as session_module
from facetrack_cli.editor.app_session import PROGRAMS, AppSession, likely_in
from facetrack_cli.editor.server import serving
from facetrack_cli.run_folder.manifest import read_manifest
from facetrack_cli.trajectory.formats import EXPORTS
from facetrack_cli.video.source import Frames
from tests.support.page_client import Client, drive, wait_for
from tests.support.samples import FOLDER, cut

BOX = "frame: 0\nface:\n  box: [95, 60, 120, 130]\n"
ACTIVE = ("queued", "running")


class App(Client):
    """A project that is served, and a window of it."""

    def __init__(self, folder):
        self.session = AppSession(folder)
        self._serving = serving(self.session)
        super().__init__(self._serving.__enter__().url)

    def clips(self):
        return {one["name"]: one for one in self.state()["clips"]}

    def add(self, *paths):
        """Add clips, and wait until they were looked at."""
        for path in paths:
            assert self.post("add", path=str(path)).status == 200
        wait_for(lambda: all(one["size"] or one["error"] for one in self.state()["clips"]), "looks at the clips")
        return self.state()["clips"]

    def rest(self):
        """The clips, once nothing is to be done any more."""
        return wait_for(lambda: (s := self.state()["clips"]) and not any(c["state"] in ACTIVE for c in s) and s, "runs")

    def close(self):
        super().close()
        self._serving.__exit__(None, None, None)


@pytest.fixture
def app(tmp_path):
    opened = []

    def make(folder=tmp_path / "project"):
        opened.append(App(folder))
        return opened[-1]

    yield make
    for one in opened:
        one.close()


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """A face, several people, and something that is no clip."""
    folder = tmp_path_factory.mktemp("clips")
    cut("expressions", 30, folder / "smile.mp4")
    cut("film", 120, folder / "film.mp4")
    (folder / "notes.mp4").write_text("no clip at all")
    return folder


def boxed(one, clip):
    """Choose a box, as the page of the start does, which is written by itself."""
    assert one.post("choose", clips=[clip["id"]], what="box").status == 200
    start = one.session.start_of(one.session.find(clip["id"]))
    start.parent.mkdir(exist_ok=True)
    start.write_text(BOX)
    return clip["id"]


# --- the list --------------------------------------------------------------------------------------------------------


def test_clips_are_dropped_piece_by_piece(app, clips):
    one, data = app(), (clips / "smile.mp4").read_bytes()
    half = len(data) // 2

    def put(piece, **query):
        address = "&".join(f"{name}={value}" for name, value in query.items())
        return one.ask("PUT", f"api/upload?{address}", piece)

    for _ in range(2):  # a piece may be sent again
        assert put(data[:half], name="smile.mp4", offset=0, total=len(data)).json == {"offset": half}
    assert put(data[half:], name="smile.mp4", offset=half + 1, total=len(data)).status == 422
    assert put(data[half:], name="smile.mp4", offset=half, total=len(data)).json == {"added": [1]}
    assert put(data, name="smile.mp4", offset=0, total=len(data)).json == {"added": [2]}, "never over another file"
    folder = one.session.folder / "clips"
    assert sorted(path.name for path in folder.iterdir()) == ["smile-2.mp4", "smile.mp4"]
    assert (folder / "smile.mp4").read_bytes() == data
    for name in ("..%2Fa.mp4", "a%2Fb.mp4", "%00", "", ".", "a%0Ab"):
        assert put(b"x", name=name, offset=0, total=1).status == 422
    assert not list(one.session.folder.parent.glob("*.mp4"))


def test_a_folder_is_named_and_each_clip_is_looked_at(app, clips, tmp_path):
    one = app()
    found = {clip["name"]: clip for clip in one.add(clips)}
    assert [found[name]["likely"] for name in ("smile.mp4", "film.mp4")] == ["face", "everybody"]
    assert found["smile.mp4"]["frames"] == 30 and found["smile.mp4"]["size"] == [320, 240]
    assert found["notes.mp4"]["state"] == "failed" and "notes.mp4" in found["notes.mp4"]["error"]
    assert {clip["state"] for clip in found.values() if clip["size"]} == {"ready"}
    thumb = one.get(f"api/thumb?clip={found['smile.mp4']['id']}")
    assert cv2.imdecode(np.frombuffer(thumb.data, np.uint8), 1).shape == (240, 320, 3)
    assert one.post("add", path=str(clips)).json == {"added": []}, "each once"
    for path in ("", "clips", "@list", str(clips / "gone")):
        assert one.post("add", path=path).status == 422
    assert one.post("remove", clip=found["notes.mp4"]["id"]).status == 200
    assert one.post("remove", clip=77).status == 422
    assert "notes.mp4" not in one.clips() and (clips / "notes.mp4").exists()
    with Frames(FOLDER / "gestures.mp4") as frames:
        assert likely_in(frames) == "signer"


def test_a_project_is_open_once_and_not_of_another_program(app, tmp_path, capsys):
    for text in ('{"clips": 3}', "no", '{"clips": [{"id": 1, "path": "a.mp4", "name": "../../elsewhere"}]}'):
        (tmp_path / "project.json").write_text(text)
        with pytest.raises(InputError, match=r"project\.json: is not as facetrack app writes it"):
            AppSession(tmp_path)
    assert main(["app", str(tmp_path), "--no-open"]) == 3
    assert "is not as facetrack app writes it" in capsys.readouterr().err
    assert main(["app", str(app().session.folder), "--no-open"]) == 2
    assert "is open already; go to its page" in capsys.readouterr().err


# --- runs ------------------------------------------------------------------------------------------------------------


def test_a_clip_is_run_looked_at_and_exported(app, clips, monkeypatch):
    one = app()
    [clip] = one.add(clips / "smile.mp4")
    assert one.post("want", clips=[clip["id"]], wanted=True).status == 200
    [done] = one.rest()
    assert (done["state"], done["done"], done["error"]) == ("done", 30, None)
    folder = one.session.run_of(one.session.find(1))
    assert read_manifest(folder).complete, "an ordinary run"

    video = one.get("api/video?clip=1")
    whole = (folder / "annotated.mp4").read_bytes()
    assert video.data == whole and video.headers["Accept-Ranges"] == "bytes"
    for asked, part in (("bytes=5-9", whole[5:10]), ("bytes=-4", whole[-4:]), ("bytes=8-", whole[8:])):
        got = one.get("api/video?clip=1", Range=asked)
        assert (got.status, got.data) == (206, part) and got.headers["Content-Range"].endswith(f"/{len(whole)}")
    assert one.get("api/video?clip=1", Range=f"bytes={len(whole)}-").status == 416
    assert one.get("api/video?clip=1", Range="lines=1-2").status == 200

    read, read_run = [], app_module.read_run
    monkeypatch.setattr(app_module, "read_run", lambda folder: read.append(folder) or read_run(folder))
    look = one.get("api/look?clip=1").json
    assert one.get("api/look?clip=1").json == look and read == [folder], "once"
    os.utime(folder / "trajectory.json")
    assert one.get("api/look?clip=1").json == look and len(read) == 2, "and again when it changes"
    [face] = look["targets"]
    assert face["name"] == "face" and "mouth_opening" in [curve["name"] for curve in face["curves"]]
    assert len(face["curves"][0]["values"]) == 30 and 0 <= face["curves"][0]["values"][3] <= 1
    table = one.get("api/export?clip=1&program=csv-wide")
    assert table.data.startswith(b"\xef\xbb\xbfframe,") and len(table.data.splitlines()) == 31
    assert table.headers["Content-Disposition"] == 'attachment; filename="smile.wide.csv"'
    assert b"ANNOTATION_DOCUMENT" in one.get("api/export?clip=1&program=eaf").data
    assert {one.get(f"api/export?clip=1&program={program}").status for program in PROGRAMS} == {200}
    assert one.get("api/export?program=measures").data.startswith(b"\xef\xbb\xbfclip,frame,")
    assert one.get("api/export?program=eaf").status == 422
    assert one.get("api/export?clip=1&program=word").status == 422
    made = {path.name for path in (one.session.folder / "exports").iterdir()}
    assert made == {"project.measures.csv", *(f"smile.{EXPORTS[program].ending}" for program in PROGRAMS)}

    url = one.post("open", clip=1, page="fix").json["url"]
    assert one.get(f"{url}api/session").json["mode"] == "fix" and b"app.js" in one.get(url).data
    assert one.post("open", clip=1, page="fix").json["url"] == url
    assert one.ask("POST", f"{url}api/done", {}).status == 200
    wait_for(lambda: one.state() and one.get(f"{url}api/session").status == 404, "the end of the page")
    start = one.post("open", clip=1, page="start").json["url"]
    assert one.get(f"{start}api/session").json["mode"] == "pick"

    assert one.post("remove", clip=1).status == 200
    assert [path.name for path in (one.session.folder / "runs").iterdir()] == ["smile-face"]
    assert one.get("api/export?clip=1&program=csv-wide").status == 422
    [again] = one.add(clips / "smile.mp4")
    assert again["state"] == "ready" and not again["start"], "what was made of it before is not taken for its own"


def test_a_run_that_fails_says_so_in_one_line_and_the_queue_lives_on(app, clips, tmp_path, monkeypatch):
    lost, good = cut("expressions", 20, tmp_path / "gone.mp4"), clips / "smile.mp4"
    one = app()
    for clip in one.add(lost, good):
        boxed(one, clip)
    lost.unlink()
    assert one.post("want", clips=[1, 2], wanted=True).status == 200
    failed, done = one.rest()
    assert failed["state"] == "failed" and "gone.mp4" in failed["error"] and "\n" not in failed["error"]
    assert done["state"] == "done"
    assert one.post("choose", clips=[2], what="face").json["clips"][1]["state"] == "ready", "a folder for each choice"
    assert one.post("choose", clips=[2], what="box").json["clips"][1]["state"] == "done"

    def fails(*_, **__):
        raise OSError(12, "Cannot allocate memory")

    with monkeypatch.context() as patch:
        patch.setattr(app_module.subprocess, "Popen", fails)
        one.post("want", clips=[2], wanted=True, again=True)
        clip = one.rest()[1]
    assert clip["state"] == "failed" and "Cannot allocate memory" in clip["error"]

    # a run that outlives the app is not begun twice
    real, told = app_module.clip_status, []

    def status(folder, name, clip):
        told.append(clip)
        return app_module.ClipStatus(clip, name, "running", frames=7) if len(told) < 8 else real(folder, name, clip)

    monkeypatch.setattr(app_module, "clip_status", status)
    one.session.find(2).again = False
    one.post("want", clips=[2], wanted=True)
    assert (shown := one.clips()["smile.mp4"])["state"] == "running" and shown["done"] == 7
    assert one.session.running is None
    assert one.rest()[1]["state"] == "done"


OFTEN = """
import time
from facetrack_cli.runs import progress, record
record.EVERY_FRAMES, progress.EVERY_JSON_S = 5, 0.05
write = record.Recorder.write

def wait_and_write(*given):  # so that a short clip takes long enough to be stopped
    time.sleep(0.04)
    write(*given)

record.Recorder.write = wait_and_write
"""
FRAMES, FEW = 60, 10


def running(one):
    """Until it tracks, and has a checkpoint."""
    found = lambda: [c for c in one.state()["clips"] if c["state"] == "running" and c["done"] > FEW]  # noqa: E731
    return wait_for(found, "a run", 240)


def test_after_a_kill_the_queue_goes_on_and_is_paused_and_stopped(app, clips, command, tmp_path, monkeypatch):
    folder, long = tmp_path / "project", cut("expressions", FRAMES, tmp_path / "long.mp4")
    (tmp_path / "sitecustomize.py").write_text(OFTEN)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(FOLDER.parent)]))
    one = app(folder)
    for clip in one.add(long, clips / "smile.mp4"):
        boxed(one, clip)
    one.close()
    killed = command("app", folder, "--no-open")
    client = Client(killed.url)
    client.post("want", clips=[1, 2], wanted=True)
    wait_for(lambda: client.state()["clips"][0]["done"] > 0, "the run")
    killed.kill()
    client.close()

    one = app(folder)
    assert one.state()["paused"]
    wait_for(lambda: {clip["state"] for clip in one.state()["clips"]} == {"paused"}, "the end of what was killed")
    one.post("pause", paused=False)
    running(one)
    assert one.clips()["smile.mp4"]["state"] == "queued"
    assert one.post("choose", clips=[1], what="face").status == 422
    assert one.post("pause", paused=True).json["paused"]
    wait_for(lambda: one.session.running is None, "the pause")
    assert [clip["state"] for clip in one.state()["clips"]] == ["paused", "paused"]
    assert one.clips()["long.mp4"]["done"] > 0
    one.post("pause", paused=False)
    running(one)
    one.post("want", clips=[1], wanted=False)
    stopped, done = one.rest()
    assert (stopped["state"], done["state"]) == ("interrupted", "done") and FEW <= stopped["done"] < FRAMES
    assert one.get("api/look?clip=1").status == 200, "what was tracked may be looked at"
    one.post("want", clips=[1], wanted=True)
    assert one.rest()[0]["state"] == "done"
    manifest = read_manifest(one.session.run_of(one.session.find(1)))
    assert manifest.complete and manifest.frames == FRAMES and manifest.resumed >= FEW


# --- who may use it --------------------------------------------------------------------------------------------------


def test_a_box_must_be_drawn_first_on_a_page_below_that_has_the_guards_of_the_page(app, clips):
    one = app()
    one.add(clips / "smile.mp4")
    assert one.post("choose", clips=[1], what="box").json["clips"][0]["state"] == "needs box"
    got = one.post("want", clips=[1], wanted=True)
    assert got.status == 422 and "draw the box first" in got.json["error"]
    url = one.post("open", clip=1, page="start").json["url"]
    [required] = one.get(f"{url}api/session").json["requirements"]
    assert required["box"] == "needed" and not required["points"]
    for path in (f"{url}api/save", "api/want"):
        for address, headers in (
            (f"/wrong/{path}", {}),
            (one.base + path, {"Host": f"evil.example:{one.port}"}),
            (one.base + path, {"Origin": "http://evil.example"}),
        ):
            assert one.ask("POST", address, b"{}", headers).status == 403, (path, headers)
    assert [one.get(path).status for path in ("start-99/api/state", f"{url}../api/state")] == [404, 404]
    assert b"home.js" in one.get("").data and set(PROGRAMS) == set(one.state()["programs"])


def test_it_ends_by_its_button(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(session_module, "LINGER_S", 0.3)
    drive(monkeypatch, tmp_path, lambda client: client.ask("POST", "api/quit", {}))
    assert main(["app", str(tmp_path / "p")]) == 0
    assert "open this page: " in capsys.readouterr().err
