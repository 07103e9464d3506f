"""Several clips: which, where the results of each go, and N of them at a time.

What is done, and what failed, is what the folders say, before a clip is begun and again once its folder is claimed. So
several batches on the same folders, also of several machines, share the clips.

They are tracked by processes of this machine, or by the workers of a Dask cluster: jobs go out, outcomes come back,
results go straight to the folders. Dask finds a worker for each clip, replaces a worker that dies (its nanny does), and
tries again what fails. What a killed worker leaves in a folder is taken up by the next run there, as after any kill.

Of the inputs of a command line a folder of images is one clip. In a folder that holds videos or animations each
of them is a clip; in one that holds none of these, those of its sub-folders are.
"""

import contextlib
import glob
import itertools
import json
import logging
import math
import os
import pickle
import re
import secrets
import socket
import sys
import threading
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import (
    BusyError,
    ExitCode,
    FacetrackError,
    InputError,
    UsageError,
    about,
    from_system,
    needed,
    reason,
)
from facetrack_cli.core.files import MAX_FILE_BYTES, absolute, read_bounded
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.lease import FolderLease, here, is_held
from facetrack_cli.run_folder.manifest import NAME, Manifest, as_line, note_failure, recover_interrupted
from facetrack_cli.runs.clip import run
from facetrack_cli.runs.plan import Job, Outcome, Report, resolve, silent
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import cores, share_threads, side_by_side
from facetrack_cli.start.precompile import precompiling
from facetrack_cli.trajectory.reader import is_there
from facetrack_cli.video import images
from facetrack_cli.video.source import check_local, is_clip, is_image

LOOK_S: Final = 0.5  # between two looks whether a clip of somebody else is free
RETRIES: Final = 2  # of a clip on a cluster that is not itself at fault
ANSWER_S = 30.0  # for a scheduler to answer
ANSWER_LOOK_S = 0.1  # between two looks at the clips that are out
STOP_S = 30.0  # for clips on a cluster that are told to end, to close their files


def variant_name(recipe: str, settings: Sequence[str]) -> str:
    """A recipe's name with the settings that are changed, as in `face-filter.particles=500`."""
    suffix = ",".join("".join(c if c.isalnum() or c in ".=_+" else "-" for c in text.strip()) for text in settings)
    return f"{recipe}-{suffix}" if suffix else recipe


def folders(clips: Sequence[Path], recipe: str) -> list[str]:
    """A folder name for the results of each clip, `<clip>-<recipe>`; no two are the same.

    Clips of one name are told apart by the folders in which they lie; in one folder, by their suffix.
    """
    names, groups = [title(clip) for clip in clips], defaultdict[str, list[int]](list)
    for i, name in enumerate(names):
        groups[name.casefold()].append(i)
    for group in (group for group in groups.values() if len(group) > 1):
        places = [absolute(clips[i]) for i in group]
        levels, beside = zip(*(place.parts[:-2] for place in places), strict=False), [each.parent for each in places]
        above = len([*itertools.takewhile(lambda level: len({*level}) == 1, levels)])  # none on two drives
        for i, place in zip(group, places, strict=True):
            last = place.name.replace(".", "-") if beside.count(place.parent) > 1 else names[i]
            names[i] = "-".join([*place.parts[max(above, 1) : -1], last])
    taken: set[str] = set()
    for i, name in enumerate(names):
        free = (f"{name}-{n}" if n > 1 else name for n in itertools.count(1))
        names[i] = next(each for each in free if each.casefold() not in taken)
        taken.add(names[i].casefold())
    return [f"{name}-{recipe}" for name in names]


def title(clip: Path) -> str:
    """What a clip is called: a file's name without its suffix; the name of a folder, also where `*.png` follows it."""
    full = absolute(clip)
    if full.is_dir():
        return full.name
    return full.parent.name if "*" in full.name and not full.exists() else full.stem


def check_all(jobs: Sequence[Job]) -> tuple[list[Outcome], list[Job]]:
    """What became of the jobs that are done already, have failed before, or cannot work; and the others."""
    decided: list[Outcome] = []
    left: list[Job] = []
    for job in jobs:
        try:
            outcome = resolve(job).ended()
        except FacetrackError as e:
            outcome = Outcome(source=job.clip, failure=as_line(e))
        if outcome is None:
            left.append(job)
        else:
            decided.append(outcome)
    return decided, left


def run_batch(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[Outcome]:
    """Run `jobs`, `workers` at a time in processes of this machine; as `run_shared`."""
    return run_shared(jobs, partial(_turn, workers=workers, stop=stop, progress=progress), stop, progress)


def run_shared(
    jobs: Sequence[Job], turn: Callable[[Sequence[Job]], Iterator[tuple[Job, Outcome]]], stop: Stop, progress: Progress
) -> Iterator[Outcome]:
    """Run `jobs` by `turn`; each outcome is yielded as it ends. A job that fails does not stop the others.

    Clips that another facetrack is tracking come last: they are waited for, and tracked if nobody does any more. Once
    `stop` says so, the clips at work close their files and the others are not begun.
    """
    left, busy, said = list(jobs), list[Job](), False
    while (left or busy) and not stop():
        for job, outcome in turn(left):
            if isinstance(outcome.failure, BusyError):
                busy.append(job)
            else:
                yield outcome
        if busy and not said and not stop():
            said = True
            clips, them = ("1 clip is", "it") if len(busy) == 1 else (f"{len(busy)} clips are", "them")
            progress.say(f"{clips} being tracked by another facetrack; waiting for {them}")
        free: list[Job] = []
        while busy and not free and not stop():
            for job in busy:
                if job.out is not None:
                    recover_interrupted(job.out, stop)  # a claim that is stale is ended
            free = [job for job in busy if job.out is None or not is_held(job.out)]
            time.sleep(0 if free else LOOK_S)
        busy = [job for job in busy if job not in free]
        decided, left = check_all(free)
        yield from decided


def _turn(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[tuple[Job, Outcome]]:
    workers = min(workers, len(jobs))
    if workers <= 1:
        for i, job in enumerate(jobs, 1):
            if stop():
                return
            share_threads(job.threads)
            progress.begin(f"[{i}/{len(jobs)}] {job.clip.name}", "frames", None)
            yield job, attempt(job, stop, progress.update, progress.looked)
        return
    progress.begin(f"{len(jobs)} clips", "clips", len(jobs))
    with precompiling(to_dict(jobs[0].recipe), cores()) as compile_all:  # or each of the workers would compile them
        compile_all(stop, progress.looked)
    began, finished = time.monotonic(), 0

    def report(frames: int) -> None:
        progress.update(finished, len(jobs), frames / (time.monotonic() - began))

    results = side_by_side(jobs, attempt, workers, stop, report, threads=jobs[0].threads)
    for i, result in results:
        finished += 1
        yield jobs[i], outcome_of_crash(jobs[i], result) if isinstance(result, Exception) else result


def outcome_of_crash(job: Job, error: Exception) -> Outcome:
    """What becomes of a clip whose process ended by itself."""
    frames, asked = 0, ""
    with contextlib.suppress(FacetrackError):
        plan = resolve(job)  # which ends what it has left
        frames, asked = 0 if plan.previous is None else plan.previous.frames, plan.asked
    kept = f"the frames that it had tracked are kept ({frames})" if frames else "nothing was kept"
    error_line = FacetrackError(f"{job.clip}: {error}; {kept}")
    if job.out is not None and job.batch:
        with contextlib.suppress(FacetrackError), FolderLease(job.out) as lease:
            note_failure(lease, job.out, Manifest(asked=asked, host=here()[0]), job.clip, error_line)
    return Outcome(source=job.clip, failure=error_line)


def attempt(job: Job, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Run a job; its error is in the outcome, as one line."""
    with about(job.clip.name):
        try:
            outcome = run(job, stop, report, looked)
        except Exception as e:
            outcome = Outcome(source=job.clip, failure=e)
        outcome.failure = outcome.failure and as_line(outcome.failure)
    return outcome


# --- on a cluster of Dask --------------------------------------------------------------------------------------------


def run_cluster(jobs: Sequence[Job], address: str, stop: Stop, progress: Progress) -> Iterator[Outcome]:
    """Run `jobs` on the workers of the scheduler at an address; as `run_shared`.

    Once `stop` says so, the clips at work close their files as far as they can within `STOP_S`. Raises UsageError if no
    scheduler answers.
    """
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our lines say what matters
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except OSError as e:
        said = f"no scheduler of Dask answers at {address} within {ANSWER_S:.0f} s"
        raise UsageError(f"--cluster: {said} ({reason(e)}); start one with `dask scheduler`, or take -j") from e
    try:
        if not client.nthreads():
            progress.say(f"facetrack: the scheduler at {address} has no worker; waiting for one")
        yield from run_shared(jobs, partial(_cluster_turn, client, stop, progress), stop, progress)
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=ANSWER_S)


def _cluster_turn(client: Any, stop: Stop, progress: Progress, jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
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
            threading.Thread(target=_tell, args=(client, batch), daemon=True).start()  # nobody waits for who hangs
        for future, job in [(future, job) for future, job in out.items() if future.done()]:
            outcome = _outcome(job, future, killed)
            left = outcome is None or (outcome.stopped is not None and outcome.failure is None)  # by its worker
            if left and not stop():
                if client.status != "running":
                    break
                begun = outcome is not None and outcome.paths  # what is there is of this batch
                again = replace(job, overwrite=False) if begun else job
                out[submit(again)] = again
            elif outcome is not None:
                ended, frames = ended + 1, frames + outcome.frames
                yield job, outcome
            del out[future]
        progress.update(ended, len(jobs), frames / (time.monotonic() - began))
        time.sleep(ANSWER_LOOK_S)
    for job in () if stop() else out.values():
        gone = "not tracked, as the scheduler is gone; the same command again goes on"
        yield job, Outcome(source=job.clip, failure=FacetrackError(f"{job.clip}: {gone}"))


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
    """Let the workers end the clips of this batch."""
    with contextlib.suppress(Exception):
        client.run(_end, batch, on_error="ignore")


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
    if outcome.failure is not None and not isinstance(outcome.failure, InputError | BusyError) and not stop():
        raise outcome.failure
    return outcome


def address_of(where: str) -> str:
    """The address of a scheduler, which may stand in a file. UsageError for what is neither, and without Dask."""
    if os.name != "posix":
        raise UsageError("--cluster is for Linux and macOS; take -j")
    with needed("workers of --cluster", "distributed", "cluster"):
        import distributed  # noqa: F401
    if re.fullmatch(r"(tcp|tls)://[^\s/]+:\d{1,5}", where):
        return where
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        if isinstance(address := json.loads(read_bounded(Path(where), what="scheduler file"))["address"], str):
            return address
    forms = "give tcp://HOST:PORT, or the scheduler file of `dask scheduler --scheduler-file`"
    raise UsageError(f"--cluster {where}: names no scheduler; {forms}")


# --- what a command line names ----------------------------------------------------------------------------------------


def expand(inputs: Sequence[Path]) -> tuple[list[Path], bool]:
    """The clips of the inputs of a command line, each once, in their order.

    And whether they are several: more than one, or whatever a folder, glob or list holds. InputError for a list that
    cannot be read, and a folder, glob or list without clips; UsageError for several images.
    """
    listed = [clip for path in inputs for clip in _listed(path)]
    groups = [_clips(path) for path in listed]
    found = {absolute(clip): clip for group in groups for clip in group}
    clips = list(found.values())
    single = [clip for clip in clips if is_image(clip) and images.listing(clip) is None and images.pages(clip) == 1]
    if len(single) > 1:
        folder = f"{single[0].parent}{os.sep}"
        raise UsageError(f"{single[0]} and {len(single) - 1} more are single images; give their folder, {folder}")
    plain = len(inputs) == len(listed) and groups == [[path] for path in inputs]
    return clips, len(clips) > 1 or not plain


def _listed(path: Path) -> list[Path]:
    """What a list names, `@list.txt` or `@-`; anything else is itself, also a file whose name begins so."""
    if not str(path).startswith("@") or is_there(path):
        return [path]
    name, is_pipe = str(path)[1:], str(path) == "@-"
    try:
        data = sys.stdin.buffer.read(MAX_FILE_BYTES) if is_pipe else read_bounded(Path(name), what="list")
    except OSError as e:
        raise InputError(f"{name}: cannot be read as a list of clips: {reason(e)}; check the name") from e
    lines = [line.rstrip("\r") for line in os.fsdecode(data.removeprefix(b"\xef\xbb\xbf")).split("\n")]
    clips = [Path(line) for line in lines if line.strip() and not line.startswith("#")]
    if b"\0" in data or not clips:
        raise InputError(f"{'standard input' if is_pipe else name}: names no clip; a list has a path a line")
    return clips


def _clips(path: Path) -> list[Path]:
    """The clips that one input is."""
    check_local(path)
    try:
        if path.is_dir():
            if (path / NAME).exists():
                raise InputError(f"{path}: is the folder of a run; name the clip that was tracked")
            below = _sorted(sub for sub in path.iterdir() if not sub.name.startswith(".") and sub.is_dir())
            return _of_folder(path) or [clip for folder in below for clip in _of_folder(folder)] or [path]
        if re.search(r"[*?\[]", str(path)) and not is_there(path):
            matches = _sorted(Path(name) for name in glob.glob(str(path), recursive=True))  # noqa: PTH207 -- any parts
            if not matches:
                raise InputError(f"{path}: matches no file; check the name")
            videos = [match for match in matches if not match.is_dir() and not is_image(match)]
            inside = [match for match in matches if match.is_dir()]
            return videos + [clip for folder in inside for clip in _of_folder(folder)] if videos or inside else [path]
    except OSError as e:
        raise from_system(e) or InputError(f"{e.filename or path}: {reason(e)}; check the permissions") from e
    return [path]


def _of_folder(folder: Path) -> list[Path]:
    """The clips right in a folder: it itself, its videos without the images beside them, or none, as of a run."""
    if (folder / NAME).exists():
        return []
    names = [name for name in os.listdir(folder) if not name.startswith(".")]  # noqa: PTH208 -- of many, fast
    paths = [folder / name for name in names]
    if videos := _sorted(filter(is_clip, paths)):
        return videos
    return [folder] if any(path.suffix.lower() in images.SUFFIXES and path.is_file() for path in paths) else []


def _sorted(paths: Iterable[Path]) -> list[Path]:
    return sorted(paths, key=lambda path: images.natural_key(str(path)))
