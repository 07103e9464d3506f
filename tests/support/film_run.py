"""A run of the sample film, made once for all processes that share the tests."""

import fcntl
import os

from facetrack_cli.__main__ import main
from tests.support.samples import FOLDER

FILM = FOLDER / "film.mp4"


def film_run(tmp_path_factory):
    """The folder of `facetrack run film.mp4 --faces all`; nobody may change it."""
    own = tmp_path_factory.getbasetemp()  # with xdist a folder of each worker, in a folder of the session
    place = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    out = place / "film-run"
    with (place / "film-run.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not out.exists():
            assert main(["run", str(FILM), "--faces", "all", "-o", str(out), "-q"]) == 0
    return out
