"""A batch on the workers of a Dask cluster: jobs go out, outcomes come back, results go straight to the folders.

Dask finds a worker for each clip, replaces a worker that dies (its nanny does), and gives the clip to another one. What
a killed worker leaves in a folder is taken up by the next run there, as after any kill.
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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from facetrack_cli import __version__
from facetrack_cli.core.errors import BusyError, ExitCode, FacetrackError, InputError, UsageError, needed, reason
from facetrack_cli.run_folder.manifest import NAME, as_line
from facetrack_cli.runs.batch import attempt, died, share
from facetrack_cli.runs.job import Job, Outcome
from facetrack_cli.runs.pipeline import share_threads
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop, StoppedError

if TYPE_CHECKING:
    from distributed import Client, Future

After: TypeAlias = Callable[[Outcome, Stop], tuple[object, Sequence[str]]]
"""What is done with a clip that was tracked, as smoothing; it gives warnings, and can be pickled."""
TRIES: Final = 3  # of a clip that is not itself at fault
ANSWER_S = 30.0  # for a scheduler to answer
PATIENCE_S = 1800.0  # for a scheduler that is gone to come back
LOOK_S = 0.1  # between two looks at the clips that are out
UNSEEN_S = 60.0  # until files that a worker wrote show here
STOP_S = 30.0  # for clips that are told to end, to close their files


class _Try(NamedTuple):
    """A job that is out: how often it has failed before, and the addresses of the workers on which it did."""

    job: Job
    failed: int = 0
    workers: frozenset[str] = frozenset()


def run_cluster(
    jobs: Sequence[Job], where: str, stop: Stop, progress: Progress, after: After | None = None
) -> Iterator[Outcome]:
    """Run `jobs` on the cluster `where`, and then `after`; each outcome is yielded as it ends.

    A job that fails does not stop the others. Once `stop` says so, the clips at work close their files, as far as they
    can within `STOP_S`, and the others are not begun. Raises UsageError if no scheduler answers.
    """
    with contextlib.closing(_Cluster(where, stop, progress, after)) as cluster:
        cluster.connect(ANSWER_S)
        yield from share(jobs, cluster.turn, stop, progress)


class _Cluster:
    def __init__(self, where: str, stop: Stop, progress: Progress, after: After | None) -> None:
        self._where, self._stop, self._progress, self._after = where, stop, progress, after
        self._batch, self._folder = secrets.token_hex(8), str(Path.cwd())
        self._client: Any = None
        self._unseen_s = UNSEEN_S

    def connect(self, patience_s: float) -> None:
        """Connect, or return early on a wish to stop. Raises UsageError if there is no answer for so long."""
        deadline = time.monotonic() + patience_s
        while not self._stop():
            try:
                self._client = _client(address_of(self._where), min(patience_s, ANSWER_S / 6))
                threads = self._client.nthreads().values()
            except (OSError, UsageError) as e:  # of a file that is being written, too
                if time.monotonic() > deadline:
                    said = f"no scheduler of Dask answers at {address_of(self._where)} within {patience_s:.0f} s"
                    remedy = "start one with `dask scheduler`, or take -j"
                    raise UsageError(f"--cluster {self._where}: {said} ({reason(e)}); {remedy}") from e
                time.sleep(LOOK_S)
            else:
                if not threads:
                    self._progress.say(f"facetrack: the scheduler of {self._where} has no worker; waiting for one")
                elif max(threads) > 1:
                    said = "a worker tracks one clip at a time, whatever its threads; start workers with --nthreads 1"
                    self._progress.say(f"facetrack: warning: {self._where}: {said}")
                return

    def turn(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
        """Run each of the jobs until it is decided what becomes of it."""
        began, ended, frames, deadline = time.monotonic(), 0, 0, math.inf
        self._progress.begin(f"{len(jobs)} clips", "clips", len(jobs))
        out = {self._submit(one): one for one in map(_Try, jobs)}
        while out and time.monotonic() < deadline:
            if self._stop() and deadline == math.inf:
                deadline = time.monotonic() + STOP_S
                self._tell()
            if self._client.status != "running":
                if self._stop() or not self._return():
                    break
                out = {self._submit(one): one for one in out.values()}
            for future in [future for future in out if future.done()]:
                one = out.pop(future)
                again, outcome = self._judged(one, future)
                if again is not None:
                    out[self._submit(again)] = again
                elif outcome is not None:
                    outcome = self._shown(one.job, outcome)
                    ended, frames = ended + 1, frames + outcome.frames
                    yield one.job, outcome
            self._progress.update(ended, len(jobs), frames / (time.monotonic() - began))
            time.sleep(LOOK_S)
        for one in () if self._stop() else out.values():
            gone = "not tracked, as the scheduler did not come back; the same command again goes on"
            yield one.job, Outcome(clip=one.job.clip, error=FacetrackError(f"{one.job.clip}: {gone}"))

    def _submit(self, one: _Try) -> Future[tuple[Outcome | None, str]]:
        """Send a job; not to the workers on which it failed, nor to their machines, if there are others."""
        machines, known, prefer = {_host(worker) for worker in one.workers}, list[str](), dict[str, Any]()
        with contextlib.suppress(OSError):  # the scheduler is gone, which shows elsewhere
            known = list(self._client.nthreads()) if one.workers else []
        others = [worker for worker in known if _host(worker) not in machines]
        if others := others or [worker for worker in known if worker not in one.workers]:
            prefer = {"workers": others, "allow_other_workers": True}
        task = (__version__, self._folder, self._batch, pickle.dumps((one.job, self._after)))
        return self._client.submit(_on_worker, *task, pure=False, **prefer)

    def _judged(self, one: _Try, future: Future[Any]) -> tuple[_Try | None, Outcome | None]:
        """The job as it is tried again, or its outcome; neither if it had not begun when the batch was stopped."""
        from distributed import KilledWorker

        job, worker, cost, outcome = one.job, "", 1, None
        try:
            outcome, worker = future.result(timeout=ANSWER_S)
            error = None if outcome is None else outcome.error
        except KilledWorker as e:
            # Dask suspects all clips that the workers had, so each is tried once more
            worker, cost = e.last_worker.address, TRIES - 1
            error = FacetrackError("it ended worker after worker, as by taking all of the memory")
        except ModuleNotFoundError as e:
            error = FacetrackError(f"{reason(e)}; install facetrack {__version__} on the workers, as it is here")
        except Exception as e:
            error = e if isinstance(e, FacetrackError) else FacetrackError(f"{type(e).__name__}: {e}")
            if future.status in ("cancelled", "lost", "pending"):  # with the scheduler, or with the worker
                return (None if self._stop() else one), None
        if outcome is not None and outcome.files:
            job = replace(job, overwrite=False)  # what is there is of this batch
        if self._stop() or isinstance(error, InputError | BusyError):
            return None, outcome
        if error is None:  # the worker may have been told to leave
            return (one._replace(job=job), None) if outcome is None or outcome.stopped else (None, outcome)
        failed = one.failed + cost
        if failed < TRIES:
            self._progress.say(
                f"facetrack: warning: {job.clip}: failed on {worker or 'a worker'} and is tried again: {error}"
            )
            return _Try(replace(job, retry_failed=True), failed, one.workers | {worker}), None
        error = FacetrackError(f"{error}; tried {failed} times, at last on {worker or 'a worker'}")
        if outcome is None:
            return None, died(job, error)
        outcome.error = error
        return None, outcome

    def _shown(self, job: Job, outcome: Outcome) -> Outcome:
        """The outcome, once what the worker wrote shows here."""
        until = time.monotonic() + self._unseen_s
        while outcome.files and not (outcome.files[0].parent / NAME).exists() and not self._stop():
            if time.monotonic() > until:
                self._unseen_s = 0.0
                said = f"{job.clip}: was tracked, but {job.out} does not show it here"
                return Outcome(clip=job.clip, error=FacetrackError(f"{said}; all machines must see the same folders"))
            time.sleep(LOOK_S)
        return outcome

    def _return(self) -> bool:
        """Wait for a scheduler that is gone; whether it came back."""
        self._progress.say(f"facetrack: warning: the scheduler of {self._where} is gone; waiting for it")
        self.close()
        with contextlib.suppress(UsageError):
            self.connect(PATIENCE_S)
        if self._client is not None:
            self._progress.say(f"facetrack: the scheduler of {self._where} is back")
        return self._client is not None

    def _tell(self) -> None:
        """Let the workers end the clips of this batch; nobody waits for a worker that hangs."""
        client, batch = self._client, self._batch

        def say() -> None:
            with contextlib.suppress(Exception):
                client.run(_end, batch, on_error="ignore")

        threading.Thread(target=say, daemon=True).start()

    def close(self) -> None:
        if self._client is not None:
            with contextlib.suppress(Exception):
                self._client.close(timeout=ANSWER_S)
        self._client = None


# --- on a worker -----------------------------------------------------------------------------------------------------

_ended_batches: set[str] = set()  # whose clips are to end
_alone: Final = threading.Lock()  # the working directory is that of the process


def _end(batch: str) -> None:
    _ended_batches.add(batch)


def _on_worker(version: str, folder: str, batch: str, sent: bytes) -> tuple[Outcome | None, str]:
    """A task: the outcome of a job, None if it is not begun any more, and the address of the worker.

    `sent` has the job and what is done after it. Raises FacetrackError if this machine cannot do it.
    """
    from distributed import get_worker

    worker, host = get_worker(), socket.gethostname()

    def asked() -> ExitCode | None:
        leaving = worker.status.name in ("closing", "closed", "failed", "stopping")
        return ExitCode.TERMINATED if leaving or batch in _ended_batches else None

    stop = Stop(asked)
    with _alone:
        if stop():
            return None, worker.address
        if version != __version__:
            said = f"facetrack {__version__} is installed on {host}, and {version} where the batch is"
            raise FacetrackError(f"{said}; install the same version")
        try:
            os.chdir(folder)
        except OSError as e:
            raise FacetrackError(f"{folder}: {e.strerror} on {host}; all machines must see the same folders") from None
        job, after = pickle.loads(sent)
        share_threads(job.threads)
        outcome = attempt(job, stop)
        smoothed = outcome.again is not None and outcome.again.smoothed
        if after is not None and outcome.error is None and not smoothed and not stop():
            try:
                outcome.warnings = (*outcome.warnings, *after(outcome, stop)[1])
                outcome.again = outcome.again and job.previous()
            except StoppedError:  # before it was smoothed
                return None, worker.address
            except Exception as e:
                outcome.error = as_line(e)
    return outcome, worker.address


# --- the scheduler ---------------------------------------------------------------------------------------------------


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
    forms = "give local:N, tcp://HOST:PORT, or the scheduler file of `dask scheduler --scheduler-file`"
    if re.fullmatch(r"(tcp|tls)://[^\s/]+:\d{1,5}", where):
        return where
    if where.startswith("local") or "://" in where or re.fullmatch(r"[^/]*:\d+", where):
        raise UsageError(f"--cluster {where}: names no scheduler; {forms}")
    try:
        found = json.loads(Path(where).read_bytes())["address"]
        if not isinstance(found, str):
            raise TypeError
    except OSError as e:
        raise UsageError(f"--cluster {where}: cannot be read: {e.strerror or e}; {forms}") from None
    except (ValueError, TypeError, KeyError):
        raise UsageError(f"--cluster {where}: is no scheduler file: it has no address; {forms}") from None
    return found


def _client(address: str, patience_s: float) -> Client:
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our lines say what matters
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Client(address, timeout=patience_s, set_as_default=False)


def _host(worker: str) -> str:
    return worker.rpartition(":")[0]
