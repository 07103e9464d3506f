"""facetrack app: track, look, correct and export on one page."""

from __future__ import annotations

from pathlib import Path

import click

from facetrack_cli.cli.options import flag, option, say
from facetrack_cli.cli.types import Text, Whole


@click.command()
@click.argument("project", type=Text("PROJECT", Path), required=False, default=lambda: Path.home() / "facetrack")
@option(
    "--port", type=Whole(min=1, max=65535), metavar="N", help="Port of the page on this machine [default: any free]."
)
@flag("--no-open", help="Do not open the page in the browser.")
def command(project: Path, port: int | None, no_open: bool) -> int:
    """Track, look, correct and export on one page.

    The page opens in the browser and stays open. Drop clips on it, or name a folder; choose what is tracked in each;
    run them; look at them, correct them, and export them for other programs. PROJECT is the folder where all of that is
    kept [default: facetrack, in your home]; the same command again shows it, and goes on with what was not finished.

    It is served to this machine alone, and ends with Quit on the page, or with Ctrl-C.

    \b
    Examples:
      facetrack app
      facetrack app study/
      facetrack app study/ --port 8800 --no-open
    """
    from facetrack_cli.editor.project import Project
    from facetrack_cli.editor.web.app_session import AppSession
    from facetrack_cli.editor.web.server import run_page
    from facetrack_cli.runs.signals import Stop

    with Stop().listening() as stop:
        session = AppSession(Project(project))
        run_page(session, stop, say, port=port or 0, browse=not no_open)
    return stop.code or 0
