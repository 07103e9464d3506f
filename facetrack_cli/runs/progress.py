"""Progress on standard error: a bar on a terminal, plain lines elsewhere, objects of JSON if asked for, or nothing."""

import contextlib
import re
import sys
import time
from typing import Any

from facetrack_cli.core.errors import as_json, flat, write_line

EVERY_S = 10.0  # between plain lines
EVERY_JSON_S = 1.0  # between objects of JSON, which nobody reads


class Progress:
    """One task at a time, in `unit`s: frames of a clip, clips of a batch. A line every ten seconds, none if `quiet`.

    In JSON an object for each message, with the clip, and every second one with how far it is.
    """

    _name = _unit = ""
    _doing: str | None = None  # of `name`, as the lines have it; None before anything is heard

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet

    def begin(self, name: str, unit: str = "frames", total: int | None = None) -> None:
        self._name, self._unit, self._doing = name, unit, None
        self._heard = self._last = time.monotonic()

    def looked(self, done: int, total: int | None, doing: str = "looking for a face", unit: str = "frames") -> None:
        """As `update`, while something else is done: what is tracked later is counted, and timed, anew."""
        self._hear(done, total, None, unit, f", {doing}")

    def update(self, done: int, total: int | None, rate: float | None = None) -> None:
        """Called as often as one likes; `total` None or 0 is not known."""
        self._hear(done, total, rate, self._unit, "")

    def _hear(self, done: int, total: int | None, rate: float | None, unit: str, doing: str) -> None:
        if doing != self._doing:  # of a run that goes on, much was done before
            self._doing, self._before, self._began = doing, done - 1, self._heard
        self._heard = time.monotonic()
        if rate is None and unit == "frames":
            rate = (done - self._before) / max(self._heard - self._began, 1e-6)
        self._show(done, total, None if rate is None else round(rate, 1), unit)

    def _show(self, done: int, total: int | None, speed: float | None, unit: str) -> None:
        if self._quiet or not self._due(EVERY_JSON_S if as_json() else EVERY_S):
            return
        if as_json():
            far = {"done": done, "total": total or None, "unit": unit, "frames_per_s": speed}
            write_line(f"progress{self._doing}", clip=self._clip(), **far)
        else:
            # the length that a file states is a guess
            of = "" if not total else f" of about {total}" if unit == "frames" else f" of {total}"
            rate = "" if speed is None else f", {speed:.1f} frames/s"
            self.say(f"{self._name}{self._doing}: {done}{of} {unit}{rate}")

    def say(self, line: str) -> None:
        """A line that stays."""
        if not self._quiet:
            self.error(line)

    def error(self, line: str) -> None:
        write_line(line, clip=self._clip())

    def close(self) -> None:
        pass

    def _due(self, every: float) -> bool:
        """Whether so many seconds have passed since it was last due."""
        now = time.monotonic()
        due = now - self._last >= every
        self._last = now if due else self._last
        return due

    def _clip(self) -> str | None:
        name = re.sub(r"^\[\d+/\d+\] ", "", self._name)  # without the count of a batch
        return name if self._unit == "frames" else None


class Bar(Progress):
    """A bar with the count, frames/s and the time left."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = ("description", "fields[count]", "fields[rate]")
        name, count, rate = (TextColumn(f"{{task.{column}}}", markup=False) for column in columns)
        console = Console(stderr=True, emoji=False)
        self._bar = Progress(name, BarColumn(), count, rate, TimeRemainingColumn(), console=console, transient=True)

    def begin(self, name: str, unit: str = "frames", total: int | None = None) -> None:
        super().begin(name, unit, total)
        for task in self._bar.task_ids:
            self._bar.remove_task(task)
        self._bar.add_task(flat(name), total=total, count="", rate="")
        self._bar.start()

    def _show(self, done: int, total: int | None, speed: float | None, unit: str) -> None:
        if self._bar.task_ids and self._due(0.1):
            total = total if total and done <= total else None  # a stated length may be wrong
            count = f"{done}{f'/{total}' if total else ''} {unit}"
            about: Any = {"count": count, "rate": "" if speed is None else f"{speed:.1f} frames/s"}
            description = flat(f"{self._name}{self._doing}")
            self._bar.update(self._bar.task_ids[0], description=description, completed=done, total=total, **about)

    def say(self, line: str) -> None:
        self._bar.console.print(flat(line), markup=False, highlight=False, soft_wrap=True)

    error = say

    def close(self) -> None:
        self._bar.stop()


def progress(quiet: bool) -> contextlib.closing[Progress]:
    """The kind that fits standard error, for a `with`."""
    has_bar = sys.stderr.isatty() and not quiet and not as_json()
    return contextlib.closing(Bar() if has_bar else Progress(quiet))
