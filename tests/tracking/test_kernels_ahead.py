"""Kernels compiled before they are called: what recipes call is what is declared, and a second process may fail."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from facetrack_cli.tracking.kernels import ahead
from facetrack_cli.tracking.kernels.compiled import exact

CLIPS = Path(__file__).parents[2] / "sample_videos"
# between them these call all that is declared
RECIPES = {
    "face": "expressions", "factorized": "expressions", "adaptive": "expressions",
    "contour_histogram_correlation": "expressions", "skin_ncc": "expressions", "head_hands": "signing",
}  # fmt: skip
_RUN = """
import json, sys
from facetrack_cli.__main__ import main
from facetrack_cli.tracking.kernels import ahead
for recipe, clip in json.loads(sys.argv[1]).items():
    done = ["-o", f"{sys.argv[2]}/{recipe}", "--no-video", "--stop", "12", "--threads", "1", "-q"]
    assert main(["run", clip, "--config", recipe, *done]) == 0
print(json.dumps({name: [list(map(str, one)) for one in ahead.kernel(name).signatures] for name in ahead.KERNELS}))
"""


def test_recipes_call_what_is_declared_with_one_signature_each(tmp_path):
    given = json.dumps({recipe: str(CLIPS / f"{clip}.mp4") for recipe, clip in RECIPES.items()})
    command = [sys.executable, "-c", _RUN, given, str(tmp_path)]
    found = json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)
    assert found == {name: [list(map(str, ahead.signature(name)))] for name in ahead.KERNELS}


@exact
def _add(a, b):
    return a + b


@exact
def _less(a, b):
    return a - b


@pytest.fixture
def two(monkeypatch):
    """Two kernels of a recipe `{"sums": {}}` that nobody has compiled."""
    monkeypatch.setattr(ahead, "KERNELS", {"_add": ("i8 i8", "sums"), "_less": ("i8 i8", "other sums")})
    monkeypatch.setattr(ahead, "kernel", lambda name: {"_add": _add, "_less": _less}[name])
    monkeypatch.setattr(ahead, "_is_kept", lambda name: False)


@pytest.mark.parametrize("dies", ["at once", "with a kernel in hand", "never begins"])
def test_what_the_second_process_leaves_the_first_one_compiles(two, monkeypatch, dies):
    if dies == "never begins":
        monkeypatch.setattr(sys, "executable", "/nowhere/python")
    else:
        monkeypatch.setattr(ahead, "_SERVE", "import sys; sys.stdin.readline()" if "hand" in dies else "import no_such")
    compiled = []
    monkeypatch.setattr(ahead, "_compile", compiled.append)
    with ahead.Ahead({"sums": {}}, 2) as both:
        both.finish()
    assert sorted(compiled) == ["_add", "_less"]


def test_nothing_is_compiled_that_the_settings_do_not_call_nor_after_a_stop(two, monkeypatch):
    compiled = []
    monkeypatch.setattr(ahead, "_compile", compiled.append)
    for settings, stopped in (({"head": {"others": {"type": "sums"}}}, False), ({"sums": {}}, True)):
        with ahead.Ahead(settings, 1) as alone:
            alone.finish(lambda stopped=stopped: stopped)
    assert compiled == []
    with ahead.Ahead({"head": {"sums": None, "other": {"sums": {}}}}, 1) as alone:
        alone.finish()
    assert compiled == ["_add", "_less"]


def test_the_second_process_leaves_kernels_for_the_first_and_ends_with_its_input(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", ahead._SERVE.format(ahead.__name__), json.dumps(sys.path)]
    done = subprocess.run(
        command, input="histogram.crop\n", capture_output=True, text=True, env=environment, check=True
    )
    assert (done.stdout, done.stderr) == ("\n", "")
    script = (
        "from facetrack_cli.tracking.kernels import ahead\n"
        "print(*(ahead._is_kept(name) for name in ('histogram.crop', 'histogram.edges')))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment, check=True
    )
    assert found.stdout == "True False\n"
