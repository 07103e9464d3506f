"""How far a run is, on standard error: a bar on a terminal, a plain line now and then elsewhere, or nothing."""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

EVERY_S = 10.0  # between plain lines


class Progress(Protocol):
    """One task at a time, in `unit`s: frames of a clip, clips of a batch. `say` and `error` print a line that stays."""

    def begin(self, name: str, unit: str, total: int | None) -> None: ...
    def update(self, done: int, total: int | None, rate: float | None = None) -> None: ...
    def say(self, line: str) -> None: ...
    def error(self, line: str) -> None: ...
    def close(self) -> None: ...


def progress(quiet: bool) -> Progress:
    """The kind that fits standard error."""
    if quiet:
        return Silent()
    return Bar() if sys.stderr.isatty() else Lines()


class Silent:
    """Says nothing."""

    def begin(self, name: str, unit: str, total: int | None) -> None:
        pass

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        pass

    def say(self, line: str) -> None:
        pass

    def error(self, line: str) -> None:
        _write(line)

    def close(self) -> None:
        pass


class Lines:
    """A line every ten seconds, for logs."""

    def begin(self, name: str, unit: str, total: int | None) -> None:
        self._name, self._unit = name, unit
        self._began = self._last = time.monotonic()

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        now = time.monotonic()
        if now - self._last < EVERY_S:
            return
        self._last = now
        # what a file says of its length is a guess
        of = "" if not total else f" of about {total}" if self._unit == "frames" else f" of {total}"
        rate = done / (now - self._began) if rate is None else rate
        self.say(f"{self._name}: {done}{of} {self._unit}, {rate:.1f} frames/s")

    def say(self, line: str) -> None:
        _write(line)

    def error(self, line: str) -> None:
        _write(line)

    def close(self) -> None:
        pass


class Bar:
    """A bar with the count, frames/s and the time left."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar: RichProgress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[count]}", markup=False),
            TextColumn("{task.fields[rate]}", markup=False),
            TimeRemainingColumn(),
            console=Console(stderr=True, emoji=False),
            transient=True,
        )
        self._task: TaskID | None = None

    def begin(self, name: str, unit: str, total: int | None) -> None:
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._unit = unit
        self._began = self._last = time.monotonic()
        self._task = self._bar.add_task(name, total=total, count="", rate="")
        self._bar.start()

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        now = time.monotonic()
        if self._task is None or now - self._last < 0.1:
            return
        self._last = now
        rate = done / (now - self._began) if rate is None else rate
        # a count that the file got wrong must not show more than all of it
        total = None if total is not None and done > total else total
        self._bar.update(
            self._task,
            completed=done,
            total=total,
            count=f"{done}{f'/{total}' if total else ''} {self._unit}",
            rate=f"{rate:.1f} frames/s",
        )

    def say(self, line: str) -> None:
        self._bar.console.print(_flat(line), markup=False, highlight=False, soft_wrap=True)

    def error(self, line: str) -> None:
        self.say(line)

    def close(self) -> None:
        self._bar.stop()


def _write(line: str) -> None:
    with contextlib.suppress(OSError):  # a full disk under the log is no reason to stop
        sys.stderr.write(_flat(line) + "\n")
        sys.stderr.flush()


def _flat(line: str) -> str:
    """A name may hold a line break, a message must not."""
    return " ".join(line.splitlines())
