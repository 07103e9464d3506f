"""The rows of a clip from those of its chunks: where two chunks meet, whether they agree, and whose rows are taken.

Two tracks of a target agree in a frame if its boxes overlap by half (intersection over union), and its points are, in
the mean, apart by at most half the distance between the eyes; of faces whose eyes are not followed half the largest
distance between two points, of a single point half the width of its window. Chunks agree if every target does, in
`SHARE` of the frames that both have. None of this is in the papers.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from facetrack_cli.core.errors import ExitCode, FacetrackError, InputError
from facetrack_cli.core.files import make_folder, read_bounded, write_new
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import BOX, Array, Frame, Mask, Start
from facetrack_cli.run_folder.manifest import read_manifest, read_run
from facetrack_cli.runs.job import Job, Outcome, Report, silent
from facetrack_cli.runs.pipeline import decoded_ahead
from facetrack_cli.runs.recording import ClipFacts, Recorder
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.runs.verdict import Watch
from facetrack_cli.trajectory.header import StartRecord, to_record
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded

OVERLAP: Final = 0.5  # of boxes, intersection over union
APART: Final = 0.5  # mean distance of points, in sizes of their shape
SHARE: Final = 0.8  # of the frames that both have, in which they must agree
CHUNKS: Final = "chunks"  # the folder of them, in that of the run
PLAN: Final = "plan.json"
TABLE: Final = "trajectory.json"
_SAME: Final = 0.5  # of those frames, in which tracks of several faces agree if they are of one face
_EYES: Final = ("eye_left", "eye_right")


class Plan(BaseModel):
    """The start of a clip, and its `cuts`, the frames [first, stop) of each chunk; the last stop may be None: the end.

    `key` tells what was asked.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    key: str
    origin: str
    note: str
    record: dict[str, Any]
    cuts: tuple[tuple[int, int | None], ...]

    @classmethod
    def of(cls, key: str, start: Start, cuts: Sequence[tuple[int, int | None]]) -> Plan:
        return cls(key=key, origin=start.origin, note=start.note, record=to_record(start), cuts=tuple(cuts))

    @property
    def start(self) -> Start:
        return replace(StartRecord.model_validate(self.record).start_from(self.origin), note=self.note)

    def write(self, out: Path) -> None:
        """Write it beside the chunks of a run. Raises OutputError."""
        path = out / CHUNKS / PLAN
        make_folder(path.parent)
        write_new(path, self.model_dump_json().encode(), overwrite=True)


def read_plan(out: Path) -> Plan:
    """The plan of a run's folder. Raises InputError."""
    path = out / CHUNKS / PLAN
    try:
        return Plan.model_validate_json(read_bounded(path))
    except (OSError, ValidationError) as e:
        raise InputError(f"{path}: is not as facetrack run --split writes it; give --overwrite") from e


def folder_of(out: Path, chunk: int) -> Path:
    return out / CHUNKS / f"{chunk:05d}"


def has_rows(table: Path) -> bool:
    """Whether a trajectory in JSON has a frame."""
    with table.open("rb") as file:
        return any(line.startswith(b'{"frame":') for line in file)


class Seam(NamedTuple):
    """Where the rows of a later chunk begin; `agreement`: the share of frames in which both agree, None without any."""

    frame: int
    agreement: float | None
    agrees: bool

    def record(self) -> dict[str, Any]:
        return self._asdict() | {"agreement": None if self.agreement is None else round(self.agreement, 4)}


class Stitch(NamedTuple):
    """A seam; `names` are those that targets of the later chunk take, `begun` the targets that begin there."""

    seam: Seam
    names: dict[str, str]
    begun: frozenset[str]


def stitch(earlier: Trajectory, later: Trajectory, taken: Collection[str], *, matched: bool) -> Stitch:
    """How the rows of two chunks are stitched, in the middle of the frames that both have.

    `matched`: targets have the names of those that they agree with, others a name that is not `taken`; else names stay.
    """
    both = np.intersect1d(earlier.frames, later.frames)
    if not len(both):
        names = _named(later, {}, taken) if matched else {name: name for name in later.targets}
        return Stitch(Seam(int(later.frames[0]), None, False), names, frozenset(names.values()))
    first, stop = int(both[0]), int(both[-1]) + 1
    a, b = earlier.between(first, stop), later.between(first, stop)
    shares: dict[tuple[str, str], float] = {}
    for ours in a.targets:
        for theirs in b.targets:
            if matched or ours == theirs:
                fine = agreeing(choose(a, ours), choose(b, theirs))
                shares[ours, theirs] = float(fine.mean()) if len(fine) else 0.0
    pairs: dict[str, str] = {}
    for (ours, theirs), share in sorted(shares.items(), key=lambda one: -one[1]):
        if ours not in pairs.values() and theirs not in pairs and (share >= _SAME or not matched):
            pairs[theirs] = ours
    found = {ours: shares[ours, theirs] for theirs, ours in pairs.items()}
    # of several faces one that is lost all the while may have left
    there = [name for name in a.targets if not matched or (choose(a, name).status != "lost").any()]
    agreement = min((found.get(name, 0.0) for name in there), default=0.0)
    names = _named(later, pairs, taken)
    seam = Seam(int(both[len(both) // 2]), agreement, agreement >= SHARE)
    return Stitch(seam, names, frozenset(names[name] for name in later.targets if name not in pairs))


def renamed(rows: Trajectory, names: Mapping[str, str]) -> Trajectory:
    """The rows, each target under its name in `names`."""
    diagnostics = {names[target]: one for target, one in rows.diagnostics.items()}
    return replace(rows, names=tuple((names[target], part) for target, part in rows.names), diagnostics=diagnostics)


def agreeing(ours: Trajectory, theirs: Trajectory) -> Mask:
    """(T,) whether two tracks of one target agree, of the T frames of both in which either shows a part that both have.

    A part that one of them alone shows is in another place.
    """
    frames = np.intersect1d(ours.frames, theirs.frames)
    fine, known = np.ones(len(frames), bool), np.zeros(len(frames), bool)
    points: list[tuple[str, Trajectory]] = []
    apart: list[Array] = []
    for one in ours.parts:
        if (other := next((part for part in theirs.parts if part.part == one.part), None)) is None:
            continue
        a, b = one.take(np.isin(one.frame, frames)), other.take(np.isin(other.frame, frames))
        shown = np.isfinite(a.x), np.isfinite(b.x)
        known |= shown[0] | shown[1]
        fine &= shown[0] == shown[1]
        if one.part == BOX:
            fine &= ~(iou(a.boxes, b.boxes) < OVERLAP)
        else:
            points.append((one.part, a))
            apart.append(np.hypot(a.x - b.x, a.y - b.y))
    if points:
        distance = np.stack(apart)
        many = np.isfinite(distance).sum(axis=0)
        mean = np.nansum(distance, axis=0) / np.maximum(many, 1)
        fine &= ~(mean > APART * _size(points))
    found: Mask = fine[known]
    return found


def _size(points: list[tuple[str, Trajectory]]) -> Array:
    """(T,) the size of a shape in pixels; nan where it is not known."""
    places = {part: np.stack([rows.x, rows.y], axis=1) for part, rows in points}
    if all(eye in places for eye in _EYES):
        return np.asarray(np.hypot(*(places[_EYES[0]] - places[_EYES[1]]).T))
    if len(points) == 1:
        return points[0][1].w
    each = np.stack([*places.values()])
    between = np.hypot(*np.moveaxis(each[:, None] - each[None], -1, 0))
    return np.asarray(np.fmax.reduce(between, axis=(0, 1)))


def _named(later: Trajectory, pairs: Mapping[str, str], taken: Collection[str]) -> dict[str, str]:
    """What the targets of a later chunk are called: as the target that they are, else by a name that no target has."""
    names, given = dict(pairs), {*taken, *pairs.values()}
    for target in later.targets:
        if target not in names:
            stem = target.rstrip("0123456789").rstrip("_")
            free = (name for i in count(1) if (name := f"{stem}_{i}" if i > 1 else stem) not in given)
            names[target] = next(free)
            given.add(names[target])
    return names


@dataclass(frozen=True)
class _Part:
    """What is taken of one chunk: frames [first, stop), its targets under other `names`; those `marked` begin there."""

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
    """What the chunks hold, and how each meets the one before. They are read one after another: memory is that of two.

    `end`: the frame after the last one. Raises InputError if no chunk has rows.
    """

    def __init__(self, job: Job, plan: Plan) -> None:
        assert job.out is not None and job.split is not None
        self.parts: list[_Part] = []
        self.chunks: list[dict[str, object]] = []
        self.seams: list[Seam] = []
        self.failed: list[str] = []
        self.complete, self.variable = True, None if plan.cuts[-1][1] else False
        self._clip, self._why, self._everyone, self.end = str(job.clip), "", job.everyone, plan.start.frame
        self._warnings: dict[str, None] = {}  # of the chunks, then of their seams
        said: list[str] = []
        matched, taken = job.faces == "all" and not job.recipe.followed, set[str]()
        end, before = plan.start.frame, None
        for i, (first, _) in enumerate(plan.cuts):
            folder = folder_of(job.out, i)
            rows = self._read(folder, first)
            if rows is None:
                continue
            begins = first if job.everyone else int(rows.frames[0])
            names, marked = {name: name for name in rows.targets}, frozenset[str]()
            if before is not None:
                seam, names, marked = stitch(before, rows, taken, matched=matched)
                begins = seam.frame
                if not seam.agrees:
                    marked = frozenset(names.values())
                    if seam.agreement is not None:
                        share = f"they agree in {100 * seam.agreement:.0f} % of the frames that both have"
                        said.append(f"{self._clip}: two chunks differ where they meet at frame {seam.frame}: {share}")
                self.seams.append(seam)
                self.parts[-1] = replace(self.parts[-1], stop=min(self.parts[-1].stop, begins))
            said += [] if job.everyone else self._gap(end if not self.parts else self.parts[-1].stop, begins)
            end = int(rows.frames[-1]) + 1
            self.parts.append(_Part(folder / TABLE, begins, end, names, marked))
            taken |= {*names.values()}
            # what a chunk after one that failed may still have in common
            before = renamed(rows.between(plan.cuts[min(i + 1, len(plan.cuts) - 1)][0], end), names)
        if not self.parts:
            raise InputError(f"{self._clip}: no chunk has rows: {self._why}")
        if self.chunks[-1]["frames"] == 0 and not job.everyone:
            said += self._gap(end, plan.cuts[-1][1])
        self.warnings = (*self._warnings, *said)

    def _read(self, folder: Path, first: int) -> Trajectory | None:
        """The rows of a chunk; None if it has none."""
        known = read_manifest(folder)
        why = "was not tracked" if known is None else known.error or known.stopped
        if known is None or (why is not None and (known.files or known.exit_code != ExitCode.INPUT)):
            self.failed.append(f"{CHUNKS}/{folder.name}: {why}")
        if known is None or not known.files:
            self.complete, self._why = False, str(why)
            self.chunks.append({"first": first, "frames": 0, "error": why})
            return None
        self.end = first + known.frames
        if self._everyone and not known.lost_frames and not has_rows(folder / TABLE):
            self.chunks.append({"first": first, "frames": known.frames})
            return None
        rows = read_run(folder / TABLE)
        self.chunks.append({"first": int(rows.frames[0]), "frames": len(rows.frames)})
        self._warnings |= dict.fromkeys(rows.header.get("warnings", ()))
        self.complete &= bool(rows.header.get("complete")) and why is None
        self.variable = self.variable or rows.header.get("variable_fps")
        return rows

    def _gap(self, end: int, begins: int | None) -> list[str]:
        """A line if frames from `end` on are in no chunk; None: up to the end of the clip."""
        if begins is not None and end >= begins:
            return []
        self.complete = False
        until = "on" if begins is None else f"to {begins - 1}"
        why, self._why = f" ({self._why})" if self._why else "", ""
        return [f"{self._clip}: no rows of frames {end} {until}{why}"]


def join(job: Job, out: Recorder, stop: Stop, report: Report = silent) -> Outcome:
    """Join the chunks of a clip, which are there, into `out`. A chunk that failed leaves a gap, which is said.

    Raises InputError if no chunk has rows. Once `stop` says so nothing is written.
    """
    assert job.out is not None and job.split is not None
    plan = read_plan(job.out)
    found = _Survey(job, plan)
    # no detector: it has looked at the chunks as they were tracked
    watch = out.state.watch = replace(Watch.of(job.recipe, plan.start), detector=None)
    out.outcome.note = plan.start.note
    last = found.parts[-1].stop
    more: dict[str, object] = {"split": job.split.record(), "chunks": found.chunks}
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
        rows = next(parts)
        for frame in frames:
            while frame.index > rows.frames[-1] and (following := next(parts, None)) is not None:
                rows = following
            yield FrameResult(frame, recorded(frame.index, rows.at(frame.index)))

    with replace(job, stop=last).open(plan.start.frame) as source:
        parts = written()
        with contextlib.suppress(StoppedError):
            if job.video and not job.everyone:
                with decoded_ahead(iter(source), threaded=job.threads > 1, stopped=stop) as frames:
                    for result in shown(frames):
                        out.paint(result)
            for _ in parts:
                pass
        if stop():
            return Outcome(clip=job.clip, stopped=stop.reason)
        if job.everyone:  # also in frames that show nobody
            out.outcome.frames = found.end - plan.start.frame
        error = None if not found.failed else FacetrackError(f"{job.clip}: {found.failed[0]}{_more(found.failed)}")
        return out.close(error=error, complete=found.complete, warnings=found.warnings, variable_fps=found.variable)


def _more(failed: Sequence[str]) -> str:
    again = "the same command with --retry-failed tries again"
    return f"; {again}" if len(failed) == 1 else f" (and {len(failed) - 1} more chunks failed); {again}"
