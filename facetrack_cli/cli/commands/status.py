"""facetrack status: how far a batch is."""

from __future__ import annotations

from pathlib import Path

import click

from facetrack_cli.cli.options import flag
from facetrack_cli.cli.types import FOLDER
from facetrack_cli.core.errors import flat


@click.command()
@click.argument("results", type=FOLDER, metavar="RESULTS")
@flag("--json", "as_json", help="Print JSON.")
def command(results: Path, as_json: bool) -> None:
    """Tell how far a batch is, and how long it still takes.

    RESULTS is the folder that --out of facetrack run named, or that of a single run. A table names the clips to look
    at, the worst first: clips that failed, with the reason; incomplete clips; clips in which a part is lost most. What
    runs is told with its machine, since when, and how far it is. Nothing is written.

    \b
    Examples:
      facetrack status results
      watch -n 60 facetrack status results
      facetrack status results --json | jq .counts
    """
    from facetrack_cli.run_folder.status import survey

    found = survey(results)
    click.echo(found.json() if as_json else "\n".join(map(flat, found.lines())), nl=not as_json)
