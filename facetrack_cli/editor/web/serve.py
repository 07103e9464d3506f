"""Serve one session until it is saved or somebody stops it."""

from __future__ import annotations

import threading
import time
import webbrowser
from collections.abc import Callable

from facetrack_cli.editor.web.server import POLL_S, serving
from facetrack_cli.editor.web.session import Session


def run_page(
    session: Session, stop: Callable[[], bool], say: Callable[[str], None], *, port: int = 0, browse: bool = False
) -> None:
    """Say where the page is, and return when it is over or `stop` says so; a job that runs is waited for.

    Port 0 is any that is free. Raises UsageError if the port cannot be had.
    """
    with serving(session, port) as server:
        at = server.server_port
        say(f"open this page: {server.url}")
        say(f"from another machine: ssh -L {at}:127.0.0.1:{at} HOST, then open the same address there; Ctrl-C ends it")
        if browse:  # in a thread, since a browser of the terminal returns only when it is left
            threading.Thread(target=_browse, args=(server.url, say), daemon=True).start()
        while not (session.over() or stop()):
            time.sleep(POLL_S)
    if session.first_fault is not None:
        told = f"{type(session.first_fault).__name__}: {session.first_fault}"
        say(f"facetrack: warning: while the page was open, an error that is our fault, not yours: {told}")


def _browse(url: str, say: Callable[[str], None]) -> None:
    if not webbrowser.open(url):
        say("no browser can be opened from here; open the page yourself")
