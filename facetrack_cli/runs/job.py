"""What is asked of one clip, and what became of it."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from facetrack_cli.core.errors import FacetrackError, InputError, OutputError, UsageError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.files import check_folder, check_plain
from facetrack_cli.core.types import Box
from facetrack_cli.recipe.load import default_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.run_folder.fingerprint import clip_stat, job_digest, previous_run
from facetrack_cli.run_folder.lock import LOCK, FolderLock, here
from facetrack_cli.run_folder.manifest import (
    OWNED,
    VIDEO,
    Manifest,
    commit,
    error_of,
    failed,
    read_manifest,
    recover_interrupted,
)
from facetrack_cli.runs.posterior import check_smoothing
from facetrack_cli.runs.start import Begin
from facetrack_cli.start.init_file import find_init
from facetrack_cli.trackers.people.looks import load_people
from facetrack_cli.trajectory.header import is_there
from facetrack_cli.trajectory.people import PEOPLE
from facetrack_cli.trajectory.writers import Ending, Format
from facetrack_cli.video.source import Source

MAX_LAG_BYTES: Final = 1 << 30  # of the frames that wait for later ones
Report: TypeAlias = Callable[..., None]  # frames done, frames in all if that is known, and what is done


def silent(*_: object) -> None:
    """Where nobody listens."""


class Split(NamedTuple):
    """How long chunks are to be, in frames or in seconds."""

    length: float
    frames: bool

    def record(self) -> dict[str, str]:
        return {"length": f"{self.length:.15g}{'f' if self.frames else 's'}"}


@dataclass(frozen=True)
class Job(Begin):
    """What is asked of one clip. `out` None streams the one format to standard output.

    `lag`: by how many frames rows come later, given the frames up to then. `posterior`: whether it is kept. `strict`:
    whether a clip that is damaged is an error, of which what was tracked is kept. `resume`: whether a run that was
    ended goes on from its last checkpoint. `batch`: whether a clip that fails has a run.json that says so; it is not
    tried again then, but with `retry_failed`. `split`: that it is tracked in chunks, whose rows are joined.
    """

    recipe: Recipe
    out: Path | None
    _: KW_ONLY
    formats: tuple[Format, ...] = ("csv", "json")
    video: bool = True
    overwrite: bool = False
    threads: int = 2
    lag: int = 0
    posterior: bool = False
    default_reason: str = ""  # why this recipe, said after the next step
    strict: bool = False
    resume: bool = True
    batch: bool = False
    retry_failed: bool = False
    split: Split | None = None
    gallery: Path | None = None  # people that a film may show

    @property
    def everyone(self) -> bool:
        """Whether everybody in a film is followed, from entry to exit, and over cuts."""
        searched = self.box is None and (self.init in DETECTORS or (self.init is None and find_init(self.clip) is None))
        return self.faces == "all" and searched and self.recipe.has_head and not self.recipe.followed

    def digest(self) -> str:
        """A digest of all that is asked for but the clip: of recipe, start, frames, options, and their files."""
        init = find_init(self.clip) if self.init is None and self.box is None else self.init
        settings = [self.box, self.init_frame, self.faces, self.start, self.stop]
        options = [str(self.fps), self.lag, self.posterior, self.formats, self.video, self.strict]
        options += [] if self.gallery is None else [str(self.gallery)]
        options += [] if self.stream is None else [f"stream {self.stream}"]
        chunks = [self.split, self.chunk] if self.split or self.chunk else []
        return job_digest(self.recipe, init, settings, options, *chunks)

    def previous(self) -> Manifest | None:
        """The run.json of an earlier run of the same job and the same clip; None if there is none."""
        return None if self.out is None else previous_run(self.out, self.digest, self.clip)


@dataclass
class Outcome(Ending):
    """What became of one clip.

    `error` ended the run early; what was tracked until then is kept. `note` says where the search for a face began it.
    `again`: the run was done before, and nothing was tracked now. `resumed`: the frame from which it went on.
    `network` says which one placed points.
    `doubtful`: whether something that was measured speaks against the track, as the `verdict` says.
    """

    clip: Path = Path()
    files: Sequence[Path] = ()
    frames_per_s: float = 0.0
    error: Exception | None = None
    streamed: bool = False
    note: str = ""
    verdict: str = ""
    doubtful: bool = False
    again: Manifest | None = None
    resumed: int | None = None
    network: str = ""

    @classmethod
    def of(cls, job: Job, known: Manifest) -> Outcome:
        """That of a run that its folder holds already."""
        assert job.out is not None
        return cls(
            frames=known.frames,
            lost_frames=known.lost_frames,
            lost_at_end=known.lost_at_end,
            complete=known.complete,
            clip=job.clip,
            files=[job.out / name for name in known.files],
            error=error_of(known) or (InputError(known.warnings[-1]) if job.strict and not known.complete else None),
            again=known,
            network=known.network,
        )

    def next_step(self) -> str:
        """The commands that show and correct what was written; "" where they could not."""
        if not self.files or not any(file.suffix in (".json", ".jsonl") for file in self.files):
            return ""
        folder = shlex.quote(str(self.files[0].parent))
        by = "people" if any(file.name == PEOPLE for file in self.files) else "fix"
        return f"look: facetrack report {folder}; correct: facetrack {by} {folder}"

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.clip}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames" if self.frames > 1 else "1 frame"]
        if self.again is not None:
            parts.insert(0, "done before")
        elif self.frames > 1 and self.frames_per_s:
            parts.append(f"{self.frames_per_s:.1f} frames/s")
        if self.network:
            parts.append(self.network)
        if self.resumed is not None:
            parts.append(f"went on from frame {self.resumed}")
        if self.lost_frames:
            parts.append(f"lost: {lost_words(self.lost_frames)}")
        if self.stopped or not self.complete:
            parts.append(self.stopped or "incomplete")
        where = "standard output" if self.streamed else "nothing"
        if self.files:
            where = f"{self.files[0].parent}{os.sep} ({', '.join(file.name for file in self.files)})"
        return f"{self.clip} -> {where}: {'; '.join(parts)}"


def lost_words(frames: Mapping[str, int]) -> str:
    """In how many frames each target/part is lost, worst first, with the name of a target once."""
    by: dict[str, dict[int, list[str]]] = {}
    for name, count in sorted(frames.items(), key=lambda one: -one[1]):
        target, _, part = name.rpartition("/")
        by.setdefault(target, {}).setdefault(count, []).append(part)
    told = (", ".join(f"{' and '.join(parts)} in {n}" for n, parts in counts.items()) for counts in by.values())
    last = 0 if not by else [*[*by.values()][-1]][-1]
    words = "; ".join(f"{target} {words}".strip() for target, words in zip(by, told, strict=True))
    return f"{words} frame{'s' * (last != 1)}"


def finished(job: Job) -> Manifest | None:
    """The run.json of a job, if nothing of its run is missing; None if the clip is to be tracked."""
    known = None if job.overwrite else job.previous()
    return known if known is not None and _is_whole(job, known) else None


def _is_whole(job: Job, known: Manifest) -> bool:
    named = not job.everyone or job.chunk or PEOPLE in known.files
    return is_tracked(known) and named and (VIDEO in known.files or not job.video)


def is_tracked(known: Manifest) -> bool:
    """Whether a run came to its end, named or not."""
    return known.error is None and known.stopped is None


def ended(job: Job) -> Outcome | None:
    """What became of a job that is done, or, in a batch, has failed; None if the clip is to be tracked."""
    known = None if job.overwrite else job.previous()
    if known is None:
        return None
    failed_before = known.error is not None and job.batch and not job.retry_failed
    return Outcome.of(job, known) if failed_before or _is_whole(job, known) else None


def note_failure(
    job: Job, lock: FolderLock, error: Exception, log: Sequence[str] = (), begun: Manifest | None = None
) -> None:
    """Write into run.json of a folder that its clip failed; what was tracked of it stays.

    Nothing is written where the error is one of writing, and over results that are whole or of something else.
    `log`: the last lines of a process that died. `begun` is what is known of the run.
    """
    if job.out is None or isinstance(error, OutputError):
        return
    with contextlib.suppress(FacetrackError, OSError):  # the error itself is worth more
        known, there = job.previous(), read_manifest(job.out)
        if known is not None and known.files and known.stopped is None:
            return
        is_failure = there is not None and there.is_failure
        if known is None and not is_failure and any((job.out / name).exists() for name in OWNED):
            return
        begun = begun or Manifest(asked=job.digest(), host=here()[0])
        known = known if known is not None and known.files else replace(begun, clip=clip_stat(job.clip))
        commit(lock, job.out, [], failed(known, error, log))


def default_reason(box: Box | None) -> str:
    """Why a run that names no recipe took its own, and how to find others."""
    why = "for whatever is in a --box" if box is not None else "for a face and its features, where no --box is given"
    name = default_recipe(box=box is not None)
    return f"; recipe {name} is the default {why}, others: facetrack recipes"


def check(job: Job, *, kept: bool = False, locked: bool = False) -> None:
    """Refuse what cannot work before anything is opened: results in the way, an output that is the input.

    `kept`: without a folder the rows stay in memory, and do not go to standard output. `locked`: the folder's lock is
    ours, so that nobody else writes there.
    """
    if job.faces == "all" and job.recipe.later:
        who = f"recipe {job.recipe.name} follows the hands of one person"
        raise UsageError(f"--faces all: {who}; leave it out, and choose the signer with --box X,Y,W,H")
    if job.everyone and (job.lag or job.posterior):
        raise UsageError(
            "--faces all follows people over cuts, and no row is smoothed over a cut; leave one of them out"
        )
    if job.everyone and job.out is None and not kept:
        raise UsageError("--faces all knows who is who at the end, and -o - writes as it goes; name a folder")
    if job.gallery is not None and not job.everyone:
        raise UsageError(f"--gallery: {job.clip} has a start, and people are named where faces are searched for")
    if job.gallery is not None:
        load_people(job.gallery)
    if job.lag or job.posterior:
        check_smoothing(job.recipe)
    if job.out is not None:
        if job.chunk:
            check_plain(job.out)
        there = None
        if is_there(job.out):
            recover_interrupted(job.out)
            there = read_manifest(job.out)
        # what is cut short is replaced, and what failed
        overwrite = job.overwrite or job.previous() is not None or (there is not None and there.is_failure)
        init = job.init if isinstance(job.init, Path) else None
        inputs = (job.clip, init, job.recipe.path)
        try:
            check_folder(job.out, OWNED, overwrite=overwrite, inputs=inputs)
        except OutputError:  # another facetrack may have written the same results since, or be writing them
            if locked or not (is_there(job.out / LOCK) or job.previous() is not None):
                raise
            check_folder(job.out, OWNED, overwrite=True, inputs=inputs)


def check_lag(job: Job, source: Source) -> None:
    """Refuse a lag whose frames, which are all kept, take too much memory."""
    of_frame = 3 * source.size[0] * source.size[1]
    if job.lag * of_frame > MAX_LAG_BYTES:
        most = f"at most --lag {MAX_LAG_BYTES // of_frame} at {source.size[0]}x{source.size[1]}"
        raise UsageError(f"{job.clip}: {job.lag} frames of this size take too much memory; {most}, or take --smooth")
