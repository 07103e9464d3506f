"""Compiled kernels: where they are kept, what damaged files do, and which are compiled before they are called."""

import ast
import importlib
import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import pytest

from facetrack_cli.engine.kernels import cache as kernel_cache
from facetrack_cli.engine.kernels import compiled as compiled_kernels
from facetrack_cli.start import precompile
from tests.support import media
from tests.support.samples import FOLDER

# these recipes together call all declared kernels
RECIPES = {
    "face": "expressions", "factorized": "expressions", "adaptive": "expressions",
    "contour_histogram_correlation": "expressions", "skin_ncc": "expressions",
    "signer": "signing",
}  # fmt: skip
_RUN = """
import json, sys
from facetrack_cli.__main__ import main
from facetrack_cli.start import precompile as kernels
kernels._load = lambda name: True  # a kernel is loaded by its call alone
for recipe, clip in json.loads(sys.argv[1]):
    done = ["-o", f"{sys.argv[2]}/{recipe}", "--overwrite", "--no-video", "--stop", "3", "--threads", "1", "-q"]
    assert main(["run", clip, "--config", recipe, *done]) == 0
print(json.dumps({name: [list(map(str, one)) for one in kernels.kernel(name).signatures] for name in kernels.KERNELS}))
"""


def python(script, *arguments, **environment):
    command = [sys.executable, "-c", script, *arguments]
    return subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=True)


_FORKS = """
import json, os, sys
from facetrack_cli.engine.kernels import compiled
from numba.core import config
for line in sys.stdin:
    script, config.CACHE_DIR = json.loads(line)
    if not os.fork():
        exec(script)
        sys.stdout.flush()
        os._exit(0)
    os.wait()
    for stream in (sys.stdout, sys.stderr):
        print("", end=chr(0), file=stream, flush=True)
"""


@pytest.fixture(scope="module")
def forked():
    """Run a script, with kernels in a folder, in a process that has imported numba already: what it printed."""
    if not hasattr(os, "fork"):
        pytest.skip("this system has no fork")
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen([sys.executable, "-c", _FORKS], text=True, **pipes) as process:

        def run(script, cache):
            print(json.dumps([script, str(cache)]), file=process.stdin, flush=True)
            return ["".join(iter(partial(stream.read, 1), "\0")) for stream in (process.stdout, process.stderr)]

        yield run
        process.stdin.close()


# --- the folder ----------------------------------------------------------------------------------------------------


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A user without NUMBA_CACHE_DIR, whose home and temporary folder are in `tmp_path`."""
    # set first, so that monkeypatch takes back what provide_cache sets
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def unwritable(monkeypatch, *parts):
    monkeypatch.setattr(kernel_cache, "_writable", lambda folder: not any(part in folder for part in parts))


def test_nothing_is_set_where_numba_finds_a_place_and_else_a_process_has_a_folder_of_its_own(place, monkeypatch):
    for parts in ((), ("__pycache__",)):
        unwritable(monkeypatch, *parts)
        kernel_cache.provide_cache()
        assert "NUMBA_CACHE_DIR" not in os.environ
    unwritable(monkeypatch, "__pycache__", "home")
    kernel_cache.provide_cache()
    assert Path(os.environ.pop("NUMBA_CACHE_DIR")).parent == place


def test_whether_a_folder_can_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    assert kernel_cache._writable(str(tmp_path))
    assert kernel_cache._writable(str(tmp_path / "not" / "yet"))
    assert not kernel_cache._writable(str(tmp_path / "file" / "below"))


# --- the files -----------------------------------------------------------------------------------------------------


DAMAGE = (
    (".nbc", lambda data: data[: len(data) // 2]),
    (".nbi", lambda data: bytes(len(data))),
    (".nbi", lambda _: b""),
)


def test_files_that_power_loss_cuts_are_compiled_anew_with_one_warning(forked, tmp_path):
    """Two kernels in a module with a cache of its own."""
    (tmp_path / "two.py").write_text(
        "from facetrack_cli.engine.kernels.compiled import exact\n"
        "@exact\ndef add(a, b):\n    return a + b\n@exact\ndef less(a, b):\n    return a - b\n"
    )
    script = (
        f"sys.path.insert(0, {str(tmp_path)!r})\n"
        "import two\n"
        "print(two.add(1, two.less(2, 1)), sum(sum(one.stats.cache_hits.values()) for one in (two.add, two.less)))"
    )

    def run():
        return forked(script, tmp_path / "cache")

    assert run() == ["2 0\n", ""]
    for suffix, left in DAMAGE:
        for file in (tmp_path / "cache").rglob(f"*{suffix}"):
            file.write_bytes(left(file.read_bytes()))
        out, err = run()
        assert out == "2 0\n"
        assert err.count("\n") == err.count("facetrack: warning: compiled kernels in ") == 1
    assert run() == ["2 2\n", ""]


def test_a_kernel_from_the_cache_is_compiled_into_one_that_calls_it(forked, tmp_path):
    (tmp_path / "two.py").write_text(
        "from facetrack_cli.engine.kernels.compiled import exact\n"
        "@exact\ndef square(a):\n    return a * a\n@exact\ndef cube(a):\n    return a * square(a)\n"
    )
    script = "sys.path.insert(0, {0!r}); import two; print(two.{1}(3), sum(two.{1}.stats.cache_hits.values()))"
    found = [
        forked(script.format(str(tmp_path), name), tmp_path / "cache") for name in ("square", "cube") for _ in "12"
    ]
    assert found == [["9 0\n", ""], ["9 1\n", ""], ["27 0\n", ""], ["27 1\n", ""]]


# --- before they are called ----------------------------------------------------------------------------------------


def test_recipes_call_what_is_declared_with_one_signature_each(tmp_path):
    # so large that the check for cuts skips pixels
    media.ffmpeg("-i", FOLDER / "expressions.mp4", "-vf", "scale=640:480", "-frames:v", "6", path := tmp_path / "a.mp4")
    given = [(recipe, str(FOLDER / f"{clip}.mp4")) for recipe, clip in RECIPES.items()] + [("face", str(path))]
    found = json.loads(python(_RUN, json.dumps(given), str(tmp_path)).stdout)
    assert found == {name: [list(map(str, precompile.kernel(name).takes))] for name in precompile.KERNELS}


@pytest.fixture
def compiled(monkeypatch):
    """The names that are compiled in this process; the recipe `{"sums": {}}` has two kernels, both missing."""
    names = []

    def kernel(name):
        names.append(name)
        raise ValueError

    monkeypatch.setattr(precompile, "KERNELS", {"_add": "sums", "_less": "other sums"})
    monkeypatch.setattr(precompile, "_load", lambda name: False)
    monkeypatch.setattr(precompile, "kernel", kernel)
    return names


@pytest.mark.parametrize("broken", [(sys, "executable", "/nowhere/python"), (precompile, "_SECOND", "import no_such")])
def test_this_process_compiles_what_the_second_one_does_not(compiled, monkeypatch, broken):
    monkeypatch.setattr(*broken)
    with precompile.precompiling({"sums": {}}, 2) as compile_all:
        compile_all()
    assert compiled == ["_add", "_less"]


def test_nothing_is_compiled_that_the_settings_do_not_call_nor_after_a_stop(compiled):
    for settings, stopped in (({"head": {"others": {"type": "sums"}}}, False), ({"sums": {}}, True)):
        with precompile.precompiling(settings, 1) as compile_all:
            compile_all(lambda stopped=stopped: stopped)
    assert compiled == []
    with precompile.precompiling({"head": {"sums": None, "other": {"sums": {}}}}, 1) as compile_all:
        compile_all()
    assert compiled == ["_add", "_less"]


def test_the_second_process_leaves_kernels_for_the_first(forked, tmp_path):
    names = [f"trackers.skin.skin_kernels.{one}" for one in ("box_sums", "bilinear")]
    order = json.dumps([sys.path, names[:1]])
    done = python(precompile._SECOND.format(precompile.__name__), order, NUMBA_CACHE_DIR=str(tmp_path))
    assert (done.stdout, done.stderr) == ("", "")
    script = f"from facetrack_cli.start import precompile; print(*map(precompile._load, {names}))"
    assert forked(script, tmp_path) == ["True False\n", ""]


def test_nothing_of_a_kernel_goes_into_the_next_one(tmp_path, monkeypatch):
    """Or the sums of `moments_direct` are in another order after kernels that square as it does."""
    made = list[str]()

    class Told(compiled_kernels._Nothing):
        def __setitem__(self, key, value):
            super().__setitem__(key, value)
            made.append(key[0].co_name)

    monkeypatch.setattr(compiled_kernels, "_Nothing", Told)
    kernels = "from facetrack_cli.engine.kernels.compiled import exact, fast\n"
    for name, kind, what in (("one", "fast", "x**2"), ("plain", "exact", "x**2"), ("two", "fast", "plain(x) + x**2")):
        kernels += f"@{kind}\ndef {name}(x): return {what}\n"
    (tmp_path / "squares_in_turn.py").write_text(kernels)
    monkeypatch.syspath_prepend(tmp_path)
    squares = importlib.import_module("squares_in_turn")
    assert (squares.one(3.0), squares.two(3.0)) == (9.0, 18.0)
    assert made == ["int_power"] * 2, "for each kernel whose sums may be reordered, also after that which it calls"


def test_no_kernel_calls_another_one_whose_sums_may_be_reordered():
    kernels, calls = dict[str, str](), dict[str, set[str]]()
    texts = (path.read_text(encoding="utf-8") for path in Path(kernel_cache.__file__).parents[2].rglob("*.py"))
    for text in texts:
        for node in ast.parse(text).body if "\n@fast" in text or "\n@exact" in text else ():
            if isinstance(node, ast.FunctionDef) and node.decorator_list:
                kernels[node.name] = ast.unparse(node.decorator_list[0]).split("(")[0]
                calls[node.name] = {ast.unparse(one.func) for one in ast.walk(node) if isinstance(one, ast.Call)}
    fast = {name for name, kind in kernels.items() if kind == "fast"}
    assert fast and not {name for name, kind in kernels.items() if kind in ("fast", "exact") and calls[name] & fast}
