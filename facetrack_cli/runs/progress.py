"""Progress on standard error: a bar on a terminal, plain lines elsewhere, or nothing."""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

EVERY_S = 10.0  # between plain lines


def progress(quiet: bool) -> Progress:
    """The kind that fits standard error."""
    if quiet:
        return Progress()
    return Bar() if sys.stderr.isatty() else Lines()


class Progress:
    """One task at a time, in `unit`s: frames of a clip, clips of a batch. This kind prints errors alone.

    `say` and `error` print a line that stays.
    """

    def begin(self, name: str, unit: str, total: int | None) -> None:
        self._name, self._unit = name, unit
        self._began = self._last = time.monotonic()

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        pass

    def say(self, line: str) -> None:
        pass

    def error(self, line: str) -> None:
        with contextlib.suppress(OSError):  # a full disk under the log does not stop the run
            sys.stderr.write(_flat(line) + "\n")
            sys.stderr.flush()

    def close(self) -> None:
        pass

    def _due(self, every: float) -> bool:
        """Whether so many seconds have passed since it was last due."""
        now = time.monotonic()
        due = now - self._last >= every
        self._last = now if due else self._last
        return due

    def _rate(self, done: int, rate: float | None) -> str:
        return f"{done / (time.monotonic() - self._began) if rate is None else rate:.1f} frames/s"


class Lines(Progress):
    """A line every ten seconds, for logs."""

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        if self._due(EVERY_S):
            # the length that a file states is a guess
            of = "" if not total else f" of about {total}" if self._unit == "frames" else f" of {total}"
            self.say(f"{self._name}: {done}{of} {self._unit}, {self._rate(done, rate)}")

    def say(self, line: str) -> None:
        self.error(line)


class Bar(Progress):
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
        super().begin(name, unit, total)
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._task = self._bar.add_task(name, total=total, count="", rate="")
        self._bar.start()

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        if self._task is not None and self._due(0.1):
            total = None if total is not None and done > total else total  # a stated length may be wrong
            count = f"{done}{f'/{total}' if total else ''} {self._unit}"
            self._bar.update(self._task, completed=done, total=total, count=count, rate=self._rate(done, rate))

    def say(self, line: str) -> None:
        self._bar.console.print(_flat(line), markup=False, highlight=False, soft_wrap=True)

    def error(self, line: str) -> None:
        self.say(line)

    def close(self) -> None:
        self._bar.stop()


def _flat(line: str) -> str:
    """A name may hold a line break, a message must not."""
    return " ".join(line.splitlines())
