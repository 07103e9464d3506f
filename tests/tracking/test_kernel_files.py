"""Compiled kernels on the disk: what power loss or a bad disk leaves of them is compiled anew."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A kernel in a module of its own, compiled into a cache of its own: (run, files of the cache)."""
    folder = tmp_path_factory.mktemp("kernels")
    (folder / "one.py").write_text(
        "from facetrack_cli.tracking.kernels.compiled import exact\n@exact\ndef add(a, b):\n    return a + b\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(Path.cwd())])}
    environment["NUMBA_CACHE_DIR"] = str(folder / "cache")

    def run():
        command = [sys.executable, "-c", "import one; print(one.add(1, 2), sum(one.add.stats.cache_hits.values()))"]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    assert run().stdout == "3 0\n"
    assert run().stdout == "3 1\n"
    return run, folder


def test_the_user_is_told_once_that_kernels_are_compiled(tmp_path):
    (tmp_path / "two.py").write_text(
        "from facetrack_cli.tracking.kernels.compiled import exact\n"
        "@exact\ndef add(a, b):\n    return a + b\n@exact\ndef less(a, b):\n    return a - b\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path.cwd())])}
    environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    said = "from facetrack_cli.tracking.kernels import cache; cache.tell(print); import two; two.add(1, two.less(2, 1))"
    first, again = (
        subprocess.run([sys.executable, "-c", said], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    )
    assert first.startswith("compiling kernels, once: ") and first.count("\n") == 1
    assert again == ""


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [
        (".nbi", "zeros"), (".nbi", "one byte"), (".nbc", "one byte"),
        pytest.param(".nbi", "empty", marks=pytest.mark.nightly),
        pytest.param(".nbc", "half", marks=pytest.mark.nightly),
        pytest.param(".nbi", "half", marks=pytest.mark.nightly),
        pytest.param(".nbc", "empty", marks=pytest.mark.nightly),
        pytest.param(".nbc", "zeros", marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_a_damaged_kernel_is_compiled_anew_with_one_warning(package, suffix, damage):
    run, folder = package
    for file in (folder / "cache").rglob(f"*{suffix}"):
        data = bytearray(file.read_bytes())
        if damage == "empty":
            data.clear()
        elif damage == "zeros":
            data[:] = bytes(len(data))
        elif damage == "half":
            del data[len(data) // 2 :]
        else:
            data[len(data) // 2] ^= 0x10
        file.write_bytes(data)
    first = run()
    assert first.returncode == 0 and first.stdout == "3 0\n"
    said = first.stderr.splitlines()
    # an index that is read, and has no such entry, is as good as none
    assert [line.count("damaged") for line in said] == [1] or (said == [] and (suffix, damage) == (".nbi", "one byte"))
    again = run()
    assert (again.stdout, again.stderr) == ("3 1\n", ""), "it heals"
