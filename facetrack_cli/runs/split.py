"""One long clip in chunks that are tracked side by side, by one process or several, and joined once all are done.

A chunk is a run of some frames of the clip, in a folder of its own. Chunks overlap, and begin at keyframes where there
are some about the wished place. In each but the first a detector looks for the face.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import InputError, OutputError, UsageError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.files import check_plain
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Array, Start, Whole
from facetrack_cli.run_folder.fingerprint import clip_stat
from facetrack_cli.runs.batch import check_all, run_batch
from facetrack_cli.runs.job import Job, Outcome, Split, check, ended
from facetrack_cli.runs.people import film_start
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.stitch import CHUNKS, Plan, folder_of, read_plan
from facetrack_cli.trackers.face.detectors import check_parts, detector
from facetrack_cli.video.decode import read_index
from facetrack_cli.video.source import FolderSource

OVERLAP_S: Final = 5.0  # of two chunks


def run_chunks(
    job: Job, workers: int, stop: Stop, progress: Progress, shard: tuple[int, int] = (1, 1)
) -> Iterator[tuple[str, Outcome]]:
    """Track the chunks that are not done, `workers` at a time; each is yielded with its name, the clip last, with "".

    Of `shard` (I, N) every N-th chunk, from the I-th on; the clip is joined by the process that finds all chunks ended.
    Raises UsageError where it cannot be split, OutputError where the chunks of another split are in its folder.
    """
    if (known := ended(job)) is not None:
        yield "", known
        return
    chunks = chunks_of(job, _planned(job, stop, progress))
    decided, left = check_all(chunks[shard[0] - 1 :: shard[1]])
    for outcome in chain(decided, run_batch(left, min(workers, len(left)), stop, progress)):
        yield CHUNKS, outcome
    if stop():
        return
    over = [ended(replace(one, overwrite=False, retry_failed=False)) is not None for one in chunks]
    waiting = over.count(False) if shard[1] > 1 else 0
    if waiting:
        progress.say(f"{job.clip}: {waiting} of {len(chunks)} chunks are not done; who ends the last one joins them")
        return
    for outcome in run_batch([job], 1, stop, progress):
        yield "", outcome


def chunks_of(job: Job, plan: Plan) -> list[Job]:
    """What is asked of each chunk."""
    assert job.out is not None and job.split is not None
    by = next((name for name in DETECTORS if name in (job.init, plan.start.origin)), None)
    by = by or next(name for name in DETECTORS if name == detector().name)
    found = []
    for i, (first, stop) in enumerate(plan.cuts):
        search = job.everyone or i > 0
        where: dict[str, Any] = {"init": by if search else plan.start, "box": None, "init_frame": None}
        where |= {"start": first if search else plan.start.frame, "stop": stop, "chunk": True}
        alone: dict[str, Any] = {"split": None, "formats": ("json",), "video": False, "strict": False, "batch": True}
        found.append(replace(job, out=folder_of(job.out, i), **where, **alone))
    return found


def _planned(job: Job, stop: Stop, progress: Progress) -> Plan:
    """How the clip is cut: as the file beside its chunks says, which is written if there is none."""
    assert job.out is not None and job.split is not None
    check(job)
    clip, folder = clip_stat(job.clip), job.out / CHUNKS
    check_plain(folder)
    # the chunks are the same whatever is made of them
    of_chunks = replace(job, formats=(), video=False, strict=False).digest()
    key = hashlib.sha256(dumps([of_chunks, clip and (clip.bytes, clip.changed_ns)]).encode()).hexdigest()
    if clip is not None and folder.is_dir():
        with suppress(InputError):
            if (plan := read_plan(job.out)).key == key:
                return plan
        if not job.overwrite:
            other = "holds chunks of another --split, recipe, start or clip"
            raise OutputError(f"{folder}: {other}; replace them with --overwrite, or name another --out")
        shutil.rmtree(folder, ignore_errors=True)
    progress.begin(f"{job.clip.name}: looking where it can be cut")
    if job.everyone:
        start = film_start(job.first)
    else:
        start = job.find(job.recipe, stopped=stop, looked=progress.looked)
        _check_detector(job, start)
    times, keys = _frames(job, start, stop, progress)
    cuts = cut_by_length(start.frame, times, job.split, keys, str(job.clip))
    Plan.of(key, start, [*cuts[:-1], (cuts[-1][0], job.stop)]).write(job.out)
    return read_plan(job.out)  # as others read it


def _check_detector(job: Job, start: Start) -> None:
    """UsageError where a detector cannot begin what the clip's start begins."""
    fix = "or leave --split out"
    if start.corrections:
        raise UsageError(f"{start.origin}: has corrections, which --split does not follow; leave --split out")
    if not job.recipe.points and not job.recipe.followed and start.origin not in DETECTORS:
        what = f"{job.recipe.name} follows what is in the box of {start.origin}"
        raise UsageError(f"{job.clip}: {what}, which no detector finds again; begin with --init haar, {fix}")
    if len(start.targets) > 1 and not job.recipe.followed and job.faces != "all":
        raise UsageError(f"{start.origin}: has {len(start.targets)} targets, and the search takes one; add --faces all")
    try:
        check_parts(job.recipe.points)
    except InputError as e:
        raise UsageError(f"{job.clip}: --split: {e}; {fix}") from None


def _frames(job: Job, start: Start, stop: Stop, progress: Progress) -> tuple[Array, Whole]:
    """The times (T,) of the clip's frames up to --stop, in s, and the keyframes (M,), as far as they are known."""
    with job.open(start.frame) as source:
        claimed = None if source.frames_hint is None else start.frame + source.frames_hint
        count, fps = len(source.files) if isinstance(source, FolderSource) else claimed, float(source.fps)
    if not isinstance(source, FolderSource):
        index = read_index(job.clip, stop, job.stream)
        if stop():
            raise InputError(f"{job.clip}: stopped before it was cut")
        if index is not None:
            return index.times[: job.stop], index.keys
        progress.say(f"{job.clip}: its frames cannot be sought: every chunk decodes the clip from its start")
    if count is None:
        raise UsageError(f"{job.clip}: does not say how long it is; convert it to MP4, or leave --split out")
    return np.arange(count)[: job.stop] / fps, np.zeros(0, np.int64)


def cut_by_length(
    first: int, times: Array, split: Split, keys: Sequence[int] | Whole, clip: str
) -> list[tuple[int, int]]:
    """[first, stop) of chunks of the frames from `first` to the last of `times` (T,), in s; each overlaps the next.

    A chunk begins at the last of `keys` before the wished place, if that is not half a chunk away.
    """
    end, steps = len(times), np.diff(times[first:])
    overlap = OVERLAP_S
    if split.frames and len(steps):
        overlap /= float(np.median(steps))
    if split.length < 2 * overlap:
        least = f"{round(2 * overlap)}f" if split.frames else f"{2 * overlap:g}s"
        raise UsageError(f"{clip}: chunks overlap by {OVERLAP_S:g} s; give --split {least} or more")
    clock = np.arange(end, dtype=np.float64) if split.frames else times
    begins, sought = [first], np.asarray(keys, np.int64)
    while True:
        wished = clock[begins[-1]] + split.length
        at = int(np.searchsorted(clock, wished))
        if at >= end or clock[-1] - wished < 2 * overlap:
            break
        half = int(np.searchsorted(clock, wished - split.length / 2))
        near = sought[(sought >= half) & (sought <= at)]
        begins.append(int(near[-1]) if len(near) else at)
    stops = [min(int(np.searchsorted(times, times[begin] + OVERLAP_S)), end) for begin in begins[1:]]
    return list(zip(begins, [*stops, end], strict=True))
