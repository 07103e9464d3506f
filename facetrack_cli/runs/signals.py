"""Ctrl-C and SIGTERM: a wish to stop, which the loop over frames grants between two frames.

Nothing is torn out of a half-written file: the signal only leaves a note. A second signal changes nothing.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, ClassVar, NoReturn, TypeAlias

from facetrack_cli.core.errors import ExitCode

Stopped: TypeAlias = Callable[[], bool]  # whether the work is to end
# a closed terminal (not on Windows) ends a run as properly as SIGTERM does
_CODES = {"SIGINT": ExitCode.INTERRUPTED, "SIGTERM": ExitCode.TERMINATED, "SIGHUP": ExitCode.TERMINATED}


class TerminatedError(BaseException):
    """SIGTERM where no Stop listens."""


class StoppedError(Exception):
    """The work was stopped on request; nothing has changed."""


def never() -> bool:
    """No wish to stop."""
    return False


class Stop:
    """Whether the run is to end. `code` is the exit code of the first wish; `elsewhere` asks another process."""

    before: ClassVar[ExitCode | None] = None  # of a signal that came before any Stop listened

    def __init__(self, elsewhere: Callable[[], ExitCode | None] = lambda: None) -> None:
        self.code: ExitCode | None = None
        self._elsewhere = elsewhere

    def __call__(self) -> bool:
        if self.code is None:
            self.code = Stop.before or self._elsewhere()
        return self.code is not None

    @property
    def reason(self) -> str:
        return "terminated" if self.code is ExitCode.TERMINATED else "interrupted"

    @contextlib.contextmanager
    def listening(self) -> Iterator[Stop]:
        """Take the signals over for the length of a `with`; a signal that is ignored (nohup) stays ignored."""

        def note(number: int, _: FrameType | None) -> None:
            # no lock is taken here: the thread that is interrupted may hold it
            if self.code is None:
                self.code = _CODES[signal.Signals(number).name]

        taken = [sig for sig in signal.Signals if sig.name in _CODES and signal.getsignal(sig) is not signal.SIG_IGN]
        with contextlib.ExitStack() as restored:
            if threading.current_thread() is threading.main_thread():
                for number in taken:
                    restored.callback(signal.signal, number, signal.signal(number, note))
            yield self


@contextlib.contextmanager
def raising() -> Iterator[None]:
    """Where no Stop listens, Ctrl-C raises KeyboardInterrupt, other signals TerminatedError; what is ignored stays so.

    Handlers of others stay.

    Within an import, which may turn the exception into another one, the process ends at once. Python drops what is
    raised within a `__del__` or a callback: then the next Stop ends at once.
    """

    def end(number: int, frame: FrameType | None) -> NoReturn:
        while frame is not None:
            if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
                code = _CODES[signal.Signals(number).name]
                what = "interrupted" if code is ExitCode.INTERRUPTED else "terminated"
                with contextlib.suppress(OSError):
                    os.write(2, f"facetrack: {what}\n".encode())
                os._exit(code)
            frame = frame.f_back
        Stop.before = _CODES[signal.Signals(number).name]
        raise KeyboardInterrupt if number == signal.SIGINT else TerminatedError

    def report(dropped: Any) -> None:
        if not isinstance(dropped.exc_value, KeyboardInterrupt | TerminatedError):
            reported(dropped)

    reported, sys.unraisablehook = sys.unraisablehook, report
    with contextlib.ExitStack() as restored:
        restored.callback(setattr, sys, "unraisablehook", reported)
        restored.callback(setattr, Stop, "before", None)
        main = threading.current_thread() is threading.main_thread()
        for number in [sig for sig in signal.Signals if sig.name in _CODES] if main else ():
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                restored.callback(signal.signal, number, signal.signal(number, end))
        yield
