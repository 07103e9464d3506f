"""The scheduler of a Dask cluster: what names one, the connection to it, and what is said when it is gone."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import threading
import time
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facetrack_cli import __version__
from facetrack_cli.core.errors import UsageError, needed, reason
from facetrack_cli.runs.guard import attempt, dismiss, tell
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop

if TYPE_CHECKING:
    from distributed import Client, Future

ANSWER_S = 30.0  # for a scheduler to answer
PATIENCE_S = 1800.0  # for one that is gone to come back
LOOK_S = 0.1  # between two looks at what is waited for
WORKERS_S = 5.0  # between two looks at who works
LEAST_OUT = 64  # clips that wait at the scheduler, so that a cluster that grows with its tasks does


def check_cluster(where: str) -> None:
    """UsageError for a value of --cluster that names no workers, and where the packages that it takes are missing."""
    if os.name != "posix":
        raise UsageError("--cluster is for Linux and macOS; take -j")
    address_of(where)
    with needed("workers of --cluster", "distributed", "cluster"):
        import distributed  # noqa: F401


class Scheduler:
    """The connection to a scheduler, and to a cluster of this process where there is to be one."""

    def __init__(self, where: str, progress: Progress, stop: Stop) -> None:
        self._where, self._progress, self._stop = where, progress, stop
        self._client: Client | None = None
        self._local: Any = None
        self._workers: dict[str, int] = {}  # the threads of each
        self._asked = -WORKERS_S
        self._began: float | None = time.monotonic()  # since when there has been no worker; None once that was said
        self._folder = str(Path.cwd())

    def connect(self, patience_s: float) -> None:
        """Connect, or return early on a wish to stop. Raises UsageError if there is no answer for so long."""
        made: list[Client | Exception] = []
        address = address_of(self._where)

        def make() -> None:
            try:
                made.append(self._made(address, patience_s))
            except Exception as e:
                made.append(e)

        threading.Thread(target=make, daemon=True).start()
        while not made and not self._stop():
            time.sleep(LOOK_S)
        if made and isinstance(made[0], Exception):
            said = f"no scheduler of Dask answers at {address} within {patience_s:.0f} s"
            remedy = "start one with `dask scheduler`, or take -j"
            raise UsageError(f"--cluster {self._where}: {said} ({reason(made[0])}); {remedy}")
        self._client = made[0] if made and not isinstance(made[0], Exception) else None

    def _made(self, address: str | int, patience_s: float) -> Client:
        from distributed import Client, LocalCluster

        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it is said in our lines
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if isinstance(address, str):
                return Client(address, timeout=patience_s, set_as_default=False)
            # its worker is a thread: what could end a process of Dask is in processes of the guards in any case
            self._local = LocalCluster(
                n_workers=1, threads_per_worker=address, processes=False, memory_limit=0, dashboard_address=None
            )
            return Client(self._local, set_as_default=False)

    def connect_again(self) -> bool:
        """Wait for a scheduler that is gone; False once it was too long."""
        self._progress.say(f"facetrack: warning: the scheduler of {self._where} is gone; waiting for it")
        self._close()
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and not self._stop():
            try:
                self.connect(ANSWER_S)
            except UsageError:  # also of a file that is being written
                time.sleep(LOOK_S)
            else:
                if self.lives():
                    self._progress.say(f"facetrack: the scheduler of {self._where} is back")
                return True
        return self._stop()

    def lives(self) -> bool:
        return self._client is not None and self._client.status == "running"

    def room(self) -> int:
        """How many clips may be out: enough that no thread waits for its next one."""
        now = time.monotonic()
        if now - self._asked >= WORKERS_S and self._client is not None:
            self._asked = now
            with contextlib.suppress(Exception):  # it is gone, which shows elsewhere
                self._workers = self._client.nthreads(callback_timeout=ANSWER_S)
            if self._workers:
                self._began = now
            elif self._began is not None and now - self._began > 2 * WORKERS_S:
                self._began = None
                self._progress.say(f"facetrack: the scheduler of {self._where} has no worker; waiting for one")
        return max(LEAST_OUT, 2 * sum(self._workers.values()))

    def submit(self, key: str, words: Sequence[str], failed: Collection[str]) -> Future[None]:
        """Send `facetrack run` with these words; not to the workers on which it `failed`, nor their machines, if there
        are others.
        """
        assert self._client is not None
        machines = {_host(one) for one in failed}
        others = [one for one in self._workers if _host(one) not in machines]
        others = others or [one for one in self._workers if one not in failed]
        prefer: dict[str, Any] = {"workers": others, "allow_other_workers": True} if failed and others else {}
        task = (key, __version__, self._folder, [*words])
        return self._client.submit(attempt, *task, key=key, pure=False, **prefer)

    def tell(self, keys: Sequence[str], at_once: bool = False) -> None:
        """Let the workers end these tasks; nobody waits for one that hangs."""
        client = self._client

        def say() -> None:
            with contextlib.suppress(Exception):
                if client is not None:
                    client.run(tell, keys, at_once, on_error="ignore")

        threading.Thread(target=say, daemon=True).start()

    def close(self) -> None:
        self._close()
        dismiss()

    def _close(self) -> None:
        for one in (self._client, self._local):
            with contextlib.suppress(Exception):
                if one is not None:
                    one.close(timeout=ANSWER_S)
        self._client, self._local = None, None


def address_of(where: str) -> str | int:
    """The address of a scheduler; a number of workers for local:N. UsageError for what is neither."""
    forms = "give local:N, tcp://HOST:PORT, or the scheduler file of `dask scheduler --scheduler-file`"
    if found := re.fullmatch(r"local:([1-9]\d{0,3})", where):
        return int(found[1])
    if re.fullmatch(r"(tcp|tls)://[^\s/]+:\d{1,5}", where):
        return where
    if where.startswith("local") or "://" in where or re.fullmatch(r"[^/]*:\d+", where):
        raise UsageError(f"--cluster {where}: names no scheduler; {forms}")
    try:
        found_in = json.loads(Path(where).read_bytes())["address"]
        if not isinstance(found_in, str):
            raise TypeError
    except OSError as e:
        raise UsageError(f"--cluster {where}: cannot be read: {e.strerror or e}; {forms}") from None
    except (ValueError, TypeError, KeyError):
        raise UsageError(f"--cluster {where}: is no scheduler file: it has no address; {forms}") from None
    return found_in


def _host(worker: str) -> str:
    return worker.rpartition(":")[0]
