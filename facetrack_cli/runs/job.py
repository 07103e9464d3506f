"""What is asked of one clip, and what became of it."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.files import check_folder
from facetrack_cli.core.types import Box
from facetrack_cli.recipe.files import default_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.again import previous
from facetrack_cli.runs.failures import code_of, is_failure
from facetrack_cli.runs.plan import Split
from facetrack_cli.runs.posterior import check_smoothing
from facetrack_cli.runs.start import Begin
from facetrack_cli.trajectory.diagnostics import EVIDENCE
from facetrack_cli.trajectory.header import is_there
from facetrack_cli.trajectory.killed import settle
from facetrack_cli.trajectory.manifest import OWNED, Manifest, read_manifest
from facetrack_cli.trajectory.trajectory import FrameResult
from facetrack_cli.trajectory.writers import Format
from facetrack_cli.video.source import Source

VIDEO: Final = "annotated.mp4"
LAG_BYTES: Final = 1 << 30  # of the frames that wait for later ones
Report: TypeAlias = Callable[[int, "int | None"], None]  # frames done, frames in all if that is known


def silent(done: int, total: int | None) -> None:
    """Where nobody listens."""


@dataclass(frozen=True)
class Job(Begin):
    """What is asked of one clip. `out` None streams the one format to standard output.

    `lag`: by how many frames rows come later, given the frames up to then. `posterior`: whether it is kept. `strict`:
    whether a clip that is damaged is an error, of which what was tracked is kept. `resume`: whether a run that was
    ended goes on from its last checkpoint. `batch`: whether a clip that fails has a run.json that says so; it is not
    tried again then, but with `retry_failed`. `split`: that it is tracked in pieces, of which the rows are joined.
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
    why: str = ""  # why this recipe, said after the next step
    strict: bool = False
    resume: bool = True
    batch: bool = False
    retry_failed: bool = False
    split: Split | None = None


@dataclass
class Outcome:
    """What became of one clip. `lost` counts the lost frames of each part; `lost_at_end` are those lost in the last.

    `evidence` sums up each target's.
    `error` ended the run early; what was tracked until then is kept. `note` says where the search for a face began it.
    """

    clip: Path
    files: Sequence[Path] = ()
    frames: int = 0
    frames_per_s: float = 0.0
    lost: dict[str, int] = field(default_factory=dict)
    lost_at_end: tuple[str, ...] = ()
    evidence: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    complete: bool = True
    stopped: str | None = None
    error: Exception | None = None
    streamed: bool = False
    note: str = ""
    verdict: str = ""  # what it comes to
    doubtful: bool = False  # whether something measured speaks against the track
    again: Manifest | None = None  # the run was done before: nothing was tracked now
    resumed: int | None = None  # the frame from which it went on

    @classmethod
    def of(cls, job: Job, known: Manifest) -> Outcome:
        """That of a run that its folder holds already."""
        assert job.out is not None
        error = code_of(known)(known.error) if known.error is not None else None
        return cls(
            job.clip,
            files=[job.out / name for name in known.files],
            frames=known.frames,
            lost=known.lost_frames,
            lost_at_end=known.lost_at_end,
            complete=known.complete,
            error=error or (InputError(known.warnings[-1]) if job.strict and not known.complete else None),
            again=known,
        )

    def count(self, result: FrameResult) -> None:
        """Take in one more frame."""
        rows = result.rows
        self.frames += 1
        self.lost_at_end = tuple("/".join(rows.names[i]) for i in rows.which[rows.status == "lost"].tolist())
        for part in self.lost_at_end:
            self.lost[part] = self.lost.get(part, 0) + 1
        for target, found in rows.diagnostics.items():
            if np.isfinite(nats := found.get(EVIDENCE.name)).all():
                self.evidence[target] = self.evidence.get(target, 0.0) + float(nats.sum())

    def next_step(self) -> str:
        """The commands that show and correct what was written; "" where they could not."""
        if not self.files or not any(file.suffix in (".json", ".jsonl") for file in self.files):
            return ""
        folder = shlex.quote(str(self.files[0].parent))
        return f"look: facetrack report {folder}; correct: facetrack fix {folder}"

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.clip}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames" if self.frames > 1 else "1 frame"]
        if self.again is not None:
            parts.insert(0, "done before")
        elif self.frames > 1:
            parts.append(f"{self.frames_per_s:.1f} frames/s")
        if self.resumed is not None:
            parts.append(f"went on from frame {self.resumed}")
        if self.lost:
            parts.append("lost: " + ", ".join(f"{part} in {n}" for part, n in self.lost.items()))
        if self.stopped or not self.complete:
            parts.append(self.stopped or "incomplete")
        where = "standard output" if self.streamed else "nothing"
        if self.files:
            where = f"{self.files[0].parent}{os.sep} ({', '.join(file.name for file in self.files)})"
        return f"{self.clip} -> {where}: {'; '.join(parts)}"


def finished(job: Job) -> Manifest | None:
    """What the folder of a job holds of it, if nothing is missing; None if the clip is to be tracked."""
    known = None if job.overwrite else previous(job)
    return known if known is not None and _is_whole(job, known) else None


def _is_whole(job: Job, known: Manifest) -> bool:
    return known.error is None and known.stopped is None and (VIDEO in known.files or not job.video)


def ended(job: Job) -> Outcome | None:
    """What became of a job that is done, or, in a batch, has failed; None if the clip is to be tracked."""
    known = None if job.overwrite else previous(job)
    if known is None:
        return None
    failed = known.error is not None and job.batch and not job.retry_failed
    return Outcome.of(job, known) if failed or _is_whole(job, known) else None


def default_reason(box: Box | None, clip: Path) -> str:
    """Why a run that names no recipe took its own, and how to find others."""
    why = "for whatever is in a --box" if box is not None else "for a face and its features, where no --box is given"
    said = "" if box is None else f" --box {','.join(f'{value:g}' for value in box)}"
    name = default_recipe(box=box is not None)
    return f"; recipe {name} is the default {why}, others: facetrack suggest {shlex.quote(str(clip))}{said}"


def check(job: Job) -> None:
    """Refuse what cannot work before anything is opened: results in the way, an output that is the input."""
    if job.lag or job.posterior:
        check_smoothing(job.recipe)
    if job.out is not None:
        there = is_there(job.out)
        if there:
            settle(job.out)
        # what is cut short is replaced, and what failed
        overwrite = job.overwrite or previous(job) is not None or (there and is_failure(read_manifest(job.out)))
        init = job.init if isinstance(job.init, Path) else None
        check_folder(job.out, OWNED, overwrite=overwrite, inputs=(job.clip, init, job.recipe.path))


def check_lag(job: Job, source: Source) -> None:
    """Refuse a lag whose frames, which are all kept, take too much memory."""
    of_frame = 3 * source.size[0] * source.size[1]
    if job.lag * of_frame > LAG_BYTES:
        most = f"at most --lag {LAG_BYTES // of_frame} at {source.size[0]}x{source.size[1]}"
        raise UsageError(f"{job.clip}: {job.lag} frames of this size take too much memory; {most}, or take --smooth")
