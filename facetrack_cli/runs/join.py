"""The rows of a clip from those of its pieces, which are read one after the other: memory is that of two of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.errors import ExitCode, FacetrackError, InputError
from facetrack_cli.core.types import Frame
from facetrack_cli.run_folder.manifest import read_manifest
from facetrack_cli.run_folder.recovery import read_run
from facetrack_cli.runs.job import Job, Outcome, Report, silent
from facetrack_cli.runs.pipeline import decoded_ahead
from facetrack_cli.runs.plan import FILE, Plan, read_plan
from facetrack_cli.runs.recording import ClipFacts, Recorder
from facetrack_cli.runs.seams import Seam, meet, renamed
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.runs.verdict import Watch
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded

PIECES: Final = "pieces"
TABLE: Final = "trajectory.json"


def folder_of(out: Path, piece: int) -> Path:
    return out / PIECES / f"{piece:05d}"


@dataclass(frozen=True)
class _Part:
    """What is taken of one piece: frames [first, stop), its targets under other `names`, those `marked` begin there."""

    table: Path
    first: int
    stop: int
    names: Mapping[str, str]
    marked: frozenset[str]

    def rows(self) -> Trajectory:
        rows = renamed(read_run(self.table), self.names).between(self.first, self.stop)
        marked = [i for i, (target, _) in enumerate(rows.names) if target in self.marked]
        begins = (rows.frame == self.first) & np.isin(rows.which, marked) & (rows.status == "tracked")
        return replace(rows, status=np.where(begins, "init", rows.status))


class _Survey:
    """What the pieces hold, and how each meets the one before."""

    def __init__(self, job: Job, plan: Plan) -> None:
        assert job.out is not None and job.split is not None
        self.parts: list[_Part] = []
        self.pieces: list[dict[str, object]] = []
        self.seams: list[Seam] = []
        self.failed: list[str] = []
        self.complete, self.variable = True, None if plan.cuts[-1][1] else False
        self._clip, self._why = str(job.clip), ""
        self._warnings: dict[str, None] = {}
        self._about: list[str] = []
        matched, taken = job.faces == "all" and not job.recipe.followed, set[str]()
        end, before = plan.start.frame, None
        for i, (first, _) in enumerate(plan.cuts):
            folder = folder_of(job.out, i)
            rows = self._read(folder, first)
            if rows is None:
                continue
            begins = int(rows.frames[0])
            names, marked = {name: name for name in rows.targets}, frozenset[str]()
            if before is not None and job.split.starts == "detect":
                seam, names, marked = meet(before, rows, taken, matched=matched)
                begins = seam.frame
                if not seam.agrees:
                    marked = frozenset(names.values())
                self.seams.append(seam)
                self.parts[-1] = replace(self.parts[-1], stop=min(self.parts[-1].stop, begins))
                self._say(seam)
            self._gap(end if not self.parts else self.parts[-1].stop, begins)
            end = int(rows.frames[-1]) + 1
            self.parts.append(_Part(folder / TABLE, begins, end, names, marked))
            taken |= {*names.values()}
            # what a piece after one that failed may still have in common
            before = renamed(rows.between(plan.cuts[min(i + 1, len(plan.cuts) - 1)][0], end), names)
        if not self.parts:
            raise InputError(f"{self._clip}: no piece has rows: {self._why}")
        if self.pieces[-1]["frames"] == 0:
            self._gap(end, plan.cuts[-1][1])

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self._warnings, *self._about)

    def _read(self, folder: Path, first: int) -> Trajectory | None:
        """The rows of a piece; None if it has none, which is said."""
        known, name = read_manifest(folder), f"{PIECES}/{folder.name}"
        why = "was not tracked" if known is None else known.error or known.stopped
        if known is None or (why is not None and (known.files or known.exit_code != ExitCode.INPUT)):
            self.failed.append(f"{name}: {why}")
        if known is None or not known.files:
            self.complete, self._why = False, str(why)
            self.pieces.append({"first": first, "frames": 0, "error": why})
            return None
        rows = read_run(folder / TABLE)
        self.pieces.append({"first": int(rows.frames[0]), "frames": len(rows.frames)})
        self._warnings |= dict.fromkeys(rows.header.get("warnings", ()))
        self.complete &= bool(rows.header.get("complete")) and why is None
        self.variable = self.variable or rows.header.get("variable_fps")
        return rows

    def _say(self, seam: Seam) -> None:
        if seam.agreement is not None and not seam.agrees:
            share = f"they agree in {100 * seam.agreement:.0f} % of the frames that both have"
            self._about.append(f"{self._clip}: two pieces differ where they meet at frame {seam.frame}: {share}")

    def _gap(self, end: int, begins: int | None) -> None:
        if begins is not None and end >= begins:
            return
        self.complete = False
        until = "on" if begins is None else f"to {begins - 1}"
        why, self._why = f" ({self._why})" if self._why else "", ""
        self._about.append(f"{self._clip}: no rows of frames {end} {until}{why}")


def join(job: Job, out: Recorder, stop: Stop, report: Report = silent) -> Outcome:
    """Join the pieces of a clip, which are there, into `out`. A piece that failed leaves a gap, which is said.

    Raises InputError if no piece has rows. Once `stop` says so nothing is written.
    """
    assert job.out is not None and job.split is not None
    plan = read_plan(job.out / PIECES / FILE)[1]
    found = _Survey(job, plan)
    # no detector: it has looked at the pieces as they were tracked
    watch = out.state.watch = replace(Watch.of(job.recipe, plan.start), detector=None)
    out.outcome.note = plan.start.note
    last = found.parts[-1].stop
    more: dict[str, object] = {"split": job.split.record(), "pieces": found.pieces}
    if found.seams:
        more["seams"] = [seam.record() for seam in found.seams]

    def written() -> Iterator[Trajectory]:
        for part in found.parts:
            rows = part.rows()
            if not out.outcome.frames:
                declared = {name: rows.header[name] for name in ("diagnostics",) if name in rows.header}
                out.begin(ClipFacts.of(job.clip, source), plan.start, {**declared, **more})
            if stop():
                raise StoppedError
            out.write_rows(rows)
            for frame in rows.frames.tolist():
                watch.take(rows.at(frame))
            report(out.outcome.frames, None)
            yield rows

    def shown(frames: Iterator[Frame]) -> Iterator[FrameResult]:
        chunk = next(chunks)
        for frame in frames:
            while frame.index > chunk.frames[-1] and (following := next(chunks, None)) is not None:
                chunk = following
            yield FrameResult(frame, recorded(frame.index, chunk.at(frame.index)))

    with replace(job, stop=last).open(plan.start.frame) as source:
        chunks = written()
        with contextlib.suppress(StoppedError):
            if job.video:
                with decoded_ahead(iter(source), threaded=job.threads > 1, stopped=stop) as frames:
                    for result in shown(frames):
                        out.paint(result)
            for _ in chunks:
                pass
        if stop():
            return Outcome(clip=job.clip, stopped=stop.reason)
        error = None if not found.failed else FacetrackError(f"{job.clip}: {found.failed[0]}{_more(found.failed)}")
        return out.close(error=error, complete=found.complete, warnings=found.warnings, variable_fps=found.variable)


def _more(failed: Sequence[str]) -> str:
    again = "the same command with --retry-failed tries again"
    return f"; {again}" if len(failed) == 1 else f" (and {len(failed) - 1} more pieces failed); {again}"
