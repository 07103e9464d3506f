"""Ctrl-C and SIGTERM: a wish to stop, which the loop over frames grants between two frames.

Nothing is torn out of a half-written file: the signal only leaves a note. A second signal changes nothing.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, NoReturn, TypeAlias

from facetrack_cli.core.errors import ExitCode, log_line

Stopped: TypeAlias = Callable[[], bool]  # whether the work is to end
# a closed terminal (not on Windows) ends a run as properly as SIGTERM does
_CODES = {"SIGINT": ExitCode.INTERRUPTED, "SIGTERM": ExitCode.TERMINATED, "SIGHUP": ExitCode.TERMINATED}
_SHOW_CURSOR = "\r\x1b[?25h"  # which a bar hides


class StoppedError(Exception):
    """The work was stopped on request; nothing has changed."""


def never() -> bool:
    """No wish to stop."""
    return False


class Stop:
    """Whether the run is to end. `code` is the exit code of the first wish; `elsewhere` asks another process."""

    def __init__(self, elsewhere: Callable[[], ExitCode | None] = lambda: None) -> None:
        self.code: ExitCode | None = None
        self._elsewhere = elsewhere

    def __call__(self) -> bool:
        if self.code is None:
            self.code = self._elsewhere()
        return self.code is not None

    @property
    def reason(self) -> str:
        return "terminated" if self.code is ExitCode.TERMINATED else "interrupted"

    @contextlib.contextmanager
    def listening(self) -> "Iterator[Stop]":
        """Take the signals over for the length of a `with`; a signal that is ignored (nohup) stays ignored."""

        def note(number: int, _: FrameType | None) -> None:
            # no lock is taken here: the thread that is interrupted may hold it
            if self.code is None:
                self.code = _CODES[signal.Signals(number).name]

        with _handled(note, lambda before: before is not signal.SIG_IGN):
            yield self


@contextlib.contextmanager
def ending_at_once() -> Iterator[None]:
    """Where no Stop listens, a signal ends the process at once, with its line and exit code.

    Nothing is raised, since imports and `__del__` would drop it, and nothing is left half done: files appear whole.
    What is ignored stays so, and so do handlers of others.
    """

    def end(number: int, _: FrameType | None) -> NoReturn:
        code = _CODES[signal.Signals(number).name]
        with contextlib.suppress(Exception):  # it may have broken into the import of what a line needs
            line = log_line("facetrack: interrupted" if code is ExitCode.INTERRUPTED else "facetrack: terminated")
            os.write(2, f"{_SHOW_CURSOR * os.isatty(2)}{line}\n".encode())
        os._exit(code)

    with _handled(end, lambda before: before in (signal.SIG_DFL, signal.default_int_handler)):
        yield


@contextlib.contextmanager
def _handled(handler: Callable[[int, FrameType | None], None], takes: Callable[[Any], bool]) -> Iterator[None]:
    """Take over, for the length of a `with`, each signal that ends a run and whose handler so far it `takes`."""
    with contextlib.ExitStack() as restored:
        main = threading.current_thread() is threading.main_thread()
        for number in [sig for sig in signal.Signals if sig.name in _CODES] if main else ():
            if takes(signal.getsignal(number)):
                restored.callback(signal.signal, number, signal.signal(number, handler))
        yield
