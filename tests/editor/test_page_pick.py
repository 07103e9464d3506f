"""facetrack init --pick without a browser: what the page receives and sends, what is saved, how the command ends."""

import json
import socket
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.editor import server as server_module
from facetrack_cli.editor import session as session_module
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trackers.face.detectors import PARTS, detector
from tests.support import page_client
from tests.support.damage import raising
from tests.support.media import write_pictures
from tests.support.page_client import Client, drive, wait_for
from tests.support.samples import read_pictures
from tests.support.terminal import refusal

NOBODY = np.full((240, 320, 3), 90, np.uint8)
POINTS = {"nose": [160, 138.37], "mouth_left": [137.65, 153.77], "mouth_right": [180.2, 156.18],
          "lip_upper": [159, 153.63], "lip_lower": [158.24, 167.13]}  # fmt: skip
FACE = {"box": [112, 79, 98, 98], "points": POINTS}
HANDS = {"head": {"box": [135, 44, 50, 50]}, "left_hand": {"box": [82, 138, 48, 57]},
         "right_hand": {"box": [188, 131, 50, 60]}}  # fmt: skip


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """`face`: nobody, then two frames of a face; `sign`: somebody who signs, with two hands; `two`: two faces."""
    folder = tmp_path_factory.mktemp("clips")
    face, sign = read_pictures("expressions")[:2], read_pictures("signing")[:1]
    write_pictures(folder / "face", [NOBODY, *face])
    write_pictures(folder / "sign", [*sign, cv2.cvtColor(cv2.cvtColor(sign[0], 6), 8)])
    write_pictures(folder / "two", [np.hstack([face[0], sign[0]])])
    return folder


@contextmanager
def picking(*where, **more):
    """A client of a page, and its session."""
    with page_client.picking(*where, **more) as (session, url), closing(Client(url)) as client:
        yield client, session


@pytest.fixture(autouse=True)
def hurry(monkeypatch):
    """The server stops as soon as a client was told of the end."""
    monkeypatch.setattr(session_module, "LINGER_S", 0.3)


# --- what is required ------------------------------------------------------------------------------------------------


def test_what_a_recipe_requires(clips):
    hands = [(name, "needed", []) for name in ("head", "left_hand", "right_hand")]
    for config, expected in (
        (None, [("face", "optional", list(PARTS))]),
        ("factorized", [("face", "optional", list(PARTS))]),
        ("contour_histogram", [("face", "needed", [])]),
        ("mil", [("face", "needed", [])]),
        ("head_hands", hands),
    ):
        with picking(clips / "face", config=config) as (client, _):
            about = client.get("api/session").json
        assert [(one["target"], one["box"], one["points"]) for one in about["requirements"]] == expected
        assert about["free"] == (config != "head_hands")
        assert (about["mode"], about["clip"], about["recipe"]) == ("pick", "face", config or "face")
        assert about["size"] == [320, 240]
        assert about["frames"] == {"first": 0, "last": 2, "exact": True}
        for one in about["requirements"]:
            assert set(one["about"]) == {*one["points"], "box"} and all(one["about"].values())
        assert "brows to the chin" in about["requirements"][0]["about"]["box"]


# --- proposals -------------------------------------------------------------------------------------------------------


def looking(monkeypatch, find):
    """The page finds faces so."""
    monkeypatch.setattr("facetrack_cli.editor.session.detector", lambda: SimpleNamespace(find=find, name=""))


def test_the_faces_of_a_frame_are_proposed(clips, monkeypatch):
    found = []

    def find(frame):
        found[:] = detector().find(frame)
        return found

    looking(monkeypatch, find)
    with picking(clips / "face") as (client, _):
        assert client.get("api/proposals?frame=0").json == {
            "frame": 0, "proposals": [], "note": "no face is found in this frame; draw a box, or look at another frame"
        }  # fmt: skip
        got = client.get("api/proposals?frame=1").json
        assert client.get("api/proposals?frame=3").status == 422
    [one] = got["proposals"]
    assert (got["frame"], got["note"], one["label"]) == (1, None, "face 1")
    face = one["targets"]["face"]
    assert face["box"] == list(found[0].box)
    assert set(face["points"]) == set(PARTS)
    for part, at in POINTS.items():
        assert np.hypot(*np.subtract(face["points"][part], at)) < 7


def test_hands_are_proposed_with_the_head(clips):
    with picking(clips / "sign", config="head_hands") as (client, session):
        got = client.get("api/proposals?frame=0").json
        grey = client.get("api/proposals?frame=1").json
        frame = session.frames.read(0)
    [one] = got["proposals"]
    start = Start(0, {"face": TargetStart(box=detector().find(frame)[0].box)}, "")
    expected = name_targets(start, ("head", "left_hand", "right_hand"), frame)
    assert {name: tuple(target["box"]) for name, target in one["targets"].items()} == {
        name: target.box for name, target in expected.targets.items()
    }
    assert [list(one["targets"]) for one in grey["proposals"]] == [["head"]], "without colours there is no skin"
    assert "colour" in grey["note"]
    with picking(clips / "two", config="contour_histogram") as (client, _):  # of a recipe of boxes there are no points
        two = client.get("api/proposals?frame=0").json["proposals"]
    assert [(one["label"], one["targets"]["face"]["points"]) for one in two] == [("face 1", {}), ("face 2", {})]


# --- what may be saved -----------------------------------------------------------------------------------------------


def test_what_a_draft_lacks_is_said_in_one_line(clips, tmp_path):
    cases = [
        (None, {}, "nothing is chosen yet; take a face that was found, or choose a part"),
        (None, {"face": {"box": [112, 79, 98, 98]}}, "no point for nose, mouth_left, mouth_right, lip_upper, lip_"),
        (None, {"face": {"points": {**POINTS, "nose": [400, 20]}}}, "nose of face at [400, 20] is outside the"),
        (None, {"face": {**FACE, "box": [112, 79, 5, 98]}}, "the box of face is smaller than 6x6 pixels; give a"),
        (None, {"face": FACE, "corrections": FACE}, "a target cannot be called corrections, a key of init files"),
        ("factorized", {"face": {"points": {part: [100, 100] for part in PARTS}}}, "in one place"),
        ("contour_histogram", {"face": {"points": POINTS}}, "still to choose: the box of face"),
        ("contour_histogram", {"face": {"box": [-900, 79, 98, 98]}}, "the centre of the box [-900, 79, 98, 98] of"),
        ("contour_histogram", {"face": {"box": [-90, 0, 400, 200]}}, "400x200 pixels, is larger than the frame"),
        ("head_hands", {"head": HANDS["head"]}, "still to choose: the box of left_hand"),
        ("head_hands", {**HANDS, "foot": FACE}, "has foot, which the recipe does not know; it follows head"),
    ]
    for config in dict.fromkeys(case[0] for case in cases):
        with picking(clips / "face", tmp_path / "a.init.yaml", config) as (client, session):
            for targets, said in [case[1:] for case in cases if case[0] == config]:
                assert client.put_draft(1, **targets).status == 200
                got = client.save()
                assert got.status == 422 and said in got.json["error"], got.json
                assert "the page:" not in got.json["error"] and len(got.json["error"].splitlines()) == 1
                state = client.state()
                assert state["job"] is None and state["ended"] is None
        assert session.fault is None and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("config", "targets", "suffix"),
    [
        (None, {"face": FACE}, ".json"),
        ("factorized", {"face": {"points": POINTS}, "lena": FACE}, ".yaml"),
        ("contour_histogram", {"face": {"box": [110.123456, 79, 98.004, 98]}, "a": {"box": [9, 9, 60, 60]}}, ".json"),
        (None, dict.fromkeys(("null", "yes", "On", "nan", "Infinity", "hand-2", "_"), FACE), ".yaml"),
        ("head_hands", HANDS, ".yaml"),
        ("mil", {"face": {"box": [112, 79, 98, 98]}}, ".yaml"),
    ],
)
def test_what_is_saved_is_what_was_chosen(clips, tmp_path, config, targets, suffix):
    out = tmp_path / f"a.init{suffix}"
    with picking(clips / "face", out, config, next_="facetrack run x") as (client, session):
        assert client.put_draft(1, **targets).status == 200
        assert client.save().status == 200
        state = client.until(lambda state: state["ended"])
        assert state["ended"] == {"messages": [f"{out}: written"], "next": "facetrack run x"}
        wait_for(session.over, "the end")
    start = read_init(out)
    assert start.frame == 1 and list(start.targets) == list(targets)
    for name, chosen in targets.items():
        found = start.targets[name]
        assert found.box == (None if "box" not in chosen else tuple(round(value, 2) for value in chosen["box"]))
        assert found.points == {part: tuple(at) for part, at in chosen.get("points", {}).items()}
    if suffix == ".yaml":
        assert out.read_text().startswith("# Where the track of face begins.\n")


def test_a_file_that_appears_meanwhile_is_not_replaced(clips, tmp_path):
    out = tmp_path / "a.init.yaml"
    with picking(clips / "face", out) as (client, _):
        client.put_draft(1, face=FACE)
        out.write_text("mine")
        assert client.save().status == 200
        state = client.until(lambda state: state["message"])
        assert "exists already" in state["message"] and state["ended"] is None
        assert out.read_text() == "mine"
        out.unlink()
        assert client.save().status == 200
        client.until(lambda state: state["ended"])
    assert read_init(out).frame == 1


def test_windows_and_corrections_of_the_file_before_are_kept(clips, tmp_path):
    given = {"nose": (5, 5)}
    points = {part: tuple(at) for part, at in POINTS.items()}
    begun = Start(
        0, {"face": TargetStart(points=points, windows={"nose": (25, 25)})}, "old.yaml",
        tuple(Correction(frame, name, points=given) for frame, name in ((1, "face"), (2, "face"))),
    )  # fmt: skip
    out = tmp_path / "a.init.yaml"
    with picking(clips / "face", out, previous=begun) as (client, _):
        state = client.state()
        assert state["draft"]["targets"]["face"]["points"]["nose"] == POINTS["nose"]
        assert state["message"] == "taken from old.yaml"
        client.put_draft(1, face=FACE)
        client.save()
        messages = client.until(lambda state: state["ended"])["ended"]["messages"]
    start = read_init(out)
    assert start.targets["face"].windows == {"nose": (25, 25)}
    assert [one.frame for one in start.corrections] == [2]
    assert messages[1] == "corrections left out, since they come before the start or have no target: 1"


def test_what_the_page_begins_with(clips):
    for names in (["face"], ["head", "foot"]):  # a file of another recipe is fitted to this one
        begun = Start(0, {name: TargetStart(box=(10, 10, 40, 40)) for name in names}, "old.yaml")
        with picking(clips / "face", config="head_hands", previous=begun) as (client, _):
            assert list(client.state()["draft"]["targets"]) == ["head"]


def test_the_file_says_which_detector_has_placed_what_nobody_moved(clips, tmp_path):
    def saved(change=None, **more):
        out = tmp_path / "a.init.yaml"
        out.unlink(missing_ok=True)
        with picking(clips / "face", out, **more) as (client, _):
            targets = client.state()["draft"]["targets"]
            if not more:
                targets = client.get("api/proposals?frame=1").json["proposals"][0]["targets"]
            if change == "point":
                targets["face"]["points"]["nose"][0] += 1
            elif change == "box":
                targets["face"]["box"][2] += 1
            assert client.put_draft(1, **targets).status == 200
            assert client.save().status == 200
            client.until(lambda state: state["ended"])
        return read_init(out)

    here = detector().name
    begun = saved()
    assert begun.detector == here and begun.placed
    assert [saved(change).detector for change in ("point", "box")] == ["", ""]
    assert [saved(change, previous=begun).detector for change in (None, "point")] == [here, ""]
    by_hand = replace(begun, detector="", placed=False)
    assert saved(previous=by_hand).detector == ""


# --- the command -----------------------------------------------------------------------------------------------------


def choose(client):
    client.put_draft(1, face=FACE)
    client.save()
    client.until(lambda state: state["ended"])


def test_picked_saved_and_run(clips, command, tmp_path, monkeypatch, facetrack):
    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        port = link.getsockname()[1]
    out, look = tmp_path / "a.init.yaml", tmp_path / "look.png"
    running = command("init", clips / "face", "--pick", "--port", port, "-o", out, "--preview", look)
    client = Client(running.url)
    assert not running.said and client.port == port
    choose(client)
    client.close()
    assert running.ended() == (0, "", f"{look}: the start drawn on frame 1\n{out}: written\n"
                               f"next: facetrack run {clips / 'face'} --init {out}\n")  # fmt: skip
    assert running.hint.startswith(f"from another machine: ssh -L {port}:127.0.0.1:{port} HOST, then")
    assert cv2.imread(str(look)) is not None
    drive(monkeypatch, tmp_path, choose)
    code, printed, err = facetrack("init", "IN/face", "--pick", "--open", "-o", "-", "--config", "factorized")
    assert code == 0 and printed == out.read_text()
    assert err.splitlines()[-1] == f"next: facetrack run {clips / 'face'} --init FILE --config factorized"
    few = ("--set", "filter.particles=50", "--no-video", "-q", "-o", "-", "--format", "json")
    code, text, err = facetrack("run", "IN/face", "--init", out, *few)
    assert (code, err) == (0, "")
    run = json.loads(text)
    assert run["init"]["frame"] == 1
    [target] = run["frames"][0]["targets"]
    *points, box = target["parts"][: len(POINTS) + 1]  # and then the eyes, which nobody has picked
    assert {part["status"] for part in (*points, box)} == {"init"} and box["part"] == "box"
    for part in points:
        assert np.allclose((part["x"], part["y"]), POINTS[part["part"]], atol=0.01)


@pytest.mark.nightly
@pytest.mark.parametrize(("code", "said"), [(130, "interrupted"), (143, "terminated")])
def test_stopped_before_it_is_saved(clips, command, tmp_path, code, said):
    running = command("init", clips / "face", "--pick", "-o", tmp_path / "a.init.yaml")
    client = Client(running.url)
    assert not running.said
    client.put_draft(1, face={"points": {"nose": [3.14159, 4]}})
    running.process.send_signal(code - 128)
    *ended, err = running.ended()
    client.close()
    assert ended == [code, ""] and err.splitlines()[-1] == f"facetrack: {said}; nothing was written"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--pick", "--init-frame", "3"], 3, "frame 3"),
        (["--pick", "--box", "9,5,10,10"], 2, "leave out --box"),
        (["--pick", "-o", "a.txt"], 2, ".yaml"),
        (["--pick", "-o", "there.yaml"], 2, "there.yaml: exists already"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_served(facetrack, monkeypatch, arguments, code, said):
    monkeypatch.setattr(server_module, "serving", None)
    Path("there.yaml").write_text("mine")
    assert said in refusal(facetrack("init", "IN/face", *arguments), code)


def test_overwrite_begins_with_the_file(tmp_path, monkeypatch, facetrack):
    out, seen = tmp_path / "a.yaml", []
    drive(monkeypatch, tmp_path, lambda client: (seen.append(client.state()["draft"]), choose(client)))
    out.write_text("frame: 2\nface: {points: {nose: [1, 2]}, windows: {nose: [9, 9]}}\n")
    code, printed, err = facetrack("init", "IN/face", "--pick", "--open", "--overwrite", "-o", out)
    assert (code, printed) == (0, "") and "no browser can be opened from here" in err
    assert not list(tmp_path.glob("*.html")), "the file is removed"
    assert seen[0]["frame"] == 2 and seen[0]["targets"]["face"]["points"] == {"nose": [1, 2]}
    assert read_init(out).targets["face"].windows == {"nose": (9, 9)}
    out.write_text("frame: x\n")
    code, printed, err = facetrack("init", "IN/face", "--pick", "--open", "--overwrite", "--init-frame", 1, "-o", out)
    assert code == 0 and "warning" in err and "should be a valid integer" in err and "begins without it" in err
    assert seen[1] == {"frame": 1, "targets": {}}


def test_an_internal_error_is_reported_at_the_end(tmp_path, monkeypatch, facetrack):
    def act(client):
        assert client.get("api/proposals?frame=0").status == 500
        choose(client)

    looking(monkeypatch, raising(ZeroDivisionError("odd")))
    drive(monkeypatch, tmp_path, act)
    code, _, err = facetrack("init", "IN/face", "--pick", "--open", "-o", tmp_path / "a.yaml")
    assert code == 0 and "while the page was open: internal error; please report it: ZeroDivisionError: odd" in err
    assert "Traceback" not in err and read_init(tmp_path / "a.yaml").targets["face"].points["nose"] == (160, 138.37)
