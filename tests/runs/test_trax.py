"""TraX: the text of the protocol, a session, what ends one; and a session with vot-toolkit's own client."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_frames
from facetrack_cli.runs.trax import PREFIX, Message, box_of, image_of, parse, serve, state
from facetrack_cli.trajectory.trajectory import one_part
from tests.support.samples import FOLDER

PEERS = os.environ.get("FACETRACK_PEERS")
ROOT = Path(__file__).parents[2]
BOX = (115.0, 80.0, 90.0, 110.0)
REGION = "115,80,90,110"


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("with a blank")
    clip = cv2.VideoCapture(str(FOLDER / "expressions.mp4"))
    images = [clip.read()[1] for _ in range(4)]
    for n, image in enumerate(images):
        cv2.imwrite(str(folder / f"{n}.png"), image)
    return folder, images


def session(*lines, config="histogram"):
    said = []
    serve(lines, said.append, load_recipe(config, {"filter.particles": 20} if config == "histogram" else {}))
    return said


def initialize(folder, region=REGION, n=0):
    return f'@@TRAX:initialize "file://{folder}/{n}.png" "{region}"\n'


def test_a_session_says_what_the_python_interface_does(pictures):
    folder, images = pictures
    frames = [f'@@TRAX:frame "file://{folder}/{n}.png" "key=value"\n' for n in (1, 2, 3)]
    hello, *states = session("noise\n", initialize(folder), "\n", *frames, "@@TRAX:quit\n", "@@TRAX:nonsense\n")
    assert hello == (
        '@@TRAX:hello "trax.version=3" "trax.name=facetrack" "trax.identifier=histogram 0.1.0" "trax.image=path;" '
        '"trax.region=rectangle;polygon;" "trax.channels=color;"'
    )
    recipe = load_recipe("histogram", {"filter.particles": 20})
    for said, result in zip(states, track_frames(images, recipe, init=BOX), strict=True):
        ltwh = ",".join(f"{value:.4f}" for value in result.rows.boxes[0])
        assert said == f'@@TRAX:state "{ltwh}" "confidence={result.rows.confidence[0]:.4f}"'


def test_a_client_may_begin_again_and_just_end(pictures):
    folder, _ = pictures
    one, first, again = session(initialize(folder), initialize(folder, "115,80,205,80,205,190,115,190"))
    assert first == again and one.startswith("@@TRAX:hello")


def test_a_parallelogram_is_answered_as_one_and_confidence_only_where_there_is_some():
    corners = np.array([[[10.0, 20], [40, 25], [38, 60], [8, 55]]])
    place = {"x": [24.0], "y": [40.0], "w": [30.0], "h": [35.0]}
    for one, said in (
        (one_part("face", "box", [0], **place, corners=corners), "10.0000,20.0000,40.0000,25.0000,38.0000,60.0000,"),
        (one_part("face", "box", [0], **place), "9.5000,23.0000,30.0000,35.0000"),
    ):
        found = state(SimpleNamespace(rows=one))
        assert found.given[0].startswith(said) and found.named == ()


TEXT = st.text(st.characters(blacklist_categories=("Cs",), blacklist_characters="\r\n"), min_size=1)
KEY = st.from_regex(r"[a-z._0-9]{1,9}", fullmatch=True)


@given(st.lists(TEXT, min_size=1, max_size=2), st.dictionaries(KEY, st.text('ab ="\\\n')))
def test_what_is_written_is_read(given, named):
    name = "frame" if len(given) == 1 else "initialize"
    message = Message(name, tuple(given), tuple(named.items()))
    line = str(message)
    assert "\n" not in line and parse(line + "\n") == message


def test_lines_that_are_no_messages_and_messages_that_are_wrong():
    assert parse("@@TRAX hello") is None and parse("") is None
    assert parse("@@TRAX:frame file:///a.png k=v") == Message("frame", ("file:///a.png",), (("k", "v"),))
    for line, why in (
        ("state 1,2,3,4", "no message 'state' of a client is known; there are initialize, frame, quit"),
        ("frame", "frame has 1 argument and then key=value"),
        ('initialize "a"', "initialize has 2 arguments"),
        ('frame "a" "b"', "frame has 1 argument and then key=value"),
        ('frame "a', "cannot be told apart; quote them"),
        ('frame "a"b', "cannot be told apart"),
    ):
        with pytest.raises(InputError, match=why):
            parse(PREFIX + line)


def test_regions_and_images():
    assert box_of("1,2.5,30,40") == (1, 2.5, 30, 40)
    assert box_of("10,20,40,25,30,60") == (10, 20, 30, 40)  # a triangle
    for wrong in ("", "1,2,3", "1,2,3,4,5", "1,2,0,4", "1,2,nan,4", "a,b,c,d", "1,1,5,1,9,1", "1e9,0,5,5", "1,2,-3,4"):
        with pytest.raises(InputError, match=r"is no rectangle left,top,width,height and no polygon"):
            box_of(wrong)
    with pytest.raises(InputError, match="masks are not read"):
        box_of("m0,0,3,1,2,1")
    assert image_of("file:///a b/1.png") == Path("/a b/1.png") == image_of("/a b/1.png")
    for wrong in ("image:320;240;rgb;AAAA", "data:image/png;base64;AAAA", "https://a/b.png"):
        with pytest.raises(InputError, match="is no path; hello says that paths are read"):
            image_of(wrong)


def test_what_goes_wrong_is_in_the_quit_message(pictures):
    folder, _ = pictures
    for lines, why in (
        (['@@TRAX:frame "a.png"'], "a frame before initialize"),
        ([initialize(folder), f'@@TRAX:frame "file://{folder}/none.png"'], "none.png: cannot be read as an image"),
        ([initialize(folder, "1000,1000,5,5")], "outside|beyond|within"),
        (["@@TRAX:hello"], "no message 'hello'"),
    ):
        said = []
        with pytest.raises(InputError, match=why):
            serve(lines, said.append, load_recipe("histogram"))
        assert said[-1].startswith('@@TRAX:quit "trax.reason=') and "\n" not in said[-1]


@pytest.mark.parametrize(("config", "why"), [("factorized", "points"), ("head_hands", "several targets")])
def test_recipes_without_one_box_are_refused(config, why):
    with pytest.raises(UsageError, match=f"TraX follows one box, and {config} {why}; take a recipe of a box, as corr"):
        serve([], print, load_recipe(config))


def test_the_command_speaks_on_its_streams(pictures):
    folder, _ = pictures
    words = [sys.executable, "-m", "facetrack_cli", "trax", "--config", "histogram", "--set", "filter.particles=20"]
    text = initialize(folder) + "@@TRAX:bye\n"
    run = subprocess.run(words, input=text, capture_output=True, text=True, check=False, timeout=120, cwd=ROOT)
    hello, place, quit_ = run.stdout.splitlines()
    assert hello.startswith("@@TRAX:hello ") and place.startswith("@@TRAX:state ")
    assert quit_.startswith("@@TRAX:quit \"trax.reason=TraX: no message 'bye'")
    assert run.returncode == 3 and run.stderr.startswith("facetrack: error: TraX: no message 'bye'")


@pytest.mark.skipif(not PEERS, reason="FACETRACK_PEERS names no Python with vot-toolkit")
def test_vot_toolkit_s_own_client():
    script = Path(__file__).parents[1] / "peers/trax_client.py"
    command = shlex.join([sys.executable, "-m", "facetrack_cli", "trax"])
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run([PEERS, script, command], capture_output=True, text=True, check=False, timeout=300, env=env)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])
    assert found["name"] == "facetrack" and len(found["boxes"]) == 12
    assert found["boxes"][0] == found["truth"][0] and found["again"] == found["truth"][3]
    np.testing.assert_allclose(found["boxes"], found["truth"], atol=4)
    assert min(found["confidence"]) > 0.5
    assert "Server terminated the session: TraX: " in found["refused"]
