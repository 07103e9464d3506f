"""What is asked of one clip, resolved once against the files that are there: where its tracks begin, and whether it is
done; and what became of it.
"""

import hashlib
import math
import os
import shlex
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from fractions import Fraction
from functools import partial
from itertools import islice
from numbers import Integral
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias, get_args

import numpy as np

from facetrack_cli.core import __version__
from facetrack_cli.core.errors import ExitCode, FacetrackError, InputError, UsageError
from facetrack_cli.core.face_points import DETECTORS, HANDS, DetectorName
from facetrack_cli.core.files import check_folder, check_plain
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Box, Frame, Point, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.spaces import box_of
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.run_folder import manifest
from facetrack_cli.run_folder.lease import is_held
from facetrack_cli.runs.signals import never
from facetrack_cli.start.assembly import name_targets, tracker_for
from facetrack_cli.start.init_file import check_start, find_init, read_init
from facetrack_cli.start.search import Faces, box_start, search_start
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.people.descriptor import load_people
from facetrack_cli.trajectory.reader import PEOPLE, to_record
from facetrack_cli.trajectory.trajectory import SEEN, FrameResult, Trajectory
from facetrack_cli.trajectory.writers import FORMATS, Format, by_frame
from facetrack_cli.video.source import Source, open_source

SIGNS_FRAMES: Final = 50  # in which hands are looked at, where a recipe follows those of one of several faces
MIN_MOVED, MOVES_MORE = 2.0, 2.0  # sizes of its face; and times as far as the hands of the largest face
MOST_NAMED: Final = 4  # of the parts that are lost, the worst ones
Report: TypeAlias = Callable[..., None]  # frames done, frames in all if that is known, and what is done


def silent(*_: object) -> None:
    """Where nobody listens."""


@dataclass(frozen=True, eq=False)
class ClipRequest:
    """A clip, what says where its tracks begin, and which of its frames are read.

    `init` is an init file, a start, or the detector that looks for a face whatever lies beside the clip; None: see
    `find`. `faces` says whether it takes the best face, or all that are there.
    `init_frame` is the frame of the init file or box, or the first to look for a face in.
    `stream`: the number of the video stream in the file.
    `chunk`: whether it is a chunk of a longer clip.
    """

    clip: Path
    _: KW_ONLY
    init: Path | DetectorName | Start | None = None
    faces: Faces = "one"
    box: Box | None = None
    init_frame: int | None = None
    start: int = 0
    stop: int | None = None
    fps: Fraction | None = None
    stream: int | None = None
    chunk: bool = False

    @property
    def first(self) -> int:
        """The first frame that is looked at, where no start says another."""
        return self.start if self.init_frame is None else self.init_frame

    @property
    def by(self) -> DetectorName | None:
        """The detector that `init` names."""
        return next((name for name in DETECTORS if name == self.init), None)

    def open(self, first: int = 0) -> Source:
        return open_source(self.clip, fps=self.fps, start=first, stop=self.stop, stream=self.stream)

    def find(
        self,
        recipe: Recipe,
        truth: Trajectory | None = None,
        stopped: Callable[[], bool] = never,
        looked: Callable[[int, int | None], None] = silent,
    ) -> Start:
        """Where a recipe begins: the box or init file given, the init file beside the clip, else the ground truth.

        The start of ground truth is its first frame in which all that the recipe follows is visible. Without any a face
        is looked for. Raises InputError where there is no such place in these frames, or once `stopped`.
        `looked` hears in how many frames, and of how many, a face was looked for.
        """
        first = self.first
        path = find_init(self.clip) if self.init is None else self.init
        start: Start | None = None
        if isinstance(self.init, Start):
            start = self.init
        elif self.box is not None:
            start = Start(first, {"face": TargetStart(box=self.box)}, "--box")
        elif isinstance(path, Path):
            start = read_init(path)
        elif path is None and truth is not None:
            start = truth_start(truth, recipe.points)
        at = first if start is None or self.init_frame is not None else start.frame
        origin = self.origin(start)
        if at < self.start or (self.stop is not None and at >= self.stop):
            asked = f"from {self.start} on" if self.stop is None else f"{self.start} to {self.stop - 1}"
            remedy = "change --start or --stop, or begin elsewhere with --init or --box"
            raise InputError(f"{self.clip}: {origin} begins at frame {at}, but frames {asked} were asked for; {remedy}")
        if start is not None:
            if start.origin not in DETECTORS and recipe.heads:
                start = replace(start, detector=start.detector or detector().name)
            start = replace(start, frame=at, placed=start.placed and start.frame == at)
            return completed(recipe, start, lambda: self.frame(at, origin), str(self.clip))
        with self.open(at) as source:
            faces: Faces = "all" if recipe.later else self.faces
            frames, clip = frames_of(source, at, origin, stopped, looked), str(self.clip)
            how: Any = {"faces": faces, "clip": clip, "complete": partial(with_names, recipe, clip)}
            start = search_start(frames, recipe.points, detector=detector(self.by), **how)
        return self._signer(recipe, start) if recipe.later else start

    def _signer(self, recipe: Recipe, start: Start) -> Start:
        """Of a start with several faces that with the largest, or with one whose hands move far more than its hands."""
        first, moved = next(iter(start.targets)), list[float]()
        starts = [replace(start, targets={first: face}) for face in start.targets.values()]
        if len(starts) == 1:
            return start
        for candidate in starts:
            with self.open(start.frame) as source:
                tracker = tracker_for(recipe, candidate, source.size)
                moved.append(hands_moved(track(tracker, islice(iter(source), SIGNS_FRAMES), recipe.seed)))
        best = int(np.argmax(moved))
        if moved[best] < MIN_MOVED or moved[best] < MOVES_MORE * moved[0]:
            return replace(starts[0], note=start.note.replace(", and ", "; passed over: ", 1))
        wide = f"begins in frame {start.frame} with a face {box_of(starts[best], first)[2]:.0f} pixels wide"
        note = f"{wide}, whose hands move most, by {start.origin}; passed over: {len(starts) - 1} more"
        return replace(starts[best], note=note)

    def origin(self, start: Start | None) -> str:
        """What says in which frame to begin."""
        if self.init_frame is not None:
            return "--init-frame"
        return "the search" if start is None else start.origin

    def frame(self, index: int, origin: str = "a correction") -> Frame:
        """One frame of the clip, which `origin` asks for."""
        with self.open(index) as source:
            return next(frames_of(source, index, origin))


def frames_of(
    source: Source,
    first: int,
    origin: str,
    stopped: Callable[[], bool] = never,
    looked: Callable[[int, int | None], None] = silent,
) -> Iterator[Frame]:
    """The frames from the `first`, which `origin` asked for; InputError, which says so, if that one cannot be had."""
    frames = iter(source)
    try:
        frame = next(frames, None)
    except InputError as e:
        raise InputError(f"{e} (frame {first} is where {origin} begins)") from None
    if frame is None:
        raise InputError(source.warnings.pop() if source.warnings else f"{source.path}: frame {first} cannot be read")
    done = 0
    while frame is not None and not stopped():
        yield frame
        frame, done = None, done + 1  # none is held while the next one is decoded
        looked(done, source.frames_hint)
        frame = next(frames, None)


def completed(recipe: Recipe, start: Start, first: Callable[[], Frame], clip: str) -> Start:
    """The start with what it lacks: points in a lone box, targets that the recipe names; `first` gives its frame."""
    if not start.targets:
        raise InputError(f"{start.origin}: has no targets; give one, with a box or points")
    if recipe.followed:
        frame = None
        if not set(recipe.followed) <= {*start.targets, *recipe.later}:
            frame = first()
            check_start(start, frame.size, ())
        return with_names(recipe, clip, frame, start)
    name, target = next(iter(start.targets.items()))
    if len(start.targets) > 1 or target.points or target.box is None or not recipe.points:
        return start
    file = clip if start.origin == "--box" else start.origin
    [placed] = box_start(first(), target.box, recipe.points, by=start.detector, clip=file).targets.values()
    return replace(start, targets={name: replace(placed, windows=target.windows)}, placed=start.detector != "")


def with_names(recipe: Recipe, clip: str, frame: Frame | None, start: Start) -> Start:
    """The start with the targets that the recipe names, as the frame shows them."""
    return name_targets(start, recipe.followed, frame, left_out=recipe.left_out, later=recipe.later, clip=clip)


def truth_start(truth: Trajectory, points: Sequence[str]) -> Start:
    """The first frame of the ground truth in which its targets' boxes, or all these points of them, are visible."""
    for frame, rows in by_frame(truth):
        boxes: dict[str, Box] = {}
        places: dict[str, dict[str, Point]] = defaultdict(dict)
        for i in rows:
            target, part = truth.names[truth.which[i]]
            place = tuple(truth.boxes[i].tolist())
            if not all(map(math.isfinite, place)):
                place = float(truth.x[i]), float(truth.y[i])
            if truth.status[i] not in SEEN or not all(map(math.isfinite, place)):
                continue
            if len(place) == 4:
                boxes[target] = place
            elif part in points:
                places[target][part] = place
        whole = {target: {p: at[p] for p in points} for target, at in places.items() if len(at) == len(points)}
        if {*boxes, *whole} >= {*truth.targets}:
            targets = {name or "face": TargetStart(boxes.get(name), whole.get(name, {})) for name in truth.targets}
            return Start(frame, targets, str(truth.path))
    what = ", ".join(points) if points else "a box"
    remedy = "give --init FILE or --box" + ("" if points else ", or take a recipe of points, as factorized")
    raise InputError(f"{truth.path}: no frame shows {what} of every target to begin with; {remedy}")


def hands_moved(results: Iterable[FrameResult]) -> float:
    """How far the hands of a head go while they have a place, in all, in sizes of the head's box."""
    total, before = 0.0, dict[str, complex]()
    for rows in (result.rows for result in results):
        targets = [rows.names[i][0] for i in rows.which]
        at = {name: complex(x, y) for name, x, y in zip(targets, rows.x, rows.y, strict=True) if math.isfinite(x)}
        head = next(i for i, name in enumerate(targets) if name not in HANDS)
        side = math.sqrt(rows.w[head] * rows.h[head])
        steps = (abs(at[name] - before[name]) / side for name in HANDS if name in at and name in before)
        total += sum(step for step in steps if math.isfinite(step))
        before = at
    return total


class Split(NamedTuple):
    """How long chunks are to be, in frames or in seconds."""

    length: float
    frames: bool

    def record(self) -> dict[str, str]:
        return {"length": f"{self.length:.15g}{'f' if self.frames else 's'}"}


@dataclass(frozen=True, eq=False)
class Job(ClipRequest):
    """What is asked of one clip. `out` None streams the one format to standard output.

    `lag`: by how many frames rows come later, given the frames up to then. `smooth`: whether they are smoothed at the
    end, given the whole clip. `strict`: whether a damaged clip is an error; its rows are kept. `resume`: whether a run
    that was ended goes on from its last checkpoint. `batch`: whether a clip that fails has a run.json that says so; it
    is not tried again then, but with `retry_failed`. `split`: the length of chunks that are tracked apart and joined.
    """

    recipe: Recipe
    out: Path | None
    _: KW_ONLY
    formats: tuple[Format, ...] = ("csv", "json")
    video: bool = True
    overwrite: bool = False
    threads: int = 2
    lag: int = 0
    smooth: bool = False
    strict: bool = False
    resume: bool = True
    batch: bool = False
    retry_failed: bool = False
    split: Split | None = None
    gallery: Path | None = None  # people that a film may show
    found: Start | None = None  # where the search has found the start of what is split


class Plan(NamedTuple):
    """A job with the answers that the files gave: its `init` is the init file beside the clip, where that is taken.

    `asked` is a digest of all that is asked for but the clip: of recipe, start, frames, options, and their files.
    `everyone`: whether everybody in a film is followed, from entry to exit, and over cuts. `previous` is the run.json
    of an earlier run of the same job and the same clip, whose files are whole.
    """

    job: Job
    asked: str
    everyone: bool
    previous: manifest.Manifest | None

    @property
    def draws(self) -> bool:
        """Whether a video is drawn from rows: of a film the names are known at the end."""
        return self.job.video and self.job.out is not None and not self.everyone

    @property
    def names(self) -> bool:
        """Whether people are named at the end."""
        return self.everyone and not self.job.chunk and self.job.out is not None

    @property
    def tracked(self) -> manifest.Manifest | None:
        """The run.json of a run that came to its end, named and smoothed or not, and is not to be replaced."""
        previous = None if self.job.overwrite else self.previous
        return previous if previous is not None and previous.error is None and previous.stopped is None else None

    def ended(self) -> "Outcome | None":
        """What became of a job that is done, or, in a batch, has failed; None if the clip is to be tracked."""
        previous, job = self.previous, self.job
        if previous is None or job.overwrite:
            return None
        whole = self.tracked is not None and (manifest.VIDEO in previous.files or not job.video)
        whole &= (not self.names or PEOPLE in previous.files) and (not job.smooth or previous.smoothed)
        failed_before = previous.error is not None and job.batch and not job.retry_failed
        return Outcome.of(job, previous) if whole or failed_before else None


def resolve(job: Job, *, kept: bool = False, locked: bool = False) -> Plan:
    """Look at what is there, once, and refuse what cannot work before anything is opened.

    `kept`: whether rows without a folder stay in memory, and do not go to standard output. `locked`: whether the
    folder's lease is ours, so that nobody else writes there. Raises UsageError, InputError and OutputError for options
    that exclude each other, results in the way, an output that is the input.
    """
    if job.init is None and job.box is None:
        job = replace(job, init=find_init(job.clip))
    searched = job.box is None and (job.init is None or job.init in DETECTORS)
    everyone = job.faces == "all" and searched and follows_everyone(job.recipe)
    _check_options(job, everyone, kept)
    how = {"clip", "recipe", "out", "overwrite", "threads", "resume", "batch", "retry_failed", "found"}
    values: dict[str, object] = {each.name: getattr(job, each.name) for each in fields(job) if each.name not in how}
    if isinstance(job.init, Path):
        values["init"] = manifest.clip_digest(job.init)
    elif isinstance(job.init, Start):
        values["init"] = to_record(job.init)
    words = [__version__, manifest.recipe_digest(job.recipe), *map(str, values.items())]
    asked = hashlib.sha256(dumps(words).encode(errors="surrogateescape")).hexdigest()
    if job.out is None:
        return Plan(job, asked, everyone, None)
    if job.chunk:
        check_plain(job.out)
    if not locked:
        manifest.recover_interrupted(job.out, lambda: True)
    held = not locked and is_held(job.out)  # whoever writes there may be writing the same results
    previous, there = manifest.previous_run(job.out, asked, job.clip)
    if not held:
        # what is cut short is replaced, and what failed
        overwrite = job.overwrite or previous is not None or (there is not None and there.is_failure)
        init = job.init if isinstance(job.init, Path) else None
        check_folder(job.out, manifest.OWNED, overwrite=overwrite, inputs=(job.clip, init, job.recipe.path))
    return Plan(job, asked, everyone, previous)


def follows_everyone(recipe: Recipe) -> bool:
    """Whether a recipe follows everybody over cuts, where all faces are asked for."""
    return bool(recipe.heads) and not recipe.followed


def check_count(name: str, value: object) -> None:
    """UsageError for what does not count frames."""
    if not isinstance(value, Integral) or value < 0:
        raise UsageError(f"{name} {value!r} is no whole number from 0 on")


def check_span(start: int, stop: int | None) -> None:
    """UsageError for a span of frames that has none."""
    if stop is not None and stop <= start:
        place = f"after --start {start}" if start else "at all"
        raise UsageError(f"--stop {stop} leaves no frame {place}; it is the frame to stop before")


def _check_options(job: Job, everyone: bool, kept: bool) -> None:
    """UsageError for options that exclude each other, and for values that only Python can ask for."""
    if job.faces not in get_args(Faces):
        raise UsageError(f"faces {job.faces!r} is not one of {', '.join(get_args(Faces))}")
    if unknown := [form for form in job.formats if form not in FORMATS]:
        raise UsageError(f"formats: {unknown[0]!r} is not one of {', '.join(FORMATS)}")
    for name, value in (("start", job.start), ("stop", job.stop or 0), ("lag", job.lag)):
        check_count(name, value)
    check_span(job.start, job.stop)
    if job.faces == "all" and job.recipe.later:
        who = f"recipe {job.recipe.name} follows the hands of one person"
        raise UsageError(f"--faces all: {who}; leave it out, and choose the signer with --box X,Y,W,H")
    if everyone and (job.lag or job.smooth):
        why = "follows people over cuts, and no row is smoothed over a cut"
        raise UsageError(f"--faces all {why}; leave one of them out")
    if everyone and job.out is None and not kept:
        raise UsageError("--faces all knows who is who at the end, and -o - writes as it goes; name a folder")
    if job.gallery is not None and not everyone:
        raise UsageError(f"--gallery: {job.clip} has a start, and people are named where faces are searched for")
    if job.gallery is not None:
        load_people(job.gallery)
    if job.lag or job.smooth:
        check_smoothing(job.recipe)


@dataclass
class Outcome(manifest.Manifest):
    """What became of one clip: what its run.json says, and what is said of it.

    `source` is the clip, `paths` are the files. `failure` ended the run early; what was tracked until then is kept.
    `note` says where the search for a face began it. `again`: the run was done before, and nothing was tracked now.
    """

    source: Path = Path()
    paths: Sequence[Path] = ()
    frames_per_s: float = 0.0
    failure: Exception | None = None
    streamed: bool = False
    note: str = ""
    verdict: str = ""
    again: bool = False

    @classmethod
    def of(cls, job: Job, run: manifest.Manifest) -> "Outcome":
        """That of a run that its folder holds already."""
        assert job.out is not None
        kind = InputError if run.exit_code == ExitCode.INPUT else FacetrackError
        paths, failure = [job.out / name for name in run.files], None if run.error is None else kind(run.error)
        if job.strict and not run.complete:
            failure = failure or InputError(run.warnings[-1])
        said = {"warnings": (), "stopped": None, "resumed": 0}
        return cls(**{**vars(run), **said}, source=job.clip, paths=paths, failure=failure, again=True)

    def next_step(self) -> str:
        """The commands that show and correct what was written; "" where they could not."""
        if not self.paths or not any(file.suffix in (".json", ".jsonl") for file in self.paths):
            return ""
        folder = shlex.quote(str(self.paths[0].parent))
        by = "people" if any(file.name == PEOPLE for file in self.paths) else "fix"
        return f"look: facetrack report {folder}; correct: facetrack {by} {folder}"

    def summary(self) -> str:
        """One line: what was written, how fast, what was lost."""
        if self.frames == 0:
            return f"{self.source}: {self.stopped or 'ended'} before the first frame; nothing was written"
        parts = [f"{self.frames} frames" if self.frames > 1 else "1 frame"]
        if self.again:
            parts.insert(0, "done before")
        elif self.frames > 1 and self.frames_per_s:
            parts.append(f"{self.frames_per_s:.1f} frames/s")
        if self.network:
            parts.append(self.network)
        if self.smoothed:
            parts.append("smoothed")
        if self.resumed:
            parts.append(f"went on after {self.resumed} frames")
        if self.lost_frames:
            worst = sorted(self.lost_frames.items(), key=lambda item: -item[1])[:MOST_NAMED]
            named = ", ".join(f"{name.replace('/', ' ')} in {n}" for name, n in worst)
            others = ", and other parts" * (len(self.lost_frames) > MOST_NAMED)
            parts.append(f"lost: {named} frame{'s' * (worst[-1][1] > 1)}{others}")
        if self.stopped or not self.complete:
            parts.append(self.stopped or "incomplete")
        where = "standard output" if self.streamed else "nothing"
        if self.paths:
            where = f"{self.paths[0].parent}{os.sep} ({', '.join(file.name for file in self.paths)})"
        return f"{self.source} -> {where}: {'; '.join(parts)}"


def check_smoothing(recipe: Recipe) -> None:
    """UsageError for a recipe whose trackers have no posterior to smooth."""
    if not recipe.filters:
        raise UsageError(f"{recipe.name} is one of OpenCV's trackers, which have no posterior to smooth; take another")
    if all(settings.target.type == "cloud" for settings in recipe.filters.values()):
        raise UsageError(f"{recipe.name}: the particles of a cloud are the target itself, no posterior to smooth")
