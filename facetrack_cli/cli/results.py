"""What `compare` and `repeat` share: the options about their results, and writing and printing them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import flag, option
from facetrack_cli.core.errors import UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.output_folder import Folder
    from facetrack_cli.evaluation.experiments.sheet import Findings
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop

TABLES = ("json", "csv", "md")


class Experiment(NamedTuple):
    """What a command of many runs works with: the wish to stop, the progress, and the folder of its results."""

    stop: Stop
    shown: Progress
    folder: Folder


class Results(NamedTuple):
    """Where results go, and how many processes make them."""

    out: str | None
    printed: str | None
    no_plots: bool
    overwrite: bool
    workers: int
    quiet: bool

    @contextlib.contextmanager
    def open(self, clip: Path, folder: str, stem: str, plots: Sequence[str]) -> Iterator[Experiment]:
        """For results named `stem`.json and so on in --out, or else `folder`; refuses at once what cannot be written.

        Raises OutputError.
        """
        from facetrack_cli.core.output_folder import Folder
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop

        names = [*(f"{stem}.{ending}" for ending in TABLES), *(() if self.no_plots else plots)]
        with (
            Stop().listening() as stop,
            contextlib.closing(progress(self.quiet)) as shown,
            Folder.of(self.out, folder, names, overwrite=self.overwrite, inputs=[clip]) as opened,
        ):
            yield Experiment(stop, shown, opened)

    def publish(
        self, found: Findings, stem: str, into: Experiment, figures: Callable[[], Iterable[tuple[str, bytes]]]
    ) -> None:
        """Write all files, without matplotlib all but the plots, and print the table, or the data."""
        try:
            self._write(found, stem, into, figures)
        finally:  # what took long is not lost for a full disk
            if self.printed is None:
                found.sheet().show()
            else:
                click.echo(found.json() if self.printed == "json" else found.csv(), nl=False)
        into.shown.say(f"{found.clip} -> {into.folder.summary()}")

    def _write(
        self, found: Findings, stem: str, into: Experiment, figures: Callable[[], Iterable[tuple[str, bytes]]]
    ) -> None:
        from facetrack_cli.report.figures.style import need_matplotlib

        for ending, text in zip(TABLES, (found.json(), found.csv(), found.sheet().markdown()), strict=True):
            into.folder.write(f"{stem}.{ending}", text)
        if self.no_plots:
            return
        try:
            need_matplotlib()
        except UsageError as e:
            into.shown.say(f"facetrack: warning: no plots: {e}")
            return
        for name, png in figures():
            into.folder.write(name, png)


def results(folder: str, row: str) -> options.Decorator:
    """The options of `Results`: `folder` is the default of --out, `row` what a row of the CSV is."""
    return options.grouped(
        "results",
        Results,
        option("-o --out", "DIR", f"Folder for results [default: ./{folder}]."),
        click.option("--json", "printed", flag_value="json", help="Print JSON instead of the table."),
        click.option("--csv", "printed", flag_value="csv", help=f"Print CSV, a row a {row}, instead of the table."),
        flag("--no-plots", "Draw nothing."),
        options.overwrite,
        options.jobs("Processes that share the runs."),
        flag("--quiet -q", "Print the table, and nothing else but errors."),
    )
