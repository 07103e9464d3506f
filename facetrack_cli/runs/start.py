"""Where the tracks of a clip begin: an init file, a box, ground truth, or a face that is looked for."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import DETECTORS, HANDS, DetectorName
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Box, Frame, Point, Start, TargetStart
from facetrack_cli.engine.checks import box_of, check_start
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.signals import never
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.init_file import find_init, read_init
from facetrack_cli.start.search import Faces, box_start, search_start
from facetrack_cli.start.targets import name_targets
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory
from facetrack_cli.trajectory.writers import by_frame
from facetrack_cli.video.source import Source, open_source

SIGNS_FRAMES: Final = 50  # in which hands are looked at, where a recipe follows those of one of several faces
MIN_MOVED, MOVES_MORE = 2.0, 2.0  # sizes of its face; and times as far as the hands of the largest face
MIN_OVERLAP: Final = 0.5  # of the boxes: a region with less does not count as found


@dataclass(frozen=True)
class Begin:
    """A clip, what says where its tracks begin, and which of its frames are read.

    `init` is an init file, a start, or the detector that looks for a face whatever lies beside the clip; None: see
    `find`. `faces` says whether it takes the best face, or all that are there.
    `init_frame` is the frame of the init file or box, or the first to look for a face in.
    `stream`: the number of the video stream in the file.
    `chunk`: that it is a chunk of a clip, in which a face is looked for up to its end.
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

    def open(self, first: int = 0) -> Source:
        return open_source(self.clip, fps=self.fps, start=first, stop=self.stop, stream=self.stream)

    def find(
        self,
        recipe: Recipe,
        truth: Trajectory | None = None,
        stopped: Callable[[], bool] = never,
        looked: Callable[[int, int | None], None] = lambda done, total: None,
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
            raise InputError(
                f"{self.clip}: {origin} begins at frame {at}, but frames {asked} were asked for; "
                "change --start or --stop, or begin elsewhere with --init or --box"
            )
        if start is not None:
            if start.origin not in DETECTORS and recipe.has_head:
                start = replace(start, detector=start.detector or detector().name)
            start = replace(start, frame=at, placed=start.placed and start.frame == at)
            return completed(recipe, start, lambda: self.frame(at, origin), str(self.clip))
        with self.open(at) as source:
            by = next((name for name in DETECTORS if name == self.init), None)
            faces: Faces = "all" if recipe.later else self.faces
            frames = _counted(frames_of(source, at, origin, stopped), source, looked)
            while True:
                try:
                    found = search(recipe, frames, str(self.clip), by=by, faces=faces)
                    return self._signer(recipe, found) if recipe.later else found
                except InputError:
                    if stopped():
                        raise InputError(f"{self.clip}: stopped before a start was found") from None
                    further = next(frames, None) if self.chunk else None
                    if further is None:
                        raise
                    frames = chain([further], frames)

    def _signer(self, recipe: Recipe, start: Start) -> Start:
        """Of a start with several faces that with the largest, or with one whose hands move far more than its hands."""
        (first, _), *others = start.targets.items()
        one_each = [replace(start, targets={first: face}) for face in start.targets.values()]
        if not others:
            return start
        moved = []
        for one in one_each:
            with self.open(one.frame) as source:
                frames = islice(iter(source), SIGNS_FRAMES)
                tracker = tracker_for(recipe, one, source.size, source.fps)
                moved.append(hands_moved([result.rows for result in track(tracker, frames, recipe.seed)]))
        best = int(np.argmax(moved))
        if moved[best] < MIN_MOVED or moved[best] < MOVES_MORE * moved[0]:
            return replace(one_each[0], note=start.note.replace(", and ", "; passed over: ", 1))
        wide = f"begins in frame {start.frame} with a face {box_of(one_each[best], first)[2]:.0f} pixels wide"
        note = f"{wide}, whose hands move most, by {start.origin}; passed over: {len(others)} more"
        return replace(one_each[best], note=note)

    def origin(self, start: Start | None) -> str:
        """What says in which frame to begin."""
        given = "the search" if start is None else start.origin
        return given if self.init_frame is None else "--init-frame"

    def frame(self, index: int, origin: str = "a correction") -> Frame:
        """One frame of the clip, which `origin` asks for."""
        with self.open(index) as source:
            return next(frames_of(source, index, origin))


def frames_of(source: Source, first: int, origin: str, stopped: Callable[[], bool] = never) -> Iterator[Frame]:
    """The frames from the `first`, which `origin` asked for; InputError, which says so, if that one cannot be had."""
    frames = iter(source)
    try:
        frame = next(frames, None)
    except InputError as e:
        raise InputError(f"{e} (frame {first} is where {origin} begins)") from None
    if frame is None:
        raise InputError(source.warnings.pop() if source.warnings else f"{source.path}: frame {first} cannot be read")
    while frame is not None and not stopped():
        yield frame
        frame = None  # while the next one is decoded
        frame = next(frames, None)


def _counted(frames: Iterator[Frame], source: Source, looked: Callable[[int, int | None], None]) -> Iterator[Frame]:
    for done, frame in enumerate(frames, 1):
        yield frame
        looked(done, source.frames_hint)


def completed(recipe: Recipe, start: Start, first: Callable[[], Frame], clip: str) -> Start:
    """The start with what it does not say: points of a target that is a box alone, targets that the recipe names.

    `first` gives its frame.
    """
    if recipe.followed:
        frame = None
        if not set(recipe.followed) <= {*start.targets, *recipe.later}:
            frame = first()
            check_start(start, frame.size, ())
        return name_targets(start, recipe.followed, frame, left_out=recipe.left_out, later=recipe.later, clip=clip)
    name, given = next(iter(start.targets.items()))
    if len(start.targets) > 1 or given.points or given.box is None or not recipe.points:
        return start
    said_in = clip if start.origin == "--box" else start.origin
    [found] = box_start(first(), given.box, recipe.points, by=start.detector, clip=said_in).targets.values()
    return replace(start, targets={name: replace(found, windows=given.windows)}, placed=start.detector != "")


def search(
    recipe: Recipe,
    frames: Iterator[Frame],
    clip: str,
    *,
    by: DetectorName | None = None,
    faces: Faces = "one",
    whole: bool = True,
) -> Start:
    """The start at the first face in `frames`, if not `whole` in the first ones alone. InputError if there is none."""

    def complete(frame: Frame, start: Start) -> Start:
        return name_targets(start, recipe.followed, frame, left_out=recipe.left_out, later=recipe.later, clip=clip)

    look = detector(by)
    return search_start(frames, recipe.points, detector=look, faces=faces, whole=whole, clip=clip, complete=complete)


def truth_start(truth: Trajectory, points: Sequence[str]) -> Start:
    """The first frame of the ground truth in which its targets' boxes, or all these points of them, are visible."""
    boxes = truth.boxes
    for frame, rows in by_frame(truth):
        found: dict[str, Box] = {}
        known: dict[str, dict[str, Point]] = {}
        for i in rows:
            target, part = truth.names[truth.which[i]]
            place = boxes[i] if np.isfinite(boxes[i]).all() else np.array([truth.x[i], truth.y[i]])
            if truth.status[i] not in SEEN or not np.isfinite(place).all():
                continue
            if len(place) == 4:
                found[target] = tuple(place.tolist())
            elif part in points:
                known.setdefault(target, {})[part] = (place[0].item(), place[1].item())
        whole = {target: {p: those[p] for p in points} for target, those in known.items() if len(those) == len(points)}
        if {*found, *whole} >= {*truth.targets}:
            targets = {one or "face": TargetStart(found.get(one), whole.get(one, {})) for one in truth.targets}
            return Start(frame, targets, str(truth.path))
    what = ", ".join(points) if points else "a box"
    other = "" if points else ", or take a recipe of points, as factorized"
    raise InputError(
        f"{truth.path}: no frame shows {what} of every target to begin with; give --init FILE or --box{other}"
    )


def hands_moved(frames: Sequence[Trajectory]) -> float:
    """How far the hands of a head go while they have a place, in all, in sizes of the head's box."""
    total, before = 0.0, dict[str, complex]()
    for rows in frames:
        named = [rows.names[i][0] for i in rows.which]
        at = {name: complex(x, y) for name, x, y in zip(named, rows.x, rows.y, strict=True) if math.isfinite(x)}
        head = next(i for i, name in enumerate(named) if name not in HANDS)
        side = math.sqrt(rows.w[head] * rows.h[head])
        total += float(np.nansum([abs(at[one] - before[one]) / side for one in HANDS if one in at and one in before]))
        before = at
    return total


def far_from_truth(start: Start, truth: Trajectory) -> str | None:
    """A line if a start's box lies elsewhere than the ground truth's in its frame: then every figure measures that."""
    boxes = {name: target.box for name, target in start.targets.items() if target.box is not None}
    for name, box in boxes.items() if start.origin != str(truth.path) else ():
        for one in truth.at(start.frame).parts:
            if one.target not in (name, "") or not len(one) or not np.isfinite(one.boxes).all():
                continue
            overlap = float(iou(np.array([box]), one.boxes)[0])
            if overlap < MIN_OVERLAP:
                return (
                    f"{start.origin} puts the box of {name} in frame {start.frame} where it overlaps the truth's "
                    f"by {overlap:.2f} alone; all figures measure that too: begin with --box, or with another --init"
                )
    return None
