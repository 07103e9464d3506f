"""One long clip in chunks that are tracked side by side, by one process or several, and joined once all are done.

A chunk is a run of some frames of the clip, in a folder of its own. Chunks overlap. In each but the first a detector
looks for the face.

Two tracks of a target agree in a frame if the boxes around its parts overlap by half (intersection over union). Chunks
agree if every target does, in `SHARE` of the frames that both have. None of this is in the papers.
"""

import shutil
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, count, product
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import ExitCode, FacetrackError, InputError, UsageError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.files import check_plain, make_folder
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Frame, Mask, Start
from facetrack_cli.run_folder.manifest import read_manifest, read_run
from facetrack_cli.run_folder.status import CHUNKS, chunk_name
from facetrack_cli.runs.batch import check_all, run_batch
from facetrack_cli.runs.clip import RunMonitor
from facetrack_cli.runs.people import ORIGIN
from facetrack_cli.runs.plan import Job, Outcome, Plan, Report, Split, resolve, silent
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.record import ClipFacts, Recorder, Results, outputs
from facetrack_cli.runs.signals import Stop, StoppedError
from facetrack_cli.trackers.face.detectors import check_parts, detector
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded
from facetrack_cli.trajectory.views import choose, enclose

OVERLAP_S: Final = 5.0  # of two chunks
OVERLAP: Final = 0.5  # of the boxes around a target's parts
SHARE: Final = 0.8  # of the frames that both have, in which they must agree
TABLE: Final = "trajectory.json"
_SAME: Final = 0.5  # of those frames, in which tracks of several faces agree if they are of one face
Cuts: TypeAlias = list[tuple[int, int | None]]
_NOTHING: Final = np.zeros((0, 0, 3), np.uint8)  # the pixels of a frame; the video is drawn at the end


def run_chunks(
    job: Job, workers: int, stop: Stop, progress: Progress, shard: tuple[int, int] = (1, 1)
) -> Iterator[tuple[str, Outcome]]:
    """Track the chunks that are not done, `workers` at a time; each is yielded with its name, the clip last, with "".

    Of `shard` (I, N) every N-th chunk, from the I-th on; the clip is joined by the process that finds all chunks ended.
    Raises UsageError where it cannot be split, OutputError where the chunks of another split are in its folder.
    """
    whole = resolve(job)
    if (ended := whole.ended()) is not None:
        yield "", ended
        return
    progress.begin(f"{job.clip.name}: looking where it can be cut")
    try:
        start, cuts = _cut(whole, stop, progress.looked)
        chunks = _chunks_of(whole, start, cuts)
    except StoppedError:
        yield "", Outcome(source=job.clip, stopped=stop.reason)
        return
    decided, left = check_all(chunks[shard[0] - 1 :: shard[1]])
    yield from ((CHUNKS, outcome) for outcome in chain(decided, run_batch(left, workers, stop, progress)))
    if stop():
        return
    if shard[1] > 1:
        *_, waiting = check_all([replace(chunk, overwrite=False, retry_failed=False) for chunk in chunks])
        if waiting:
            others = f"{len(waiting)} of {len(chunks)} chunks are not done"
            progress.say(f"{job.clip}: {others}; who ends the last one joins them")
            return
    yield from (("", outcome) for outcome in run_batch([replace(job, found=start)], 1, stop, progress))


def _chunks_of(whole: Plan, start: Start, cuts: Cuts) -> list[Job]:
    """What is asked of each chunk; their folders are made. OutputError where the chunks of another split are there."""
    job, out = whole.job, whole.job.out
    assert out is not None
    by = next((name for name in DETECTORS if name in (job.init, start.origin)), None) or detector().name
    apart: dict[str, Any] = {"split": None, "formats": ("json",), "video": False, "strict": False, "batch": True}
    each = replace(job, box=None, init_frame=None, chunk=True, **apart)
    check_plain(out / CHUNKS)
    if job.overwrite:
        shutil.rmtree(out / CHUNKS, ignore_errors=True)
    chunks = []
    for i, (first, stop) in enumerate(cuts):
        searched = whole.everyone or i > 0
        where = {"init": by, "start": first} if searched else {"init": start, "start": start.frame}
        chunks.append(replace(each, out=out / chunk_name(i), stop=stop, **where))
        resolve(chunks[-1])
        make_folder(out / chunk_name(i))
    return chunks


def _cut(whole: Plan, stop: Stop, looked: Report) -> tuple[Start, Cuts]:
    """The start of a clip, and the frames [first, stop) of each chunk; the last stop may be None: the end.

    Raises StoppedError once `stop` says so before the start is found.
    """
    job = whole.job
    assert job.split is not None
    if whole.everyone:
        start = Start(job.first, {}, ORIGIN)
    else:
        try:
            start = job.found or job.find(job.recipe, stopped=stop, looked=looked)
        except InputError:  # no face was found until then
            if stop():
                raise StoppedError from None
            raise
        _check_detector(job, start)
    with job.open(start.frame) as source:
        if source.frames_hint is None:
            raise UsageError(f"{job.clip}: does not say how long it is; convert it to MP4, or leave --split out")
        cuts = cut_by_length(start.frame, start.frame + source.frames_hint, float(source.fps), job.split)
    return start, [*cuts[:-1], (cuts[-1][0], job.stop)]


def _check_detector(job: Job, start: Start) -> None:
    """UsageError where a detector cannot begin what the clip's start begins."""
    if start.corrections:
        raise UsageError(f"{start.origin}: has corrections, which --split does not follow; leave --split out")
    if not job.recipe.points and not job.recipe.followed and start.origin not in DETECTORS:
        what = f"{job.recipe.name} follows what is in the box of {start.origin}, which no detector finds again"
        raise UsageError(f"{job.clip}: {what}; begin with --init haar, or leave --split out")
    if len(start.targets) > 1 and not job.recipe.followed and job.faces != "all":
        raise UsageError(f"{start.origin}: has {len(start.targets)} targets, and the search takes one; add --faces all")
    check_parts(job.recipe.points)


def cut_by_length(first: int, end: int, fps: float, split: Split) -> list[tuple[int, int]]:
    """[first, stop) of chunks of the frames from `first` to before the `end`; each overlaps the next. UsageError."""
    length, overlap = round(split.length * (1 if split.frames else fps)) or 1, round(OVERLAP_S * fps)
    least = split._replace(length=2 * overlap if split.frames else 2 * OVERLAP_S)
    if split.length < least.length:
        raise UsageError(f"chunks overlap by {OVERLAP_S:g} s; give --split {least.record()['length']} or more")
    begins = [first, *range(first + length, end - 2 * overlap + 1, length)]
    return list(zip(begins, [*(begin + overlap for begin in begins[1:]), end], strict=True))


class Seam(NamedTuple):
    """Where the rows of a later chunk begin; `agreement`: the share of frames in which both agree, None without any."""

    frame: int
    agreement: float | None
    agrees: bool


def stitch(
    earlier: Trajectory, later: Trajectory, taken: Collection[str], *, matched: bool
) -> tuple[Seam, dict[str, str], frozenset[str]]:
    """How the rows of two chunks are stitched, in the middle of the frames that both have.

    With the seam come the names that targets of the later chunk take, and the names of those that begin there.
    `matched`: targets have the names of those that they agree with, others a name that is not `taken`; else names stay.
    """
    both = np.intersect1d(earlier.frames, later.frames)
    if not len(both):
        names = _named(later, {}, taken) if matched else {name: name for name in later.targets}
        return Seam(int(later.frames[0]), None, False), names, frozenset(names.values())
    a, b = (rows.between(int(both[0]), int(both[-1]) + 1) for rows in (earlier, later))
    shares: dict[tuple[str, str], float] = {}
    for ours, theirs in product(a.targets, b.targets):
        if matched or ours == theirs:
            fine = agreeing(choose(a, ours), choose(b, theirs))
            shares[ours, theirs] = float(fine.mean()) if len(fine) else 0.0
    pairs: dict[str, str] = {}
    for (ours, theirs), share in sorted(shares.items(), key=lambda pair: -pair[1]):
        if ours not in pairs.values() and theirs not in pairs and (share >= _SAME or not matched):
            pairs[theirs] = ours
    agreements = {ours: shares[ours, theirs] for theirs, ours in pairs.items()}
    # of several faces one that is lost all the while may have left
    there = [name for name in a.targets if not matched or (choose(a, name).status != "lost").any()]
    agreement = min((agreements.get(name, 0.0) for name in there), default=0.0)
    names = _named(later, pairs, taken)
    seam = Seam(int(both[len(both) // 2]), round(agreement, 4), agreement >= SHARE)
    return seam, names, frozenset(names[name] for name in later.targets if name not in pairs)


def renamed(rows: Trajectory, names: Mapping[str, str]) -> Trajectory:
    """The rows, each target under its name in `names`."""
    diagnostics = {names[target]: reported for target, reported in rows.diagnostics.items()}
    return replace(rows, names=tuple((names[target], part) for target, part in rows.names), diagnostics=diagnostics)


def agreeing(ours: Trajectory, theirs: Trajectory) -> Mask:
    """(T,) whether two tracks of one target agree, of the T frames of both in which either shows it."""
    frames = np.intersect1d(ours.frames, theirs.frames)
    # a part without a window is one pixel
    sized = (replace(own, w=np.nan_to_num(own.w, nan=1.0), h=np.nan_to_num(own.h, nan=1.0)) for own in (ours, theirs))
    a, b = (enclose(rows.take(np.isin(rows.frame, frames)).parts) for rows in sized)
    shown = np.isfinite(a.x), np.isfinite(b.x)
    return np.asarray((shown[0] & shown[1] & (iou(a.boxes, b.boxes) >= OVERLAP))[shown[0] | shown[1]])


def _named(later: Trajectory, pairs: Mapping[str, str], taken: Collection[str]) -> dict[str, str]:
    """What the targets of a later chunk are called: as the target that they are, else by a name that no target has."""
    names, used = dict(pairs), {*taken, *pairs.values()}
    for target in later.targets:
        if target not in names:
            stem = target.rstrip("0123456789").rstrip("_")
            free = (name for i in count(1) if (name := f"{stem}_{i}" if i > 1 else stem) not in used)
            names[target] = next(free)
            used.add(names[target])
    return names


class _Part(NamedTuple):
    """The rows that one chunk gives: frames [first, stop). Targets get new `names`; those `marked` start at `first`."""

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


@dataclass
class _Survey:
    """What the chunks of a clip hold: the `parts` that its rows are made of, and the seams between them.

    `end`: the frame after the last one that was tracked. `failed` has a line for each chunk that was not tracked to its
    end.
    """

    end: int
    variable: bool | None
    parts: list[_Part] = field(default_factory=list)
    chunks: list[dict[str, object]] = field(default_factory=list)
    seams: list[Seam] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    warnings: dict[str, None] = field(default_factory=dict)
    complete: bool = True


def _survey(whole: Plan, begins_at: int, cuts: Cuts) -> _Survey:
    """What the chunks hold; at most two of them are in memory at a time. Raises InputError if none has rows."""
    job, everyone, stop = whole.job, whole.everyone, begins_at  # up to which there are rows so far
    assert job.out is not None
    survey = _Survey(stop, None if cuts[-1][1] else False)
    matched, taken = job.faces == "all" and not job.recipe.followed, set[str]()
    before, why = None, ""

    def note_gap(begin: int | None) -> None:
        if not everyone and (begin is None or stop < begin):  # of a film a frame may show nobody
            survey.complete, until = False, "on" if begin is None else f"to {begin - 1}"
            survey.warnings[f"{job.clip}: no rows of frames {stop} {until}{f' ({why})' if why else ''}"] = None

    for i, (first, _) in enumerate(cuts):
        run = read_manifest(folder := job.out / chunk_name(i))
        ended = "was not tracked" if run is None else run.error or run.stopped
        if run is None or (ended is not None and (run.files or run.exit_code != ExitCode.INPUT)):
            survey.failed.append(f"{CHUNKS}/{folder.name}: {ended}")
        if run is None or not run.files:
            survey.complete, why = False, str(ended)
            survey.chunks.append({"first": first, "frames": 0, "error": ended})
            continue
        survey.end = first + run.frames
        with (folder / TABLE).open("rb") as table:
            shows = not everyone or any(line.startswith(b'{"frame":') for line in table)
        if not shows:
            why = "it shows nobody"
            survey.chunks.append({"first": first, "frames": run.frames})
            continue
        rows = read_run(folder / TABLE)
        survey.chunks.append({"first": int(rows.frames[0]), "frames": len(rows.frames)})
        survey.warnings |= dict.fromkeys(rows.header.get("warnings", ()))
        survey.complete &= bool(rows.header.get("complete")) and ended is None
        survey.variable = survey.variable or rows.header.get("variable_fps")
        begins = first if everyone else int(rows.frames[0])
        names, marked = {name: name for name in rows.targets}, frozenset[str]()
        if before is not None:
            seam, names, marked = stitch(before, rows, taken, matched=matched)
            begins = seam.frame
            if not seam.agrees:
                marked = frozenset(names.values())
                if seam.agreement is not None:
                    share = f"they agree in {100 * seam.agreement:.0f} % of the frames that both have"
                    differ = f"{job.clip}: two chunks differ where they meet at frame {seam.frame}: {share}"
                    survey.warnings[differ] = None
            survey.seams.append(seam)
            stop = min(stop, begins)
            survey.parts[-1] = survey.parts[-1]._replace(stop=stop)
        note_gap(begins)
        stop, why = int(rows.frames[-1]) + 1, ""
        survey.parts.append(_Part(folder / TABLE, begins, stop, names, marked))
        taken |= {*names.values()}
        # what a chunk after one that failed may still have in common
        before = renamed(rows.between(cuts[min(i + 1, len(cuts) - 1)][0], stop), names)
    if not survey.parts:
        raise InputError(f"{job.clip}: no chunk has rows: {why}")
    if why:
        note_gap(cuts[-1][1])
    return survey


def join_chunks(into: Recorder, stop: Stop, report: Report) -> Outcome:
    """Join the chunks of a clip, which are there. A chunk that failed leaves a gap. Nothing is written once `stop`.

    Raises InputError if no chunk has rows.
    """
    plan, job = into.plan, into.plan.job
    assert job.out is not None and job.split is not None
    start, cuts = _cut(plan, stop, silent)
    survey, error = _survey(plan, start.frame, cuts), None
    if survey.failed:
        more = f" (and {len(survey.failed) - 1} more chunks failed)" if len(survey.failed) > 1 else ""
        again = "the same command with --retry-failed tries again"
        error = FacetrackError(f"{job.clip}: {survey.failed[0]}{more}; {again}")
    first = survey.parts[0].rows()
    about = {name: first.header[name] for name in ("diagnostics",) if name in first.header}
    about |= {"split": job.split.record(), "chunks": survey.chunks}
    about |= {"seams": [seam._asdict() for seam in survey.seams]} if survey.seams else {}
    with job.open(start.frame) as source:
        clip = ClipFacts.of(job.clip, source)._replace(frames_hint=None)

    def joined() -> Results:
        rows, later = first, iter(survey.parts[1:])
        for index in range(start.frame, survey.end):
            if stop():
                raise StoppedError
            while index > rows.frames[-1] and (part := next(later, None)) is not None:
                rows = part.rows()
            yield FrameResult(Frame(index, 0.0, _NOTHING), recorded(index, rows.at(index)))

    def ended(done: Outcome, whole: bool) -> None:
        done.complete, done.variable_fps, done.failure = survey.complete, survey.variable, error
        done.warnings = tuple(survey.warnings)

    monitor = RunMonitor.of(job.recipe, start)
    monitor.detector = None  # it has looked at the chunks as they were tracked
    into.open([*outputs(into), monitor])
    into.outcome.note = start.note
    into.ended = ended
    done = into.record(clip, start, about, joined(), report)
    done.frames_per_s = 0.0  # rows were joined, not tracked
    return done
