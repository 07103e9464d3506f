"""How far the runs of a batch are, by the files in their folders; nothing is written there. And the file of a batch."""

import hashlib
import json
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.files import check_plain, make_folder, read_bounded, write_new
from facetrack_cli.core.numbers import document, places
from facetrack_cli.run_folder.lease import holder, is_held, left_in
from facetrack_cli.run_folder.manifest import NAME, Manifest, as_text, read_manifest

State: TypeAlias = Literal["done", "running", "interrupted", "failed", "not begun"]
_BATCHES: Final = "batch-????????.json"
CHUNKS: Final = "chunks"  # the folder of them, in that of a run
MAX_ROWS: Final = 20  # of the table of clips to look at
STATES: Final[tuple[State, ...]] = ("done", "running", "interrupted", "failed", "not begun")


def write_batch(out: Path, recipe: str, clips: Sequence[Path], names: Sequence[str]) -> None:
    """Write `batch-<8 hex>.json`, each clip of a batch with the name of its folder, into `out`, which is made.

    The same batch has the same name. Raises OutputError.
    """
    pairs = [(as_text(str(clip)), as_text(name)) for clip, name in zip(clips, names, strict=True)]
    record = {"format": "facetrack-batch", "version": 1, "recipe": recipe, "clips": pairs}
    data = json.dumps(record, indent=1, ensure_ascii=False).encode() + b"\n"
    path = out / f"batch-{hashlib.sha256(data).hexdigest()[:8]}.json"
    make_folder(out)
    check_plain(path)
    if not path.exists():
        write_new(path, data, overwrite=True)


def _batches(folder: Path) -> dict[str, str]:
    """The clips of the batches of a folder, by the names of their folders. Raises InputError, and OSError."""
    clips: dict[str, str] = {}
    for path in sorted(folder.glob(_BATCHES)):
        try:
            clips = {name: clip for clip, name in json.loads(read_bounded(path))["clips"]} | clips
        except (ValueError, LookupError, TypeError) as e:
            raise InputError(f"{path}: is not as facetrack run writes it; remove it, and run again") from e
    return clips


@dataclass(frozen=True)
class ClipStatus:
    """One clip: its `folder` below that of the batch, and how far it is.

    `frames` are those that are tracked, `of` those in all, where known; `lost` is the share of them in which the part
    that is lost most is lost, `doubtful` says whether something speaks against the track, `look` what to look at
    first, and `still` which frame shows it. `since` and `ended` are UTC; `error` says why it
    failed.
    """

    clip: str
    folder: str
    state: State
    frames: int = 0
    of: int | None = None
    host: str = ""
    since: str = ""
    ended: str = ""
    seconds: float | None = None
    frames_per_s: float | None = None
    complete: bool | None = None
    lost: float | None = None
    doubtful: bool = False
    look: str = ""
    still: int | None = None
    error: str | None = None
    exit_code: int | None = None


@dataclass(frozen=True)
class Status:
    """Those of a folder, in the order of its batch; `kind`: clips, or chunks of one that are not joined yet."""

    folder: Path
    clips: tuple[ClipStatus, ...]
    kind: Literal["clip", "chunk"] = "clip"

    @property
    def counts(self) -> dict[State, int]:
        counts = Counter(clip.state for clip in self.clips)
        return {state: counts[state] for state in STATES}

    @property
    def work_s(self) -> float | None:
        """Seconds that one process would take for what is left; None if nothing is done yet that would tell."""
        took = [clip.seconds for clip in self.clips if clip.state == "done" and clip.seconds is not None]
        left = sum(
            max(0.0, 1 - clip.frames / clip.of) if clip.state == "running" and clip.of else 1.0
            for clip in self.clips
            if clip.state not in ("done", "failed")
        )
        return round(left * statistics.fmean(took), 1) if took else None

    def json(self) -> str:
        fields = {"folder": as_text(str(self.folder)), "counts": self.counts, "work_s": self.work_s}
        return document("facetrack-status", {**fields, "clips": [asdict(clip) for clip in self.clips]}, indent=1)

    def lines(self) -> Iterator[str]:
        """The same in words."""
        yield f"{self.folder}: {len(self.clips)} {self.kind}{'s' * (len(self.clips) != 1)}"
        width = max(map(len, STATES))
        yield from (f"  {state:<{width}}  {n}" for state, n in self.counts.items() if n)
        yield from worst(self.clips)
        for clip in self.clips:
            if clip.state == "running":
                of = "" if clip.of is None else f" of about {clip.of}"
                rate = "" if clip.frames_per_s is None else f", {clip.frames_per_s:.1f} frames/s"
                yield f"running: {clip.clip}: on {clip.host} since {clip.since}, {clip.frames}{of} frames{rate}"
        running = self.counts["running"]
        left = len(self.clips) - self.counts["done"] - self.counts["failed"]
        again = "" if running else "; nothing is running: give the command again"
        if not left and self.kind == "chunk":
            yield "no chunk is left: give the command again, which joins them"
        elif not left:
            yield f"nothing is left{', but --retry-failed tries what failed again' if self.counts['failed'] else ''}"
        else:
            work = "" if self.work_s is None else f": about {timedelta(seconds=round(self.work_s / max(running, 1)))}"
            at = f", {running} at a time" if work and running else ""
            yield f"{left} {self.kind}{'s' * (left != 1)} left{work}{at}{again}"


def worst(clips: Sequence[ClipStatus]) -> Iterator[str]:
    """A table of the clips that failed, and of those that somebody should look at, worst first."""
    rows = sorted((clip for clip in clips if clip.look or clip.error), key=badness)
    if not rows:
        return
    width = max(len("clip"), *(len(name_of(clip)) for clip in rows[:MAX_ROWS]))
    yield f"{'clip':<{width}}  frames  lost  look at"
    for clip in rows[:MAX_ROWS]:
        lost = "–" if clip.lost is None else f"{clip.lost:.0%}"
        said = f"failed: {clip.error}" if clip.error else clip.look
        yield f"{name_of(clip):<{width}}  {clip.frames:>6}  {lost:>4}  {said}"
    if len(rows) > MAX_ROWS:
        yield f"and {len(rows) - MAX_ROWS} more; --json of facetrack status has all"


def badness(clip: ClipStatus) -> tuple[bool, bool, bool, float]:
    """A key to sort clips by: failed, incomplete, doubtful, and then those in which a part is lost most."""
    return clip.state != "failed", clip.complete is not False, not clip.doubtful, -(clip.lost or 0.0)


def name_of(clip: ClipStatus) -> str:
    return clip.folder if clip.folder != "." else Path(clip.clip).name


def survey(folder: Path) -> Status:
    """How far the runs in a batch's folder are, or a run, or its chunks before they are joined. InputError of none."""
    with reading(folder):
        if _is_run(folder):
            return Status(folder, (clip_status(folder, ".", ""),))
        if chunks := sorted(f"{CHUNKS}/{path.name}" for path in (folder / CHUNKS).glob("?????")):
            return Status(folder, tuple(clip_status(folder / name, name, name) for name in chunks), "chunk")
        named = _batches(folder)
        below = folder.iterdir() if folder.is_dir() else ()
        there = sorted(sub.name for sub in below if sub.name not in named and sub.is_dir() and _is_run(sub))
    if not named and not there:
        raise InputError(f"{folder}: holds no results of facetrack run; name the folder that --out named")
    named |= dict.fromkeys(map(as_text, there), "")
    return Status(folder, tuple(clip_status(folder / name, name, clip) for name, clip in named.items()))


def is_batch(folder: Path) -> bool:
    """Whether a folder holds the runs of a batch, and is not that of a run."""
    return not _is_run(folder) and any(folder.glob(_BATCHES))


def chunk_name(chunk: int) -> str:
    """The folder of a chunk, in that of the run."""
    return f"{CHUNKS}/{chunk:05d}"


def _is_run(folder: Path) -> bool:
    return (folder / NAME).is_file() or is_held(folder)


def clip_status(folder: Path, name: str, clip: str) -> ClipStatus:
    """How far the run in a `folder` is, which has this `name` in its batch."""
    try:
        run = read_manifest(folder)
    except InputError as e:
        return ClipStatus(clip or name, name, "failed", error=str(e), exit_code=int(e.exit_code))
    note = holder(folder)
    if note is not None or run is None:
        left: Mapping[str, Any] = left_in(folder) if note is None else note
        clip = clip or as_text(str(left.get("clip", name)))
        if note is None:  # what is left is of a process that is gone
            return ClipStatus(clip, name, "interrupted" if is_held(folder) else "not begun")
        numbers = (note.get(key) for key in ("frame", "frames", "seconds"))
        done, of, seconds = (number if isinstance(number, int | float) else None for number in numbers)
        rate = round(done / seconds, 2) if done and seconds else None
        host, since = str(note.get("host", "a machine")), str(note.get("began", ""))
        frames, total = int(done or 0), None if of is None else int(of)
        return ClipStatus(clip, name, "running", frames, total, host, since, seconds=seconds, frames_per_s=rate)
    state: State = "failed" if run.error is not None else "done" if run.stopped is None else "interrupted"
    tracked, took = run.frames - run.resumed, run.seconds
    lost, look = _worst_part(run)
    first, last = max(run.look, key=lambda span: span[1] - span[0], default=(None, None))
    members = ("frames", "host", "ended", "seconds", "complete", "error", "exit_code")
    return ClipStatus(
        clip=clip or (run.clip.path if run.clip is not None else name),
        folder=name,
        state=state,
        since=run.began,
        frames_per_s=round(tracked / took, 2) if tracked and took else None,
        lost=lost,
        doubtful=bool(run.doubts),
        look=look if state == "done" else "",
        still=None if first is None or last is None else (first + last) // 2,
        **{name: getattr(run, name) for name in members},
    )


def _worst_part(run: Manifest) -> tuple[float | None, str]:
    """The share of frames in which the part that is lost most is lost, and what to look at first."""
    if not run.frames:
        return None, ""
    part, frames = max(run.lost_frames.items(), key=lambda item: item[1], default=("", 0))
    part = part.replace("/", " ")
    lines = [*run.warnings[:1]] if run.warnings else [run.doubts] if run.doubts else []
    if frames:
        at_end = " and at the end" if run.lost_at_end else ""
        lines.append(f"{part} is lost in {frames}{at_end}, frames {places(sorted(run.look))}")
    elif lines and run.look:
        lines.append(f"frames {places(run.look)}")
    return round(frames / run.frames, 4), "; ".join(lines)
