"""One clip on a worker of a cluster: its command line in a process that ends when the worker does.

A worker has a guard for each clip that it does at a time: a process that has the heavy imports behind it, forks itself
for each clip, and ends that clip when it is asked to, or when the worker is gone.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Sequence
from importlib import import_module
from typing import Any, Final, NoReturn

from facetrack_cli import __version__
from facetrack_cli.core.log import LINES, VARIABLE

LOOK_S: Final = 0.2  # between two looks at who is there
GRACE_S: Final = 10.0  # for a clip that is asked to end, to close its files
_ERROR: Final = "facetrack: error: "
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class FailedError(Exception):
    """A command line that failed on a worker: exit code (negative: the signal), last lines, the worker, its machine."""

    def __init__(self, code: int, lines: Sequence[str], worker: str, host: str) -> None:
        super().__init__(code, lines, worker, host)
        self.code, self.lines, self.worker, self.host = code, list(lines), worker, host

    def line(self) -> str:
        """What went wrong, in one line."""
        errors = [line for line in self.lines if line.startswith(_ERROR)]
        if errors:
            return errors[-1].removeprefix(_ERROR)
        how = f"ended with code {self.code}" if self.code > 0 else f"was killed by signal {-self.code}"
        return f"its process {how}{f', after: {self.lines[-1]}' if self.lines else ''}"


_idle: list[_Guard] = []
_told: dict[str, bool] = {}  # the tasks of this worker that are to end; whether at once


def tell(keys: Collection[str], at_once: bool = False) -> None:
    """Let these tasks end: those of this worker that it does now, or ever."""
    for key in keys:
        _told[key] = at_once or _told.get(key, False)


def attempt(key: str, version: str, folder: str, words: Sequence[str]) -> None:
    """A task: `facetrack run` and these words, in this folder. Raises FailedError for any exit code but 0."""
    from distributed import get_worker

    worker = get_worker()
    if key in _told:
        raise FailedError(143, ["told to end before it began"], worker.address, socket.gethostname())
    try:
        guard = _idle.pop()
    except IndexError:
        guard = _Guard()
    try:
        guard.ask(version, folder, words)
        while (answer := guard.answer()) is None:
            leaving = worker.status.name in ("closing", "closed", "failed", "stopping")
            if leaving or key in _told:
                guard.end(at_once=_told.get(key, False))
    except (OSError, EOFError):
        answer = [1, ["the process beside the worker that starts clips ended; the log of the worker says why"]]
    except BaseException:
        guard.close()
        raise
    if guard.process.poll() is None:
        _idle.append(guard)
    code, lines = answer
    if code:
        raise FailedError(code, lines, worker.address, socket.gethostname())


def dismiss() -> None:
    """End the guards that have nothing to do."""
    while _idle:
        _idle.pop().close()


class _Guard:
    """The guard as its worker sees it."""

    def __init__(self) -> None:
        # as the worker finds its modules, and nothing more: -m alone would look into the working directory first
        path = [one or os.getcwd() for one in sys.path]  # noqa: PTH109
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path), "PYTHONSAFEPATH": "1", VARIABLE: ""}
        environment |= dict.fromkeys(_THREADS, "1")
        command = [sys.executable, "-m", "facetrack_cli.runs.guard"]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
        )
        self._asked: float | None = None
        self._said = b""

    def ask(self, version: str, folder: str, words: Sequence[str]) -> None:
        assert self.process.stdin is not None
        self._asked, self._said = None, b""
        self.process.stdin.write(json.dumps([version, folder, [*words]]).encode() + b"\n")
        self.process.stdin.flush()

    def answer(self) -> list[Any] | None:
        """Exit code and last lines; None if there is no answer within a moment. EOFError if there will be none."""
        assert self.process.stdout is not None
        pipe = self.process.stdout.fileno()
        if not select.select([pipe], [], [], LOOK_S)[0]:
            return None
        data = os.read(pipe, 1 << 16)
        if not data:
            raise EOFError
        self._said += data
        return list(json.loads(self._said)) if self._said.endswith(b"\n") else None

    def end(self, *, at_once: bool) -> None:
        """Ask for an end of the clip; one that does not come is enforced."""
        now = time.monotonic()
        if self._asked is None:
            self._asked = now
            self.process.send_signal(signal.SIGUSR1 if at_once else signal.SIGTERM)
        elif now - self._asked > 2 * GRACE_S:  # it hangs itself
            self.process.kill()

    def close(self) -> None:
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe and pipe.close()
        try:
            self.process.wait(2 * GRACE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


# --- the process itself ----------------------------------------------------------------------------------------------


class _Wish:
    """What signals asked for since the clip began: its end, its end at once."""

    soon = now = False

    def note(self, number: int, _: object) -> None:
        self.soon, self.now = True, self.now or number == signal.SIGUSR1


def _serve() -> None:
    """Do the command lines that come in, one after another, until the worker closes the pipe, or is gone."""
    import numba

    for name in ("runs.clip", "runs.batch", "runs.inputs", "runs.seeds", "cli.commands.run"):
        import_module(f"facetrack_cli.{name}")
    numba.njit(lambda x: x + 1.0)(1.0)  # of which most is loaded when it compiles for the first time
    main = import_module("facetrack_cli.__main__").main  # as a shell does, a clip starts at the top
    wish, parent = _Wish(), os.getppid()
    for one in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(one, wish.note)
    answers = os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 1)
    for line in sys.stdin:
        version, folder, words = json.loads(line)
        wish.soon = wish.now = False
        if version != __version__:
            said = f"facetrack {__version__} is installed on {socket.gethostname()}, and {version} where the batch is"
            answer = [2, [f"facetrack: error: {said}; install the same version"]]
        else:
            pipe, theirs = os.pipe()
            child = os.fork()
            if child == 0:
                _become(folder, words, main, nothing, theirs)
            os.close(theirs)
            with contextlib.suppress(OSError):  # it does so too; whoever comes first
                os.setpgid(child, child)
            answer = _watch(child, pipe, wish, parent)
            os.close(pipe)
        with contextlib.suppress(OSError):
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
        if os.getppid() != parent:
            break


def _become(folder: str, words: Sequence[str], main: Any, nothing: int, errors: int) -> NoReturn:
    """In the forked process: be the command line."""
    code = 1
    try:
        guard = os.getppid()
        os.setpgid(0, 0)
        os.dup2(nothing, 0)
        os.dup2(errors, 2)
        for one in (signal.SIGTERM, signal.SIGUSR1):
            signal.signal(one, signal.SIG_DFL)
        threading.Thread(target=_end_with, args=(guard,), daemon=True).start()
        try:
            os.chdir(folder)
        except OSError as e:
            said = f"{folder}: {e.strerror} on {socket.gethostname()}; all machines must see the same folders"
            os.write(2, f"facetrack: error: {said}\n".encode(errors="backslashreplace"))
        else:
            code = main(["run", *words])
    finally:
        with contextlib.suppress(Exception):
            sys.stderr.flush()
        os._exit(code)


def _end_with(guard: int) -> None:
    """End this process as SIGTERM does once its guard is gone, and for good if it does not."""
    while os.getppid() == guard:
        time.sleep(LOOK_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os.killpg(0, signal.SIGKILL)


def _watch(child: int, pipe: int, wish: _Wish, parent: int) -> list[Any]:
    """Wait for the end of a clip, and see to it where it is wished: exit code and last lines."""
    said, asked, status, open_ = b"", None, None, True
    os.set_blocking(pipe, False)
    while status is None:
        if open_:
            select.select([pipe], [], [], LOOK_S)
        with contextlib.suppress(BlockingIOError):
            data = os.read(pipe, 1 << 16)
            said, open_ = (said + data)[-(1 << 16) :], bool(data)
        if not open_:
            time.sleep(0.01)  # it closes its files last; or goes on without this one
        ended, found = os.waitpid(child, os.WNOHANG)
        status = found if ended else None
        if status is None and (wish.soon or os.getppid() != parent):
            if asked is None:
                asked = time.monotonic()
                os.kill(child, signal.SIGTERM)
            if wish.now or time.monotonic() - asked > GRACE_S:
                os.killpg(child, signal.SIGKILL)
    with contextlib.suppress(BlockingIOError):
        said += os.read(pipe, 1 << 16)
    lines = said.decode(errors="replace").splitlines()[-LINES:]
    assert status is not None
    return [os.waitstatus_to_exitcode(status), [line[:500] for line in lines]]


if __name__ == "__main__":
    _serve()
