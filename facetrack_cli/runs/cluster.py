"""Several clips on the workers of a Dask cluster, which carries command lines one way and exit codes back, no more.

What is done is what the folders of the clips say: an answer is only a reason to look there. A clip that fails is tried
again on another worker, unless it is the clip itself that is at fault.
"""

from __future__ import annotations

import contextlib
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from facetrack_cli import __version__
from facetrack_cli.core.claims import LOCK, Claim, holder
from facetrack_cli.core.errors import BusyError, ExitCode, FacetrackError, InputError, OutputError, reason
from facetrack_cli.core.files import absolute
from facetrack_cli.runs.again import previous
from facetrack_cli.runs.failures import note_failure
from facetrack_cli.runs.guard import GRACE_S, FailedError
from facetrack_cli.runs.job import Job, Outcome, finished
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.scheduler import ANSWER_S, LOOK_S, Scheduler
from facetrack_cli.runs.signals import Stop
from facetrack_cli.trajectory.killed import recover
from facetrack_cli.trajectory.manifest import NAME, Manifest

if TYPE_CHECKING:
    from distributed import Future

DISK_S = 5.0  # between two looks at the folders of clips that are out
SILENT_S = 90.0  # without a sign of life, after which a clip is taken to hang
UNSEEN_S = 60.0  # until what a worker wrote shows here too
STOP_S = 30.0  # for clips that are told to end, to close their files
TRIES = 3


def run_cluster(
    jobs: Sequence[Job], where: str, options: Sequence[str], stop: Stop, progress: Progress
) -> Iterator[Outcome]:
    """Run `jobs` on the cluster `where`; each is yielded as it ends. `options` are those of the command line for all.

    One that fails does not stop the others. Once `stop` says so, those at work close their files, as far as they can
    within `STOP_S`, and the rest are not begun. Raises UsageError if no scheduler answers.
    """
    began, ended, frames = time.monotonic(), 0, 0
    progress.begin(f"{len(jobs)} clips", "clips", len(jobs))
    with contextlib.closing(Scheduler(where, progress, stop)) as scheduler:
        scheduler.connect(ANSWER_S)
        for outcome in _Batch(jobs, options, scheduler, stop, progress.say).outcomes():
            if outcome is None:
                progress.update(ended, len(jobs), frames / (time.monotonic() - began))
            else:
                ended, frames = ended + 1, frames + outcome.frames * (outcome.again is None)
                yield outcome


@dataclass(eq=False)
class _Clip:
    """A clip, and how far it has come."""

    job: Job
    smooth: bool
    seen: tuple[int, int] | None = None  # its run.json that is not that of a finished run
    tries: int = 0
    workers: set[str] = field(default_factory=set)  # on which it failed
    later: float = 0.0  # not to be sent before
    key: str = ""
    future: Future[None] | None = None
    answered: float | None = None  # since when it is done, if that shows on the disk
    left: tuple[int, int] | None = None  # the claim that was there before
    beat: tuple[int, int] | None = None  # the last sign of life, and when it was seen
    heard: float = 0.0
    told: bool = False
    suspect: bool = False  # it, or one beside it, ended workers
    error: FacetrackError | None = None  # with which it is given up
    log: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.job.overwrite:  # what is there is of an earlier run
            self.seen = _stamp(self.folder / NAME)

    @property
    def folder(self) -> Path:
        assert self.job.out is not None
        return self.job.out

    def finished(self) -> Manifest | None:
        """What the disk says of it, once it is finished."""
        stamp = _stamp(self.folder / NAME)
        if stamp is None or stamp == self.seen:
            return None
        known = finished(replace(self.job, overwrite=False))
        if known is None or known.smoothed < self.smooth:
            self.seen = stamp
            return None
        return known

    def silent_s(self) -> float:
        """For how long it has given no sign of life; 0 for one that has not begun."""
        beat, now = _stamp(self.folder / LOCK), time.monotonic()
        if beat != self.beat:
            self.beat, self.heard = beat, now
        return now - self.heard if beat not in (None, self.left) else 0.0

    def outcome(self, known: Manifest | None, error: Exception | None = None) -> Outcome:
        """Its outcome of this batch, with what there is on the disk."""
        if known is None:
            return Outcome(self.job.clip, error=error)
        found = Outcome.of(self.job, known)
        found.error = error or found.error
        found.again, found.stopped = None, known.stopped if error is None else None
        found.frames_per_s = known.frames / known.seconds if known.seconds else 0.0
        found.warnings = tuple(line for line in known.warnings if line != str(found.error))
        return found


class _Batch:
    """Clips that wait, and clips that are out."""

    def __init__(
        self,
        jobs: Sequence[Job],
        options: Sequence[str],
        scheduler: Scheduler,
        stop: Stop,
        say: Callable[[str], None],
    ) -> None:
        smooth = "--smooth" in options
        self._waiting = deque(_Clip(job, smooth) for job in jobs)
        self._out: list[_Clip] = []
        self._options, self._scheduler, self._stop, self._say = options, scheduler, stop, say
        self._id = secrets.token_hex(4)

    def outcomes(self) -> Iterator[Outcome | None]:
        """The outcome of each clip as it ends, and None in between."""
        looked = time.monotonic()
        while (self._waiting or self._out) and not self._stop():
            if not self._scheduler.lives() and not self._return():
                break
            yield from self._send()
            on_disk = time.monotonic() - looked >= DISK_S
            looked = time.monotonic() if on_disk else looked
            for clip in list(self._out):
                found = self._answer(clip) or (self._look(clip) if on_disk else None)
                if found is not None:
                    yield found
            yield None
            time.sleep(LOOK_S)
        yield from self._end()

    def _send(self) -> Iterator[Outcome]:
        """Send clips that wait, as many as there is room for; those that are finished have their outcome at once."""
        room = self._scheduler.room() - len(self._out)
        for _ in range(len(self._waiting)):
            if room <= 0 or self._stop() or any(clip.suspect for clip in self._out):
                return
            clip = self._waiting.popleft()
            if (known := clip.finished()) is not None:
                yield clip.outcome(known) if clip.key else Outcome.of(clip.job, known)
            elif clip.later > time.monotonic() or self._is_held(clip) or self._is_not_alone(clip):
                self._waiting.append(clip)
            else:
                clip.key = f"facetrack-{self._id}-{secrets.token_hex(8)}"
                clip.left, clip.beat, clip.told = _stamp(clip.folder / LOCK), None, False
                clip.future = self._scheduler.submit(clip.key, self._words(clip.job), clip.workers)
                self._out.append(clip)
                room -= 1

    def _is_held(self, clip: _Clip) -> bool:
        """Whether another process writes into its folder: another batch, or what a worker left that was just killed."""
        if holder(clip.folder) is None:
            return False
        clip.later = time.monotonic() + DISK_S
        return True

    def _is_not_alone(self, clip: _Clip) -> bool:
        """Whether it would have others beside it, though it may end their worker."""
        return clip.suspect and bool(self._out or not all(one.suspect for one in self._waiting))

    def _words(self, job: Job) -> list[str]:
        options = [word for word in self._options if job.fps is not None or not word.startswith("--fps=")]
        clip = absolute(job.clip) if str(job.clip).startswith("@") else job.clip  # not a list here
        return [*options, f"--out={job.out}", "--", str(clip)]

    def _answer(self, clip: _Clip) -> Outcome | None:
        """The outcome of a clip that is out, if it was answered and is settled; one to be sent again waits again."""
        if clip.error is not None:
            return self._given_up(clip)
        future = clip.future
        if future is None or future.status == "pending":
            return self._shown(clip) if clip.answered is not None else None
        clip.future, error = None, None
        if future.status == "finished":
            clip.answered = time.monotonic()
            return self._shown(clip)
        if future.status == "error":
            with contextlib.suppress(Exception):  # the scheduler is gone, too
                error = future.exception(timeout=ANSWER_S)
        if error is None:  # lost or cancelled
            self._again(clip)
            return None
        if (known := clip.finished()) is not None:
            self._out.remove(clip)
            return clip.outcome(known)
        return self._failed(clip, error)

    def _shown(self, clip: _Clip) -> Outcome | None:
        """The outcome of a clip that is done, as soon as that shows here."""
        assert clip.answered is not None
        known = clip.finished()
        if known is None and time.monotonic() - clip.answered < UNSEEN_S:
            return None
        self._out.remove(clip)
        if known is not None:
            return clip.outcome(known)
        said = f"{clip.job.clip}: was tracked, but {clip.folder} does not show it here as the batch asks for it"
        return Outcome(
            clip.job.clip,
            error=FacetrackError(f"{said}; all machines must see the same folders, recipe and files"),
        )

    def _look(self, clip: _Clip) -> Outcome | None:
        """What the disk says of a clip without an answer: that it is finished, or that it hangs."""
        if clip.future is None:
            return None
        if (known := clip.finished()) is not None:  # the worker may hang, or be gone
            self._scheduler.tell([clip.key])
            self._out.remove(clip)
            return clip.outcome(known)
        if clip.silent_s() < SILENT_S:
            return None
        if clip.told:
            return self._failed(clip, TimeoutError(f"no sign of life for {2 * SILENT_S:.0f} s"))
        clip.told, clip.beat = True, None  # time for its worker to end it, and to say so
        self._scheduler.tell([clip.key], at_once=True)
        return None

    def _failed(self, clip: _Clip, error: BaseException | None) -> Outcome | None:
        """Try a clip again, or give it up."""
        from distributed import KilledWorker

        code, where = None, "a worker"
        if isinstance(error, FailedError):
            code, where = error.code, f"{error.host} ({error.worker})"
            clip.workers.add(error.worker)
            said = error.line()
        elif isinstance(error, KilledWorker):  # Dask suspects all that the worker was to do
            if not clip.suspect:
                clip.suspect = True
                self._again(clip)
                return None
            code, said = ExitCode.INPUT, "it ended worker after worker, as by taking all of the memory"
        elif isinstance(error, ModuleNotFoundError):
            said = f"{reason(error)}; install facetrack {__version__} there, as it is here"
        else:
            said = f"{type(error).__name__}: {error}"
        if code == ExitCode.USAGE and self._is_held(clip):
            self._again(clip)
            return None
        clip.tries += 1
        if code != ExitCode.INPUT and clip.tries < TRIES:
            self._say(f"facetrack: warning: {clip.job.clip}: failed on {where} and is tried again: {said}")
            self._again(clip)
            return None
        if code != ExitCode.INPUT:
            said = f"{said}; tried {clip.tries} times, at last on {where}"
        clip.error = (InputError if code == ExitCode.INPUT else FacetrackError)(said)
        clip.log, clip.future = error.lines if isinstance(error, FailedError) else (), None
        clip.later = time.monotonic() + 2 * GRACE_S
        return self._given_up(clip)

    def _given_up(self, clip: _Clip) -> Outcome | None:
        """The outcome of a clip that has failed, once its folder says so; what it left at work may still be there."""
        assert clip.error is not None
        try:
            with Claim(clip.folder) as claim:
                recover(clip.folder, claim)
                if clip.job.batch:
                    note_failure(clip.job, clip.error, clip.log)
        except OutputError as e:  # the error of the clip is worth more
            if isinstance(e, BusyError) and time.monotonic() < clip.later:
                return None
        self._out.remove(clip)
        return clip.outcome(previous(clip.job), clip.error)

    def _again(self, clip: _Clip) -> None:
        """Let a clip that is out wait again, first of all."""
        self._out.remove(clip)
        clip.future, clip.answered = None, None
        self._waiting.appendleft(clip)

    def _return(self) -> bool:
        """Wait for a scheduler that is gone, and send all again that is not finished; whether it came back."""
        for clip in list(self._out):
            self._again(clip)
        return self._scheduler.connect_again()

    def _end(self) -> Iterator[Outcome]:
        """Tell clips that are out to end, and wait until they have; without a scheduler all of them have failed."""
        if not self._stop():
            for clip in (*self._out, *self._waiting):
                known = clip.finished()
                gone = FacetrackError(f"{clip.job.clip}: not tracked, as the scheduler did not come back")
                yield clip.outcome(known, None if known else gone)
            return
        self._scheduler.tell([clip.key for clip in self._out])
        began = time.monotonic()
        while self._out and time.monotonic() - began < STOP_S and self._scheduler.lives():
            time.sleep(LOOK_S)
            for clip in list(self._out):
                done = clip.future is None or clip.future.status != "pending"
                if done and _stamp(clip.folder / NAME) not in (None, clip.seen):
                    yield clip.outcome(previous(clip.job))
                if done or (time.monotonic() - began > 1 and holder(clip.folder) is None):
                    self._out.remove(clip)


def _stamp(path: Path) -> tuple[int, int] | None:
    """What tells a file from the one that it replaces, and from itself before it was written again."""
    with contextlib.suppress(OSError):
        found = path.stat()
        return found.st_ino, found.st_mtime_ns
    return None
