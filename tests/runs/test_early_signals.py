"""A signal at any moment of a command's start ends it with its line and its exit code."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.support.sway import FACETRACK, until

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
# the interpreter's own start is not ours: 60 ms are left to it
BY_DAY = [(0.08, "SIGTERM"), (0.12, "SIGHUP"), (0.3, "SIGINT"), (0.6, "SIGTERM")]
ALL = [(0.06 + 0.02 * i, name) for i in range(60) for name in ("SIGINT", "SIGTERM", "SIGHUP")]


HOOK = """
import signal, pathlib
set_ = signal.signal
def watched(number, handler):
    old = set_(number, handler)
    number == signal.SIGTERM and pathlib.Path({!r}).touch()
    return old
signal.signal = watched
"""


@pytest.fixture
def start(tmp_path):
    """Start a command that takes seconds, and wait until our first line of code has run."""
    (tmp_path / "sitecustomize.py").write_text(HOOK.format(str(tmp_path / "began")))

    def run(*arguments, hangup=signal.SIG_DFL, **more):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path.cwd())])}
        # whoever runs the tests may ignore it, as nohup does
        more["preexec_fn"] = lambda: signal.signal(signal.SIGHUP, hangup)
        process = subprocess.Popen([*FACETRACK, *arguments], stderr=subprocess.PIPE, env=environment, **more)
        until((tmp_path / "began").exists, process)
        return process

    return run


def ended(process, name):
    process.send_signal(signal.Signals[name])
    said = process.communicate(timeout=20)[1].decode()
    return process.returncode, said


@pytest.mark.parametrize(("after", "name"), BY_DAY)
def test_a_signal_while_it_starts(start, tmp_path, after, name):
    process = start("run", "sample_videos/expressions.mp4", "-o", str(tmp_path / "out"), "--config", "adaptive")
    time.sleep(after - BY_DAY[0][0])
    code, said = ended(process, name)
    assert code == (130 if name == "SIGINT" else 143), said
    assert ("interrupted" if name == "SIGINT" else "terminated") in said and "Traceback" not in said


@pytest.mark.nightly
@pytest.mark.parametrize(("after", "name"), ALL)
def test_a_signal_at_any_moment(start, tmp_path, after, name):
    test_a_signal_while_it_starts(start, tmp_path, after + BY_DAY[0][0], name)


def test_what_is_ignored_stays_so(start, tmp_path):
    assert ended(start("recipes", hangup=signal.SIG_IGN, stdout=subprocess.DEVNULL), "SIGHUP")[0] == 0
