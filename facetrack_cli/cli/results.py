"""What `compare` and `repeat` share: the options about their results, and writing and printing them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from facetrack_cli.cli.options import OVERWRITE, flag, jobs_option
from facetrack_cli.core.errors import UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.files import Folder
    from facetrack_cli.evaluation.experiments.sheet import Findings
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop

TABLES = ("json", "csv", "md")


class Experiment(NamedTuple):
    """What a command of many runs works with: the wish to stop, the progress, and the folder of its results."""

    stopped: Stop
    shown: Progress
    folder: Folder


class Results:
    """Where the results of many runs go, and how many processes make them."""

    as_json: bool = flag("--json", "Print JSON instead of the table.")
    as_csv: bool = flag("--csv", "Print CSV instead of the table.")
    no_plots: bool = flag("--no-plots", "Draw nothing.")
    overwrite: bool = OVERWRITE
    jobs: int = jobs_option("Processes that share the runs.")
    quiet: bool = flag("--quiet -q", "Print the table, and nothing else but errors.")

    @contextlib.contextmanager
    def open(self, clip: Path, out: str | None, folder: str, stem: str, plots: Sequence[str]) -> Iterator[Experiment]:
        """For results named `stem`.json and so on in `out`, or else `folder`; OutputError where there can be none."""
        from facetrack_cli.core.files import Folder
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop

        names = [*(f"{stem}.{ending}" for ending in TABLES), *(() if self.no_plots else plots)]
        with (
            Stop().listening() as stopped,
            contextlib.closing(progress(self.quiet)) as shown,
            Folder(out, folder, names, overwrite=self.overwrite, clip=clip) as opened,
        ):
            yield Experiment(stopped, shown, opened)

    def publish(
        self, found: Findings, stem: str, into: Experiment, figures: Callable[[], Iterable[tuple[str, bytes]]]
    ) -> None:
        """Write all files, without matplotlib all but the plots, and print the table, or the data."""
        try:
            for ending, text in zip(TABLES, (found.json(), found.csv(), found.sheet().markdown()), strict=True):
                into.folder.write(f"{stem}.{ending}", text)
            if not self.no_plots:
                self._draw(into, figures)
        finally:  # what took long is not lost for a full disk
            if self.as_json or self.as_csv:
                click.echo(found.json() if self.as_json else found.csv(), nl=False)
            else:
                found.sheet().show()
        into.shown.say(f"{found.clip} -> {into.folder.summary()}")

    def _draw(self, into: Experiment, figures: Callable[[], Iterable[tuple[str, bytes]]]) -> None:
        from facetrack_cli.report.figures.style import need_matplotlib

        try:
            need_matplotlib()
        except UsageError as e:
            into.shown.say(f"facetrack: warning: no plots: {e}")
            return
        for name, png in figures():
            into.folder.write(name, png)
