"""A batch on the workers of a Dask cluster: jobs go out, outcomes come back, results go straight to the folders.

Dask finds a worker for each clip, replaces a worker that dies (its nanny does), and tries again what fails. What a
killed worker leaves in a folder is taken up by the next run there, as after any kill.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import pickle
import re
import secrets
import socket
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import BusyError, ExitCode, FacetrackError, InputError, UsageError, needed, reason
from facetrack_cli.core.files import read_bounded
from facetrack_cli.runs.batch import attempt, outcome_of_crash, run_shared
from facetrack_cli.runs.plan import Job, Outcome
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import share_threads

RETRIES: Final = 2  # of a clip that is not itself at fault
ANSWER_S = 30.0  # for a scheduler to answer
LOOK_S = 0.1  # between two looks at the clips that are out
STOP_S = 30.0  # for clips that are told to end, to close their files


def run_cluster(jobs: Sequence[Job], where: str, stop: Stop, progress: Progress) -> Iterator[Outcome]:
    """Run `jobs` on the cluster `where`; each outcome is yielded as it ends.

    A job that fails does not stop the others. Once `stop` says so, the clips at work close their files, as far as they
    can within `STOP_S`, and the others are not begun. Raises UsageError if no scheduler answers.
    """
    client = _connect(where, progress)
    try:
        yield from run_shared(jobs, partial(_turn, client, stop, progress), stop, progress)
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=ANSWER_S)


def _connect(where: str, progress: Progress) -> Any:
    """A client of the scheduler. Raises UsageError if none answers within `ANSWER_S`."""
    address = address_of(where)
    if not _is_here(address):
        said = f"{address} is another machine; a scheduler of Dask may run code on this one, too"
        progress.say(f"facetrack: warning: --cluster: {said}")
    try:
        client = _client(address, ANSWER_S)
        threads = client.nthreads().values()
    except OSError as e:
        said = f"no scheduler of Dask answers at {address} within {ANSWER_S:.0f} s"
        raise UsageError(f"--cluster {where}: {said} ({reason(e)}); start one with `dask scheduler`, or take -j") from e
    if not threads:
        progress.say(f"facetrack: the scheduler of {where} has no worker; waiting for one")
    elif max(threads) > 1:
        said = "a worker tracks one clip at a time, whatever its threads; start workers with --nthreads 1"
        progress.say(f"facetrack: warning: {where}: {said}")
    return client


def _turn(client: Any, stop: Stop, progress: Progress, jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
    """Run each of the jobs until it is decided what becomes of it."""
    batch, folder, killed = secrets.token_hex(8), str(Path.cwd()), set[Path]()

    def submit(job: Job) -> Any:
        sent = pickle.dumps(replace(job, retry_failed=True))
        return client.submit(_on_worker, __version__, folder, batch, sent, pure=False, retries=RETRIES)

    began, ended, frames, deadline = time.monotonic(), 0, 0, math.inf
    progress.begin(f"{len(jobs)} clips", "clips", len(jobs))
    out = {submit(job): job for job in jobs}
    while out and time.monotonic() < deadline and client.status == "running":
        if stop() and deadline == math.inf:
            deadline = time.monotonic() + STOP_S
            _tell(client, batch)
        for future, job in [(future, job) for future, job in out.items() if future.done()]:
            outcome = _outcome(job, future, killed)
            left = outcome is None or (outcome.stopped is not None and outcome.error is None)  # by its worker
            if left and not stop():
                if client.status != "running":
                    break
                begun = outcome is not None and outcome.files  # what is there is of this batch
                again = replace(job, overwrite=False) if begun else job
                out[submit(again)] = again
            elif outcome is not None:
                ended, frames = ended + 1, frames + outcome.frames
                yield job, outcome
            del out[future]
        progress.update(ended, len(jobs), frames / (time.monotonic() - began))
        time.sleep(LOOK_S)
    for job in () if stop() else out.values():
        gone = "not tracked, as the scheduler is gone; the same command again goes on"
        yield job, Outcome(clip=job.clip, error=FacetrackError(f"{job.clip}: {gone}"))


def _outcome(job: Job, future: Any, killed: set[Path]) -> Outcome | None:
    """What became of a job; None if its worker ended, or was told to leave, before it had begun."""
    from distributed import KilledWorker

    try:
        outcome: Outcome | None = future.result(timeout=ANSWER_S)
        return outcome
    except KilledWorker as e:
        if job.clip not in killed:  # Dask suspects all clips that the workers had, so each is tried once more
            killed.add(job.clip)
            return None
        last = e.last_worker.address
        error = FacetrackError(f"it ended worker after worker, as by taking all of the memory, at last {last}")
    except Exception as e:
        if future.status in ("cancelled", "lost", "pending"):  # with the worker
            return None
        what = str(e) if isinstance(e, FacetrackError) else f"{type(e).__name__}: {e}"
        error = FacetrackError(f"{what}; tried {RETRIES + 1} times")
    return outcome_of_crash(job, error)


def _tell(client: Any, batch: str) -> None:
    """Let the workers end the clips of this batch; nobody waits for a worker that hangs."""

    def say() -> None:
        with contextlib.suppress(Exception):
            client.run(_end, batch, on_error="ignore")

    threading.Thread(target=say, daemon=True).start()


# --- on a worker -----------------------------------------------------------------------------------------------------

_ended_batches: set[str] = set()  # whose clips are to end
_alone: Final = threading.Lock()  # the working directory is that of the process


def _end(batch: str) -> None:
    _ended_batches.add(batch)


def _on_worker(version: str, folder: str, batch: str, sent: bytes) -> Outcome | None:
    """A task: the outcome of the job that is `sent`, None if it is not begun any more.

    Raises FacetrackError for what Dask is to try again: all but a clip that is itself at fault, or is busy.
    """
    from distributed import get_worker

    worker, host = get_worker(), socket.gethostname()

    def asked() -> ExitCode | None:
        leaving = worker.status.name in ("closing", "closed", "failed", "stopping")
        return ExitCode.TERMINATED if leaving or batch in _ended_batches else None

    stop = Stop(asked)
    with _alone:
        if stop():
            return None
        if version != __version__:
            said = f"facetrack {__version__} is installed on {host}, and {version} where the batch is"
            raise FacetrackError(f"{said}; install the same version")
        try:
            os.chdir(folder)
        except OSError as e:
            raise FacetrackError(f"{folder}: {e.strerror} on {host}; all machines must see the same folders") from None
        job = pickle.loads(sent)
        share_threads(job.threads)
        outcome = attempt(job, stop)
    if outcome.error is not None and not isinstance(outcome.error, InputError | BusyError) and not stop():
        raise outcome.error
    return outcome


def check_cluster(where: str) -> int | None:
    """N of local:N, the processes of this machine; None for a scheduler, whose workers do the clips.

    Raises UsageError for a value of --cluster that names neither, and where the packages that it takes are missing.
    """
    if os.name != "posix":
        raise UsageError("--cluster is for Linux and macOS; take -j")
    if found := re.fullmatch(r"local:([1-9]\d{0,3})", where):
        return int(found[1])
    address_of(where)
    with needed("workers of --cluster", "distributed", "cluster"):
        import distributed  # noqa: F401
    return None


def address_of(where: str) -> str:
    """The address of a scheduler, which may stand in a file. UsageError for what is neither."""
    if re.fullmatch(r"(tcp|tls)://[^\s/]+:\d{1,5}", where):
        return where
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        if isinstance(address := json.loads(read_bounded(Path(where), what="scheduler file"))["address"], str):
            return address
    forms = "give local:N, tcp://HOST:PORT, or the scheduler file of `dask scheduler --scheduler-file`"
    raise UsageError(f"--cluster {where}: names no scheduler; {forms}")


def _is_here(address: str) -> bool:
    """Whether the host of an address is this machine: only here a socket can be bound to it."""
    host = urlsplit(address).hostname or ""
    with contextlib.suppress(OSError):
        socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
        return True
    return False


def _client(address: str, patience_s: float) -> Any:
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our lines say what matters
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Client(address, timeout=patience_s, set_as_default=False)
